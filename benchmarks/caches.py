"""What the caches of values computed of data save a user: CPU time without each, by that with it.

``python -m benchmarks.caches`` runs `auto` on simulated data in one process, with all caches, then
without one after the other, and prints how often each was asked for a value, how many values it
computed, and the factor of the CPU time of the whole run without it. The last row is without all
of them. Times are the least of three runs.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import attrgetter
from typing import Any

import numpy as np

import termsel

CACHES = {
    "data.scaling": ("Scaling.features",), "data.view": ("_view_of",),
    "data.roles": ("_order_and_labels",),
    "data.coordinates.places": ("_lattice_of_points",), "data.monomials": ("_cached_monomials",),
    "models.quotient": ("guard_points",), "fitting.pinhole": ("camera_of",),
    "adjustment.bayesian.field": ("_cached_gaussian_process",),
    "adjustment.bayesian.kernels": ("_cached_spline_field",),
    "adjustment.bayesian.line_posterior": ("_cached_mean",),
    "adjustment.bayesian.physics": ("_cached_views",),
    "adjustment.bayesian.posterior": ("_cached_polynomial_posterior", "_coefficient_moments",
                                      "_scales_of", "_shared_scales"),
    "adjustment.bayesian.thin_plate": ("_cached_splines",),
    "auto.physical": ("_cached_evidence", "_cached_camera_average"),
    "selection.criteria.cross_validation": ("_groups_of_twins",)}
"""Functions that keep what they computed of data, by module."""

RUNS = 3
"""Runs of which the fastest counts."""


def cached_functions() -> dict[str, Any]:
    """Return the functions with a cache by their names."""
    functions = {}
    for module, names in CACHES.items():
        for name in names:
            functions[f"{module}.{name}"] = attrgetter(name)(
                importlib.import_module(f"termsel.{module}"))
    return functions


@contextmanager
def without(functions: Sequence[Any]) -> Iterator[None]:
    """Let every module of termsel call some functions without their cache."""
    replaced = []
    modules = [module for name, module in sys.modules.items() if name.startswith("termsel")]
    # A method is kept by its class.
    classes = {value for module in modules for value in vars(module).values()
               if isinstance(value, type)}
    for holder in [*modules, *classes]:
        for name, value in list(vars(holder).items()):
            if any(value is function for function in functions):
                replaced.append((holder, name, value))
                setattr(holder, name, value.__wrapped__)
    try:
        yield
    finally:
        for holder, name, value in replaced:
            setattr(holder, name, value)


def cpu_seconds(work: Callable[[], object], functions: Sequence[Any]) -> float:
    """Return the CPU time of the fastest of some runs [s], each with empty caches."""
    seconds = []
    for _ in range(RUNS):
        for function in functions:
            function.cache_clear()
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    return min(seconds)


def works() -> dict[str, Callable[[], object]]:
    """Return what a user does, by title."""
    from termsel_cameras import simulate_map

    points = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    lines = termsel.simulate_scene("ikonos-hamedan")
    sheet = simulate_map(seed=1)
    return {"74 points": lambda: termsel.run(features=points),
            "9 points": lambda: termsel.run(features=points.take(np.arange(len(points)) < 9)),
            "a photo": lambda: termsel.run(dataset="aerial-photo"),
            "a search by cross-validation": lambda: termsel.run(
                problem="rfm-terms", features=points, solver="ga", criterion="kfold", seed=1,
                generations=20),
            "points and lines": lambda: termsel.run(features=lines, problem="rfm-terms-lines",
                                                    solver="ga", seed=1, generations=5),
            "old map": lambda: termsel.run(features=sheet)}


def main() -> None:
    """Print a table for each work."""
    functions = cached_functions()
    for title, work in works().items():
        work()
        with_all = cpu_seconds(work, list(functions.values()))
        print(f"\n{title}: {with_all:.2f} s with all caches\n")
        print("| function | asked | computed | time without it |\n|---|---|---|---|")
        counts = {name: function.cache_info() for name, function in functions.items()}
        for name, function in functions.items():
            asked = counts[name].hits + counts[name].misses
            if counts[name].hits:
                with without([function]):
                    factor = cpu_seconds(work, list(functions.values())) / with_all
                print(f"| `{name}` | {asked} | {counts[name].misses} | {factor:.2f} |", flush=True)
        with without(list(functions.values())):
            factor = cpu_seconds(work, list(functions.values())) / with_all
        print(f"| all of them | | | {factor:.2f} |")


if __name__ == "__main__":
    main()
