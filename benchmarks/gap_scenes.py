"""More scenes of the full RFM, searched: does a better search give a better result?

Part of benchmarks.gap. Each scene has 24 control and 24 check points, and 1,000 further places of
the same sensor and terrain, measured as well, as independent points.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from scipy.stats import t as student

import termsel
from benchmarks.sets import rmse_of
from termsel.measurements.features import FloatArray, no_lines
from termsel.simulate import simulate_scene

NAME, NEW = "ikonos-hamedan", 1000
THIRD = range(201, 213)
"""Seeds of the scenes of third order; none is that of the embedded scene."""
METHODS: tuple[tuple[str, bool, int, int], ...] = (
    ("ga", False, 16_040, 8), ("ga", True, 16_040, 8), ("pso", False, 16_040, 8),
    ("swap", False, 16_040, 4), ("ga", True, 160_400, 4), ("swap", False, 160_400, 4))
"""Solver, whether it is refined, evaluations, and seeds."""
NEAR = 1.3


def scene(seed: int | None = None) -> termsel.FeatureSet:
    """Return the embedded scene, or that of a seed, with so many new points as independent ones."""
    features = simulate_scene(NAME) if seed is None else simulate_scene(NAME, seed=seed)
    new = simulate_scene(NAME, seed=9000 + (seed or 0), roles=(0, 0, NEW), n_lines=0)
    kept = features.points.take([role != "independent" for role in features.points.roles])
    ids = tuple(f"N{i + 1}" for i in range(NEW))
    return replace(features, points=termsel.Points(
        kept.ids + ids, np.concatenate([kept.image, new.points.image]),
        np.concatenate([kept.ground, new.points.ground]), None,
        kept.roles + new.points.roles))


def searched(file: Path) -> list[dict[str, Any]]:
    """Return the runs on all scenes, those that a file has from there."""
    known: dict[str, dict[str, Any]] = {}
    if file.is_file():
        known = {one["key"]: one for one in map(json.loads, file.read_text().splitlines())}
    runs = []
    for seed in THIRD:
        features = scene(seed)
        quadratic = None
        for solver, refined, evaluations, seeds in METHODS:
            for run in range(seeds):
                key = f"{seed} {solver} {refined} {evaluations} {run}"
                if key not in known:
                    quadratic = quadratic or rmse_of(_quadratic(features))
                    known[key] = {"key": key, "seed": seed, "quadratic": quadratic,
                                  **_run(features, solver, refined, evaluations, run)}
                    with file.open("a", encoding="utf-8") as kept:
                        kept.write(json.dumps(known[key]) + "\n")
                runs.append(known[key])
    return runs


def _run(features: termsel.FeatureSet, solver: str, refined: bool, evaluations: int,
         seed: int) -> dict[str, float]:
    options = {"polish": refined} if solver != "swap" else {}
    result = termsel.run("rfm-terms", features=features, solver=solver, seed=seed,
                         evaluations=evaluations, options=options)
    check, independent = result.rmse["check"], result.rmse["independent"]
    assert check is not None
    assert independent is not None
    return {"check": check.total, "independent": independent.total}


def _quadratic(features: termsel.FeatureSet) -> FloatArray:
    """Return errors of a quadratic polynomial by control and check points, shape (n, 2)."""
    points = features.points
    roles = tuple("control" if role == "check" else role for role in points.roles)
    fitted = termsel.fit(replace(features, points=replace(points, roles=roles), lines=no_lines()),
                         "quadratic")
    return np.asarray(fitted.errors(points.take([role == "independent" for role in roles])))


def of_scenes(runs: Iterable[dict[str, Any]]) -> tuple[float, float, float]:
    """Return the mean rank correlation of check and new points within a scene, and its interval.

    Student's, over the scenes.
    """
    by_scene: dict[int, list[dict[str, Any]]] = {}
    for one in runs:
        by_scene.setdefault(one["seed"], []).append(one)
    values = []
    for some in by_scene.values():
        least = min(one["check"] for one in some)
        near = [one for one in some if one["check"] < NEAR * least]
        values.append(spearmanr([one["check"] for one in near],
                                [one["independent"] for one in near]).statistic)
    return interval(np.array(values))


def interval(values: FloatArray) -> tuple[float, float, float]:
    """Return a mean and Student's interval of 95 %."""
    half = student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean()), float(values.mean() - half), float(values.mean() + half)


def rmse_interval(errors: FloatArray) -> tuple[float, float, float]:
    """Return an RMSE and its interval of 95 %, by a bootstrap of points."""
    rng = np.random.default_rng(0)
    squares = (errors**2).sum(axis=1)
    drawn = np.sqrt(squares[rng.integers(0, len(squares), (2000, len(squares)))].mean(axis=1))
    return rmse_of(errors), *(float(one) for one in np.quantile(drawn, (0.025, 0.975)))


def correlation_interval(first: FloatArray, second: FloatArray) -> str:
    """Return Spearman's rank correlation and its interval of 95 %, after Bonett and Wright 2000."""
    rho = float(spearmanr(first, second).statistic)
    half = 1.96 * np.sqrt((1 + rho**2 / 2) / (len(first) - 3))
    low, high = np.tanh(np.arctanh(rho) + np.array([-half, half]))
    return f"{rho:.2f} ({low:.2f} to {high:.2f})"
