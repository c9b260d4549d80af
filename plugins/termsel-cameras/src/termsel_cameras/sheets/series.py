"""A sheet of a series as a candidate of auto: an affine map that is expected to be like others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from termsel import (
    Adjustment,
    Estimator,
    Experience,
    FeatureSet,
    Fit,
    FitData,
    HeldOut,
    Method,
    Option,
    Polynomial2D,
    Scaling,
    SensorModel,
    Spread,
    Undetermined,
)
from termsel.toolkit import BoolArray, FloatArray
from termsel_cameras.sheets.paper import (
    PAPER_NAMES,
    TURN,
    Paper,
    matrix_of,
    plan_of,
    reason_against,
    rotation_by,
    to_upright,
    wrap_angle,
)

COLUMN = "sheet_paper"
"""Column of the points that says what other sheets of the series show."""

UNKNOWNS = 6
"""Number of unknowns of a sheet: the four of its paper, and the two of its position."""

TAILS = 4.0
"""Degrees of freedom of what an affine map leaves of points: few are wild, as those of photos."""

_STEPS, _NOISE_STEPS = 30, 6

PAPER = Option("paper", "", "Expected scale, turn, stretch and shear, their standard deviations, "
               "the noise [px], its degrees of freedom, and the number of sheets.")


def text_of(paper: Paper) -> str:
    """Return what is known of a sheet as the column states it: its numbers with commas between."""
    numbers = [*paper.means, *paper.spreads, paper.noise, paper.freedom, paper.sheets]
    return ",".join(repr(float(number)) for number in numbers)


def paper_of_text(text: str) -> Paper:
    """Return what a column of points states of the paper of their sheet (see `text_of`).

    Raises
    ------
    Undetermined
        If it is no such statement.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if (len(numbers) != 2 * len(PAPER_NAMES) + 3 or not np.isfinite(numbers).all()
            or min(numbers[4:10]) <= 0.0):
        raise Undetermined(f"the column {COLUMN} does not state what a series shows: {text!r:.60}",
                           hint="Read the points with --set series=FILE.json.")
    return Paper(tuple(numbers[:4]), tuple(numbers[4:8]), numbers[8], numbers[9], int(numbers[10]))


class SeriesSheet(Polynomial2D):
    """Sheet of a series: an affine map of the plane, expected to be like those of other sheets.

    References
    ----------
    Lindley and Smith 1972, J. R. Stat. Soc. B 34(1), for the prior that others show. What sheets
    have in common is termsel's own formulation.
    """

    name = "series-sheet"
    declared_options = (PAPER,)

    @cached_property
    def exponents(self) -> Any:
        """Exponents of 1, X and Y."""
        return Polynomial2D(degree=1).exponents

    @cached_property
    def paper(self) -> Paper:
        """What other sheets show."""
        return paper_of_text(self.options["paper"])


@dataclass(frozen=True, eq=False)
class _SheetPosterior:
    """The affine map of a sheet by its points and the others of its series [px, units of the CRS].

    `values` are the four numbers of the paper and the place of the middle of the points,
    `covariance` theirs, `sigma` the noise, `effective` how many of them the points determine.
    """

    values: FloatArray
    covariance: FloatArray
    sigma: float
    effective: float


