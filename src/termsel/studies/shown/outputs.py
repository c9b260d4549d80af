"""The files of a finished study."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from termsel.files.atomic import atomic_path, write_text
from termsel.report.plots import save
from termsel.report.theme import styled
from termsel.studies.cells.table import csv_of
from termsel.studies.shown.ioh import ioh_files
from termsel.studies.shown.pages import latex, markdown
from termsel.studies.shown.report import charts_of, report
from termsel.studies.statistics.groups import group
from termsel.studies.study import Study

REPORT = "report.html"

NAMES = ("study.csv", "study.parquet", "summary.md", "summary.tex", REPORT, "ioh", "figures")
"""Files and folders that `write_outputs` writes."""


def write_outputs(study: Study, out: Path) -> list[Path]:
    """Write the tables of a study, and return which files were written.

    study.csv has a row a cell; study.parquet the same, where pyarrow is installed; summary.md and
    summary.tex tables for people; ioh/ the runs for IOHprofiler; report.html a page of tables and
    charts, and figures/ the charts, where altair is installed.

    Raises
    ------
    TermselError
        If a file cannot be written.
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
    charts = charts_of(study) if drawn else []
    if drawn:
        write_text(out / REPORT, report(study, charts))
        written.append(out / REPORT)
    if study.spec.strategies == ("auto",):
        return written
    files = dict(ioh_files(group(study.rows, study.records, study.spec.measure)))
    for name, text in files.items():
        (out / "ioh" / name).parent.mkdir(parents=True, exist_ok=True)
        write_text(out / "ioh" / name, text)
    for one in charts:
        path = out / "figures" / f"{one.name}.svg"
        path.parent.mkdir(exist_ok=True)
        save(styled(one.chart, one.title, one.look), path)
        written.append(path)
    return [*written, *[out / "ioh"] * bool(files)]
