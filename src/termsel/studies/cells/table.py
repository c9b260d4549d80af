"""The tidy table of a study: one row a cell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from termsel.core.files.texts import csv_table
from termsel.data.coordinates.earth import in_words
from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.neighbours import Batch, batch_of

LABELS = ("problem", "data", "split", "strategy", "model", "criterion", "solver", "seed")
"""What tells the cells of a study apart, in the order in which they vary."""

WAITING = "waiting"
"""State of a cell that is not finished."""

_SEARCH = ("objective", "fitness", "optimum", "proven", "refinement_evaluations", "generations")
_AUTO = ("chosen", "predicted", "predicted_low", "predicted_high", "excluded", "blunders")
_BOTH = ("control", "n_control", "check", "n_check", "independent", "n_independent", "n_terms",
         "n_features", "evaluations")
_LAST = ("place", "doubt", "notes", "cell", "seconds", "cpu_seconds")

TIMES = ("seconds", "cpu_seconds")
"""Columns that differ from run to run."""

Row = dict[str, Any]


def columns_of(strategies: Sequence[str], measures: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the columns of a study's table."""
    return (*LABELS, "state", "reason", *(_AUTO if "auto" in strategies else ()),
            *(_SEARCH if "as-asked" in strategies else ()), *_BOTH, *measures, *_LAST)


def rows_of(cells: Mapping[str, Mapping[str, Any]], records: Mapping[str, CellRecord],
            strategies: Sequence[str], measures: Sequence[str] = ()) -> list[Row]:
    """Return one row a cell, waiting without a record, in order; of auto alone worst first."""
    # One set of columns for all rows; what a row has not is None.
    columns = columns_of(strategies, measures)
    doubts = batch_of_records(cells, records).doubts
    rows = []
    for key, labels in cells.items():
        record = records.get(key)
        values = {**labels, "cell": key, "state": WAITING, "reason": ""} if record is None else {
            **labels, **record.figures, **record.figures.get("measures", {}), "cell": key,
            "state": record.state, "reason": record.reason,
            "place": in_words(position) if (position := record.figures.get("place")) else "",
            "doubt": " ".join([*_sentence(record.figures.get("doubt")),
                               *doubts.get(str(labels["data"]), ())])}
        rows.append({name: values.get(name) for name in columns})
    return sorted(rows, key=_badness) if tuple(strategies) == ("auto",) else rows


def batch_of_records(cells: Mapping[str, Mapping[str, Any]],
                     records: Mapping[str, CellRecord]) -> Batch:
    """Return what the images of finished cells say of each other."""
    return batch_of({str(labels["data"]): records[key].figures for key, labels in cells.items()
                     if key in records})


def _sentence(doubt: str | None) -> list[str]:
    return [f"{doubt[0].upper()}{doubt[1:]}."] if doubt else []


def _badness(row: Row) -> tuple[int, float]:
    """Return what sorts images worst first: those that failed, then by predicted RMSE."""
    figure = row["predicted"] if row["predicted"] is not None else row["independent"]
    return (0, 0.0) if figure is None else (1, -figure)


def csv_of(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Return rows as CSV; lists have semicolons, and what is not known is blank."""
    lines: list[Sequence[Any]] = [columns]
    for row in rows:
        lines.append([_cell(row[name]) for name in columns])
    return csv_table(lines)


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return "; ".join(map(str, value)) if isinstance(value, list) else value
