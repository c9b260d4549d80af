"""A scene with 1,000 new points as independent ones, and intervals of what they say.

The new points are further ones of the same sensor and terrain, measured as the others are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import spearmanr

import termsel
from benchmarks.sets import rmse_of
from termsel.data.features import FloatArray
from termsel.simulate import simulate_scene

NAME, NEW = "ikonos-hamedan", 1000


def scene(seed: int | None = None, roles: tuple[int, int, int] | None = None,
          new_points: int = NEW) -> termsel.FeatureSet:
    """Return the embedded scene, or that of a seed, with new points as independent ones.

    `roles` are numbers of control, selection and independent check points other than those
    of the scene.
    """
    features = simulate_scene(NAME, seed=seed, roles=roles)
    new = simulate_scene(NAME, seed=9000 + (seed or 0), roles=(0, 0, new_points), n_lines=0)
    kept = features.points.take([role != "independent" for role in features.points.roles])
    ids = tuple(f"N{i + 1}" for i in range(new_points))
    return replace(features, points=termsel.Points(
        kept.ids + ids, np.concatenate([kept.image, new.points.image]),
        np.concatenate([kept.ground, new.points.ground]), None,
        kept.roles + new.points.roles))


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
