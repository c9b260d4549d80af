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

N_FIT_BY_DRIFT = 2
"""Number of features that a drift fits exactly, so that they show no noise."""

MANY_FEATURES = 17
"""Number of features from which on blunders are left to the test by regularised polynomials."""

MAX_BLUNDER_SHARE = 1 / 3
"""Largest share of blunders."""

SURE = 0.99
"""Probability of a blunder beyond which a feature is left out as one for certain."""

LIKELY = 0.75
"""Probability beyond which it is left out as a probable one: odds of three to one."""

MIN_BLUNDER = 1.0
"""Least error of a blunder [px]."""

N_LIKELIEST = 3
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
        """Fit a correction of the RPC by the features in use (see `Estimator.fit`).

        `used` (n,) marks the features in use; `terms` is not looked at, as the corrections are
        averaged over which terms they have.
        """
        ready = model.prepared(scaling, control.crs)
        in_use = control.take(used)
        believed, weights = belief_about_rpc(ready, in_use, scaling, self.kinds)
        coefficients = to_terms(ready, scaling) @ believed.coefficients
        # Equations are multiplied by the square root of their weights, by which errors are divided
        # to be px.
        held_out = HeldOut.of(
            _rows_as_vectors(believed.without_each[0] / weights, scaling.features(in_use)), in_use)
        solution = RefinementSolution(coefficients, believed.effective, len(believed.right),
                                      float(np.sqrt(believed.noise)) / scaling.image_scale,
                                      held_out)
        return fit_of(ready, scaling, control, used, self, solution)

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of image positions at scaled ground positions (m, 3).

        See `Estimator.spread`.
        """
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
    """The estimates of a refinement of an RPC, and the errors of features that were held out.

    Parameters
    ----------
    coefficients : ndarray, shape (k,)
        Coefficients of the model's terms.
    effective : float
        Number of effective parameters of both axes.
    n_equations : int
    sigma0 : float
        Standard deviation of a measurement, scaled; NaN where it differs between measurements.
    held_out : HeldOut
        Errors of features by the procedure without them.
    """

    coefficients: FloatArray
    effective: float
    n_equations: int
    sigma0: float
    held_out: HeldOut


def fit_of(model: Any, scaling: Scaling, control: FeatureSet, used: BoolArray,
           estimator: Estimator, solution: RefinementSolution) -> Fit:
    """Return a solution as a fit to the features of `control` that are in use, `used` (n,).

    The standard deviations of its terms and the condition are NaN.
    """
    n_coefficients = len(solution.coefficients)
    # An adjustment counts terms in whole numbers; the fit's trace is the effective number itself.
    n_terms = round(solution.effective)
    adjustment = Adjustment(
        solution.coefficients, np.full(n_coefficients, np.nan), n_terms=n_terms,
        n_equations=solution.n_equations, rank=n_terms, condition=float("nan"),
        sigma0=solution.sigma0)
    return Fit(model, scaling, control, terms=np.ones(n_coefficients, dtype=bool), used=used,
               adjustment=adjustment, estimator=estimator, trace=solution.effective,
               stored_held_out=solution.held_out)


def to_terms(model: RpcAffine, scaling: Scaling) -> FloatArray:
    """Return the matrix (6, 6) that turns coefficients of `Belief` [px] into terms of the model."""
    rpc = model.rpc
    half_size = np.abs(rpc.image_scale)
    middle = (np.array(scaling.image_offset) - rpc.image_offset) / half_size
    # Positions count in half images from the middle of the RPC's image in `Belief`, and in scaled
    # coordinates from the middle of the control in the model.
    axis_matrix = np.array([[1 / scaling.image_scale, *middle / scaling.image_scale],
                            [0.0, 1 / half_size[0], 0.0], [0.0, 0.0, 1 / half_size[1]]])
    return np.kron(np.eye(2), axis_matrix)


def belief_about_rpc(model: RpcAffine, features: FeatureSet, scaling: Scaling,
                     kinds: tuple[int, ...]) -> tuple[Belief, FloatArray]:
    """Return what features show of the errors of an RPC, and the weights of their equations (m,).

    The model is prepared; `features` are not scaled. `kinds` are numbers in `CORRECTION_KINDS`.
    """
    scaled = scaling.features(features)
    equations = model.equations(scaled)
    sigma = features.points.sigma
    rows = equations.A @ to_terms(model, scaling) * scaling.image_scale
    usual = USUAL_PX if sigma is None else float(np.median(sigma))
    grid = correction_grid(kinds, usual, scattered=len(features) > N_FIT_BY_DRIFT)
    belief = Belief(rows, equations.b * scaling.image_scale, equations.feature, grid)
    return belief, row_weights(scaled)


def _rows_as_vectors(errors: FloatArray, scaled: FeatureSet) -> FloatArray:
    """Return the errors of equations [px] as vectors (m, 2), of points and then of line vertices.

    A point has two equations and a vertex one, whose error is along the normal of its line.
    """
    n_of_points = 2 * len(scaled.points)
    normals = np.repeat(line_normals(scaled.lines)[0], 2, axis=0)
    return np.concatenate(
        [errors[:n_of_points].reshape(-1, 2), errors[n_of_points:, None] * normals])


@lru_cache(maxsize=8)  # a fit asks with each of its steps
def _prepared_model(rpc: Rpc) -> RpcAffine:
    """Return a model with the RPC as its option, which is JSON."""
    return RpcAffine(rpc=json.dumps(asdict(rpc)))


@dataclass(frozen=True, eq=False)
class CorrectedRpc(Method):
    """The RPC that features have, corrected as far as they show: as delivered, by a shift, ..."""

    def declines(self, control: FitData) -> str | None:
        """Return why the RPC cannot be corrected by the control; None if it can.

        Reasons are that there is no RPC, that a height is missing, that the CRS cannot be
        transformed, and that half of the control is so far from where the RPC puts it that the RPC
        is of another image, or the heights in another unit.
        """
        rpc = control.features.rpc
        if rpc is None:
            return ("no RPC is given. Give it with --rpc FILE, or --image FILE of an image that "
                    "has one; an RPC fitted to points alone is the model rfm")
        missing = control.features.without_height()
        if missing:
            return (f"it needs ellipsoidal heights, and {missing[0]} has none (--dem FILE takes "
                    "them from a raster)")
        try:
            model = _prepared_model(rpc).prepared(control.scaling, control.features.crs)
        except TermselError as error:
            return error.what
        return _reason_if_far_away(model, control)

    def fit(self, control: FitData) -> Fit:
        """Return the fit of the correction to all features; raises Undetermined without an RPC."""
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
        probabilities = [f"{name} {probability:.2f}" for name, probability in zip(
            CORRECTION_KINDS, believed.kinds, strict=True)]
        likeliest = int(np.argmax(believed.kinds))
        # Three coefficients of line, then three of sample; the first of each is the shift.
        shift = believed.coefficients[[0, 3]]
        corners = np.array([[1.0, -1, -1], [1.0, -1, 1], [1.0, 1, -1], [1.0, 1, 1]])
        rows = np.einsum("ab,nc->nabc", np.eye(2), corners).reshape(8, 6)
        # The mean variance of both axes together at the four corners, without noise.
        sigma = np.sqrt((believed.variance(rows).sum() - 8 * believed.noise) / 4)
        source = f" {rpc.source}" if rpc.source else ""
        return (f"The vendor's RPC{source} is corrected by "
                f"{shift[0]:+.2f} px in line and {shift[1]:+.2f} px in sample, in the middle of "
                f"its image. The points support {_CORRECTIONS_IN_WORDS[likeliest]} (probabilities: "
                f"{', '.join(probabilities)}). At the corners the correction is known to "
                f"{sigma:.2g} px.")

    def suspects(self, control: FitData) -> Suspects | None:
        """Return blunders among few features, by what all others and the RPC predict.

        None if there are `MANY_FEATURES` or more, which are tested as those of any model, or so few
        that none may be a blunder.
        """
        if len(control) >= MANY_FEATURES:
            return None
        return _probable_blunders(control, _prepared_model_of(control))


_CORRECTIONS_IN_WORDS = (
    "no correction", "a shift", "a drift along the lines", "an affine correction")


def _reason_if_far_away(model: RpcAffine, control: FitData) -> str | None:
    """Return why an RPC is not of this image; None if half of the control is near enough to it.

    The limit is half of its image: a correction moves an image by hundreds of px at most.
    """
    rpc = model.rpc
    features = control.features
    geographic = model.geographic(control.scaling.ground(features.ground_vertices()))
    distances = np.linalg.norm(rpc.project(geographic) - features.image_vertices(), axis=1)
    half_image = float(np.linalg.norm(rpc.image_scale))
    # The median is NaN where the RPC has no image position, which is far away, too.
    is_near = bool(np.median(distances) < half_image)
    if is_near:
        return None
    statement = (f"{model.source} sees the control {np.median(distances):,.0f} px from where it "
                 "was measured")
    # Heights in a wrong unit move the control as far as another image does.
    if outside := rpc.heights_outside(geographic[:, 2]):
        return f"{statement}, as {outside}: check their unit and sign"
    return (f"{statement}, more than half of its image ({half_image:,.0f} px). It is of another "
            "image, or line and sample are swapped")


def _prepared_model_of(control: FitData) -> RpcAffine:
    """Return the model of the features' RPC, prepared for them."""
    rpc = control.features.rpc
    assert rpc is not None
    return _prepared_model(rpc).prepared(control.scaling, control.features.crs)


