"""What a study's folder says of it: what was asked for, and which cells that makes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msgspec import ValidationError, convert

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError
from termsel.core.files.atomic import write_text
from termsel.core.files.lock import lock_holder
from termsel.core.files.names import path_inside
from termsel.formats.base import error_in_file, parse_json, read_utf8
from termsel.studies.cells.cell import Cell
from termsel.studies.cells.journal import read_journal
from termsel.studies.cells.table import LABELS
from termsel.studies.execution.progress import StudyProgress, Tally
from termsel.studies.plan.spec import FILE_KEYS, PARTS, READING, PartSpec, Source, Spec, spec_of
from termsel.studies.study import Study

PLAN = "plan.json"


def write_plan(spec: Spec, cells: Sequence[Cell], workers: int, folder: Path) -> None:
    """Write the request of a study, and its cells by key, to the plan in its folder."""
    # Objects that Python gave are in `spec` by their names, features not at all.
    write_text(folder / PLAN, json.dumps(
        {"study": table_of(spec), "data": {cell.data.label: cell.data.key for cell in cells},
         "workers": workers, "cells": {cell.key: cell.labels for cell in cells}}, indent=1) + "\n")


def _read_plan(folder: Path) -> tuple[Spec, int, dict[str, dict[str, Any]]]:
    """Return the spec of a study, its number of workers, and the labels of all cells by key.

    Raises TermselError if there is no plan, or it is damaged.
    """
    file = path_inside(folder, PLAN)
    repeat = "Repeat the command that began the study."
    if not file.is_file():
        if folder.is_file():
            raise TermselError("this is a file, and a study is a folder", file=folder,
                               hint=f"termsel compare {folder} --out DIR runs a study that a file "
                                    "describes, and writes its folder: give that."
                               if folder.suffix == ".toml" else
                               "Give the folder that termsel compare --out wrote.")
        has_run = (folder / "result.json").is_file()
        raise TermselError("this folder has a run, not a study" if has_run else
                           "there is no study in this folder", file=folder,
                           hint="Give the folder that termsel compare --out wrote.")
    try:
        table = parse_json(read_utf8(file), repeat)
    except TermselError as error:
        raise error_in_file(error, file) from error
    try:
        read = convert(table["cells"], dict[str, dict[str, str | int]])
        # Every cell has all labels, in the order of the tables.
        cells = {}
        # A cell without one of them was not written by this program.
        for key, labels in read.items():
            cells[key] = {name: labels[name] for name in LABELS}
        return spec_of(table["study"]), int(table["workers"]), cells
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError,
            ValidationError, TermselError) as error:
        raise TermselError("this is not the plan of a study", file=file, hint=repeat) from error


def keys_by_labels(folder: Path) -> dict[tuple[Any, ...], str]:
    """Return the keys that the cells of a folder had so far; none where no plan can be read."""
    try:
        cells = _read_plan(folder)[2]
    except TermselError:  # every command writes the plan again
        return {}
    return {tuple(labels.values()): key for key, labels in cells.items()}


@explains_arguments()
def read_study(folder: Path | str) -> Study:
    """Return the study of a folder, finished or not; nothing is run.

    Parameters
    ----------
    folder : path
        The folder that was given as `out`, or with ``--out``.

    Returns
    -------
    Study
        Cells that are not finished are waiting. Its `spec` names the objects that Python gave.

    Raises
    ------
    TermselError
        If there is no study, or its files were damaged.

    Examples
    --------
    >>> import tempfile, termsel
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     study = termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=2,
    ...                             budget={"evaluations": 20}, out=f"{folder}/study")
    ...     len(termsel.read_study(f"{folder}/study").rows)
    2
    """
    spec, _, cells = _read_plan(Path(folder))
    records = read_journal(Path(folder)).records
    # Records of cells that the plan does not name are of an earlier plan.
    return Study(spec, cells, {key: records[key] for key in cells if key in records}, Path(folder))


def study_progress(folder: Path) -> tuple[StudyProgress, str | None]:
    """Return the progress of the study of a folder, and who is at work on it; None if nobody is."""
    study = read_study(folder)
    workers = _read_plan(folder)[1]
    return Tally(study.cells, workers, study.records).progress(), lock_holder(folder)


def table_of(spec: Spec) -> dict[str, Any]:
    """Return a spec as the table of a study's file; `spec_of` is the inverse."""
    table = {
        "title": spec.title, **{kind: list(map(_part_name, getattr(spec, kind))) for kind in PARTS},
        "strategies": spec.strategies,
        "data": [_table_of_source(source) for source in spec.data if not source.features],
        "seeds": spec.seeds, "splits": spec.splits, "budget": spec.budget, "options": spec.options,
        "exports": spec.exports, "measure": spec.measure,
        "measures": spec.measures, "accept": spec.accept and str(spec.accept)}
    # What is not asked for is left to the defaults of whoever reads it.
    return {key: value for key, value in table.items() if value}


def _part_name(component: PartSpec) -> dict[str, Any]:
    """Return a part of a study by name, label and options."""
    return {"name": component.name, "label": component.label, **component.options}


def _table_of_source(source: Source) -> dict[str, Any]:
    """Return a source of data as a study's file states it."""
    if source.dataset is not None:
        return {"dataset": source.dataset}
    options = {key: value for key, value in source.reading.items() if key not in READING}
    return {**{kind: source.files[kind] for kind in FILE_KEYS if kind in source.files},
            **{key: source.reading[key] for key in READING if key in source.reading},
            **({"options": options} if options else {})}
