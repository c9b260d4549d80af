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
    # The measure of each run: lower is better, infinite for a run without a result.
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
    """Return the ended runs of a study by instance and method, for comparison by a measure.

    `measure` is "fitness", "check" or "independent", the RMSE at such points; by default "fitness"
    where methods differ in the solver alone, else "independent". Rows that wait for their run are
    left out. A run that ended without a result counts as infinite.
    """
    rows = [row for row in rows if row["state"] != WAITING]
    measure = measure or _default_measure(rows)
    # By fitness, solvers are compared on the same problem, data, model and criterion: a fitness is
    # comparable on these alone. By an RMSE, a method is strategy, model, criterion and solver
    # together. Labels that do not vary within any instance are left out of its name.
    method: tuple[str, ...] = ("solver",) if measure == "fitness" else METHOD
    instance = (*INSTANCE, *(("model", "criterion") if measure == "fitness" else ()))
    of_method = _varying_labels(rows, method, INSTANCE)
    of_instance: list[str] = []
    # A label that follows from those before it, as the model may from the problem, is left out.
    for label in instance:
        if label in _varying_labels(rows, instance, of_instance):
            of_instance.append(label)
    instances: dict[str, dict[str, Runs]] = {}
    for row in rows:
        name = ", ".join(_label_in_words(row, label) for label in of_instance)
        runs = instances.setdefault(name, {}).setdefault(
            ", ".join(_label_in_words(row, label) for label in of_method), Runs())
        # Lower is better in all measures, so that a run without a result is the worst.
        value = row.get(measure)
        runs.rows.append(row)
        runs.values.append(math.inf if value is None else value)
        runs.records.append(records[row["cell"]])
    methods = dict.fromkeys(chain.from_iterable(instances.values()))
    return Groups(measure, instances, tuple(methods))


def evaluations_of_run(figures: Mapping[str, Any]) -> float:
    """Return the evaluations of a run, with those of its local refinement; 0 if none are recorded.
    """
    return float(figures.get("evaluations") or 0)


def _default_measure(rows: Sequence[Row]) -> str:
    """Return the measure by which rows are compared if none is given.

    It is "fitness" if methods differ in the solver alone and no strategy is at work, else
    "independent".
    """
    # Methods that differ in the solver alone minimise the same fitness on each instance.
    only_solvers_differ = _varying_labels(rows, METHOD, INSTANCE) == ["solver"]
    if only_solvers_differ and all(row["strategy"] == "as-asked" for row in rows):
        return "fitness"
    return "independent"


def _varying_labels(rows: Sequence[Row], labels: Sequence[str],
                    given_labels: Sequence[str] = ()) -> list[str]:
    """Return which of the labels take several values among rows that agree in `given_labels`.

    If none does, one label is returned all the same, so that a name is not empty: "solver" if it is
    the last, else the first.
    """
    groups_of_rows = {_values_of_labels(row, given_labels) for row in rows}
    varying = []
    for label in labels:
        finer_groups = {_values_of_labels(row, (*given_labels, label)) for row in rows}
        if len(finer_groups) > len(groups_of_rows):
            varying.append(label)
    return varying or [labels[-1] if labels[-1] == "solver" else labels[0]]


def _values_of_labels(row: Row, labels: Sequence[str]) -> tuple[Any, ...]:
    """Return the values that a row has of labels, in the order of these."""
    return tuple(row[label] for label in labels)


def _label_in_words(row: Row, label: str) -> str:
    """Return the value that a row has of a label as text; for a split "split" and its number."""
    return f"split {row[label]}" if label == "split" else str(row[label])
