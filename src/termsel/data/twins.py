"""Points that lie closer to each other than they can tell anything apart: twins.

Twins repeat one measurement. If one is control and the other independent, the second confirms
whatever was fitted to the first; if one is held out, the other predicts it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from termsel.data.features import FeatureSet, FloatArray, IntArray, Points
from termsel.data.record.chances import quantile
from termsel.data.tables.attributes import rows_at

TWIN_DISTANCE = 0.01
"""Distance of twins, by the side of the square that each point has for itself; of their heights,
by the spread of all heights."""

MAX_PAIRWISE_PLACES = 300
"""Most places that are compared each with each: a tree takes longer to import than to search."""


def twins(ground: FloatArray, typical: FloatArray | None = None) -> IntArray:
    """Return which points (n, 3) are twins, by their place on the ground alone, shape (n,).

    A number for each group, counted from 0 in the order of their first points. Points `typical` (m,
    3), by default all, have the spread that decides what is near. NaN for heights that are not
    known.
    """
    n = len(ground)
    typical = ground if typical is None else typical
    if n < 2 or len(typical) < 2:
        return np.arange(n, dtype=np.intp)
    positions = np.nan_to_num(ground)
    typical = np.nan_to_num(typical)
    # Half of the points span half of an even spread, wherever a few wild ones are.
    low, high = (quantile(typical.T, share) for share in (0.25, 0.75))
    # Distances of twins in X, Y and Z are 1 in these units.
    unit = TWIN_DISTANCE * 2 * (high - low) * np.array([len(typical) ** -0.5] * 2 + [1.0])
    rounding = np.finfo(float).eps * np.abs(positions).max(axis=0)
    pairs = _near(positions / np.maximum(unit, np.maximum(rounding, np.finfo(float).tiny)))
    if not len(pairs):
        return np.arange(n, dtype=np.intp)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Twins of twins are twins: the groups are the connected parts of the graph of near pairs.
    edges = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.intp)


def _near(positions: FloatArray) -> IntArray:
    """Return the pairs of positions (n, 3) that are at most 1 apart, shape (p, 2)."""
    if len(positions) <= MAX_PAIRWISE_PLACES:
        # Squared distances of all pairs, each pair once above the diagonal.
        square = sum((axis[:, None] - axis) ** 2 for axis in positions.T)
        return np.argwhere(np.triu(square <= 1.0, 1))
    from scipy.spatial import KDTree

    return np.asarray(KDTree(positions).query_pairs(1.0, output_type="ndarray"))


def merged(features: FeatureSet) -> FeatureSet:
    """Return features in which twins count as one point, at their mean.

    Under id, role and attributes of the first of each group; the same object without twins.
    """
    points = features.points
    labels = twins(points.ground)
    first = np.unique(labels, return_index=True)[1]  # of each group
    if len(first) == len(points):
        return features
    count = np.bincount(labels)[:, None]

    def mean(values: FloatArray) -> FloatArray:
        total = np.zeros((len(first), values.shape[1]))
        np.add.at(total, labels, values)
        return total / count

    return features.with_(points=Points(
        tuple(points.ids[i] for i in first), mean(points.image), mean(points.ground),
        None if points.sigma is None else mean(points.sigma),
        tuple(points.roles[i] for i in first), rows_at(points.attributes, first)))


def with_twins(points: Points, ids: Iterable[str]) -> frozenset[str]:
    """Return ids of points together with those of their twins."""
    labels = twins(points.ground)
    named = frozenset(ids)
    twin_labels = {label for name, label in zip(points.ids, labels, strict=True) if name in named}
    return frozenset(name for name, label in zip(points.ids, labels, strict=True)
                     if label in twin_labels)


def groups(ids: Sequence[str], labels: IntArray) -> list[tuple[str, ...]]:
    """Return the ids of each group of two and more."""
    by_label: dict[int, list[str]] = {}
    for name, label in zip(ids, labels.tolist(), strict=True):
        by_label.setdefault(label, []).append(name)
    return [tuple(names) for names in by_label.values() if len(names) > 1]
