"""Heights from a raster, for files without heights."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel.core.arguments import explains_arguments
from termsel.core.errors import (
    GIS,
    TermselError,
    first_names_in_words,
    make_printable,
    require_import,
    rounded_size_text,
)
from termsel.data.coordinates.crs import (
    LOCAL,
    UTM,
    horizontal_crs,
    plane_transformer,
    short_crs_name,
    to_wgs84,
)
from termsel.data.coordinates.earth import degrees_of, place_of, position_in_words
from termsel.data.coordinates.longitudes import nearest_longitudes
from termsel.data.coordinates.metres import height_unit
from termsel.data.dem_difference import DemDifference, dem_difference
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.rasters import open_raster, pixel_positions, refuse_empty_giant
from termsel.formats.readers.tables import VOID_HEIGHTS
from termsel.formats.vertical import (
    UNDECLARED,
    Heights,
    counts_from_ellipsoid,
    datum_in_words,
    metres_of_band,
    require_grid,
    to_datum_of,
    with_declared_datum,
)

log = logging.getLogger(__name__)

FAR_HEIGHT_PIXELS = 1.0
"""Least displacement in the image from which on a height far from the control's is told."""

Projection = Callable[[FloatArray], FloatArray]
"""Line and sample (n, 2) of ground places (n, 3)."""

_TILE = 256  # largest number of pixels read at once along either side
_AROUND = 2  # further pixels on each side of a part
_NODATA = -1e10
_SAMPLED = 2048  # lines and samples of a raster, of which the highest is looked for
_DATUM_MARGIN = 20.0  # [m]
_SAME_ELLIPSOID = 1.0  # metres apart up to which ellipsoids are no other heights
_HEIGHT_TYPES = ("int16", "int32", "float32", "float64")
_PLACED = "Give a raster in a geographic or projected CRS of the Earth."


@dataclass(frozen=True)
class HeightCaution:
    """What heights of the ground may do wrong on a map: a sentence, and the effect in the image.

    `pixels` is how far a place is moved [px].
    """

    sentence: str
    pixels: float


