"""How far errors of the vectors move an image that lines were matched to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from termsel_match.lines.problem import MatchedLines

MIN_VECTORS = 6
"""Fewest vectors that are drawn as a whole: of fewer, an error of a whole vector does not show."""

_STRETCHES = 8
"""Number of stretches into which fewer vectors are divided altogether."""

_MIN_STRETCHES = 4
"""Fewest vectors or stretches from which is drawn."""

_DRAWS = 60
"""Number of draws of the bootstrap."""

_ALONG_LEVEL = 0.7
"""Quantile of the mean square movements of the draws that is taken. For normal errors it is about
their mean, which is not robust."""


@dataclass(frozen=True)
class Tracing:
    """What errors of the vectors leave in the image.

    Parameters
    ----------
    sigma : float
        Standard deviation of the image, both axes together [px]; NaN if it cannot be estimated.
    vectors : int
        Number of vectors by which it is estimated; 0 if it is not estimated at all.
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
    """Return how far errors of the vectors move the image, estimated by a bootstrap.

    An error of tracing is common to a vector, so that its pieces do not average it out. Besides,
    only lines that agree are selected, which hides how far the others are off. So vectors are drawn
    with replacement, and selection and fit are repeated, starting from the model. The image then
    moves as much as errors of the vectors have moved it. Of few vectors, stretches are drawn.

    Parameters
    ----------
    problem : MatchedLines
        The problem of all candidates.
    selected : sequence of str
        Ids of the lines that the model is fitted to.
    seed : int
        Seed of the draws.

    Returns
    -------
    Tracing
        With NaN as the standard deviation if there are fewer than four stretches, or no draw has
        lines that agree.

    References
    ----------
    Efron, Tibshirani 1993: An introduction to the bootstrap, section 8.3: units that are
    independent of each other are drawn.
    """
    vectors = int(problem.vector.max()) + 1
    unit = _bootstrap_units(problem.vector)
    count = int(unit.max()) + 1
    if count < _MIN_STRETCHES:
        return Tracing(vectors=vectors)
    rng = np.random.default_rng([seed, 6])
    # The model by the selected lines, from which each draw starts.
    begin = problem.fitted(np.flatnonzero(np.isin(problem.inputs.control.ids, selected)))
    once = np.ones(len(unit))
    positions = problem.seen(problem.fitted(problem.agreeing(problem.refined(begin, once), once)))
    moves = []
    for _ in range(_DRAWS):
        # How often each unit is drawn, and with it each of its pieces.
        times = np.bincount(rng.integers(0, count, count), minlength=count)[unit].astype(float)
        lines = problem.agreeing(problem.refined(begin, times), times)
        if len(lines):
            movement = problem.seen(problem.fitted(lines)) - positions
            moves.append((movement**2).sum(axis=1).mean())
    # A quantile, as a few draws hardly determine the model and move the image by far too much.
    sigma = float(np.sqrt(np.quantile(moves, _ALONG_LEVEL))) if moves else float("nan")
    return Tracing(sigma, vectors)


def _bootstrap_units(vector: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the number of the unit with which a bootstrap draws each piece, (n,).

    `vector` (n,) is the number of each piece's vector. A unit is a vector; if there are fewer than
    six, it is one of the stretches, about eight altogether, into which they are divided.
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
