"""Geolocation arrays and tie-point grids: longitude, latitude and height of regular places.

An array may have a place for every pixel of an image. A model needs some hundred of them: it is
thinned to a lattice, which is made denser until a smooth model of the lattice predicts the places
between as well as it ever will.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet, Option, Points, Reader, TermselError, open_raster
from termsel.toolkit import refuse_empty_giant
from termsel.toolkit.files import read_head
from termsel_formats.points.common import CORNER

log = logging.getLogger("termsel.formats")

FloatArray = NDArray[np.float64]

DENSITIES = (8, 16, 32)
"""Meshes along either side of a lattice, from the first that is tried to the densest."""

SMALL_ERROR, REQUIRED_SHARE = 0.05, 0.8
"""Error between the places of a lattice that is good enough [px], and the part of it that a denser
one must fall below to be worth its places."""

LONGITUDES = ("longitude", "lon", "x")
LATITUDES = ("latitude", "lat", "y")
HEIGHTS = ("height", "altitude", "elevation", "z")
"""What bands of arrays are called, without regard to case."""

NO_COORDINATE = 1e30
"""What is no coordinate."""

_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"EHFA_HEADER_TAG", b"CDF\x01", b"CDF\x02",
          b"\x89HDF")
_GEOLOCATION_HINT = ("Give a raster with bands longitude, latitude and perhaps height; or that of "
                     "longitudes, "
                     "with --set latitude=FILE and --set height=FILE; or an image whose metadata "
                     "name its "
                     "geolocation array.")

Band = Callable[[int], FloatArray]
"""Returns a line of a band."""


@dataclass(frozen=True, eq=False)
class Arrays:
    """Bands of places, and where the first one and the others are in the image.

    Parameters
    ----------
    bands : tuple of callable
        Bands of longitude, latitude and perhaps height: each returns one of its lines.
    shape : tuple of int
        Lines and samples of the arrays.
    first, step : ndarray, shape (2,)
        Line and sample of the first place, from the centre of the first pixel, and from one to the
        next [px].
    crs : str
    image_size : tuple of int, optional
    """

    bands: tuple[Band, ...]
    shape: tuple[int, int]
    first: FloatArray
    step: FloatArray
    crs: str
    image_size: tuple[int, int] | None


class GeolocationArray(Reader):
    """A geolocation array, or a tie-point grid: longitude, latitude and perhaps height.

    They are bands of one raster, files of their own, or what the domain GEOLOCATION of an image's
    metadata names. Each place is of the centre of a pixel, or of every so many pixels.
    """

    name = "geolocation-array"
    summary = "longitude, latitude and height as bands, files, or GEOLOCATION of a raster"
    declared_options = (
        Option("latitude", None, "Raster of latitudes, if the file has longitudes only."),
        Option("height", None, "Raster of ellipsoidal heights, for such a file."),
        Option("array_first", None, "Line and sample of the array's first node, counted from the "
                                    "centre of the first pixel; by default 0,0."),
        Option("array_step", None, "Lines and samples of the image from one node of the array to "
                                   "the next, such as 16,16; by default 1,1."),
        Option("meshes", None, "Meshes along either side of the lattice that is taken; by default "
                               "as many as the geometry needs, up to 32.", int, 3, 200))

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a raster whose metadata name an array, or whose bands are one.

        With the option `latitude` it is True for any file.
        """
        if self.options["latitude"] is not None:
            return True
        if head.lstrip().startswith(b"<VRTDataset"):
            # Opening a VRT would open all files that it names, so that its text is searched.
            return b'domain="GEOLOCATION"' in head or b"ongitude</Description>" in head
        if not head.startswith(_MAGIC):
            return False
        try:
            with open_raster(path) as raster:
                # Any image may have such a domain: only GDAL knows.
                return bool(raster.tags(ns="GEOLOCATION")) or _bands_by_name(raster) is not None
        except TermselError:
            return False

    def read(self, path: Path) -> FeatureSet:
        """Return a lattice of the array's nodes as points; errors name the file."""
        read_head(path, _GEOLOCATION_HINT)
        with ExitStack() as stack:
            arrays = self._open_arrays(path, stack)
            return _lattice_of(arrays, path, self.options["meshes"])

    def _open_arrays(self, path: Path, stack: ExitStack) -> Arrays:
        """Return the arrays of a file, with the files that they are in open on the stack.

        They are, in this order, the file and those that options name, those of the metadata domain
        GEOLOCATION, or the bands called longitude and latitude. Raises TermselError if there are
        none.
        """
        raster = stack.enter_context(open_raster(path))
        domain = raster.tags(ns="GEOLOCATION")
        if domain and self.options["latitude"] is None:
            return _arrays_of_domain(path, raster, domain, stack)
        numbers = _bands_by_name(raster)
        if self.options["latitude"] is not None:
            rasters = [raster, *(stack.enter_context(open_raster(Path(self.options[name])))
                                 for name in ("latitude", "height") if self.options[name])]
            bands = [(opened, 1) for opened in rasters]
        elif numbers is not None:
            bands = [(raster, number) for number in numbers]
        else:
            raise TermselError("no bands of this raster are called longitude and latitude",
                               file=path, hint=_GEOLOCATION_HINT)
        step = self._parse_pair_option("array_step", 1.0)
        # With steps of its own an array does not show the size of its image.
        size = raster.shape if (step == 1.0).all() else None
        return Arrays(_band_readers(bands, path), raster.shape,
                      self._parse_pair_option("array_first", 0.0), step,
                      "", size)

    def _parse_pair_option(self, name: str, default: float) -> FloatArray:
        """Return an option that is a pair of numbers, of lines and of samples (2,).

        Both are `default` if it is not given. Raises TermselError if it is no pair of finite
        numbers, or no pair of positive ones for `array_step`.
        """
        text = self.options[name]
        if text is None:
            return np.full(2, default)
        try:
            pair = np.array([float(number) for number in str(text).split(",")])
        except ValueError:
            pair = np.zeros(0)
        if pair.shape != (2,) or not np.isfinite(pair).all() or (name == "array_step"
                                                                 and not (pair > 0.0).all()):
            raise TermselError(f"option {name!r} cannot be {text!r}",
                               hint=f"Give lines and samples, such as {name}=16,16.", name=name)
        return pair


