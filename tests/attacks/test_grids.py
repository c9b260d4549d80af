"""A CRS of a stranger names no files: PROJ would open them as grids, and wait for a pipe."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import TermselError, open_raster
from termsel.core.files.names import refuse_grids
from termsel.toolkit import open_layer
from termsel.toolkit.coordinates import normalise
from tests.attacks.files import image, vrt

pyproj = pytest.importorskip("pyproj")
pytest.importorskip("rasterio")

DATUM = 'DATUM["b",SPHEROID["c",6377397.155,299.15]],PRIMEM["Greenwich",0]'
DEGREE = 'UNIT["degree",0.0174532925199433]'
GEOGRAPHIC = f'GEOGCS["a",{DATUM},{DEGREE}]'
AXES = ('CS[ellipsoidal,2],AXIS["lat",north],AXIS["lon",east],'
        'ANGLEUNIT["degree",0.0174532925199433]')
BOUND = (f'BOUNDCRS[SOURCECRS[GEOGCRS["a",DATUM["b",ELLIPSOID["c",6377397.155,299.15]],{AXES}]],'
         'TARGETCRS[GEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS 84",'
         f'6378137,298.257223563]],{AXES},ID["EPSG",4326]]],ABRIDGEDTRANSFORMATION["NTv2",METHOD['
         '"NTv2",ID["EPSG",9615]],PARAMETERFILE["Latitude and longitude difference file","@F"]]]')
STATED = {
    "extension": f'GEOGCS["a",{DATUM},{DEGREE},EXTENSION["PROJ4","+proj=longlat +nadgrids=@F"]]',
    "of several": f'GEOGCS["a",{DATUM},{DEGREE},EXTENSION["PROJ4","+proj=longlat '
                  '+ellps=bessel +nadgrids=@null,@@F,x +no_defs"]]',
    "quoted": f'GEOGCS["a",{DATUM},{DEGREE},EXTENSION["PROJ4","+proj=longlat +nadgrids=""@F"""]]',
    "heights": f'COMPD_CS["x",{GEOGRAPHIC},VERT_CS["h",VERT_DATUM["d",2005,EXTENSION["PROJ4_GRIDS",'
               '"@F"]],UNIT["metre",1]]]',
    "bound": BOUND, "typographic": BOUND.replace('"@F"', "\u201c@F\u201d"),
    "spaced": BOUND.replace("PARAMETERFILE[", "parameterfile  [ \n"),
    "init": f'GEOGCS["a",{DATUM},{DEGREE},EXTENSION["PROJ4","+init=@F:x"]]',
    "words": "+proj=longlat +ellps=bessel +nadgrids=@F", "words of init": "+init=@F:x"}
BOUND_JSON = pyproj.CRS.from_wkt(BOUND).to_json()
STATED |= {"json": BOUND_JSON, "escaped": BOUND_JSON.replace('"value": "', r'"v\u0061lue": "')}
HARMLESS = (
    "EPSG:3857", "+proj=longlat +ellps=bessel +nadgrids=BETA2007.gsb +type=crs",
    f'GEOGCS["a / b",{DATUM},{DEGREE},EXTENSION["PROJ4","+proj=longlat +nadgrids=@null +wktext"],'
    'AUTHORITY["http://x/y","1"]]',
    'REMARK["See https://example.org/grids = many"]',
    pyproj.CRS.from_epsg(32633).to_json())  # "WGS 84 / UTM zone 33N"


@pytest.fixture
def pipe(folder: Path) -> Path:
    """A pipe that nobody writes to: what opens it waits for ever."""
    if not hasattr(os, "mkfifo"):
        pytest.skip("there are no pipes by name")
    os.mkfifo(folder / "grid.gsb")
    return folder / "grid.gsb"


@pytest.mark.parametrize("kind", STATED)
def test_a_crs_names_no_file_and_no_address(kind: str, pipe: Path, server) -> None:
    for place in (str(pipe), "./grid.gsb", "../victim/kept.txt", f"{server.url}/grid.tif",
                  r"C:\grid.gsb"):
        with pytest.raises(TermselError, match=r"names the file of a grid|unknown CRS"):
            normalise(STATED[kind].replace("@F", place))


@pytest.mark.parametrize("crs", HARMLESS)
def test_grids_of_proj_itself_have_names_alone(crs: str) -> None:
    refuse_grids(crs)


