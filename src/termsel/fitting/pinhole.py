"""A camera with few unknowns: its place, its turn and its focal length, fitted to control points.

With the rotation R, the place C and the focal length f, a pinhole camera without distortion and
with square pixels sees a place G at

    (line, sample) = principal point + f (q1, q2) / q3,    q = R (G - C).

These are 7 unknowns where a DLT of the same view has 11, which 5 points do not determine and 6
hardly. Two more, the principal point, are held by a prior: near the middle of the image where its
size is known, and within the control else. It has long tails, so that an image that was cropped
moves it. The focal length has a wide prior, which shows where points do not. Priors count against
the measurements by the noise of these, which the residuals show.

The least squares of distances in the image have several minima, so a grid of rotations and focal
lengths is tried; for each the place of the camera is linear, and the best ones are improved in
damped steps. The solutions without each point are found from that of all.

References
----------
Kraus 2007, Photogrammetry, for the collinearity equations; Abdel-Aziz and Karara 1971 for the DLT
that the camera is written as. Priors, grid and the robust principal point are termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.equations import weights_of
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.scaling import Scaling, metres_of
from termsel.data.view import CentralView

EXPECTED_FOCAL, FOCAL_LOG_DEVIATION = 1.8, 0.7
"""Focal length by the half diagonal of the image, and the standard deviation of its logarithm: from
a wide angle of 24 mm to a telephoto lens of 150 mm before film of 36 mm by 24."""

KNOWN_MIDDLE_SCALE = 0.01
"""Scale of the prior of the principal point about the middle of an image of known size, by its half
diagonal."""

UNKNOWN_MIDDLE_SCALE = 0.3
"""The same about the middle of the control, by its half extent, where the size is not known."""

MIN_NOISE = 0.5
"""Least standard deviation of a measurement in the image [px], by which priors are weighed."""

PINHOLE_MIN_POINTS = 4
"""Points that determine a camera, with its priors, and leave an equation."""

_AZIMUTHS = np.radians(np.arange(0.0, 360.0, 22.5))
_DEPRESSIONS = np.radians([4.0, 15.0, 30.0, 50.0, 75.0])
_ROLLS = np.radians([0.0, 90.0, 180.0, 270.0])
_FOCALS = (0.8, 1.6, 3.2, 6.4)

KNOWN_FOCAL_SPREAD = 0.5 * float(np.log(2.0))
"""Standard deviation of the logarithm of the focal length below which one start is enough: half the
step between the focal lengths that are tried else."""

_STABLE_DIAGONAL = 1e-12
"""What is added to the diagonal of normal matrices, so that points in one place stop neither the
grid nor the steps."""

_N_STARTS, _FIRST_STEPS, _N_FURTHER = 12, 6, 3
"""Starts that are improved, by how many steps, and how many of them further."""

_CAMERA_STEPS, _REFIT_STEPS = 40, 10
_ROUNDS, _ROUNDS_IF_NORMAL = 12, 3
_CONVERGED_GAIN, _MAX_DAMPING = 1e-5, 1e2
"""Part of the cost by which steps have converged, and the damping beyond which none helps."""

_FIRST_DAMPING, _DAMPING_RANGE = 1e-3, (1e-12, 1e8)
"""The damping that steps begin with, and its limits, lest it underflow or overflow."""

_ROUGH_NOISE = 10.0
"""Noise of the first steps by the least, so that a blunder does not drive them."""


@dataclass(frozen=True, eq=False)
class Cameras:
    """Some cameras: rotations (s, 3, 3), shifts -R C (s, 3), focal lengths (s,), middles (s, 2).

    The rows of a rotation are the directions of lines, samples and the view. All is in units of the
    scaled image and of a level ground that is scaled alike along its axes.
    """

    rotation: FloatArray
    shift: FloatArray
    focal: FloatArray
    middle: FloatArray

    def __len__(self) -> int:
        return len(self.focal)

    def take(self, indices: IntArray) -> Cameras:
        """Return some of the cameras."""
        return Cameras(self.rotation[indices], self.shift[indices], self.focal[indices],
                       self.middle[indices])

    def in_camera_axes(self, ground: FloatArray) -> FloatArray:
        """Return the ground (n, 3) in the axes of the cameras, (s, n, 3)."""
        # q = R X + t.
        return np.asarray(ground @ self.rotation.transpose(0, 2, 1) + self.shift[:, None])

    def image(self, ground: FloatArray) -> FloatArray:
        """Return where the ground (n, 3) is seen, (s, n, 2); NaN behind a camera."""
        # x = c + f (q1, q2) / q3.
        q = self.in_camera_axes(ground)
        depth = np.where(q[..., 2:] > 0.0, q[..., 2:], np.nan)
        return np.asarray(self.middle[:, None] + self.focal[:, None, None] * q[..., :2] / depth)

    def slopes(self, ground: FloatArray) -> FloatArray:
        """Return derivatives of the image by 9 unknowns, (s, n, 2, 9).

        These are a small turn about the axes, the shift, the logarithm of the focal length, and the
        principal point: dq = turn x q + dshift, of the part of q without the shift.
        """
        q = self.in_camera_axes(ground)
        turned = q - self.shift[:, None]
        focal = self.focal[:, None, None]
        ratios = q[..., :2] / q[..., 2:]
        # d(q1 / q3) = (dq1 - q1 / q3 dq3) / q3, likewise of q2.
        by_place = np.zeros((*q.shape[:2], 2, 3))
        by_place[..., 0, 0] = by_place[..., 1, 1] = 1.0
        by_place[..., 2] = -ratios
        by_place *= (focal / q[..., 2:])[..., None]
        slopes = np.zeros((*q.shape[:2], 2, 9))
        # turn x v = -v x turn: the columns are -v x e.
        slopes[..., :3] = np.cross(turned[:, :, None, :], by_place)
        slopes[..., 3:6] = by_place
        # The focal length is exp of its unknown, so that it stays positive: dx / dlog f = f q / q3.
        slopes[..., 6] = focal * ratios
        slopes[..., 0, 7] = slopes[..., 1, 8] = 1.0
        return slopes

    @property
    def position(self) -> FloatArray:
        """Places of the cameras, C = -R' t, (s, 3)."""
        return np.asarray(-np.einsum("sji,sj->si", self.rotation, self.shift))

    @property
    def slopes_of_position(self) -> FloatArray:
        """Derivatives of the places by turns and shifts, (s, 3, 6).

        With R turned to (1 + [turn]) R: dC = R' (turn x t) - R' dshift, and turn x t = -[t] turn.
        """
        transposed = self.rotation.transpose(0, 2, 1)
        x, y, z = self.shift.T
        none = np.zeros_like(x)
        crossed = -np.stack([np.stack([none, -z, y], 1), np.stack([z, none, -x], 1),
                             np.stack([-y, x, none], 1)], axis=1)
        return np.concatenate([transposed @ crossed, -transposed], axis=2)

    def moved(self, step: FloatArray) -> Cameras:
        """Return the cameras moved by steps of the unknowns (s, 9)."""
        # Turns are small rotations in front of R, and the step of log f is limited: a quadratic
        # model holds no further.
        return Cameras(rotation_matrices(step[:, :3]) @ self.rotation, self.shift + step[:, 3:6],
                       self.focal * np.exp(np.clip(step[:, 6], -1.0, 1.0)),
                       self.middle + step[:, 7:])


