"""Polynomials whose terms beyond the affine ones are shrunk, averaged over how much.

The prior: with all coordinates scaled to [-1, 1], the coefficient of X^a Y^b Z^c, a + b + c >= 2,
is normal with the mean 0 and the standard deviation

    size * fall^(a + b + c - 2) * relief^c * own

in units of the noise: the coefficients of a Taylor series of a smooth function fall from order
to order by one rate, and by a further one with each power of Z, as the relief is shallow next to
the scene. Affine terms are free. How large `size` is for line and for sample, and what `fall`
and `relief` are for both, is not known: the least-squares solutions for all values on a wide
grid are averaged with their posterior probabilities, and nothing is set. `own` is a factor for
each term, log-normal, drawn many times, so that single terms may stand out from the rule.
Noise is taken to be the same in line and sample; its variance is integrated out.

Every solution on the grid is linear in the measurements. Leaving a point out changes it, and
its probability, in closed form, so that the leave-one-out errors are those of the whole
procedure repeated without each point.

References
----------
Hoerl and Kennard 1970 for ridge regression; Lindley and Smith 1972, J. R. Stat. Soc. B 34(1), for
its prior; Gelman 2006, Bayesian Analysis 1(3), for that of its size; Hoeting et al. 1999,
Statistical Science 14(4), for averaging. The prior's form is termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.solve import TOLERANCE, Adjustment
from termsel.candidates.selected import points_alone, weights_of
from termsel.fits.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fits.fittable import Fittable
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.measurements.scaling import Scaling
from termsel.models.monomials import Exponents, monomials
from termsel.models.polynomial import Polynomial

SIZES = 10.0 ** np.arange(-0.5, 5.5, 0.5)
"""Standard deviations of quadratic coefficients by that of the noise. From where they cannot be
told from 0 to where they are as good as free."""

TYPICAL = 10.0
"""Size beyond which larger ones are ever less likely, in proportion: the tail of a half-Cauchy
prior. Where few points leave hardly any redundancy, the data do not exclude that there is no noise
and all sizes are huge; this does."""

FALLS = (0.01, 0.03, 0.1, 0.3)
"""Cubic coefficients by quadratic ones."""

RELIEFS = (0.03, 0.1, 0.3, 1.0)
"""Coefficients of one power of Z more, by those without."""

DRAWS, SPREAD = 64, 1.0
"""How often factors of single terms are drawn, apart from 1 for all, divided among all pairs of a
fall and a relief; and their standard deviation in natural logarithms."""

NO_NOISE = 1e-11
"""Noise that counts as none, as a part of the image's half-range."""

NEVER = 40.0
"""Solutions less likely than the likeliest by this, in natural logarithms, are left out."""

TINY = 1e-14
"""What is left of 1 by rounding error."""


@dataclass(frozen=True, eq=False)
class Average:
    """An averaged polynomial.

    Parameters
    ----------
    coefficients : ndarray, shape (k, 2)
        Of line and sample.
    errors : ndarray, shape (n, 2)
        Measured minus predicted by the same procedure without that point.
    effective : float
        Effective parameters of line and sample together: the trace of the matrix that turns
        measurements into their fitted values.
    """

    coefficients: FloatArray
    errors: FloatArray
    effective: float


@dataclass(frozen=True, eq=False)
class _Side:
    """All solutions of one axis, groups of scales by sizes.

    `evidence` and `square`, shape (g s,), make up prior and marginal likelihood, square^-nu/2
    exp(evidence); `left` is 1 minus the leverage of each point, `errors` are what the fit leaves,
    shape (g s, n); `coefficients` are the shrunken ones, shape (g s, j).
    """

    evidence: FloatArray
    square: FloatArray
    left: FloatArray
    errors: FloatArray
    coefficients: FloatArray


