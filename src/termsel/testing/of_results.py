"""What every section of reports, and every measure of studies, must do."""

from __future__ import annotations

import math

from termsel.results.extras import Measure, ReportSection, figure_of_result, section_of
from termsel.results.result import Result
from termsel.testing.cases import Case, Suite, declaration_check, require, through_pickle
from termsel.testing.writers import example_results


def shown(section: ReportSection) -> None:
    """It makes blocks that texts and pages can show, or nothing, of every result."""
    for result in example_results():
        # An exception of the section itself makes this check fail.
        list(section.blocks(result))
        # Blocks that cannot be shown become a note with the reason.
        for block in section_of(section, result).blocks:
            require(getattr(block, "label", "") != "Not shown",
                    f"blocks() cannot be shown: {getattr(block, 'text', '')}")


def figure(measure: Measure) -> None:
    """It gives one number of every result, not infinite; NaN where there is none."""
    for result in example_results():
        value = measure.compute(result)
        require(isinstance(float(value), float) and not math.isinf(value),
                f"compute() returned {value!r:.100}; expected a number, or NaN")


def same_again(item: ReportSection | Measure) -> None:
    """The same result gets the same answer, here and in another process, and stays as it is."""
    for result in example_results():
        before = result.to_json()
        first = _answer_of(item, result)
        for copy in (item, through_pickle(item)):
            require(_answer_of(copy, result) == first,
                    "the same result gets another answer from one "
                    "call or process to the next")
        require(result.to_json() == before, "it changes the result; work on a copy")


def _answer_of(item: ReportSection | Measure, result: Result) -> object:
    """Return what a section shows of a result, or the figure of a measure."""
    return figure_of_result(item, result) if isinstance(item, Measure) else section_of(item, result)


def cases(item: ReportSection | Measure) -> list[Case]:
    """Return a section or a measure."""
    return [Case(item.name, lambda: item)]


SECTIONS = Suite((declaration_check("sections"), shown, same_again), cases)
MEASURES = Suite((declaration_check("measures"), figure, same_again), cases)
