"""What packages make of a result: sections of its report, measures for studies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Any

from termsel.core.errors import TermselError
from termsel.core.isolation.faults import attribute_errors_to, fault_of_method
from termsel.results.blocks import (
    Block,
    Code,
    Detail,
    Document,
    Names,
    Note,
    Section,
    Statement,
    TableBlock,
)
from termsel.results.text import text_of

# A result is `Any` here: `Result` itself shows these sections.
_MAX_BLOCKS = 1000  # blocks of a section: a generator without an end is no section
_BLOCKS = str | Note | Detail | Statement | Code | Names | TableBlock


@dataclass(frozen=True)
class ReportSection:
    """A section of reports, after those of termsel.

    Parameters
    ----------
    name, summary : str
    title : str
        The heading.
    blocks : callable
        Takes a `Result`, returns what follows the heading: text for a paragraph, `TableBlock`,
        `Note`, `Code`, `Names`, `Statement`, or `Detail` around one of these. Nothing leaves the
        section out.

    Examples
    --------
    >>> import termsel
    >>> section = termsel.ReportSection("mine", "A remark.", "Remarks", lambda result: ["None."])
    >>> section.title
    'Remarks'
    """

    name: str
    summary: str
    title: str
    blocks: Callable[[Any], Iterable[Block]]


@dataclass(frozen=True)
class Measure:
    """A figure of results, a column of studies; smaller is better.

    Parameters
    ----------
    name, summary : str
        The name is that of the column.
    compute : callable
        Takes a `Result`, returns a number; NaN where there is none.

    Examples
    --------
    >>> import termsel
    >>> termsel.Measure("terms", "number of terms", lambda result: len(result.selection.terms)).name
    'terms'
    """

    name: str
    summary: str
    compute: Callable[[Any], float]


sources: list[Callable[[], Iterable[ReportSection]]] = []
"""What gives the sections of plugins: the registry, which lies above this room, adds itself."""


def further_sections(result: Any) -> tuple[Section, ...]:
    """Return the sections that plugins add; of one that fails, a note with the reason."""
    sections = []
    for source in sources:
        sections += [section_of(declared, result) for declared in source()]
    return tuple(section for section in sections if section.blocks)


def section_of(declared: ReportSection, result: Any) -> Section:
    """Return a plugin's section of a result; if it fails, a section with a note on the reason."""
    try:
        return _checked_section(declared, result)
    except TermselError as error:  # also the fault of a plugin
        return Section(declared.title, (Note(str(error), "Not shown"),))


def _checked_section(declared: ReportSection, result: Any) -> Section:
    """Return the section that a plugin declares, so that it cannot fail when it is shown.

    Raises PluginFault for blocks that are none, and whatever the plugin raises.
    """
    with attribute_errors_to(declared.blocks, "blocks"):
        # A generator may have no end.
        blocks = tuple(islice(declared.blocks(result), _MAX_BLOCKS))
        section = Section(declared.title, blocks)
        unknown = [block for block in blocks
                   if not isinstance(getattr(block, "block", block), _BLOCKS)]
        if not unknown:
            # Rows that do not fit, or are no text, show now and not in the middle of a page.
            text_of(Document("", "", (), (section,)))
            return section
    kind = type(unknown[0]).__name__
    raise fault_of_method(declared.blocks, "blocks",
                          f"returned an object of type {kind}; expected text, or "
                          "blocks such as TableBlock and Note")


def figure_of_result(measure: Measure, result: Any) -> float | None:
    """Return the figure of a result; None if it is infinite or NaN.

    Raises PluginFault, naming the plugin, for a figure that is no number.
    """
    with attribute_errors_to(measure.compute, "compute"):
        computed = measure.compute(result)
        value = float(computed)
    return value if math.isfinite(value) else None
