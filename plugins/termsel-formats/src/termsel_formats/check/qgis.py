"""Where QGIS shows a raster, by qgis_process."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from termsel.toolkit import private_folder
from termsel_formats.check.base import NONE, NoAnswer, Taken, answer, find_program
from termsel_formats.check.gdal import (
    Header,
    border_places,
    transformation_of_gdal,
    with_fixed_height,
)

# Difference of the extents by QGIS and by GDAL up to which they agree [px of QGIS's map].
_MAX_DIFFERENCE = 3.0


@contextmanager
def restore_afterwards(file: Path) -> Iterator[None]:
    """Restore the content of a file at the end of the context; remove it if there was none."""
    content = file.read_bytes() if file.is_file() else None
    try:
        yield
    finally:
        if content is None:
            file.unlink(missing_ok=True)
        elif file.read_bytes() != content:
            file.write_bytes(content)


def taken_by_qgis(path: Path, raster_header: Header) -> Taken | None:
    """Return what QGIS takes from a raster; None if QGIS is not installed.

    QGIS reports the extent of a layer alone. Its transformation is taken to be the one whose
    outline has that extent: GDAL's default, or an RPC at its height offset, as QGIS takes it from
    version 3.14 on (`QgsGdalUtils::rpcAwareAutoCreateWarpedVrt`). `places` is None if neither has,
    and for a raster that is not georeferenced. The .aux.xml beside it, which QGIS writes, is
    restored.

    Raises
    ------
    NoAnswer
        If QGIS cannot read the raster, or answers in another form.
    """
    # On some systems qgis_process is a script that adds an option which the program does not know.
    program = find_program("qgis_process.bin") or find_program("qgis_process")
    if program is None:
        return None
    with private_folder() as folder:
        # QGIS has a Python of its own, which another one would hide, and no screen is needed.
        environment = {key: value for key, value in os.environ.items()
                       if key not in ("VIRTUAL_ENV", "PYTHONHOME", "PYTHONPATH")} | {
            "PATH": os.pathsep.join([str(Path(program).parent), os.defpath]),
            "QT_QPA_PLATFORM": "offscreen", "QGIS_CUSTOM_CONFIG_PATH": str(folder)}
        # QGIS writes the statistics of a layer next to its raster.
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
        return Taken(name, NONE)
    by_gdal = transformation_of_gdal(path)
    border = border_places(raster_header.size)
    words = {"geotransform": "affine transformation", "gcps": "as GDAL, through GCPs",
             "rpc": "RPC at the height 0", "geolocation": "geolocation array"}[raster_header.kind]
    transforms = {words: with_fixed_height(by_gdal)}
    if raster_header.height is not None:
        height = raster_header.height
        transforms[f"RPC at its height offset, {height:,.0f} m"] = with_fixed_height(
            by_gdal, height)
    differences = {}
    # QGIS's map is the box around the image on the ground, which the border of the image spans.
    for words, transform in transforms.items():
        border_on_map = transform(border, np.zeros(len(border)))
        lowest = np.nanmin(border_on_map, axis=0)
        highest = np.nanmax(border_on_map, axis=0)
        differences[words] = float(
            np.abs((np.concatenate([lowest, highest]) - extent) / pixel).max())
    words = min(differences, key=differences.__getitem__)
    # The difference is NaN if the whole border has no ground position: the extents do not agree.
    agrees = differences[words] <= _MAX_DIFFERENCE
    if not agrees:
        return Taken(name, f"another than GDAL: its extent is {differences[words]:,.0f} px off")
    return Taken(name, words, raster_header.crs, transforms[words])
