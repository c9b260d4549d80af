"""Where nothing is matched: clouds, water, and polygons of a user."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from termsel import TermselError
from termsel.toolkit import open_layer
from termsel.toolkit.coordinates import plane_transformer
from termsel_match.images.rasters import FloatArray, GreyRaster, Mask, open_picture

log = logging.getLogger("termsel.match")

NONE = "none"
"""Name of a mask that is none: clouds and water are looked at, too."""

_LEARNED_SIDE = 400
"""Side of the reduced image from which thresholds are learned [px]."""

_MIN_SEPARATION = 0.75
"""Least share of the variance that lies between two classes, for them to be two."""

_CLOUD_BRIGHTNESS = 1.8
"""Least brightness of clouds in each visible band, divided by the median of the other pixels."""

_GREY = 0.25
"""Largest relative difference of these ratios between bands: clouds are grey."""

_WATER_DARKNESS = 0.6
"""Largest near infrared of water, divided by the median of the other pixels."""

_MIN_WIDTH = 9
"""Least width of a masked area [reduced px]: narrower ones are roofs and shadows."""

_MAX_DEGREES = np.array([360.0, 90.0])
"""Largest absolute longitude and latitude [deg]."""

_MIN_PART = 0.002
"""Share of the image below which a class is not masked."""

Excluded = Callable[[int, int, tuple[int, int], int], Mask]
"""A function that takes first line and sample of a window [px], its lines and samples in steps, and
the step [px], and returns where nothing is matched in it."""


@contextmanager
def open_masked(path: Path | str, band: int | None, masks: Sequence[Path | str],
                ) -> Iterator[GreyRaster]:
    """Open an image in which masked areas count as unknown.

    Parameters
    ----------
    path : path-like
        The image.
    band : int, optional
        See `open_picture`.
    masks : sequence of path-like
        Files of polygons. Here only those without a CRS count, which are in px of the image: x is
        the sample, y the line, or its negative as in QGIS. Without any file, clouds and water are
        masked as far as green and near infrared, or three visible bands, show them. The name "none"
        stands for no mask at all.

    Yields
    ------
    GreyRaster
        The brightness of the image, unknown in masked areas.

    Raises
    ------
    TermselError
        If a file cannot be read, or has no polygons.
    """
    with open_picture(path, band) as picture:
        excluded = []
        for name in masks:
            if str(name) == NONE:
                continue
            shapes, crs = read_polygons(name)
            if not crs:
                excluded.append(_windows_in_polygons([_polygon_in_pixels(shape)
                                                      for shape in shapes]))
        if not masks:
            excluded = list(mask_clouds_and_water(picture))
        yield replace(picture, excluded=tuple(excluded))


def read_polygons(path: Path | str) -> tuple[NDArray[Any], str]:
    """Return the polygons of a file, an array (n,) of shapely geometries, and their CRS.

    The CRS is "" if the polygons are in px of the image: in a file without a CRS, or with degrees
    beyond the globe. Raises TermselError if the file has no polygons, or a coordinate that is no
    number.
    """
    from pyproj import CRS

    meta, shapes, _ = open_layer(Path(path), None, ("Polygon", "MultiPolygon"), columns=[])
    if shapes is None:
        areas = np.empty(0, dtype=object)
    else:
        areas = shapes[(shapely.get_dimensions(shapes) == 2) & ~shapely.is_empty(shapes)]
    if not len(areas):
        raise TermselError("this mask has no polygons", file=path,
                           hint="Draw areas, and save them in a layer of polygons.")
    crs = str(meta["crs"] or "")
    areas = shapely.force_2d(areas)
    coordinates = shapely.get_coordinates(areas)
    if not np.isfinite(coordinates).all():
        raise TermselError("a polygon of this mask has a coordinate that is no number", file=path,
                           hint="Draw it again.")
    # A GeoJSON claims to be in degrees, also one that a GIS made of pixels.
    is_geographic = bool(crs) and CRS.from_user_input(crs).is_geographic
    if is_geographic and (np.abs(coordinates) > _MAX_DEGREES).any():
        crs = ""
    return areas, crs


def mask_from_ground(masks: Sequence[Path | str], crs: str, transform: Any) -> tuple[Excluded, ...]:
    """Return a function for each mask file that tells which pixels of a reference it masks.

    Parameters
    ----------
    masks : sequence of path-like
        Files of polygons; those without a CRS are left out.
    crs : str
        CRS of the reference.
    transform : affine.Affine
        Geotransform of the reference: from columns and rows to coordinates.

    Returns
    -------
    tuple of callable
        See `Excluded`; pixels are those of the reference.

    Raises
    ------
    TermselError
        If a file cannot be read, has no polygons, or cannot be converted to the CRS.
    """
    excluded = []
    for name in masks:
        if str(name) == NONE:
            continue
        shapes, mask_crs = read_polygons(name)
        if not mask_crs:
            continue
        turn = plane_transformer(mask_crs, crs)

        def to_px(coordinates: FloatArray, turn: Any = turn, name: Path | str = name) -> FloatArray:
            """Return columns and rows in the reference, (n, 2), of coordinates of a mask (n, 2).

            Raises TermselError where one cannot be converted to the CRS of the reference.
            """
            x, y = turn.transform(coordinates[:, 0], coordinates[:, 1])
            if not np.isfinite([x, y]).all():
                raise TermselError("polygons of this mask cannot be converted to the CRS of the "
                                   "reference", file=name,
                                   hint="Check their CRS, and draw them near the image.")
            return np.column_stack(~transform @ (np.asarray(x), np.asarray(y)))

        excluded.append(_windows_in_polygons([shapely.transform(shape, to_px) for shape in shapes]))
    return tuple(excluded)


def warn_of_idle_masks(masks: Sequence[Path | str], images: Sequence[Path | str],
                       references: Sequence[Path]) -> None:
    """Log a warning for each mask file whose polygons touch neither the image nor a reference.

    Parameters
    ----------
    masks : sequence of path-like
        See `open_masked`.
    images : sequence of path-like
        Images, which polygons in px should touch.
    references : sequence of path-like
        References, which polygons on the ground should touch.
    """
    for name in masks:
        if str(name) == NONE:
            continue
        shapes, crs = read_polygons(name)
        # Polygons with a CRS are on the ground, as references are; others are in px of the image.
        if crs:
            is_idle = not any(
                _touches_bounds(shapes, _bounds_in_crs(file, crs)) for file in references)
            target = "any reference"
        else:
            shapes = np.array([_polygon_in_pixels(shape) for shape in shapes])
            is_idle = not any(_touches_bounds(shapes, _bounds_in_crs(file)) for file in images)
            target = "the image"
        if is_idle:
            hint = (" Save polygons that are in px in a GeoPackage without a CRS: GeoJSON has "
                    "degrees." if crs else " Draw them in px of the image.")
            log.warning("Warning: the mask %s hides nothing: its polygons do not touch %s.%s",
                        name, target, hint)


def _bounds_in_crs(path: Path | str, crs: str = "") -> tuple[float, ...] | None:
    """Return the bounds of a raster in a CRS, or in px if `crs` is "".

    They are left, bottom, right, top; in px the least sample and line come first. None if the
    raster has no CRS, or its bounds cannot be transformed.
    """
    from rasterio.crs import CRS
    from rasterio.errors import CRSError
    from rasterio.warp import transform_bounds

    with open_picture(path) as picture:
        if not crs:
            return 0.0, 0.0, float(picture.size[1]), float(picture.size[0])
        raster = picture.raster
        if raster.crs is None:
            return None
        try:
            bounds = transform_bounds(raster.crs, CRS.from_user_input(crs), *raster.bounds)
        except CRSError:
            return None
    return tuple(bounds) if np.isfinite(bounds).all() else None


def _touches_bounds(shapes: NDArray[Any], bounds: tuple[float, ...] | None) -> bool:
    """Return whether any polygon touches bounds; True if the bounds are not known (None)."""
    return bounds is None or bool(shapely.intersects(shapes, shapely.box(*bounds)).any())


def _polygon_in_pixels(shape: Any) -> Any:
    """Return a polygon whose x is the sample and y the line, from one drawn over an image in a GIS.

    If all its y are negative, as QGIS draws an image without a CRS, their sign is changed.
    """
    coordinates = shapely.get_coordinates(shape)
    # QGIS puts such an image below the x axis, so that y goes from 0 to minus the lines.
    down = -1.0 if (coordinates[:, 1] <= 0).all() else 1.0
    return shapely.transform(shape, lambda xy: xy * [1.0, down])


def _windows_in_polygons(shapes: list[Any]) -> Excluded:
    """Return a function that tells which pixels of a window polygons touch (see `Excluded`).

    The polygons have columns and rows of the image, or of the reference, as x and y.
    """
    def rasterise(first_line: int, first_sample: int, shape: tuple[int, int], step: int) -> Mask:
        """Return which pixels of a window the polygons touch, (lines, samples)."""
        from rasterio.features import rasterize
        from rasterio.transform import Affine

        # From column and row of the window to sample and line of the image.
        window = Affine(step, 0, first_sample, 0, step, first_line)
        return np.asarray(rasterize(shapes, out_shape=shape, transform=window, all_touched=True,
                                    dtype="uint8") > 0)

    return rasterise


@dataclass(frozen=True)
class Bands:
    """Numbers of bands, counted from 1; 0 for none."""

    red: int
    green: int
    blue: int
    infrared: int


def bands_of(raster: Any) -> Bands:
    """Return which bands of a raster are red, green, blue and near infrared, as it states.

    Four bands of which nothing is stated are taken for blue, green, red and near infrared, the
    order of most satellites.
    """
    stated: dict[str, int] = {}
    for index, kind, text in zip(raster.indexes, raster.colorinterp, raster.descriptions,
                                 strict=True):
        words = {kind.name.lower(), *(text or "").lower().replace("-", " ").split()}
        for name, signs in (("red", {"red"}), ("green", {"green"}), ("blue", {"blue"}),
                            ("infrared", {"nir", "infrared", "nir1"})):
            if signs & words:
                stated.setdefault(name, index)
    if not stated and raster.count == 4:
        return Bands(3, 2, 1, 4)
    return Bands(*(stated.get(name, 0) for name in ("red", "green", "blue", "infrared")))


def mask_clouds_and_water(picture: GreyRaster) -> tuple[Excluded, ...]:
    """Return functions that tell where an image shows clouds or water; () if its bands show none.

    Water is what Otsu's threshold separates by the index (green - infrared) / (green + infrared),
    and clouds are what it separates by the darkest visible band. Either is masked only if the two
    classes differ clearly, and in the way that water or clouds do.

    References
    ----------
    Otsu 1979: A threshold selection method from gray-level histograms. IEEE Transactions on
    Systems, Man, and Cybernetics 9(1), 62-66. McFeeters 1996: The use of the normalized difference
    water index (NDWI). International Journal of Remote Sensing 17(7), 1425-1432.
    """
    bands = bands_of(picture.raster)
    excluded_areas = []
    # Thresholds are learned from a reduced image; the same threshold then holds for all windows.
    step = max(1, max(picture.size) // _LEARNED_SIDE)
    shape = picture.size[0] // step, picture.size[1] // step

    def mask_above_threshold(name: str, used: tuple[int, ...],
                             index: Callable[[FloatArray], FloatArray],
                             likely: Callable[[FloatArray, Mask, Mask], bool]) -> None:
        """Mask the pixels above Otsu's threshold of an index, if they are likely to be a class.

        A function of them is added to `excluded_areas`, and a note says how much of the image it
        is.

        `name` is that of the class, and `used` are the numbers of the bands. `index` takes their
        values (c, lines, samples) and returns one value for each pixel. `likely` takes the same
        values and the masks of the pixels above and below the threshold.
        """
        of_bands = replace(picture, bands=used)
        values, is_known = read_bands(of_bands, 0, 0, shape, step)
        if not is_known.any():
            return
        limit, separation = otsu_threshold(index(values)[is_known])
        high = is_known & (index(values) > limit)
        # Otsu's method divides any image in two: most have no such class.
        if (
            separation < _MIN_SEPARATION
            or high.mean() < _MIN_PART
            or not likely(values, high, is_known & ~high)
        ):
            return
        log.info("Note: %.0f %% of the image is %s, where nothing is matched (--mask none).",
                 100 * _wide_areas(high).mean(), name)

        def excluded(first_line: int, first_sample: int, shape: tuple[int, int], step: int) -> Mask:
            """Return which pixels of a window are of this class."""
            values, is_known = read_bands(of_bands, first_line, first_sample, shape, step)
            return _wide_areas(is_known & (index(values) > limit))

        excluded_areas.append(excluded)

    visible = tuple(band for band in (bands.red, bands.green, bands.blue) if band)
    if bands.green and bands.infrared:
        # Water is dark in the near infrared, which vegetation and soil are not.
        def is_water(values: FloatArray, water: Mask, land: Mask) -> bool:
            """Return whether one class is much darker in the near infrared than the other."""
            return bool(np.median(values[1][water]) < _WATER_DARKNESS * np.median(values[1][land]))

        # NDWI = (green - infrared) / (green + infrared).
        mask_above_threshold("water", (bands.green, bands.infrared), lambda values: np.asarray(
            (values[0] - values[1]) / np.maximum(values[0] + values[1], 1e-6)), is_water)
    if len(visible) == 3:
        # Clouds are brighter than the ground in all visible bands, and about alike in each: grey.
        def is_cloud(values: FloatArray, cloud: Mask, land: Mask) -> bool:
            """Return whether one class is much brighter than the other, and grey."""
            medians = np.array([np.median(value[cloud]) / max(float(np.median(value[land])), 1e-6)
                                for value in values])
            return bool(medians.min() > _CLOUD_BRIGHTNESS
                        and medians.max() - medians.min() < _GREY * medians.max())

        mask_above_threshold("cloud", visible, lambda values: np.asarray(values.min(axis=0)),
                             is_cloud)
    return tuple(excluded_areas)


def read_bands(picture: GreyRaster, first_line: int, first_sample: int, shape: tuple[int, int],
               step: int) -> tuple[FloatArray, Mask]:
    """Return the values of a window's bands, (c, lines, samples), and where all bands have data.

    `shape` has the lines and samples that come back, each the mean of `step` px.
    """
    windows = [replace(picture, bands=(band,), excluded=()).read(
        first_line, first_sample, shape[0] * step, shape[1] * step, step) for band in picture.bands]
    return (np.stack([window[0] for window in windows]).astype(np.float64),
            np.logical_and.reduce([is_known for _, is_known in windows]))


def otsu_threshold(values: FloatArray) -> tuple[float, float]:
    """Return the threshold that divides values (n,) in two classes, by Otsu's method.

    The second is the share of the variance of the values that lies between the classes: 0 if all
    values are alike, and 1 if each class has one value.
    """
    # Otsu: with the mean m of all, the share t of the values below a threshold and their sum m_t,
    # the variance between both classes is (m t - m_t)^2 / (t (1 - t)); it is to be largest.
    count, edges = np.histogram(values, 256)
    middle = (edges[1:] + edges[:-1]) / 2
    share = count / count.sum()
    below = share.cumsum()
    mean = (share * middle).cumsum()
    total = mean[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (total * below - mean) ** 2 / (below * (1 - below))
    between = np.where(np.isfinite(between), between, 0)
    best = int(between.argmax())
    variance = float((share * (middle - total) ** 2).sum())
    return float(edges[best + 1]), float(between[best] / variance) if variance > 0 else 0.0


def _wide_areas(mask: Mask) -> Mask:
    """Return the parts of a mask at least `_MIN_WIDTH` pixels wide, grown by half of that."""
    # Opening removes what is narrower than the square; dilation adds the blurred rim of a cloud.
    wide = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN,
                            np.ones((_MIN_WIDTH, _MIN_WIDTH), np.uint8))
    return np.asarray(cv2.dilate(wide, np.ones((_MIN_WIDTH, _MIN_WIDTH), np.uint8)) > 0)
