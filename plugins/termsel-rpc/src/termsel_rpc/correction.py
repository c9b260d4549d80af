"""A vendor's RPC, corrected by one point or more, as candidates of the strategy auto."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from termsel import (
    Adjustment,
    Estimator,
    FeatureSet,
    Fit,
    FitData,
    HeldOut,
    Method,
    Rpc,
    Scaling,
    SensorModel,
    Spread,
    Suspects,
    TermselError,
    Undetermined,
    line_normals,
    row_weights,
)
from termsel_rpc.belief import CORRECTION_KINDS, USUAL_PX, Belief, correction_grid
from termsel_rpc.image_space import RpcAffine
from termsel_rpc.refinement import FloatArray

BoolArray = np.ndarray[tuple[int], np.dtype[np.bool_]]

MAX_TESTED_HERE = 17
"""Number of features from which on blunders are left to the test by regularised polynomials."""

MAX_BLUNDER_SHARE = 1 / 3
"""Largest share of blunders."""

SURE = 0.99
"""Probability of a blunder beyond which a feature is left out as one for certain."""

LIKELY = 0.75
"""Probability beyond which it is left out as a probable one: odds of three to one."""

NEAREST = 1.0
"""Least error of a blunder [px]."""

LOOKED_AT = 3
"""Likeliest blunders, with each of which pairs are made."""


@dataclass(frozen=True)
class Correction(Estimator):
    """The average of all corrections of an RPC, of some kinds, that the features leave possible.

    Parameters
    ----------
    kinds : tuple of int
        Numbers in `CORRECTION_KINDS`.
    """

    name = "rpc-correction"
    kinds: tuple[int, ...] = tuple(range(len(CORRECTION_KINDS)))

    @property
    def options(self) -> dict[str, Any]:
        """No options: the candidate tries all kinds itself."""
        return {}

    def fit(self, model: Any, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit the correction (see `Estimator.fit`) with all its terms, by features in use."""
        ready = model.prepared(scaling, control.crs)
        in_use = control.take(used)
        believed, unit = belief_about_rpc(ready, in_use, scaling, self.kinds)
        coefficients = to_terms(ready, scaling) @ believed.coefficients
        # Rows were weighed; errors of held-out features are in px again.
        held_out = HeldOut.of(
            _rows_as_vectors(believed.without_each[0] / unit, scaling.features(in_use)), in_use)
        solution = RefinementSolution(coefficients, believed.effective, len(believed.right),
                                      float(np.sqrt(believed.noise)) / scaling.image_scale,
                                      held_out)
        return fit_of(ready, scaling, control, used, self, solution)

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors at scaled places (see `Estimator.spread`)."""
        model = fitted.model
        scale = fitted.scaling.image_scale
        assert isinstance(model, RpcAffine)
        believed, _ = belief_about_rpc(
            model, fitted.control.take(fitted.used), fitted.scaling, self.kinds)
        # C = F F^T by its eigenvectors; rounding may leave eigenvalues just below zero.
        values, vectors = np.linalg.eigh(believed.covariance)
        root = to_terms(model, fitted.scaling) @ vectors * np.sqrt(np.maximum(values, 0.0))
        factors = model.known(ground)[1] @ root
        return Spread((factors**2).sum(axis=2), np.full(2, believed.noise / scale**2), factors)


@dataclass(frozen=True, eq=False)
class RefinementSolution:
    """What a procedure found for a refinement of an RPC.

    Parameters
    ----------
    coefficients : ndarray, shape (k,)
        Of the model's terms.
    effective : float
        Effective parameters of both axes.
    n_equations : int
    sigma0 : float
        Standard deviation of a measurement, scaled; nan where it is not one for all.
    held_out : HeldOut
        Errors of features under the procedure without them.
    """

    coefficients: FloatArray
    effective: float
    n_equations: int
    sigma0: float
    held_out: HeldOut


def fit_of(model: Any, scaling: Scaling, control: FeatureSet, used: BoolArray,
           estimator: Estimator, solution: RefinementSolution) -> Fit:
    """Return a solution as a fit to the features in use, `used` (n,).

    Its terms have no standard deviations of their own.
    """
    count = len(solution.coefficients)
    effective = round(solution.effective)
    adjustment = Adjustment(
        solution.coefficients, np.full(count, np.nan), n_terms=effective,
        n_equations=solution.n_equations, rank=effective, condition=float("nan"),
        sigma0=solution.sigma0)
    return Fit(model, scaling, control, np.ones(count, dtype=bool), used, adjustment, estimator,
               solution.effective, solution.held_out)


def to_terms(model: RpcAffine, scaling: Scaling) -> FloatArray:
    """Return the matrix from coefficients of `Belief` [px] to terms of the model, shape (6, 6)."""
    rpc = model.rpc
    half = np.abs(rpc.image_scale)
    middle = (np.array(scaling.image_offset) - rpc.image_offset) / half
    # Unit of a position: half images of the RPC there, scaled coordinates here.
    of_axis = np.array([[1 / scaling.image_scale, *middle / scaling.image_scale],
                        [0.0, 1 / half[0], 0.0], [0.0, 0.0, 1 / half[1]]])
    return np.kron(np.eye(2), of_axis)


def belief_about_rpc(model: RpcAffine, features: FeatureSet, scaling: Scaling,
                     kinds: tuple[int, ...]) -> tuple[Belief, FloatArray]:
    """Return what features show of a prepared model's RPC errors, and the weights of the rows (m,).
    """
    scaled = scaling.features(features)
    equations = model.equations(scaled)
    sigma = features.points.sigma
    rows = equations.A @ to_terms(model, scaling) * scaling.image_scale
    usual = USUAL_PX if sigma is None else float(np.median(sigma))
    return Belief(rows, equations.b * scaling.image_scale, equations.feature,
                  correction_grid(kinds, usual)), row_weights(scaled)


def _rows_as_vectors(errors: FloatArray, scaled: FeatureSet) -> FloatArray:
    """Return errors of rows [px] as vectors of points, then of vertices of lines, shape (m, 2)."""
    # Normals of lines: errors of lines have no direction along them.
    count = 2 * len(scaled.points)
    normals = np.repeat(line_normals(scaled.lines)[0], 2, axis=0)
    return np.concatenate([errors[:count].reshape(-1, 2), errors[count:, None] * normals])


@lru_cache(maxsize=8)  # a fit asks with each of its steps
def _prepared_model(rpc: Rpc) -> RpcAffine:
    """Return a model with the RPC, which it takes as JSON."""
    return RpcAffine(rpc=json.dumps(asdict(rpc)))


@dataclass(frozen=True, eq=False)
class CorrectedRpc(Method):
    """The RPC that features have, corrected as far as they show: as delivered, by a shift, ..."""

    def declines(self, control: FitData) -> str | None:
        """Return why the RPC is not one of this image, or cannot be corrected; None if it can.

        An RPC of another image puts the control half an image away, where a correction moves it by
        hundreds of px at most. Heights in a wrong unit look alike, so that they are told apart.
        """
        rpc = control.features.rpc
        if rpc is None:
            return ("no RPC is given. Give it with --rpc FILE, or --image FILE of an image that "
                    "has one")
        missing = control.features.without_height()
        if missing:
            return (f"it needs ellipsoidal heights, and {missing[0]} has none (--dem FILE takes "
                    "them from a raster)")
        try:
            model = _prepared_model(rpc).prepared(control.scaling, control.features.crs)
        except TermselError as error:
            return error.what
        features = control.features
        # A correction moves an image by some px to hundreds; half an image is another image.
        geographic = model.geographic(control.scaling.ground(features.ground_vertices()))
        away = np.linalg.norm(rpc.project(geographic) - features.image_vertices(), axis=1)
        half = float(np.linalg.norm(rpc.image_scale))
        if not np.median(away) < half:
            statement = (f"{model.source} sees the control {np.median(away):,.0f} px from where it "
                         "was measured")
            if outside := rpc.heights_outside(geographic[:, 2]):
                return f"{statement}, as {outside}: check their unit and sign"
            return (f"{statement}, more than half of its image ({half:,.0f} px). It is of another "
                    "image, or line and sample are swapped")
        return None

    def fit(self, control: FitData) -> Fit:
        """Return the fit of the correction; raises Undetermined without an RPC."""
        rpc = control.features.rpc
        if rpc is None:
            raise Undetermined("no RPC is given", hint="Give it with --rpc FILE.")
        model = _prepared_model(rpc)
        return self.estimator.fit(
            model, control.features, control.scaling, np.ones(len(model.terms), dtype=bool),
            np.ones(len(control), dtype=bool))

    def size(self, heights: bool) -> float:
        """Return 0: what is known comes before what is fitted."""
        return 0.0

    def model(self, heights: bool) -> SensorModel | None:
        """Return None: the model depends on the RPC."""
        return None

    def describe(self, fitted: Fit) -> str:
        """Return sentences on the correction: its shift, each kind's probability, its uncertainty.

        The shift is that in the middle of the RPC's image. Kinds of corrections, from none to
        affine, are averaged by their probabilities, and the uncertainty is that at the corners,
        where it is largest.
        """
        assert isinstance(fitted.model, RpcAffine)
        believed, _ = belief_about_rpc(fitted.model, fitted.control.take(fitted.used),
                                       fitted.scaling,
                                       tuple(range(len(CORRECTION_KINDS))))
        rpc = fitted.model.rpc
        chances = [f"{name} {share:.2f}"
                   for name, share in zip(CORRECTION_KINDS, believed.kinds, strict=True)]
        likeliest = int(np.argmax(believed.kinds))
        shift = believed.coefficients[[0, 3]]
        corners = np.array([[1.0, -1, -1], [1.0, -1, 1], [1.0, 1, -1], [1.0, 1, 1]])
        rows = np.einsum("ab,nc->nabc", np.eye(2), corners).reshape(8, 6)
        # The mean variance of both axes together at the four corners, without noise.
        sigma = np.sqrt((believed.variance(rows).sum() - 8 * believed.noise) / 4)
        return (f"The vendor's RPC{f' {rpc.source}' if rpc.source else ''} is corrected by "
                f"{shift[0]:+.2f} px in line and {shift[1]:+.2f} px in sample, in the middle of "
                f"its image. The points support {_WORDS[likeliest]} (probabilities: "
                f"{', '.join(chances)}). At the corners the correction is known to {sigma:.2g} "
                "px.")

    def suspects(self, control: FitData) -> Suspects | None:
        """Return blunders among few features, by what all others and the RPC predict.

        None if the features are many, and are tested as those of any model.
        """
        return None if len(
            control) >= MAX_TESTED_HERE else _probable_blunders(control, _model_of(control))


_WORDS = ("no correction", "a shift", "a drift along the lines", "an affine correction")


def _model_of(control: FitData) -> RpcAffine:
    """Return the model of the features' RPC, prepared for them."""
    rpc = control.features.rpc
    assert rpc is not None
    return _prepared_model(rpc).prepared(control.scaling, control.features.crs)


