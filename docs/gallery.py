"""Run the cases of the gallery: their pictures, and the output that their pages show.

    python docs/gallery.py      draws the pictures of all pages again

Each page of `how-to/gallery` is a case. What it has the reader run is run here, in one process
and in a folder of its own. The pictures of the pages are files next to them, so that they are seen
without a build; a build runs the cases too, and leaves the pictures as they are.
Output shown is replaced by what was printed. A line ``<!-- true: EXPRESSION -->`` states in Python
what the page says: there the name of a folder is the content of its result.json, or its study, and
`KNOWN` has what looks further. A page that is not true any more fails the build. A page with a line
``<!-- needs: MODULE -->`` stays as it is where that module is not installed.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import tempfile
from contextlib import chdir, redirect_stdout
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from statistics import median
from typing import Any

from click.testing import CliRunner
from snippets import COMPILING, Step, renewed, steps

import termsel
from termsel.cli.main import cli
from termsel.io.plan import plan
from termsel.studies.study import Study

PAGES = Path(__file__).parent / "how-to" / "gallery"
PICTURES = PAGES / "pictures"
_PICTURE = re.compile(r"^```{image} pictures/(\S+)$", re.MULTILINE)
_PLACES = re.compile(r' (?:transform|d|[xy]2?|width|height)="[^"]*"')
_DECIMALS = re.compile(r"(\.\d)\d+")
_UNSEEN = re.compile(r' (?:aria-[a-z]+|role|class)="[^"]*"| opacity="1"'
                     r'| stroke-dasharray=""')
_NEEDS = re.compile(r"^<!-- needs: (\w+) -->$", re.MULTILINE)
_TRUE = re.compile(r"^<!-- true: (.+) -->$", re.MULTILINE)


def reached(study: Study, solver: str, evaluations: int) -> float:
    """Return the median of what the runs of a solver reached with so many evaluations."""
    traces = [study.records[key].trace for key, labels in study.cells.items()
              if labels["solver"] == solver]
    return median(min((point[1] for point in trace if point[0] <= evaluations),
                      default=float("inf")) for trace in traces)


def column(study: Study, solver: str, name: str) -> float:
    """Return the median of a column of a study's table over the runs of a solver."""
    return median(row[name] for row in study.rows if row["solver"] == solver)


KNOWN = {"read": termsel.read_result, "plan": plan, "median": median, "reached": reached,
         "column": column}
"""What statements may call."""


class Untrue(Exception):
    """What a page says and what its case gave differ."""


def made(pages: Path = PAGES, pictures: Path | None = None) -> dict[str, str]:
    """Run all cases, and return their pages with the output that was printed.

    Parameters
    ----------
    pages : Path
        Folder of the pages.
    pictures : Path, optional
        Folder for the pictures that pages show; what is there goes first.

    Raises
    ------
    Untrue
        If a page says what is not so.
    """
    if pictures is not None:
        shutil.rmtree(pictures, ignore_errors=True)
        pictures.mkdir(parents=True)
    found = {}
    for page in sorted(pages.glob("*.md")):
        needs = _NEEDS.findall(page.read_text(encoding="utf-8"))
        if page.stem == "index" or not all(map(find_spec, needs)):
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            found[page.stem] = _case(page, folder)
            drawn = {"-".join(path.relative_to(folder).parts): path
                     for path in folder.glob("**/*.svg")}
            for picture in _PICTURE.findall(found[page.stem]):
                if picture not in drawn:
                    raise Untrue(f"{page.name} shows {picture}, which it does not draw")
                if pictures is not None:
                    (pictures / picture).write_text(small(drawn[picture].read_text("utf-8")),
                                                    encoding="utf-8")
    return found


def small(svg: str) -> str:
    """Return a picture without what cannot be seen in one with an alternative text."""
    places = _PLACES.sub(lambda found: _DECIMALS.sub(r"\1", found[0]), svg)
    return _UNSEEN.sub("", places)


def _case(page: Path, folder: Path) -> str:
    """Return a page with the output that its steps print in a folder."""
    text = page.read_text(encoding="utf-8")
    new, done = "", 0
    for step in steps(text):
        printed = _run(step, folder)
        if not step.shown:
            continue
        lines = renewed(step.shown, printed)
        if lines is None:
            raise Untrue(f"{page.name} shows of {step.code}\n{step.shown}\n"
                         f"and it prints\n{printed}")
        new += text[done:step.start] + lines
        done = step.end
    records: dict[str, Any] = {path.parent.name: json.loads(path.read_text(encoding="utf-8"))
                               for path in folder.glob("*/result.json")}
    records |= {path.parent.name: termsel.read_study(path.parent)
                for path in folder.glob("*/plan.json")}
    with chdir(folder):
        for said in _TRUE.findall(text):
            if not eval(said, {**KNOWN, **records}):
                raise Untrue(f"{page.name}: not true: {said}")
    return new + text[done:]


def _run(step: Step, folder: Path) -> str:
    with chdir(folder):
        if step.python:
            printed = StringIO()
            with redirect_stdout(printed):
                exec(step.code, {})
            return printed.getvalue()
        program, *words = shlex.split(step.code.replace("\\\n", " "))
        if program != "termsel":
            raise Untrue(f"{step.code} is no command of termsel")
        result = CliRunner(env={"COLUMNS": "100", **os.environ}).invoke(cli, words)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return COMPILING.sub("", result.output)


if __name__ == "__main__":
    made(pictures=PICTURES)
