"""Which cells of a study are compared with which: methods on instances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from termsel.toolkit.studies import WAITING, CellRecord, Row

METHOD = ("strategy", "model", "criterion", "solver")
INSTANCE = ("problem", "data", "split")


@dataclass(frozen=True)
class Runs:
    """The runs of one method on one instance."""

    rows: list[Row] = field(default_factory=list)
    # What they are compared by, lower is better; infinite without a result
    values: list[float] = field(default_factory=list)
    records: list[CellRecord] = field(default_factory=list)


@dataclass(frozen=True)
class Groups:
    """All runs by label of the instance, then by label of the method."""

    # "fitness", "check" or "independent".
    measure: str
    instances: Mapping[str, Mapping[str, Runs]]
    methods: tuple[str, ...]

    @property
    def common(self) -> list[str]:
        """Instances that every method was run on."""
        return [name for name, by_method in self.instances.items()
                if set(by_method) == set(self.methods)]

    def records(self) -> Iterator[CellRecord]:
        """Yield the records of all runs."""
        for by_method in self.instances.values():
            for runs in by_method.values():
                yield from runs.records

    @property
    def objectives(self) -> list[str]:
        """Names of the objectives that the searches minimised, sorted; [] if none is recorded."""
        names = set()
        for by_method in self.instances.values():
            for runs in by_method.values():
                names |= {row["objective"] for row in runs.rows if row.get("objective")}
        return sorted(names)


def group(rows: Sequence[Row], records: Mapping[str, CellRecord],
          measure: str | None = None) -> Groups:
    """Return the finished runs of a study by instance and method, for comparison by a measure.

    By default the measure is the fitness where only solvers differ, else the RMSE at independent
    check points. A run without a result counts as infinite.
    """
    rows = [row for row in rows if row["state"] != WAITING]
    measure = measure or _measure(rows)
    # By fitness, solvers are compared on the same problem, data, model and criterion. By an RMSE,
    # methods are: model, criterion and solver together, without what no instance varies, as the
    # model where each problem has its own.
    method: tuple[str, ...] = ("solver",) if measure == "fitness" else METHOD
    instance = (*INSTANCE, *(("model", "criterion") if measure == "fitness" else ()))
    of_method = _varying_labels(rows, method, INSTANCE)
    of_instance: list[str] = []
    # Without what others show already, as the model that a problem has.
    for label in instance:
        if label in _varying_labels(rows, instance, of_instance):
            of_instance.append(label)
    instances: dict[str, dict[str, Runs]] = {}
    for row in rows:
        name = ", ".join(_group_in_words(row, label) for label in of_instance)
        runs = instances.setdefault(name, {}).setdefault(
            ", ".join(_group_in_words(row, label) for label in of_method), Runs())
        # Lower is better in all measures, and no result is the worst of all.
        value = row.get(measure)
        runs.rows.append(row)
        runs.values.append(math.inf if value is None else value)
        runs.records.append(records[row["cell"]])
    methods = dict.fromkeys(chain.from_iterable(instances.values()))
    return Groups(measure, instances, tuple(methods))


def evaluations_of_run(figures: Mapping[str, Any]) -> float:
    """Return the evaluations of a run by its figures, those of the local refinement included."""
    return float(figures.get("evaluations") or 0)


def _measure(rows: Sequence[Row]) -> str:
    """Return the measure by which rows are compared if none is given: fitness or independent."""
    # Methods that differ in the solver alone minimise the same fitness, whatever model and
    # criterion each problem has.
    only_solvers = _varying_labels(rows, METHOD, INSTANCE) == ["solver"]
    if only_solvers and all(row["strategy"] == "as-asked" for row in rows):
        return "fitness"
    return "independent"


def _varying_labels(rows: Sequence[Row], labels: Sequence[str],
                    given_labels: Sequence[str] = ()) -> list[str]:
    """Return the labels that distinguish rows, of those rows that are alike in other labels.

    The first or last one where none does.
    """
    # A label varies where it splits rows that are alike in the other ones.
    groups_of_rows = {_label_values(row, given_labels) for row in rows}
    varying = []
    for label in labels:
        if len({_label_values(row, (*given_labels, label)) for row in rows}) > len(groups_of_rows):
            varying.append(label)
    return varying or [labels[-1] if labels[-1] == "solver" else labels[0]]


def _label_values(row: Row, labels: Sequence[str]) -> tuple[Any, ...]:
    """Return the labels of a row as a tuple, by which rows are grouped."""
    return tuple(row[label] for label in labels)


def _group_in_words(row: Row, label: str) -> str:
    """Return the label of a row as a title: the number of a split says what it is."""
    return f"split {row[label]}" if label == "split" else str(row[label])
