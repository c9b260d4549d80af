"""A lower bound of all scores, long before all subsets are decided.

To rule out all scores below a low limit takes far less than the proof. Such limits, ever higher,
are the rungs that the bound climbs while nothing else is known of the optimum. A limit is proven
once every node is decided with it in place of the best score: whatever a walk then does not report
scores at least that much.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from termsel.data.features import FloatArray
from termsel.selection.best_subsets.columns.kernels import LINEAR, RATIONAL
from termsel.selection.best_subsets.columns.system import (
    Masks,
    NodeResult,
    SubtreeNode,
    better_of_each_size,
)
from termsel.selection.best_subsets.score_systems import ScoreSystems

_SHARES = {LINEAR: (0.5, 0.7, 0.9, 0.991), RATIONAL: (0.3,)}
"""Root of each limit as a share of that of the best score. Together they take about a tenth of a
proof: with denominators the time grows with the limit, without them most is spent on the last
per cent and on sizes that do not hold the optimum."""

_MAX_RUNG_SUBSETS = 1 << 40  # subsets up to which a rung ends within minutes
_NODES_IN_PROGRESS = 16  # at once, whatever the number of workers
_STATE = 64  # nodes between two states: a second or so


def raise_bound(systems: ScoreSystems, best: FloatArray, masks: Masks, node_subsets: int,
                workers: int) -> Iterator[tuple[FloatArray, Masks, float]]:
    """Yield the best subsets so far, with a score below which no other subset is.

    The score rises from rung to rung, each a share of the best score that is known before it, as
    long as it rises. Nothing is yielded where no bound cuts branches, for a large tree, and without
    a score to begin with. `best` and `masks` (k + 1,) are the least score of each size so far and
    its subset, and are yielded as they become better. A node of at most `node_subsets` is walked,
    any other one is divided. Workers are threads; the result does not depend on them.
    """
    lower_bound = 0.0
    root = systems.everything
    shares: tuple[float, ...] = ()
    if systems.branches and root.count <= _MAX_RUNG_SUBSETS:
        shares = _SHARES.get(systems.kind, ())
    pool = ThreadPoolExecutor(workers)
    pending: deque[Future[NodeResult]] = deque()
    try:
        for share in shares:
            limit = share**2 * float(best.min())
            if not lower_bound < limit < np.inf:
                return
            # No subset above the limit is recorded, whatever its size: it is ruled out.
            starting_scores = np.full_like(best, limit)
            no_masks = np.zeros_like(masks)
            # Every node starts from the rung alone, so that their order does not matter.
            nodes = _nodes_of_root(root, node_subsets)
            node = next(nodes, None)
            decided_nodes = 0
            while node is not None or pending:
                if node is not None and len(pending) < _NODES_IN_PROGRESS:
                    pending.append(pool.submit(systems.walk, node, starting_scores, no_masks))
                    node = next(nodes, None)
                    continue
                result = pending.popleft().result()
                # The limit itself is no subset's score.
                scores = np.where(result.best < limit, result.best, np.inf)
                best, masks = better_of_each_size(best, masks, scores, result.masks)
                decided_nodes += 1
                if decided_nodes % _STATE == 0:
                    yield best, masks, lower_bound
            lower_bound = limit
            yield best, masks, lower_bound
    finally:
        pool.shutdown(cancel_futures=True)


def _nodes_of_root(root: SubtreeNode, node_subsets: int) -> Iterator[SubtreeNode]:
    """Yield nodes of at most `node_subsets` subsets each, which together have those of the root."""
    open_nodes = [root]
    while open_nodes:
        node = open_nodes.pop()
        if node.count > node_subsets:
            open_nodes += node.halves()
        elif node.count:
            yield node
