"""How far errors of the vectors move an image that lines were matched to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from termsel_match.lines.problem import MatchedLines

MIN_VECTORS = 6
"""Vectors; of fewer, an error that a whole one has does not show."""
# Of fewer vectors, that are drawn together.
_STRETCHES, _MIN_STRETCHES = 8, 4
_DRAWS = 60
# Of the draws; the mean square is as large for normal errors, and not robust.
_ALONG_LEVEL = 0.7


@dataclass(frozen=True)
class Tracing:
    """What errors of the vectors leave in the image.

    Parameters
    ----------
    sigma : float
        Standard deviation, both axes together [px]; NaN where it cannot be told.
    vectors : int
        By how many it is told; 0 where it is not asked.
    """

    sigma: float = float("nan")
    vectors: int = 0

    def text(self) -> str:
        """Return a sentence on the standard deviation [px] that errors of the vectors leave."""
        remaining = ("cannot be estimated from so few pieces of vectors."
                     if np.isnan(self.sigma) else f"{self.sigma:.2f} px.")
        if self.vectors < MIN_VECTORS and not np.isnan(self.sigma):
            remaining = (f"{self.sigma:.2f} px, apart from errors that a whole vector has. Fewer "
                         f"than {MIN_VECTORS} vectors do not show those.")
        return f"Standard deviation in the image that errors of the vectors leave: {remaining}"


def variance_of_tracing(problem: MatchedLines, selected: Sequence[str], seed: int) -> Tracing:
    """Return what errors of the vectors leave in the image.

    Errors of tracing are common to a vector, so that its pieces do not average them out; and lines
    are selected that agree, which hides how far the others are off. So vectors are drawn with
    replacement, selection and fit are repeated from the model on, and the image moves by as much as
    errors of the vectors have moved it. Where vectors are few, stretches of them are drawn.

    Parameters
    ----------
    problem : MatchedLines
        Of all candidates.
    selected : sequence of str
        The lines that the model is fitted to.
    seed : int
        Of the draws.

    References
    ----------
    Efron, Tibshirani 1993: An introduction to the bootstrap, section 8.3: units that are
    independent of each other are drawn.
    """
    vectors = int(problem.vector.max()) + 1
    of = _bootstrap_units(problem.vector)
    count = int(of.max()) + 1
    if count < _MIN_STRETCHES:
        return Tracing(vectors=vectors)
    rng = np.random.default_rng([seed, 6])
    # The model by the selected lines, refined by all that agree: the draws begin there.
    begin = problem.fitted(np.flatnonzero(np.isin(problem.inputs.control.ids, selected)))
    once = np.ones(len(of))
    positions = problem.seen(problem.fitted(problem.agreeing(problem.refined(begin, once), once)))
    moves = []
    for _ in range(_DRAWS):
        # How often each group is drawn, and with it all of its pieces.
        times = np.bincount(rng.integers(0, count, count), minlength=count)[of].astype(float)
        lines = problem.agreeing(problem.refined(begin, times), times)
        if len(lines):
            away = problem.seen(problem.fitted(lines)) - positions
            moves.append((away**2).sum(axis=1).mean())
    # A few draws hardly determine the model, which says nothing of all vectors together.
    sigma = float(np.sqrt(np.quantile(moves, _ALONG_LEVEL))) if moves else float("nan")
    return Tracing(sigma, vectors)


def _bootstrap_units(vector: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return for each piece the number of the unit that a bootstrap draws it with, (n,).

    A unit is a vector; where vectors are few, a stretch of one.
    """
    count = int(vector.max()) + 1
    if count >= MIN_VECTORS:
        return vector
    n_stretches = -(-_STRETCHES // count)
    stretch = np.empty_like(vector)
    for number in range(count):
        of_vector = np.flatnonzero(vector == number)
        share = np.arange(len(of_vector)) * n_stretches // len(of_vector)
        stretch[of_vector] = number * n_stretches + share
    return np.asarray(np.unique(stretch, return_inverse=True)[1].ravel())