def _probable_blunders(control: FitData, model: RpcAffine) -> Suspects | None:
    """Return the blunders among the control, by the probabilities of hypotheses (`_Hypotheses`).

    A feature is a blunder if its probability is above `LIKELY`, a certain one above `SURE`, and
    under suspicion above a half. None if fewer than three features leave no room for a blunder.
    """
    n = len(control)
    max_blunders = int(MAX_BLUNDER_SHARE * n)
    if not max_blunders:
        return None
    belief, _ = belief_about_rpc(model, control.features, control.scaling,
                                 tuple(range(len(CORRECTION_KINDS))))
    reach = float(np.log(np.linalg.norm(model.rpc.image_scale) / MIN_BLUNDER))
    hypotheses = _Hypotheses(belief, n, reach)
    logs: dict[tuple[int, ...], float] = {(): belief.log}
    logs |= {(feature,): hypotheses.log_of((feature,)) for feature in range(n)}
    likeliest = sorted(range(n), key=lambda feature: -logs[feature,])[:N_LIKELIEST]
    for pair in combinations(range(n), 2) if max_blunders > 1 else ():
        if set(pair) & set(likeliest):
            logs[pair] = hypotheses.log_of(pair)
    total = np.logaddexp.reduce(list(logs.values()))
    # A feature is a blunder with the probability of all hypotheses that name it.
    probability = np.zeros(n)
    for feature in range(n):
        naming = [log for hypothesis, log in logs.items() if feature in hypothesis]
        probability[feature] = np.exp(np.logaddexp.reduce(naming) - total)
    # Errors are those by the features that the most probable hypothesis takes to be right.
    by_others = hypotheses.without(max(logs, key=lambda hypothesis: logs[hypothesis]))
    errors = np.array([hypotheses.error(feature, by_others) for feature in range(n)])
    sigma = np.sqrt(np.array([by_others.variance(belief.rows[belief.feature == feature]).max()
                              for feature in range(n)]))
    blunders = probability > LIKELY
    return Suspects(blunders, blunders & (probability <= SURE), (probability > 0.5) & ~blunders,
                    errors, _least_certain_errors(sigma, n, reach))


