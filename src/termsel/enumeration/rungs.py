"""A lower bound of all scores, long before all subsets are decided.

To rule out all scores below a low limit takes far less than the proof. Such limits, ever higher,
are the rungs that the bound climbs while nothing else is known of the optimum.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from termsel.enumeration.columns.kernels import LINEAR, RATIONAL
from termsel.enumeration.columns.system import Masks, Piece, Walked, better
from termsel.enumeration.stack import Stack
from termsel.measurements.features import FloatArray

_SHARES = {LINEAR: (0.5, 0.7, 0.9, 0.991), RATIONAL: (0.3,)}
"""Root of each limit as a share of that of the best score. Together they take about a tenth of a
proof: with denominators the time grows with the limit, without them most is spent on the last
per cent and on sizes that do not hold the optimum."""

_LARGEST = 1 << 40  # subsets up to which a rung ends within minutes
_AHEAD = 16  # pieces in progress at once, whatever the number of workers
_STATE = 64  # pieces between two states: a second or so


def rungs(stack: Stack, best: FloatArray, masks: Masks, largest: int,
          workers: int) -> Iterator[tuple[FloatArray, Masks, float]]:
    """Yield better subsets, and a score: only subsets that are found already score less.

    Best score and mask of each size so far are (k + 1,); a piece has `largest` subsets at most.
    Workers are threads; the result does not depend on them.
    """
    least = 0.0
    whole = stack.everything
    shares = _SHARES.get(stack.kind, ()) if stack.branches and whole.count <= _LARGEST else ()
    pool = ThreadPoolExecutor(workers)
    waiting: deque[Future[Walked]] = deque()
    try:
        for share in shares:
            limit = share**2 * float(best.min())
            if not least < limit < np.inf:
                return
            # No subset above the limit is recorded, whatever its size: it is ruled out.
            start, at = np.full_like(best, limit), np.zeros_like(masks)
            # Every piece starts from the rung alone, so that their order does not matter.
            pieces = _pieces(whole, largest)
            piece = next(pieces, None)
            done = 0
            while piece is not None or waiting:
                if piece is not None and len(waiting) < _AHEAD:
                    waiting.append(pool.submit(stack.walk, piece, start, at))
                    piece = next(pieces, None)
                    continue
                walked = waiting.popleft().result()
                # The limit itself is no subset's score.
                scores = np.where(walked.best < limit, walked.best, np.inf)
                best, masks = better(best, masks, scores, walked.masks)
                done += 1
                if done % _STATE == 0:
                    yield best, masks, least
            least = limit
            yield best, masks, least
    finally:
        pool.shutdown(cancel_futures=True)


def _pieces(whole: Piece, largest: int) -> Iterator[Piece]:
    """Yield the subsets in pieces of at most so many."""
    todo = [whole]
    while todo:
        piece = todo.pop()
        if piece.count > largest:
            todo += piece.halves()
        elif piece.count:
            yield piece