@dataclass(frozen=True)
class BySeries(Estimator):
    """The affine map of a sheet by its points, and by what others of the series show."""

    name = "series-sheet"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a sheet with all its terms to the points in use (see `Estimator.fit`).

        `used` (n,) marks the points in use; `terms` (k,) is not looked at. What the series shows of
        the paper is the prior of scale, turn, stretch and shear, so that one point is enough.
        Held-out errors are those of each point by the posterior of the others, with the noise of
        all.
        """
        assert isinstance(model, SeriesSheet)
        in_use = control.take(used)
        posterior, middle = self._sheet_posterior(model, in_use, scaling)
        plan = plan_of(in_use, scaling)
        measured = to_upright(in_use.points.image)
        errors = np.empty_like(measured)
        for i in range(len(measured)):
            others = np.arange(len(measured)) != i
            without = posterior_of(model.paper, plan[others] - middle, measured[others],
                                   posterior.sigma)
            errors[i] = measured[i] - _image_positions(without.values, plan[i:i + 1] - middle)[0]
        # From sample and minus line to line and sample.
        errors = errors[:, ::-1] * [-1.0, 1.0]
        coefficients = _affine_coefficients(posterior.values, middle, scaling)
        # An adjustment counts terms in whole numbers; the fit's trace is the effective number.
        n_terms = round(posterior.effective)
        adjustment = Adjustment(coefficients, np.full(UNKNOWNS, np.nan), n_terms=n_terms,
                                n_equations=2 * len(in_use), rank=n_terms, condition=np.nan,
                                sigma0=posterior.sigma / scaling.image_scale, converged=True)
        return Fit(model, scaling, control, terms=np.ones(UNKNOWNS, dtype=bool), used=used,
                   adjustment=adjustment, estimator=self, trace=posterior.effective,
                   stored_held_out=HeldOut.of(errors, in_use))

    def _sheet_posterior(self, model: SeriesSheet, in_use: FeatureSet,
                         scaling: Scaling) -> tuple[_SheetPosterior, FloatArray]:
        """Return the posterior of a sheet, and the middle x, y (2,) of its points' ground."""
        plan = plan_of(in_use, scaling)
        middle = plan.mean(axis=0)
        return posterior_of(model.paper, plan - middle, to_upright(in_use.points.image)), middle

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of image positions at scaled ground positions (m, 3).

        See `Estimator.spread`.
        """
        assert isinstance(fitted.model, SeriesSheet)
        scaling = fitted.scaling
        posterior, middle = self._sheet_posterior(
            fitted.model, fitted.control.take(fitted.used), scaling)
        plan = ground[:, :2] * scaling.ground_scale[:2] + scaling.ground_offset[:2]
        # Minus line and sample become sample and minus line; squares do not depend on the sign.
        slopes = _image_derivatives(posterior.values, plan - middle)[:, ::-1] / scaling.image_scale
        factors = slopes @ np.linalg.cholesky(posterior.covariance)
        noise = (posterior.sigma / scaling.image_scale) ** 2
        return Spread((factors**2).sum(axis=2), np.full(2, noise), factors)

    def experience(self, fitted: Fit) -> Experience:
        """Return the prior of the noise: degrees of freedom that the series gives it."""
        assert isinstance(fitted.model, SeriesSheet)
        return Experience(fitted.model.paper.freedom, UNKNOWNS, TAILS)


def posterior_of(paper: Paper, plan: FloatArray, measured: FloatArray,
                 sigma: float | None = None) -> _SheetPosterior:
    """Return the posterior of a sheet by its points and the prior of its paper.

    `plan` (n, 2) are x and y from their middle, `measured` (n, 2) samples and minus lines [px]. The
    noise is `sigma` [px], if given. Else noise and values are found in turns: the variance is the
    mean of that of the residuals and that of the series, weighted by their degrees of freedom.
    """
    prior = np.zeros((UNKNOWNS, UNKNOWNS))
    prior[:4, :4] = np.diag(1.0 / np.array(paper.spreads) ** 2)
    values = _start(paper, plan, measured)
    noise = paper.noise if sigma is None else sigma
    for _ in range(_NOISE_STEPS if sigma is None else 1):
        values, normal = _most_probable_values(paper, plan, measured, values, noise)
        covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        # The trace of N^-1 A' A, with N = A' A + prior.
        effective = UNKNOWNS - float(np.trace(covariance @ prior))
        if sigma is None:
            square = float(((measured - _image_positions(values, plan)) ** 2).sum())
            freedom = max(measured.size - effective, 0.0)
            noise = float(np.sqrt((paper.freedom * paper.noise**2 + square)
                                  / (paper.freedom + freedom)))
    return _SheetPosterior(values, covariance, noise, effective)


def _start(paper: Paper, plan: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the six values (see `_SheetPosterior`) from which the fit of a sheet begins, (6,).

    Scale and turn are those of a similarity by the points, or the means of the paper if there is
    one point alone; stretch and shear are the means. `plan` and `measured` are as for
    `posterior_of`.
    """
    mean_image = measured.mean(axis=0)
    image = measured - mean_image
    square = float((plan**2).sum())
    if len(plan) < 2 or square == 0.0:
        return np.array([*paper.means, *mean_image])
    # With complex numbers z of the plan and w of the image the similarity is w = c z, where
    # c = sum(conj(z) w) / sum |z|^2.
    real = float((plan * image).sum()) / square
    imaginary = float((plan[:, 0] * image[:, 1] - plan[:, 1] * image[:, 0]).sum()) / square
    scale = max(np.hypot(real, imaginary), 1e-12)
    return np.array([np.log(scale), np.arctan2(imaginary, real), *paper.means[2:], *mean_image])