@dataclass(frozen=True, eq=False)
class Dem:
    """Heights of the ground by bilinear interpolation in an open raster.

    They are in the unit and refer to what the CRS of the ground coordinates says.

    `to_raster` is a pyproj.Transformer from ground coordinates to the raster's; `datum` says what
    the heights refer to; `turns` whether the raster's x is a longitude, the same after a full turn;
    `crs` is that of the ground coordinates; `unit` is the raster's [m]; `to_datum` converts its
    heights in metres to those of the ground coordinates, where they differ.
    """

    path: Path
    raster: Any
    to_raster: Any
    datum: str
    turns: bool
    crs: str
    unit: float = 1.0
    to_datum: Heights | None = None

    @property
    def is_as_stored(self) -> bool:
        """Whether the numbers in the file are the heights [m], without scale, offset or datum."""
        return (self.unit == 1.0 and self.to_datum is None
                and self.raster.scales[0] == 1.0 and self.raster.offsets[0] == 0.0)

    @property
    def is_beyond_180(self) -> bool:
        """Whether longitudes of the raster go beyond 180 degrees, as of a model from 0 to 360."""
        bounds = self.raster.bounds
        # The edge of a global raster may be half a pixel beyond.
        edge = 180.0 + abs(self.raster.transform.a)
        return self.turns and (bounds.left < -edge or bounds.right > edge)

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Return heights, shape (n,), of x and y, shape (n, 2); NaN where there are none."""
        x, y = self._raster_xy(xy)
        return self.converted(x, y, self._interpolate_heights(x, y))

    def converted(self, x: FloatArray, y: FloatArray, heights: FloatArray) -> FloatArray:
        """Return the raster's own heights at its x and y as those of the ground coordinates, (n,).
        """
        # First the unit, then the datum, which is in metres, then the unit of the ground
        # coordinates.
        metres = heights * self.unit
        if self.to_datum is not None:
            metres = self.to_datum(np.column_stack([x, y, metres]))
        return np.asarray(metres / height_unit(self.crs))

    def covers(self, xy: FloatArray) -> BoolArray:
        """Return which of x and y, shape (n, 2), lie on the raster, with or without data."""
        x, y = self._raster_xy(xy)
        position = pixel_positions(self.raster, x, y)
        inside = (position >= -0.5) & (position <= np.array(self.raster.shape) - 0.5)
        return np.asarray(inside.all(axis=1))

    def extent(self) -> FloatArray:
        """Return least x and y, then greatest x and y, of the raster's corners, shape (2, 2).

        They are ground coordinates in the CRS of the control.
        """
        bounds = self.raster.bounds
        # By the four corners, in any order: between them the edges may bulge in the other CRS, but
        # the extent only shows whether two areas meet.
        x, y = self.to_raster.transform([bounds.left, bounds.right, bounds.left, bounds.right],
                                        [bounds.bottom, bounds.bottom, bounds.top, bounds.top],
                                        direction="INVERSE")
        return np.array([[min(x), min(y)], [max(x), max(y)]])

    def highest(self, corners: FloatArray) -> float:
        """Return a height that the ground in the box around places (n, 2) hardly exceeds.

        That is the greatest height there, or in a large box the greatest that is sampled, and a
        margin for what the vertical datum adds elsewhere. Returns NaN without any height in the
        box.
        """
        from rasterio.windows import Window

        pixels = pixel_positions(self.raster, *self._raster_xy(corners))
        size = np.array(self.raster.shape)
        if not np.isfinite(pixels).all():
            return np.nan
        first = np.clip(np.floor(pixels.min(axis=0)), 0, size).astype(int)
        last = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, size).astype(int)
        lines, samples = (last - first).tolist()
        if min(lines, samples) < 1:
            return np.nan
        # GDAL reads a large box at a lower resolution, from overviews where there are any.
        heights = self.raster.read(
            1, window=Window(int(first[1]), int(first[0]), samples, lines), masked=True,
            out_shape=(min(lines, _SAMPLED), min(samples, _SAMPLED))).astype(np.float64)
        heights = heights.filled(np.nan) * self.raster.scales[0] + self.raster.offsets[0]
        finite = heights[np.isfinite(heights)]
        if not finite.size:
            return np.nan
        bounds = self.raster.bounds
        middle = (np.array([bounds.left + bounds.right]) / 2,
                  np.array([bounds.bottom + bounds.top]) / 2)
        # What the datum adds is computed in the middle of the raster, and changes by metres in it.
        return float(self.converted(*middle, finite.max(keepdims=True))[0]
                     + _DATUM_MARGIN / height_unit(self.crs))

    def spacing(self) -> float:
        """Return the side of a pixel in the middle, in the unit of the ground coordinates."""
        line, sample = np.array(self.raster.shape) / 2
        x, y = self.raster.transform @ (np.array([sample, sample + 1.0, sample]),
                                        np.array([line, line, line + 1.0]))
        plan = np.stack(self.to_raster.transform(x, y, direction="INVERSE"), axis=1)
        return float(np.linalg.norm(plan[1:] - plan[0], axis=1).min())

    def _raster_xy(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y, (n,) each, in the raster's CRS of ground positions (n, 2)."""
        x, y = self.to_raster.transform(*np.asarray(xy, dtype=np.float64).T)
        if self.turns:
            # Longitudes may count from -180 or from 0, so that the one nearest to the raster is
            # meant.
            x = nearest_longitudes(np.asarray(x),
                                   (self.raster.bounds.left + self.raster.bounds.right) / 2)
        return np.asarray(x), np.asarray(y)

    def _interpolate_heights(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the raster's own heights at its x and y, (n,), NaN outside of the raster.

        They are interpolated between the middles of pixels.
        """
        position = pixel_positions(self.raster, x, y)
        size = np.array(self.raster.shape)
        heights = np.full(len(position), np.nan)
        inside = np.flatnonzero(((position >= -0.5) & (position <= size - 0.5)).all(axis=1))
        # In the outer half of the outermost pixels, heights are constant across the edge.
        position = np.clip(position[inside], 0, size - 1)
        first = np.minimum(position.astype(np.intp), np.maximum(size - 2, 0))
        # Pixels are read tile by tile, once for all positions in a tile.
        tiles, member = np.unique(first // _TILE, axis=0, return_inverse=True)
        order = np.argsort(member.ravel(), kind="stable")
        bounds = np.searchsorted(member.ravel()[order], np.arange(len(tiles) + 1))
        for i in range(len(tiles)):
            members = order[bounds[i]:bounds[i + 1]]
            start = first[members].min(axis=0)
            pixels = self._read_window(start, first[members].max(axis=0))
            heights[inside[members]] = _interpolate_bilinear(pixels, first[members] - start,
                                                             position[members] - first[members])
        return heights

    def ellipsoidal(self, window: Any) -> FloatArray:
        """Return ellipsoidal heights [m] of the pixels of a window, (lines, samples).

        They are NaN for pixels without a height.
        """
        rows, columns = np.mgrid[:window.height, :window.width] + 0.5
        x, y = self.raster.transform @ (columns.ravel() + window.col_off,
                                        rows.ravel() + window.row_off)
        heights = self.converted(x, y, self.stored(window).ravel())
        # From the CRS of the raster to that of the control, whose heights they are now.
        ground = np.column_stack([*self.to_raster.transform(x, y, direction="INVERSE"), heights])
        finite = np.isfinite(ground).all(axis=1)
        heights[finite] = to_wgs84(self.crs)(ground[finite])[:, 2]
        heights[~finite] = np.nan
        return heights.reshape(window.height, window.width)

    def _read_window(self, first: Any, last: Any) -> FloatArray:
        """Return the heights (rows, columns) from pixel `first` to `last`, and one more of both.

        The further row and column are needed to interpolate towards them, and left out at the edge
        of the raster. Pixels without a height are NaN.
        """
        from rasterio.windows import Window

        rows, columns = (np.minimum(last + 2, self.raster.shape) - first).tolist()
        return self.stored(Window(int(first[1]), int(first[0]), columns, rows))

    def stored(self, window: Any) -> FloatArray:
        """Return the raster's own heights in a window, (lines, samples).

        They are NaN for pixels without a height, and for heights that are infinite.
        """
        with np.errstate(all="ignore"):  # of bytes that are no numbers, and numbers near the limit
            values = self.raster.read(1, window=window, masked=True).astype(np.float64)
            heights = values.filled(np.nan) * self.raster.scales[0] + self.raster.offsets[0]
        heights[np.isinf(heights)] = np.nan
        return np.asarray(heights)


def _interpolate_bilinear(pixels: FloatArray, first: Any, share: FloatArray) -> FloatArray:
    """Return heights (n,) at positions `first` + `share`, (n, 2) each, in an array of pixels.

    `first` are row and column, `share` the parts of a pixel beyond them. Pixels without any weight
    may be NaN.
    """
    heights = np.zeros(len(first))
    for down in (0, 1):
        for right in (0, 1):
            # (1 - u) or u along lines by (1 - v) or v along samples, for the four pixels around.
            weight = np.abs(1 - down - share[:, 0]) * np.abs(1 - right - share[:, 1])
            row = first[:, 0] + down * (weight > 0)
            column = first[:, 1] + right * (weight > 0)
            heights += np.where(weight > 0, weight * pixels[row, column], 0.0)
    return heights


def looks_like_heights(path: Path) -> bool:
    """Return whether a raster looks like a DEM: one georeferenced band of int16, int32 or floats.

    An image that is to be georeferenced has no place on the ground yet, or an RPC or points.
    Returns False for a file that is no raster.
    """
    try:
        with open_raster(path) as raster:
            has_place = raster.crs is not None and not raster.transform.is_identity
            has_model = raster.rpcs is not None or bool(raster.gcps[0])
            kind = raster.dtypes[0]
            return has_place and not has_model and raster.count == 1 and kind in _HEIGHT_TYPES
    except TermselError:
        return False


@explains_arguments()
@contextmanager
def open_dem(path: Path | str, crs: str) -> Iterator[Dem]:
    """Open a raster of heights for ground coordinates in a CRS.

    Parameters
    ----------
    path : pathlib.Path or str
    crs : str
        CRS of the ground coordinates. Heights are converted to its unit, and to its vertical datum
        where the raster declares another one; without a vertical axis it has ellipsoidal heights
        in metres.

    Yields
    ------
    Dem
        It has heights at ground coordinates, and is closed after the block.

    Raises
    ------
    TermselError
        If rasterio or pyproj is not installed; if the raster cannot be read, has no
        CRS, no geotransform, several bands or another unit than metres and feet; if PROJ lacks the
        grid that converts its heights; if `crs` is "local".

    Examples
    --------
    >>> import tempfile, termsel
    >>> from pathlib import Path
    >>> from termsel.toolkit.files import write_example
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = Path(folder) / "files"
    ...     _ = write_example(files)
    ...     with termsel.open_dem(files / "dem.tif", "EPSG:4979") as dem:
    ...         type(dem).__name__
    'Dem'
    """
    path = Path(path)
    if crs == LOCAL:
        raise TermselError("a raster gives heights only to ground coordinates with a "
                           "CRS", file=path,
                           hint="State the CRS of the ground coordinates instead of local.")
    with open_raster(path) as raster:
        refuse_empty_giant(raster)
        with require_import("heights require", "pyproj", GIS):
            from pyproj import CRS
            from pyproj.exceptions import CRSError
        # Without georeferencing the transformation is the identity, by which pixel numbers would be
        # taken for coordinates.
        _require_georeferenced(raster, path)
        if raster.count != 1:
            hint = "Choose one, for example with gdal_translate -b."
            if _stores_bytes(raster):
                hint = "Its 8-bit bands are those of an image: give a raster of heights (a DEM)."
            raise TermselError(f"this raster has {raster.count} bands, expected one of heights",
                               file=path, hint=hint)
        try:
            raster_crs = CRS.from_user_input(raster.crs.to_wkt())
        except CRSError as error:  # such as the CRS of a building
            raise TermselError(f"the CRS of this raster cannot be used: {error}", file=path,
                               hint=_PLACED) from error
        if not (raster_crs.is_geographic or raster_crs.is_projected):
            raise TermselError(f"the CRS of this raster, {raster_crs.name}, has no horizontal "
                               "coordinates",
                               file=path, hint=_PLACED)
        try:
            # x before y on both sides, whatever the order of axes that the CRS states.
            to_raster = plane_transformer(crs, raster_crs)
        except TermselError as error:  # such as a CRS of the Moon, or a datum whose grid is missing
            raise TermselError(f"the CRS of this raster cannot be used: {error.what}", file=path,
                               hint=error.hint or _PLACED) from error
        raster_crs = with_declared_datum(raster, raster_crs, path)
        unit = metres_of_band(raster, raster_crs, path)
        to_datum = to_datum_of(crs, raster_crs, path)
        if to_datum is not None:
            bounds = raster.bounds
            require_grid(to_datum, ((bounds.left + bounds.right) / 2,
                                    (bounds.bottom + bounds.top) / 2), path)
        datum = datum_in_words(raster_crs, to_datum is not None, crs)
        yield Dem(path, raster, to_raster, datum, turns=raster_crs.is_geographic, crs=crs,
                  unit=unit, to_datum=to_datum)


def _stores_bytes(raster: Any) -> bool:
    """Return whether a raster stores 8-bit values, as images do, and no scale makes them heights.
    """
    return bool(raster.dtypes[0] == "uint8"
                and raster.scales[0] == 1.0 and raster.offsets[0] == 0.0)


def warn_of_bytes(dem: Dem) -> None:
    """Warn that a raster of heights stores 8-bit values, as images do."""
    if _stores_bytes(dem.raster):
        log.warning("Warning: %s stores 8-bit values (0 to 255), as an image does. They were "
                    "taken for heights: is it a DEM?", make_printable(dem.path.name))


def _require_georeferenced(raster: Any, path: Path) -> None:
    """Raise TermselError for a raster without a geotransform or a CRS, naming the missing one."""
    has_transform = not raster.transform.is_identity
    if raster.crs is None and has_transform:
        raise TermselError("this raster has a geotransform but no CRS", file=path,
                           hint=f"State it: gdal_edit.py -a_srs EPSG:n {path}, or set it in a GIS.")
    if not has_transform:
        raise TermselError("this raster is not georeferenced: it has no geotransform", file=path,
                           hint="Give a raster of heights from a GIS, such as a GeoTIFF.")


def write_ellipsoidal(surface: Dem, path: Path, bounds: tuple[float, float, float, float],
                      crs: str) -> None:
    """Write the part of a raster within bounds in a CRS, as ellipsoidal heights in metres.

    The pixels are those of the raster; one of them is written where the bounds meet none. `bounds`
    are west, south, east and north.
    """
    import rasterio
    from rasterio.errors import WindowError
    from rasterio.warp import transform_bounds
    from rasterio.windows import Window

    raster = surface.raster
    full_window = Window(0, 0, raster.width, raster.height)
    # Along the edges as well as at the corners, as they are curves in the other CRS.
    left, bottom, right, top = transform_bounds(crs, raster.crs, *bounds, densify_pts=21)
    # The raster may be turned, or its first line be the one farthest south.
    corners = pixel_positions(raster, np.array([left, right, right, left]),
                              np.array([top, top, bottom, bottom])) + 0.5
    first = np.floor(corners.min(axis=0)).astype(int) - _AROUND
    last = np.ceil(corners.max(axis=0)).astype(int) + _AROUND
    try:
        rows, columns = (slice(max(low, 0), max(high, 1))
                         for low, high in zip(first, last, strict=True))
        window = Window.from_slices(rows, columns).intersection(full_window)
    except WindowError:  # none of the map has heights
        window = Window(0, 0, 1, 1)
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "nodata": _NODATA,
               "tiled": True, "crs": raster.crs, "width": window.width, "height": window.height,
               "transform": raster.window_transform(window)}
    with rasterio.open(path, "w", **profile) as written:
        for _, block in written.block_windows():
            heights = surface.ellipsoidal(Window(block.col_off + window.col_off,
                                                 block.row_off + window.row_off, block.width,
                                                 block.height))
            written.write(np.nan_to_num(heights, nan=_NODATA).astype(np.float32), 1, window=block)


def refuse_void(height: float) -> None:
    """Raise TermselError for a height that rasters have where there is none, such as -9999."""
    if height in VOID_HEIGHTS:
        raise TermselError(f"{height:g} is no height, but what rasters have where there is none",
                           hint="Give the height of the ground: --height H.")


def surface_of(dem: Path | str | None, crs: str, height: float,
               ) -> AbstractContextManager[Dem | float]:
    """Open a raster of heights for coordinates in a CRS, or give a constant height instead.

    Raises TermselError for a height that rasters have where there is none, such as -9999.
    """
    if dem is None:
        refuse_void(height)
    return nullcontext(height) if dem is None else open_dem(Path(dem), crs)


def difference_of(features: FeatureSet, surface: Dem) -> DemDifference | None:
    """Return how far a raster is above the known heights of features that take part.

    Returns None if these are too few, or the raster does not cover them.
    """
    ground = features.ground_vertices()
    off = {name for name, role in zip(features.points.ids, features.points.roles, strict=True)
           if role == "off"}
    owners = np.array(features.ids, dtype=object)[features.vertex_feature]
    has_height = np.isfinite(ground[:, 2]) & ~np.isin(owners, list(off))
    unit = height_unit(features.crs)
    return dem_difference(ground[has_height, 2] * unit, surface(ground[has_height, :2]) * unit,
                          make_printable(surface.path.name))


def pixels_of(difference: DemDifference, features: FeatureSet, project: Projection) -> float:
    """Return by how much places of control move in the image where all heights change so [px]."""
    return pixels_by(difference.above / height_unit(features.crs), features, project)


def pixels_by(above: float, features: FeatureSet, project: Projection) -> float:
    """Return how far places of control move in the image if they are higher by `above` [px].

    It is the median over all places, 0 where no place is known. `above` is in the unit of the
    heights.
    """
    ground = features.ground_vertices()
    ground = ground[np.isfinite(ground).all(axis=1)]
    with np.errstate(all="ignore"):
        raised = ground + np.array([0.0, 0.0, above])
        moved = np.linalg.norm(project(raised) - project(ground), axis=1)
    return float(np.nanmedian(moved)) if np.isfinite(moved).any() else 0.0


def note_on_ellipsoid(features: FeatureSet, project: Projection) -> str:
    """Return that heights of no declared datum count from another ellipsoid than that of WGS84.

    Such heights come from a raster, and are taken to count from the ellipsoid of the features' CRS.
    Returns "" for other heights, and where the two ellipsoids are within _SAME_ELLIPSOID of each
    other.

    Parameters
    ----------
    features : FeatureSet
    project : callable
        Takes ground places to image positions, which show the effect in px.
    """
    if not features.heights.endswith(UNDECLARED) or not counts_from_ellipsoid(features.crs):
        return ""
    middle = np.nanmedian(features.ground_vertices(), axis=0)
    # The height over WGS84 of a place on the other ellipsoid is how far that is above.
    middle[2] = 0.0
    above = float(to_wgs84(features.crs)(middle[None])[0, 2])
    if abs(above) < _SAME_ELLIPSOID:
        return ""
    pixels = pixels_by(above / height_unit(features.crs), features, project)
    side = "above" if above > 0 else "below"
    return (f"the heights of the DEM, whose datum it does not declare, count from the ellipsoid of "
            f"{short_crs_name(features.crs)}, {abs(above):.3g} m {side} that of WGS84 here: if "
            "they are heights above the latter, an RPC is wrong by "
            f"{rounded_size_text(pixels)} px. State what they are in the raster and run again: "
            "gdal_edit.py -mo VERTICAL_DATUM=ellipsoid, or =EGM96 for that geoid.")


def say_difference(features: FeatureSet, project: Projection, surface: Dem | float,
                   ) -> HeightCaution | None:
    """Warn where a raster, or one height, contradicts the heights of control, and by how many px.

    Returns the caution of the warning; None where nothing contradicts them.
    """
    if not isinstance(surface, Dem):
        caution = _far_height_note(features, project, surface)
    else:
        caution = _hole_note(features, project, surface)
        # There is one caution: a contradiction to the control goes before a hole.
        difference = difference_of(features, surface)
        if difference is not None and difference.contradicts:
            pixels = pixels_of(difference, features, project)
            caution = HeightCaution(difference.sentence(pixels), pixels)
    if caution is not None:
        log.warning("Warning: %s", caution.sentence)
    return caution


_HOLE_NODES = 48
"""Places along a side at which a raster is searched for holes, over the area of the control."""
_LEAST_HILL = 30.0  # metres above 0 of all other heights from which on a 0 is a hole


def _hole_note(features: FeatureSet, project: Projection, surface: Dem) -> HeightCaution | None:
    """Return that a raster has heights of exactly 0, and all others far above or all far below it.

    Programs write 0 where they know no height, and not all declare it. Returns None where that is
    not so, and where control lies near 0 itself, as on the sea.
    """
    ground = features.ground_vertices()[:, :2]
    ground = ground[np.isfinite(ground).all(axis=1)]
    if not len(ground):
        return None
    axes = np.linspace(ground.min(axis=0), ground.max(axis=0), _HOLE_NODES).T
    heights = surface(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2))
    heights = heights[np.isfinite(heights)]
    is_zero = heights == 0.0
    other_heights = heights[~is_zero]
    control = features.ground_vertices()[:, 2] * height_unit(features.crs)
    if (np.abs(control) < _LEAST_HILL).any():
        return None
    if not is_zero.any() or not len(other_heights):
        return None
    if other_heights.min() < 0.0 < other_heights.max():
        return None
    # Heights next to a hole are interpolated with its 0: one in twenty may be nearer to 0.
    nearest = float(np.quantile(np.abs(other_heights), 0.05))
    if nearest * height_unit(features.crs) < _LEAST_HILL:
        return None
    pixels = pixels_by(float(np.median(other_heights)), features, project)
    return HeightCaution(
        f"{100 * is_zero.mean():.2g} % of the heights of {surface.path.name} in the area of the "
        f"control are exactly 0, and the others are about {np.median(other_heights):.4g}: is this "
        f"water, or are these holes? In a hole places are about {rounded_size_text(pixels)} px "
        "off. A copy by gdal_translate -a_nodata 0 leaves holes out.", pixels)


def _far_height_note(features: FeatureSet, project: Projection,
                     height: float) -> HeightCaution | None:
    """Return that a height is farther from the control's than these are from each other.

    A height that is given by hand is often in another unit or datum. Returns None if it is not that
    far, if it moves places by less than FAR_HEIGHT_PIXELS, as under a model that uses no heights,
    or if the control has no heights.
    """
    heights = features.ground_vertices()[:, 2]
    heights = heights[np.isfinite(heights)]
    if not len(heights):
        return None
    unit = height_unit(features.crs)
    lowest, highest = float(heights.min()), float(heights.max())
    distance = max(lowest - height, height - highest)
    # A height within the relief beyond the control is likely; one farther away is a mistake.
    if distance <= highest - lowest:
        return None
    above = height - (highest if height > highest else lowest)
    pixels = pixels_by(above, features, project)
    if pixels < FAR_HEIGHT_PIXELS:
        return None
    side = "above" if above > 0 else "below"
    return HeightCaution(
        f"the height {height * unit:,.0f} m is {rounded_size_text(distance * unit)} m {side} the "
        f"control ({lowest * unit:,.0f} to {highest * unit:,.0f} m): {rounded_size_text(pixels)} "
        "px in the image, where the model was not tested. Give the height of the ground, in the "
        "unit of the control.", pixels)


def with_heights(features: FeatureSet, dem: Path,
                 left_out: Collection[str] = ()) -> FeatureSet:
    """Return the features with their unknown heights taken from a raster, bilinear.

    Parameters
    ----------
    features : FeatureSet
        Features with heights keep them; the raster is compared with these (`dem_difference`).
    dem : Path
        A raster of heights in any CRS, converted to the heights of the features' CRS.
    left_out : collection of str, optional
        Ids of features that may stay without a height, such as those that are off.

    Returns
    -------
    FeatureSet
        Its `heights` say how many are of which raster, and in which vertical datum.

    Raises
    ------
    TermselError
        Where the raster has no height at a feature, with the names, and where it lies instead.
    """
    ground = features.ground_vertices()
    unknown = np.isnan(ground[:, 2])
    with open_dem(dem, features.crs) as surface:
        if unknown.any():
            warn_of_bytes(surface)
        difference = difference_of(features, surface)
        ground[unknown, 2] = surface(ground[unknown, :2])
        datum = surface.datum
        # The ids of the features that the vertices belong to: lines have two each.
        owner = features.points.ids + tuple(np.repeat(features.lines.ids, 2))
        still_unknown = np.isnan(ground[:, 2]) & ~np.isin(owner, list(left_out))
        is_outside = ~surface.covers(ground[still_unknown, :2])
        surface_extent = surface.extent()
        covers_some = surface.covers(ground[:, :2]).any()
        elsewhere = "" if covers_some or not len(ground) else where_raster_is(surface, features)
    if len(ground) and not unknown.any() and not covers_some:
        log.warning("Warning: the raster %s covers none of the %s, which are around %s. %s",
                    make_printable(dem.name), features.word, place_of(features), elsewhere)
    if still_unknown.any():
        names = list(dict.fromkeys(str(owner[i]) for i in np.flatnonzero(still_unknown)))
        if len(names) == len(features) and not len(features.lines):
            count = "all points"
        else:
            count = f"{len(names)} of {len(features)} {features.word}"
        error = _no_height_error(names, count, ground[still_unknown, :2],
                                 surface_extent, is_outside, dem)
        if not covers_some:
            error.hint = f"{elsewhere} Give a raster of their area."
        raise error
    n = len(features.points)
    found = int((unknown & np.isfinite(ground[:, 2])).sum())
    statement = (f"{found} of {len(ground)} heights from {make_printable(dem.name)}, "
                 "bilinear; "
                 f"vertical datum: {datum}")
    if unknown.any():
        log.info("Heights: %s.", statement)
    return replace(
        features, heights=statement if unknown.any() else features.heights,
        dem_difference=difference,
        points=replace(features.points, ground=ground[:n]),
        lines=replace(features.lines, ground=ground[n:].reshape(-1, 2, 3)))


def where_raster_is(surface: Dem, features: FeatureSet) -> str:
    """Return a sentence on where a raster is that covers no feature, for the hint of an error.

    With features in UTM it names another zone in which the raster would cover all of them, if there
    is one: that of the raster and both neighbours are tried, of either hemisphere.
    """
    from pyproj import CRS

    middle = degrees_of(surface.crs, np.column_stack([surface.extent(), np.zeros(2)]))
    if middle is None:
        return "Is it of another place, or have x or y the wrong sign or CRS?"
    place = f"The raster is around {position_in_words(middle)}"
    if place == f"The raster is around {place_of(features)}":
        return _where_beside(surface, features)
    stated = UTM.match(horizontal_crs(features.crs))
    if stated is None:
        return f"{place}: is it of another place, or have x or y the wrong sign or CRS?"
    xy = features.ground_vertices()[:, :2]
    for zone in _zones_near(middle[0]):
        # EPSG:326zz is zone zz of the north, EPSG:327zz that of the south.
        for hemisphere in "67":
            utm = f"EPSG:32{hemisphere}{zone:02}"
            to_raster = plane_transformer(utm, CRS(surface.raster.crs.to_wkt()))
            if replace(surface, to_raster=to_raster, crs=utm).covers(xy).all():
                return (f"{place}. In {utm} the {features.word} would be on it: is {stated[0]} "
                        "right?")
    return f"{place}: is it of another place?"


def _where_beside(surface: Dem, features: FeatureSet) -> str:
    """Return a sentence on the extents of a raster and of features that lie beside it."""
    extent = surface.extent()
    ground = features.ground_vertices()[:, :2]
    control = np.array([ground.min(axis=0), ground.max(axis=0)])
    decimals = _decimals_of_side(extent)
    return (f"The raster covers {_range_in_words(extent, decimals)}, and the {features.word} are "
            f"at {_range_in_words(control, decimals)}: is it a neighbouring tile?")


def _zones_near(lon: float) -> tuple[int, int, int]:
    """Return the zone of UTM at a longitude [deg], and its neighbours."""
    zone = int((lon + 180.0) // 6.0) % 60
    return zone + 1, (zone - 1) % 60 + 1, (zone + 1) % 60 + 1


def _no_height_error(names: Sequence[str], count: str, xy: FloatArray, extent: FloatArray,
                     outside: BoolArray, dem: Path) -> TermselError:
    """Return the error for features, with their names, for which a raster has no height.

    `count` says in words how many they are, `xy` (n, 2) are vertices without a height, `outside`
    (n,) which of them are off the raster, `extent` (2, 2) the corners of the raster.
    """
    if not outside.any():
        is_all = count.startswith("all ")
        return TermselError("the raster has no data at any of the points" if is_all else
                            f"{count} are in areas without data: {first_names_in_words(names)}",
                            file=dem, ids=names,
                            hint="Is it the right raster? Give one with heights there."
                            if is_all else "Fill the holes of the raster, or leave these out: "
                                           "--off.")
    if outside.all():
        reason = "outside the raster"
    else:
        reason = "outside the raster or in areas without data"
    vertices = np.array([xy.min(axis=0), xy.max(axis=0)])
    decimals = _decimals_of_side(extent)
    return TermselError(
        f"{count} are {reason}: {first_names_in_words(names)}", file=dem, ids=names,
        hint=f"The raster covers {_range_in_words(extent, decimals)}; these are at "
             f"{_range_in_words(vertices, decimals)}. Give a raster of their area, or leave them "
             f"out: --off {','.join(names[:1])}{',...' if len(names) > 1 else ''}.")


def _range_in_words(corners: FloatArray, decimals: int) -> str:
    """Return the ranges of x and y between two corners, one number where both ends are alike."""
    ranges = np.round(corners.T, decimals).tolist()
    return ", ".join(f"{axis} {low:.10g}" + (f" to {high:.10g}" if high > low else "")
                     for axis, (low, high) in zip("xy", ranges, strict=True))


def _decimals_of_side(corners: FloatArray) -> int:
    """Return as many decimals as four digits of the smaller side need, and none for metres."""
    side = float(np.ptp(corners, axis=0).min())
    return max(0, 3 - int(np.floor(np.log10(side)))) if 0.0 < side < 1e3 else 0
