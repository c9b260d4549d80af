"""Polynomials whose terms beyond the affine ones are shrunk, averaged over how much.

The prior: with all coordinates scaled to [-1, 1], the coefficient of X^a Y^b Z^c, a + b + c >= 2,
is normal with the mean 0 and the standard deviation

    size * fall^(a + b + c - 2) * relief^c * own

in units of the noise: the coefficients of a Taylor series of a smooth function fall from order
to order by one rate, and by a further one with each power of Z, as the relief is shallow next to
the scene. Affine terms are free. How large `size` is for line and for sample, and what `fall`
and `relief` are for both, is not known: the least-squares solutions for all values on a wide
grid are averaged with their posterior probabilities, and nothing is set. An affine image, of
which all sizes are 0, is one of them, with a probability of its own. `own` is a factor for
each term, log-normal, drawn many times, so that single terms may stand out from the rule.
Noise is taken to be the same in line and sample; its variance is integrated out.

Every solution on the grid is linear in the measurements. Leaving a point out changes it, and
its probability, in closed form, so that the leave-one-out errors are those of the whole
procedure repeated without each point. Lines couple line and sample:
`termsel.adjustment.bayesian.line_posterior` has the same for them.

References
----------
Hoerl and Kennard 1970 for ridge regression; Lindley and Smith 1972, J. R. Stat. Soc. B 34(1), for
its prior; Gelman 2006, Bayesian Analysis 1(3), for that of its size; Hoeting et al. 1999,
Statistical Science 14(4), for averaging. The prior's form is termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.bayesian.line_posterior import mean_line_solution
from termsel.adjustment.bayesian.posterior import Posterior, polynomial_posterior
from termsel.adjustment.equations import line_normals, row_weights, weights_of
from termsel.adjustment.interpolation import Interpolation
from termsel.adjustment.leave_out import independent_parts
from termsel.adjustment.solve import TOLERANCE, Adjustment, Spectrum, choose_penalty
from termsel.core.errors import count_in_words
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.monomials import Exponents, evaluate_monomials
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.least_squares import LeastSquares
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial
from termsel.models.terms import Term


@dataclass(frozen=True, eq=False)
class Average:
    """An averaged polynomial."""

    coefficients: FloatArray  # (k, 2): of line and sample
    # (n, 2): measured minus predicted by the same procedure without that point, or without the line
    # of a vertex.
    errors: FloatArray
    # Effective parameters of line and sample together: the trace of the matrix that turns
    # measurements into their fitted values.
    effective: float


class Averaging(Estimator):
    """The average of a polynomial's regularised solutions."""

    name = "averaging"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a polynomial to the features in use, with all its terms; see `Estimator.fit`.

        Raises Undetermined where leaving out some single feature leaves an affine model
        undetermined.
        """
        assert isinstance(model, Polynomial)
        scaled = scaling.features(control.take(used))
        points = scaled.points
        if len(scaled.lines):
            feature_word = "control feature"
            average_of_all = fit_average_with_lines(scaled, model)
        else:
            feature_word = "control point"
            weights = None if points.sigma is None else weights_of(points)
            average_of_all = fit_average(points.ground, points.image, model.exponents, weights)
        if average_of_all is None:
            raise Undetermined(
                f"{count_in_words(len(scaled), feature_word)} without any one of them do not "
                "determine an affine model", hint="Measure more control, spread over the area.")
        return fit_of(self, model, control, scaling, used, average_of_all)


def fit_of(estimator: Estimator, model: Polynomial, control: FeatureSet, scaling: Scaling,
           used: BoolArray, average_of_all: Average) -> Fit:
    """Return the average of a polynomial's solutions as a fit, with its errors held out.

    Its sigma0^2 is v'v / (n - p), with the weighted residuals v of the n equations in use and the
    effective number p of parameters.
    """
    coefficients = average_of_all.coefficients.T.ravel()
    scaled = scaling.features(control)
    # Equations of lines need the whole system; points alone are faster by their monomials.
    if len(scaled.lines):
        equations = model.equations(scaled)
        v = (equations.b - equations.A @ coefficients)[used[equations.feature]]
    else:
        points = scaled.points
        predicted = evaluate_monomials(points.ground, model.exponents) @ average_of_all.coefficients
        v = ((points.image - predicted) * weights_of(points))[used].ravel()
    freedom = len(v) - average_of_all.effective
    count = round(average_of_all.effective)
    # Half a degree of freedom or less is none, as counts are whole numbers.
    sigma0 = float(np.sqrt(v @ v / freedom)) if freedom > 0.5 else np.nan
    adjustment = Adjustment(coefficients, np.full(len(coefficients), np.nan), n_terms=count,
                            n_equations=len(v), rank=count, condition=np.nan, sigma0=sigma0)
    held_out = HeldOut.of(average_of_all.errors * scaling.image_scale, control.take(used))
    return Fit(model, scaling, control, terms=np.ones(len(coefficients), dtype=bool), used=used,
               adjustment=adjustment, estimator=estimator, trace=average_of_all.effective,
               stored_held_out=held_out)


def fit_average(ground: FloatArray, image: FloatArray, exponents: Exponents,
                weights: FloatArray | None = None) -> Average | None:
    """Fit an averaged polynomial to points.

    Parameters
    ----------
    ground, image : ndarray, shape (n, 3) and (n, 2)
        Scaled to [-1, 1].
    exponents : tuple
        Of k terms, the affine ones first.
    weights : ndarray, shape (n, 2), optional
        Reciprocals of standard deviations, up to a factor: what equations are multiplied by.

    Returns
    -------
    Average or None
        None if leaving out some single point leaves the affine terms undetermined.
    """
    posterior = polynomial_posterior(ground, image, exponents, weights)
    if posterior is None:
        return None
    coefficients, effective = mean_coefficients(posterior, exponents)
    # The equations were multiplied by the weights, and so were their errors.
    errors = posterior.held_out.errors
    return Average(coefficients, errors if weights is None else errors / weights, effective)


def mean_coefficients(posterior: Posterior, exponents: Exponents) -> tuple[FloatArray, float]:
    """Return the averaged coefficients of a posterior, (k, 2), and its effective parameters.

    Coefficients of shrunken terms are averaged over the grid; the affine ones, which are free,
    follow from them by least squares. The exponents are as for `fit_average`.
    """
    is_free = np.array(exponents).sum(axis=1) < 2
    coefficients = np.empty((len(exponents), 2))
    effective = 0.0
    for axis, (design, solutions) in enumerate(zip(posterior.designs, posterior.solutions,
                                                   strict=True)):
        shrunk_coefficients, effective_of_axis = posterior.mean(axis)
        coefficients[~is_free, axis] = shrunk_coefficients
        # Affine terms fit what the others leave: R x = Q'(y - C shrunk), with their factors Q R.
        coefficients[is_free, axis] = np.linalg.solve(
            design.free_triangle, solutions.free - design.free_projections @ shrunk_coefficients)
        effective += effective_of_axis
    return coefficients, effective


def fit_average_with_lines(features: FeatureSet, model: Polynomial) -> Average | None:
    """Fit an averaged polynomial to points and lines, or to lines alone, scaled to [-1, 1].

    The errors of the average are those of the points, then of both vertices of each line, along its
    normal. Returns None if leaving out some single feature leaves the affine terms undetermined.
    """
    equations = model.equations(features)
    mean_solution = mean_line_solution(equations, model.exponents)
    if mean_solution is None:
        return None
    k = len(model.exponents)
    (shrunk_coefficients, effective, row_errors) = mean_solution
    is_free = np.tile(np.array(model.exponents).sum(axis=1) < 2, 2)  # of line, then of sample
    left_to_affine = equations.b - equations.A[:, ~is_free] @ shrunk_coefficients
    coefficients = np.empty(2 * k)
    coefficients[~is_free] = shrunk_coefficients
    coefficients[is_free] = np.linalg.lstsq(equations.A[:, is_free], left_to_affine)[0]
    # The rows were multiplied by their weights, and so were their errors.
    row_errors = row_errors / row_weights(features, heights=model.uses_height)
    n_point_rows = 2 * len(features.points)
    normals = np.repeat(line_normals(features.lines)[0], 2, axis=0)
    errors = np.concatenate([row_errors[:n_point_rows].reshape(-1, 2),
                             row_errors[n_point_rows:, None] * normals])
    return Average(coefficients.reshape(2, k).T, errors, effective)


# Ridge regression that shrinks a coefficient the more, the higher the order of its term.

class RidgeByOrder(Estimator):
    """Ridge regression that shrinks a coefficient the more, the higher the order of its term.

    Minimises |b - A x|^2 + penalty^2 sum (w_j x_j)^2 over the control, for each independent part
    with the penalty of the least generalised cross-validation. The weight of a numerator's term is
    its order less 1, so that affine terms are not shrunk, that of a denominator's its order.
    Without a feature, the penalty is chosen again.

    References
    ----------
    Hoerl and Kennard 1970; Golub, Heath, Wahba 1979 for the penalty. The weights are termsel's
    own choice.
    """

    name = "ridge-by-order"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit the terms and features in use (see `Estimator.fit`), shrunken by their order.

        The rest of the adjustment, such as its rank, is that of least squares.
        """
        plain = LeastSquares(iterated=False).fit(model, control, scaling, terms, used)
        coefficients = np.zeros(len(terms))
        trace = 0.0
        # By order, as the class says: of a numerator's term less 1.
        weights = np.array([float(term.order if term.is_denominator else max(term.order - 1, 0))
                            for term in map(Term.parse, model.terms)])
        for part in independent_parts(plain.model.equations(plain.scaled_control), model.axis):
            rows = used[part.equations.feature]
            selected = terms & part.columns
            columns = part.equations.A[rows][:, selected[part.columns]]
            coefficients[selected], effective = _ridge(columns, part.equations.b[rows],
                                                       weights[selected])
            trace += effective
        return plain.with_coefficients(coefficients, self, trace)


