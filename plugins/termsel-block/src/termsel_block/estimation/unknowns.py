"""What a block is adjusted from and for: measurements, unknowns, heights, and the outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from termsel_block.estimation.equations import Solved
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame, IntArray

_SLOPE_OVER = 10.0  # m


@dataclass(frozen=True, eq=False)
class Measured:
    """The ties in one image: index of each tie, and its line and sample, shapes (n,) and (n, 2)."""

    tie: IntArray
    place: FloatArray


@dataclass(eq=False)
class State:
    """Unknowns and variances while they are estimated; all in px and metres of the frame."""

    cameras: list[Camera]
    parameters: list[FloatArray]
    ties: FloatArray
    variances: list[FloatArray]
    sigma_ties: float = 1.0
    sigma_control: float = 1.0
    freedom_control: float = 4.0
    """From how many measurements that standard deviation is known."""
    in_use: list[BoolArray] = field(default_factory=list)
    control_in_use: list[BoolArray] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Heights:
    """What is known of the heights of ties before: a surface, or a mean and its uncertainty [m].

    `surface` gives heights of ground coordinates x and y (n, 2); where it has none, and without it,
    `mean` and `spread` hold. `sigma` is the standard deviation of the surface.
    """

    frame: Frame
    mean: float
    spread: float
    surface: Callable[[FloatArray], FloatArray] | None = None
    sigma: float = 5.0

    def equations(self, ties: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what they add to the ties' normal equations, (t, 3, 3) and (t, 3)."""
        away, weight, height = self._away(ties)
        row = np.zeros((len(ties), 3))
        row[:, 2] = 1.0  # up is up, within the milliradians that a block is wide
        if self.surface is not None:
            for axis in range(2):
                there = ties.copy()
                there[:, axis] += _SLOPE_OVER
                slope = (self.surface(self.frame.ground(there)[:, :2]) - height) / _SLOPE_OVER
                row[:, axis] = np.where(np.isfinite(slope), -slope, 0.0)
        return (np.einsum("t,ti,tj->tij", weight, row, row),
                (weight * away)[:, None] * row)

    def cost(self, ties: FloatArray) -> float:
        """Return the sum of squares of how far ties (t, 3) are off, over their variances."""
        away, weight, _ = self._away(ties)
        return float((weight * away**2).sum())

    def _away(self, ties: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what ties lack in height, its weight, and the height of the surface."""
        ground = self.frame.ground(ties)
        away, weight = self.mean - ground[:, 2], np.full(len(ties), self.spread**-2)
        height = np.full(len(ties), np.nan)
        if self.surface is not None:
            height = self.surface(ground[:, :2])
            known = np.isfinite(height)
            away = np.where(known, height - ground[:, 2], away)
            weight = np.where(known, self.sigma**-2, weight)
        return away, weight, height


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A block as adjusted.

    Parameters
    ----------
    state : State
    solved : Solved
        The last normal equations, with what is needed for covariances.
    residuals : list of ndarray, shape (n, 2)
        Of the ties of each image, measured minus computed [px].
    of_control : list of ndarray, shape (k,)
        Of the rows of each image's control [px].
    evidence : list of dict
        Of each image: logarithm of the Bayes factor of each group of columns that was weighed.
    steps : int
    converged : bool
    freedom : float
        Redundancy: measurements less the unknowns that they determine.
    """

    state: State
    solved: Solved
    residuals: list[FloatArray]
    of_control: list[FloatArray]
    evidence: list[dict[str, float]]
    steps: int
    converged: bool
    freedom: float