@pytest.mark.parametrize("kind", ["extension", "bound"])
def test_tables_and_files_of_gdal(kind: str, pipe: Path, folder: Path, server) -> None:
    """The CRS comes with points, next to them, with a raster, its metadata, or a layer."""
    crs = STATED[kind].replace("@F", str(pipe))
    rows = "id,line,sample,x,y,z\n" + "".join(f"P{i},{i},{i * i % 7},{i},{i},1\n" for i in range(9))
    (folder / "a.csv").write_text(f"# crs: {crs}\n{rows}")
    (folder / "b.csv").write_text(rows)
    (folder / "b.prj").write_text(crs)
    (folder / "c.points").write_text(f"#CRS: {crs}\nmapX,mapY,sourceX,sourceY,enable\n"
                                     "1,2,3,-4,1\n2,2,3,-5,1\n")
    for name in ("a.csv", "b.csv", "c.points"):
        with pytest.raises(TermselError):
            termsel.read(folder / name)
    image(folder / "d.tif")
    stated = crs.replace("&", "&amp;").replace('"', "&quot;")
    (folder / "d.vrt").write_text(vrt("d.tif", 1).replace("EPSG:4326", stated))
    (folder / "e.vrt").write_text(vrt("d.tif", 1, more=f'<GCPList Projection="{stated}"><GCP Id="" '
                                      'Pixel="0" Line="0" X="1" Y="2"/></GCPList>'))
    (folder / "f.vrt").write_text(
        '<VRTDataset subClass="VRTWarpedDataset" rasterXSize="60" rasterYSize="60"><VRTRasterBand '
        'dataType="Byte" band="1" subClass="VRTWarpedRasterBand"/><GDALWarpOptions><SourceDataset '
        'relativeToVRT="1">d.tif</SourceDataset><Transformer><ReprojectionTransformer><SourceSRS>'
        f"{stated}</SourceSRS></ReprojectionTransformer></Transformer></GDALWarpOptions>"
        "</VRTDataset>")
    for name in ("d.vrt", "e.vrt", "f.vrt"):
        with pytest.raises(TermselError, match="grid"):
            open_raster(folder / name).__enter__()
    image(folder / "g.tif")
    (folder / "g.tif.aux.xml").write_text(f"<PAMDataset><SRS>{stated}</SRS></PAMDataset>")
    with pytest.raises(TermselError, match="grid"):
        open_raster(folder / "g.tif").__enter__()


def test_other_texts_of_virtual_rasters_may_have_paths(folder: Path) -> None:
    image(folder / "d.tif")
    (folder / "d.vrt").write_text(vrt("d.tif", 1, more="<Metadata><MDI key='made by'>file=a/b, "
                                      "model = x/y</MDI></Metadata>"))
    with open_raster(folder / "d.vrt") as raster:
        assert raster.tags()["made by"].startswith("file=a/b")


def test_a_server_behind_a_query_is_not_called_a_grid(folder: Path, server) -> None:
    (folder / "d.vrt").write_text(vrt(f"/vsicached?file=/vsicurl/{server.url}/d.tif", 1))
    with pytest.raises(TermselError) as caught, open_raster(folder / "d.vrt"):
        pass
    assert "grid" not in str(caught.value)


def test_a_layer(pipe: Path, folder: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    line = shapely.to_wkb(shapely.LineString([[0, 0], [1, 1]]))
    pyogrio.raw.write(folder / "a.gpkg", np.array([line], object), [], [], layer="x",
                      geometry_type="LineString", crs="EPSG:4314", driver="GPKG")
    with closing(sqlite3.connect(folder / "a.gpkg")) as database:
        database.execute("UPDATE gpkg_spatial_ref_sys SET organization = 'NONE', definition = ? "
                         "WHERE srs_id = 4314", [STATED["extension"].replace("@F", str(pipe))])
        database.commit()
    with pytest.raises(TermselError, match="grid"):
        open_layer(folder / "a.gpkg", None, ("LineString",))


def test_a_result(made_result: Path, folder: Path, pipe: Path, call) -> None:
    """What is read again from the folder of a result is a stranger's, too."""
    for file in made_result.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    crs = STATED["extension"].replace("@F", str(pipe)).replace('"', '\\"')
    for name, before, after in (("result.json", '"EPSG:4979"', f'"{crs}"'),
                                ("points.csv", "EPSG:4979", crs.replace('\\"', '"'))):
        path = folder / name
        path.write_text(path.read_text().replace(before, after))
    assert call("plan", folder, "-o", "plan.csv").exit_code == 2
