"""What every section of reports, and every measure of studies, must do."""

from __future__ import annotations

import math

from termsel.results.extras import Measure, ReportSection, measured, section_of
from termsel.results.result import Result
from termsel.testing.cases import Case, Suite, declares, pickled, require
from termsel.testing.writers import example_results


def shown(section: ReportSection) -> None:
    """It makes blocks that texts and pages can show, or nothing, of every result."""
    for result in example_results():
        list(section.blocks(result))  # raises what it raises
        for block in section_of(section, result).blocks:
            require(getattr(block, "label", "") != "Not shown",
                    f"blocks() cannot be shown: {getattr(block, 'text', '')}")


def figure(measure: Measure) -> None:
    """It gives one number of every result, not infinite; NaN where there is none."""
    for result in example_results():
        found = measure.compute(result)
        require(isinstance(float(found), float) and not math.isinf(found),
                f"compute() returned {found!r:.100}; expected a number, or NaN")


def same_again(thing: ReportSection | Measure) -> None:
    """The same result gets the same answer, here and in another process, and stays as it is."""
    for result in example_results():
        before = result.to_json()
        first = _answer(thing, result)
        for other in (thing, pickled(thing)):
            require(_answer(other, result) == first, "the same result gets another answer from one "
                                                     "call or process to the next")
        require(result.to_json() == before, "it changes the result; work on a copy")


def _answer(thing: ReportSection | Measure, result: Result) -> object:
    return measured(thing, result) if isinstance(thing, Measure) else section_of(thing, result)


def cases(thing: ReportSection | Measure) -> list[Case]:
    """Return a section or a measure."""
    return [Case(thing.name, lambda: thing)]


SECTIONS = Suite((declares("sections"), shown, same_again), cases)
MEASURES = Suite((declares("measures"), figure, same_again), cases)
