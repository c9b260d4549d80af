"""What is known of heights before: a surface, how far it is off as a whole, and its roughness."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from termsel import open_dem
from termsel.toolkit.coordinates import height_unit
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame, IntArray

Surface = Callable[[FloatArray], FloatArray]
"""Heights [m] at ground coordinates x and y (n, 2), above what their CRS says."""

# Distance over which the slope of a surface is taken [m].
_SLOPE_STEP = 10.0
_MAX_COUNT_GROUND, _MAX_COUNT_DEM = 6.0, 30.0
"""Independent heights in an image at most: neighbours share hills, and a DEM's errors."""
DEM_OFFSET_SIGMA = 10.0
"""Standard deviation of how far a DEM is off as a whole [m]: most are by another geoid."""
_GROUND_ROUGHNESS, _DEM_ROUGHNESS = 20.0, 5.0
"""Usual roughness of level ground and of a DEM's errors [m]; it counts as `_PRIOR_COUNT` ties."""
# Least roughness [m].
_MIN_ROUGHNESS = 0.5
_PRIOR_COUNT = 2.0
# Robust standard deviations beyond which a height shows nothing more of the roughness.
_OUTLYING = 4.0
_MAD = 1.4826


@contextmanager
def open_surface(path: Path, crs: str) -> Iterator[Surface]:
    """Open a DEM as heights in metres at ground coordinates of a CRS, whatever its unit."""
    with open_dem(path, crs) as dem:
        yield lambda xy: np.asarray(dem(xy) * height_unit(crs))


@dataclass(frozen=True, eq=False)
class ControlHeights:
    """Heights that control states.

    Parameters
    ----------
    over : ndarray, shape (k,)
        Over the surface [m].
    of_rows : tuple of ndarray, shape (n,)
        For each image, the number of the height of each row of its control; -1 for none.
    """

    over: FloatArray = field(default_factory=lambda: np.empty(0))
    of_rows: tuple[IntArray, ...] = ()

    def in_use_by_most(self, rows: Sequence[BoolArray]) -> BoolArray:
        """Return which heights (k,) are in use in more than half of the rows that have them.

        `rows` marks the rows of control in use, (n,) of each image.
        """
        votes = np.zeros(len(self.over))
        for index, used in zip(self.of_rows, rows, strict=True):
            np.add.at(votes, index[index >= 0], np.where(used, 1, -1)[index >= 0])
        return votes > 0


@dataclass(frozen=True, eq=False)
class Observed:
    """Each tie's height as an observation: surface plus offset less height, with its derivative.

    Parameters
    ----------
    row : ndarray, shape (t, 3)
        Derivative of the height over the surface by the place.
    away : ndarray, shape (t,)
        What the tie lacks [m].
    weight : ndarray, shape (t,)
        Inverse variance [1/m2].
    joint : ndarray of bool, shape (t,)
        Whether the offset is part of it.
    """

    row: FloatArray
    away: FloatArray
    weight: FloatArray
    joint: BoolArray