class Averaging(Estimator):
    """The average of a polynomial's shrunken solutions, from control points alone."""

    def fit(self, model: Fittable, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a polynomial (see `Estimator.fit`) with all its terms."""
        assert isinstance(model, Polynomial)
        points = scaling.points(points_alone(control, used, "a shrunken polynomial"))
        found = average(points.ground, points.image, model.exponents,
                        None if points.sigma is None else weights_of(points))
        if found is None:
            raise Undetermined(
                f"{len(points)} control points do not determine an affine model twice over",
                hint="Measure more control, spread over the area.")
        coefficients = found.coefficients.T.ravel()
        equations = model.equations(scaling.features(control))
        k = len(coefficients)
        residuals = equations.b - equations.A @ coefficients
        in_use = residuals[used[equations.feature]]
        freedom = len(in_use) - found.effective
        sigma0 = float(np.sqrt(in_use @ in_use / freedom)) if freedom > 0.5 else np.nan
        adjustment = Adjustment(coefficients, residuals, np.full(k, np.nan),
                                round(found.effective), len(in_use), round(found.effective),
                                float("nan"), sigma0)
        held_out = HeldOut(found.errors * scaling.image_scale,
                           (found.errors**2).sum(axis=1) * scaling.image_scale**2)
        return Fit(model, scaling, control, np.ones(k, dtype=bool), used, adjustment, self,
                   found.effective, held_out)


def average(ground: FloatArray, image: FloatArray, exponents: Exponents,
            weights: FloatArray | None = None) -> Average | None:
    """Fit an averaged polynomial.

    Parameters
    ----------
    ground : ndarray, shape (n, 3)
        Scaled to [-1, 1].
    image : ndarray, shape (n, 2)
    exponents : k exponents of X, Y, Z
        Affine ones first.
    weights : ndarray, shape (n, 2), optional
        By which equations are multiplied: reciprocals of standard deviations, up to a factor.

    Returns
    -------
    Average or None
        None if the affine terms are not determined twice over by all points but any one.
    """
    order = np.array(exponents).sum(axis=1)
    columns = monomials(ground, exponents)
    scales = _scales(np.array(exponents)[order > 1])
    freedom = 2 * (len(ground) - int((order < 2).sum()))
    noise = 2 * len(ground) * (NO_NOISE * float(np.ptp(image, axis=0).max()) / 2) ** 2
    if weights is None:
        weights = np.ones_like(image)
        designs = [_design(columns, order < 2, scales)] * 2
    else:
        designs = [_design(columns * w[:, None], order < 2, scales) for w in weights.T]
    sides = [_solutions(design, image[:, axis] * weights[:, axis], scales)
             for axis, design in enumerate(designs) if design is not None]
    if len(sides) < 2 or freedom < 4:
        return None
    cells = _cells(sides, freedom, noise)
    coefficients = np.empty((len(exponents), 2))
    effective = 0.0
    for axis, (side, which) in enumerate(zip(sides, cells.which, strict=True)):
        shrunk = cells.share @ side.coefficients[which]
        affine = columns[:, order < 2] * weights[:, axis, None]
        rest = weights[:, axis] * (image[:, axis] - columns[:, order > 1] @ shrunk)
        coefficients[order > 1, axis] = shrunk
        coefficients[order < 2, axis] = np.linalg.lstsq(affine, rest)[0]
        effective += float(cells.share @ (1.0 - side.left[which]).sum(axis=1))
    errors = _left_out(sides, cells, freedom, noise) / weights
    return Average(coefficients, errors, effective)


def _scales(exponents: FloatArray) -> FloatArray:
    """Return standard deviations of the shrunken coefficients for size 1, shape (g, k)."""
    order, height = exponents.sum(axis=1), exponents[:, 2]
    reliefs, falls = RELIEFS if height.any() else (1.0,), FALLS if order.max() > 2 else (1.0,)
    rule = np.array([fall ** (order - 2.0) * relief ** height
                     for fall in falls for relief in reliefs])
    rng = np.random.default_rng(0)
    own = np.exp(SPREAD * rng.standard_normal((DRAWS // len(rule), *rule.shape)))
    return np.concatenate([rule, (rule * own).reshape(-1, rule.shape[1])])


@dataclass(frozen=True, eq=False)
class _Design:
    """Decompositions of the shrunken columns without the free ones, one for each group.

    Parameters
    ----------
    basis : ndarray, shape (n, m)
        What some column, and no affine function, explains.
    explained : ndarray, shape (n, l)
        What the columns explain, affine ones with them; the rest is left by every solution.
    u : ndarray, shape (g, m, m)
    values : ndarray, shape (g, m)
    vt : ndarray, shape (g, m, k)
    """

    basis: FloatArray
    explained: FloatArray
    u: FloatArray
    values: FloatArray
    vt: FloatArray


def _design(columns: FloatArray, free: BoolArray, scales: FloatArray) -> _Design | None:
    """Return the decompositions; None if the free columns lack a point's redundancy."""
    lead = columns[:, free]
    count = lead.shape[1]
    if len(lead) <= count:
        return None
    q, r = np.linalg.qr(np.concatenate([lead, columns[:, ~free]], axis=1))
    if (np.abs(np.diag(r))[:count] <= TOLERANCE * np.linalg.norm(lead, axis=0)).any() \
            or (1.0 - (q[:, :count]**2).sum(axis=1)).min() < TOLERANCE:
        return None
    rest = r[count:, count:]
    return _Design(q[:, count:], q, *np.linalg.svd(rest * scales[:, None, :],
                                                   full_matrices=False))


def _solutions(design: _Design, target: FloatArray, scales: FloatArray) -> _Side:
    """Return the solutions of one axis for all scales and sizes."""
    along = (design.basis.T @ target) @ design.u
    u = design.basis @ design.u
    n, k = len(target), scales.shape[1]
    # What no column reaches is kept apart, so that nothing cancels where noise tends to 0.
    beyond, room = np.zeros(n), np.zeros(n)
    if design.explained.shape[1] < n:
        beyond = target - design.explained @ (design.explained.T @ target)
        room = np.maximum(1.0 - (design.explained**2).sum(axis=1), 0.0)
    ratio = SIZES[:, None] * design.values[:, None, :]                        # (g, s, m)
    keep = 1.0 / (1.0 + ratio**2)
    part = keep * along[:, None, :]
    return _Side(
        (0.5 * np.log(keep).sum(axis=2) - 0.5 * np.log1p((SIZES / TYPICAL) ** 2)).ravel(),
        (beyond @ beyond + (part * along[:, None, :]).sum(axis=2)).ravel(),
        np.maximum(room + keep @ (u**2).transpose(0, 2, 1), TINY).reshape(-1, n),
        (beyond + part @ u.transpose(0, 2, 1)).reshape(-1, n),
        (scales[:, None, :] * ((SIZES[:, None] * ratio * part) @ design.vt)).reshape(-1, k))


@dataclass(frozen=True, eq=False)
class _Cells:
    """The points of the grid that matter: which solutions of line and of sample, and how likely."""

    which: tuple[IntArray, IntArray]
    share: FloatArray


def _cells(sides: list[_Side], freedom: int, noise: float) -> _Cells:
    """Return what is on the grid of group, size of line and size of sample, and not NEVER."""
    line, sample = (np.arange(len(side.square)).reshape(-1, len(SIZES)) for side in sides)
    shape = (*line.shape, len(SIZES))
    first = np.broadcast_to(line[:, :, None], shape).ravel()
    second = np.broadcast_to(sample[:, None, :], shape).ravel()
    logarithm = (sides[0].evidence[first] + sides[1].evidence[second] - freedom / 2 * np.log(
        sides[0].square[first] + sides[1].square[second] + noise))
    kept = logarithm > logarithm.max() - NEVER
    return _Cells((first[kept], second[kept]), _shares(logarithm[kept]))


def _shares(logarithm: FloatArray) -> FloatArray:
    """Return probabilities, adding up to 1 along the first axis."""
    share = np.exp(logarithm - logarithm.max(axis=0))
    return np.asarray(share / share.sum(axis=0))


def _left_out(sides: list[_Side], cells: _Cells, freedom: int, noise: float) -> FloatArray:
    """Return the averages' errors at each point, errors and probabilities without it, (n, 2)."""
    pairs = list(zip(sides, cells.which, strict=True))
    square = sides[0].square[cells.which[0]] + sides[1].square[cells.which[1]] + noise
    evidence = sides[0].evidence[cells.which[0]] + sides[1].evidence[cells.which[1]]
    found = np.empty((sides[0].left.shape[1], 2))
    for i in range(len(found)):
        left = [side.left[which, i] for side, which in pairs]
        errors = [side.errors[which, i] for side, which in pairs]
        # The determinant loses the factor `left`, the sum of squares errors^2 / left.
        rest = square - errors[0] ** 2 / left[0] - errors[1] ** 2 / left[1]
        share = _shares(evidence - 0.5 * np.log(left[0] * left[1]) - (freedom - 2) / 2 * np.log(
            np.maximum(rest, noise + TINY * square)))
        found[i] = [share @ (errors[axis] / left[axis]) for axis in (0, 1)]
    return found
