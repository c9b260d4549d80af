"""Points in files of other programs: against GDAL, and files that are damaged."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed: "
                    "pip install -e plugins/termsel-formats")

import termsel
from termsel import FeatureSet, Points, Reader, TermselError
from termsel.testing import Check, checks
from termsel_formats.points.erdas import ErdasGcps
from termsel_formats.points.gdal_files import PamGcps
from termsel_formats.points.mapinfo import MapInfoTab
from termsel_formats.points.metashape import MetashapeMarkers
from termsel_formats.points.ozi import OziMap
from termsel_formats.points.pci import PciGcp
from termsel_formats.points.pix4d import Pix4dMarks
from termsel_formats.points.world import WorldFile

GOLDEN = Path(__file__).with_name("golden")


def features(ids: tuple[str, ...], image: list[list[float]], ground: list[list[float]], crs: str,
             ) -> FeatureSet:
    return FeatureSet(Points(ids, np.array(image), np.array(ground)), crs=crs)


TAB = """!table
!version 300
!charset WindowsLatin1

Definition Table
  File "scene.tif"
  Type "RASTER"
  (500000.5,5000000) (0,0) Label "Pt 1",
  (500400,5000000) (40,0) Label "Pt 2",
  (500000,4999700) (0,30.5) Label "Pt 3",
  (500600,4999690) (40.25,30.5) Label "Pt 4"
  CoordSys Earth Projection 8, 104, "m", 3, 0, 0.9996, 500000, 0
  Units "m"
"""
TAB_READ = features(
    ("Pt 1", "Pt 2", "Pt 3", "Pt 4"), [[-0.5, -0.5], [-0.5, 39.5], [30, -0.5], [30, 39.75]],
    [[500000.5, 5000000, np.nan], [500400, 5000000, np.nan], [500000, 4999700, np.nan],
     [500600, 4999690, np.nan]], "EPSG:32631")
OZI = """OziExplorer Map Data File Version 2.2
scene
scene.tif
1 ,Map Code,
WGS 84,WGS 84,   0.0000,   0.0000,WGS 84
Reserved 1
Reserved 2
Magnetic Variation,,,E
Map Projection,Latitude/Longitude,PolyCal,No,AutoCalOnly,No,BSBUseWPX,No
Point01,xy,    0,    0,in, deg,  48,  30.5,N,  11,  15,E, grid,   ,           ,           ,N
Point02,xy,   40,    0,in, deg,  48,  30.5,N,  11,  45,E, grid,   ,           ,           ,N
Point03,xy,    0,   30,in, deg,  48,     0,N,  11,  15,E, grid,   ,           ,           ,N
Point04,xy,   40,   30,in, deg,  48,     1,N,  11,  45,E, grid,   ,           ,           ,N
Point05,xy,     ,     ,in, deg,    ,        ,N,    ,        ,W, grid,   ,           ,           ,N
Projection Setup,,,,,,,,,,
Map Feature = MF ; Map Comment = MC
MMPNUM,0
"""
OZI_READ = features(
    ("01", "02", "03", "04"), [[-0.5, -0.5], [-0.5, 39.5], [29.5, -0.5], [29.5, 39.5]],
    [[11.25, 48 + 30.5 / 60, np.nan], [11.75, 48 + 30.5 / 60, np.nan], [11.25, 48, np.nan],
     [11.75, 48 + 1 / 60, np.nan]], "EPSG:4326")
MARKERS = """<?xml version="1.0" encoding="UTF-8"?>
<document version="1.2.0"><chunk label="Chunk 1" enabled="true">
<cameras><camera id="0" label="IMG_1.JPG"/><camera id="1" label="IMG_2.JPG"/></cameras>
<markers>
 <marker id="0" label="point 1"><reference x="11.5" y="48.25" z="520.5" enabled="true"/></marker>
 <marker id="1" label="point 2"><reference x="11.6" y="48.5" z="530" enabled="true"/></marker>
 <marker id="2" label="point 3"/>
</markers>
<frames><frame id="0"><markers>
 <marker marker_id="0"><location camera_id="0" pinned="true" x="100.5" y="20"/>
  <location camera_id="1" pinned="true" x="8" y="9"/></marker>
 <marker marker_id="1"><location camera_id="0" pinned="true" x="3000" y="40.25"/></marker>
 <marker marker_id="2"><location camera_id="0" pinned="true" x="30" y="40"/></marker>
