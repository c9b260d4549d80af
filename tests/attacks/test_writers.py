"""Every table and every XML goes through one guarded writer: this finds any other."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GUARDED = {"src/termsel/core/files/texts.py": "the guarded writer",
           "src/termsel/cli/plan.py": "a method of termsel's own, which calls the guarded writer",
           "plugins/qgis-termsel/qgis_termsel/layers.py": "the guarded writer of QGIS's own Python"}
WRITERS = frozenset((
    "csv.writer", "csv.DictWriter", "writer.writerow", "DictWriter",
    "ElementTree.tostring", "ElementTree.tostringlist", "ElementTree.ElementTree",
    "ElementTree.indent", "etree.tostring", "minidom.parseString", "minidom.Document",
    "saxutils.XMLGenerator", "saxutils.quoteattr", "np.savetxt", "numpy.savetxt"))
METHODS = frozenset(("to_csv", "to_xml", "toxml", "toprettyxml", "write_csv", "to_markdown"))
MENTIONED = re.compile("csv|xml|savetxt|minidom|openpyxl|writerow|to_markdown", re.IGNORECASE)


def _sources() -> Iterator[Path]:
    for folder in ("src", "plugins", "docs", "benchmarks"):
        yield from (path for path in sorted((ROOT / folder).rglob("*.py"))
                    if not {"tests", "build"} & set(path.relative_to(ROOT).parts))


def unguarded_writers(text: str) -> list[str]:
    """Return the calls and imports in a module that write tables or XML by themselves."""
    found: list[str] = []
    if not MENTIONED.search(text):  # most modules, which take their time to parse
        return found
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            name = ".".join(ast.unparse(node.func).split(".")[-2:])
            if name in WRITERS or name.rpartition(".")[2] in METHODS:
                found.append(f"line {node.lineno}: {name}")
        elif isinstance(node, ast.ImportFrom) and node.module in (
                "csv", "xml.etree.ElementTree", "xml.dom.minidom", "xml.sax.saxutils",
                "lxml", "openpyxl", "xlsxwriter"):
            found += [f"line {node.lineno}: {node.module}.{name.name}" for name in node.names
                      if name.name not in ("Element", "ParseError", "fromstring", "reader")]
    return found


def test_tables_and_xml_have_one_writer() -> None:
    found = {str(path.relative_to(ROOT).as_posix()): unguarded_writers(path.read_text("utf-8"))
             for path in _sources()}
    assert len(found) > 300
    assert {name: calls for name, calls in found.items() if calls and name not in GUARDED} == {}
    assert {name for name, calls in found.items() if calls} == set(GUARDED)


@pytest.mark.parametrize("text", [
    "import csv\ncsv.writer(file).writerow(row)", "csv.DictWriter(f, names)",
    "from csv import writer", "from xml.etree import ElementTree\nElementTree.tostring(root)",
    "xml.etree.ElementTree.ElementTree(root).write(path)", "frame.to_csv(path)",
    "np.savetxt(path, rows)", "from xml.etree.ElementTree import tostring", "import openpyxl.x\n"
    "from openpyxl import Workbook", "root.toprettyxml()"])
def test_others_are_found(text: str) -> None:
    assert unguarded_writers(text)
    assert not unguarded_writers("import csv\ncsv.reader(f)\nElementTree.fromstring(x)\n"
                                 "ElementTree.SubElement(a, 'b')")
