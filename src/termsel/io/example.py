"""The files of the tutorial and of the how-to guides, all simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from json import dumps
from pathlib import Path
from typing import Any

import numpy as np

from termsel.core.files.atomic import new_folder, write_text
from termsel.data.coordinates.crs import transformation_between
from termsel.data.features import FloatArray, Lines, Points
from termsel.data.rasters import require_rasterio, tiff_bytes
from termsel.formats.readers.csv_tables import table_text, write_lines_csv, write_points_csv
from termsel.simulate.example import (
    BOARD,
    CRS,
    GSD,
    LAT,
    LON,
    MAP_CRS,
    SENSOR,
    SIZE,
    example_terrain,
    ground_of_corners,
    picture_and_points,
)
from termsel.simulate.kept import kept_features, kept_text
from termsel.simulate.scenes import scene_truth
from termsel.simulate.sheets import GRID_SPACING, SHEET_CRS, SHEETS, sheet_and_points

README = "README.txt"

EXAMPLE_FILES = {
    "scene.tif": "the image of the tutorial: a checkerboard on hills",
    "dem.tif": "its heights, ellipsoidal",
    "gcps.csv": "its control points: 97 corners of the board",
    "noheader.txt": "40 of them without a header: id, longitude, latitude, height, sample, line",
    "scene.points": "60 of them as QGIS saves them: UTM, no heights",
    "vendor.RPB": "its RPC as a vendor delivers it, 17 px off",
    "ortho.tif": "a map of the same area",
    "matches.csv": "120 matches of image and map, 18 of them wrong; and the same as",
    "matches.txt": "the Ames Stereo Pipeline has them, and as",
    "tiepoints.csv": "AROSICS has them",
    "places.csv": "ground positions, for termsel project",
    "pixels.csv": "image positions, for termsel project --inverse",
    "crossroads.csv": "points that could be measured, for termsel plan",
    "points.csv": "another scene, ikonos-hamedan: 74 points with roles",
    "lines.csv": "its 120 control lines, 8 of them wrong",
    "roads.geojson": "30 of these lines as a GIS has them, and",
    "roads.csv": "their image coordinates",
    "areas.csv": "six fields of that scene",
    "images": "points of five images; one has a blunder",
    "maps": "scans of four sheets of a map, and their points as QGIS saves them",
    "study.toml": "a study of three solvers",
}
"""What each file is, by its name."""

_STUDY = """\
title = "Three solvers"
problems = [{name = "poly-terms", degree = 3}]
solvers = ["random", {name = "ga", population = 40}, "exact"]
seeds = 5
[budget]
evaluations = 200
"""


def write_example(folder: Path) -> None:
    """Write the files to a new folder, completely or not at all.

    Half an example would fail in the middle of a tutorial. Raises TermselError if the folder exists
    or cannot be written, and if the extra ``gis`` is not installed.
    """
    require_rasterio()
    to_map = transformation_between(CRS, MAP_CRS)
    with new_folder(folder) as new:
        points = _write_scene(new)
        _write_other_forms(new, points, to_map(points.ground))
        _write_matches(new, to_map)
        _write_places(new)
        _write_control_features(new)
        _write_batch(new / "images")
        _write_sheets(new / "maps")
        (new / "study.toml").write_text(_STUDY, encoding="utf-8")
        width = max(map(len, EXAMPLE_FILES))
        lines = [f"{name:{width}}  {description}\n" for name, description in EXAMPLE_FILES.items()]
        (new / README).write_text("Simulated data.\n\n" + "".join(lines), encoding="utf-8")


def _write_scene(folder: Path) -> Points:
    """Write the image, its heights, control and vendor's RPC; return the control points."""
    pixels, points = picture_and_points()
    (folder / "scene.tif").write_bytes(tiff_bytes(pixels[None]))
    # Pixels of some 20 m on the ground [deg], and so many that the raster is wider than the scene.
    step, n = 0.0002, 520
    west = LON - n / 2 * step
    north = LAT + n / 2 * step
    middles = _pixel_middles(west, north, step, (n, n))
    heights = example_terrain()(middles).reshape(n, n).astype(np.float32)
    _write_map(folder / "dem.tif", heights, west, north, step, "EPSG:4326")
    write_points_csv(points, folder / "gcps.csv", CRS)
    write_text(folder / "vendor.RPB", kept_text("vendor.RPB"))
    return points


