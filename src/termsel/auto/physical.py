"""A polynomial with the prior of known cameras, next to regularised ones in one average."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.bayesian.cameras import east_north_up
from termsel.adjustment.bayesian.field import GaussianProcess, fit_gaussian_process
from termsel.adjustment.bayesian.physics import (
    FRAMES,
    N_VIEW_POINTS,
    RADARS,
    SCANNERS,
    VIEW_BOX,
    CameraEquations,
    CameraSolutions,
    Kind,
    camera_priors,
    log_marginal_likelihood,
)
from termsel.adjustment.bayesian.posterior import Posterior, polynomial_posterior
from termsel.adjustment.bayesian.predicted_positions import predict_positions
from termsel.adjustment.equations import weights_of
from termsel.auto.local import LIKELY, asked_of, points_alone
from termsel.auto.shrunken import Average, average, fit_of
from termsel.auto.validated import gain_of
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.monomials import Exponents, graded_exponents, monomials
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, Undetermined
from termsel.fitting.uncertainty import Spread
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial

FEWEST, MOST = 6, 40
"""Numbers of points for which there is a physical prior: fewer do not tell such images from
others, and more gain nothing by it."""

CHOSEN, FEW = 18, 12
"""Points of control up to which auto tries it, and up to which points do not tell whether it
predicts better than what stands without it. The final fit has the check points, too."""

NEGLIGIBLE = 25.0
"""Logarithm by which a prior explains the points worse than the best, to be left out of the
average. Without one of the points its share is hardly ever one, either."""

FRAMED = 7
"""Points up to which frame cameras are among the kinds: from more a DLT tells photos, and without a
prior. One more than the fewest, as a point is held out."""

FROM_ORBIT = (0.1, 2000.0)
FROM_THE_AIR = (0.002, 20.0)
"""Sizes of a pixel on the ground [m] that images have, resampled ones included."""

STRONG = 20 / 21
"""Probability asked of the prior beyond the fewest points, where what stands without it is better:
odds of twenty to one, beyond which the evidence is strong (Kass and Raftery 1995)."""

WORSE = 1.0
"""Standard errors by which the regularised polynomials alone must predict left-out points better to
remain alone; beyond few points they must be as much worse not to."""


@dataclass(frozen=True, eq=False)
class Averaged(Average):
    """Polynomials with different priors, averaged by their marginal likelihoods."""

    physical: tuple[CameraSolutions, ...]
    shrunken: tuple[tuple[Posterior, Exponents], ...]
    shares: FloatArray  # (p,): of the physical ones, then of the others
    worse: float  # standard errors by which the regularised ones predict left-out points better

    @property
    def probability(self) -> float:
        """Probability of the physical prior."""
        return float(self.shares[:len(self.physical)].sum())

    @property
    def kind(self) -> str:
        """The kind of cameras that is likeliest."""
        likely: defaultdict[str, float] = defaultdict(float)
        for one, share in zip(self.physical, self.shares, strict=False):
            likely[one.kind] += float(share)
        return max(likely, key=likely.__getitem__)

    def alone(self, local: GaussianProcess | None) -> bool:
        """Return whether the prior is not called for: next to a field, if points call for one.

        It needs positive evidence at the fewest points, as a field does, and strong evidence at
        more: where it is hardly likelier than what stands without it, that is as good, and has no
        prior that may be wrong.
        """
        beyond = local.probability if local and local.probability > asked_of(
            local) else 0.0
        mine = self.probability * (1.0 - beyond)
        others = 1.0 - self.probability
        asked = LIKELY if len(self.errors) <= FEWEST else STRONG
        least = WORSE if len(self.errors) <= FEW else -WORSE
        return mine <= asked * (mine + others) or self.worse > least


def averaged(points: Points, scaling: Scaling, crs: str, exponents: Exponents) -> Averaged | None:
    """Return the average for scaled control points; None where none of the kinds can be meant.

    The exponents are those of a cubic polynomial of X and Y, or of X, Y and Z.
    """
    variables = 3 if any(power[2] for power in exponents) else 2
    found = east_north_up(scaling, crs, points.ground)
    rng = np.random.default_rng(0)
    scaled = rng.uniform(-VIEW_BOX, VIEW_BOX, (N_VIEW_POINTS, 3)) * [1.0, 1.0, variables == 3]
    grid = east_north_up(scaling, crs, scaled)
    if found is None or grid is None or not FEWEST <= len(points) <= MOST:
        return None
    plan = found[0][:, :2]
    pixel = 1.0 / scaling.image_scale
    slopes, _, rank, _ = np.linalg.lstsq(
        np.column_stack([np.ones(len(plan)), plan]), points.image)
    if rank < 3:
        return None
    coarse, fine = sorted(np.linalg.norm(slopes[1:], axis=0) / pixel)  # px per metre

    def seen(sizes: tuple[float, float]) -> bool:
        return bool(sizes[0] * fine <= 1.0 <= sizes[1] * coarse)

    kinds: list[Kind] = []
    if seen(FROM_ORBIT):
        # Without heights a map that bends would look like a radar image.
        kinds += [SCANNERS, *RADARS] if variables == 3 else [SCANNERS]
    if variables == 3 and len(points) <= FRAMED and seen(FROM_THE_AIR):
        kinds.append(FRAMES)
    priors = camera_priors(kinds, grid[0], scaled, exponents, grid[1], np.asarray(slopes[1:].T),
                           pixel)
    if not priors:
        return None
    weights = weights_of(points)
    equations = CameraEquations(monomials(points.ground, exponents), points.image, weights)
    physical = [CameraSolutions(equations, prior, pixel) for prior in priors]
    least = max(one.log_evidence for one in physical) - NEGLIGIBLE
    physical = [one for one in physical if one.log_evidence > least]
    logs = [solution.log_evidence for solution in physical]
    logs_without = [solution.log_evidence_without for solution in physical]
    errors = [solution.errors for solution in physical]
    coefficients = [solution.coefficients for solution in physical]
    effective = [solution.effective for solution in physical]
    shrunken = []
    own = None if points.sigma is None else weights
    height = scaling.ground_scale[2] * float(np.linalg.norm(slopes[1:], axis=0).mean())
    for degree in (2, 3):
        powers = graded_exponents(degree, variables)
        one = average(points.ground, points.image, powers, own)
        posterior = polynomial_posterior(points.ground, points.image, powers, own)
        if one is None or posterior is None:
            return None
        shrunken.append((posterior, powers))
        log = log_marginal_likelihood(posterior, one.coefficients, variables, height,
                                      pixel) - np.log(2.0)
        logs.append(log)
        logs_without.append(log + posterior.held_out.log_evidence - posterior.cells.log_evidence)
        errors.append(one.errors)
        coefficients.append(np.pad(one.coefficients, (
            (0, len(exponents) - len(powers)), (0, 0))))
        effective.append(one.effective)
    shares = np.exp(logs - np.logaddexp.reduce(logs))

    def left_out(some: slice) -> FloatArray:
        logs = np.array(logs_without[some])
        return np.asarray(np.einsum("pn,pna->na", np.exp(
            logs - np.logaddexp.reduce(logs, axis=0)), np.array(errors[some])))

    mean, others = left_out(slice(None)), left_out(slice(len(physical), None))
    return Averaged(np.einsum("p,pka->ka", shares, coefficients), mean, float(shares @ effective),
                    tuple(physical), tuple(shrunken), shares,
                    gain_of((others**2).sum(axis=1), (mean**2).sum(axis=1)))


def averaged_of(fitted: Fit) -> Averaged:
    """Return the average that a fit was made of."""
    assert isinstance(fitted.model, Polynomial)
    points = fitted.scaling.points(fitted.control.points.take(fitted.used))
    found = averaged(points, fitted.scaling, fitted.control.crs, fitted.model.exponents)
    assert found is not None
    return found


class Physical(Estimator):
    """The average of polynomials with a physical prior and of regularised ones."""

    name = "physical"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a cubic polynomial (see `Estimator.fit`) with all its terms."""
        assert isinstance(model, Polynomial)
        mine = points_alone(control, used, "a physical prior")
        found = averaged(scaling.points(mine), scaling, control.crs, model.exponents)
        local = fit_gaussian_process(scaling.points(mine), model.variables)
        if found is None or found.alone(local):
            raise Undetermined(
                "the points do not support the sensor-geometry prior of a scanner, a radar or a "
                "frame camera" + (
                    "" if found is None else f": its probability is {found.probability:.2g}"),
                hint="Choose a polynomial without it, such as shrunken-cubic.")
        return fit_of(self, model, control, scaling, used, found)

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of a fit at scaled places, under all priors."""
        assert isinstance(fitted.model, Polynomial)
        found = averaged_of(fitted)
        parts = []
        columns = monomials(ground, fitted.model.exponents)
        for one in found.physical:
            parts.append((columns @ one.coefficients, *one.spread(columns)))
        for posterior, powers in found.shrunken:
            mine = monomials(ground, powers)
            lead = posterior.designs[0].lead.shape[0]
            there = predict_positions(posterior, mine[:, :lead], mine[:, lead:])
            parts.append((there.image, there.variance, there.noise))
        image = fitted.model.project(fitted.adjustment.coefficients, ground)
        variance = sum((share * (own + (mean - image) ** 2) for share, (mean, own, _) in zip(
            found.shares, parts, strict=True)), np.zeros_like(image))
        return Spread(variance, np.full(2, float(found.shares @ [part[2] for part in parts])))
