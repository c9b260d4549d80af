"""What to do after a study of searches: the command of its best method, with a folder."""

from __future__ import annotations

from collections.abc import Iterator
from shlex import join
from typing import Any

from termsel import Study
from termsel.toolkit.studies import Row
from termsel_studies.groups import Groups, group
from termsel_studies.significance import compare_methods, medians_of
from termsel_studies.summaries import quantiles_with_infinity

BEST = "best"
"""Folder of the result that the command writes."""
_LIMITS = ("evaluations", "generations", "patience", "seconds")
"""Budgets of a study that `termsel run` has, too."""


def next_command(study: Study) -> str:
    """Return "Next: " and the command that repeats the best run of the best method, with a folder.

    A study keeps figures alone: the result of a run, with its model, needs a run of its own. The
    method is that of the lowest mean rank, or of the lowest median on the first instance where
    too few were run for ranks. Returns "" where the command cannot be typed, as for data and parts
    from Python, or where no run has a result.
    """
    if study.spec.strategies != ("as-asked",):
        return ""
    groups = group(study.rows, study.records, study.spec.measure)
    found = _best_run(groups)
    words = [] if found is None else list(_words_of_run(study, found[1]))
    if found is None or not all(words):
        return ""
    return f"Next: {join(['termsel', 'run', *words, '--out', BEST])}   ({found[0]}, its best run)"


def _best_run(groups: Groups) -> tuple[str, Row] | None:
    """Return the best method and its best run on the first instance that has all methods."""
    if not groups.common:
        return None
    by_method = groups.instances[groups.common[0]]
    comparison = compare_methods(groups.methods, medians_of(groups))
    if comparison is not None:
        figures = dict(zip(comparison.methods, comparison.ranks, strict=True))
    else:
        figures = {name: quantiles_with_infinity(runs.values, (0.5,))[0]
                   for name, runs in by_method.items()}
    best = min(figures, key=lambda name: figures[name])
    runs = by_method[best]
    value, row = min(zip(runs.values, runs.rows, strict=True), key=lambda pair: pair[0])
    return (best, row) if value < float("inf") else None


def _words_of_run(study: Study, row: Row) -> Iterator[str]:
    """Yield the arguments of `termsel run` for a row; "" for what no argument can say."""
    spec = study.spec
    parts = {"problem": spec.problems, "model": spec.models, "criterion": spec.criteria,
             "solver": spec.solvers}
    options: dict[str, Any] = {}
    for kind, named in parts.items():
        part = next((part for part in named if part.label == row[kind]), None)
        # Parts that the study does not name follow from the problem, and that from the files.
        if part is not None:
            yield from (f"--{kind}", "" if part.thing is not None else part.name)
            options |= part.options
    yield from _words_of_data(study, str(row["data"]))
    options |= spec.options
    if row["split"]:
        options["split"] = row["split"]
    for name, value in options.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        yield from ("--set", f"{name}={text}")
    yield from ("--seed", str(row["seed"]))
    # exact decides on many subsets in one step, so `termsel run` bounds it by time alone.
    limits = ("seconds",) if str(row["solver"]).partition(",")[0] == "exact" else _LIMITS
    for name in limits:
        if name in spec.budget:
            yield from (f"--{name}", f"{spec.budget[name]:.12g}")


def _words_of_data(study: Study, label: str) -> Iterator[str]:
    """Yield the arguments for data by their label; "" for data that came from Python, and lines.

    Without data, each problem has a data set of its own.
    """
    if not study.spec.data:
        return
    named = [source for source in study.spec.data if source.dataset == label]
    if named:
        yield from ("--dataset", label)
        return
    of_points = [source for source in study.spec.data if set(source.files) == {"points"}]
    if len(study.spec.data) != 1 or not of_points or "#" in label or " + " in label:
        yield ""
        return
    yield from ("--points", label)
    for name, value in of_points[0].reading.items():
        yield from (f"--{name}", str(value) if name in ("crs", "dem", "columns") else "")