def _bands_by_name(raster: Any) -> list[int] | None:
    """Return the numbers of the bands called longitude, latitude and, if there is one, height.

    None if there is no longitude or no latitude.
    """
    names = [str(name or "").strip().casefold() for name in raster.descriptions]
    numbers: list[int | None] = []
    for accepted in (LONGITUDES, LATITUDES, HEIGHTS):
        # rasterio counts bands from 1.
        numbers.append(next((names.index(name) + 1 for name in accepted if name in names), None))
    return None if None in numbers[:2] else [number for number in numbers if number is not None]


def _arrays_of_domain(path: Path, raster: Any, domain: dict[str, str], stack: ExitStack) -> Arrays:
    """Return the arrays that the metadata domain GEOLOCATION of an image names, by GDAL's RFC 4.

    `domain` has the entries of the domain by name; `stack` keeps the files of the arrays open.
    Raises TermselError if the domain names no longitudes or latitudes, or if one of its numbers is
    wrong.
    """
    bands = []
    # X, Y and Z are longitude, latitude and height, of which the height may be missing.
    for axis in "XYZ":
        name = domain.get(f"{axis}_DATASET")
        if name is None:
            if axis == "Z":
                break
            raise TermselError(f"its domain GEOLOCATION has no {axis}_DATASET", file=path,
                               hint=_GEOLOCATION_HINT)
        relative = domain.get(f"{axis}_DATASET_RELATIVE_TO_SOURCE", "NO").upper() in ("YES", "1")
        array_file = Path(os.path.join(path.parent, name)) if relative else Path(name)
        bands.append((stack.enter_context(open_raster(array_file)),
                      int(_parse_number(domain, f"{axis}_BAND", 1.0, path))))
    offset = np.array(
        [_parse_number(domain, f"{axis}_OFFSET", 0.0, path) for axis in ("LINE", "PIXEL")])
    step = np.array(
        [_parse_number(domain, f"{axis}_STEP", 1.0, path) for axis in ("LINE", "PIXEL")])
    # Nodes must follow one another in the image, as GDAL expects them.
    if not (step > 0.0).all():
        raise TermselError("its domain GEOLOCATION has a step that is not positive", file=path,
                           hint=_GEOLOCATION_HINT)
    # A node is at the corner of its step or, by this convention, in its middle. GDAL counts both
    # from the outer corner of the first pixel.
    centred = domain.get("GEOREFERENCING_CONVENTION", "").upper() == "PIXEL_CENTER"
    first = offset + (step / 2.0 if centred else 0.0) - CORNER
    shape = bands[0][0].shape
    return Arrays(_band_readers(bands, path), shape, first, step, domain.get("SRS", ""),
                  raster.shape)


