"""Files that people bring from other programs, and those that they take to them.

The forms are those of the documentation of OpenDroneMap (Ground Control Points), MicMac
(SaisieAppuisInit, GCPConvert), GRASS GIS (g.gui.gcp, i.ortho.photo), GDAL (gdal_translate -gcp,
gdalinfo), Allmaps (package io) and ArcGIS (links as a text file).
"""

from __future__ import annotations

import logging
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed: "
                    "pip install -e plugins/termsel-formats")
pytest.importorskip("rasterio")

import rasterio

import termsel
from termsel import FeatureSet, Points, Reader, Result, TermselError, Writer
from termsel.testing import Check, checks
from termsel.toolkit.files import read_head
from termsel_formats.points.asp import AspGcpWriter
from termsel_formats.points.gdal_text import GdalinfoText, GdalOptions, GdalOptionsWriter
from termsel_formats.points.grass import GrassPoints
from termsel_formats.points.links import ArcgisLinks
from termsel_formats.points.metashape import MetashapeMarkersWriter
from termsel_formats.points.micmac import MicmacXml, MicmacXmlWriter
from termsel_formats.points.odm import OdmGcpList, OdmGcpListWriter
from termsel_formats.points.pix4d import Pix4dMarks, Pix4dMarksWriter

GROUND = np.array([[500000.5, 5000000.0, 410.0], [500900.0, 5000010.0, 420.5],
                   [500020.0, 4999100.0, 430.0], [500880.0, 4999200.0, 415.0]])
IMAGE = np.array([[20.5, 100.0], [31.0, 1900.25], [1800.0, 140.0], [1700.5, 1850.0]])
"""Line and sample from the centre of the first pixel."""
IDS = ("P1", "P2", "P3", "P4")


def features(crs: str = "", *, heights: bool = True, ids: tuple[str, ...] = IDS,
             roles: tuple[str, ...] = (), image: np.ndarray = IMAGE) -> FeatureSet:
    ground = GROUND.copy()
    if not heights:
        ground[:, 2] = np.nan
    return FeatureSet(Points(ids, image, ground, roles=roles), crs=crs)


def odm(header: str = "EPSG:32633", images: tuple[str, ...] = ("DJI_1.JPG",)) -> str:
    rows = [f"{x} {y} {z}\t{sample} {line}\t{image} {name}" for image in images
            for name, (line, sample), (x, y, z) in zip(IDS, IMAGE, GROUND, strict=True)]
    return "\n".join([header, *rows, ""])


def micmac() -> str:
    marks = "".join(f"<OneMesureAF1I><NamePt>{name}</NamePt><PtIm>{sample} {line}</PtIm>"
                    f"</OneMesureAF1I>" for name, (line, sample) in zip(IDS, IMAGE, strict=True))
    return (f'<?xml version="1.0" ?><Global><SetOfMesureAppuisFlottants><MesureAppuiFlottant1Im>'
            f"<NameIm>a.tif</NameIm>{marks}</MesureAppuiFlottant1Im></SetOfMesureAppuisFlottants>"
            f"{appuis()}</Global>")


def appuis() -> str:
    return "<DicoAppuisFlottant>" + "".join(
        f"<OneAppuisDAF><Pt> {x} {y} {z} </Pt><NamePt> {name} </NamePt><Incertitude>1 1 1"
        f"</Incertitude></OneAppuisDAF>" for name, (x, y, z) in zip(IDS, GROUND, strict=True)
    ) + "</DicoAppuisFlottant>"


def grass() -> str:
    rows = [f"{sample + 0.5} {2000 - line - 0.5}     {x} {y}     {int(name != 'P3')}"
            for name, (line, sample), (x, y, _) in zip(IDS, IMAGE, GROUND, strict=True)]
    return "\n".join(["# Ground Control Points File", "# ", "# target location: utm",
                      "#\tsource\t\ttarget\t\tstatus", *rows, ""])


def options() -> str:
    gcps = " \\\n  ".join(f"-gcp {sample + 0.5} {line + 0.5} {x} {y} {z}"
                          for (line, sample), (x, y, z) in zip(IMAGE, GROUND, strict=True))
    return f'#!/bin/bash\ngdal_translate -of vrt -a_srs EPSG:32633 \\\n  {gcps} \\\n  a.jpg a.vrt\n'


def printed() -> str:
    gcps = "\n".join(f"GCP[{i:3d}]: Id={name}, Info=\n          ({sample + 0.5},{line + 0.5}) -> "
                     f"({x},{y},{z})" for i, (name, (line, sample), (x, y, z))
                     in enumerate(zip(IDS, IMAGE, GROUND, strict=True)))
    return f"Driver: GTiff/GeoTIFF\nFiles: a.tif\nOrigin unknown\n{gcps}\nMetadata:\n"


def links() -> str:
    return "\n".join([*(f"{sample + 0.5}\t{-line - 0.5}\t{x}\t{y}" for (line, sample), (x, y, _)
                        in zip(IMAGE, GROUND, strict=True)), ""])


READERS: dict[str, tuple[type[Reader], str, FeatureSet, str]] = {
    "odm-gcp-list": (OdmGcpList, odm(), features("EPSG:32633"), "gcp_list.txt"),
    "micmac-xml": (MicmacXml, micmac(), features(), "all.xml"),
    "grass-points": (GrassPoints, grass(), features(
        heights=False, roles=("", "", "off", ""), image=np.column_stack(
            [2000 - IMAGE[:, 0] - 0.5, IMAGE[:, 1] + 0.5])), "POINTS"),
    "gdal-options": (GdalOptions, options(), features("EPSG:32633"), "a.sh"),
    "gdalinfo": (GdalinfoText, printed(), features(), "info.txt"),
    "arcgis-links": (ArcgisLinks, links(), features(heights=False), "links.txt")}


