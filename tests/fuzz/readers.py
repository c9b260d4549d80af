"""Files for every reader that is installed: written by termsel itself, or by GDAL and libraries."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np

import termsel
from termsel.core.errors import TermselError
from termsel.plugins.registry import registry
from termsel.toolkit import open_layer
from tests.fuzz.seeds import Seed, result_files, seeds

Use = Callable[[Path, Random], int]
_WITHOUT_CRS = ("asp-gcp", "erdas-gcps", "micmac-xml", "pci-gcp", "pix4d-marks")
"""Formats that state none."""

_VECTORS = {"roads.kml": "KML", "roads.gml": "GML", "roads.fgb": "FlatGeobuf",
            "roads.gpx": "GPX", "roads.geojson": "GeoJSON"}


@cache
def _exported() -> dict[str, dict[str, bytes]]:
    """Return the files of each format that is both written and read, by the name of its reader."""
    found = {}
    both = set(registry().names("readers")) & set(registry().names("writers"))
    both -= {"world-file"}  # which is read next to an image alone; any reader is given any file
    with TemporaryDirectory() as name:
        for file, content in result_files().items():
            (Path(name) / file).write_bytes(content)
        result = termsel.read_result(name)
    for reader in sorted(both):
        with TemporaryDirectory() as name:
            try:
                termsel.export(result, reader, Path(name) / "a.txt")
            except TermselError:  # it takes another kind of result
                continue
            found[reader] = {path.name: path.read_bytes() for path in sorted(Path(name).iterdir())}
    return found


@cache
def _vectors() -> dict[str, bytes]:
    import shapely
    from pyogrio.raw import write

    line = shapely.MultiLineString([[[48, 35], [48.1, 35.1], [48.2, 35]]])
    with TemporaryDirectory() as folder:
        for name, driver in _VECTORS.items():
            write(str(Path(folder) / name), np.array([shapely.to_wkb(line)], object), [], [],
                  driver=driver, geometry_type="MultiLineString", crs="EPSG:4326", layer="tracks")
        return {name: (Path(folder) / name).read_bytes() for name in _VECTORS}


@cache
def _sheets() -> dict[str, bytes]:
    import pandas

    points = next(seed.content for seed in seeds() if seed.name == "points.csv")
    table = pandas.read_csv(io.BytesIO(points), comment="#")
    found = {}
    for name, engine in (("points.xlsx", "openpyxl"), ("points.ods", "odf")):
        page = io.BytesIO()
        table.to_excel(page, index=False, engine=engine)
        found[name] = page.getvalue()
    return found


def reader_seeds() -> tuple[Seed, ...]:
    """Return files for each reader; every reader also reads the files of others."""
    exported = [
        Seed(name, content, f"read-{reader}", tuple(item for item in files.items()
                                                    if item[0] != name))
        for reader, files in _exported().items() for name, content in files.items()]
    texts = ("points.csv", "points.geojson", "gcps.vrt", "dimap.xml", "asp.gcp")
    return (*exported,
            *(Seed(name, content, "layers") for name, content in _vectors().items()),
            *(Seed(name, content, "sheet") for name, content in _sheets().items()),
            *(Seed(seed.name, seed.content, "any-reader") for seed in seeds()
              if seed.name in texts))


def _read_as(reader: str) -> Use:
    def use(path: Path, random: Random) -> int:
        known = "EPSG:4979" if reader in _WITHOUT_CRS else None
        main = path if path.name == "a.txt" else path.with_name("a.txt")
        termsel.read(main if main.exists() else path, format=reader,
                     crs=random.choice((known, known, "EPSG:4979", "local")))
        return 0
    return use


def _layers(path: Path, random: Random) -> int:
    layer = "tracks" if path.suffix == ".gpx" else None
    open_layer(path, layer, ("LineString", "MultiLineString"))
    return 0


def _sheet(path: Path, random: Random) -> int:
    termsel.read(path, crs="EPSG:4979")
    return 0


def _any_reader(path: Path, random: Random) -> int:
    """Read a file as a format that it is not."""
    names = sorted(registry().names("readers"))
    areas = {entry.name for entry in registry().entries("readers") if entry.object.areas}
    name = random.choice(names)
    try:
        if name in areas:
            termsel.read(areas=path, format=name, crs="EPSG:4979")
        else:
            termsel.read(path, format=name, crs="EPSG:4979")
    except TermselError:
        if random.random() in (0.0, 0.9):  # a file that is not mutated, of another format
            return 0
        raise
    return 0


def reader_uses() -> dict[str, Use]:
    """Return what is done with these files."""
    return {**{f"read-{reader}": _read_as(reader) for reader in _exported()}, "layers": _layers,
            "sheet": _sheet, "any-reader": _any_reader}


def start_helper() -> None:
    """Begin the process that reads vector files, outside of the limits of a case."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "roads.geojson"
        path.write_bytes(_vectors()[path.name])
        open_layer(path, None, ("LineString", "MultiLineString"))