@dataclass(eq=False)
class Heights:
    """Heights are those of a surface, plus an offset that all share, plus what each has of its own.

    The surface is a DEM, or level at the mean that RPCs or control state. The offset is an unknown
    of the adjustment; heights of control show it, too. So in a pair, whose ties cannot show their
    height, the ground is as high as control says, within its roughness, and no better.

    Parameters
    ----------
    frame : Frame
    mean, spread : float
        Height, above what the CRS says, and its uncertainty where there is no DEM [m].
    surface : callable, optional
        Heights [m] of the DEM at ground coordinates x and y (n, 2); not finite where it has none.
    control_heights : ControlHeights
        Heights of control.
    crowd : float
        Ties of an image, so that those which share a hill do not count as if each were by itself.
    """

    frame: Frame
    mean: float
    spread: float
    surface: Surface | None = None
    control_heights: ControlHeights = field(default_factory=ControlHeights)
    crowd: float = 1.0
    offset: float = 0.0
    far: float = 0.0
    """The offset by which a DEM is off beyond what is usual [m]."""
    doubt: float = 0.0
    """That which it may have, as others say [m]."""
    sigma: float = np.nan
    """Roughness: standard deviation of a height over the surface [m]."""
    control: FloatArray = field(init=False)
    """Heights of control in use, over the surface [m]."""

    def __post_init__(self) -> None:
        if np.isnan(self.sigma):
            self.sigma = self.spread if self.surface is None else _DEM_ROUGHNESS
        self.control = self._heights_near_median(self.control_heights.over)

    def keep(self, rows: Sequence[BoolArray]) -> None:
        """Keep the heights of control of which most rows are in use (see `in_use_by_most`)."""
        is_agreed = self.control_heights.in_use_by_most(rows)
        self.control = self._heights_near_median(self.control_heights.over[is_agreed])

    def _heights_near_median(self, over: FloatArray) -> FloatArray:
        """Return those of the heights `over` (n,) the surface [m] that are near their median, (k,).
        """
        # A wrong height would shift images without control, which follow the offset, before its row
        # is found to be a blunder. The mean of the prior, 0, counts as one more height.
        with_prior = np.append(over, 0.0)
        median = np.median(with_prior)
        # The usual roughness counts as `_PRIOR_COUNT` heights, as a few may agree by chance.
        scale = _MAD * np.median(np.abs(with_prior - median))
        variance = (len(with_prior) * scale**2 + _PRIOR_COUNT * self._usual_roughness**2) / (
            len(with_prior) + _PRIOR_COUNT)
        return np.asarray(over[np.abs(over - median) <= _OUTLYING * np.sqrt(variance)])

    @property
    def _usual_roughness(self) -> float:
        """Usual roughness of what is over the surface [m]."""
        return _GROUND_ROUGHNESS if self.surface is None else _DEM_ROUGHNESS

    @property
    def _max_count(self) -> float:
        """Heights of one image or of control that count by themselves."""
        return _MAX_COUNT_GROUND if self.surface is None else _MAX_COUNT_DEM

    def tie_observations(self, ties: FloatArray) -> Observed:
        """Return the heights of ties as observations of the surface, a row for each tie.

        `ties` (t, 3) are their positions in the frame of the block [m].
        """
        away, joint = self._depth_below_surface(ties)
        # Heights of an image with many ties weigh less, so that all count as `_max_count` at most.
        weight = np.full(len(ties), self.sigma**-2 / max(self.crowd / self._max_count, 1.0))
        weight[~joint] = self.spread**-2
        row = np.zeros((len(ties), 3))
        # The vertical of the frame is that of any tie, within the milliradians that a block spans.
        row[:, 2] = 1.0
        if self.surface is not None:
            height = self.surface(self.frame.ground(ties)[:, :2])
            # A slope of the ground makes the height over it depend on east and north, too.
            for axis in range(2):
                shifted = ties.copy()
                shifted[:, axis] += _SLOPE_STEP
                slope = (self.surface(self.frame.ground(shifted)[:, :2]) - height) / _SLOPE_STEP
                row[:, axis] = np.where(np.isfinite(slope), -slope, 0.0)
        return Observed(row, away, weight, joint)

    def equations(self, ties: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the part of the heights in the ties' normal equations, (t, 3, 3) and (t, 3)."""
        # H = w a a^T and b = w a r of each tie, by its row a and residual r.
        observed = self.tie_observations(ties)
        return (np.einsum("t,ti,tj->tij", observed.weight, observed.row, observed.row),
                (observed.weight * observed.away)[:, None] * observed.row)

    def offset_equation(self) -> tuple[float, float]:
        """Return what prior and control add to the normal equation of a change of the offset.

        They are a weight [1/m2] and a right side [1/m].
        """
        # (p + n w) do = w sum(h - o) - p o, with n heights h of control and the present offset o.
        prior = self._weight_of_prior()
        weight = self._weight_of_control()
        return (prior + weight * len(self.control),
                weight * float((self.control - self.offset).sum()) - prior * self.offset)

    def _weight_of_prior(self) -> float:
        """Return the weight [1/m2] of the prior of the offset, whose mean is 0."""
        # A DEM that is found to be hundreds of metres off gets a prior as wide as that.
        if self.surface is None:
            sigma = self.spread / 2
        else:
            sigma = max(DEM_OFFSET_SIGMA, self.far, self.doubt)
        return sigma**-2

    def guessed_offset_weight(self) -> float | None:
        """Return the weight [1/m2] of the prior of a DEM's offset; None without a DEM."""
        # That of a DEM is a guess: few are far off, but these by any length.
        return None if self.surface is None else self._weight_of_prior()

    def _weight_of_control(self) -> float:
        """Return the weight [1/m2] of a height of control; all count as `_max_count` at most."""
        return self.sigma**-2 / max(len(self.control) / self._max_count, 1.0)

    def cost(self, ties: FloatArray) -> float:
        """Return the sum of squares over variances of all heights: ties, offset and control."""
        away, joint = self._depth_below_surface(ties)
        weight = self.sigma**-2 / max(self.crowd / self._max_count, 1.0)
        return float(weight * (away[joint] ** 2).sum() + (away[~joint] ** 2).sum() / self.spread**2
                     + self._weight_of_prior() * self.offset**2
                     + self._weight_of_control() * ((self.control - self.offset) ** 2).sum())

    def estimate(self, ties: FloatArray, covariance: FloatArray, is_seen: BoolArray) -> None:
        """Estimate the roughness by the ties that are seen and the heights of control, in place.

        Parameters
        ----------
        ties : ndarray, shape (t, 3)
            Positions of the ties in the frame of the block [m].
        covariance : ndarray, shape (t, 3, 3)
            Covariances of the ties' positions, given the images [m2].
        is_seen : ndarray of bool, shape (t,)
            Which ties are seen from two images or more.
        """
        self.far = abs(self.offset)
        all_seen = self.tie_observations(ties)
        is_used = is_seen & all_seen.joint
        row = all_seen.row[is_used]
        away = all_seen.away[is_used]
        # The variance of each height over the surface, by that of its position.
        variance = np.einsum("ti,tij,tj->t", row, covariance[is_used], row)
        # The weight of a tie's prior, lowered in `tie_observations`, is replaced by the full one.
        precision = np.maximum(1 / variance - all_seen.weight[is_used], 0.0) + self.sigma**-2
        # The expected square of a height is residual^2 + variance; those of control are known.
        square = np.concatenate([away**2 + 1 / precision, (self.control - self.offset) ** 2])
        if not len(square):
            return
        # Squares are limited, so that a tower or a hole does not make the ground rough.
        # sigma^2 = (sum of squares + n0 s0^2) / (n + n0): the usual s0 is n0 more heights.
        largest_square = (_OUTLYING * _MAD) ** 2 * float(np.median(square))
        self.sigma = max(float(np.sqrt(
            (np.minimum(square, largest_square).sum() + _PRIOR_COUNT * self._usual_roughness**2)
            / (len(square) + _PRIOR_COUNT))), _MIN_ROUGHNESS)

    def _depth_below_surface(self, ties: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the depths (t,) [m] of ties (t, 3) below the surface, and which have the offset.

        The offset is added to the surface except off the DEM, where the mean height is taken.
        """
        ground = self.frame.ground(ties)
        heights = self.frame.heights(ground)
        below_mean = self.mean - heights
        if self.surface is None:
            return below_mean + self.offset, np.ones(len(ties), bool)
        surface = self.surface(ground[:, :2])
        is_known = np.isfinite(surface)
        return np.where(is_known, surface + self.offset - heights, below_mean), is_known