def reader_suite() -> Iterator[Check]:
    for reader, text, expected, name in READERS.values():
        yield from checks(reader(), content=text.encode(), expected=expected, filename=name)


@pytest.mark.parametrize("check", [pytest.param(one, id=one.name) for one in reader_suite()])
def test_readers_conform(check: Check) -> None:
    check.run()


def same(read: FeatureSet, crs: str, *, heights: bool = True) -> None:
    assert read.crs == crs
    np.testing.assert_allclose(read.points.image, IMAGE, atol=1e-9)
    np.testing.assert_allclose(read.points.ground[:, :2 + heights], GROUND[:, :2 + heights])


@pytest.mark.parametrize("name", sorted(READERS))
def test_content_tells_the_format(name: str, tmp_path: Path) -> None:
    _, text, expected, file = READERS[name]
    (tmp_path / file).write_text(text)
    image = tmp_path / "image.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        rasterio.open(image, "w", driver="GTiff", width=2000, height=2000, count=1, dtype="uint8",
                      sparse_ok=True).close()
    read = termsel.read(tmp_path / file, crs="EPSG:32633", image=image)
    same(read, "EPSG:32633", heights=not np.isnan(expected.points.ground[0, 2]))


def accented(text: str) -> str:
    """Return a text with an accent in a comment, or in the name of an image."""
    for name in ("a.tif", "a.jpg", "DJI_1", "utm"):
        text = text.replace(name, f"\xe9{name}")
    return text if "\xe9" in text else text + "# caf\xe9\n"


@pytest.mark.parametrize("name", sorted(READERS))
def test_text_may_have_any_usual_encoding(name: str, tmp_path: Path,
                                          caplog: pytest.LogCaptureFixture) -> None:
    """Windows writes UTF-16 by > of PowerShell, and the encoding of its country elsewhere."""
    caplog.set_level(logging.INFO, "termsel")
    reader, text, expected, file = READERS[name]
    for encoding in ("utf-16", "utf-16-le", "utf-8-sig", "cp1252"):
        (tmp_path / encoding).mkdir()
        path = tmp_path / encoding / file
        path.write_bytes(accented(text).replace("\n", "\r\n").encode(encoding))
        assert reader().sniff(path, read_head(path, ""))
        points = reader().read(path).points
        np.testing.assert_allclose(points.image, expected.points.image)
        np.testing.assert_allclose(points.ground, expected.points.ground)
    notes = [note for note in caplog.messages if "is not UTF-8" in note]
    assert notes == [f"Note: the text of {path} is not UTF-8; it is read as cp1252."]


@pytest.mark.parametrize(("declared", "encoding"), [
    ("ISO-8859-1", "latin-1"), ("windows-1251", "cp1251"), ("UTF-16", "utf-16"),
    ("UTF-8", "cp1252")])
def test_xml_is_read_in_the_encoding_that_it_declares(declared: str, encoding: str,
                                                      tmp_path: Path) -> None:
    letter = "\u0436" if encoding == "cp1251" else "\xe9"
    text = micmac().replace('"1.0"', f'"1.0" encoding="{declared}"').replace("a.tif", letter)
    path = tmp_path / "a.xml"
    path.write_bytes(text.encode(encoding))
    same(termsel.read(path, crs="EPSG:32633", image_name=letter), "EPSG:32633")
    path.write_bytes(text.replace(declared, "nope").encode("latin-1", "replace"))
    with pytest.raises(TermselError, match="line 1: the encoding of this XML cannot be read"):
        termsel.read(path, crs="EPSG:32633")


@pytest.mark.parametrize(("header", "crs"), [
    ("EPSG:32633", "EPSG:32633"), ("WGS84 UTM 33N", "EPSG:32633"),
    ("+proj=utm +zone=33 +ellps=WGS84 +datum=WGS84 +units=m +no_defs\t", "EPSG:32633")])
