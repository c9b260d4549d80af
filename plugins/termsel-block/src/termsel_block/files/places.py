"""The places of the ties of a block as a file for other programs: GeoPackage or LAS."""

from __future__ import annotations

import csv
import importlib
import io
import warnings
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from termsel import TermselError, require_replaceable
from termsel.toolkit import (
    path_inside,
    private_folder,
    read_data,
    read_text,
    unguard_cell,
    write_bytes,
)
from termsel.toolkit.coordinates import LOCAL, horizontal_crs
from termsel_block.files.folders import RECORD, TIES
from termsel_block.geometry.frame import FloatArray

_LAS_STEPS = 1e-3, 1e-8
"""Steps of coordinates in LAS: in metres, and in degrees, where a step is about a millimetre."""


def write_places(folder: Path | str, target: Path | str, *, overwrite: bool = False) -> int:
    """Write the places of the ties with their standard deviations, and return how many there are.

    Parameters
    ----------
    folder : path-like
        A block as `write_block` writes it.
    target : path-like
        A GeoPackage, by the suffix ``.gpkg``: points with heights and the columns id, sigma_east,
        sigma_north and sigma_up [m], and images. Or a point cloud by ``.las`` or ``.laz``, with
        the same but id. LAS needs laspy, LAZ laspy with lazrs.
    overwrite : bool
        Whether a file that is there may be replaced.

    Returns
    -------
    int
        Number of ties written.

    Raises
    ------
    TermselError
        If the folder has no block, the suffix is another, a package is missing, or the file is
        there or cannot be written.

    Examples
    --------
    >>> from termsel.testing import invoke
    >>> from termsel_block import adjust, read_block, write_block, write_places
    >>> written = invoke("block-example", "scene")
    >>> record = write_block(adjust(read_block("scene/block.toml")), "adjusted")
    >>> write_places("adjusted", "ties.gpkg")
    159
    """
    folder = Path(folder)
    target = Path(target)
    writers = {".gpkg": _write_geopackage, ".las": _write_cloud, ".laz": _write_cloud}
    if target.suffix.lower() not in writers:
        raise TermselError(f"the suffix {target.suffix!r} is of no known format", file=target,
                           hint=f"Known: {', '.join(writers)}.")
    require_replaceable([target], reads=[folder / RECORD, folder / TIES], overwrite=overwrite)
    ids, values, crs = _read_ties(folder)
    # A private folder has the file until it is complete, so that no half of it takes the target.
    with private_folder() as private:
        complete_file = private / f"places{target.suffix.lower()}"
        writers[target.suffix.lower()](complete_file, target, ids, values, crs)
        write_bytes(target, complete_file.read_bytes())
    return len(ids)


def _read_ties(folder: Path) -> tuple[list[str], FloatArray, str]:
    """Return the ids of the ties of a block (n), the other columns of ties.csv (n, 7), and the CRS.

    The columns are x, y, z, the standard deviations to the east, to the north and up [m], and the
    number of images. The CRS is "local" if the block has none. Raises TermselError if the folder
    has no block, or its files are damaged.
    """
    for name in (RECORD, TIES):
        if not path_inside(folder, name).is_file():
            raise TermselError(f"there is no block in this folder: it has no {name}", file=folder,
                               hint="Name the folder that termsel block --out wrote.")
    try:
        record = msgspec.json.decode(read_data(folder / RECORD), type=dict[str, Any])
        text = read_text(folder / TIES)
    except (msgspec.DecodeError, RecursionError) as error:
        raise TermselError(f"this is not the file of a block: {error}", file=folder / RECORD,
                           hint="Run termsel block again.") from error
    # The first row is the header.
    try:
        rows = list(csv.reader(io.StringIO(text)))[1:]
        values = np.array([row[1:] for row in rows], float).reshape(len(rows), 7)
    except (ValueError, csv.Error) as error:
        raise TermselError("this is not the table of ties that termsel block wrote",
                           file=folder / TIES, hint="Run termsel block again.") from error
    return [unguard_cell(row[0]) for row in rows], values, str(record.get("crs") or LOCAL)


def _write_geopackage(complete_file: Path, target: Path, ids: list[str], values: FloatArray,
                      crs: str) -> None:
    """Write the ties as a layer of points into `complete_file`.

    `values` (n, 7) are as `_read_ties` returns them. `target` is the name that the file gets later,
    for messages. Raises TermselError without shapely or pyogrio.
    """
    shapely = _import_required("shapely", target, "termsel[gis]")
    write = _import_required("pyogrio.raw", target, "termsel[gis]").write
    names = ["id", "sigma_east", "sigma_north", "sigma_up", "images"]
    fields = [np.array(ids, object), *values[:, 3:6].T, values[:, 6].astype(np.int32)]
    with warnings.catch_warnings():
        # The layer of a block in plane coordinates has no CRS on purpose.
        warnings.filterwarnings("ignore", "'crs' was not provided")
        write(str(complete_file), shapely.to_wkb(shapely.points(values[:, :3])), fields, names,
              layer="places", driver="GPKG", geometry_type="Point Z",
              crs=horizontal_crs(crs) or None,
              dataset_options={"VERSION": "1.3"})


def _write_cloud(complete_file: Path, target: Path, _: list[str], values: FloatArray,
                 crs: str) -> None:
    """Write the ties without their ids as LAS or LAZ into `complete_file`.

    `values` (n, 7) are as `_read_ties` returns them. `target` is the name that the file gets later,
    for messages. Raises TermselError without laspy or pyproj, or without lazrs for LAZ.
    """
    laspy = _import_required("laspy", target, "termsel-block[las]")
    header = laspy.LasHeader(point_format=6, version="1.4")
    horizontal = horizontal_crs(crs)
    is_in_degrees = False
    if horizontal:
        crs_of_pyproj = _import_required("pyproj", target, "termsel[gis]").CRS(horizontal)
        is_in_degrees = crs_of_pyproj.is_geographic
        header.add_crs(crs_of_pyproj)
    # LAS stores coordinates as whole numbers of steps from an offset.
    header.offsets = np.floor(values[:, :3].min(axis=0)) if len(values) else np.zeros(3)
    step = _LAS_STEPS[is_in_degrees]
    # Heights are in metres even if the CRS is in degrees.
    header.scales = np.array([step, step, _LAS_STEPS[0]])
    names = ("sigma_east", "sigma_north", "sigma_up")
    header.add_extra_dims([laspy.ExtraBytesParams(name, np.float32) for name in names]
                          + [laspy.ExtraBytesParams("images", np.uint16)])
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = values[:, :3].T
    for name, column in zip(names, values[:, 3:6].T, strict=True):
        cloud[name] = column.astype(np.float32)
    cloud["images"] = values[:, 6].astype(np.uint16)
    try:
        cloud.write(str(complete_file))
    except laspy.LaspyException as error:
        raise TermselError(f"laspy cannot write this: {str(error).rstrip('.')}", file=target,
                           hint="LAZ needs lazrs: pip install lazrs. Or name a .las.") from error


def _import_required(module: str, target: Path, package: str) -> Any:
    """Return the module that the format of a file requires.

    Raises TermselError that names `package`, which has the module, if it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise TermselError(f"this format requires {module.partition('.')[0]}", file=target,
                           hint=f"pip install {package!r}") from error