</markers></frame></frames>
<reference>GEOGCS["WGS 84",DATUM["World Geodetic System 1984",
SPHEROID["WGS 84",6378137,298.257223563]],
PRIMEM["Greenwich",0],UNIT["degree",0.01745329251994328],AUTHORITY["EPSG","4326"]]</reference>
</chunk></document>
"""
MARKERS_READ = features(("point 1", "point 2"), [[19.5, 100], [39.75, 2999.5]],
                        [[11.5, 48.25, 520.5], [11.6, 48.5, 530]], "EPSG:4326")
PAM = (GOLDEN / "scene.png.aux.xml").read_text()
PAM_READ = features(
    ("P1", "P2", "P3", "P4"), [[-0.5, -0.5], [-0.5, 39.5], [30, -0.5], [30, 39.75]],
    [[500000.5, 5000000, 10], [500400, 5000000, 11], [500000, 4999700, 12],
     [500600, 4999690, 13]], "EPSG:32631")
WORLD = (GOLDEN / "scene.tfw").read_text()
WORLD_READ = FeatureSet(Points(
    ("upper left", "upper right", "lower left", "lower right", "middle"),
    np.array([[0, 0], [0, 40], [31, 0], [31, 40], [15.5, 20]]),
    np.array([[500005, 4999995, np.nan], [500405, 4999995, np.nan], [500005, 4999685, np.nan],
              [500405, 4999685, np.nan], [500205, 4999840, np.nan]])), crs="", image_size=(32, 41))
PCI = """# points of a scene
A1  100.5  20.0   500000.5  5000000  520.5 G
"A 2" 3000  40.75  500600   4999690  530   C
A3  7  9.5  500100 4999900 525 I
"""
PCI_READ = FeatureSet(Points(
    ("A1", "A 2", "A3"), np.array([[19.5, 100], [40.25, 2999.5], [9, 6.5]]),
    np.array([[500000.5, 5000000, 520.5], [500600, 4999690, 530], [500100, 4999900, 525]]),
    roles=("control", "check", "off")), crs="")
ERDAS = """Point #\tPoint ID\t>\tColor\tX Input\tY Input\tX Ref.\tY Ref.\tType\tX Residual
1\tGCP #1\t\t\t100.0\t-19.5\t500000.5\t5000000.0\tControl\t0.01
2\tGCP #2\t>\t\t2999.5\t-40.25\t500600.0\t4999690.0\tCheck\t-0.5
3\tGCP #3\t\t\t7.0\t-9.0\t500100.0\t4999900.0\tControl\t0.2
"""
ERDAS_READ = FeatureSet(Points(
    ("GCP #1", "GCP #2", "GCP #3"), np.array([[19.5, 100], [40.25, 2999.5], [9, 7]]),
    np.array([[500000.5, 5000000, np.nan], [500600, 4999690, np.nan], [500100, 4999900, np.nan]]),
    roles=("control", "check", "control")), crs="")
MARKS = """IMG_1.JPG,GCP0,100.5,20,0.3
IMG_1.JPG,GCP1,3000,40.75,0.5
IMG_2.JPG,GCP0,8,9,0.5
IMG_1.JPG,MTP7,8,9,0.5
"""
MARKS_READ = features(("GCP0", "GCP1"), [[19.5, 100], [40.25, 2999.5]],
                      [[6.56114, 46.23456, 299.931], [6.56234, 46.23234, 299.823]], "")
FILES: dict[str, tuple[Reader, str, FeatureSet, str]] = {
    "mapinfo-tab": (MapInfoTab(), TAB, TAB_READ, "scene.tab"),
    "ozi-map": (OziMap(), OZI, OZI_READ, "scene.map"),
    "metashape-markers": (MetashapeMarkers(image_name="IMG_1.JPG"), MARKERS, MARKERS_READ,
                          "markers.xml"),
    "pam-gcps": (PamGcps(), PAM, PAM_READ, "scene.png.aux.xml"),
    "world-file": (WorldFile(image=GOLDEN / "scene.tif"), WORLD, WORLD_READ, "scene.tfw"),
    "pci-gcp": (PciGcp(), PCI, PCI_READ, "scene.gcp"),
    "erdas-gcps": (ErdasGcps(), ERDAS, ERDAS_READ, "points.txt"),
    "pix4d-marks": (Pix4dMarks(ground=GOLDEN / "pix4d_gcps.csv", latitude_first=True,
                               image_name="IMG_1.JPG"), MARKS, MARKS_READ, "marks.csv")}


@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{check.name}") for name, (reader, text, read, file)
    in FILES.items() for check in checks(reader, content=text.encode(), expected=read,
                                         filename=file)])
def test_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize("name", ["mapinfo-tab", "ozi-map"])
def test_gdal_reads_the_same_points(name: str, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    if shutil.which("gdalinfo") is None:
        pytest.skip("gdalinfo is not installed")
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(
            tmp_path / "scene.tif", "w", driver="GTiff", width=41, height=32, count=1,
            dtype="uint8"):
        pass
    _, text, read, file = FILES[name]
    (tmp_path / file).write_text(text)
    opened = tmp_path / (file if name == "ozi-map" else "scene.tif")
    said = json.loads(subprocess.run(["gdalinfo", "-json", str(opened)], capture_output=True,
                                     check=True, text=True).stdout)
    gcps = said["gcps"]["gcpList"]
    np.testing.assert_allclose([[one["line"] - 0.5, one["pixel"] - 0.5] for one in gcps],
                               read.points.image)
    np.testing.assert_allclose([[one["x"], one["y"]] for one in gcps], read.points.ground[:, :2])


def test_grid_coordinates_of_ozi(tmp_path: Path) -> None:
    text = OZI.replace("  48,  30.5,N,  11,  15,E, grid,   ,           ,           ,N",
                       "    ,      ,N,    ,    ,E, grid, 32, 500000, 5300000,N")
    path = tmp_path / "a.map"
    path.write_text("\n".join(line for line in text.splitlines()
                              if "Point0" not in line or "500000" in line) + "\n")
    read = termsel.read(path)
    assert read.crs == "EPSG:32632"
    assert read.points.ground[0, :2].tolist() == [500000, 5300000]
    path.write_text(text)
    with pytest.raises(TermselError, match="some points have degrees and others grid"):
        termsel.read(path)


@pytest.mark.parametrize(("old", "new", "crs"), [
    ("Projection 8, 104,", "Projection 8, 28,", ""), ("0.9996", "1", ""),
    (", 3, 0,", ", 9, 0,", "EPSG:32632"), (", 500000, 0\n", ", 500000, 10000000\n", "EPSG:32731"),
    ('Projection 8, 104, "m", 3, 0, 0.9996, 500000, 0', "Projection 1, 104", "EPSG:4326")])
def test_systems_of_mapinfo(old: str, new: str, crs: str, tmp_path: Path) -> None:
    path = tmp_path / "a.tab"
    text = TAB.replace(old, new)
    if crs == "EPSG:4326":
        text = text.replace("(5", "(").replace("(00", "(10").replace(",49", ",4").replace(
            ",50", ",4")
    path.write_text(text)
    assert MapInfoTab().read(path).crs == crs


@pytest.mark.parametrize(("name", "old", "new", "said", "line"), [
    ("mapinfo-tab", "(40,0)", "(forty,0)", "not a number", 9),
    ("mapinfo-tab", "(", "[", "no points of registration", None),
    ("ozi-map", "48,  30.5,N", "48,  half,N", "no degrees, minutes and side", 10),
    ("ozi-map", "Point", "Ponit", "no points in use", None),
    ("metashape-markers", "</document>", "", "this is not XML", None),
    ("metashape-markers", 'x="11.5"', 'x="here"', "a marker cannot be read", None),
    ("metashape-markers", "<document", "<!DOCTYPE a><document", "document type", None),
    ("pam-gcps", 'Pixel="0.0000"', 'Pixel="left"', "point cannot be read", None),
    ("pam-gcps", "GCPList", "List", "no ground control points", None),
    ("pam-gcps", "<PAM", "<!DOCTYPE a><PAM", "document type", None),
    ("world-file", "500005", "east", "not a number", 5),
    ("world-file", "500005.0", "nan\n#", "'nan' is not a finite number", 5),
    ("world-file", "500005", "1\n500005", "7 numbers", None),
    ("pci-gcp", "40.75", "forty", "not a number", 3),
    ("pci-gcp", " 530 ", "", "6 fields, expected 7", 3),
    ("pci-gcp", " I\n", " X\n", "no status", 4),
    ("erdas-gcps", "2999.5", "2999,5 px", "not a number", 3),
    ("erdas-gcps", "X Ref.", "East", "no X Input", 1),
    ("erdas-gcps", "GCP #2", "GCP #1", "already used", 3),
    ("pix4d-marks", "40.75", "forty", "not a number", 2),
    ("pix4d-marks", "GCP", "PNT", "no label of these marks", None),
    ("pix4d-marks", ",0.3", ",0.3,1,2", "a line has 7 cells", 1)])
def test_damage_is_named(name: str, old: str, new: str, said: str, line: int | None,
                         tmp_path: Path) -> None:
    reader, text, _, file = FILES[name]
    (tmp_path / file).write_text(text.replace(old, new))
    with pytest.raises(TermselError, match=said) as caught:
        reader.read(tmp_path / file)
    assert caught.value.line == line


def test_markers_on_images_without_ground_positions(tmp_path: Path) -> None:
    """Those that have ground positions are on no image, and the others have none."""
    path = tmp_path / "a.xml"
    path.write_text(MARKERS.replace('marker_id="0"', 'marker_id="2"').replace(
        'marker_id="1"', 'marker_id="2"'))
    with pytest.raises(TermselError, match="no markers with image and ground positions"):
        termsel.read(path)


def test_gcps_that_gdal_wrote_into_a_geotiff() -> None:
    read = termsel.read(GOLDEN / "gcps.tif")
    np.testing.assert_allclose(read.points.image, PAM_READ.points.image)
    np.testing.assert_allclose(read.points.ground, PAM_READ.points.ground)
    assert read.crs == "EPSG:32631"


ARCGIS = """<PAMDataset><Metadata domain="xml:ESRI" format="xml"><GeodataXform>
<SpatialReference><WKT>GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137,
298.257223563]],PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433],AUTHORITY["EPSG",4326]]
</WKT></SpatialReference>
<SourceGCPs><Double>0.5</Double><Double>-30.5</Double><Double>40</Double><Double>-1</Double>
</SourceGCPs>
<TargetGCPs><Double>11.5</Double><Double>48.25</Double><Double>11.6</Double><Double>48.5</Double>
</TargetGCPs></GeodataXform></Metadata></PAMDataset>"""


def test_points_of_arcgis_are_those_that_gdal_reads(tmp_path: Path) -> None:
    (tmp_path / "a.png.aux.xml").write_text(ARCGIS)
    read = termsel.read(tmp_path / "a.png.aux.xml")
    assert read.crs == "EPSG:4326"
    np.testing.assert_array_equal(read.points.image, [[30, 0], [0.5, 39.5]])
    np.testing.assert_array_equal(read.points.ground[:, :2], [[11.5, 48.25], [11.6, 48.5]])
    if shutil.which("gdal_translate") is None:
        pytest.skip("gdal_translate is not installed")
    subprocess.run(["gdal_translate", "-q", "-of", "PNG", GOLDEN / "scene.tif", "b.png"],
                   cwd=tmp_path, check=True)
    (tmp_path / "b.png.aux.xml").write_text(ARCGIS)
    said = json.loads(subprocess.run(["gdalinfo", "-json", tmp_path / "b.png"], check=True,
                                     capture_output=True, text=True).stdout)
    assert [[one["line"] - 0.5, one["pixel"] - 0.5] for one in said["gcps"]["gcpList"]] == \
        read.points.image.tolist()
    (tmp_path / "c.aux.xml").write_text(ARCGIS.replace("<Double>-1</Double>", ""))
    with pytest.raises(TermselError, match="3 numbers in the image and 4 on the ground"):
        termsel.read(tmp_path / "c.aux.xml")


def test_a_world_file_needs_its_image(tmp_path: Path) -> None:
    (tmp_path / "scene.tfw").write_text(WORLD)
    with pytest.raises(TermselError, match="no image beside"):
        termsel.read(tmp_path / "scene.tfw")
    with pytest.raises(TermselError, match="does not exist"):
        termsel.read(tmp_path / "scene.tfw", image=tmp_path / "other.tif")
    shutil.copy(GOLDEN / "scene.tif", tmp_path)
    assert len(termsel.read(tmp_path / "scene.tfw", crs="local").points) == 5


@pytest.mark.parametrize(("layout", "line", "sigma"), [
    ("IDXYZPL", "A1 500000.5 5000000 520.5 100.5 20", None),
    ("ID P L eP eL X Y Z S", "A1 100.5 20 0.3 0.4 500000.5 5000000 520.5 G", [[0.4, 0.3]]),
    ("IPLXYE", "A1,100.5,20,500000.5,5000000,520.5", None)])
def test_layouts_of_pci(layout: str, line: str, sigma: list[list[float]] | None,
                        tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(f"{line}\n")
    read = termsel.read(tmp_path / "a.txt", format="pci-gcp", crs="local",
                        layout=layout).points
    np.testing.assert_array_equal(read.image, [[19.5, 100]])
    np.testing.assert_array_equal(read.ground, [[500000.5, 5000000, 520.5]])
    assert (None if read.sigma is None else read.sigma.tolist()) == sigma


@pytest.mark.parametrize("layout", ["IDPLX", "IDPLXYQ", "IDPPLXY"])
def test_layouts_that_pci_has_not(layout: str, tmp_path: Path) -> None:
    (tmp_path / "a.gcp").write_text(PCI)
    with pytest.raises(TermselError, match="is none of PCI"):
        termsel.read(tmp_path / "a.gcp", layout=layout)


def test_a_binary_file_of_erdas_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.gcc").write_bytes(b"EHFA_HEADER_TAG\0\1\2\3")
    with pytest.raises(TermselError, match=r"this \.gcc file of ERDAS IMAGINE is binary"):
        termsel.read(tmp_path / "a.gcc")


def test_a_point_without_a_line_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.aux.xml").write_text(
        '<PAMDataset><GCPList><GCP Pixel="1" X="2" Y="3"/></GCPList></PAMDataset>')
    with pytest.raises(TermselError, match="a ground control point cannot be read: it has no Line"):
        termsel.read(tmp_path / "a.aux.xml")


@pytest.mark.parametrize("separator", [",", ", ", ";", "\t", " ", "   "])
@pytest.mark.parametrize("header", [[], ["Label", "Easting", "Northing", "Height"]])
def test_the_ground_of_pix4d_has_the_separators_that_it_takes(
        separator: str, header: list[str], tmp_path: Path) -> None:
    marks = tmp_path / "marks.csv"
    marks.write_text("a.jpg,g1,10.5,20.5\na.jpg,g2,30.5,25.5\n", encoding="utf-8")
    rows = [["g1", "690010.5", "5334020.25", "512.75"], ["g2", "690030.5", "5334007", "508"]]
    ground = tmp_path / "ground.txt"
    ground.write_text("".join(separator.join(row) + "\n" for row in [header, *rows] if row),
                      encoding="utf-8")
    read = termsel.read(marks, crs="EPSG:32632", ground=ground)
    assert read.points.ground.tolist() == [[690010.5, 5334020.25, 512.75], [690030.5, 5334007, 508]]


def test_marks_of_pix4d_need_the_ground(tmp_path: Path) -> None:
    (tmp_path / "marks.csv").write_text(MARKS)
    with pytest.raises(TermselError, match="the marks have image coordinates only"):
        termsel.read(tmp_path / "marks.csv")
    shutil.copy(GOLDEN / "pix4d_gcps.csv", tmp_path / "marks_gcps.csv")
    with pytest.raises(TermselError, match=r"images IMG_1\.JPG \(2\), IMG_2\.JPG \(1\)"):
        termsel.read(tmp_path / "marks.csv")
    read = termsel.read(tmp_path / "marks.csv", image_name="IMG_2.JPG", crs="local")
    assert read.points.ids == ("GCP0",)
    assert read.points.ground.tolist() == [[46.23456, 6.56114, 299.931]]


def test_several_cameras_need_a_choice(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(MARKERS)
    with pytest.raises(TermselError, match=r"images IMG_1\.JPG \(\d\), IMG_2\.JPG \(\d\)"):
        termsel.read(tmp_path / "m.xml")
    assert termsel.read(tmp_path / "m.xml", image_name="IMG_2.JPG").points.ids == ("point 1",)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(sorted(FILES)), st.data())
def test_any_damage_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, name: str,
                                       data: st.DataObject) -> None:
    reader, text, _, file = FILES[name]
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(len(text), start + 40)))
    new = data.draw(st.text('ab,;\t"#\r\n 0123456789.-e()<>/=nN\x1cé', max_size=12))
    path = tmp_path_factory.mktemp("any") / file
    path.write_text(text[:start] + new + text[stop:], encoding="utf-8")
    with suppress(TermselError):
        reader.read(path)


@pytest.mark.parametrize("name", ["=1+1", "+1+1", "@a", "-b", "plain", 'a,"b"'])
def test_labels_of_pix4d_are_no_formulas(name: str, tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    ids = tuple(name if one == "P002" else one for one in scene.points.ids)
    features = scene.with_(points=replace(scene.points, ids=ids))
    result = termsel.run("poly-terms", features=features, model="affine", solver="all-terms")
    termsel.export(result, "pix4d-marks", tmp_path / "marks.csv")
    for file in tmp_path.iterdir():
        rows = list(csv.reader(file.read_text(encoding="utf-8").splitlines()))
        assert not any(cell[:1] in ("=", "+", "@") for row in rows for cell in row)
    again = termsel.read(tmp_path / "marks.csv", format="pix4d-marks", crs="EPSG:4979")
    assert name in again.points.ids