def _probable_blunders(control: FitData, model: RpcAffine) -> Suspects | None:
    """Return the blunders, by hypotheses: none, each feature, pairs with one of the likeliest.

    A blunder lies anywhere, as likely within 2 to 4 px of its place as within 20 to 40. Beforehand
    one feature of all is believed to be one.
    """
    n = len(control)
    max_blunders = int(MAX_BLUNDER_SHARE * len(control))
    if not max_blunders:
        return None
    full, _ = belief_about_rpc(model, control.features, control.scaling,
                               tuple(range(len(CORRECTION_KINDS))))
    reach = np.log(np.linalg.norm(model.rpc.image_scale) / NEAREST)
    logs: dict[tuple[int, ...], float] = {(): full.log}

    def without(hypothesis: tuple[int, ...]) -> Belief:
        is_kept = ~np.isin(full.feature, hypothesis)
        number = np.cumsum(~np.isin(np.arange(n), hypothesis)) - 1
        return Belief(full.rows[is_kept], full.right[is_kept], number[full.feature[is_kept]],
                      full.grid)

    def away(feature: int, remaining: Belief) -> float:
        rows = full.feature == feature
        return float(np.abs(full.right[rows] - full.rows[rows] @ remaining.coefficients).max())

    def weigh(*hypothesis: int) -> None:
        remaining = without(hypothesis)
        # A blunder is anywhere: its distance is log-uniform, and its direction uniform.
        anywhere = [np.log((n - 1) * 2 * np.pi * reach)
                    + 2 * np.log(max(away(feature, remaining), NEAREST)) for feature in hypothesis]
        logs[hypothesis] = remaining.log - sum(anywhere)

    for feature in range(n):
        weigh(feature)
    likeliest = sorted(range(n), key=lambda feature: -logs[feature,])[:LOOKED_AT]
    for pair in combinations(range(n), 2) if max_blunders > 1 else ():
        if set(pair) & set(likeliest):
            weigh(*pair)
    best = max(logs, key=lambda hypothesis: logs[hypothesis])
    total = np.logaddexp.reduce(list(logs.values()))
    # A feature is a blunder with the probability of all hypotheses that name it.
    chance = np.zeros(n)
    for feature in range(n):
        named = [log for hypothesis, log in logs.items() if feature in hypothesis]
        chance[feature] = np.exp(np.logaddexp.reduce(named) - total)
    by_others = without(best)
    errors = np.array([away(feature, by_others) for feature in range(n)])
    sigma = np.sqrt(np.array([by_others.variance(full.rows[full.feature == feature]).max()
                              for feature in range(n)]))
    blunders = chance > LIKELY
    return Suspects(blunders, blunders & (chance <= SURE), (chance > 0.5) & ~blunders, errors,
                    _least_certain_errors(sigma, n, float(reach)))