def _parse_number(domain: dict[str, str], name: str, default: float, path: Path) -> float:
    """Return a number of the domain GEOLOCATION; `default` if it is not stated.

    Raises TermselError, with the file, if it is no finite number.
    """
    text = domain.get(name)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise TermselError(f"its domain GEOLOCATION has {name}={text!r:.50}, which is no number",
                           file=path, hint=_GEOLOCATION_HINT)
    return value


def _band_readers(bands: list[tuple[Any, int]], path: Path) -> tuple[Band, ...]:
    """Return a function for each band, given as raster and number, that reads its lines.

    Raises TermselError if rasters differ in size, or if one lacks the band.
    """
    first = bands[0][0]
    for raster, number in bands:
        refuse_empty_giant(raster)
        if raster.shape != first.shape:
            raise TermselError(f"{raster.name} has {raster.shape[0]} lines and {raster.shape[1]} "
                               f"samples, other than the array of longitudes with "
                               f"{first.shape[0]} and {first.shape[1]}", file=path,
                               hint=_GEOLOCATION_HINT)
        if not 1 <= number <= raster.count:
            raise TermselError(
                f"{raster.name} has no band {number}", file=path, hint=_GEOLOCATION_HINT)
    return tuple(_line_reader(raster, number) for raster, number in bands)


def _line_reader(raster: Any, number: int) -> Band:
    """Return the function that reads a line of a band by its index, from 0.

    `number` is that of the band, from 1; its scale and offset are applied.
    """
    from rasterio.windows import Window

    def read_line(index: int) -> FloatArray:
        """Return a line of the band; NaN for what is masked or no coordinate."""
        with np.errstate(all="ignore"):
            values = raster.read(number, window=Window(0, index, raster.width, 1), masked=True)
            numbers = values.astype(np.float64).filled(np.nan)[0]
            numbers = numbers * raster.scales[number - 1] + raster.offsets[number - 1]
        numbers[~(np.abs(numbers) < NO_COORDINATE)] = np.nan
        return np.asarray(numbers)

    return read_line