def _write_other_forms(folder: Path, points: Points, on_map: FloatArray) -> None:
    """Write the control without a header, and as QGIS saves it."""
    rows = zip(points.ids, points.ground.tolist(), points.image.tolist(), strict=True)
    _write_rows(folder / "noheader.txt", [
        (name, x, y, z, sample, line) for name, (x, y, z), (line, sample) in rows][:40])
    _write_qgis_points(folder / "scene.points", on_map[:60, :2], points.image[:60], MAP_CRS)


def _write_qgis_points(path: Path, ground: FloatArray, image: FloatArray, crs: str) -> None:
    """Write points as QGIS saves them, from ground (x, y) and image (line, sample)."""
    from pyproj import CRS as Known

    # QGIS counts px from the corner of the first pixel, to the right and upwards.
    _write_rows(path, [
        (f"{x:.3f}", f"{y:.3f}", f"{sample + 0.5:.3f}", f"{-line - 0.5:.3f}", 1, 0, 0, 0)
        for (x, y), (line, sample) in zip(ground.tolist(), image.tolist(), strict=True)],
        f"#CRS: {Known(crs).to_wkt()}",
        "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual")


def _write_matches(folder: Path, to_map: Callable[[FloatArray], FloatArray]) -> None:
    """Write a map of the board, and 120 matches of the image with it; every 7th is wrong.

    The matches are written as three programs have them: termsel's CSV, a match file of the Ames
    Stereo Pipeline and a table of AROSICS, so that the pages show how each is read. `to_map` takes
    ground positions (n, 3) to the map. Wrong matches are off by 8 to 40 px in line and in sample.
    """
    west, top = _write_ortho(folder / "ortho.tif", to_map)
    # A fixed seed, so that the pages can quote what comes out.
    rng = np.random.default_rng(5)
    ground = ground_of_corners()[rng.permutation(len(ground_of_corners()))[:120]]
    image = SENSOR.project(ground) + rng.normal(0.0, 0.3, (len(ground), 2))
    # Blunders, which matching has to find.
    image[::7] += rng.choice([-1, 1], image[::7].shape) * rng.uniform(8, 40, image[::7].shape)
    mapped = np.asarray(to_map(ground))
    # From the corner of the map to the centre of its upper-left pixel it is half a pixel.
    reference = np.column_stack([top - mapped[:, 1], mapped[:, 0] - west]) / GSD - 0.5
    image = image.round(3)
    reference = reference.round(3)
    _write_rows(folder / "matches.csv", np.hstack([image, reference]).tolist(),
                "image_line,image_sample,reference_line,reference_sample")
    # The counts of both images, then their interest points; of each nine more numbers follow.
    zeros = [0] * 9
    _write_rows(folder / "matches.txt", [(f"{len(image)} {len(image)}",), *(
        (" ".join(map(str, (sample, line, *zeros))),)
        for line, sample in [*image.tolist(), *reference.tolist()])])
    # AROSICS counts pixels from the corner of the image. It states a place on the map where it
    # believed the image to be, here 20 m west and 10 m north, and the shift from there.
    _write_rows(folder / "tiepoints.csv", [
        (i, sample + 0.5, line + 0.5, round(x - 20, 3), round(y + 10, 3), 20, -10)
        for i, ((line, sample), (x, y, _)) in enumerate(
            zip(image.tolist(), mapped.tolist(), strict=True), 1)],
        "POINT_ID,X_IM,Y_IM,X_MAP,Y_MAP,X_SHIFT_M,Y_SHIFT_M")


def _write_ortho(path: Path, to_map: Callable[[FloatArray], FloatArray]) -> tuple[float, float]:
    """Write a map of the board with some ground around it; return its west and north edge [m].

    `to_map` takes ground positions to east and north on the map (n, 2 or 3).
    """
    to_ground = transformation_between(MAP_CRS, CRS)
    east, north, _ = np.array(to_map(ground_of_corners())).T
    west = np.floor(east.min() / GSD) * GSD - 200.0  # m
    top = np.ceil(north.max() / GSD) * GSD + 200.0
    shape = (int((top - north.min()) / GSD) + 20, int((east.max() - west) / GSD) + 20)  # px
    # The board has no heights.
    middles = np.column_stack(
        [_pixel_middles(west, top, GSD, shape), np.zeros(shape[0] * shape[1])])
    board = BOARD(np.asarray(to_ground(middles))[:, :2]).reshape(shape).astype(np.uint8)
    _write_map(path, board, west, top, GSD, MAP_CRS)
    return float(west), float(top)