def test_crs_lines_of_opendronemap(header: str, crs: str, tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text(odm(header))
    same(termsel.read(tmp_path / "gcp_list.txt"), crs)


@pytest.mark.parametrize("header", [
    "EPSG: 32633", "# my points\nEPSG:32633", "UTM 33N",
    "EPSG:32633\ngeo_x geo_y geo_z im_x im_y image_name gcp_name"])
def test_lists_of_opendronemap_as_people_write_them(header: str, tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text(odm(header))
    same(termsel.read(tmp_path / "gcp_list.txt"), "EPSG:32633")


def test_names_of_images_may_have_blanks_between_tabs(tmp_path: Path) -> None:
    text = odm().replace(" ", "\t").replace("DJI_1.JPG", "my photo 1.JPG")
    (tmp_path / "gcp_list.txt").write_text(text)
    points = termsel.read(tmp_path / "gcp_list.txt").points
    assert points.ids == IDS


@pytest.mark.parametrize("header", ["32633", "WGS84 UTM 33"])
def test_a_list_with_half_a_crs_is_asked_for_the_other(header: str, tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text(odm(header))
    with pytest.raises(TermselError, match=r"line 1: unknown CRS.*Did you mean EPSG:32633"):
        termsel.read(tmp_path / "gcp_list.txt")


@pytest.mark.parametrize("form", [
    "{x}, {y}, {z}, {sample}, {line}, my photo.JPG, {name}", "{x};{y};{z};{sample};{line};a.JPG",
    "{x},{y},{z},{sample},{line},a.JPG,{name}"])
@pytest.mark.parametrize("crs", ["EPSG:32633", ""])
def test_lists_with_other_separators(form: str, crs: str, tmp_path: Path,
                                     caplog: pytest.LogCaptureFixture) -> None:
    write_marks(tmp_path / "gcp_list.txt", form, crs)
    with caplog.at_level("INFO"):
        same(termsel.read(tmp_path / "gcp_list.txt", crs="EPSG:32633"), "EPSG:32633")
    assert ("without the CRS" in caplog.text) == (not crs)


@pytest.mark.parametrize("separator", ["\t", ";", " "])
@pytest.mark.parametrize("crs", ["EPSG:32633", ""])
def test_lists_with_decimal_commas(separator: str, crs: str, tmp_path: Path) -> None:
    form = separator.join(("{x:.3f}", "{y:.3f}", "{z:.3f}", "{sample:.3f}", "{line:.3f}"))
    path = write_marks(tmp_path / "gcp_list.txt", form, crs)
    marks = path.read_text().replace(".", ",").splitlines()
    path.write_text("\n".join(
        f"{line}{separator}a.JPG" if i or not crs else line for i, line in enumerate(marks)))
    read = termsel.read(path, crs="EPSG:32633")
    np.testing.assert_allclose(read.points.image, IMAGE, atol=1e-3)
    np.testing.assert_allclose(read.points.ground, GROUND, atol=1e-3)


def test_a_list_without_its_crs_asks_for_it_and_for_the_image(tmp_path: Path) -> None:
    path = write_marks(tmp_path / "gcp_list.txt", "{x} {y} {z} {sample} {line} a.JPG")
    with pytest.raises(TermselError, match="the CRS of the ground coordinates is unknown"):
        termsel.read(path)
    path.write_text(path.read_text() + path.read_text().replace("a.JPG", "b.JPG"))
    with pytest.raises(TermselError, match=r"images a\.JPG \(4\), b\.JPG"):
        termsel.read(path, crs="EPSG:32633")
    same(termsel.read(path, crs="EPSG:32633", image_name="b.JPG"), "EPSG:32633")


def write_marks(path: Path, form: str, crs: str = "") -> Path:
    rows = [form.format(x=x, y=y, z=z, sample=sample, line=line, name=name)
            for name, (line, sample), (x, y, z) in zip(IDS, IMAGE, GROUND, strict=True)]
    path.write_text("\n".join(filter(None, [crs, *rows])) + "\n")
    return path


def test_a_list_whose_crs_is_unknown_is_a_list_of_images_all_the_same(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(odm("PUWG1992", images=("DJI_1.JPG", "DJI_2.JPG")))
    with pytest.raises(TermselError, match=r"images DJI_1\.JPG \(4\), DJI_2\.JPG"):
        termsel.read(path)
    same(termsel.read(path, image_name="DJI_2.JPG", crs="EPSG:32633"), "EPSG:32633")
    assert "line 1: 'PUWG1992' is no CRS that is known" in caplog.text
    # The header of a table in another order is no such statement.
    path.write_text(odm("line sample x y z image name"))
    assert not OdmGcpList().sniff(path, path.read_bytes())


def test_the_image_that_is_given_is_the_one_of_a_list(tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text(odm(images=("DJI_1.JPG", "DJI_2.JPG")))
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        rasterio.open(tmp_path / "dji_2.jpg", "w", driver="GTiff", width=2000, height=2000,
                      count=1, dtype="uint8", sparse_ok=True).close()
    same(termsel.read(tmp_path / "gcp_list.txt", image=tmp_path / "dji_2.jpg"), "EPSG:32633")


def test_a_list_of_several_images_asks_which(tmp_path: Path) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(odm(images=("DJI_1.JPG", "DJI_2.JPG")))
    with pytest.raises(TermselError, match=r"images DJI_1\.JPG \(4\), DJI_2\.JPG.*termsel compare"):
        termsel.read(path)
    same(termsel.read(path, image_name="DJI_2.JPG"), "EPSG:32633")
    assert list(OdmGcpList().parts(path)) == ["DJI_1.JPG", "DJI_2.JPG"]


def test_measures_of_micmac_find_their_ground(tmp_path: Path) -> None:
    (tmp_path / "a-S2D.xml").write_text(micmac().replace(appuis(), ""))
    with pytest.raises(TermselError, match="the measures have image coordinates only"):
        termsel.read(tmp_path / "a-S2D.xml")
    (tmp_path / "a-S3D.xml").write_text(appuis())
    same(termsel.read(tmp_path / "a-S2D.xml", crs="EPSG:32633"), "EPSG:32633")
    with pytest.raises(TermselError, match="no measures in images"):
        termsel.read(tmp_path / "a-S3D.xml", crs="EPSG:32633")


def test_measures_of_several_images_ask_which(tmp_path: Path) -> None:
    """The file that SaisieAppuisPredic writes has a MesureAppuiFlottant1Im for each image."""
    start, end = "<MesureAppuiFlottant1Im>", "</MesureAppuiFlottant1Im>"
    first = start + micmac().partition(start)[2].partition(end)[0] + end
    (tmp_path / "a-S2D.xml").write_text(
        micmac().replace(appuis(), "").replace(first, first + first.replace("a.tif", "b.tif")))
    (tmp_path / "a-S3D.xml").write_text(appuis())
    with pytest.raises(TermselError, match=r"images a\.tif \(4\), b\.tif.*termsel compare"):
        termsel.read(tmp_path / "a-S2D.xml", crs="EPSG:32633")
    same(termsel.read(tmp_path / "a-S2D.xml", crs="EPSG:32633", image_name="b.tif"), "EPSG:32633")


def test_the_ground_of_pix4d_is_found_beside_the_marks(tmp_path: Path) -> None:
    (tmp_path / "marks.csv").write_text("".join(
        f"IMG_1.JPG,{name},{sample + 0.5},{line + 0.5}\n"
        for name, (line, sample) in zip(IDS, IMAGE, strict=True)))
    (tmp_path / "survey.csv").write_text("".join(
        f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(IDS, GROUND, strict=True)))
    same(termsel.read(tmp_path / "marks.csv", crs="EPSG:32633", ground="survey.csv"), "EPSG:32633")


def test_a_header_of_another_order_heads_no_links(tmp_path: Path) -> None:
    """The northings of a plane may be negative, as the ordinates of links are."""
    path = tmp_path / "table.csv"
    path.write_text("mapX,mapY,r,c\n" + "".join(
        f"{2.0 * sample + 900.0},{-2.0 * line - 900.0},{line},{sample}\n"
        for line, sample in IMAGE.tolist()))
    assert not ArcgisLinks().sniff(path, path.read_bytes())


def test_links_with_a_header_between_commas(tmp_path: Path) -> None:
    (tmp_path / "links.csv").write_text(
        "Link,X Source,Y Source,X Map,Y Map,Residual X,Residual Y,Residual\n" + "".join(
            f"{i},{row.replace(chr(9), ',')},0.1,-0.2,0.22\n"
            for i, row in enumerate(links().splitlines(), 1)))
    same(termsel.read(tmp_path / "links.csv", crs="EPSG:32633"), "EPSG:32633", heights=False)


def test_the_ground_of_micmac_is_found_beside_the_measures(tmp_path: Path) -> None:
    (tmp_path / "Mesure.xml").write_text(micmac().replace(appuis(), ""))
    (tmp_path / "Appuis.xml").write_text(appuis())
    same(termsel.read(tmp_path / "Mesure.xml", crs="EPSG:32633", ground="Appuis.xml"),
         "EPSG:32633")


def test_an_xml_bomb_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a-S2D.xml").write_text(
        '<!DOCTYPE a [<!ENTITY b "c">]><SetOfMesureAppuisFlottants>&b;'
        "</SetOfMesureAppuisFlottants>")
    with pytest.raises(TermselError, match="a document type is not read"):
        termsel.read(tmp_path / "a-S2D.xml")


def test_points_of_grass_need_the_image(tmp_path: Path) -> None:
    (tmp_path / "POINTS").write_text(grass())
    with pytest.raises(TermselError, match="needs the height of the image"):
        termsel.read(tmp_path / "POINTS", crs="EPSG:32633")


def test_option_files_and_numbered_links(tmp_path: Path) -> None:
    (tmp_path / "gcps.opt").write_text("".join(
        f"-gcp {sample + 0.5} {line + 0.5} {x} {y}\n"
        for (line, sample), (x, y, _) in zip(IMAGE, GROUND, strict=True)))
    (tmp_path / "links.csv").write_text("".join(
        f"{i},{row.replace(chr(9), ',')}\n" for i, row in enumerate(links().splitlines(), 1)))
    for name in ("gcps.opt", "links.csv"):
        same(termsel.read(tmp_path / name, crs="EPSG:32633"), "EPSG:32633", heights=False)


def gdal(form: str) -> str:
    """Return the points as arguments of a form of -gcp."""
    return " ".join(form.format(sample + 0.5, line + 0.5, x, y, z)
                    for (line, sample), (x, y, z) in zip(IMAGE, GROUND, strict=True))


GDAL_FORMS = {
    "quoted": "gdal_translate " + gdal('-gcp "{}" "{}" "{}" "{}" "{}"') + " -a_srs EPSG:32633 a b",
    "commas": "gdal raster edit " + gdal("--gcp {},{},{},{},{}") + " --crs=EPSG:32633 a.tif",
    "PowerShell": "gdal_translate `\n" + gdal("-gcp {} {} {} {} {} `\n")
                  + " -a_srs EPSG:32633 `\n a.tif b.tif",
    "a variable": "GCPS=\"" + gdal("-gcp {} {} {} {} {}") + "\"\ngdal_translate $GCPS -a_srs "
                  "EPSG:32633 a.tif b.tif",
    "the warp": "gdal_translate " + gdal("-gcp {} {} {} {} {}") + " a.tif b.tif\n"
                "gdalwarp -s_srs EPSG:32633 -t_srs EPSG:3857 b.tif c.tif",
    "escaped": gdal("-gcp {} {} {} {} {}") + ' -a_srs "GEOGCS[\\"WGS 84\\",DATUM[\\"WGS_1984\\",'
    'SPHEROID[\\"WGS 84\\",6378137,298.257223563]],PRIMEM[\\"Greenwich\\",0],'
    'UNIT[\\"degree\\",0.0174532925199433]]"'}


@pytest.mark.parametrize("form", GDAL_FORMS)
def test_options_of_gdal_in_all_their_forms(form: str, tmp_path: Path) -> None:
    (tmp_path / "a.sh").write_text(GDAL_FORMS[form])
    if form == "escaped":
        assert GdalOptions().read(tmp_path / "a.sh").crs == "EPSG:4326"
    else:
        same(termsel.read(tmp_path / "a.sh"), "EPSG:32633")


def test_two_maps_of_one_image_stay_apart(tmp_path: Path) -> None:
    """A script of Allmaps has a command a map; several maps may be on one image."""
    command = f"gdal_translate -of vrt -a_srs EPSG:32633 {gdal('-gcp {} {} {} {} {}')} a.jpg "
    (tmp_path / "a.sh").write_text(f"{command} first.vrt\n{command} second.vrt\n")
    assert list(GdalOptions().parts(tmp_path / "a.sh")) == ["a.jpg", "second.vrt"]
    same(termsel.read(tmp_path / "a.sh", image_name="second.vrt"), "EPSG:32633")


def test_commands_with_one_output_stay_apart_too(tmp_path: Path) -> None:
    command = f"gdal_translate -of vrt -a_srs EPSG:32633 {gdal('-gcp {} {} {} {} {}')} a.jpg a.vrt"
    (tmp_path / "a.sh").write_text(f"{command}\n" * 4)
    names = list(GdalOptions().parts(tmp_path / "a.sh"))
    assert len(names) == 4
    for name in names:
        same(termsel.read(tmp_path / "a.sh", image_name=name), "EPSG:32633")


def test_a_script_of_several_images_asks_which(tmp_path: Path) -> None:
    gcps = gdal("-gcp {} {} {} {} {}")
    command = f"gdal_translate -a_srs EPSG:32633 {gcps} im{{0}}.tif o{{0}}.tif"
    path = tmp_path / "a.sh"
    path.write_text("\n".join(command.format(i) for i in (1, 2)))
    with pytest.raises(TermselError, match=r"points of the images im1\.tif, im2\.tif\. Choose one"):
        termsel.read(path)
    same(termsel.read(path, image_name="im2.tif"), "EPSG:32633")


@pytest.mark.parametrize("heading", [
    "# comment\n#\timage\t\ttarget\t\tstatus\n#\teast\tnorth\teast\tnorth\t(1=ok, 0=ignore)\n#",
    "\ufeff# image  target  status\n# east north east north (1=ok, 0=ignore)"])
def test_points_of_grass_are_known_by_their_heading(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "my points.txt"
    path.write_text("\n".join([heading, *grass().splitlines()[4:], ""]), encoding="utf-8")
    image = tmp_path / "image.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        rasterio.open(image, "w", driver="GTiff", width=2000, height=2000, count=1, dtype="uint8",
                      sparse_ok=True).close()
    same(termsel.read(path, crs="EPSG:32633", image=image), "EPSG:32633", heights=False)


def test_links_without_a_header_count_from_corners(tmp_path: Path) -> None:
    """With one residual they have a width that no reader takes without a word."""
    path = tmp_path / "links.txt"
    path.write_text("\n".join(f"{row}\t0.12" for row in links().splitlines()))
    with pytest.raises(TermselError, match="image_origin='y-up-corner'") as caught:
        termsel.read(path, crs="EPSG:32633")
    read = termsel.read(path, crs="EPSG:32633", columns=caught.value.options["--columns"],
                        image_origin=caught.value.options["--set"].partition("=")[2])
    same(read, "EPSG:32633", heights=False)


@pytest.mark.parametrize(("separator", "decimal"), [
    (";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", ".")])
def test_marks_of_pix4d_as_spreadsheets_write_them(separator: str, decimal: str,
                                                   tmp_path: Path) -> None:
    marks = [["Filename", "Label", "PixelX", "PixelY"]]
    ground = []
    for name, (line, sample), position in zip(IDS, IMAGE, GROUND, strict=True):
        pixels = [str(number).replace(".", decimal) for number in (sample + 0.5, line + 0.5)]
        marks.append(["a.JPG", name, *pixels])
        ground.append([name, *(str(number).replace(".", decimal) for number in position)])
    for file, rows in (("m.csv", marks), ("m_gcps.csv", ground)):
        (tmp_path / file).write_text("\n".join(map(separator.join, rows)), encoding="utf-16")
    same(termsel.read(tmp_path / "m.csv", crs="EPSG:32633"), "EPSG:32633")


def test_exports_of_allmaps(tmp_path: Path) -> None:
    """The forms of printGcps of its package io: numbers alone, links, and .points."""
    rows = [(sample + 0.5, line + 0.5, x, y) for (line, sample), (x, y, _)
            in zip(IMAGE, GROUND, strict=True)]
    (tmp_path / "gdal.txt").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    (tmp_path / "arcgis.csv").write_text("\n".join(
        f"{i},{sample},{-line},{x},{y}" for i, (sample, line, x, y) in enumerate(rows, 1)))
    (tmp_path / "arcgis.tsv").write_text("\n".join(
        f"{sample}\t{-line}\t{x}\t{y}" for sample, line, x, y in rows))
    (tmp_path / "qgis.points").write_text(
        "#CRS: +proj=utm +zone=33 +datum=WGS84\nmapX,mapY,sourceX,sourceY\n" + "\n".join(
            f"{x},{y},{sample},{-line}" for sample, line, x, y in rows))
    for name, options in (("gdal.txt", {"format": "gdal-options"}), ("arcgis.csv", {}),
                          ("arcgis.tsv", {})):
        same(termsel.read(tmp_path / name, crs="EPSG:32633", **options), "EPSG:32633",
             heights=False)
    same(termsel.read(tmp_path / "qgis.points"), "EPSG:32633", heights=False)
    # Without the format the numbers alone could be anything: they are asked about.
    with pytest.raises(TermselError, match="This mapping is a guess"):
        termsel.read(tmp_path / "gdal.txt", crs="EPSG:32633")


def test_links_say_how_they_are_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="termsel")
    (tmp_path / "links.txt").write_text(links())
    termsel.read(tmp_path / "links.txt", crs="EPSG:32633")
    assert "read as links of ArcGIS" in caplog.text
    assert "the first is at sample 100, line 20.5, x 500000.5, y 5000000.0" in caplog.text


def test_fields_of_pci_in_another_order_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.gcp"
    path.write_text("".join(f"{name} {x} {y} {z} {sample + 0.5} {line + 0.5}\n"
                            for name, (line, sample), (x, y, z) in zip(IDS, IMAGE, GROUND,
                                                                       strict=True)))
    with pytest.raises(TermselError, match="line 1: the fields are taken as ID P L X Y Z, and"):
        termsel.read(path, crs="EPSG:32633")
    same(termsel.read(path, crs="EPSG:32633", layout="IDXYZPL"), "EPSG:32633")


def test_a_header_of_pix4d_says_what_comes_first(tmp_path: Path) -> None:
    marks = "".join(f"a.jpg,{name},{sample + 0.5},{line + 0.5}\n"
                    for name, (line, sample) in zip(IDS, IMAGE, strict=True))
    (tmp_path / "a.csv").write_text("imagename,label,x,y\n" + marks)
    (tmp_path / "a_gcps.csv").write_text("label,northing,easting,z\n" + "".join(
        f"{name},{y},{x},{z}\n" for name, (x, y, z) in zip(IDS, GROUND, strict=True)))
    same(termsel.read(tmp_path / "a.csv", crs="EPSG:32633"), "EPSG:32633")


def test_the_datum_of_a_gcp_file_is_in_its_comment(tmp_path: Path) -> None:
    (tmp_path / "a.gcp").write_text(
        '# WKT: GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
        'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]]\n# id lat lon height\n'
        "1 46.9 15.8 240 1 1 1 a.tif 10 20 1 1\n2 46.8 15.9 230 1 1 1 a.tif 900 40 1 1\n")
    features = termsel.read(tmp_path / "a.gcp")
    assert features.crs == "EPSG:4979"
    assert features.points.ground[0].tolist() == [15.8, 46.9, 240.0]


def test_images_of_each_format_are_parts_of_a_study(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a.jpg,P1,1,2\na.jpg,P2,3,4\nb.jpg,P1,5,6\n")
    (tmp_path / "a_gcps.csv").write_text("P1,1,2,3\nP2,4,5,6\n")
    assert list(Pix4dMarks().parts(tmp_path / "a.csv")) == ["a.jpg", "b.jpg"]
    with pytest.raises(TermselError, match=r"a\.jpg \(2\), b\.jpg.*termsel compare --points FILE"):
        termsel.read(tmp_path / "a.csv", crs="local")


def test_degrees_of_the_west_are_no_links(tmp_path: Path) -> None:
    """Latitude, longitude, row, column: the second column is negative, too."""
    (tmp_path / "a.txt").write_text("53.38 -2.90 825 1145\n53.39 -2.91 857 1028\n"
                                    "53.37 -2.95 977 905\n53.36 -2.94 600 701\n")
    with pytest.raises(TermselError, match="no header"):
        termsel.read(tmp_path / "a.txt", crs="EPSG:4326")


@pytest.mark.skipif(shutil.which("gdalinfo") is None, reason="gdalinfo is not installed")
@pytest.mark.parametrize("flags", [[], ["-json"]])
def test_what_gdalinfo_prints(flags: list[str], tmp_path: Path) -> None:
    gcps = "".join(f'<GCP Id="{name}" Info="" Pixel="{sample + 0.5}" Line="{line + 0.5}" X="{x}" '
                   f'Y="{y}" Z="{z}"/>' for name, (line, sample), (x, y, z)
                   in zip(IDS, IMAGE, GROUND, strict=True))
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="2000" rasterYSize="2100"><GCPList Projection="EPSG:32633">{gcps}'
        '</GCPList><VRTRasterBand dataType="Byte" band="1"/></VRTDataset>')
    text = subprocess.run(["gdalinfo", *flags, tmp_path / "a.vrt"], check=True,
                          capture_output=True, text=True).stdout
    (tmp_path / "info.txt").write_text(text)
    read = termsel.read(tmp_path / "info.txt")
    same(read, "EPSG:32633")
    assert read.image_size == (2100, 2000)


def fitted(crs: str = "EPSG:32631", *, independent: bool = False) -> Result:
    """A fit of points on an affine map with noise, P7 a blunder, with check points if asked."""
    rng = np.random.default_rng(7)
    image = rng.uniform(0, [2000, 3000], (24, 2))
    ground = np.column_stack([500000 + 2 * image[:, 1], 4000000 - 2 * image[:, 0],
                              rng.uniform(100, 120, 24)])
    measured = image + rng.normal(0, 0.3, image.shape)
    if independent:
        measured[7] += 80.0
    roles = ("control",) * 18 + (("independent",) * 6 if independent else ("control",) * 6)
    points = Points(tuple(f"P{i}" for i in range(24)), measured, ground, roles=roles)
    features = FeatureSet(points, crs=crs, image_size=(2000, 3000))
    if independent:
        return termsel.run(features=features, seed=0)
    return termsel.run("poly-terms", features=features, model="poly2d", solver="all-terms",
                       criterion="press", options={"degree": 1})


@pytest.fixture(scope="module")
def results() -> tuple[Result, ...]:
    return (fitted(),)


@pytest.fixture(scope="module")
def checked() -> Result:
    return fitted(independent=True)


WRITERS: dict[str, tuple[type[Writer], str, str]] = {
    "asp-gcp": (AspGcpWriter, "a.gcp", "EPSG:4979"),
    "odm-gcp-list": (OdmGcpListWriter, "a_gcp_list.txt", ""),
    "micmac-xml": (MicmacXmlWriter, "a.xml", "EPSG:32631"),
    "gdal-options": (GdalOptionsWriter, "a_gcps.txt", ""),
    "metashape-markers": (MetashapeMarkersWriter, "a_markers.xml", ""),
    "pix4d-marks": (Pix4dMarksWriter, "a_marks.csv", "EPSG:32631")}


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_writers_conform_and_are_read_back(name: str, results: tuple[Result, ...]) -> None:
    writer, file, crs = WRITERS[name]

    def verify(result: Result, path: Path) -> None:
        read = termsel.read(path, format=name, crs=crs or None)
        np.testing.assert_allclose(read.points.image, result.features.points.image, atol=1e-9)
        if crs != "EPSG:4979":
            np.testing.assert_allclose(read.points.ground, result.features.points.ground)

    for check in checks(writer(), filename=file, results=results, verify=verify):
        check.run()


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_blunders_stay_out_and_are_named(name: str, checked: Result, tmp_path: Path,
                                         caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="termsel")
    _, file, crs = WRITERS[name]
    assert [outlier.id for outlier in checked.outliers] == ["P7"]
    termsel.export(checked, name, tmp_path / file)
    assert "Left out: P7 (blunder of" in caplog.text
    # The format is told by the content.
    read = termsel.read(tmp_path / file, crs=crs or None).points
    assert len(read) == (
        17 if name in ("micmac-xml", "pix4d-marks", "gdal-options") else 23)
    known = checked.features.points.image[7]
    assert np.abs(read.image - known).max(axis=1).min() > 1.0
    if name == "metashape-markers":
        assert sum(role == "independent" for role in read.roles) == 6
    if name == "odm-gcp-list":
        assert sum(role == "independent" for role in read.roles) == 6
        assert sum(one.startswith("CHK-") for one in read.ids) == 6
        assert "take them as control" in caplog.text
        termsel.export(checked, name, tmp_path / "control.txt", check_points="false")
        assert len(termsel.read(tmp_path / "control.txt").points) == 17
    if name == "asp-gcp":
        assert read.sigma is not None
        assert set(read.ids) == {f"P{number}" for number in range(24)} - {"P7"}
        text = (tmp_path / file).read_text()
        assert sum(" 10000.0 10000.0 10000.0 " in row for row in text.splitlines()) == 6
        # bundle_adjust reads ids as whole numbers, and leaves out other rows.
        assert all(row.split()[0].isdecimal() for row in text.splitlines() if row[0] != "#")


@pytest.mark.parametrize(("name", "image", "written"), [
    ("odm-gcp-list", "a b,#.tif", "a_b,#.tif"), ("asp-gcp", "a b,#.tif", "a_b_.tif"),
    ("pix4d-marks", "a b,#.tif", "a b_#.tif"), ("micmac-xml", "a b,#.tif", "")])
def test_another_name_of_the_image_is_noted(name: str, image: str, written: str, tmp_path: Path,
                                            results: tuple[Result, ...],
                                            caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / WRITERS[name][1]
    termsel.export(results[0], name, path, image=image)
    assert (written or image) in path.read_text()
    assert (f"calls the image '{image}' {written}, as names have no" in caplog.text
            ) == bool(written)


def parsed_as_bundle_adjust_does(text: str) -> dict[int, tuple[list[float], str, list[float]]]:
    """Return ground numbers, image and image numbers of each id of a .gcp file.

    As the manual of bundle_adjust has it: cells between blanks or commas; a whole number, latitude
    and longitude [deg], height above the datum [m], three positive standard deviations [m]; then of
    each image its name, column and row from 0 and their two positive standard deviations [px].
    """
    points = {}
    for line in text.splitlines():
        if line.startswith("#") or not line.strip():
            continue
        cells = line.replace(",", " ").split()
        assert len(cells) == 12
        ground, image = list(map(float, cells[1:7])), list(map(float, cells[8:]))
        assert -90.0 <= ground[0] <= 90.0
        assert min(ground[3:] + image[2:]) > 0.0
        points[int(cells[0])] = (ground, cells[7], image)
    return points


@pytest.mark.parametrize("crs", ["EPSG:32631", "EPSG:2154"])
def test_asp_finds_the_points_where_they_are(crs: str, tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    result = fitted(crs)
    termsel.export(result, "asp-gcp", tmp_path / "a.gcp", image="scene 1.tif", ground_sigma=0.5)
    text = (tmp_path / "a.gcp").read_text()
    parsed = parsed_as_bundle_adjust_does(text)
    names = {int(line.split()[2]): line.split(" is ")[1] for line in text.splitlines()
             if line.startswith("# id ") and " is " in line}
    points = result.features.points
    to_degrees = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    assert set(names.values()) == set(points.ids)
    for number, (ground, image, pixel) in parsed.items():
        i = points.ids.index(names[number])
        x, y, z = points.ground[i]
        lon, lat = to_degrees.transform(x, y)
        np.testing.assert_allclose(ground[:2], [lat, lon], atol=1e-9)
        assert ground[2:] == [pytest.approx(z, abs=1e-3), 0.5, 0.5, 0.5]
        # Column before row, pixel centres at whole numbers as here.
        np.testing.assert_allclose(pixel[:2], points.image[i, ::-1], atol=1e-12)
        assert image == "scene_1.tif"


@pytest.mark.skipif(shutil.which("gdal_translate") is None, reason="GDAL is not installed")
def test_gdal_takes_a_projection_without_a_code_from_options(tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    bonne = "+proj=bonne +lat_1=36 +lon_0=0 +ellps=clrk80ign +pm=paris +units=m"
    result = fitted(bonne)
    termsel.export(result, "gdal-options", tmp_path / "a.txt")
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", width=3000, height=2000, count=1,
                      dtype="uint8", sparse_ok=True).close()
    subprocess.run(["gdal_translate", "-q", "-of", "VRT", "--optfile", tmp_path / "a.txt",
                    tmp_path / "a.tif", tmp_path / "b.vrt"], check=True)
    with rasterio.open(tmp_path / "b.vrt") as raster:
        gcps, crs = raster.gcps
        assert len(gcps) == 24
        written = pyproj.CRS(crs.to_wkt())
    assert written.prime_meridian.name == "Paris"
    assert written.coordinate_operation.method_name.startswith("Bonne")
    read = pyproj.CRS(termsel.read(tmp_path / "a.txt").crs)
    assert read.coordinate_operation.method_name.startswith("Bonne")


def test_check_points_alone_are_no_control_of_micmac(tmp_path: Path) -> None:
    result = fitted(independent=True)
    is_check = np.array([residual.role == "independent" for residual in result.residuals])
    names = {residual.id for residual, check in zip(result.residuals, is_check, strict=True)
             if check}
    points = result.features.points
    ground = points.ground.copy()
    ground[[name not in names for name in points.ids], 2] = np.nan
    checks = result.with_(features=replace(result.features, points=replace(
        points, ground=ground)))
    with pytest.raises(TermselError, match="independent check points"):
        termsel.export(checks, "micmac-xml", tmp_path / "a.xml")
    assert not list(tmp_path.iterdir())


def test_a_file_without_points_is_not_written(tmp_path: Path) -> None:
    result = fitted()
    ground = result.features.points.ground.copy()
    ground[:, 2] = np.nan
    flat = termsel.run("poly-terms", features=replace(
        result.features, points=replace(result.features.points, ground=ground)), model="poly2d",
        solver="all-terms", criterion="press", options={"degree": 1})
    for name, (_, file, _) in WRITERS.items():
        if name in ("asp-gcp", "micmac-xml"):
            with pytest.raises(TermselError, match="no point of this result can be written"):
                termsel.export(flat, name, tmp_path / file)
    assert not list(tmp_path.iterdir())


GCPS = [(10.5, 20.5, 15.81, 46.94, 240.8), (900.0, 40.0, 15.83, 46.94, 231.0),
        (450.0, 700.0, 15.82, 46.92, 228.5)]


@pytest.mark.parametrize("columns", ["", "\t>\tColor"])
def test_erdas_tables_are_recognised_with_all_their_columns(columns: str, tmp_path: Path) -> None:
    """X, Y and Z stand in the names of its columns, next to other words."""
    blank = "\t" * columns.count("\t")
    header = (f"Point #\tPoint ID{columns}\tX Input\tY Input{columns}\tX Ref.\tY Ref.\tZ Ref.\t"
              "Type\tX Residual\tY Residual")
    rows = [f"{i}\tGCP #{i}{blank}\t{sample}\t{-line}{blank}\t{x}\t{y}\t{z}\tControl\t0.1\t0.2"
            for i, (sample, line, x, y, z) in enumerate(GCPS)]
    path = tmp_path / "points.txt"
    path.write_text("\n".join([header, *rows, ""]))
    points = termsel.read(path, crs="EPSG:4326").points
    assert points.ids == ("GCP #0", "GCP #1", "GCP #2")
    assert points.image.tolist() == [[line, sample] for sample, line, *_ in GCPS]


def test_pci_writes_degrees_with_minutes_and_seconds(tmp_path: Path) -> None:
    def angle(value: float, side: str) -> str:
        minutes, seconds = divmod(value % 1.0 * 3600.0, 60.0)
        return f"{int(value)}d{int(minutes):02d}'{seconds:.4f}\"{side}"

    path = tmp_path / "points.gcp"
    path.write_text("".join(f"G{i} {sample} {line} {angle(x, 'E')} {angle(y, 'N')} {z}\n"
                            for i, (sample, line, x, y, z) in enumerate(GCPS)))
    points = termsel.read(path, crs="EPSG:4326").points
    np.testing.assert_allclose(points.ground, [row[2:] for row in GCPS], atol=1e-7)


def test_links_with_decimal_commas_are_read(tmp_path: Path) -> None:
    path = tmp_path / "links.txt"
    path.write_text("".join(f"{sample:.4f}\t{-line:.4f}\t{x:.6f}\t{y:.6f}\n".replace(".", ",")
                            for sample, line, x, y, _ in GCPS))
    points = termsel.read(path, crs="EPSG:4326").points
    assert points.image.tolist() == [[line - 0.5, sample - 0.5] for sample, line, *_ in GCPS]