def _lattice_of(arrays: Arrays, path: Path, meshes: int | None) -> FeatureSet:
    """Return a lattice of the arrays' nodes as points, as dense as the geometry needs.

    If `meshes` is not None, it has that many meshes either way. Nodes without coordinates are left
    out, and so are all heights if one of them is unknown. Raises TermselError if fewer than four
    nodes remain, or if latitudes are beyond 90 degrees in arrays that name no CRS.
    """
    image, ground = _sample_densely_enough(arrays, meshes)
    # Pixels beyond the edge of the Earth, or in gaps of a swath, have no coordinates.
    finite = np.isfinite(ground[:, :2]).all(axis=1)
    if finite.sum() < 4:
        raise TermselError(
            "this array has fewer than four nodes", file=path, hint=_GEOLOCATION_HINT)
    # Arrays that name a CRS may be in metres.
    if (np.abs(ground[finite, 1]) > 90.0).any() and not arrays.crs:
        raise TermselError(
            "the latitudes of this array are beyond 90", file=path, hint=_GEOLOCATION_HINT)
    image = image[finite]
    ground = ground[finite]
    # A model that uses heights needs that of every point.
    if np.isnan(ground[:, 2]).any():
        ground[:, 2] = np.nan
    if _mirrors(image, ground):
        log.info("Note: %s mirrors the ground, as radar images and raw scans may. GDAL takes "
                 "arrays out of netCDF upside down: gdal_translate --config GDAL_NETCDF_BOTTOMUP "
                 "NO, or the name HDF5:FILE://ARRAY, keeps them as they are.", path)
    names = tuple(f"L{line:g}P{sample:g}" for line, sample in image)
    return FeatureSet(Points(names, image, ground),
                      crs=_crs_of(arrays.crs, bool(np.isfinite(ground[:, 2]).all())),
                      image_size=arrays.image_size)


def _sample_densely_enough(arrays: Arrays, meshes: int | None) -> tuple[FloatArray, FloatArray]:
    """Return image (n, 2) and ground (n, 3) positions of the nodes of a lattice.

    It is the lattice of `meshes` meshes, or else the densest of `DENSITIES` that lowers the error
    between the nodes enough, to `REQUIRED_SHARE` of that of the lattice before.
    """
    most_meshes = max(size - 1 for size in arrays.shape)
    lattice = None
    error = np.inf
    # Twice as dense each time, until that no longer pays or the lattice has all nodes.
    for density in DENSITIES if meshes is None else (meshes,):
        denser_lattice = _sample_arrays(arrays, density)
        denser_error = _error_between(arrays, denser_lattice)
        is_better = denser_error < REQUIRED_SHARE * error
        if lattice is None or is_better:
            lattice = denser_lattice
        if denser_error <= SMALL_ERROR or not is_better or density >= most_meshes:
            break
        error = denser_error
    assert lattice is not None
    return lattice


def _mirrors(image: FloatArray, ground: FloatArray) -> bool:
    """Return whether an image mirrors the ground as seen from above.

    `image` (n, 2) are lines and samples, `ground` (n, 2 or 3) are x to the east and y to the north
    of the same points.
    """
    plane = ground[:, :2].copy()
    # Longitudes that jump at 180 degrees are counted from 0; metres have a larger range.
    if np.abs(plane[:, 0]).max() <= 180.0 < np.ptp(plane[:, 0]):
        plane[:, 0] %= 360.0
    slopes = np.linalg.lstsq(image - image.mean(axis=0), plane - plane.mean(axis=0))[0]
    # The determinant is dx/dline dy/dsample - dy/dline dx/dsample. It is positive as seen from
    # above, where y falls along lines and x grows along samples.
    return bool(np.linalg.det(slopes) < 0.0)


def _crs_of(stated: str, heights: bool) -> str:
    """Return the CRS of the nodes: as stated, or longitude and latitude on WGS84 if none is.

    Degrees on WGS84 have ellipsoidal heights if `heights` says that these are known.
    """
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    degrees = "EPSG:4979" if heights else "EPSG:4326"
    if not stated:
        return degrees
    try:
        epsg = CRS.from_user_input(stated).to_epsg()
    except CRSError:
        return stated
    if epsg is None:
        return stated
    return degrees if epsg == 4326 else f"EPSG:{epsg}"


