"""The page of a study: what may be claimed, tables, charts, and each image's residuals."""

from __future__ import annotations

from dataclasses import replace
from html import escape

from termsel.errors import TermselError, counted
from termsel.io.result_folder import read_result
from termsel.report.blocks import Document, Figure, Section
from termsel.report.page import page
from termsel.report.small import small_map
from termsel.report.text import text_of
from termsel.report.theme import require_altair
from termsel.studies.cells.images import IMAGES, folders_of
from termsel.studies.shown.figures import figures_of
from termsel.studies.shown.pages import tables_of
from termsel.studies.study import Study

_SMALL = ("Arrows are the residuals of all features: blue of control, orange of check, black of "
          "independent points. Red rings are probable blunders. Each drawing has its own scale.")


def charts_of(study: Study) -> list[Figure]:
    """Return the charts of a study: none of the strategy auto alone, which searches nothing.

    Raises
    ------
    TermselError
        If altair is not installed.
    """
    return figures_of(study) if study.spec.strategies != ("auto",) else []


def report(study: Study, charts: list[Figure] | None = None) -> str:
    """Return a page with the tables and charts of a study, and what may be claimed.

    Parameters
    ----------
    study : Study
        Finished or not.
    charts : list of Figure, optional
        As `charts_of` returns them.

    Raises
    ------
    TermselError
        If the extra `report` is not installed.
    """
    require_altair()
    return page(_document(study, charts_of(study) if charts is None else charts,
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
    """Return the residuals of each image that has a result as a small drawing.

    Returns
    -------
    dict
        SVG, or why there is none, as HTML; by the key of the cell.
    """
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