def _most_probable_values(paper: Paper, plan: FloatArray, measured: FloatArray, values: FloatArray,
                          sigma: float) -> tuple[FloatArray, FloatArray]:
    """Return the six values of the least cost, and the normal matrix there (6, 6).

    The cost is the sum of (measured - image)^2 / sigma^2 over the points, and of (value - mean)^2 /
    spread^2 over the four values of the paper. The search takes Gauss-Newton steps from `values`.
    """
    means = np.array(paper.means)
    spreads = np.array(paper.spreads)
    for _ in range(_STEPS):
        design = _image_derivatives(values, plan).reshape(-1, UNKNOWNS) / sigma
        residuals = (measured - _image_positions(values, plan)).ravel() / sigma
        from_expected = values[:4] - means
        from_expected[TURN] = wrap_angle(from_expected[TURN])
        normal = design.T @ design
        normal[:4, :4] += np.diag(1.0 / spreads**2)
        right = design.T @ residuals
        right[:4] -= from_expected / spreads**2
        step = np.linalg.solve(normal, right)
        # A step changes angles and logarithms by a half at most, so that it does not overshoot.
        step *= min(1.0, 0.5 / max(np.abs(step[:4]).max(), 1e-300))
        values = values + step
        if np.abs(step[:4]).max() < 1e-12:
            break
    return values, normal


def _image_positions(values: FloatArray, plan: FloatArray) -> FloatArray:
    """Return samples and minus lines (n, 2) [px] of x and y from the middle (n, 2)."""
    return np.asarray(plan @ matrix_of(values[:4]).T + values[4:])


def _image_derivatives(values: FloatArray, plan: FloatArray) -> FloatArray:
    """Return the derivatives of samples and minus lines by the six values of a sheet, (n, 2, 6).

    `plan` (n, 2) are x and y from the middle of the points.
    """
    # image = e^scale S(stretch, shear) R(turn) plan + place of the middle, see `matrix_of`.
    scale, turn, stretch, shear = values[:4]
    rotated = np.exp(scale) * plan @ rotation_by(turn).T
    h = np.hypot(1.0, shear)
    along = np.exp(stretch)
    across = np.exp(-stretch)
    # The derivatives by stretch and shear of S = [[h along, shear], [shear, h across]].
    paper_derivatives = (np.array([[h * along, 0.0], [0.0, -h * across]]),
                         np.array([[shear / h * along, 1.0], [1.0, shear / h * across]]))
    matrix = matrix_of(values[:4])
    slopes = np.zeros((len(plan), 2, UNKNOWNS))
    slopes[..., 0] = plan @ matrix.T
    # The derivative of a rotation by its angle is the rotation by a quarter turn more.
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    slopes[..., 1] = plan @ (matrix @ quarter).T
    for i, derivative in enumerate(paper_derivatives):
        slopes[..., 2 + i] = rotated @ derivative.T
    slopes[..., 4:] = np.eye(2)
    return slopes


