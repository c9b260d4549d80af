"""What the runs of one method on one instance come to: quartiles, success, expected time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from termsel.toolkit.searches import TIE
from termsel_studies.groups import Groups, Runs, evaluations_of_run

_NEARLY_INFINITE = 1e300
"""Stands for infinity where quantiles are interpolated, which has no meaning with infinity."""


@dataclass(frozen=True)
class Summary:
    """Figures of one method on one instance; medians where nothing else is said."""

    instance: str
    method: str
    runs: int
    # Runs with a result.
    finished: int
    # Least value, quartiles and greatest; infinite where runs had none.
    quartiles: list[float]
    # The proven optimum of the fitness; None if it is not known, or another measure is compared.
    optimum: float | None
    # How many runs reached the optimum; None without one.
    reached: int | None
    # Wilson's 95 % interval of the share of runs that reach the optimum; zeros without one.
    interval: tuple[float, float]
    # Expected evaluations until the optimum is reached (`expected_running_time`).
    expected: float | None
    # RMSE at independent check points [px].
    independent: float | None
    evaluations: float | None
    cpu_seconds: float | None


def summarise_runs(groups: Groups) -> list[Summary]:
    """Return the figures of every method on every instance."""
    figures = []
    for instance, by_method in groups.instances.items():
        optimum = optimum_of(by_method.values(), groups.measure)
        figures += [_summarise_method(
            instance, method, runs, optimum) for method, runs in by_method.items()]
    return figures


def optimum_of(runs: Any, measure: str) -> float | None:
    """Return the proven optimum of an instance by the rows of its `Runs`, one for each method.

    None if no row has it, or if `measure` is another than "fitness".
    """
    rows = chain.from_iterable(run.rows for run in runs)
    optima = [row["optimum"] for row in rows if row.get("optimum") is not None]
    return min(optima) if optima and measure == "fitness" else None


def _summarise_method(instance: str, method: str, runs: Runs, optimum: float | None) -> Summary:
    """Return the summary of one method's runs on one instance.

    Without a proven optimum, `reached` and `expected` are None, and `interval` is (0, 0).
    """
    reached = None
    expected = None
    interval = (0.0, 0.0)
    if optimum is not None:
        # Runs that do not reach the target count with all their evaluations, and infinite times.
        target = reachable_value(optimum)
        reached = sum(value <= target for value in runs.values)
        interval = wilson_interval(reached, len(runs.values))
        times_to_target = [effort_to_target(record.trace, target) if value <= target else math.inf
                           for record, value in zip(runs.records, runs.values, strict=True)]
        expected = expected_running_time(times_to_target,
                                         [evaluations_of_run(record.figures)
                                          for record in runs.records])
    return Summary(
        instance=instance, method=method, runs=len(runs.values),
        finished=sum(row["state"] == "done" for row in runs.rows),
        quartiles=quantiles_with_infinity(runs.values, (0, 0.25, 0.5, 0.75, 1)), optimum=optimum,
        reached=reached, interval=interval, expected=expected,
        independent=_median_of(runs.rows, "independent"),
        evaluations=_median_of(runs.rows, "evaluations"),
        cpu_seconds=_median_of(runs.rows, "cpu_seconds"))


def reachable_value(optimum: float) -> float:
    """Return the largest value at which an optimum counts as reached.

    It is a little above the optimum: solvers add up in different orders, so their rounding differs.
    """
    return optimum + TIE * abs(optimum)


def _median_of(rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    """Return the median of a figure of rows; None if no row has it."""
    values = [row[name] for row in rows if row.get(name) is not None]
    return float(np.median(values)) if values else None


def quantiles_with_infinity(values: Sequence[float], shares: Sequence[float]) -> list[float]:
    """Return the quantiles at shares (0 to 1) of values, some of which may be infinite.

    A quantile between a finite value and infinity is infinite.
    """
    finite = np.minimum(np.asarray(values, dtype=float), _NEARLY_INFINITE)
    # The factor covers quantiles interpolated from a little of _NEARLY_INFINITE.
    return [math.inf if value > _NEARLY_INFINITE * 1e-6 else float(value)
            for value in np.quantile(finite, shares)]


def wilson_interval(successes: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Return the lower and upper end of the confidence interval of a share of successes, 0 to 1."""
    from scipy.stats import binomtest

    # Wilson 1927, J. Am. Stat. Assoc. 22(158).
    interval = binomtest(successes, runs).proportion_ci(level, method="wilson")
    return float(interval.low), float(interval.high)


def effort_to_target(trace: Sequence[Sequence[float]], target: float, column: int = 0) -> float:
    """Return the evaluations (column 0) or CPU seconds (2) until a run reached a target.

    `trace` has rows of evaluations, best value and CPU seconds. Infinite if the run did not reach
    the target.
    """
    return next((float(point[column]) for point in trace if point[1] <= target), math.inf)


def expected_running_time(times_to_target: Sequence[float], lengths: Sequence[float]) -> float:
    """Return how long it takes to reach a target if runs that miss it are started again.

    `times_to_target` has the time at which each run reached the target, or infinity; `lengths` its
    whole time. Both are evaluations, or both are seconds, and so is the result. Infinite if no run
    reached the target.
    """
    # The time spent in all runs by the number of runs that reached the target: Hansen, Auger, Finck
    # and Ros 2009, Real-parameter black-box optimization benchmarking: experimental setup.
    successes = sum(map(math.isfinite, times_to_target))
    total = sum(at if math.isfinite(at) else run_length
                for at, run_length in zip(times_to_target, lengths, strict=True))
    return total / successes if successes else math.inf


def success_curve(times_to_target: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return the finite times of `times_to_target`, sorted, and the share of runs done by each.

    Of equal times, one is returned, with the share of all of them.
    """
    steps = {moment: (i + 1) / len(times_to_target)
             for i, moment in enumerate(sorted(filter(math.isfinite, times_to_target)))}
    return list(steps), list(steps.values())


def targets_of(optimum: float | None, runs: Iterable[Runs], number: int = 21) -> list[float]:
    """Return targets for an ECDF of run times, the easiest first.

    They are `number` values from 100 % to 0.01 % above the optimum, evenly in the logarithm.
    Without an optimum the best value of all runs takes its place; [] if no run has a value.
    """
    # Run times over many targets follow Hansen, Auger, Ros, Mersmann, Tušar and Brockhoff 2021,
    # COCO, Optim. Methods Softw. 36(1), section 5; these targets are termsel's own.
    values = [value for value in chain.from_iterable(run.values for run in runs)
              if math.isfinite(value)]
    if optimum is None and not values:
        return []
    best = min(values) if optimum is None else optimum
    return [best + float(gap) * abs(best) for gap in np.logspace(0, -4, number)]


def _best_within(trace: Sequence[Sequence[float]], budget: float) -> float:
    """Return the best value of a run within a budget [evaluations]; infinite if it had none yet."""
    return min((point[1] for point in trace if point[0] <= budget), default=math.inf)


def quartiles_by_budget(traces: Sequence[Sequence[Sequence[float]]], budgets: Sequence[float]
                        ) -> list[tuple[float, float, float, float]]:
    """Return rows of a budget [evaluations] and three quartiles of the runs' best values within it.
    """
    rows = []
    for budget in budgets:
        values = [_best_within(trace, budget) for trace in traces]
        lower, median, upper = quantiles_with_infinity(values, (0.25, 0.5, 0.75))
        rows.append((float(budget), lower, median, upper))
    return rows