def _ridge(columns: FloatArray, target: FloatArray,
           weights: FloatArray) -> tuple[FloatArray, float]:
    """Return ridge coefficients (k,) whose penalty is chosen by GCV, and their effective number.

    They are those of weighted `columns` (n, k) for a `target` (n,).
    Coefficients whose weight in `weights` (k,) is 0 are not penalised.
    """
    # With A = [F, P W], F the free columns, the substitution z = W x makes the penalty a plain
    # |z|^2. Orthogonal to F, that is (I - Q Q') P z = (I - Q Q') y, and the singular values s of
    # its columns give z = V s / (s^2 + penalty^2) U'y; it counts sum s^2 / (s^2 + penalty^2).
    is_free = weights == 0
    x = np.zeros(columns.shape[1])
    free_columns = columns[:, is_free]
    q, singular_values = np.linalg.svd(free_columns, full_matrices=False)[:2]
    rounding = np.finfo(float).eps * max(free_columns.shape)
    q = q[:, singular_values > rounding * singular_values.max(initial=0.0)]
    penalised = columns[:, ~is_free]
    penalised = (penalised - q @ (q.T @ penalised)) / weights[~is_free]
    y = target - q @ (q.T @ target)  # what the free columns leave
    effective = float(q.shape[1])
    if penalised.size:
        u, s, vt = np.linalg.svd(penalised, full_matrices=False)
        is_determined = s > TOLERANCE * s.max(initial=0.0)
        u = u[:, is_determined]
        s = s[is_determined]
        vt = vt[is_determined]
        projections = u.T @ y
        if len(s):
            # What no solution reaches; below 0 by rounding alone.
            outside_squared = max(float(y @ y - projections @ projections), 0.0)
            penalty = choose_penalty(
                Spectrum(s, np.abs(projections), outside_squared, len(y) - q.shape[1]), "gcv")
            x[~is_free] = vt.T @ (s / (s**2 + penalty**2) * projections) / weights[~is_free]
            effective += float((s**2 / (s**2 + penalty**2)).sum())
    # The free columns fit what the penalised ones leave.
    if free_columns.size:
        x[is_free] = np.linalg.lstsq(free_columns, target - columns @ x)[0]
    return x, effective


