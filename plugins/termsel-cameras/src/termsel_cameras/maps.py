"""Simulated scans of old maps: paper that shrank, sheets that were joined, local distortion.

The map is drawn in one projection and scanned from above. What separates the scan from a
similarity of the ground:

- the paper shrank, along and across its fibres by different parts, and a little unevenly;
- each sheet was drawn, stuck on and shrunk by itself, with a shift, a turn and a scale of its own,
  so that the image jumps at the joints;
- features were drawn where local measurements put them: a smooth random field distorts the map,
  with a Matern spectrum;
- every single feature is drawn inexactly.

All measurements are simulated. The sizes are those that the literature reports of cadastral and
city maps, in the order of magnitude; they imitate no map.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from termsel import DatasetSpec, FeatureSet, Points, TermselError
from termsel.toolkit import FloatArray
from termsel.toolkit.models import ASSIGNABLE, empty_lines
from termsel_cameras.photo import DIGITS

MAP_NAME = "old-map"
MAP_CRS = "EPSG:32633"

SIZE = (6000, 8000)
"""Lines and samples of the scan [px]."""

GSD = 0.25
"""Size of a pixel on the ground [m]: a map of 1:3000, scanned with 300 dpi."""

ORIGIN = (512000.0, 5340000.0)
"""Easting and northing of the middle of the map [m]."""

SHRINKAGE = 0.012
"""Part by which the paper shrank along its fibres; across them by half of it more."""

WARP = 4.0
"""Largest shift by uneven shrinkage [px]."""

WAVES = 200
"""Random waves that add up to the local distortion."""

DISTORTION_LENGTH = 0.15
"""Length of the local distortion, by the longer side of the scan."""

_CANDIDATES = 12
_EDGE = 0.02


def simulate_map(
    *,
    seed: int | None = None,
    n_points: int = 90,
    sheets: tuple[int, int] = (2, 2),
    joints: float = 6.0,
    local: float = 5.0,
    shrinkage: float = SHRINKAGE,
    noise: float = 1.5,
) -> FeatureSet:
    """Return the measured points of a simulated scan of an old map.

    Parameters
    ----------
    seed : int, optional
        Draws the map, the points and the noise; by default 0.
    n_points : int
        Number of points, with roles in thirds.
    sheets : tuple of 2 int
        Sheets along lines and along samples.
    joints : float
        Standard deviation of the shift of a sheet [px]. Its turn and its scale move its edges by as
        much.
    local : float
        Standard deviation of the local distortion of line and of sample [px].
    shrinkage : float
        Part by which the paper shrank along its fibres.
    noise : float
        Standard deviation of line and sample of a feature by drafting and measuring [px].

    Returns
    -------
    FeatureSet
        Easting and northing in UTM zone 33 [m], without heights.

    Raises
    ------
    TermselError
        For a number that is negative or infinite, or without a sheet.

    Examples
    --------
    >>> from termsel_cameras import simulate_map
    >>> scan = simulate_map(sheets=(1, 1), local=0.0)
    >>> len(scan.points), scan.image_size
    (90, (6000, 8000))
    """
    numbers = {"seed": seed or 0, "n_points": n_points, "joints": joints, "local": local,
               "shrinkage": shrinkage, "noise": noise}
    for name, value in numbers.items():
        if not 0 <= value < float("inf"):
            raise TermselError(f"a map with {name} = {value} cannot be simulated",
                               hint="Give a number of at least 0.")
    if min(sheets) < 1:
        raise TermselError(f"a map with sheets = {sheets} cannot be simulated",
                           hint="Give at least one sheet along lines and along samples.")
    # A generator for each part, so that without one of them the others stay the same.
    paper_rng, sheet_rng, field_rng, position_rng, noise_rng = np.random.default_rng(
        [1900, seed or 0]).spawn(5)
    positions = _spread_positions(position_rng, n_points)
    extent = np.array(SIZE) - 1.0
    # Distorted as drawn, then by the sheets, then by the paper, then measured.
    image = positions + _random_shift(field_rng, local, positions)
    image += _shift_by_sheet(sheet_rng, sheets, joints, positions)
    image = _shrink(paper_rng, shrinkage, image)
    image += noise * noise_rng.standard_normal(positions.shape)
    # Processors differ in the last bits.
    image = image.round(DIGITS)
    # Lines count downwards from the upper edge, northings upwards.
    from_middle = (positions - extent / 2) * GSD
    up = -from_middle[:, 0]
    right = from_middle[:, 1]
    ground = np.column_stack([ORIGIN[0] + right, ORIGIN[1] + up, np.full(n_points, np.nan)])
    roles = tuple(ASSIGNABLE[i % 3] for i in range(n_points))
    points = Points(tuple(f"M{i + 1:03d}" for i in range(n_points)), image, ground, None, roles)
    return FeatureSet(points, empty_lines(), MAP_CRS, SIZE, noise)


def _spread_positions(rng: Generator, count: int) -> FloatArray:
    """Return line and sample (count, 2) [px] of points spread over the map (Mitchell 1991)."""
    positions = np.empty((count, 2))
    for i in range(count):
        candidates = rng.uniform(_EDGE, 1 - _EDGE, (_CANDIDATES, 2)) * (np.array(SIZE) - 1.0)
        # Of several random candidates the one is taken that is farthest from all points so far.
        distances = np.linalg.norm(candidates[:, None] - positions[:i], axis=2)
        positions[i] = candidates[distances.min(axis=1, initial=np.inf).argmax()]
    return positions


def _random_shift(rng: Generator, size: float, positions: FloatArray) -> FloatArray:
    """Return a smooth random shift (n, 2) [px] at positions (n, 2) [px].

    `size` [px] is its standard deviation in each axis.
    """
    length = DISTORTION_LENGTH * max(SIZE)
    shift = np.empty(positions.shape)
    for axis in (0, 1):
        # Waves whose numbers are drawn from the spectrum of a Matern field of smoothness 5/2, a
        # Student distribution with 5 degrees of freedom.
        stretched = np.sqrt(5 / rng.chisquare(5, (WAVES, 1)))
        waves = stretched * rng.standard_normal((WAVES, 2)) / length
        phases = rng.uniform(0, 2 * np.pi, WAVES)
        # The sum of many waves of random phase is about normal; this factor makes its variance 1.
        shift[:, axis] = np.sqrt(2 / WAVES) * np.cos(positions @ waves.T + phases).sum(axis=1)
    return size * shift


def _shift_by_sheet(rng: Generator, sheets: tuple[int, int], size: float,
                    positions: FloatArray) -> FloatArray:
    """Return the shift (n, 2) [px] of positions (n, 2) [px] by the sheets that they are on.

    `sheets` are their numbers along lines and samples, `size` [px] is the standard deviation of
    their shifts. A single sheet has no shift.
    """
    if sheets == (1, 1):
        return np.zeros(positions.shape)
    extent = np.array(SIZE) / sheets
    sheet = np.minimum(positions // extent, np.array(sheets) - 1).astype(int)
    number = sheet[:, 0] * sheets[1] + sheet[:, 1]
    # Line and sample count from the middle of each sheet, in halves of its longer side.
    line, sample = ((positions - (sheet + 0.5) * extent) / (extent.max() / 2)).T
    shift = size * rng.standard_normal((sheets[0] * sheets[1], 2))[number]
    # A small scale and turn move the edge of a sheet by as much as its shift.
    scale, turn = size * rng.standard_normal((2, sheets[0] * sheets[1]))[:, number]
    return np.asarray(shift + np.stack([scale * line - turn * sample,
                                        turn * line + scale * sample], axis=1))


def _shrink(rng: Generator, shrinkage: float, image: FloatArray) -> FloatArray:
    """Return image positions (n, 2) [px] once the paper shrank about its middle and was scanned.

    It shrank by `shrinkage` along its fibres, and lay on the scanner with a turn of up to 0.01 rad.
    """
    middle = (np.array(SIZE) - 1.0) / 2
    line, sample = ((image - middle) / middle).T
    coefficients = rng.uniform(-1, 1, (2, 3)) * WARP / 3
    # Uneven shrinkage: a quadratic form of the position, 0 in the middle.
    warp = np.stack([line**2, line * sample, sample**2], axis=1) @ coefficients.T
    turn = rng.uniform(-0.01, 0.01)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    # Fibres run along lines; across them paper shrinks by half more.
    shrunk = (image - middle) * (1.0 - shrinkage * np.array([1.0, 1.5]))
    return np.asarray(middle + shrunk @ rotation + warp)


MAP = DatasetSpec(
    MAP_NAME, "simulated scan of an old map of four sheets, 0.25 m: 90 points without heights",
    simulate_map, simulated=True)
"""The embedded map."""
