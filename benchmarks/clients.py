"""What other programs make of exported files, compared with the model: GDAL, OTB, Orthority, QGIS.

    apt-get install gdal-bin otb-bin python3-qgis
    python3 -m venv oty && oty/bin/pip install orthority
    python -m benchmarks.clients --orthority oty/bin/python --qgis /usr/bin/python3

Each program that is found transforms places of a simulated scene by each form it reads, and the
table states the largest deviation from the fitted model in px. GDAL and OTB are called by their
commands, Orthority and QGIS in the Python that has them. Programs that are not found are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import termsel
from termsel.data.features import FloatArray
from termsel.formats.deviation import places_of
from termsel.simulate import simulate_scene

Row = tuple[str, str, str, float]
"""Program, its version, form, and the largest deviation [px]."""

PLACES = 25  # that OTB transforms, one call each

ORTHORITY = """
import json, sys
from importlib.metadata import version
import numpy as np
from orthority.factory import RpcCameras
image, ground = sys.argv[1], np.array(json.load(sys.stdin))
pixels = RpcCameras.from_images([image]).get(image).world_to_pixel(ground.T)
print(json.dumps([version("orthority"), pixels[::-1].T.tolist()]))
"""

QGIS = """
import json, sys
from qgis.core import Qgis, QgsApplication, QgsRasterLayer
QgsApplication.setPrefixPath("/usr", True)
application = QgsApplication([], False)
application.initQgis()
layer = QgsRasterLayer(sys.argv[1], "scene")
box = layer.extent()
print(json.dumps([Qgis.QGIS_VERSION.split("-")[0], layer.crs().authid(),
                  [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()],
                  layer.rasterUnitsPerPixelX()]))
