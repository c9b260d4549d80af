"""The page of a study, with each image's residuals, and the files of a finished one."""

from __future__ import annotations

import logging
from dataclasses import replace
from html import escape
from importlib.util import find_spec
from pathlib import Path

from termsel import Code, Study, TermselError, read_result
from termsel.toolkit import count_in_words, write_text
from termsel.toolkit.charts import Document, Figure, Section, render_page, save, text_of, with_theme
from termsel.toolkit.studies import IMAGES, folders_of, image_reasons
from termsel_studies.figures import CHARTS, figures_of
from termsel_studies.next_run import next_command
from termsel_studies.pages import remarks_of, study_as_latex, study_as_markdown, tables_of, title_of
from termsel_studies.small import draw_residual_thumbnail

log = logging.getLogger(__name__)

REPORT = "report.html"

FILES = ("summary.md", "summary.tex", REPORT, "figures")
"""Files and folders that `write_tables_and_charts` writes."""

_LEGEND_OF_THUMBNAILS = ("Arrows are the residuals of all features: blue at control points, orange "
          "at selection points, black (white on a dark page) at independent check points. Red "
          "rings mark probable blunders. Each drawing has its own scale.")


def report(study: Study, charts: list[Figure] | None = None) -> str:
    """Return a page with what may be claimed of a study, finished or not, its tables and charts.

    Parameters
    ----------
    study : Study
        As `termsel.compare` returns it.
    charts : list of Figure, optional
        By default those of `figures_of`.

    Returns
    -------
    str
        HTML that needs no other file.

    Raises
    ------
    TermselError
        Without the extra `report`.

    Examples
    --------
    >>> import termsel
    >>> from termsel_studies import report
    >>> study = termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=[1],
    ...                         budget={"evaluations": 100})
    >>> report(study)[:15]
    '<!DOCTYPE html>'
    """
    return render_page(_study_document(
        study, figures_of(study) if charts is None else charts, residual_thumbnails(study)))


def study_summary(study: Study) -> str:
    """Return the page of a study as text, brief: valid claims, short tables, reasons of images.

    Parameters
    ----------
    study : Study
        As `termsel.compare` returns it.

    Returns
    -------
    str
        Lines of text, as `termsel compare` prints them.

    Examples
    --------
    >>> import termsel
    >>> from termsel_studies import study_summary
    >>> study = termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=[1],
    ...                         budget={"evaluations": 100})
    >>> print(study_summary(study).splitlines()[5])
    There is one method, so nothing is compared.
    """
    return text_of(_study_document(study, [], {}, brief=True))


def _study_document(study: Study, charts: list[Figure], pictures: dict[str, str], *,
                    brief: bool = False) -> Document:
    """Return the page of a study: a chart, valid claims, images, tables, further charts, a command.

    The chart before the first heading is that of all instances, or of the convergence on one.
    `pictures` are drawings of images as SVG by the key of their cell; the table of images shows
    them. If `brief`, tables have at most five columns, and the reasons of the verdicts on images
    are sentences. Sections without content are left out.
    """
    tables, sentences = tables_of(study, brief=brief)
    images = []
    for table in tables:
        if table.keys:
            thumbnails = [pictures.get(key, "") for key in table.keys] if pictures else ()
            images.append(replace(table, keys=(), pictures=thumbnails))
    legend = [_LEGEND_OF_THUMBNAILS] if pictures and images else []
    rows = [row for row in study.rows if row["strategy"] == "auto"]
    reasons = image_reasons(rows) if brief else []
    first = first_chart(charts)
    command = "" if brief else next_command(study).removeprefix("Next: ").partition("   ")[0]
    sections = (
        Section("What may be claimed", tuple(sentences)),
        Section("Images", (*remarks_of(study), *legend, *images, *reasons)),
        Section("Tables", tuple(table for table in tables if not table.keys)),
        Section("Charts", tuple(chart for chart in charts if chart is not first)),
        Section("What comes next?", (
            "A study keeps figures alone. This repeats the best run of the best method, and keeps "
            "its model, its residuals and its accuracy:", Code(command)) if command else ()))
    only_images = study.spec.strategies == ("auto",)
    done = len(study.records)
    number = count_in_words(len(study.cells), "image" if only_images else "run")
    return Document(title_of(study),
                    number if study.complete else f"{done} of {number} finished",
                    () if first is None else (first,),
                    tuple(section for section in sections if section.blocks))


def first_chart(charts: list[Figure]) -> Figure | None:
    """Return the chart that a page begins with: over all instances, if there is one, else of one.
    """
    by_name = {chart.name: chart for chart in charts}
    return next((by_name[name] for name in ("performance-profile", "convergence",
                                            "ecdf-evaluations") if name in by_name), None)


def residual_thumbnails(study: Study) -> dict[str, str]:
    """Return small drawings (SVG) of the residuals of finished images, by the key of their cell.

    If the result of an image cannot be read, the reason stands in place of its drawing, as HTML.
    Returns {} for a study without a folder.
    """
    if study.folder is None:
        return {}
    drawings = {}
    for key, name in folders_of(study.cells).items():
        if key not in study.records or study.records[key].state != "done":
            continue
        try:
            drawings[key] = draw_residual_thumbnail(read_result(study.folder / IMAGES / name).view)
        except TermselError as error:
            drawings[key] = escape(error.what)
    return drawings


def write_tables_and_charts(study: Study, folder: Path) -> list[Path]:
    """Write the tables and charts of a study into a folder; return the files that were written.

    summary.md and summary.tex have the tables. report.html, a page of tables and charts, and the
    charts in figures/ are written only if altair and vl-convert are installed. A page or chart that
    cannot be drawn is left out with a warning. Charts in figures/ that were not written now are
    removed, whatever the reason; a report.html that is not written now stays as it was. Raises
    TermselError if a table cannot be written.
    """
    written = []
    for name, text in {"summary.md": study_as_markdown(study),
                       "summary.tex": study_as_latex(study)}.items():
        write_text(folder / name, text)
        written.append(folder / name)
    # Charts are drawn by altair, and turned into files by vl-convert.
    if find_spec("altair") and find_spec("vl_convert"):
        charts = figures_of(study)
        written += [*_write_page(study, charts, folder), *_write_charts(charts, folder / "figures")]
    # A study that went on may have other charts than when it was written last.
    for name in CHARTS:
        path = folder / "figures" / f"{name}.svg"
        if path not in written:
            path.unlink(missing_ok=True)
    return written


def _write_page(study: Study, charts: list[Figure], folder: Path) -> list[Path]:
    """Write report.html into a folder and return its path, alone; none, and a warning, without it.
    """
    path = folder / REPORT
    try:
        write_text(path, report(study, charts))
    except (TermselError, MemoryError) as error:
        why = error.what if isinstance(error, TermselError) else "out of memory"
        log.warning("Warning: %s is missing: %s.", path, why.rstrip("."))
        return []
    return [path]


def _write_charts(charts: list[Figure], folder: Path) -> list[Path]:
    """Write charts into a folder and return the files; one that cannot be drawn is a warning."""
    written = []
    for figure in charts:
        path = folder / f"{figure.name}.svg"
        folder.mkdir(exist_ok=True)
        try:
            save(with_theme(figure.chart, figure.title, figure.look), path)
        except TermselError as error:
            log.warning("%s", error)
        else:
            written.append(path)
    return written
