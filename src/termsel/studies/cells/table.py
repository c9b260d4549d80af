"""The tidy table of a study: one row a cell."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from termsel.core.files.texts import csv_table
from termsel.data.coordinates.earth import position_in_words
from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.neighbours import Batch, batch_of
from termsel.studies.cells.verdicts import DOUBTFUL, FIT, PLAUSIBLE, UNFIT, Accept, verdicts_of

LABELS = ("problem", "data", "split", "strategy", "model", "criterion", "solver", "seed")
"""What distinguishes the cells of a study, in the order in which they vary."""

WAITING = "waiting"
"""State of a cell that is not finished."""

_SEARCH = ("objective", "fitness", "optimum", "proven", "refinement_evaluations", "generations")
_AUTO = ("verdict", "why", "chosen", "predicted", "predicted_low", "predicted_high", "predicted_m",
         "independent_m", "pixel", "excluded", "blunders", "without_height")
_BOTH = ("control", "n_control", "check", "n_check", "independent", "n_independent", "n_terms",
         "n_features", "evaluations")
_LAST = ("place", "doubt", "notes", "cell", "seconds", "cpu_seconds")

_OF_IMAGES = ("data", "verdict", "why", "predicted", "predicted_low", "predicted_high",
              "predicted_m", "independent", "n_independent", "independent_m", "blunders", "chosen",
              "n_control", "state", "reason")
"""First columns of a table of images."""

_IN_SIX_DIGITS = ("predicted", "predicted_low", "predicted_high", "predicted_m", "independent_m",
                  "pixel", "control", "check", "independent", "seconds", "cpu_seconds")
"""Columns of figures that people read; a fitness, which is compared with an optimum, is whole."""

_ROUNDED_RMSE = 1e-9
"""Size [px] below which an RMSE is rounding of the computation alone."""

USUAL = 1 / 2
"""Share of the images from which on a note of theirs is said once."""

_WORST_FIRST = ("", UNFIT, DOUBTFUL, PLAUSIBLE, FIT)

TIMES = ("seconds", "cpu_seconds")
"""Columns that differ from run to run."""

Row = dict[str, Any]


def columns_of(strategies: Sequence[str], measures: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the columns of a study's table."""
    if tuple(strategies) == ("auto",):
        # Of images first what people look for; what distinguishes cells of a study comes last.
        further = [name for name in (*_AUTO, *_BOTH) if name not in _OF_IMAGES]
        return (*_OF_IMAGES, *further, *measures, "place", "doubt", "notes",
                *(name for name in LABELS if name != "data"), "cell", *TIMES)
    return (*LABELS, "state", "reason", *(_AUTO if "auto" in strategies else ()),
            *(_SEARCH if "as-asked" in strategies else ()), *_BOTH, *measures, *_LAST)


def rows_of(cells: Mapping[str, Mapping[str, Any]], records: Mapping[str, CellRecord],
            strategies: Sequence[str], measures: Sequence[str] = (),
            accept: Accept | None = None) -> list[Row]:
    """Return the rows of a study's table, one for each cell, in the order of the cells.

    Where "auto" is the only strategy, the rows are images and the worst comes first. Images have
    verdicts, which depend on `accept` where the user gives the largest RMSE that is accepted. All
    rows have the same columns, with None for what a row has not; a cell without a record is
    waiting.
    """
    columns = columns_of(strategies, measures)
    doubts = batch_of_records(cells, records).doubts
    rows = []
    for key, labels in cells.items():
        record = records.get(key)
        if record is None:
            row = {**labels, "cell": key, "state": WAITING, "reason": ""}
        else:
            row = _row_of_record(key, labels, record, doubts.get(str(labels["data"]), ()))
        rows.append({name: row.get(name) for name in columns})
    if "verdict" in columns:
        for row, (verdict, why) in zip(rows, verdicts_of(rows, accept), strict=True):
            row |= {"verdict": verdict, "why": why}
    return sorted(rows, key=_sort_key_of_badness) if tuple(strategies) == ("auto",) else rows


def _row_of_record(key: str, labels: Mapping[str, Any], record: CellRecord,
                   doubts: Iterable[str]) -> Row:
    """Return the row of a finished cell; `doubts` are those that other images raise about it."""
    figures = record.figures
    position = figures.get("place")
    return {**labels, **figures, **figures.get("measures", {}), "cell": key,
            "state": record.state, "reason": record.reason,
            "place": position_in_words(position) if position else "",
            "doubt": " ".join([*_as_sentence(figures.get("doubt")), *doubts])}


def batch_of_records(cells: Mapping[str, Mapping[str, Any]],
                     records: Mapping[str, CellRecord]) -> Batch:
    """Return the sentences and doubts that images of finished cells raise about each other."""
    return batch_of({str(labels["data"]): records[key].figures for key, labels in cells.items()
                     if key in records})


def _as_sentence(doubt: str | None) -> list[str]:
    """Return a doubt as a sentence in a list; [] without one."""
    return [f"{doubt[0].upper()}{doubt[1:]}."] if doubt else []


def _sort_key_of_badness(row: Row) -> tuple[int, int, float]:
    """Return a sort key for images, worst first: verdict, those without figures, then RMSE."""
    # The predicted RMSE is of every image; the measured one of few.
    figure = row["predicted"] if row["predicted"] is not None else row["independent"]
    # Cells that are not finished have no verdict yet, and come first.
    verdict = _WORST_FIRST.index(row["verdict"] or "")
    return (verdict, 0, 0.0) if figure is None else (verdict, 1, -figure)


def usual_notes(rows: Iterable[Row]) -> dict[str, int]:
    """Return the notes that most images have, with the number of these."""
    images = [row for row in rows if row["strategy"] == "auto"]
    count = Counter(chain.from_iterable(row["notes"] or () for row in images))
    return {note: number for note, number in count.items()
            if number > 1 and number > USUAL * len(images)}


def usual_notes_in_words(rows: Iterable[Row]) -> list[str]:
    """Return the notes that most images have, such as "3 of 4 images: the heights are alike"."""
    images = [row for row in rows if row["strategy"] == "auto"]
    return [f"{number} of {len(images)} images: {note}"
            for note, number in usual_notes(images).items()]


def with_notes_once(rows: Sequence[Row]) -> list[Row]:
    """Return rows in which a note that most images have stands in the first of these alone."""
    usual = usual_notes(rows)
    told: set[str] = set()
    shorter = []
    for row in rows:
        # A note is kept with the first image that has it.
        notes = [note for note in row["notes"] or () if note not in told]
        told |= usual.keys() & set(notes)
        shorter.append({**row, "notes": notes or None})
    return shorter


def csv_of(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Return rows as CSV; lists have semicolons, and a value that is not known is blank."""
    lines: list[Sequence[Any]] = [columns]
    for row in rows:
        lines.append([_as_cell(_readable_figure(row[name]) if name in _IN_SIX_DIGITS else row[name])
                      for name in columns])
    return csv_table(lines)


def _readable_figure(value: Any) -> Any:
    """Return a figure to six digits, 0 for mere rounding; other values as they are."""
    if not isinstance(value, float) or not math.isfinite(value):
        return value
    return 0.0 if abs(value) < _ROUNDED_RMSE else float(f"{value:.6g}")


def _as_cell(value: Any) -> Any:
    """Return a value as a cell of CSV: "" for None and NaN, lists with semicolons."""
    # NaN of a figure that has no meaning is a blank cell, too.
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return "; ".join(map(str, value)) if isinstance(value, list) else value
