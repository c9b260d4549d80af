"""Statistics, claims, tables, charts and the page of studies, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    from termsel.toolkit import Part
    from termsel_studies.report import report, summary

# What only a finished study needs is not imported for `termsel run`.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "outlines": ["map_of"], "report": ["report", "summary"]})

__all__ = ["map_of", "report", "summary"]


@hookimpl
def termsel_parts() -> Iterable[Part]:
    """Return what is made of a study."""
    from termsel.toolkit import Part
    from termsel.toolkit.studies import StudyOutput
    from termsel_studies import ioh
    from termsel_studies.outlines import map_of
    from termsel_studies.report import FILES, report, summary, write

    return [Part("study", StudyOutput((ioh.IOH_FOLDER,), ioh.write)),
            Part("study-map", map_of), Part("study", StudyOutput(FILES, write, summary, report))]
