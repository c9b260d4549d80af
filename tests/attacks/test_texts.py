"""Tables, XML and Markdown that are written do nothing in the programs that open them."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import termsel
from termsel.core.files.texts import (
    csv_table,
    guard_cell,
    markdown_text,
    unguard_cell,
    xml_attribute,
)
from termsel.formats.vrt import Picture, vrt_text
from termsel.io.result_folder import residuals_csv
from termsel.studies.cells.table import csv_of
from termsel.studies.outputs import write_outputs

HOSTILE = ("=1+1", "+1+1", "-1+cmd|' /C calc'!A0", "@SUM(A1)", "'=1", " =1+1", "\t=1+1",
           "\uff1d1+1", "\x1b[31mred", "a\x07b", "<script>alert(1)</script>", "a|b", "x\u202ey",
           "[a](javascript:alert(1))", "`x`")


@pytest.mark.parametrize("text", HOSTILE)
def test_cells(text: str) -> None:
    cell = next(csv.reader(io.StringIO(csv_table([[text]]))))[0]
    assert not cell.strip().startswith(("=", "+", "-", "@", "\uff1d"))
    assert "\x1b" not in cell
    assert "\x07" not in cell
    assert unguard_cell(guard_cell(text)) == text
    assert csv_table([[-1.5, 2, None, "-1.5"]]) == "-1.5,2,,-1.5\n"


@pytest.mark.parametrize("text", HOSTILE)
def test_markdown(text: str) -> None:
    written = markdown_text(text)
    assert not any(sign in written for sign in "<>\x1b\x07\u202e\n")
    assert "](" not in written.replace("\\](", "")


def test_a_study(folder: Path) -> None:
    """Titles, labels and reasons come from a file of somebody else."""
    pytest.importorskip("termsel_studies")
    title = "=cmd() \x1b[31m <img src=x onerror=alert(1)> | ` [a](b)"
    study = termsel.compare(problems=["poly-terms"], models=["poly2d"], solvers=["random"], seeds=1,
                            title=title, budget={"evaluations": 20}, options={"degree": 1},
                            out=folder / "out")
    assert write_outputs(study, folder / "out")
    for name in ("study.csv", "summary.md", "summary.tex"):
        text = (folder / "out" / name).read_text()
        assert "\x1b" not in text
        assert "<img" not in text
    rows = [{**row, "reason": "=HYPERLINK(1)", "data": "@a", "notes": ["=b"]} for row in study.rows]
    for row in csv.reader(io.StringIO(csv_of(rows, study.columns))):
        assert not any(cell.startswith(("=", "@")) for cell in row)


def test_ties_of_a_block(folder: Path, call) -> None:
    """Ids of ties come from tables of a stranger; what is written is read again with them."""
    pytest.importorskip("termsel_block")
    assert call("block-example", "made", "--images", 3).exit_code == 0
    ties = folder / "made" / "ties.csv"
    header, *rows = ties.read_text().splitlines()
    ties.write_text("\n".join([header, *("=cmd-" + row for row in rows)]) + "\n")
    done = call("block", "made/block.toml", "--out", "out", "--quiet")
    assert done.exit_code == 0, done.stderr
    cells = [row[0] for row in csv.reader((folder / "out" / "ties.csv").open())]
    assert len(cells) > 10
    assert not any(cell.startswith("=") for cell in cells)


def test_residuals_and_points(made_result: Path) -> None:
    result = termsel.read_result(made_result)
    points = replace(result.features.points, ids=tuple(
        f"=cmd({i})" for i in range(len(result.features.points))))
    run = termsel.run("poly-terms", features=result.features.with_(points=points),
                      options={"degree": 1}, evaluations=20)
    rows = list(csv.reader(io.StringIO(residuals_csv(run))))
    assert len(rows) == 41
    assert not any(row[0].startswith("=") for row in rows)


def test_xml(folder: Path) -> None:
    """Whatever a name or a CRS holds, what is written is well-formed."""
    points = termsel.Points(("a\x01",) if _takes("a\x01") else ("a<&\">'",),
                            np.array([[1.0, 2]]), np.array([[3.0, 4, 5]]))
    text = vrt_text(Picture((9, 9)), folder, gcps=points, crs='X["\x01\x1b]]>"]',
                    domains={"a\x02": {"k\x03": "v\x04"}})
    ElementTree.fromstring(text)
    ElementTree.fromstring(f"<a b={xml_attribute(chr(1) + chr(0xfffe) + '<')}/>")
    with pytest.raises(termsel.TermselError, match="control characters"):
        vrt_text(Picture((9, 9), folder / "a\x01.tif"), folder)


def _takes(name: str) -> bool:
    try:
        termsel.Points((name,), np.zeros((1, 2)), np.zeros((1, 3)))
    except termsel.TermselError:
        return False
    return True


@pytest.mark.parametrize("name", ["points-csv", "pci-gcp", "erdas-gcps",
                                  "pix4d-marks", "qgis-points", "mapinfo-tab", "ozi-map",
                                  "metashape-markers", "pam-gcps", "gcp-vrt"])
def test_ids_in_each_format(name: str, folder: Path, made_result: Path) -> None:
    """An id that is a formula is no cell of any table, and comes back as it was."""
    pytest.importorskip("termsel_formats")
    features = termsel.read_result(made_result).features
    points = features.points.take(np.arange(25))
    ids = tuple(f"{sign}cmd({i})<&" for i, sign in zip(range(25), "=+-@\uff1d" * 5, strict=True))
    result = termsel.run("poly-terms", features=termsel.FeatureSet(
        replace(points, ids=ids), crs=features.crs), options={"degree": 1}, evaluations=20)
    path = folder / {"pci-gcp": "a.gcp", "erdas-gcps": "a_erdas.txt"}.get(name, f"a.{name}")
    written = termsel.export(result, name, path)
    for file in written or [path]:
        text = Path(file).read_text()
        if text.lstrip().startswith("<"):
            ElementTree.fromstring(text)
            continue
        for separator in ",\t;" if name in ("mapinfo-tab", "ozi-map") else ",\t; ":
            cells = [cell for row in csv.reader(io.StringIO(text), delimiter=separator)
                     for cell in row]
            assert not any(cell.startswith(("=", "@", "\uff1d", "+c", "-c"))
                           for cell in cells), separator
    if name in ("points-csv", "pci-gcp", "erdas-gcps"):
        read = termsel.read(path, format=name, crs=features.crs)
        assert set(read.points.ids) <= set(ids)
