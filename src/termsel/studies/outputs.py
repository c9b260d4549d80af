"""What is made of a study: its table, and what packages add."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

from termsel.core.errors import counted
from termsel.core.files.atomic import atomic_path, write_text
from termsel.core.isolation.parts import missing, package_of_name, parts
from termsel.studies.cells.table import csv_of, with_notes_once
from termsel.studies.study import Study

NAMES = ("study.csv", "study.parquet")


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
        Takes a `Study`; returns text for ``termsel compare`` to print.
    page : callable, optional
        Takes a `Study`; returns the HTML page that ``termsel report`` writes.
    """

    files: tuple[str, ...]
    write: Callable[[Study, Path], Iterable[Path]]
    summary: Callable[[Study], str] | None = None
    page: Callable[[Study], str] | None = None


def names() -> tuple[str, ...]:
    """Return the files and folders that `write_outputs` may write."""
    return (*NAMES, *chain.from_iterable(output.files for output in parts("study")))


def write_outputs(study: Study, out: Path) -> list[Path]:
    """Write a study's files: study.csv with a row a cell, then what packages add; return them.

    study.parquet holds the same as study.csv, where pandas and pyarrow are installed.
    """
    write_text(out / "study.csv", csv_of(with_notes_once(study.rows), study.columns))
    written = [out / "study.csv"]
    # Both packages are needed, and neither is required.
    if find_spec("pandas") and find_spec("pyarrow"):
        with atomic_path(out / "study.parquet") as path:
            study.to_pandas().to_parquet(path, index=False)
        written.append(out / "study.parquet")
    for output in parts("study"):
        written += output.write(study, out)
    return written


def summary(study: Study) -> str:
    """Return what packages say of a study as text; without one, which package would."""
    texts = [output.summary(study) for output in parts("study") if output.summary]
    package = package_of_name("study")
    # A study is complete without the package that makes statistics of it.
    return "".join(texts) or (
        f"{counted(len(study.records), 'cell')} finished. Statistics and tables come with the "
        f"package {package}: pip install ./plugins/{package}\n")


def page(study: Study) -> str:
    """Return the HTML page of a study; TermselError where no installed package makes one."""
    pages = [output.page for output in parts("study") if output.page]
    if not pages:
        raise missing("study", "the page of a study requires")
    return str(pages[0](study))