@dataclass(frozen=True, eq=False)
class Measured:
    """Control points, scaled, with what is known of the camera beforehand.

    Errors of measurements are normal, or have Student's distribution with `tails` degrees of
    freedom: then a few wild points hardly count (Lange, Little and Taylor 1989).
    """

    ground: FloatArray  # (n, 3), scaled alike along its axes
    image: FloatArray  # (n, 2)
    weights: FloatArray  # (n, 2)
    middle: FloatArray  # (2,): where the principal point is expected
    reach: float  # scale of its prior
    focal: float  # expected
    unit: FloatArray  # (3,): of the scaled ground, by that of `ground`
    noise: float  # least standard deviation of a measurement
    # Standard deviation of the logarithm of the focal length.
    focal_spread: float = FOCAL_LOG_DEVIATION
    place: FloatArray | None = None  # (3,): expected of the camera; NaN where not known
    place_spread: FloatArray | None = None  # (3,): its standard deviations
    tilt: float = np.inf  # scale of the prior of the view's sine off the vertical
    tails: float = np.inf
    unknowns: int = 7  # that residuals are less for
    usual: float = 0.0  # standard deviation of a measurement as it usually is
    experience: float = 0.0  # degrees of freedom that it counts as

    @property
    def is_focal_known(self) -> bool:
        """Whether the focal length is known well enough to start from it alone."""
        return self.focal_spread < KNOWN_FOCAL_SPREAD

    @cached_property
    def _key(self) -> tuple[float | bytes, ...]:
        return tuple(value.tobytes() if isinstance(value, np.ndarray) else value
                     for value in (getattr(self, member.name) for member in fields(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Measured) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def prior(self, cameras: Cameras) -> tuple[FloatArray, FloatArray]:
        """Return the residuals of p priors for s cameras, (s, p), and their robust weights, (s, p).

        The priors are those of log f, the middle, the tilt and the place, as far as there are any.

        The middle and the tilt have Cauchy distributions, whose minus logarithm is that of 1 + d^2.
        The costs have it twice: their derivative 4 d / (1 + d^2) is that of w d^2 with the weight
        w = 2 / (1 + d^2).
        """
        offsets = (cameras.middle - self.middle) / self.reach
        residuals = np.column_stack(
            [np.log(cameras.focal / self.focal) / self.focal_spread, offsets])
        if np.isfinite(self.tilt):
            residuals = np.column_stack([residuals, cameras.rotation[:, 2, :2] / self.tilt])
        if self.place is not None and self.place_spread is not None:
            departure = (cameras.position - self.place) / self.place_spread
            # Where nothing is expected of a coordinate, it has no residual.
            residuals = np.column_stack([residuals, np.nan_to_num(departure)])
        weights = np.ones_like(residuals)
        weights[:, 1:3] = 2.0 / (1.0 + (offsets**2).sum(axis=1, keepdims=True))
        tilts = residuals[:, self._tilts]
        weights[:, self._tilts] = 2.0 / (1.0 + (tilts**2).sum(axis=1, keepdims=True))
        return residuals, weights

    @property
    def _tilts(self) -> slice:
        """Columns of the priors that are of the tilt."""
        return slice(3, 5 if np.isfinite(self.tilt) else 3)

    def counting(self, squares: FloatArray, sigma: float) -> tuple[FloatArray, FloatArray]:
        """Return the losses of squared errors (..., n), and the weights of these errors.

        A loss is -2 log likelihood but for a constant. Under Student's distribution of t degrees of
        freedom in two dimensions it is (t + 2) log(1 + e^2 / (t s^2)), with the weight
        (t + 2) / (t + e^2 / s^2); under the normal distribution e^2 / s^2, with the weight 1.
        """
        relative_squares = squares / sigma**2
        t = self.tails
        if not np.isfinite(t):
            return relative_squares, np.ones_like(relative_squares)
        return ((t + 2.0) * np.log1p(relative_squares / t),
                (t + 2.0) / (t + relative_squares))

    def sigma_of(self, residuals: FloatArray, previous: float) -> float:
        """Return the standard deviation of a measurement, from residuals (n, 2) and experience.

        `previous` is the value taken so far, by which wild residuals are told.
        """
        squares = ((residuals * self.weights) ** 2).sum(axis=1)
        _, weights = self.counting(squares, previous)
        least_redundancy = 0 if self.experience else 1
        freedom = self.experience + max(2 * len(residuals) - self.unknowns, least_redundancy)
        # A scaled inverse chi-squared prior counts as so many residuals of the usual size.
        total = self.experience * self.usual**2 + float((weights * squares).sum())
        return max(float(np.sqrt(total / freedom)), self.noise)

    def costs(self, cameras: Cameras, rows: FloatArray, sigma: float) -> FloatArray:
        """Return -2 log posterior of each camera, but for a constant, shape (s,).

        It is infinite for a camera with points behind it. Else it is the sum over the points that
        count (`rows` (s, n) above 0) of their losses, and of the priors of focal length, principal
        point, tilt and position. `sigma` is the standard deviation of a measurement, in the unit of
        `image`.
        """
        residuals = (self.image - cameras.image(self.ground)) * self.weights
        losses, _ = self.counting((residuals**2).sum(axis=2), sigma)
        prior_residuals, _ = self.prior(cameras)
        # Focal length: normal. Principal point and tilt: Cauchy. Position: normal.
        total = (np.where(rows > 0.0, losses, 0.0).sum(axis=1) + prior_residuals[:, 0]**2
                 + 2.0 * np.log1p((prior_residuals[:, 1:3]**2).sum(axis=1))
                 + 2.0 * np.log1p((prior_residuals[:, self._tilts]**2).sum(axis=1))
                 + (prior_residuals[:, self._tilts.stop:]**2).sum(axis=1))
        return np.where(np.isfinite(total), total, np.inf)

    def system(self, cameras: Cameras, rows: FloatArray,
               sigma: float) -> tuple[FloatArray, FloatArray]:
        """Return the design (s, 2 n + p, 9) and residuals (s, 2 n + p), both by their deviations.

        The first 2 n rows are of the n points, the others of the p priors. `rows` (s, n) are the
        weights of the points for each camera, 0 for those that do not count, and `sigma` is the
        standard deviation of a measurement, in the unit of `image`.
        """
        count = len(cameras)
        residuals = self.image - cameras.image(self.ground)
        _, weights = self.counting(((residuals * self.weights) ** 2).sum(axis=2), sigma)
        # Each row is divided by its deviation, so that the sum of squares is the cost to second
        # order.
        factor = (rows * np.sqrt(weights))[:, :, None] * self.weights / sigma
        slopes = cameras.slopes(self.ground) * factor[..., None]
        residuals = residuals * factor
        prior_residuals, weights = self.prior(cameras)
        root = np.sqrt(weights)
        priors = np.zeros((count, prior_residuals.shape[1], 9))
        priors[:, 0, 6] = 1.0 / self.focal_spread
        priors[:, 1, 7] = priors[:, 2, 8] = 1.0 / self.reach
        if np.isfinite(self.tilt):
            # Row 3 of [turn] R is turn_1 times row 2, less turn_2 times row 1.
            priors[:, self._tilts, 0] = cameras.rotation[:, 1, :2] / self.tilt
            priors[:, self._tilts, 1] = -cameras.rotation[:, 0, :2] / self.tilt
        if self.place is not None and self.place_spread is not None:
            priors[:, self._tilts.stop:, :6] = np.nan_to_num(
                cameras.slopes_of_position / self.place_spread[:, None])
        design = np.concatenate([slopes.reshape(count, -1, 9), priors * root[..., None]], axis=1)
        return design, np.concatenate([residuals.reshape(count, -1), -prior_residuals * root],
                                      axis=1)

    def descended(self, cameras: Cameras, rows: FloatArray, sigma: float,
                  steps: int = _CAMERA_STEPS) -> tuple[Cameras, FloatArray]:
        """Return the cameras where damped steps from s cameras end, and their costs (s,).

        It is the method of Levenberg (1944) and Marquardt (1963) for many cameras at once:
        (N + d diag N) x = r, with the damping d of each camera divided by ten after a better step
        and multiplied by ten after a worse one. `rows` (s, n) is 1 for the points that a camera is
        fitted to and 0 for others; `sigma` is the standard deviation of a measurement, scaled.
        """
        costs = self.costs(cameras, rows, sigma)
        damping = np.full(len(cameras), _FIRST_DAMPING)
        for _ in range(steps):
            design, residuals = self.system(cameras, rows, sigma)
            # A camera with points behind it has no residuals, and makes no step.
            finite = np.asarray(np.isfinite(residuals).all(axis=1))
            design = np.where(finite[:, None, None], design, 0.0)
            residuals = np.where(finite[:, None], residuals, 0.0)
            normal = np.einsum("sri,srj->sij", design, design)
            diagonal = np.einsum("sii->si", normal) + np.finfo(float).tiny
            right = np.einsum("sri,sr->si", design, residuals)
            damped = normal + np.einsum(
                "si,ij->sij", damping[:, None] * diagonal + _STABLE_DIAGONAL, np.eye(9))
            stepped = cameras.moved(np.linalg.solve(damped, right[..., None])[..., 0])
            stepped_costs = self.costs(stepped, rows, sigma)
            is_better = stepped_costs < costs
            gain = np.where(is_better, costs - stepped_costs, 0.0)
            # Each camera goes on or stays on its own, as one that diverges must not stop others.
            cameras = _choose_cameras(is_better, stepped, cameras)
            damping = np.where(is_better, damping / 10.0, damping * 10.0).clip(*_DAMPING_RANGE)
            is_finished = ((gain < _CONVERGED_GAIN * (1.0 + stepped_costs))
                           & (is_better | (damping >= _MAX_DAMPING)))
            costs = np.where(is_better, stepped_costs, costs)
            if is_finished.all():
                break
        return cameras, costs


@dataclass(frozen=True, eq=False)
class Pinhole:
    """The camera that control points support, in scaled coordinates.

    Parameters
    ----------
    camera : Cameras
        The one camera.
    measured : Measured
    sigma : float
        Standard deviation of a measurement of unit weight.
    errors : ndarray, shape (n, 2)
        Measured minus predicted of each point, by the camera without it.
    residuals : ndarray, shape (n, 2)
    effective : float
        Trace of the matrix that turns measurements into what is fitted.
    """

    camera: Cameras
    measured: Measured
    sigma: float
    errors: FloatArray
    residuals: FloatArray
    effective: float

    @property
    def matrix(self) -> FloatArray:
        """The projection of 1, X, Y and Z: numerators of line and sample, denominator, (3, 4)."""
        rotation = self.camera.rotation[0] * self.measured.unit
        columns = np.column_stack([self.camera.shift[0], rotation])
        # Numerators are f q + c q3, the denominator is q3.
        middle = np.append(self.camera.middle[0], 0.0)
        return np.asarray(columns * np.array([[self.camera.focal[0]]] * 2 + [[1.0]])
                          + np.outer(np.append(middle[:2], 0.0), columns[2]))

    @property
    def view(self) -> CentralView:
        """The camera as a view of scaled places."""
        return CentralView(self.matrix, self.measured.ground / self.measured.unit, self.sigma,
                           self.sigma)

    def factors(self, ground: FloatArray) -> FloatArray:
        """Return factors F (m, 2, 9) of the covariance F F' of the image of scaled places (m, 3).
        """
        design, _ = self.measured.system(self.camera, np.ones((1, len(self.measured.image))),
                                         self.sigma)
        # With R of the design's QR the covariance is (R' R)^-1, so that factors are slopes by R^-1.
        _, r = np.linalg.qr(design[0])
        slopes = self.camera.slopes(ground * self.measured.unit)[0]
        return np.asarray(np.linalg.solve(r.T, slopes.reshape(-1, 9).T).T.reshape(slopes.shape))


def pinhole_of(scaled: FeatureSet, scaling: Scaling) -> Pinhole | None:
    """Return the camera of scaled control points.

    Returns None with few points, with lines, or if no camera has all points in front. Heights that
    are not known, or all the same, are those of level ground.
    """
    measured = _camera_points(scaled, scaling)
    if measured is None or len(measured.image) < PINHOLE_MIN_POINTS:
        return None
    return camera_of(measured)


def pinhole_near(camera: Pinhole, scaled: FeatureSet, scaling: Scaling) -> Pinhole | None:
    """Return the camera of other control points that is nearest to a given camera.

    Few points may allow several cameras, far from each other. The points are in the scaled
    coordinates of the camera. Returns None where a camera cannot be fitted to such points, or has
    some of them behind it.
    """
    measured = _camera_points(scaled, scaling)
    return None if measured is None else camera_next_to(measured, camera.camera)


@lru_cache(maxsize=32)  # a fit, its errors and its spread need it
def camera_of(measured: Measured) -> Pinhole | None:
    """Return the camera of control points, None if no camera has all of them in front.

    It is cached, since a run asks for the same one many times.
    """
    cameras = cameras_of(measured)
    return camera_next_to(measured, cameras.take(np.arange(1))) if len(cameras) else None


def cameras_of(measured: Measured) -> Cameras:
    """Return up to _N_FURTHER cameras that control points may support, the best first; or none."""
    everything = np.ones((1, len(measured.image)))
    candidates = _grid_search_cameras(measured)
    costs = np.zeros(len(candidates))
    # Many starts for few steps, then the best for many: most starts lead to the same camera.
    for count, steps in ((_N_STARTS, _FIRST_STEPS), (_N_FURTHER, _CAMERA_STEPS)):
        if not len(candidates):  # every camera has a point behind it
            break
        candidates = candidates.take(np.arange(min(count, len(candidates))))
        rows = np.repeat(everything, len(candidates), axis=0)
        candidates, costs = measured.descended(candidates, rows, _ROUGH_NOISE * measured.noise,
                                               steps)
        candidates = candidates.take(np.argsort(costs, kind="stable"))
    return candidates.take(np.arange(np.isfinite(costs).sum()))


def camera_next_to(measured: Measured, camera: Cameras) -> Pinhole | None:
    """Return the camera of control points to which steps from a given camera lead.

    Returns None where it has a point behind it.
    """
    everything = np.ones((1, len(measured.image)))
    sigma = measured.noise
    for _ in range(_ROUNDS if np.isfinite(measured.tails) else _ROUNDS_IF_NORMAL):
        # The noise says how much the priors count, and they how much is left.
        camera, costs = measured.descended(camera, everything, sigma)
        residuals = measured.image - camera.image(measured.ground)[0]
        if not np.isfinite(costs).all():
            return None
        sigma = measured.sigma_of(residuals, sigma)
    design, _ = measured.system(camera, everything, sigma)
    q = np.linalg.qr(design[0])[0]
    # The trace of the projection onto the design, over the rows of measurements.
    effective = float((q[:2 * len(measured.image)] ** 2).sum())
    errors = _held_out_errors(measured, camera, sigma)
    return Pinhole(camera, measured, sigma, errors, residuals, effective)


def _held_out_errors(measured: Measured, camera: Cameras, sigma: float) -> FloatArray:
    """Return the errors of points (n, 2), each by the camera without it.

    These cameras are found by steps from the camera of all points.
    """
    n = len(measured.image)
    # Row i leaves point i out: all n cameras descend at once from that of all points.
    rows = 1.0 - np.eye(n)
    cameras, _ = measured.descended(camera.take(np.zeros(n, dtype=np.intp)), rows, sigma,
                                    _REFIT_STEPS)
    predicted = cameras.image(measured.ground)[np.arange(n), np.arange(n)]
    return np.asarray(measured.image - predicted)


def _camera_points(scaled: FeatureSet, scaling: Scaling) -> Measured | None:
    """Return scaled control points as a camera is fitted to them; None where none can be."""
    metres = metres_of(scaled, scaling)
    if metres is None or len(scaled.lines):
        return None
    points = scaled.points
    # The same unit along all axes: a camera does not know that a map is scaled.
    unit = metres / metres[:2].max()
    weights = weights_of(points)
    size = scaled.image_size
    # Scaled control has its middle at 0 and reaches to 1: that stands for an unknown image.
    if size is None:
        middle = np.zeros(2)
        half = 1.0
        reach = UNKNOWN_MIDDLE_SCALE
    else:
        middle = scaling.image((np.array(size) - 1.0) / 2.0)
        half = float(np.linalg.norm(size)) / 2.0 / scaling.image_scale
        reach = KNOWN_MIDDLE_SCALE * half
    return Measured(points.ground * unit, points.image, weights, middle, reach,
                    EXPECTED_FOCAL * half, unit, MIN_NOISE / scaling.image_scale)


def _grid_search_cameras(measured: Measured) -> Cameras:
    """Return up to _N_STARTS cameras of a grid, those with the least squared errors, best first.

    Cameras of the grid look at the points from above. Each is in the place that suits the points,
    and has all of them in front.
    """
    expected = measured.focal * (
        np.ones(1) if measured.is_focal_known else np.array(_FOCALS) / EXPECTED_FOCAL)
    rotations = _grid_of_rotations(mirrored=_is_mirrored(measured))
    focal = np.repeat(expected, len(rotations))
    rotation = np.tile(rotations, (len(expected), 1, 1))
    shift = _shifts_by_equations(measured, rotation, focal)
    cameras = Cameras(rotation, shift, focal, np.tile(measured.middle, (len(focal), 1)))
    # A start may have points behind it that better ones have not.
    costs = ((measured.image - cameras.image(measured.ground)) ** 2).sum(axis=2).mean(axis=1)
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")[:_N_STARTS]
    return cameras.take(order[np.isfinite(costs[order])])


def _shifts_by_equations(measured: Measured, rotation: FloatArray, focal: FloatArray) -> FloatArray:
    """Return the shifts t (s, 3) of cameras, by least squares of equations that are linear in them.

    With q = v + t, where v is the ground turned by the rotation (s, 3, 3), and the offset d of a
    point from the principal point, f q1 = d1 q3 is f t1 - d1 t3 = d1 v3 - f v1; likewise for d2.
    """
    turned = measured.ground @ rotation.transpose(0, 2, 1)                     # (s, n, 3): v
    offsets = measured.image - measured.middle                                 # (n, 2): d
    design = np.zeros((len(focal), len(offsets), 2, 3))
    design[..., 0, 0] = design[..., 1, 1] = focal[:, None]
    design[..., 2] = -offsets
    right = offsets * turned[..., 2:] - focal[:, None, None] * turned[..., :2]
    rows = design.reshape(len(focal), -1, 3)
    normal = np.einsum("sri,srj->sij", rows, rows) + _STABLE_DIAGONAL * np.eye(3)
    products = np.einsum("sri,sr->si", rows, right.reshape(len(focal), -1))
    return np.asarray(np.linalg.solve(normal, products[..., None])[..., 0])


def _is_mirrored(measured: Measured) -> bool:
    """Return whether the image is mirrored: then lines, samples and the view are left-handed."""
    columns = np.column_stack([np.ones(len(measured.image)), measured.ground[:, :2]])
    # The determinant of the affine map from ground to image shows its handedness.
    slopes = np.linalg.lstsq(columns, measured.image)[0][1:]
    return bool(np.linalg.det(slopes) < 0.0)


@lru_cache(maxsize=2)  # a table without data
def _grid_of_rotations(*, mirrored: bool) -> FloatArray:
    """Return rotations of cameras that look down by some angle in all directions, (s, 3, 3)."""
    rotations = []
    # A grid that is finer than the steps converge from: 22.5 degrees in azimuth.
    for azimuth in _AZIMUTHS:
        for depression in _DEPRESSIONS:
            ahead = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
            # Axes of a camera whose sample axis is level; a roll then turns it about its view.
            view = np.cos(depression) * ahead - np.sin(depression) * np.array([0.0, 0.0, 1.0])
            right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
            down = np.cross(view, right)
            for roll in _ROLLS:
                line = np.cos(roll) * down + np.sin(roll) * right
                sample = np.cos(roll) * right - np.sin(roll) * down
                rotations.append([line, -sample if mirrored else sample, view])
    grid = np.array(rotations)
    grid.setflags(write=False)
    return grid


def rotation_matrices(turn: FloatArray) -> FloatArray:
    """Return the rotations by vectors (s, 3), shape (s, 3, 3) (Rodrigues)."""
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    x, y, z = (turn / np.maximum(angle[:, 0], np.finfo(float).tiny)).T
    zero = np.zeros_like(x)
    cross = np.stack([np.stack([zero, -z, y], 1), np.stack([z, zero, -x], 1),
                      np.stack([-y, x, zero], 1)], axis=1)
    # Rodrigues: R = 1 + sin(a) K + (1 - cos(a)) K^2.
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _choose_cameras(condition: BoolArray, first: Cameras, second: Cameras) -> Cameras:
    """Return cameras (s,), each the first one where `condition` (s,) holds, else the second."""
    return Cameras(np.where(condition[:, None, None], first.rotation, second.rotation),
                   np.where(condition[:, None], first.shift, second.shift),
                   np.where(condition, first.focal, second.focal),
                   np.where(condition[:, None], first.middle, second.middle))
