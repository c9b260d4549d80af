"""Where QGIS shows a raster, by qgis_process."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from termsel.toolkit import private_folder
from termsel_formats.check.base import NoAnswer, Taken, answer, find_program
from termsel_formats.check.gdal import (
    Header,
    border_places,
    transformation_of_gdal,
    with_fixed_height,
)

_NEAR = 3.0  # px of the map that QGIS makes, by which its extent may differ from GDAL's


@contextmanager
def restore_afterwards(file: Path) -> Iterator[None]:
    """Restore a file afterwards, or remove one that was not there.

    QGIS writes the statistics of a layer next to its raster.
    """
    before = file.read_bytes() if file.is_file() else None
    try:
        yield
    finally:
        if before is None:
            file.unlink(missing_ok=True)
        elif file.read_bytes() != before:
            file.write_bytes(before)


def taken_by_qgis(path: Path, raster_header: Header) -> Taken | None:
    """Return what QGIS takes, or None where it is not installed.

    QGIS opens a raster with GCPs, RPCs or a rotated geotransform through GDAL's warped raster, by
    the transformation that GDAL takes by default. It takes an RPC at its height offset, from
    version 3.14 on (`QgsGdalUtils::rpcAwareAutoCreateWarpedVrt`), where GDAL itself and earlier
    versions take the height 0. What is believed is the one with which the extent of the layer
    agrees.

    Raises
    ------
    NoAnswer
        If QGIS cannot read the raster.
    """
    # The script of this name on some systems hands on an option that the program has not.
    program = find_program("qgis_process.bin") or find_program("qgis_process")
    if program is None:
        return None
    with private_folder() as folder:
        # QGIS has a Python of its own, which another one would hide, and no screen is needed.
        environment = {key: value for key, value in os.environ.items()
                       if key not in ("VIRTUAL_ENV", "PYTHONHOME", "PYTHONPATH")} | {
            "PATH": os.pathsep.join([str(Path(program).parent), os.defpath]),
            "QT_QPA_PLATFORM": "offscreen", "QGIS_CUSTOM_CONFIG_PATH": str(folder)}
        with restore_afterwards(path.with_name(f"{path.name}.aux.xml")):
            text = answer([program, "run", "--json", "native:rasterlayerproperties", "--",
                           f"INPUT={path.absolute()}"], environment=environment)
    try:
        report = json.loads(text)
        layer = report["results"]
        name = f"QGIS {report['qgis_version'].partition('-')[0]}"
        extent = np.array([layer[key] for key in ("X_MIN", "Y_MIN", "X_MAX", "Y_MAX")], dtype=float)
        pixel = np.array([layer["PIXEL_WIDTH"], layer["PIXEL_HEIGHT"]] * 2, dtype=float)
    except (ValueError, KeyError):
        raise NoAnswer("qgis_process gave an answer of another form") from None
    if not raster_header.kind:
        return Taken(name, "none: no georeferencing")
    by_gdal = transformation_of_gdal(path)
    border = border_places(raster_header.size)
    words = {"geotransform": "affine transformation", "gcps": "as GDAL, through GCPs",
             "rpc": "RPC at the height 0", "geolocation": "geolocation array"}[raster_header.kind]
    ways = {words: with_fixed_height(by_gdal)}
    if raster_header.height is not None:
        height = raster_header.height
        ways[f"RPC at its height offset, {height:,.0f} m"] = with_fixed_height(by_gdal, height)
    # The way whose outline has the extent that QGIS shows is the one that it took.
    away = {}
    for words, transform in ways.items():
        border_on_map = transform(border, np.zeros(len(border)))
        lowest = np.nanmin(border_on_map, axis=0)
        highest = np.nanmax(border_on_map, axis=0)
        away[words] = float(np.abs((np.concatenate([lowest, highest]) - extent) / pixel).max())
    words = min(away, key=away.__getitem__)
    if not away[words] <= _NEAR:
        return Taken(name, f"another than GDAL: its extent is {away[words]:,.0f} px off")
    return Taken(name, words, raster_header.crs, ways[words])