def _affine_coefficients(values: FloatArray, middle: FloatArray, scaling: Scaling) -> FloatArray:
    """Return the coefficients (6,) of 1, X and Y for the line, then for the sample, all scaled.

    `values` (6,) are those of a sheet about `middle` (2,), the middle x, y of its points.
    """
    # An affine map is known by the images of three points.
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    plan = corners * scaling.ground_scale[:2] + scaling.ground_offset[:2]
    image = scaling.image(_image_positions(values, plan - middle)[:, ::-1] * [-1.0, 1.0])
    return np.concatenate([np.append(image[0, axis], image[1:, axis] - image[0, axis])
                           for axis in range(2)])


@dataclass(frozen=True, eq=False)
class SheetOfSeries(Method):
    """A sheet whose series shows what its paper is like."""

    def declines(self, control: FitData) -> str | None:
        """Return why the sheet cannot borrow from a series; None if it can.

        Raises Undetermined if the points differ in what their series shows, or if that cannot be
        read.
        """
        features = control.features
        if COLUMN not in features.points.attributes:
            return "no series of sheets is stated"
        if len(features.lines) or not len(features.points):
            return "a sheet of a series takes points alone"
        return reason_against(paper_of_text(stated_paper(features))) or None

    def fit(self, control: FitData) -> Fit:
        """Return the fit of the sheet to all points.

        Raises Undetermined if they differ in what their series shows, or if that cannot be read.
        """
        text = stated_paper(control.features)
        model = SeriesSheet(paper=text).prepared(control.scaling, control.features.crs)
        assert model.paper.sheets > 0
        return self.estimator.fit(model, control.features, control.scaling,
                                  np.ones(UNKNOWNS, dtype=bool),
                                  np.ones(len(control), dtype=bool))

    def model(self, heights: bool) -> SensorModel | None:
        """Return None: the model depends on the series."""
        return None

    def size(self, heights: bool) -> float:
        """Return 0: what is known comes before what is fitted."""
        return 0.0

    def describe(self, fitted: Fit) -> str:
        """Return sentences on what the other sheets lend, how sure it is, and what points add."""
        assert isinstance(fitted.model, SeriesSheet)
        paper = fitted.model.paper
        spreads = paper.spreads
        determined = min(fitted.effective, float(UNKNOWNS))
        return (f"{paper.sheets} other sheets of the series lend it their scale, to "
                f"{100 * spreads[0]:.2g} %, their turn, to {np.degrees(spreads[1]):.2g} deg, their "
                f"stretch and shear, to {100 * spreads[2]:.2g} and {100 * spreads[3]:.2g} %, and "
                f"their noise of {paper.noise:.2g} px. The points of this sheet determine "
                f"{determined:.1f} of its {UNKNOWNS} numbers.")


def stated_paper(features: FeatureSet) -> str:
    """Return the value of the column `COLUMN`; raises Undetermined if points differ in it."""
    values = {str(value) for value in features.points.attributes[COLUMN]}
    if len(values) != 1:
        raise Undetermined(f"the column {COLUMN} has {len(values)} values, and a sheet one series",
                           hint="Read the points of each sheet by themselves.")
    return values.pop()


def with_paper(features: FeatureSet, paper: Paper) -> FeatureSet:
    """Return features with a column that says what the series shows."""
    points = features.points
    columns: Mapping[str, Any] = {**points.attributes, COLUMN: np.array(
        [text_of(paper)] * len(points), dtype=object)}
    return replace(features, points=replace(points, attributes=columns))


SHEET_OF_SERIES = SheetOfSeries("series-sheet", "a sheet like others of its series",
                                short="sheet of a series", estimator=BySeries(), has_prior=True,
                                from_one=True)
