"""Simulated maps of kinds that `termsel_cameras.simulate_map` does not draw.

What separates them from a similarity of the ground comes from other mechanisms: rough or smooth
errors of drawing, folds, sheets that were joined, uneven transport in a scanner, a photo of the
map. No constant of the program was fitted to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from termsel.data.features import FloatArray, Points

SIZE = np.array([5000.0, 7000.0])
GSD, ORIGIN, WAVES = 0.5, (4e5, 5e6), 400


def drawn_by_hand(rng: Generator, at: FloatArray, size: float, length: float,
                  smoothness: float) -> FloatArray:
    """Return a random field with Matern covariance, by waves from its spectrum, (n, 2) [px]."""
    shift = np.empty(at.shape)
    for axis in (0, 1):
        stretched = np.sqrt(2 * smoothness / rng.chisquare(2 * smoothness, (WAVES, 1)))
        waves = stretched * rng.standard_normal((WAVES, 2)) / (length * SIZE.max())
        phases = rng.uniform(0, 2 * np.pi, WAVES)
        shift[:, axis] = np.sqrt(2 / WAVES) * np.cos(at @ waves.T + phases).sum(axis=1)
    return size * shift


def folded(rng: Generator, at: FloatArray, size: float, folds: tuple[int, int]) -> FloatArray:
    """Return shifts that are bilinear between folds, where they bend, (n, 2) [px]."""
    corners = size * rng.standard_normal((folds[0] + 1, folds[1] + 1, 2))
    part = at / SIZE * folds
    i, j = np.minimum(part.astype(int), np.array(folds) - 1).T
    u, v = (part - np.stack([i, j], axis=1)).T[..., None]
    return np.asarray((1 - u) * ((1 - v) * corners[i, j] + v * corners[i, j + 1])
                      + u * ((1 - v) * corners[i + 1, j] + v * corners[i + 1, j + 1]))


def joined(rng: Generator, at: FloatArray, size: float, sheets: tuple[int, int]) -> FloatArray:
    """Return shifts of sheets, each with an affine error of its own, (n, 2) [px]."""
    i, j = np.minimum((at / SIZE * sheets).astype(int), np.array(sheets) - 1).T
    extent = SIZE / sheets
    place = (at - (np.stack([i, j], axis=1) + 0.5) * extent) / extent.max() * 2
    bent = size * rng.standard_normal((*sheets, 2, 2))
    shift = size * rng.standard_normal((*sheets, 2))
    return np.asarray(shift[i, j] + np.einsum("nij,nj->ni", bent[i, j], place))


def transported(rng: Generator, at: FloatArray, size: float) -> FloatArray:
    """Return shifts by a scanner that moves the paper unevenly, (n, 2) [px]."""
    steps, where = size * np.cumsum(rng.standard_normal((400, 2)), axis=0) / 20, at[:, 0] / SIZE[0]
    line, sample = (np.interp(where, np.linspace(0, 1, 400), one) for one in steps.T)
    return np.stack([line, 0.3 * sample], axis=1)


def photographed(rng: Generator, at: FloatArray) -> FloatArray:
    """Return shifts by a tilted camera whose lens distorts, (n, 2) [px]."""
    u = at / SIZE * 2 - 1
    bent = 1 + rng.normal(0, 0.006) * (u**2).sum(axis=1, keepdims=True)
    return np.asarray(2500 * u * (bent / (1 + u @ rng.normal(0, 0.03, (2, 1))) - 1))


KINDS: dict[str, tuple[float, Callable[[Generator, FloatArray], FloatArray]]] = {
    "hand-drawn": (2.0, lambda rng, at: drawn_by_hand(rng, at, 18.0, 0.3, 0.5)),
    "sketch": (4.0, lambda rng, at: drawn_by_hand(rng, at, 60.0, 0.35, 4.0)),
    "mild": (1.5, lambda rng, at: drawn_by_hand(rng, at, 3.0, 0.5, 1.5)),
    "folded": (1.0, lambda rng, at: folded(rng, at, 8.0, (3, 4))),
    "atlas": (1.5, lambda rng, at: joined(rng, at, 7.0, (3, 3))),
    "two sheets": (1.0, lambda rng, at: joined(rng, at, 12.0, (1, 2))),
    "strip": (1.0, lambda rng, at: transported(rng, at, 6.0)),
    "photo of a map": (1.0, photographed),
    "good map": (1.0, lambda _, at: np.zeros_like(at))}
"""Noise of drafting and measuring [px], and what draws the shifts of places."""


def unlike_map(kind: str, count: int, seed: int, measured: int | None = None) -> Points:
    """Return points of a scan of 5000 x 7000 px, without heights.

    With `measured` only the first so many have noise; the others are where the map shows them.
    """
    rng = np.random.default_rng([list(KINDS).index(kind), count, seed])
    noise, shifts = KINDS[kind]
    at = rng.uniform(0.02, 0.98, (count, 2)) * SIZE
    turn = rng.uniform(-0.1, 0.1)
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) \
        * (1 + rng.normal(0, 0.01, 2))
    image = at @ turned + shifts(rng, at)
    image[:measured] += noise * rng.standard_normal(at.shape)[:measured]
    ground = np.column_stack([ORIGIN[0] + GSD * at[:, 1], ORIGIN[1] - GSD * at[:, 0],
                              np.full(count, np.nan)])
    return Points(tuple(map(str, range(count))), image, ground)