@dataclass(frozen=True)
class _Hypotheses:
    """Hypotheses on which of `n` features are blunders.

    Beforehand one feature of `n` is expected to be one. A blunder is as likely 2 to 4 px from its
    right position as 20 to 40 px; `reach` is the logarithm of the farthest over the nearest
    distance.
    """

    belief: Belief
    n: int
    reach: float

    def without(self, hypothesis: tuple[int, ...]) -> Belief:
        """Return the belief by all features but those of the hypothesis, numbered anew."""
        belief = self.belief
        is_kept = ~np.isin(belief.feature, hypothesis)
        number = np.cumsum(~np.isin(np.arange(self.n), hypothesis)) - 1
        return Belief(belief.rows[is_kept], belief.right[is_kept],
                      number[belief.feature[is_kept]], belief.grid)

    def error(self, feature: int, by_others: Belief) -> float:
        """Return the largest error [px] of a feature's equations by another belief."""
        rows = self.belief.feature == feature
        predicted = self.belief.rows[rows] @ by_others.coefficients
        return float(np.abs(self.belief.right[rows] - predicted).max())

    def log_of(self, hypothesis: tuple[int, ...]) -> float:
        """Return the logarithm of the evidence that the features of a hypothesis are blunders."""
        remaining = self.without(hypothesis)
        # At the distance d, log-uniform and in any direction, a blunder has the density
        # 1 / (2 pi reach d^2); before, it has the odds 1 to n - 1.
        densities = [np.log((self.n - 1) * 2 * np.pi * self.reach)
                     + 2 * np.log(max(self.error(feature, remaining), MIN_BLUNDER))
                     for feature in hypothesis]
        return float(remaining.log - sum(densities))


def _least_certain_errors(sigma: FloatArray, n: int, reach: float) -> FloatArray:
    """Return the errors (n,) [px] beyond which a feature is a blunder with the probability `SURE`.

    `sigma` (n,) are the standard deviations of the predictions [px], `n` is the number of features,
    and `reach` the logarithm of the farthest over the nearest distance of a blunder.
    """
    # The odds of a blunder against a normal error e are those of `SURE` if
    # e^2 / (2 sigma^2) = log(SURE / (1 - SURE) (n - 1) reach) + 2 log(e / sigma).
    # The fixed point is reached soon, as e is in a logarithm at the right.
    errors = 4 * sigma
    for _ in range(20):
        errors = sigma * np.sqrt(2 * (np.log(SURE / (1 - SURE) * (n - 1) * reach)
                                      + 2 * np.log(np.maximum(errors, MIN_BLUNDER) / sigma)))
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
