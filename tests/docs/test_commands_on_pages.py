"""Pages can be followed by pasting: each command runs, and prints what the page shows."""

from __future__ import annotations

import logging
import re
import shutil
import sys
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

from termsel.plugins.registry import registry

ROOT = Path(__file__).parents[2]
pytest.importorskip("rasterio")


def _load(path: Path) -> ModuleType:
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


snippets = _load(ROOT / "docs" / "snippets.py")
_EXAMPLE = re.compile(r"termsel example (\S+) && cd \1")
PAGES = [page for page in [ROOT / "README.md", *sorted(ROOT.glob("plugins/*/README.md")),
                           *sorted(ROOT.glob("docs/**/*.md"))]
         if "_build" not in page.parts and snippets.steps(page.read_text(encoding="utf-8"))]


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a page registers, or has said in a log, ends with the page."""
    monkeypatch.setattr(logging.getLogger("termsel"), "handlers", [])
    monkeypatch.setenv("COLUMNS", "80")
    provided = registry()._provided
    before = {kind: list(one.entries) for kind, one in provided.items()}
    yield
    for kind in list(provided):
        if kind in before:
            provided[kind].entries[:] = before[kind]
        else:
            del provided[kind]


def _plugin() -> str:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    return next(block for block in blocks if "class DLT" in block)


@pytest.mark.slow_cases(
    "README.md", "docs/explanation/certificates.md", "docs/explanation/lines.md",
    "docs/explanation/searching.md", "docs/how-to/answers.md", "docs/how-to/attributes.md",
    "docs/how-to/block.md", "docs/how-to/checkpoint.md",
    "docs/how-to/blunders.md", "docs/how-to/compare.md", "docs/how-to/coordinates.md",
    "docs/how-to/deap-and-pymoo.md", "docs/how-to/export.md", "docs/how-to/gallery/blunders.md",
    "docs/how-to/gallery/clean.md", "docs/how-to/gallery/contradiction.md",
    "docs/how-to/gallery/corner.md", "docs/how-to/gallery/few.md", "docs/how-to/gallery/front.md",
    "docs/how-to/gallery/lines.md", "docs/how-to/gallery/old-map.md",
    "docs/how-to/gallery/overfitting.md", "docs/how-to/gallery/solvers.md",
    "docs/how-to/heights.md", "docs/how-to/match.md", "docs/how-to/photos-and-scanners.md",
    "docs/how-to/plan.md", "docs/how-to/points.md", "docs/how-to/problem.md",
    "docs/how-to/python.md", "docs/how-to/refine-rpc.md", "docs/how-to/relief.md",
    "docs/how-to/report.md", "docs/how-to/standards.md", "docs/reference/formats/areas-csv.md",
    "docs/reference/formats/gdal-gcps.md", "docs/reference/formats/ground-lines.md",
    "docs/reference/formats/points-csv.md", "docs/reference/formats/qgis-points.md",
    "docs/reference/formats/rpc.md", "docs/tutorial/gis-analyst.md", "docs/tutorial/index.md",
    "docs/tutorial/map-archivist.md", "docs/tutorial/photogrammetrist.md")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
@pytest.mark.usefixtures("clean")
def test_page_can_be_followed(page: Path, tmp_path: Path, example_files: Path,
                              monkeypatch: pytest.MonkeyPatch) -> None:
    text = page.read_text(encoding="utf-8")
    for package in set(re.findall(r"\./plugins/termsel-(\w+)", text)):
        pytest.importorskip(f"termsel_{package}")
    if "termsel_dlt" in text:  # the plugin of the README
        (tmp_path / "termsel_dlt.py").write_text(_plugin(), encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
    session = snippets.Session(tmp_path, here=True)
    snippets.download(page, tmp_path)
    for step in snippets.steps(text):
        if files := _EXAMPLE.fullmatch(step.code):
            session.folder = session.folder / files[1]
            shutil.copytree(example_files, session.folder)
            continue
        actual = session.run(step)
        if step.shown is not None:
            assert snippets.renewed(step.shown, actual) is not None, (
                f"{step.code}\nis shown to print\n{step.shown}\nand prints\n{actual}\n"
                f"python docs/snippets.py {page.relative_to(ROOT)} renews the page")
