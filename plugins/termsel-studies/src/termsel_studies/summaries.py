"""What the runs of one method on one instance come to: quartiles, success, expected time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.toolkit import TIE
from termsel_studies.groups import Groups, Runs, length

_HUGE = 1e300
"""Stands for infinity where quantiles are interpolated."""


@dataclass(frozen=True)
class Summary:
    """Figures of one method on one instance; medians where nothing else is said."""

    instance: str
    method: str
    runs: int
    finished: int  # runs with a result
    quartiles: list[float]  # least value, quartiles and greatest; infinite where runs had none
    optimum: float | None  # proven, where it is known and the measure is the fitness
    reached: int | None  # runs that reached it
    interval: tuple[float, float]  # Wilson's 95 % of the share that reach it; zeros if unknown
    expected: float | None  # evaluations until then (`expected_running_time`)
    independent: float | None  # RMSE [px]
    evaluations: float | None
    cpu_seconds: float | None


def summaries(groups: Groups) -> list[Summary]:
    """Return the figures of every method on every instance."""
    return [_summary(instance, method, runs, optimum_of(by_method.values(), groups.measure))
            for instance, by_method in groups.instances.items()
            for method, runs in by_method.items()]


def optimum_of(runs: Any, measure: str) -> float | None:
    """Return the proven optimum of an instance, if one of its runs knows it."""
    known = [row["optimum"] for run in runs for row in run.rows if row.get("optimum") is not None]
    return min(known) if known and measure == "fitness" else None


def _summary(instance: str, method: str, runs: Runs, optimum: float | None) -> Summary:
    reached = None
    expected = None
    interval = (0.0, 0.0)
    if optimum is not None:
        target = reachable(optimum)
        reached = sum(value <= target for value in runs.values)
        interval = wilson(reached, len(runs.values))
        hits = [hit(one.trace, target) if value <= target else math.inf
                for one, value in zip(runs.records, runs.values, strict=True)]
        expected = expected_running_time(hits, [length(record.figures) for record in runs.records])
    return Summary(
        instance, method, len(runs.values), sum(row["state"] == "done" for row in runs.rows),
        quantiles(runs.values, (0, 0.25, 0.5, 0.75, 1)), optimum, reached, interval, expected,
        *(_median(runs.rows, name) for name in ("independent", "evaluations", "cpu_seconds")))


def reachable(optimum: float) -> float:
    """Return the value from which on down an optimum counts as reached: rounding differs."""
    return optimum + TIE * abs(optimum)


def _median(rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    known = [row[name] for row in rows if row.get(name) is not None]
    return float(np.median(known)) if known else None


def quantiles(values: Sequence[float], shares: Sequence[float]) -> list[float]:
    """Return quantiles of values among which some may be infinite."""
    finite = np.minimum(np.asarray(values, dtype=float), _HUGE)
    return [math.inf if value > _HUGE * 1e-6 else float(value)
            for value in np.quantile(finite, shares)]


def wilson(successes: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Return the interval of a share of successes, without correction for continuity."""
    from scipy.stats import binomtest

    # Wilson 1927, J. Am. Stat. Assoc. 22(158).
    found = binomtest(successes, runs).proportion_ci(level, method="wilson")
    return float(found.low), float(found.high)


def hit(trace: Sequence[Sequence[float]], target: float, column: int = 0) -> float:
    """Return evaluations (column 0) or CPU seconds (2) until a target is reached, or infinity."""
    return next((float(point[column]) for point in trace if point[1] <= target), math.inf)


def expected_running_time(hits: Sequence[float], lengths: Sequence[float]) -> float:
    """Return how long it takes to reach a target, with restarts of runs that do not.

    `hits` and `lengths` are the times up to the target, or infinity, and up to the end of each run.
    """
    # The time spent in all runs, per run that reached it: Hansen, Auger, Finck and Ros 2009,
    # Real-parameter black-box optimization benchmarking: experimental setup.
    successes = sum(map(math.isfinite, hits))
    spent = sum(at if math.isfinite(at) else whole
                for at, whole in zip(hits, lengths, strict=True))
    return spent / successes if successes else math.inf


def ecdf(hits: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return budgets, and which share of the moments, as of `hit`, is reached within each."""
    steps = {moment: (i + 1) / len(hits)
             for i, moment in enumerate(sorted(filter(math.isfinite, hits)))}
    return list(steps), list(steps.values())


def targets_of(optimum: float | None, runs: Iterable[Runs], number: int = 21) -> list[float]:
    """Return targets for an ECDF: above the optimum by 100 % to 0.01 %, evenly in the logarithm."""
    # Runtimes over many targets are of Hansen, Auger, Ros, Mersmann, Tušar and Brockhoff 2021,
    # COCO, Optim. Methods Softw. 36(1), section 5; these targets are termsel's own. Where the
    # optimum is not known, the best value of all runs stands for it.
    found = [value for run in runs for value in run.values if math.isfinite(value)]
    if optimum is None and not found:
        return []
    least = min(found) if optimum is None else optimum
    return [least + float(gap) * abs(least) for gap in np.logspace(0, -4, number)]


def bands(traces: Sequence[Sequence[Sequence[float]]], budgets: Sequence[float]
          ) -> list[tuple[float, float, float, float]]:
    """Return budgets [evaluations] with the quartiles of the best value of the runs within each."""
    rows = []
    for budget in budgets:
        values = [min((point[1] for point in trace if point[0] <= budget), default=math.inf)
                  for trace in traces]
        lower, median, upper = quantiles(values, (0.25, 0.5, 0.75))
        rows.append((float(budget), lower, median, upper))
    return rows