def _least_certain_errors(sigma: FloatArray, n: int, reach: float) -> FloatArray:
    """Return the errors (n,) [px] beyond which a feature is surely a blunder.

    `sigma` (n,) [px] is that of the predictions, `n` the number of features, and `reach` the
    logarithm of the farthest over the nearest distance of a blunder.
    """
    # The odds of a blunder against a normal error, solved for the error: a fixed point.
    errors = 4 * sigma
    # Converges as errors enter by their logarithms.
    for _ in range(20):
        errors = sigma * np.sqrt(2 * (np.log(SURE / (1 - SURE) * (n - 1) * reach)
                                      + 2 * np.log(np.maximum(errors, NEAREST) / sigma)))
    return np.asarray(errors)


_ALL = Correction()

CORRECTIONS = (
    CorrectedRpc("rpc", "the vendor's RPC, corrected", short="corrected RPC", estimator=_ALL,
                 has_prior=True, from_one=True, family="corrections of the RPC",
                 contains=("rpc-as-delivered", "rpc-shifted", "rpc-drifted", "rpc-by-affine")),
    CorrectedRpc("rpc-as-delivered", "the vendor's RPC as delivered", short="RPC as delivered",
                 estimator=Correction((0,)), is_plain=True),
    CorrectedRpc("rpc-shifted", "the vendor's RPC, shifted", short="RPC, shift",
                 estimator=Correction((1,)), is_plain=True),
    CorrectedRpc("rpc-drifted", "the vendor's RPC with a drift along the lines",
                 short="RPC, drift", estimator=Correction((2,)), is_plain=True),
    CorrectedRpc("rpc-by-affine", "the vendor's RPC with an affine correction",
                 short="RPC, affine", estimator=Correction((3,)), is_plain=True))
"""Corrections of the RPC that features have."""