def _sample_arrays(
        arrays: Arrays, meshes: int, shift: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return image (n, 2) and ground (n, 3) positions of the nodes of a lattice in the arrays.

    The lattice has `meshes` meshes either way, or fewer in a small array. With a `shift` of a half
    the nodes are those in the middles of its meshes. Unknown heights, and gaps, are NaN.
    """
    selected = []
    for size in arrays.shape:
        count = min(meshes, size - 1)
        # The ends of meshes are one more than their middles.
        steps = np.arange(count + (shift == 0.0)) + shift
        selected.append(np.unique(np.round(steps * (size - 1) / max(count, 1)).astype(int)))
    rows = []
    for index in selected[0]:
        bands = [band(int(index))[selected[1]] for band in arrays.bands]
        bands += [np.full(len(selected[1]), np.nan)] * (3 - len(bands))
        rows.append(np.stack(bands, axis=1))
    nodes = np.stack(np.meshgrid(*selected, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = np.concatenate(rows)
    finite = np.isfinite(ground[:, 0])
    are_degrees = np.abs(ground[finite, 0]).max(initial=0.0) <= 360.0
    # Across the date line longitudes jump, so that they are counted from 0 to 360.
    if are_degrees and finite.any() and np.ptp(ground[finite, 0]) > 180.0:
        ground[:, 0] %= 360.0
    return arrays.first + nodes * arrays.step, ground


def _error_between(arrays: Arrays, lattice: tuple[FloatArray, FloatArray]) -> float:
    """Return how well a smooth model of a lattice predicts the nodes between: the RMSE [px].

    `lattice` are image positions (n, 2) and ground positions (n, 3), as `_sample_arrays` returns
    them; the nodes between are those in the middles of its meshes. In the model, line and sample
    are polynomials of the ground (`_smooth_monomials`), and their residuals are interpolated
    linearly between the nodes. The error is 0 if the lattice has too few nodes for it, or no middle
    of a mesh can be compared.
    """
    from scipy.interpolate import griddata

    image, ground = lattice
    meshes = max(len(np.unique(image[:, 0])) - 1, 1)
    middle_image, middle_ground = _sample_arrays(arrays, meshes, 0.5)
    # Arrays without heights have NaN there.
    ground = ground.copy()
    ground[:, 2] = np.nan_to_num(ground[:, 2])
    middle_ground[:, 2] = np.nan_to_num(middle_ground[:, 2])
    finite = np.isfinite(ground[:, :2]).all(axis=1)
    has_ground = np.isfinite(middle_ground[:, :2]).all(axis=1)
    # The model has 17 terms.
    if finite.sum() < 30 or not has_ground.any():
        return 0.0
    centre = np.nanmean(ground[finite], axis=0)
    half_extent = np.maximum(np.ptp(ground[finite], axis=0) / 2.0, 1e-9)
    columns = _smooth_monomials((ground[finite] - centre) / half_extent)
    solution = np.linalg.lstsq(columns, image[finite])[0]
    # Residuals are small, so that linear interpolation of them is exact enough.
    residuals = image[finite] - columns @ solution
    interpolated = griddata(image[finite], residuals, middle_image[has_ground], rescale=True)
    smooth = _smooth_monomials((middle_ground[has_ground] - centre) / half_extent) @ solution
    predicted = smooth + np.nan_to_num(interpolated)
    # Middles outside the hull of the nodes have no interpolated residual.
    errors = (middle_image[has_ground] - predicted)[np.isfinite(interpolated).all(axis=1)]
    return float(np.sqrt((errors**2).sum(axis=1).mean())) if len(errors) else 0.0


def _smooth_monomials(ground: FloatArray) -> FloatArray:
    """Return the monomials (n, 17) of the smooth model at scaled ground positions (n, 3).

    They are those of x and y up to the third degree, those up to the second times z, and z^2.
    Unknown heights (NaN) count as 0.
    """
    x, y, z = np.nan_to_num(ground).T
    plane = []
    with_height = []
    for i in range(4):
        plane += [x**i * y**j for j in range(4 - i)]
    for i in range(3):
        with_height += [z * x**i * y**j for j in range(3 - i)]
    return np.stack([*plane, *with_height, z**2], axis=1)
