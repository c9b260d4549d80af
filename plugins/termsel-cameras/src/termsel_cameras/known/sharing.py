"""The camera that photos of one flight share, from the control points of all.

For a focal length f and a radial distortion k1 each photo has its own best place and turn, and a
cost, twice the minus logarithm of its likelihood (see `Measured`). The sum of the costs over all
photos is the profile of f and k1: its least value is the shared camera, and where it is larger by
1, f is one standard deviation off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from termsel import FeatureSet, FitData, TermselError
from termsel.toolkit.models import Measured, Pinhole, camera_next_to, camera_of
from termsel_cameras.known.interior import REACH, Interior
from termsel_cameras.known.lens import FloatArray
from termsel_cameras.known.method import FREE_FOCAL_SPREAD, is_mirrored
from termsel_cameras.known.model import KnownFrame
from termsel_cameras.roles import without_independent

MIN_POINTS_OF_PHOTO = 4
"""Points of a photo from which on it says something of its camera."""

FOCALS_TRIED, FOCALS_TRIED_NEAR = 9, 7
"""Focal lengths that are tried at first, and about the best of them."""

SHORTEST_FOCAL, LONGEST_FOCAL = 0.4, 6.0
"""Least and largest focal length, by the longer side of the photo."""

DISTORTIONS = (-0.1, -0.05, -0.02, 0.0, 0.02, 0.05)
"""Radial distortions k1 that are tried."""

NEAR_FACTOR, FOCALS_PER_DISTORTION = 1.12, 5
"""Factor up to which focal lengths are tried with each distortion, and how many."""

FIRST_STEPS, STEPS_OF_SIMPLEX = (0.03, 0.015), 60
"""Sides of the first simplex of log f and k1, and costs that it may ask for."""

DOUBTFUL_RATIO = 4.0
"""Ratio of the residuals of a photo to the median from which on its points are doubted."""

PHOTOS_ALONE = 4
"""Photos that are asked for a focal length of their own."""

FIXED_FOCAL_SPREAD = 1e-6
"""Relative standard deviation that fixes a focal length at the value that is tried."""

UNKNOWN_SPREADS = np.array([0.1, 0.05])
"""Standard deviations of log f and of k1 where the cost is not bent upwards."""

FIRST_DIFFERENCES = (0.02, 0.01)
"""Differences of log f and of k1 by which the cost is bent at first."""

MAX_STEP, NEWTON_STEPS = 4.0, 6
"""Largest step, by these, and how many are taken."""

USUAL_DISTORTION = 0.03
"""Standard deviation of k1 beforehand."""


@dataclass(frozen=True)
class SharedCamera:
    """The camera of all photos.

    Parameters
    ----------
    focal : float
        [px].
    spread : float
        Relative standard deviation of it.
    k1 : float
        See `Lens`.
    sigma : float
        Root mean square of what its measurements leave, with robust weights [px].
    photos, points : int
        How many photos and control points the figures rest on.
    residuals : tuple of float
        The residuals of each photo that was given [px]; NaN for one that was left out.
    """

    focal: float
    spread: float
    k1: float
    sigma: float
    photos: int
    points: int
    residuals: tuple[float, ...] = ()


def shared_camera(photos: Sequence[FeatureSet], size: tuple[int, int],
                  focal: float | None = None) -> SharedCamera:
    """Return the camera that photos share, found from the control points of all.

    Parameters
    ----------
    photos : sequence of FeatureSet
        With heights, each of `MIN_POINTS_OF_PHOTO` points at least; others say nothing and are left
        out, as are independent check points.
    size : tuple of int
        Lines and samples of all photos.
    focal : float, optional
        Rough focal length [px].

    Raises
    ------
    TermselError
        If no photo has enough points with heights, if the points do not determine a focal length,
        or if with none all points are in front of the cameras.
    """
    controls = [without_independent(photo) for photo in photos]
    is_used = [len(photo.points) >= MIN_POINTS_OF_PHOTO and not photo.without_height()
               for photo in controls]
    data = [FitData.of(replace(photo, image_size=size))
            for photo, is_in_use in zip(controls, is_used, strict=True) if is_in_use]
    if not data:
        requirement = f"{MIN_POINTS_OF_PHOTO} control points with heights"
        if any(len(photo.points) >= MIN_POINTS_OF_PHOTO for photo in photos):
            raise TermselError(f"no photo has {requirement}: the points have no heights",
                               hint="Add a column z, or give a raster of heights: --dem FILE.")
        raise TermselError(f"no photo has {requirement}",
                           hint="Measure more points in each photo.")
    flight = _Flight(data)
    longer = float(max(size))
    ends = (SHORTEST_FOCAL * longer, LONGEST_FOCAL * longer)
    if focal is not None:
        ends = (0.8 * focal, 1.25 * focal)
    step = (ends[1] / ends[0]) ** (1.0 / (FOCALS_TRIED - 1))
    best = flight.focal_of_least_cost(np.geomspace(*ends, FOCALS_TRIED), 0.0)
    best = flight.focal_of_least_cost(best * np.geomspace(1.0 / step, step, FOCALS_TRIED_NEAR), 0.0)
    # Oblique photos have sharp minima, which the grid may miss: each of them shows its own focal
    # length. One far outside of all that are tried is no such minimum.
    single_focals = [focal_of_one for focal_of_one in flight.focals_of_each(best)
                     if _is_near(focal_of_one, ends)]
    best = flight.focal_of_least_cost(np.array([*single_focals, best]), 0.0, afresh=True)
    solution, covariance = _minimum_of_two_unknowns(
        lambda values: flight.penalised_cost(float(np.exp(values[0])), float(values[1])),
        flight.start_near_least(best))
    shared_focal = float(np.exp(solution[0]))
    if not _is_near(shared_focal, ends):
        if focal is None:
            remedy = "If so, give --focal PX, or photos taken obliquely or over hills."
        else:
            remedy = "If so, check --focal, which is in px."
        raise TermselError(
            "the points do not determine a focal length: none from "
            f"{ends[0]:,.0f} to {ends[1]:,.0f} px fits them best",
            hint="Check line and sample, and whether this is a photo of a frame camera. "
                 f"{remedy}")
    spread = float(np.clip(np.sqrt(covariance[0, 0]), 1e-4, 0.1))
    sigma = flight.cost(shared_focal, float(solution[1]))[1]
    residuals = np.full(len(photos), np.nan)
    residuals[is_used] = flight.residuals()
    return SharedCamera(shared_focal, spread, float(solution[1]), sigma, photos=len(data),
                        points=sum(len(photo) for photo in data),
                        residuals=tuple(residuals.tolist()))


def _is_near(focal: float, ends: tuple[float, float]) -> bool:
    """Return whether a focal length is within the ends of what is tried, or next to them."""
    return ends[0] / NEAR_FACTOR <= focal <= ends[1] * NEAR_FACTOR


def unlike_photos(names: Sequence[object], residuals: Sequence[float]) -> list[str]:
    """Return photos whose residuals with a shared camera are far above the median of all photos.

    Each is its name with the residual [px]. `residuals` are NaN for photos that were left out.

    Examples
    --------
    >>> unlike_photos(["a.csv", "b.csv", "c.csv", "d.csv"], [1.2, 60.0, 0.9, float("nan")])
    ['b.csv (60 px)']
    """
    usual = float(np.nanmedian(residuals))
    return [f"{name} ({residual:.2g} px)"
            for name, residual in zip(names, residuals, strict=True)
            if residual > DOUBTFUL_RATIO * usual]


class _Flight:
    """Photos with the cameras that were found for them last, from which others are found."""

    def __init__(self, photos: Sequence[FitData]) -> None:
        self.photos = photos
        self.mirrored = [is_mirrored(photo) for photo in photos]
        self.cameras: list[Pinhole | None] = [None] * len(photos)

    def focals_of_each(self, focal: float) -> list[float]:
        """Return the focal lengths [px] that the first `PHOTOS_ALONE` photos show by themselves.

        Each search begins at `focal` [px]. Photos that show none are left out.
        """
        focals = []
        for i, photo in enumerate(self.photos[:PHOTOS_ALONE]):
            measured = self._model_of_photo(
                i, focal, 0.0).measured(photo.scaled, photo.features.noise)
            camera = camera_of(replace(measured, focal_spread=FREE_FOCAL_SPREAD))
            if camera is not None:
                focals.append(float(camera.camera.focal[0]) * photo.scaling.image_scale)
        return focals

    def focal_of_least_cost(self, focals: FloatArray, k1: float, *, afresh: bool = False) -> float:
        """Return the one of the focal lengths (n,) [px] that has the least cost with a distortion.

        `k1` is the coefficient of the distortion. With `afresh` the camera of each photo is looked
        for anew for each focal length, not next to the last one. Raises TermselError if with none
        of them all photos have a camera.
        """
        costs = []
        # Infinite where a photo has no camera of this focal length.
        for focal in focals:
            if afresh:
                self.cameras = [None] * len(self.photos)
            costs.append(self.cost(float(focal), k1)[0])
        if afresh:
            self.cameras = [None] * len(self.photos)
        if not np.isfinite(costs).any():
            raise TermselError("with no focal length can the cameras see all control points",
                               hint="Check lines, samples and heights. A focal length that is "
                                    "given is in px: mm divided by the size of a pixel in mm.")
        return float(focals[int(np.argmin(costs))])

    def cost(self, focal: float, k1: float) -> tuple[float, float]:
        """Return the cost of all photos together, and the median of their noise [px].

        Both are infinite if a photo has no camera of this focal length and distortion. Otherwise
        the cameras that were found are kept, as starts for the next search.
        """
        total = 0.0
        for i, photo in enumerate(self.photos):
            model = self._model_of_photo(i, focal, k1)
            camera = self._camera_of_photo(i, model.measured(photo.scaled, photo.features.noise))
            if camera is None:
                return np.inf, np.inf
            self.cameras[i] = camera
            rows = np.ones((1, len(photo)))
            # Twice the minus logarithm of the likelihood of 2 n normal errors: their squares by
            # the variance, and 2 n log(variance) = 4 n log(sigma).
            total += (float(camera.measured.costs(camera.camera, rows, camera.sigma)[0])
                      + 4.0 * len(photo) * float(np.log(camera.sigma)))
        return total, float(np.median(self.residuals()))

    def residuals(self) -> list[float]:
        """Return the noise of each photo [px] with its last camera; photos without are left out."""
        return [camera.sigma * photo.scaling.image_scale
                for camera, photo in zip(self.cameras, self.photos, strict=True)
                if camera is not None]

    def penalised_cost(self, focal: float, k1: float) -> float:
        """Return the cost of all photos plus that of the distortion, which is expected to be small.
        """
        return self.cost(focal, k1)[0] + (k1 / USUAL_DISTORTION) ** 2

    def start_near_least(self, focal: float) -> FloatArray:
        """Return log f and k1 (2,) near the least cost, by a grid and a simplex.

        `focal` [px] is the best focal length without distortion. A distortion that is left out
        changes it by up to a tenth.
        """
        focals = focal * np.geomspace(1.0 / NEAR_FACTOR, NEAR_FACTOR, FOCALS_PER_DISTORTION)
        pairs = [(float(tried_focal), k1) for k1 in DISTORTIONS for tried_focal in focals]
        costs = [self.penalised_cost(*pair) for pair in pairs]
        best_focal, best_k1 = pairs[int(np.argmin(costs))]
        start = np.array([np.log(best_focal), best_k1])
        corners = start + np.array([[0.0, 0.0], [FIRST_STEPS[0], 0.0], [0.0, FIRST_STEPS[1]]])
        # The least cost is at the end of a narrow, bent valley, which a simplex follows; with one
        # of the two fixed the other would not be found.
        minimum = minimize(
            lambda values: self.penalised_cost(float(np.exp(values[0])), float(values[1])), start,
            method="Nelder-Mead", options={"initial_simplex": corners, "maxfev": STEPS_OF_SIMPLEX,
                                           "xatol": 1e-4, "fatol": 0.01})
        return np.asarray(minimum.x)

    def _model_of_photo(self, i: int, focal: float, k1: float) -> KnownFrame:
        """Return the model of the i-th photo, prepared for its control, with a fixed interior.

        `focal` is the focal length [px], and `k1` the radial distortion. The principal point is in
        the middle of the image, within a prior of `REACH` half diagonals.
        """
        photo = self.photos[i]
        size = photo.features.image_size
        assert size is not None
        line, sample = (np.array(size) - 1.0) / 2.0
        reach = REACH * float(np.hypot(*size)) / 2.0
        distortion = (k1, 0.0, 0.0, 0.0, 0.0)
        interior = Interior(
            focal, FIXED_FOCAL_SPREAD, float(line), float(sample), reach, distortion)
        return KnownFrame.of(interior, mirrored=self.mirrored[i]).prepared(
            photo.scaling, photo.features.crs)

    def _camera_of_photo(self, i: int, measured: Measured) -> Pinhole | None:
        """Return the camera of the i-th photo; None if none has all points in front of it.

        It is looked for next to the last one, and if there is none there, anew.
        """
        last = self.cameras[i]
        if last is None:
            return camera_of(measured)
        # With a longer focal length the camera is farther away, so that the scale is the same.
        ratio = measured.focal / last.camera.focal
        shift = last.camera.shift * np.array([1.0, 1.0, float(ratio[0])])
        start = replace(last.camera, shift=shift, focal=np.array([measured.focal]))
        return camera_next_to(measured, start) or camera_of(measured)


def _minimum_of_two_unknowns(cost: Callable[[FloatArray], float],
                             start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log f and k1 (2,) where a cost is least, and their covariance (2, 2).

    The search takes Newton's steps, with derivatives by differences. If the cost is nowhere convex
    the covariance is that of `UNKNOWN_SPREADS`.
    """
    best = start
    least_cost = cost(best)
    # Slopes and bends are counted by steps of these widths, and so have the unit of the cost.
    widths = np.array(FIRST_DIFFERENCES)
    covariance = np.diag(UNKNOWN_SPREADS**2)
    for _ in range(NEWTON_STEPS):
        ahead = np.array([cost(best + step) for step in np.diag(widths)])
        behind = np.array([cost(best - step) for step in np.diag(widths)])
        along_diagonal = cost(best + widths)
        if np.isfinite([*ahead, *behind, along_diagonal]).all():
            slopes = (ahead - behind) / 2.0
            bends = np.diag(ahead + behind - 2.0 * least_cost)
            bends[0, 1] = bends[1, 0] = along_diagonal - ahead.sum() + least_cost
            if np.linalg.eigvalsh(bends)[0] > 0.0:
                # The cost is -2 log likelihood: its Hessian is twice the inverse of the covariance.
                covariance = 2.0 * np.linalg.inv(bends) * np.outer(widths, widths)
                step = np.clip(-np.linalg.solve(bends, slopes), -MAX_STEP, MAX_STEP) * widths
                next_cost = cost(best + step)
                if next_cost < least_cost:
                    best = best + step
                    least_cost = next_cost
                    # Differences are halved only once the step is within them.
                    if (np.abs(step) > widths).any():
                        continue
        widths = widths / 2.0
    return best, covariance
