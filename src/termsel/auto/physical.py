"""A polynomial with the prior of known cameras, next to regularised ones in one average."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from termsel.adjustment.bayesian.cameras import east_north_up
from termsel.adjustment.bayesian.field import GaussianProcess, fit_gaussian_process
from termsel.adjustment.bayesian.physics import (
    FRAMES,
    RADARS,
    SCANNERS,
    CameraEquations,
    CameraSolutions,
    Kind,
    camera_priors,
    log_marginal_likelihood,
    view_points,
)
from termsel.adjustment.bayesian.posterior import (
    Posterior,
    normalise_probabilities,
    polynomial_posterior,
    predict_positions,
)
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import Adjustment
from termsel.auto.rule import CENTRAL_AFFINE_SHARE, gain_of
from termsel.auto.shrunken import (
    FIELD_CALLED_FOR,
    Average,
    fit_average,
    fit_of,
    mean_coefficients,
    points_alone,
    required_probability,
)
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import is_off_plane
from termsel.data.monomials import Exponents, evaluate_monomials, graded_exponents
from termsel.data.scaling import Scaling, metres_of
from termsel.data.view import CLEARER, CentralView, Measurements, view_of
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.pinhole import (
    EXPECTED_FOCAL,
    PINHOLE_MIN_POINTS,
    Pinhole,
    pinhole_near,
    pinhole_of,
)
from termsel.fitting.uncertainty import Spread, widening_of_projections
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial
from termsel.models.projective import Projective

PHYSICAL_MIN_POINTS = 6
"""Points from which on there is a physical prior: fewer do not show such images to be different."""

PHYSICAL_MAX_POINTS = 40
"""Points up to which there is one: more gain nothing by it."""

PHYSICAL_MAX_CHOSEN = 18
"""Points of control up to which auto tries it. The final fit has the selection points, too."""

PHYSICAL_FEW_POINTS = 12
"""Points up to which they do not show whether it predicts better than what stands without it."""

NEGLIGIBLE_LOG = 25.0
"""Logarithm by which a prior explains the points worse than the best, to be left out of the
average. Without one of the points its share is hardly ever one, either."""

FRAME_MAX_POINTS = 7
"""Points up to which frame cameras are among the kinds: from more a DLT shows photos, and without a
prior. One more than the fewest, as a point is held out."""

ORBIT_PIXELS = (0.1, 2000.0)
AERIAL_PIXELS = (0.002, 20.0)
"""Sizes of a pixel on the ground [m] that images have, resampled ones included."""

STRONG_PROBABILITY = 20 / 21
"""Probability asked of the prior beyond the fewest points, where what stands without it is better:
odds of twenty to one, beyond which the evidence is strong (Kass and Raftery 1995)."""

MIN_ADVANTAGE = 1.0
"""Standard errors by which the regularised polynomials alone must predict left-out points better to
remain alone; beyond few points they must be as much worse not to."""


@dataclass(frozen=True, eq=False)
class CameraAverage(Average):
    """Polynomials with different priors, averaged by their marginal likelihoods."""

    physical: CameraSolutions
    shrunken: tuple[tuple[Posterior, Exponents], ...]
    shares: FloatArray  # (p,): of the physical ones, then of the others
    worse: float  # standard errors by which the regularised ones predict left-out points better

    @property
    def probability(self) -> float:
        """Probability of the physical prior."""
        return float(self.shares[:len(self.physical)].sum())

    @property
    def kind(self) -> str:
        """The kind of cameras that is likeliest: that whose views have the largest probability."""
        likely: defaultdict[str, float] = defaultdict(float)
        priors = self.physical.priors
        for view, share in zip(priors.view, self.shares, strict=False):
            likely[priors.kinds[view]] += float(share)
        return max(likely, key=likely.__getitem__)

    def is_uncalled_for(self, local: GaussianProcess | None) -> bool:
        """Return whether the points do not support the prior, beside the field `local` if any.

        With the fewest points the prior needs positive evidence, as a field does, and with more
        points strong evidence. Where it is hardly likelier than the polynomials without it, these
        are as good, and have no prior that may be wrong.
        """
        # Few points cannot show that the prior is worse; more must show that it is not.
        limit = MIN_ADVANTAGE if len(self.errors) <= PHYSICAL_FEW_POINTS else -MIN_ADVANTAGE
        return is_unlikely(self.probability, len(self.errors), local) or self.worse > limit


@dataclass(frozen=True, eq=False)
class PriorEvidence:
    """How likely both kinds of priors are, before anything is averaged or held out."""

    physical: CameraSolutions
    shrunken: tuple[tuple[Posterior, Exponents], ...]
    logs: FloatArray  # logarithms of the evidence of the regularised ones

    @property
    def shares(self) -> FloatArray:
        """Probability of the physical priors, then of the others, (p,)."""
        # Bayes' rule: shares in proportion to the marginal likelihoods.
        return normalise_probabilities(np.concatenate([self.physical.log_evidence, self.logs]))[0]

    @property
    def probability(self) -> float:
        """Probability of the physical prior."""
        return float(self.shares[:len(self.physical)].sum())


def is_unlikely(probability: float, points: int, local: GaussianProcess | None) -> bool:
    """Return whether the evidence of so many `points` for a physical prior is too weak to use it.

    `probability` is how likely it is if the choice is between it and the regularised polynomials.
    `local` is the random field of the points, None if they are too few for one.
    """
    # A field that points support takes its share first; prior and polynomials divide the rest.
    has_field = local is not None and local.probability > required_probability(local)
    field_probability = local.probability if local is not None and has_field else 0.0
    physical = probability * (1.0 - field_probability)
    required = FIELD_CALLED_FOR if points <= PHYSICAL_MIN_POINTS else STRONG_PROBABILITY
    return physical <= required * (physical + 1.0 - probability)


def prior_evidence(points: Points, scaling: Scaling, crs: str,
                   exponents: Exponents) -> PriorEvidence | None:
    """Return how likely scaled control points are under each kind of prior.

    Returns None where no kind of camera can have made the image. The exponents are those of a cubic
    polynomial of X and Y, or of X, Y and Z.
    """
    return _cached_evidence(Measurements.of(points), scaling, crs, exponents)


def camera_average(points: Points, scaling: Scaling, crs: str,
                   exponents: Exponents) -> CameraAverage | None:
    """Return the average for scaled control points; None as for `prior_evidence`."""
    return _cached_camera_average(Measurements.of(points), scaling, crs, exponents)


@lru_cache(maxsize=2)  # the average asks again
def _cached_evidence(measurements: Measurements, scaling: Scaling, crs: str,
                     exponents: Exponents) -> PriorEvidence | None:
    """Return what `prior_evidence` does, and keep it for the last data.

    `camera_average` asks for the same again. The evidence of the polynomials of degree 2 and 3 is
    made comparable to that of cameras by the prior on what a height does. Returns None where any of
    the steps says that there is no prior.
    """
    points = measurements.points
    variables = 3 if any(power[2] for power in exponents) else 2
    slopes = _slopes_on_ground(points, scaling, crs)
    if slopes is None:
        return None
    physical = _solutions_by_kind(points, scaling, crs, exponents, slopes)
    if physical is None:
        return None
    weights = None if points.sigma is None else weights_of(points)
    # Scaled heights in px: how far relief moves a point, by the slope of the image.
    height = scaling.ground_scale[2] * float(np.linalg.norm(slopes, axis=1).mean())
    shrunken = []
    logs = []
    for degree in (2, 3):
        powers = graded_exponents(degree, variables)
        posterior = polynomial_posterior(points.ground, points.image, powers, weights)
        if posterior is None:
            return None
        # Without heights no coefficient has a part in the evidence; Z is the fourth term.
        height_coefficients = None
        if variables == 3:
            height_coefficients = mean_coefficients(posterior, powers)[0][3]
        # Log of one half: the degrees 2 and 3 share the probability of polynomials.
        logs.append(log_marginal_likelihood(posterior, height_coefficients, height,
                                            1.0 / scaling.image_scale) - np.log(2.0))
        shrunken.append((posterior, powers))
    return PriorEvidence(physical, tuple(shrunken), np.array(logs))


@lru_cache(maxsize=2)  # a fit, its description and its spread need it
def _cached_camera_average(measurements: Measurements, scaling: Scaling, crs: str,
                           exponents: Exponents) -> CameraAverage | None:
    """Return what `camera_average` does, None included, and keep it for the last data.

    The members of the average are the cameras, then the polynomials of degree 2 and 3, with their
    evidence as weights. A point that is left out changes the evidence of all members, so that its
    held-out error is that of an average with the weights which the other points give.
    """
    points = measurements.points
    evidence = _cached_evidence(measurements, scaling, crs, exponents)
    if evidence is None:
        return None
    weights = None if points.sigma is None else weights_of(points)
    averages = []
    logs_without = []
    for log, (posterior, powers) in zip(evidence.logs, evidence.shrunken, strict=True):
        average_of_degree = fit_average(points.ground, points.image, powers, weights)
        assert average_of_degree is not None
        averages.append(average_of_degree)
        # The evidence of the others when one point is left out.
        logs_without.append(log + posterior.held_out.log_evidence - posterior.cells.log_evidence)
    # Cameras come first, then both polynomials.
    physical = evidence.physical
    logs_of_cameras, errors_of_cameras = physical.left_out()
    errors = np.concatenate([errors_of_cameras, [member.errors for member in averages]])
    logs_without_each = np.concatenate([logs_of_cameras, logs_without])
    # The polynomial of degree 2 lacks the last coefficients.
    coefficients = np.concatenate([physical.coefficients, [
        np.pad(member.coefficients, ((0, len(exponents) - len(member.coefficients)), (0, 0)))
        for member in averages]])
    effective = np.concatenate([physical.effective, [member.effective for member in averages]])
    shares = evidence.shares
    # Each left-out point has shares of its own: its measurement must not weigh them.
    mean_errors = _mean_without_each(logs_without_each, errors)
    n_polynomials = len(averages)
    errors_of_polynomials = _mean_without_each(logs_without_each[-n_polynomials:],
                                               errors[-n_polynomials:])
    worse = gain_of((errors_of_polynomials ** 2).sum(axis=1), (mean_errors ** 2).sum(axis=1))
    return CameraAverage(np.einsum("p,pka->ka", shares, coefficients), mean_errors,
                         float(shares @ effective), physical, evidence.shrunken, shares, worse)


def _mean_without_each(logs: FloatArray, errors: FloatArray) -> FloatArray:
    """Return the error of each point left out, (n, 2), averaged over p solutions.

    `errors` (p, n, 2) are those of each solution. Its weight for a point is the evidence of all
    other points, whose logarithm is in `logs` (p, n).
    """
    return np.asarray(np.einsum("pn,pna->na", normalise_probabilities(logs)[0], errors))


def _slopes_on_ground(points: Points, scaling: Scaling, crs: str) -> FloatArray | None:
    """Return the slopes of line and of sample by metres to the east and to the north, (2, 2).

    They are in scaled units of the image. Returns None where the ground is not known, points lie on
    a line, or there are too few or too many points for a physical prior.
    """
    # Metres, as kinds of cameras are distinguished by the size of a pixel.
    positions = east_north_up(scaling, crs, points.ground)
    if positions is None or not PHYSICAL_MIN_POINTS <= len(points) <= PHYSICAL_MAX_POINTS:
        return None
    plane = np.column_stack([np.ones(len(points)), positions[0][:, :2]])
    slopes, _, rank, _ = np.linalg.lstsq(plane, points.image)
    # Points on a line say nothing of the slope across it.
    return np.asarray(slopes[1:].T) if rank == plane.shape[1] else None


def _solutions_by_kind(points: Points, scaling: Scaling, crs: str, exponents: Exponents,
                       slopes: FloatArray) -> CameraSolutions | None:
    """Return the solutions with priors of the kinds of cameras that may have made the image.

    `slopes` (2, 2) are the scaled line and sample (rows) by metre to the east and to the north
    (columns). Solutions whose evidence is negligible are left out. Returns None where none of the
    kinds can have made the image.
    """
    variables = 3 if any(power[2] for power in exponents) else 2
    pixel = 1.0 / scaling.image_scale
    # The lengths of the slopes' columns are the resolution to the east and to the north.
    coarse, fine = sorted(np.linalg.norm(slopes, axis=0) / pixel)  # px per metre

    def has_pixels_of(sizes: tuple[float, float]) -> bool:
        smallest, largest = sizes
        return bool(smallest * fine <= 1.0 <= largest * coarse)

    kinds: list[Kind] = []
    if has_pixels_of(ORBIT_PIXELS):
        # Without heights a map that bends would look like a radar image.
        kinds += [SCANNERS, *RADARS] if variables == 3 else [SCANNERS]
    if variables == 3 and len(points) <= FRAME_MAX_POINTS and has_pixels_of(AERIAL_PIXELS):
        kinds.append(FRAMES)
    scaled = view_points(variables)
    grid = east_north_up(scaling, crs, scaled)
    if grid is None:
        return None
    priors = camera_priors(kinds, grid[0], scaled, exponents, grid[1], slopes, pixel)
    if priors is None:
        return None
    # All kinds share the design of a cubic polynomial; only their priors differ.
    equations = CameraEquations(evaluate_monomials(points.ground, exponents), points.image,
                                weights_of(points))
    solutions = CameraSolutions(equations, priors, pixel)
    return solutions.take(
        solutions.log_evidence > solutions.log_evidence.max() - NEGLIGIBLE_LOG)


def camera_average_of(fitted: Fit) -> CameraAverage:
    """Return the average that a fit was made of."""
    assert isinstance(fitted.model, Polynomial)
    points = fitted.scaling.points(fitted.control.points.take(fitted.used))
    result = camera_average(points, fitted.scaling, fitted.control.crs, fitted.model.exponents)
    assert result is not None
    return result


class Physical(Estimator):
    """The average of polynomials with a physical prior and of regularised ones."""

    name = "physical"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a cubic polynomial by the average over cameras and polynomials.

        Arguments are those of `Estimator.fit`; all terms are fitted, whatever `terms` selects.
        Raises Undetermined for lines, and where the points speak against a camera or a random field
        explains them better, with the probability of the cameras.
        """
        assert isinstance(model, Polynomial)
        points = scaling.points(points_alone(control, used, "a physical prior"))
        evidence = prior_evidence(points, scaling, control.crs, model.exponents)
        local = fit_gaussian_process(points, model.variables)
        average = None
        # The average takes longer than its evidence, and is not made where that speaks against it.
        if evidence is not None and not is_unlikely(evidence.probability, len(points), local):
            average = camera_average(points, scaling, control.crs, model.exponents)
        if average is None or average.is_uncalled_for(local):
            raise Undetermined(
                "the points do not support the sensor-geometry prior of a scanner, a radar or a "
                "frame camera" + ("" if evidence is None
                                  else f": its probability is {evidence.probability:.2g}"),
                hint="Choose a polynomial without it, such as regularised-cubic.")
        return fit_of(self, model, control, scaling, used, average)

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of a fit at scaled places, under all priors.

        By the law of total variance the mean square error at a place is the mean over all members,
        cameras and polynomials, of their variance and of the square of their distance from the
        average. The noise is averaged likewise.
        """
        assert isinstance(fitted.model, Polynomial)
        average = camera_average_of(fitted)
        columns = evaluate_monomials(ground, fitted.model.exponents)
        variances, noises_of_cameras = average.physical.spread(columns)
        # Position, variance and noise by each member.
        predictions = [(columns @ coefficients, variance, noise) for coefficients, variance, noise
                       in zip(average.physical.coefficients, variances, noises_of_cameras,
                              strict=True)]
        for posterior, powers in average.shrunken:
            columns_of_degree = evaluate_monomials(ground, powers)
            n_free = posterior.designs[0].free_triangle.shape[0]
            predicted = predict_positions(posterior, columns_of_degree[:, :n_free],
                                          columns_of_degree[:, n_free:])
            predictions.append((predicted.image, predicted.variance, predicted.noise))
        image = fitted.model.project(fitted.adjustment.coefficients, ground)
        # Law of total variance: within each member, and between their means.
        total_variance = np.zeros_like(image)
        for share, (mean, variance, _) in zip(average.shares, predictions, strict=True):
            total_variance = total_variance + share * (variance + (mean - image) ** 2)
        noise = float(average.shares @ [prediction[2] for prediction in predictions])
        return Spread(total_variance, np.full(2, noise))


# A pinhole camera as a candidate, where few points support an oblique view.

PHOTO_MAX_POINTS = 20
"""Points up to which a camera is tried: a DLT of more shows as much, and takes up more of a lens.
"""

OBLIQUE_DEPTH = 0.8
"""Distance of the nearest point by that of the middle, along the view, below which a view is
oblique: points of a photo from above are at about the same distance."""

HIGHEST_FLIGHT = 30e3
"""Height above the ground [m] that aircraft with cameras do not exceed."""

BENT_DEVIATION = 0.01
"""Standard deviation of what affine polynomials leave, by the half extent of the image, below which
few points show no oblique view."""

EXACT_AFFINE_POINTS = 4
"""Points that an affine polynomial with heights fits exactly."""

PHOTO_MIN_DLT_POINTS = 8
"""Points below which a view is not told by a DLT, which leaves them hardly an equation."""


@dataclass(frozen=True)
class PinholeCamera(Estimator):
    """The camera of 7 unknowns that points support, written as the projection it is."""

    name = "pinhole"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a projection (see `Estimator.fit`) with all its terms."""
        assert isinstance(model, Projective)
        in_use = control.take(used)
        return self._fit_of_camera(pinhole_of(scaling.features(in_use), scaling), model, control,
                                   scaling, used)

    def refit(self, fitted: Fit, control: FeatureSet) -> Fit:
        """Return the fit of a camera to other control points, sought from the camera of a fit."""
        assert isinstance(fitted.model, Projective)
        camera = pinhole_near(_camera_of(fitted), fitted.scaling.features(control), fitted.scaling)
        return self._fit_of_camera(camera, fitted.model, control, fitted.scaling,
                                   np.ones(len(control), dtype=bool))

    def _fit_of_camera(self, camera: Pinhole | None, model: Projective, control: FeatureSet,
                       scaling: Scaling, used: BoolArray) -> Fit:
        """Return the fit that a camera of the points in use, a mask (n,), makes.

        Raises Undetermined where `camera` is None, as none was found.
        """
        if camera is None:
            raise Undetermined("no camera in front of all control points was found",
                               hint="Choose another model, such as dlt or projective.")
        coefficients = _projection_coefficients(camera, model)
        # Shrunken parameters count in parts; the record has whole numbers.
        count = round(camera.effective)
        in_use = control.take(used)
        equations = 2 * len(in_use)
        sigma0 = camera.sigma if equations > count else np.nan
        unknown = np.full(len(coefficients), np.nan)
        adjustment = Adjustment(coefficients, unknown, n_terms=count, n_equations=equations,
                                rank=count, condition=np.nan, sigma0=sigma0)
        return Fit(model, scaling, control, terms=np.ones(len(coefficients), dtype=bool), used=used,
                   adjustment=adjustment, estimator=self, trace=camera.effective,
                   stored_held_out=HeldOut.of(camera.errors * scaling.image_scale, in_use))

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of a fit at scaled places (see `Estimator.spread`)."""
        assert isinstance(fitted.model, Projective)
        camera = _camera_of(fitted)
        widening = widening_of_projections(camera.residuals.size - camera.effective)
        # With factors F of the unknowns' covariance, that of a place is F F'.
        factors = widening**0.5 * camera.factors(_with_heights(camera, fitted.model, ground))
        return Spread((factors**2).sum(axis=2), np.full(2, widening * camera.sigma**2), factors)

    def view(self, features: FeatureSet, scaling: Scaling) -> CentralView | None:
        """Return the view of scaled features by the camera, or the usual one without a camera."""
        camera = pinhole_of(features, scaling)
        return super().view(features, scaling) if camera is None else camera.view


def may_be_photo(features: FeatureSet, scaling: Scaling) -> bool:
    """Return whether scaled points may be of a photo, by a test that fits no camera.

    Returns False for lines, and for fewer or more points than a camera is tried for.
    """
    points = features.points
    if len(features.lines) or not PINHOLE_MIN_POINTS <= len(points) <= PHOTO_MAX_POINTS:
        return False
    if len(points) >= PHOTO_MIN_DLT_POINTS and not _may_be_from_the_air(features, scaling):
        view = view_of(points)
        return view is not None and (view.depth < OBLIQUE_DEPTH
                                     or view.affine_share < CENTRAL_AFFINE_SHARE)
    return _affine_deviation(points, heights=False) > BENT_DEVIATION


def call_for_camera(features: FeatureSet, scaling: Scaling) -> bool:
    """Return whether scaled points support a view by a camera without distortion.

    For a photo of relief from the air it is enough that the camera leaves less than an affine
    polynomial does: rough clicks on a vertical photo leave hardly less, and what the camera
    predicts for points left out decides then. In other cases it must leave far less.
    """
    if not may_be_photo(features, scaling):
        return False
    camera = pinhole_of(features, scaling)
    if camera is None or not camera.view.depth > 0.0:
        return False
    count = len(features.points)
    has_relief = is_off_plane(features.points)
    is_oblique = camera.view.depth < OBLIQUE_DEPTH
    # Affine polynomials with heights fit four points exactly.
    is_exact = count == EXACT_AFFINE_POINTS
    if is_exact and not (has_relief and is_oblique):
        return False  # a projective transformation sees four points of a plane as they are
    if has_relief and _is_from_the_air(camera, features, scaling):
        largest_share = CLEARER if is_exact else 1.0
    elif has_relief and count < PHOTO_MIN_DLT_POINTS:
        return False  # few points of a scene from orbit, in mountains, look like those of a photo
    else:
        largest_share = CLEARER if is_oblique else CENTRAL_AFFINE_SHARE
    return camera.sigma < largest_share * _affine_deviation(features.points, heights=not is_exact)


def _may_be_from_the_air(features: FeatureSet, scaling: Scaling) -> bool:
    """Return whether a camera of the usual focal length sees scaled points from where aircraft fly.

    Its height above the points is the focal length [px] times the size of a pixel [m]. Only relief
    shows how high a camera is: it is False for points of a plane, and where metres are not known.
    """
    metres = metres_of(features, scaling)
    if metres is None or not is_off_plane(features.points):
        return False
    size = features.image_size
    half_diagonal = scaling.image_scale if size is None else float(np.linalg.norm(size)) / 2.0
    # Scaled points extend to 1 from the middle, on the ground and in the image.
    pixel = float(metres[:2].max()) / scaling.image_scale
    return EXPECTED_FOCAL * half_diagonal * pixel < HIGHEST_FLIGHT


def _is_from_the_air(camera: Pinhole, features: FeatureSet, scaling: Scaling) -> bool:
    """Return whether a camera is as high above scaled points as aircraft fly, or lower."""
    metres = metres_of(features, scaling)
    assert metres is not None  # else there is no camera
    # The camera's axes have one unit, the larger of the two in the plane.
    height = camera.camera.position[0, 2] - camera.measured.ground[:, 2].mean()
    return bool(height * metres[:2].max() < HIGHEST_FLIGHT)


def _affine_deviation(points: Points, *, heights: bool) -> float:
    """Return the standard deviation that scaled points have from an affine polynomial of them.

    It is 0.0 without redundancy.
    """
    ground = points.ground[:, :3 if heights else 2]
    columns = np.column_stack([np.ones(len(points)), ground])
    coefficients, _, rank, _ = np.linalg.lstsq(columns, points.image)
    freedom = points.image.size - 2 * int(rank)
    residuals = points.image - columns @ coefficients
    return float(np.sqrt((residuals**2).sum() / freedom)) if freedom > 0 else 0.0


def _camera_of(fitted: Fit) -> Pinhole:
    """Return the camera that a fit was made of."""
    camera = pinhole_of(fitted.scaling.features(fitted.control.take(fitted.used)), fitted.scaling)
    assert camera is not None
    return camera


def _projection_coefficients(camera: Pinhole, model: Projective) -> FloatArray:
    """Return the coefficients (k,) of the projection that a camera is.

    The rows of the camera's matrix P are line, sample and denominator as functions of 1, X, Y and
    Z. In a model without heights, Z is on the plane through the points, Z = z0 + a X + b Y.

    Raises Undetermined where the middle of the points lies behind the camera.
    """
    matrix = camera.matrix
    if not model.uses_height:
        plane = np.concatenate([np.eye(3), _plane_through_control(camera)[None]])
        matrix = matrix @ plane
    # The model's denominator is 1 in the middle of the points' box, where X, Y and Z are 0.
    scaled_matrix = matrix / matrix[2, 0]
    if not matrix[2, 0] > 0.0:
        raise Undetermined("the middle of the points lies behind the camera",
                           hint="Choose another model, such as regularised-cubic.")
    return np.concatenate([scaled_matrix[0], scaled_matrix[1], scaled_matrix[2, 1:]])


def _plane_through_control(camera: Pinhole) -> FloatArray:
    """Return the coefficients (3,) of 1, X and Y for scaled heights on the plane through control.
    """
    ground = camera.view.ground
    return np.asarray(np.linalg.lstsq(evaluate_monomials(ground, ((0, 0, 0), (1, 0, 0), (0, 1, 0))),
                                      ground[:, 2])[0])


def _with_heights(camera: Pinhole, model: Projective, ground: FloatArray) -> FloatArray:
    """Return scaled places (m, 3); for a model without heights, on the plane through the control.
    """
    if model.uses_height:
        return ground
    plane = np.column_stack([np.ones(len(ground)), ground[:, :2]])
    return np.column_stack([ground[:, :2], plane @ _plane_through_control(camera)])
