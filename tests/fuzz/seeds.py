"""Valid files of every format that termsel reads: what the mutations start from."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import termsel
from termsel.data.rasters import tiff_bytes
from termsel.data.rpc import Rpc
from termsel.formats.rpc_files import rpb_text, rpc_items, rpc_txt_text
from termsel.simulate import geometry_text, scene_truth

_N = 14


@dataclass(frozen=True)
class Seed:
    """A valid file, and others next to it.

    Parameters
    ----------
    name : str
        Of the file.
    content : bytes
    kind : str
        How it is used: a key of `tests.fuzz.cases.USES`.
    others : tuple of (str, bytes)
        Files that are not mutated.
    """

    name: str
    content: bytes
    kind: str
    others: tuple[tuple[str, bytes], ...] = ()


@cache
def _numbers() -> tuple[np.ndarray, np.ndarray]:
    """Return image and ground coordinates, in degrees, of some points."""
    rng = np.random.default_rng(1)
    image = np.round(rng.uniform(0, 5000, (_N, 2)), 2)
    ground = np.column_stack([48 + image[:, 1] / 9e4, 35 - image[:, 0] / 9e4,
                              rng.uniform(50, 500, _N)])
    return image, np.round(ground, 7)


def _table(header: str, rows: list[list[object]], comment: str = "# crs: EPSG:4979\n") -> bytes:
    return (comment + "\n".join([header, *(",".join(map(str, row)) for row in rows)])
            + "\n").encode()


def _rpc() -> Rpc:
    rng = np.random.default_rng(2)
    lines = [tuple(np.round(rng.normal(0, 1e-3, 20), 9).tolist()) for _ in range(4)]
    above = [(0.0, 0.0, -1.0, *lines[0][3:]), (1.0, *lines[1][1:]),
             (0.0, 1.0, *lines[2][2:]), (1.0, *lines[3][1:])]
    return Rpc((2500.0, 2500.0), (2500.0, 2500.0), (48.03, 34.97, 250.0), (0.03, 0.03, 300.0),
               *above)


def _gcps() -> str:
    image, ground = _numbers()
    return "".join(f'<GCP Id="P{i}" Pixel="{s}" Line="{line}" X="{x}" Y="{y}" Z="{z}"/>\n'
                   for i, ((line, s), (x, y, z)) in enumerate(zip(image, ground, strict=True)))


def _vrt(inside: str) -> bytes:
    return (f'<VRTDataset rasterXSize="5000" rasterYSize="5000">\n{inside}\n<VRTRasterBand '
            'dataType="Byte" band="1"/></VRTDataset>').encode()


@cache
def dem() -> bytes:
    from rasterio.transform import from_origin

    heights = np.random.default_rng(3).uniform(0, 500, (1, 40, 40)).astype(np.float32)
    return tiff_bytes(heights, crs="EPSG:4326", transform=from_origin(47.99, 35.01, 0.003, 0.003),
                      nodata=-9999.0)


def _geojson(features: list[tuple[dict[str, object], str, object]]) -> bytes:
    return json.dumps({"type": "FeatureCollection", "crs": {
        "type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::4979"}}, "features": [
        {"type": "Feature", "properties": properties,
         "geometry": {"type": kind, "coordinates": coordinates}}
        for properties, kind, coordinates in features]}, indent=1).encode()


def _vector(folder: Path) -> dict[str, bytes]:
    import shapely
    from pyogrio.raw import write

    _, ground = _numbers()
    ends = shapely.linestrings(ground.reshape(-1, 2, 3))
    ids = np.array([f"L{i}" for i in range(_N // 2)], dtype=object)
    for name, driver in (("lines.gpkg", "GPKG"), ("lines.shp", "ESRI Shapefile")):
        write(str(folder / name), shapely.to_wkb(ends), [ids], ["id"], driver=driver,
              geometry_type="LineString Z", crs="EPSG:4326")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@cache
def result_files() -> dict[str, bytes]:
    """Return the files of a result, by name."""
    image, ground = _numbers()
    features = termsel.FeatureSet(termsel.Points([f"P{i}" for i in range(_N)], image, ground,
                                                 roles=["control"] * 10 + ["independent"] * 4),
                                  crs="EPSG:4979")
    with TemporaryDirectory() as folder:
        termsel.run("poly-terms", strategy="as-asked", solver="all-terms", criterion="press",
                    features=features, options={"degree": 1}, out=Path(folder))
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


_PIXELS = 60
"""Lines and samples of an image that is rectified."""


@cache
def scene_files() -> dict[str, bytes]:
    """Return the files of a result whose model needs heights, of a small image, by name."""
    image, ground = _numbers()
    features = termsel.FeatureSet(termsel.Points([f"P{i}" for i in range(_N)],
                                                 image * (_PIXELS / 5000), ground),
                                  crs="EPSG:4979")
    with TemporaryDirectory() as folder:
        termsel.run("rfm-terms", model="poly3d", solver="all-terms", criterion="press",
                    features=features, options={"degree": 1}, out=Path(folder))
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def _virtual(source: str, size: int, kind: str, inside: str = "") -> bytes:
    return (f'<VRTDataset rasterXSize="{size}" rasterYSize="{size}">{inside}<VRTRasterBand '
            f'dataType="{kind}" band="1"><NoDataValue>-9999</NoDataValue><SimpleSource>'
            f'<SourceFilename relativeToVRT="1">{source}</SourceFilename><SourceBand>1'
            "</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>").encode()


def _rasters() -> tuple[Seed, ...]:
    """Return images and rasters of heights, next to a result that they are used with."""
    scene = tuple(scene_files().items())
    pixels = np.random.default_rng(4).integers(0, 255, (2, _PIXELS, _PIXELS)).astype(np.uint8)
    image, heights = tiff_bytes(pixels), ("heights.tif", dem())
    place = "<SRS>EPSG:4326</SRS><GeoTransform>47.99, 0.003, 0, 35.01, 0, -0.003</GeoTransform>"
    return (
        Seed("image.tif", image, "image", (*scene, heights)),
        Seed("image.vrt", _virtual("plain.tif", _PIXELS, "Int16"), "image",
             (*scene, heights, ("plain.tif", image))),
        Seed("surface.tif", dem(), "surface", (*scene, ("image.tif", image))),
        Seed("surface.vrt", _virtual("plain.tif", 40, "Float32", place), "surface",
             (*scene, ("image.tif", image), ("plain.tif", dem()))))


@cache
def seeds() -> tuple[Seed, ...]:
    """Return a valid file of every format."""
    image, ground = _numbers()
    both = np.column_stack([image, ground]).tolist()
    ends = np.column_stack([image.reshape(-1, 4), ground.reshape(-1, 6)]).tolist()
    points = _table("id,role,line,sample,x,y,z,sigma_px", [
        [f"P{i}", ("control", "check", "")[i % 3], *row, 0.5] for i, row in enumerate(both)])
    corners = [[f"A{i // 4}", i % 4 + 1, 100 * (i % 4 in (1, 2)) + i, 100 * (i % 4 > 1) + i,
                48 + 0.001 * (i % 4 in (1, 2)), 35 + 0.001 * (i % 4 > 1) + i // 4, 3]
               for i in range(12)]
    image_lines = _table("id,line1,sample1,line2,sample2",
                         [[f"L{i}", *row[:4]] for i, row in enumerate(ends)], "")
    rpc = _rpc()
    items = "".join(f'<MDI key="{key}">{value}</MDI>\n' for key, value in rpc_items(rpc).items())
    domain = f'<Metadata domain="RPC">\n{items}</Metadata>'
    globe = "".join(f"<{line.partition(' = ')[0].strip().upper()}>"
                    f"{line.partition(' = ')[2].rstrip(';')}</"
                    f"{line.partition(' = ')[0].strip().upper()}>\n"
                    for line in rpb_text(rpc).replace("(\n", "").replace(",\n", " ").splitlines()
                    if " = " in line and "Id" not in line and "GROUP" not in line)
    values = {line.partition(": ")[0]: line.partition(": ")[2]
              for line in rpc_txt_text(rpc).splitlines()}
    dimap = ("<Dimap_Document><Global_RFM><Inverse_Model>"
             + "".join(f"<{key}>{value}</{key}>" for key, value in values.items() if "COEFF" in key)
             + "</Inverse_Model><RFM_Validity>"
             + "".join(f"<{key}>{value}</{key}>" for key, value in values.items()
                       if "COEFF" not in key) + "</RFM_Validity></Global_RFM></Dimap_Document>")
    with TemporaryDirectory() as folder:
        vector = _vector(Path(folder))
    lines = ("image.csv", image_lines)
    shape = tuple((name, content) for name, content in vector.items()
                  if name.startswith("lines.") and not name.endswith((".gpkg", ".shp")))
    result = tuple(result_files().items())
    return (
        Seed("points.csv", points, "points"),
        Seed("semicolons.csv", points.replace(b",", b";").replace(b".", b","), "points"),
        Seed("lines.csv", _table("id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2",
                                 [[f"L{i}", *row] for i, row in enumerate(ends)]), "lines"),
        Seed("areas.csv", _table("id,corner,line,sample,x,y,z", corners), "areas"),
        Seed("qgis.points", _table("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual", [
            [x, y, s, -line, 1, 0, 0, 0] for line, s, x, y, _ in both], "#CRS: EPSG:4326\n"),
            "points"),
        Seed("points.geojson", _geojson([
            ({"id": f"P{i}", "ji": [s, line], "role": "control", "sigma_px": [1, 2]}, "Point",
             [x, y, z]) for i, (line, s, x, y, z) in enumerate(both)]), "points"),
        Seed("lines.geojson", _geojson([
            ({"id": f"L{i}", "ji": [row[1::-1], row[3:1:-1]]}, "LineString", [row[4:7], row[7:]])
            for i, row in enumerate(ends)]), "lines"),
        Seed("envi.pts", ("; ENVI Image to Map GCP File\n; projection info = {Geographic Lat/Lon, "
                          "WGS-84, units=Degrees}\n; Map (x,y), Image (x,y)\n" + "".join(
                              f"{x} {y} {s} {line}\n" for line, s, x, y, _ in both)).encode(),
             "points"),
        Seed("asp.gcp", "".join(f"{i} {y} {x} {z} 1 1 1 a.tif {s} {line} 1 1\n" for i, (
            line, s, x, y, z) in enumerate(both)).encode(), "points"),
        Seed("gcps.vrt", _vrt(f'<GCPList Projection="EPSG:4326">{_gcps()}</GCPList>'), "points"),
        Seed("gcps.tif", tiff_bytes(np.zeros((1, 4, 4), dtype=np.uint8)), "points",
             (("gcps.tif.aux.xml", (f'<PAMDataset><GCPList Projection="EPSG:4326">{_gcps()}'
                                    "</GCPList></PAMDataset>").encode()),)),
        Seed("lines.gpkg", vector["lines.gpkg"], "vector", (lines,)),
        Seed("lines.shp", vector["lines.shp"], "vector", (lines, *shape)),
        Seed("image.csv", image_lines, "joined", (("lines.gpkg", vector["lines.gpkg"]),)),
        Seed("dem.tif", dem(), "dem", (("points.csv", points),)),
        Seed("dem.vrt", _virtual("plain.tif", 40, "Float32", "<SRS>EPSG:4326</SRS><GeoTransform>"
                                 "47.99, 0.003, 0, 35.01, 0, -0.003</GeoTransform>"), "dem",
             (("points.csv", points), ("plain.tif", dem()))),
        Seed("scene.RPB", rpb_text(rpc).encode(), "rpc"),
        Seed("scene_RPC.TXT", rpc_txt_text(rpc).encode(), "rpc"),
        Seed("globe.xml", f"<isd><RPB><IMAGE>{globe}</IMAGE></RPB></isd>".encode(), "rpc"),
        Seed("dimap.xml", dimap.encode(), "rpc"), Seed("rpc.vrt", _vrt(domain), "rpc"),
        Seed("scene.tif", tiff_bytes(np.zeros((1, 4, 4), dtype=np.uint8)), "rpc",
             (("scene_RPC.TXT", rpc_txt_text(rpc).encode()),)),
        Seed("geometry.json", geometry_text(scene_truth("spot-isfahan").sensor).encode(),
             "geometry"),
        *(Seed(name, content, "result", tuple(item for item in result if item[0] != name))
          for name, content in result if name in ("result.json", "points.csv")),
        Seed("ground.csv", _table("id,line,sample,x,y,z",
                                  [[i, *row] for i, row in enumerate(both)]),
             "project", result),
        *_rasters())