# Fits that predict from the control points themselves, for images with local deformation.

FIELD_CALLED_FOR = 0.75
"""Probability of a random field beyond which points support it: odds of three to one, beyond
which the evidence is positive (Kass and Raftery 1995, J. Am. Stat. Assoc. 90)."""

FIELD_EXCLUDED = 0.05
"""Probability up to which parts of many points are not asked for a field either."""


def required_probability(process: GaussianProcess) -> float:
    """Return the probability of a random field beyond which points support it.

    It is lower, down to 0, for few points without heights, which show too little to choose by and
    are averaged over all models.
    """
    return FIELD_CALLED_FOR * (1.0 - process.spline_weight)


def interpolated(model: SensorModel, control: FeatureSet, scaling: Scaling) -> Interpolation | None:
    """Return the interpolation of control points by a model.

    Returns None where the points are too few, or lie so that they determine no interpolation, such
    as in a row.
    """
    return model.prepared(scaling, control.crs).interpolation(scaling.features(control))


class Interpolated(Estimator):
    """The interpolation of a model, where the points support it.

    Its terms are those of least squares, and have no influence. A random field is supported where
    its probability exceeds `required_probability`.
    """

    name = "interpolated"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a model that interpolates: a spline, radial functions or a random field.

        Arguments are those of `Estimator.fit`. The terms have the coefficients of least squares,
        for the record alone: positions are computed by the interpolation. Raises Undetermined for
        lines, for points that determine no interpolation, and for a field that they do not support.
        """
        points_alone(control, used, "an interpolation")
        interpolation = interpolated(model, control.take(used), scaling)
        if interpolation is None:
            raise Undetermined(f"{count_in_words(int(used.sum()), 'control point')} do not "
                               "determine an interpolation: they are too few, or lie in a row",
                               hint="Measure more control, spread over the area.")
        if (isinstance(interpolation, GaussianProcess)
                and interpolation.probability <= required_probability(interpolation)):
            raise Undetermined("the points do not show local deformation: its probability is "
                               f"{interpolation.probability:.2g}", hint="Choose a polynomial.")
        least_squares = LeastSquares(iterated=False).fit(model, control, scaling, terms, used)
        errors = interpolation.errors * scaling.image_scale
        # Those of least squares would be of its errors, which include the deformation.
        no_deviations = np.full(len(terms), np.nan)
        adjustment = replace(least_squares.adjustment, deviations=no_deviations, correlations=None)
        return replace(least_squares, estimator=self, trace=interpolation.effective,
                       stored_held_out=HeldOut.of(errors, control.take(used)),
                       adjustment=adjustment)


def points_alone(control: FeatureSet, used: BoolArray, taker: str) -> Points:
    """Return the points of the control that are in use, by the mask `used` (n,) of its features.

    Raises Undetermined if there are lines, which `taker` does not take: a phrase with its article
    for the message, such as "an interpolation".
    """
    if len(control.lines):
        raise Undetermined(f"{taker} takes control points alone, and there are control lines",
                           hint="Leave the lines out, or choose another model.")
    return control.points.take(used)