"""


def scene(folder: Path) -> termsel.Result:
    """Write an empty image of a simulated scene, and the result of an RPC-like fit in all forms."""
    import rasterio

    features = simulate_scene("ikonos-hamedan", n_lines=0)
    result = termsel.run("rfm-terms", features=features, model="poly3d", solver="all-terms",
                         criterion="press")
    assert features.image_size is not None
    lines, samples = features.image_size
    for name in ("rpb", "txt", "plain"):
        with rasterio.open(folder / f"{name}.tif", "w", driver="GTiff", width=samples,
                           height=lines, count=1, dtype="uint8", compress="deflate", tiled=True):
            pass
    image = str(folder / "plain.tif")
    termsel.export(result, "rpb", folder / "rpb.RPB", image=str(folder / "rpb.tif"))
    termsel.export(result, "rpc-txt", folder / "txt_RPC.TXT", image=str(folder / "txt.tif"))
    termsel.export(result, "rpc-vrt", folder / "rpc.vrt", image=image)
    height = level_of(result)
    termsel.export(result, "gcp-grid-vrt", folder / "grid.vrt", image=image, height=height)
    termsel.export(result, "geolocation-vrt", folder / "array.vrt", image=image, height=height)
    return result


def level_of(result: termsel.Result) -> float:
    """Return the height of the middle of the control."""
    return float(result.fit.ground_box()[0][2])


def worst(image: FloatArray, other: FloatArray) -> float:
    """Return the largest distance between image places [px]."""
    return float(np.hypot(*(image - other).T).max())


RPCS = {"rpb": "rpb.tif", "rpc-txt": "txt.tif", "rpc-vrt": "rpc.vrt"}


def by_gdal(result: termsel.Result, folder: Path) -> Iterator[Row]:
    """Yield what gdaltransform makes of each form."""
    version = re.search(r"GDAL ([\d.]+)", _output(["gdalinfo", "--version"]))
    assert version is not None
    places = places_of(result.fit)
    level = places[places[:, 2] == level_of(result)]
    for form, name, option, ground in (
            *((form, name, "-rpc", places) for form, name in RPCS.items()),
            ("gcp-grid-vrt", "grid.vrt", "-tps", level),
            ("geolocation-vrt", "array.vrt", "-geoloc", level)):
        text = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in ground.tolist())
        printed = _output(["gdaltransform", "-i", option, str(folder / name)], text)
        found = np.array([line.split()[:2] for line in printed.splitlines()], dtype=float)
        # GDAL counts from the corner of the upper-left pixel.
        yield ("GDAL", version[1], form,
               worst(found[:, ::-1] - 0.5, result.project(ground)))


def by_otb(result: termsel.Result, folder: Path) -> Iterator[Row]:
    """Yield what OTB makes of the forms of RPCs, from the image to the ground at height 0."""
    version = re.search(r"version ([\d.]+)", _output(["otbcli_ReadImageInfo", "-help"]))
    assert result.features.image_size is not None
    lines, samples = result.features.image_size
    side = np.linspace(0.1, 0.9, round(PLACES**0.5))
    image = np.rint(np.stack(np.meshgrid(side * lines, side * samples), axis=-1).reshape(-1, 2))
    for form, name in RPCS.items():
        ground = []
        for line, sample in image.astype(int).tolist():
            printed = _output(["otbcli_ConvertSensorToGeoPoint", "-in", str(folder / name),
                               "-input.idx", str(sample), "-input.idy", str(line)])
            found = re.findall(r"output\.id[xy]: (\S+)", printed)
            if len(found) != 2:
                break
            ground.append([float(found[0]), float(found[1]), 0.0])
        apart = worst(result.project(ground), image) if len(ground) == len(image) else np.inf
        yield "OTB", version[1] if version else "", form, apart


def by_orthority(result: termsel.Result, folder: Path, python: str) -> Iterator[Row]:
    """Yield what Orthority makes of the forms of RPCs."""
    ground = places_of(result.fit)
    for form, name in RPCS.items():
        printed = _output([python, "-c", ORTHORITY, str(folder / name)],
                          json.dumps(ground.tolist()))
        version, image = json.loads(printed.splitlines()[-1])
        yield "Orthority", version, form, worst(np.array(image), result.project(ground))


def by_qgis(result: termsel.Result, folder: Path, python: str) -> Iterator[Row]:
    """Yield how far the extent of QGIS's layer is from that of the image at the middle height."""
    assert result.features.image_size is not None
    lines, samples = result.features.image_size
    down, right = np.linspace(-0.5, lines - 0.5, 201), np.linspace(-0.5, samples - 0.5, 201)
    edge = np.concatenate([
        [[line, sample] for line in down for sample in (right[0], right[-1])],
        [[line, sample] for sample in right for line in (down[0], down[-1])]])
    ground = result.locate(edge, result.to_rpc().ground_offset[2])[:, :2]
    ours = np.array([*ground.min(axis=0), *ground.max(axis=0)])
    for form, name in RPCS.items():
        printed = _output([python, "-c", QGIS, str(folder / name)])
        version, _, theirs, unit = json.loads(printed.splitlines()[-1])
        yield "QGIS", version, form, float(np.abs(ours - theirs).max() / unit)


def measured(folder: Path, orthority: str | None = None, qgis: str | None = None) -> list[Row]:
    """Return the rows of the table for the programs that are here.

    Parameters
    ----------
    folder : pathlib.Path
        For the files.
    orthority, qgis : str, optional
        Python interpreters that have them.
    """
    result = scene(folder)
    rows: list[Row] = []
    if shutil.which("gdaltransform"):
        rows += by_gdal(result, folder)
    if shutil.which("otbcli_ConvertSensorToGeoPoint"):
        rows += by_otb(result, folder)
    if orthority:
        rows += by_orthority(result, folder, orthority)
    if qgis:
        rows += by_qgis(result, folder, qgis)
    return rows


def _output(command: list[str], given: str = "") -> str:
    # Without a display QGIS needs to be told.
    done = subprocess.run(command, input=given, text=True, capture_output=True, check=False,
                          env={"QT_QPA_PLATFORM": "offscreen", **os.environ})
    return done.stdout or done.stderr


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--orthority", help="Python that has orthority")
    parser.add_argument("--qgis", help="Python that has qgis")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        rows = measured(Path(folder), given.orthority, given.qgis)
    print("| program | version | form | largest deviation [px] |\n|---|---|---|---|")
    for program, version, form, apart in rows:
        figure = ("not read" if np.isinf(apart) else "below 1e-6" if apart < 1e-6
                  else f"{apart:.2g}")
        print(f"| {program} | {version} | `{form}` | {figure} |")
    if not rows:
        sys.exit("None of the programs was found.")


if __name__ == "__main__":
    main()