def _write_places(folder: Path) -> None:
    """Write ground places and image positions, to be projected and located."""
    rng = np.random.default_rng(6)
    # Not at the edge of the image, where no control is near.
    image = rng.uniform(0.05, 0.95, (17, 2)) * SIZE
    positions = SENSOR.locate(image, 1800.0).round(6)
    ground = np.column_stack([positions, example_terrain()(positions).round(2)]).tolist()
    for file, name, rows in (("places.csv", "place", ground[:5]),
                             ("crossroads.csv", "crossroad", ground[5:])):
        _write_rows(folder / file, [(f"{name} {i}", *row) for i, row in enumerate(rows, 1)],
                    "id,x,y,z")
    _write_rows(folder / "pixels.csv", [("middle", 249.5, 299.5), ("corner", 20, 30)],
                "id,line,sample")


def _write_control_features(folder: Path) -> None:
    """Write points, lines, roads and areas of the scene ikonos-hamedan."""
    scene = kept_features("termsel.simulate", "ikonos-hamedan")
    truth = scene_truth("ikonos-hamedan")
    write_points_csv(scene.points, folder / "points.csv", CRS)
    write_lines_csv(scene.lines, folder / "lines.csv", CRS)
    _write_roads(folder, scene.lines)
    # Squares about six of the points, corners in order.
    square = 0.0006 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])  # deg
    positions = (square + scene.points.ground[5:11, None, :2]).reshape(-1, 2)
    ground = np.column_stack([positions, truth.terrain(positions)])
    image = truth.sensor.project(ground).round(2)
    (folder / "areas.csv").write_text(table_text(
        CRS, ["id", "corner", "line", "sample", "x", "y", "z"],
        [[f"field {i // 4 + 1}", str(i % 4 + 1)] for i in range(len(image))],
        np.column_stack([image, positions.round(7), ground[:, 2].round(2)])), encoding="utf-8")


def _write_roads(folder: Path, lines: Lines) -> None:
    """Write lines of a map, and the same lines measured in the image."""
    features = [{"type": "Feature", "properties": {"name": name}, "geometry": {
        "type": "LineString", "coordinates": ground}} for name, ground in zip(
            lines.ids[:30], lines.ground[:30].tolist(), strict=True)]
    (folder / "roads.geojson").write_text(
        dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    _write_rows(folder / "roads.csv", [
        (name, *row) for name, row in zip(
            lines.ids[:30], lines.image[:30].reshape(-1, 4).tolist(), strict=True)],
        "id,line1,sample1,line2,sample2")


def _write_batch(folder: Path) -> None:
    """Write the control of five images, one of them with a blunder."""
    folder.mkdir()
    for i in range(1, 6):
        points = kept_features("termsel.simulate", f"image-{i}").points
        image = points.image.round(2)
        if i == 3:
            # The blunder that the how-to guide of batches finds.
            image[4] += (-40.0, 25.0)
        write_points_csv(Points(points.ids, image, points.ground), folder / f"image-{i}.csv", CRS)


def _write_sheets(folder: Path) -> None:
    """Write the scans and points of four sheets, two of them with an error of the typist."""
    folder.mkdir()
    for sheet in range(SHEETS):
        scan, ground, image = sheet_and_points(sheet)
        (folder / f"sheet-{sheet + 1}.tif").write_bytes(tiff_bytes(scan[None], compress="deflate"))
        # The tutorial for archivists finds both: x and y swapped, and a neighbouring crossing.
        if sheet == 1:
            ground = ground[:, ::-1]
        if sheet == 3:
            ground[5, 0] += GRID_SPACING
        _write_qgis_points(folder / f"sheet-{sheet + 1}.points", ground, image, SHEET_CRS)


def _pixel_middles(west: float, north: float, step: float, shape: tuple[int, int]) -> FloatArray:
    """Return x and y of the middles of the pixels of a map, row by row, shape (n, 2)."""
    x, y = np.meshgrid(west + (np.arange(shape[1]) + 0.5) * step,
                       north - (np.arange(shape[0]) + 0.5) * step)
    return np.column_stack([x.ravel(), y.ravel()])


def _write_map(path: Path, pixels: Any, west: float, north: float, step: float, crs: str) -> None:
    """Write pixels (lines, samples) as a GeoTIFF from its corner and step [CRS units]."""
    from affine import Affine

    path.write_bytes(tiff_bytes(pixels[None], crs=crs, compress="deflate",
                                transform=Affine(step, 0.0, west, 0.0, -step, north)))


def _write_rows(path: Path, rows: Iterable[Iterable[object]], *header: str) -> None:
    """Write a CSV: header lines, then rows."""
    text = [*header, *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
