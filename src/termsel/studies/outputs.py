"""What is made of a study: its table, and what packages add."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from textwrap import shorten

from termsel.core.errors import count_in_words, make_printable
from termsel.core.files.atomic import atomic_path, write_text
from termsel.core.isolation.parts import (
    lack_of,
    missing_package_error,
    package_of_name,
    values_of_slot,
)
from termsel.results.blocks import Block
from termsel.results.text import text_of_blocks
from termsel.studies.cells.image_table import count_of_verdicts, image_reasons, image_table
from termsel.studies.cells.table import csv_of, usual_notes_in_words, with_notes_once
from termsel.studies.cells.verdicts import MEANING_OF_PLAUSIBLE, PLAUSIBLE
from termsel.studies.study import Study

SUMMARY = "summary.txt"
"""Everything that is said of a batch of images, of which the screen shows the worst."""
NAMES = ("study.csv", "study.parquet", SUMMARY)


@dataclass(frozen=True)
class StudyOutput:
    """What a package makes of a study.

    Parameters
    ----------
    files : tuple of str
        Files and folders that `write` may write into the folder of the study.
    write : callable
        Takes a `Study` and its folder; returns the files that it wrote.
    summary : callable, optional
        Takes a `Study` of searches; returns text for ``termsel compare`` to print. Images have
        their own text.
    page : callable, optional
        Takes a `Study`; returns the HTML page that ``termsel report`` writes.
    next_command : callable, optional
        Takes a `Study` of searches; returns the last line of the screen, "Next: " and a command,
        or "".
    """

    files: tuple[str, ...]
    write: Callable[[Study, Path], Iterable[Path]]
    summary: Callable[[Study], str] | None = None
    page: Callable[[Study], str] | None = None
    next_command: Callable[[Study], str] | None = None


def output_names() -> tuple[str, ...]:
    """Return the files and folders that `write_outputs` may write."""
    return (*NAMES, *chain.from_iterable(output.files for output in values_of_slot("study")))


def write_outputs(study: Study, out: Path) -> list[Path]:
    """Write a study's files, and return them: study.csv, then what packages add.

    study.csv has a row for each image, or for each cell of a study of searches. Of images
    summary.txt has what `study_summary` returns.

    study.parquet holds the same as study.csv, where pandas and pyarrow are installed.
    """
    write_text(out / "study.csv", csv_of(with_notes_once(study.rows), study.columns))
    written = [out / "study.csv"]
    # Both packages are needed, and neither is required.
    if find_spec("pandas") and find_spec("pyarrow"):
        with atomic_path(out / "study.parquet") as path:
            study.to_pandas().to_parquet(path, index=False)
        written.append(out / "study.parquet")
    if study.noun == "image":
        write_text(out / SUMMARY, study_summary(study))
        written.append(out / SUMMARY)
    for output in values_of_slot("study"):
        written += output.write(study, out)
    return written


def study_summary(study: Study) -> str:
    """Return a study as text: a table of its images, or the packages' summary of searches.

    Without a package, the text says which would show more.
    """
    outputs = values_of_slot("study")
    package = package_of_name("study")
    state, remedy = lack_of(package)
    # Images have their table without any package; statistics of searches come with one.
    if study.noun == "image":
        further = "" if any(output.page for output in outputs) else (
            f"A page of all images comes with the package {package}, which {state}. {remedy}\n")
        return f"{_text_on_images(study)}{further}"
    texts = [output.summary(study) for output in outputs if output.summary]
    return "".join(texts) or (
        f"{count_in_words(len(study.records), study.noun)} finished. Statistics and tables come "
        f"with the package {package}, which {state}. {remedy}\n")


def next_command_of_searches(study: Study) -> str:
    """Return the next step after a study of searches as packages say it; "" without one."""
    lines = (output.next_command(study) for output in values_of_slot("study")
             if output.next_command)
    return next(filter(None, lines), "")


REMEDY_FOR_SWAPPED = (
    "To correct a file in which coordinates are swapped: exchange the names of its columns in its "
    "header, x with y or line with sample, and repeat this command, which goes on with that image.")
"""What to do about images of a batch whose axes look swapped."""


_MOST_ROWS, _MOST_REASONS = 4, 2
"""Images, and reasons of verdicts, on the screen of a batch: with what was written, how many
failed and the next command it has twelve lines at most."""
_MOST_ALIKE = 1
"""Images that a reason on the screen names, of all that have it."""
_MOST_IDS = 3
"""Blunders of an image that its row names."""
_SCREEN_WIDTH = 88
"""Characters of a line of the screen."""


def screen(study: Study) -> str:
    """Return what a terminal shows of a batch of images: the worst ones, and how many more.

    Parameters
    ----------
    study : Study
        Of images.

    Returns
    -------
    str
        Nine lines at most. `study_summary` has every image, reason and note.
    """
    rows = study.rows
    shown_rows = rows if len(rows) <= _MOST_ROWS + 1 else rows[:_MOST_ROWS]
    caption = count_of_verdicts(rows)
    if any(row["verdict"] == PLAUSIBLE for row in rows):
        caption = f"{caption}; --accept 5m judges by a limit"
    reasons = image_reasons(rows, _MOST_ALIKE)
    remedy = [SWAPPED_IN_SHORT] if any("swapped" in reason for reason in reasons) else []
    # Rows and reasons share the screen: few images leave room for more reasons.
    room = _MOST_REASONS + _MOST_ROWS - len(shown_rows) - len(remedy)
    lines = [shorten(_first_sentence(reason), _SCREEN_WIDTH, placeholder=" ...")
             for reason in reasons[:room]]
    lines += remedy
    table = image_table(shown_rows)
    # The last column has the blunders: of many only the first.
    short_rows = [(*cells, _few_of(row["blunders"] or ()))
                  for (*cells, _), row in zip(table.rows, shown_rows, strict=True)]
    table = replace(table, caption=caption, rows=short_rows)
    hidden_counts = ((len(rows) - len(shown_rows), "more image"),
                     (len(reasons) - room, "more reason"),
                     (len(study.remarks) + len(usual_notes_in_words(rows)), "note"))
    hidden = [count_in_words(number, noun) for number, noun in hidden_counts if number > 0]
    if hidden:
        listed = " and ".join(hidden) if len(hidden) < 3 else ", ".join(hidden)
        lines.append(f"{listed}: --verbose, or {SUMMARY}")
    return text_of_blocks([table]) + make_printable("".join(f"{line}\n" for line in lines))


def _few_of(ids: Sequence[str]) -> str:
    """Return ids in words; of more than _MOST_IDS only the first, and how many more there are."""
    if len(ids) <= _MOST_IDS:
        return ", ".join(ids)
    return f"{', '.join(ids[:_MOST_IDS - 1])} and {len(ids) - _MOST_IDS + 1} more"


def _first_sentence(reason: str) -> str:
    """Return the first sentence of a reason."""
    return reason.partition(". ")[0]


SWAPPED_IN_SHORT = ("Swapped: exchange the names of the two columns in that file, and repeat "
                    "this command.")
"""What to do about images whose axes look swapped, in one line."""


def _text_on_images(study: Study) -> str:
    """Return the title, remarks, usual notes and table of the images of a study, as text.

    What "plausible" means, the reasons of verdicts and what to do about swapped axes follow, where
    they apply.
    """
    title = [study.spec.title] if study.spec.title else []
    has_plausible = any(row["verdict"] == PLAUSIBLE for row in study.rows)
    meaning = (MEANING_OF_PLAUSIBLE,) if has_plausible else ()
    reasons = image_reasons(study.rows)
    remedy = (REMEDY_FOR_SWAPPED,) if any("swapped" in reason for reason in reasons) else ()
    blocks: tuple[Block, ...] = (*title, *study.remarks, *usual_notes_in_words(study.rows),
                                 image_table(study.rows), *meaning, *reasons, *remedy)
    return text_of_blocks(blocks, all_rows=True).lstrip("\n")


def study_page(study: Study) -> str:
    """Return the HTML page of a study; TermselError where no installed package makes one."""
    pages = [output.page for output in values_of_slot("study") if output.page]
    if not pages:
        raise missing_package_error("study", "the page of a study requires")
    return str(pages[0](study))
