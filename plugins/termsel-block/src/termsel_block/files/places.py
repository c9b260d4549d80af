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
"""Steps of coordinates in LAS: of metres, and of degrees, which are a millimetre."""


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
    # Written in a private folder first, so that the target is replaced by a complete file.
    with private_folder() as private:
        complete = private / f"places{target.suffix.lower()}"
        writers[target.suffix.lower()](complete, target, ids, values, crs)
        write_bytes(target, complete.read_bytes())
    return len(ids)


def _read_ties(folder: Path) -> tuple[list[str], FloatArray, str]:
    """Return names, the other columns (n, 7) of ties.csv, and the CRS of a block.

    The columns are x, y, z, their standard deviations east, north, up [m], and the number of
    images. Raises TermselError if the folder has no block, or files that are damaged.
    """
    for name in (RECORD, TIES):
        if not path_inside(folder, name).is_file():
            raise TermselError(f"there is no block in this folder: it has no {name}", file=folder,
                               hint="Name the folder that termsel block --out wrote.")
    # Both files come from disk, where anything may have happened to them.
    try:
        record = msgspec.json.decode(read_data(folder / RECORD), type=dict[str, Any])
        text = read_text(folder / TIES)
    except (msgspec.DecodeError, RecursionError) as error:
        raise TermselError(f"this is not the file of a block: {error}", file=folder / RECORD,
                           hint="Run termsel block again.") from error
    try:
        rows = list(csv.reader(io.StringIO(text)))[1:]
        values = np.array([row[1:] for row in rows], float).reshape(len(rows), 7)
    except (ValueError, csv.Error) as error:
        raise TermselError("this is not the table of ties that termsel block wrote",
                           file=folder / TIES, hint="Run termsel block again.") from error
    return [unguard_cell(row[0]) for row in rows], values, str(record.get("crs") or LOCAL)


def _write_geopackage(complete: Path, target: Path, ids: list[str], values: FloatArray,
                      crs: str) -> None:
    """Write the ties as a layer of points to the file `complete`, which then becomes `target`.

    `values` (t, 7) are x, y, z, three standard deviations [m] and the number of images.
    """
    shapely = _import_needed("shapely", target, "termsel[gis]")
    write = _import_needed("pyogrio.raw", target, "termsel[gis]").write
    names = ["id", "sigma_east", "sigma_north", "sigma_up", "images"]
    fields = [np.array(ids, object), *values[:, 3:6].T, values[:, 6].astype(np.int32)]
    with warnings.catch_warnings():
        # Plane coordinates have none, as the block says.
        warnings.filterwarnings("ignore", "'crs' was not provided")
        write(str(complete), shapely.to_wkb(shapely.points(values[:, :3])), fields, names,
              layer="places", driver="GPKG", geometry_type="Point Z",
              crs=horizontal_crs(crs) or None,
              dataset_options={"VERSION": "1.3"})


def _write_cloud(complete: Path, target: Path, _: list[str], values: FloatArray, crs: str) -> None:
    """Write the ties as a LAS file `complete`, which then becomes `target`; it has no ids.

    `values` (n, 7) are x, y, z, standard deviations to the east, to the north and up [m], and the
    number of images of each tie. LAS stores whole steps from an offset, whose size depends on
    whether the CRS counts degrees. Raises TermselError without laspy, or without what it needs for
    LAZ.
    """
    laspy = _import_needed("laspy", target, "termsel-block[las]")
    header = laspy.LasHeader(point_format=6, version="1.4")
    system_name = horizontal_crs(crs)
    degrees = False
    if system_name:
        system = _import_needed("pyproj", target, "termsel[gis]").CRS(system_name)
        degrees = system.is_geographic
        header.add_crs(system)
    # LAS holds whole numbers of steps from an offset.
    header.offsets = np.floor(values[:, :3].min(axis=0)) if len(values) else np.zeros(3)
    step = _LAS_STEPS[degrees]
    # Heights are in metres in either case.
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
        cloud.write(str(complete))
    except laspy.LaspyException as error:
        raise TermselError(f"laspy cannot write this: {str(error).rstrip('.')}", file=target,
                           hint="LAZ needs lazrs: pip install lazrs. Or name a .las.") from error


def _import_needed(module: str, target: Path, package: str) -> Any:
    """Import the module that a format requires.

    Raises TermselError with the package if it is missing.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise TermselError(f"this format requires {module.partition('.')[0]}", file=target,
                           hint=f"pip install {package!r}") from error
