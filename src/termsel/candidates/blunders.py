"""Blunders among control points, found by what the other points predict for each.

A point is a blunder where the shrunken polynomial of the others (see
`termsel.candidates.shrunken`) predicts it worse than chance allows. Under one solution on the
grid the squared error of a prediction, over its variance, is F distributed, with the noise as the
other points leave it. Its tail is averaged over the grid with the probabilities that the other
points give. Blunders hide each other, so the points that fit worst are first set aside, a third
of all, and each is admitted again once the points in use predict it.

A prediction far from the other points rests on the form of the model, and a blunder there looks
like a bend of the image. Such a point stays in use, and is named as undecided, unless its error
is large even against the variance that its place gives.

References
----------
Baarda 1968 for data snooping; Atkinson, Riani and Cerioli 2004, Exploring Multivariate Data with
the Forward Search, for setting points aside and admitting them again; Croux and Haesbroeck 1999
for the scale of the closest points. The predictive test and the allowance for places far from
others are termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, fdtri
from scipy.stats import chi2

from termsel.adjustment.equations import weights_of
from termsel.adjustment.field import collocate
from termsel.adjustment.monomials import monomials
from termsel.adjustment.posterior import Prediction, posterior, scales_of
from termsel.candidates.local import LIKELY
from termsel.candidates.portfolio import FIELD, Judged, choose
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.measurements.scaling import scaling_of
from termsel.models.polynomial import Polynomial2D, Polynomial3D

LEVEL = 1e-3
"""Chance of naming any point where there is no blunder, under normal errors."""

STRAIN = 4.0
"""Standard deviations of a prediction that an error must exceed: real errors are not normal, and no
model is exact."""

ALLOWANCE = 1.5
"""Standard deviations it must exceed for each standard deviation of the noise that the prediction
has, on account of the form of the model."""

MOST = 1 / 3
"""Largest share of blunders."""

STEP = 0.34
"""Share of the points still to be set aside that one step takes."""

ROUNDING = 1e-6
"""Errors that are none [px]."""

CLEAR = 1.5
"""Errors by the largest one of points in use, beyond which a point is a blunder under a model that
is no polynomial."""

UNUSED = 1e-3
"""Weight at which a point has no influence and is predicted all the same."""


@dataclass(frozen=True, eq=False)
class Suspects:
    """Points against the predictions of the others.

    Parameters
    ----------
    blunders : ndarray of bool, shape (n,)
    undecided : ndarray of bool, shape (n,)
        Points with such an error that the others do not determine the model at their place.
    errors : ndarray, shape (n,)
        Largest error in line or sample, predicted by the points in use [px].
    limits : ndarray, shape (n,)
        Error that would be named at each point [px].
    """

    blunders: BoolArray
    undecided: BoolArray
    errors: FloatArray
    limits: FloatArray


@dataclass(frozen=True, eq=False)
class _Test:
    """What points in use predict for all points.

    `chance`, `strain` and `spread`, shape (n,), are the chance of an error as large, the error in
    standard deviations, and the standard deviation of the prediction by that of the noise, which
    is `noise` [px] with `freedom` degrees of freedom. `squares` are those of the errors of points
    in use; `local` is true where a random field predicts.
    """

    errors: FloatArray
    chance: FloatArray
    strain: FloatArray
    spread: FloatArray
    noise: float
    freedom: int
    squares: FloatArray
    local: bool = False

    def far(self, n: int) -> BoolArray:
        """Return the points whose error is beyond chance."""
        return (self.chance < LEVEL / n) & (self.strain > STRAIN) & (self.errors > ROUNDING)

    def decided(self) -> BoolArray:
        """Return the points whose error exceeds what their place allows."""
        return self.strain > ALLOWANCE * self.spread

    def suspects(self, blunders: BoolArray, undecided: BoolArray, which: BoolArray) -> Suspects:
        """Return what is found of some of the points."""
        least = np.sqrt(fdtri(2, self.freedom, 1 - LEVEL / which.sum()))
        strain = np.maximum(max(STRAIN, float(least)), ALLOWANCE * self.spread)
        return Suspects(blunders[which], undecided[which], self.errors[which],
                        np.maximum(strain * self.spread * self.noise, ROUNDING)[which])


def find_blunders(control: FeatureSet, heights: bool) -> Suspects | None:
    """Return which control points are blunders.

    What the shrunken polynomial suspects is left out of the choice among all candidates. Points
    that the chosen one predicts within STRAIN are no blunders: their errors were the polynomial's.

    Parameters
    ----------
    control : FeatureSet
    heights : bool
        Whether heights are known and differ.

    Returns
    -------
    Suspects or None
        None where the points are too few for a test, and with lines.
    """
    points, n = control.points, len(control.points)
    everything = np.ones(n, dtype=bool)
    whole = None if len(control.lines) else _test(points, everything, heights)
    if whole is None:
        return None
    used, test = _settled(points, *_forward(points, _core(points, whole, heights), whole, heights),
                          heights)
    while not (used.all() or test.local) and (
            choice := choose(FeatureSet(points.take(used)), heights)):
        more = used | _predicted_by(choice.chosen, points)
        if (more == used).all():
            break
        used = more
    return test.suspects(~used, used & test.far(n) & ~test.decided(), everything)


def _predicted_by(chosen: Judged, points: Points) -> BoolArray:
    """Return the points that a candidate predicts as it predicts those it was fitted to."""
    # The median of the sum of two squared normal variables is 2 ln 2.
    bound = STRAIN * np.sqrt(np.median(chosen.squares) / (2 * np.log(2)))
    if chosen.name != FIELD and chosen.candidate.kind != "shrunken":
        # The test was of another model than the chosen one.
        bound = max(bound, CLEAR * np.sqrt(chosen.squares.max()))
    return np.asarray(np.abs(chosen.fit.errors(points)).max(axis=1) <= bound)


def judge_others(chosen: Judged, heights: bool, others: Points) -> Suspects | None:
    """Return which points that took no part contradict all control points.

    Parameters
    ----------
    chosen : Judged
        The choice for control points without blunders.
    heights : bool
    others : Points

    Returns
    -------
    Suspects or None
        For the other points; None as for `find_blunders`.
    """
    points = chosen.fit.control.points
    if len(chosen.fit.control.lines) or not len(others):
        return None
    every = Points(points.ids + others.ids, np.concatenate([points.image, others.image]),
                   np.concatenate([points.ground, others.ground]))
    used = np.arange(len(every)) < len(points)
    test = _local_test(every, used, heights) or _test(every, used, heights)
    if test is None:
        return None
    far = test.far(len(others)) & ~_predicted_by(chosen, every)
    decided = test.decided()
    return test.suspects(far & decided, far & ~decided, ~used)


def _core(points: Points, whole: _Test, heights: bool) -> BoolArray:
    """Return the points that remain where those that fit worst are set aside, step by step."""
    used, test = np.ones(len(points), dtype=bool), whole
    core = len(points) - int(MOST * len(points))
    while used.sum() > core:
        count = max(1, int(STEP * (used.sum() - core)))
        worst = np.argsort(-np.where(used, test.strain, -1.0), kind="stable")[:count]
        fewer = used.copy()
        fewer[worst] = False
        nearer = _test(points, fewer, heights)
        if nearer is None:
            break
        used, test = fewer, nearer
    return used


def _forward(points: Points, used: BoolArray, whole: _Test,
             heights: bool) -> tuple[BoolArray, _Test]:
    """Admit points again that those in use predict; leave out those they no longer do."""
    n, seen = len(points), set[bytes]()
    test = _test(points, used, heights) or whole
    while used.tobytes() not in seen:
        seen.add(used.tobytes())
        out = ~used & test.far(n) & test.decided()
        if not used.all():
            # The closest points understate the noise.
            strain = test.strain * np.sqrt(_consistency(used.sum() / n))
            chance = fdtrc(2, max(2 * int(used.sum()) - 8, 2), strain**2)
            out &= (chance < LEVEL / n) & (strain > STRAIN)
        back = np.flatnonzero(~used & ~out)
        now = used.copy()
        if back.size:
            likeliest = back[np.argsort(test.strain[back], kind="stable")]
            now[likeliest[:max(1, back.size // 2)]] = True
        else:
            bad = np.flatnonzero(used & test.far(n) & test.decided())
            if bad.size and (~used).sum() < int(MOST * n):
                now[bad[np.argmax(test.strain[bad])]] = False
        nearer = _test(points, now, heights)
        if nearer is None:
            break
        used, test = now, nearer
    return used, test


def _settled(points: Points, used: BoolArray, test: _Test,
             heights: bool) -> tuple[BoolArray, _Test]:
    """Judge again by a random field, where the points in use call for one.

    Local deformation is no blunder, and what is small next to the error of a polynomial may be
    one.
    """
    n, seen = len(points), set[bytes]()
    while used.tobytes() not in seen and (~used).sum() <= MOST * n:
        seen.add(used.tobytes())
        nearer = _local_test(points, used, heights)
        if nearer is None:
            break
        test = nearer
        far = test.far(n) & test.decided()
        out = used & far & (test.strain >= np.max(test.strain, where=used & far, initial=0.0) / 2)
        used = (used & ~out) | (~used & ~far)
    return used, test


def _local_test(points: Points, used: BoolArray, heights: bool) -> _Test | None:
    """Return what the points in use predict by a random field; None if they call for none."""
    control = points.take(used)
    scaling = scaling_of(FeatureSet(control))
    found = collocate(scaling.points(control), 3 if heights else 2)
    if found is None or found.probability <= LIKELY:
        return None
    scaled = scaling.points(points)
    variance, unit = found.spread(scaled.ground)
    noise = unit / weights_of(points) ** 2
    errors = scaled.image - found.predict(scaled.ground)
    statistic = (errors**2 / (variance + noise)).sum(axis=1) / 2
    freedom = found.parts[0].found.freedom
    rows = np.stack([*np.abs(errors.T), fdtrc(2, freedom, statistic), np.sqrt(statistic),
                     np.sqrt((1 + variance / noise).max(axis=1))], axis=1)
    # Of points in use that holds, whatever their own errors, without them.
    rows[used] = [_row(found.without(i)) for i in range(len(control))]
    rows[used, :2] /= weights_of(control)
    pixels = rows[:, :2] * scaling.image_scale
    return _Test(np.abs(pixels).max(axis=1), rows[:, 2], rows[:, 3], rows[:, 4],
                 float(np.sqrt(unit[0])) * scaling.image_scale, freedom,
                 (pixels[used] ** 2).sum(axis=1), local=True)


def _test(points: Points, used: BoolArray, heights: bool) -> _Test | None:
    """Return what the points in use predict, by the shrunken quadratic or, if better, cubic."""
    quadratic, cubic = (_test_of_degree(points, used, heights, degree) for degree in (2, 3))
    if quadratic is None or cubic is None:
        return cubic or quadratic
    tiny = np.finfo(float).tiny
    gain = np.log(np.maximum(quadratic.squares, tiny) / np.maximum(cubic.squares, tiny))
    error = max(gain.std(ddof=1) / np.sqrt(len(gain)), tiny)
    return cubic if gain.mean() > error else quadratic


def _test_of_degree(points: Points, used: BoolArray, heights: bool, degree: int) -> _Test | None:
    scaling = scaling_of(FeatureSet(points.take(used)))
    scaled = scaling.points(points)
    exponents = (Polynomial3D if heights else Polynomial2D)(degree=degree).exponents
    order = np.array(exponents).sum(axis=1)
    weights = weights_of(points) * np.where(used, 1.0, UNUSED)[:, None]
    found = posterior(monomials(scaled.ground, exponents), scaled.image, order, weights,
                      scales_of(np.array(exponents)[order > 1]), int(used.sum()))
    if found is None:
        return None
    rows = np.array([_row(found.without(i) if used[i] else found.beyond(i, UNUSED))
                     for i in range(len(points))])
    pixels = rows[:, :2] / weights_of(points) * scaling.image_scale
    noise = float(np.sqrt(found.cells.share @ found.square / found.freedom)) * scaling.image_scale
    return _Test(np.abs(pixels).max(axis=1), rows[:, 2], rows[:, 3], rows[:, 4], noise,
                 found.freedom, (pixels[used] ** 2).sum(axis=1))


def _row(one: Prediction) -> tuple[float, float, float, float, float]:
    """Return the error of a point in line and sample, its chance, strain and spread."""
    statistic = (one.errors[0] ** 2 / one.spread[0]
                 + one.errors[1] ** 2 / one.spread[1]) / 2 / one.variance
    return (*one.error, float(one.share @ fdtrc(2, one.freedom, statistic)),
            float(np.sqrt(one.share @ statistic)),
            float(np.sqrt(max(one.share @ spread for spread in one.spread))))


def _consistency(share: float) -> float:
    """Return the mean square of the closest share of normal errors in two coordinates, by that of
    all."""
    if share >= 1:
        return 1.0
    bound = chi2.ppf(share, 2)
    return float(chi2.cdf(bound, 4) / share)
