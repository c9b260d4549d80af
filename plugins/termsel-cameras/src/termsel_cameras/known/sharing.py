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

BESIDE, FOCALS_BESIDE = 1.12, 5
"""Factor up to which focal lengths are tried with each distortion, and how many."""

FIRST_STEPS, STEPS_OF_SIMPLEX = (0.03, 0.015), 60
"""Sides of the first simplex of log f and k1, and costs that it may ask for."""

UNLIKE = 4.0
"""Ratio of the residuals of a photo to the median from which on its points are doubted."""

PHOTOS_ALONE = 4
"""Photos that are asked for a focal length of their own."""

HELD = 1e-6
"""Relative standard deviation that holds a focal length where it is tried."""

UNKNOWN = np.array([0.1, 0.05])
"""Standard deviations of log f and of k1 where the cost is not bent upwards."""

WIDTHS = (0.02, 0.01)
"""Differences of log f and of k1 by which the cost is bent at first."""

FARTHEST, ROUNDS = 4.0, 6
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
        How many told it.
    residuals : tuple of float
        Those of each photo that was given [px]; NaN of one that was left out.
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
        If no photo shows the camera.
    """
    controls = [without_independent(photo) for photo in photos]
    tells = [len(photo.points) >= MIN_POINTS_OF_PHOTO and not photo.without_height()
             for photo in controls]
    data = [FitData.of(replace(photo, image_size=size))
            for photo, is_telling in zip(controls, tells, strict=True) if is_telling]
    if not data:
        fewest = f"{MIN_POINTS_OF_PHOTO} control points with heights"
        if any(len(photo.points) >= MIN_POINTS_OF_PHOTO for photo in photos):
            raise TermselError(f"no photo has {fewest}: the points have no heights",
                               hint="Add a column z, for example with heights from a DEM.")
        raise TermselError(f"no photo has {fewest}", hint="Measure more points in each photo.")
    flight = _Flight(data)
    longer = float(max(size))
    ends = (SHORTEST_FOCAL * longer, LONGEST_FOCAL * longer)
    if focal is not None:
        ends = (0.8 * focal, 1.25 * focal)
    step = (ends[1] / ends[0]) ** (1.0 / (FOCALS_TRIED - 1))
    best = flight.least(np.geomspace(*ends, FOCALS_TRIED), 0.0)
    best = flight.least(best * np.geomspace(1.0 / step, step, FOCALS_TRIED_NEAR), 0.0)
    # Oblique photos have sharp minima between places of the grid: each photo alone shows its own.
    # One that shows none has a focal length far outside of all that is tried.
    shown = [alone for alone in flight.focals_of_each(best) if _is_near(alone, ends)]
    best = flight.least(np.array([*shown, best]), 0.0, afresh=True)
    solution, covariance = _minimum_of_two_unknowns(
        lambda values: flight.penalised_cost(float(np.exp(values[0])), float(values[1])),
        flight.near_least(best))
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
    residuals[tells] = flight.residuals()
    return SharedCamera(shared_focal, spread, float(solution[1]), sigma, photos=len(data),
                        points=sum(len(photo) for photo in data),
                        residuals=tuple(residuals.tolist()))


def _is_near(focal: float, ends: tuple[float, float]) -> bool:
    """Return whether a focal length is within the ends of what is tried, or next to them."""
    return ends[0] / BESIDE <= focal <= ends[1] * BESIDE


def unlike_photos(names: Sequence[object], residuals: Sequence[float]) -> list[str]:
    """Return photos that a shared camera leaves far larger residuals of than of most, with these.

    Examples
    --------
    >>> unlike_photos(["a.csv", "b.csv", "c.csv", "d.csv"], [1.2, 60.0, 0.9, float("nan")])
    ['b.csv (60 px)']
    """
    usual = float(np.nanmedian(residuals))
    return [f"{name} ({residual:.2g} px)"
            for name, residual in zip(names, residuals, strict=True)
            if residual > UNLIKE * usual]


class _Flight:
    """Photos with the cameras that were found for them last, from which others are found."""

    def __init__(self, photos: Sequence[FitData]) -> None:
        self.photos = photos
        self.mirrored = [is_mirrored(photo) for photo in photos]
        self.cameras: list[Pinhole | None] = [None] * len(photos)

    def focals_of_each(self, focal: float) -> list[float]:
        """Return the focal lengths [px] that some of the photos show, each without the others."""
        focals = []
        for i, photo in enumerate(self.photos[:PHOTOS_ALONE]):
            measured = self._model_of_photo(
                i, focal, 0.0).measured(photo.scaled, photo.features.noise)
            camera = camera_of(replace(measured, focal_spread=FREE_FOCAL_SPREAD))
            if camera is not None:
                focals.append(float(camera.camera.focal[0]) * photo.scaling.image_scale)
        return focals

    def least(self, focals: FloatArray, k1: float, *, afresh: bool = False) -> float:
        """Return that of the focal lengths [px] whose cost is least.

        `afresh` looks for the camera of each photo anew, not next to the last one.

        Raises TermselError if none has one.
        """
        costs = []
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
        """Return the cost of all photos together, and the noise that they leave [px].

        Both are infinite if a photo has no camera of this focal length and distortion.
        """
        total = 0.0
        for i, photo in enumerate(self.photos):
            model = self._model_of_photo(i, focal, k1)
            camera = self._camera_of_photo(i, model.measured(photo.scaled, photo.features.noise))
            if camera is None:
                return np.inf, np.inf
            self.cameras[i] = camera
            rows = np.ones((1, len(photo)))
            # Twice the minus logarithm of the likelihood, whose size depends on the noise, too.
            total += (float(camera.measured.costs(camera.camera, rows, camera.sigma)[0])
                      + 4.0 * len(photo) * float(np.log(camera.sigma)))
        return total, float(np.median(self.residuals()))

    def residuals(self) -> list[float]:
        """Return the noise that the last cameras leave of each photo [px]."""
        return [camera.sigma * photo.scaling.image_scale
                for camera, photo in zip(self.cameras, self.photos, strict=True)
                if camera is not None]

    def penalised_cost(self, focal: float, k1: float) -> float:
        """Return the cost of all photos plus that of the distortion, which is expected to be small.
        """
        return self.cost(focal, k1)[0] + (k1 / USUAL_DISTORTION) ** 2

    def near_least(self, focal: float) -> FloatArray:
        """Return log f and k1 near those of the least cost, about a focal length of k1 = 0 [px].

        A distortion that is left out changes the focal length by up to a tenth: the least cost is
        at the end of a narrow, bent valley, so that neither is found with the other held.
        """
        tried = [(float(tried_focal), k1) for k1 in DISTORTIONS
                 for tried_focal in focal * np.geomspace(1.0 / BESIDE, BESIDE, FOCALS_BESIDE)]
        costs = [self.penalised_cost(*pair) for pair in tried]
        best_focal, best_k1 = tried[int(np.argmin(costs))]
        start = np.array([np.log(best_focal), best_k1])
        corners = start + np.array([[0.0, 0.0], [FIRST_STEPS[0], 0.0], [0.0, FIRST_STEPS[1]]])
        # Costs at k1 = 0 left cameras that differ: the valley is followed by a simplex.
        minimum = minimize(
            lambda values: self.penalised_cost(float(np.exp(values[0])), float(values[1])), start,
            method="Nelder-Mead", options={"initial_simplex": corners, "maxfev": STEPS_OF_SIMPLEX,
                                           "xatol": 1e-4, "fatol": 0.01})
        return np.asarray(minimum.x)

    def _model_of_photo(self, i: int, focal: float, k1: float) -> KnownFrame:
        """Return the model of a photo with a focal length and a distortion that are held."""
        photo = self.photos[i]
        size = photo.features.image_size
        assert size is not None
        line, sample = (np.array(size) - 1.0) / 2.0
        reach = REACH * float(np.hypot(*size)) / 2.0
        distortion = (k1, 0.0, 0.0, 0.0, 0.0)
        interior = Interior(focal, HELD, float(line), float(sample), reach, distortion)
        return KnownFrame.of(interior, mirrored=self.mirrored[i]).prepared(
            photo.scaling, photo.features.crs)

    def _camera_of_photo(self, i: int, measured: Measured) -> Pinhole | None:
        """Return the camera of the i-th photo; None if none has all points in front of it.

        It is looked for next to the last one, farther away as the focal length grows.
        """
        before = self.cameras[i]
        if before is None:
            return camera_of(measured)
        grown = measured.focal / before.camera.focal
        shift = before.camera.shift * np.array([1.0, 1.0, float(grown[0])])
        start = replace(before.camera, shift=shift, focal=np.array([measured.focal]))
        return camera_next_to(measured, start) or camera_of(measured)


def _minimum_of_two_unknowns(cost: Callable[[FloatArray], float],
                             start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where a cost of log f and k1 is least, and their covariance (2, 2).

    Newton steps by differences: a longer focal length and a distortion do nearly the same to a
    photo, so that neither can be found with the other held.
    """
    best = start
    least = cost(best)
    widths = np.array(WIDTHS)
    covariance = np.diag(UNKNOWN**2)
    for _ in range(ROUNDS):
        ahead = np.array([cost(best + step) for step in np.diag(widths)])
        behind = np.array([cost(best - step) for step in np.diag(widths)])
        along_diagonal = cost(best + widths)
        if np.isfinite([*ahead, *behind, along_diagonal]).all():
            slopes = (ahead - behind) / 2.0
            bends = np.diag(ahead + behind - 2.0 * least)
            bends[0, 1] = bends[1, 0] = along_diagonal - ahead.sum() + least
            if np.linalg.eigvalsh(bends)[0] > 0.0:
                # The cost is -2 log likelihood, so that its Hessian is twice the inverse of theirs.
                covariance = 2.0 * np.linalg.inv(bends) * np.outer(widths, widths)
                step = np.clip(-np.linalg.solve(bends, slopes), -FARTHEST, FARTHEST) * widths
                stepped = cost(best + step)
                if stepped < least:
                    best, least = best + step, stepped
                    if (np.abs(step) > widths).any():
                        continue
        widths = widths / 2.0
    return best, covariance
