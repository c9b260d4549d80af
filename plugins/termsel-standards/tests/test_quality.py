"""Quality reports: valid against the official schemas, and the figures of the result in them."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("termsel_standards", reason="termsel-standards is not installed: "
                    "pip install -e plugins/termsel-standards")

import termsel
from termsel import Result, TermselError, export, write_result
from termsel.testing import check, invoke
from termsel_standards.quality.report import quality_of
from termsel_standards.quality.writers import FgdcXml, Iso19157Json, Iso19157Xml

etree = pytest.importorskip("lxml.etree", reason="lxml is not installed: pip install lxml")

SCHEMAS = Path(__file__).with_name("schemas")
ISO = "http://standards.iso.org/iso/"
NAMES = {"mdb": f"{ISO}19115/-3/mdb/2.0", "mdq": f"{ISO}19157/-2/mdq/1.0",
         "mrl": f"{ISO}19115/-3/mrl/2.0", "mcc": f"{ISO}19115/-3/mcc/1.0",
         "cit": f"{ISO}19115/-3/cit/2.0", "gco": f"{ISO}19115/-3/gco/1.0",
         "gex": f"{ISO}19115/-3/gex/1.0"}


@pytest.fixture(scope="module")
def result() -> Result:
    return termsel.run("poly-terms", features=termsel.simulate_scene("ikonos-hamedan"),
                       solver="all-terms", criterion="press", options={"degree": 2})


@pytest.fixture(scope="module")
def iso() -> Any:
    """The schema of mdb:MD_Metadata 2.0, with all that it imports."""
    try:
        files = importlib.metadata.files("ckanext-iso19115") or []
        xsd = importlib.metadata.files("xmlschema") or []
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("no ISO schemas: pip install ckanext-iso19115")
    root = next(Path(str(one.locate())) for one in files if one.name == "mdb.xsd"
                and one.parent.name == "2.0").parents[4]
    # Of the W3C, which the schemas import by address.
    w3c = {name: next(Path(str(one.locate())) for one in xsd if one.name == name)
           for name in ("xlink.xsd", "xml.xsd")}
    published = {"http://schemas.opengis.net/": root / "schemas.opengis.net", ISO: root}

    class Local(etree.Resolver):  # type: ignore[misc,name-defined]
        def resolve(self, url: str, _id: str, context: Any) -> Any:
            there = w3c.get(url.rpartition("/")[2]) if "//www.w3.org/" in url else next(
                (folder / url.removeprefix(start) for start, folder in published.items()
                 if url.startswith(start)), None)
            return there and self.resolve_filename(str(there), context)

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    return etree.XMLSchema(etree.parse(str(root / "19115/-3/mdb/2.0/mdb.xsd"), parser))


@pytest.fixture(scope="module")
def fgdc(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("fgdc")
    with zipfile.ZipFile(SCHEMAS / "fgdc-std-001-1998.zip") as files:
        files.extractall(folder)
    return etree.XMLSchema(etree.parse(str(folder / "fgdc-std-001-1998.xsd")))


def without_independent(result: Result) -> Result:
    return result.with_(accuracy=None)


def texts(root: Any, path: str) -> list[str]:
    return [one.text for one in root.iterfind(path, NAMES)]


def test_the_iso_report_is_valid_and_states_the_accuracy(
        result: Result, iso: Any, tmp_path: Path) -> None:
    image = tmp_path / "scene.tif"
    image.write_bytes(b"pixels")
    path = tmp_path / "report.xml"
    export(result, "iso19157-xml", path, title="A scene", organisation="Agency & Sons",
           image=image)
    root = etree.parse(str(path)).getroot()
    iso.assertValid(root)
    assert result.accuracy is not None
    ground = result.accuracy.ground
    assert ground is not None
    reports = root.findall(".//mdq:DQ_AbsoluteExternalPositionalAccuracy", NAMES)
    known = {one.findtext(".//mdq:nameOfMeasure/gco:CharacterString", None, NAMES):
             one for one in reports}
    planimetry = known["root mean square error of planimetry"]
    assert float(planimetry.findtext(".//gco:Record", None, NAMES)) == pytest.approx(
        ground.total, rel=1e-8)
    assert planimetry.findtext(".//mdq:measureIdentification//mcc:code/gco:CharacterString", None,
                               NAMES) == "47"
    assert "No choice has used these points" in planimetry.findtext(
        ".//mdq:evaluationMethodDescription/gco:CharacterString", None, NAMES)
    assert planimetry.find(".//mdq:resultScope//gex:EX_GeographicBoundingBox", NAMES) is not None
    assert planimetry.findtext(".//mdq:dateTime/gco:DateTime", None, NAMES).endswith("Z")
    checksums = texts(root, ".//mrl:source//cit:identifier//mcc:code/gco:CharacterString")
    assert checksums == [result.data.sha256, hashlib.sha256(b"pixels").hexdigest()]
    assert texts(root, ".//mrl:softwareReference//cit:edition/gco:CharacterString") == [
        result.versions["termsel"]]
    assert "numpy" in texts(root, ".//mrl:documentation//cit:title/gco:CharacterString")


def test_an_invalid_report_is_noticed(result: Result, iso: Any, tmp_path: Path) -> None:
    path = tmp_path / "report.xml"
    export(result, "iso19157-xml", path)
    root = etree.parse(str(path)).getroot()
    scope = root.find(".//mdq:scope", NAMES)
    scope.getparent().remove(scope)
    assert not iso.validate(root)


def test_without_independent_points_the_report_says_so(
        result: Result, iso: Any, fgdc: Any, tmp_path: Path) -> None:
    for name, schema in (("iso19157-xml", iso), ("fgdc-xml", fgdc)):
        path = tmp_path / f"{name}.xml"
        export(without_independent(result), name, path)
        root = etree.parse(str(path)).getroot()
        schema.assertValid(root)
        assert "has no independent points" in path.read_text()
        assert root.find(".//mdq:DQ_QuantitativeResult", NAMES) is None
        assert root.find(".//qhorizpa") is None


@pytest.mark.slow
def test_few_independent_points_are_beside_the_prediction() -> None:
    """Twenty are the least of which a standard has a statement."""
    for count, is_stated in ((3, True), (25, False)):
        scene = termsel.simulate_scene("ikonos-hamedan", roles=(20, 0, count))
        report = quality_of(termsel.run(features=scene))
        predicted = [words for words in report.statements if words.startswith("Predicted, not")]
        assert bool(predicted) == is_stated
        assert all("by cross-validation" in words for words in predicted)
        assert report.check_points == count
        assert not report.predicted


def test_the_fgdc_metadata_are_valid(result: Result, fgdc: Any, tmp_path: Path) -> None:
    path = tmp_path / "fgdc.xml"
    export(result, "fgdc-xml", path, organisation="Agency")
    root = etree.parse(str(path)).getroot()
    fgdc.assertValid(root)
    assert result.accuracy is not None
    assert result.accuracy.ground is not None
    assert float(root.findtext(".//qhorizpa/horizpav")) == pytest.approx(
        result.accuracy.ground.total, rel=1e-8)
    assert root.findtext(".//metc//cntorg") == "Agency"
    root.find(".//lineage").clear()
    assert not fgdc.validate(root)


def test_json_states_the_same(result: Result, tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    export(result, "iso19157-json", path, title="A scene")
    stated = json.loads(path.read_text())
    assert stated["schema"] == "termsel-quality-1"
    report = quality_of(result, "A scene")
    assert [one["value"] for one in stated["measures"]] == [one.value for one in report.measures]
    assert stated["sources"][0]["sha256"] == result.data.sha256
    west, east, south, north = stated["bounds"]
    inside = result.features.points.ground
    assert west <= inside[:, 0].min() <= inside[:, 0].max() <= east
    assert south <= inside[:, 1].min() <= inside[:, 1].max() <= north


def test_titles_that_xml_cannot_hold(result: Result, iso: Any, tmp_path: Path) -> None:
    path = tmp_path / "report.xml"
    export(result, "iso19157-xml", path, title="A\x00<b>&\x1bé")
    root = etree.parse(str(path)).getroot()
    iso.assertValid(root)
    assert "A�<b>&�é" in texts(root, ".//cit:title/gco:CharacterString")


@pytest.mark.parametrize("writer", [Iso19157Xml, Iso19157Json, FgdcXml])
def test_the_writers_conform(writer: type[termsel.Writer]) -> None:
    check(writer(), filename="report.xml")


def test_plane_coordinates_and_lost_images_are_refused(result: Result, tmp_path: Path) -> None:
    local = result.with_(features=replace(result.features, crs="local"))
    with pytest.raises(TermselError, match="CRS of the Earth"):
        quality_of(local)
    (tmp_path / "run").mkdir()
    write_result(result, tmp_path / "run")
    shown = invoke("export", tmp_path / "run", "--to", "iso19157-xml",
                   "--output", tmp_path / "a.xml",
                   "--image", tmp_path / "none.tif")
    assert shown.exit_code == 2
    assert "none.tif" in shown.output
    assert not (tmp_path / "a.xml").exists()
