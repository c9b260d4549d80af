"""Clusters of places: groups whose distances are clearly longer than those within them."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray, IntArray

MIN_PLACES, MAX_PLACES = 5, 500
"""Numbers of places that are looked at: fewer show no gap, and of more the search takes long."""

_ROUNDED_DISTANCE = 1e-9
"""Distances by the longest edge, below which they are rounding."""


def cluster_labels(plan: FloatArray, gap: float) -> IntArray | None:
    """Return the number of each place's cluster, (n,), counted from 0; None if there are none.

    Of the shortest tree that joins all places (n, 2), the edges between clusters are at least `gap`
    times as long as those within them. At least half of the edges have to be within clusters, as
    among places that were measured twice; the longer half of the edges among random places has no
    such gap. Each cluster has to be shorter than the shortest edge between clusters. None is
    returned, too, for fewer than MIN_PLACES or more than MAX_PLACES places, and for places that are
    all the same.

    Examples
    --------
    >>> import numpy as np
    >>> from termsel.data.coordinates.clusters import cluster_labels
    >>> cluster_labels(np.array([[0, 0], [0, 1], [1, 0], [9, 9], [9, 8], [8, 9]]), 3.0).tolist()
    [0, 0, 0, 1, 1, 1]
    """
    count = len(plan)
    if not MIN_PLACES <= count <= MAX_PLACES:
        return None
    order, parents, edges = _shortest_tree(plan)
    # Each edge of the longer half is compared with the next shorter one.
    sorted_edges = np.sort(edges)
    shorter = sorted_edges[count // 2 - 1:-1]
    longer = sorted_edges[count // 2:]
    rounding = _ROUNDED_DISTANCE * sorted_edges[-1]
    if rounding == 0.0:
        return None
    ratios = longer / np.maximum(shorter, rounding)
    widest = int(np.argmax(ratios))
    if ratios[widest] < gap:
        return None
    # A place joined by an edge that is no longer than those within clusters is in its parent's.
    labels = np.zeros(count, dtype=np.intp)
    clusters = 1
    for place, parent, edge in zip(order, parents, edges, strict=True):
        if edge <= shorter[widest]:
            labels[place] = labels[parent]
        else:
            labels[place] = clusters
            clusters += 1
    # Rows of an even lattice have gaps between them, too; they are longer than these, and no
    # clusters.
    extents = [np.ptp(plan[labels == cluster], axis=0).max() for cluster in range(clusters)]
    return labels if max(extents) < longer[widest] else None


def _shortest_tree(plan: FloatArray) -> tuple[list[int], list[int], FloatArray]:
    """Return the shortest tree that joins places (n, 2), grown from place 0.

    It comes as the numbers of the other places in the order in which they are joined, the number of
    the place that each is joined to, and the lengths of these edges. The algorithm is by R.C. Prim,
    Bell System Technical Journal 36 (1957) 1389-1401.
    """
    # Of each place: the distance to the nearest place in the tree, and the number of that.
    distances = np.linalg.norm(plan - plan[0], axis=1)
    nearest_inside = np.zeros(len(plan), dtype=np.intp)
    is_outside = np.ones(len(plan), dtype=bool)
    is_outside[0] = False
    order: list[int] = []
    parents: list[int] = []
    edges: list[float] = []
    while is_outside.any():
        # The place outside that is nearest to the tree joins it.
        place = int(np.argmin(np.where(is_outside, distances, np.inf)))
        order.append(place)
        parents.append(int(nearest_inside[place]))
        edges.append(float(distances[place]))
        is_outside[place] = False
        from_place = np.linalg.norm(plan - plan[place], axis=1)
        is_nearer = from_place < distances
        nearest_inside[is_nearer] = place
        distances = np.minimum(distances, from_place)
    return order, parents, np.array(edges)
