"""The page of a study, with each image's residuals, and the files of a finished one."""

from __future__ import annotations

import logging
from dataclasses import replace
from html import escape
from importlib.util import find_spec
from pathlib import Path

from termsel.errors import TermselError, counted
from termsel.files.atomic import atomic_path, write_text
from termsel.io.result_folder import read_result
from termsel.report.blocks import Document, Figure, Section
from termsel.report.page import page
from termsel.report.plots import save
from termsel.report.small import small_map
from termsel.report.text import text_of
from termsel.report.theme import require_altair, styled
from termsel.studies.cells.images import IMAGES, folders_of
from termsel.studies.cells.table import csv_of
from termsel.studies.shown.figures import figures_of
from termsel.studies.shown.pages import latex, markdown, tables_of
from termsel.studies.statistics.groups import group
from termsel.studies.study import Study

log = logging.getLogger(__name__)

REPORT = "report.html"

NAMES = ("study.csv", "study.parquet", "summary.md", "summary.tex", REPORT, "ioh", "figures")
"""Files and folders that `write_outputs` writes."""

_SMALL = ("Arrows are the residuals of all features: blue of control, orange of check, black "
          "(white on a dark page) of independent points. Red rings are probable "
          "blunders. Each drawing has its own scale.")


def report(study: Study, charts: list[Figure] | None = None) -> str:
    """Return a page with what may be claimed of a study, finished or not, its tables and charts.

    `charts` are by default those of `figures_of`. Raises TermselError without the extra `report`.
    """
    require_altair()
    return page(_document(study, figures_of(study) if charts is None else charts,
                          thumbnails(study)))


def summary(study: Study) -> str:
    """Return what may be claimed of a study, and its tables, as text."""
    return text_of(_document(study, [], {}))


def _document(study: Study, charts: list[Figure], pictures: dict[str, str]) -> Document:
    """Return what is shown of a study; `pictures` are drawings of images by the key of the cell."""
    tables, said = tables_of(study)
    images = [replace(one, keys=(), pictures=[pictures.get(key, "") for key in one.keys]
                      if pictures else ()) for one in tables if one.keys]
    sections = (
        Section("What may be claimed", tuple(said)),
        Section("Images", (*[_SMALL] * bool(pictures and images), *images)),
        Section("Tables", tuple(one for one in tables if not one.keys)),
        Section("Charts", tuple(charts)))
    alike = study.spec.strategies == ("auto",)
    done, number = len(study.records), counted(len(study.cells), "image" if alike else "cell")
    return Document(study.spec.title or "Study",
                    number if study.complete else f"{done} of {number} finished", (),
                    tuple(section for section in sections if section.blocks))


def thumbnails(study: Study) -> dict[str, str]:
    """Return small drawings of each image's residuals by the key of the cell: SVG, or why not."""
    if study.folder is None:
        return {}
    drawings = {}
    for key, name in folders_of(study.cells).items():
        if key not in study.records or study.records[key].state != "done":
            continue
        try:
            drawings[key] = small_map(read_result(study.folder / IMAGES / name).view)
        except TermselError as error:
            drawings[key] = escape(error.what)
    return drawings


def write_outputs(study: Study, out: Path) -> list[Path]:
    """Write the tables of a study, and return which files were written.

    study.csv has a row a cell; study.parquet the same, where pyarrow is installed; summary.md and
    summary.tex tables for people; ioh/ the runs for IOHprofiler, where termsel-bench is;
    report.html a page of tables and charts, and figures/ the charts, where altair is.
    """
    pages = {"study.csv": csv_of(study.rows, study.columns), "summary.md": markdown(study),
             "summary.tex": latex(study)}
    for name, text in pages.items():
        write_text(out / name, text)
    written = [out / name for name in pages]
    if find_spec("pandas") and find_spec("pyarrow"):
        with atomic_path(out / "study.parquet") as path:
            study.to_pandas().to_parquet(path, index=False)
        written.insert(1, out / "study.parquet")
    drawn = find_spec("altair") and find_spec("vl_convert")
    charts = figures_of(study) if drawn else []
    if drawn:
        write_text(out / REPORT, report(study, charts))
        written.append(out / REPORT)
    if study.spec.strategies == ("auto",):
        return written
    files: dict[str, str] = {}
    if find_spec("termsel_bench"):
        from termsel_bench.ioh import ioh_files

        files = dict(ioh_files(group(study.rows, study.records, study.spec.measure)))
    for name, text in files.items():
        (out / "ioh" / name).parent.mkdir(parents=True, exist_ok=True)
        write_text(out / "ioh" / name, text)
    for one in charts:
        path = out / "figures" / f"{one.name}.svg"
        path.parent.mkdir(exist_ok=True)
        try:
            save(styled(one.chart, one.title, one.look), path)
        except TermselError as error:  # no chart takes the tables along
            log.warning("%s", error)
            continue
        written.append(path)
    return [*written, *[out / "ioh"] * bool(files)]
