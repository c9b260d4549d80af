"""What candidates say against a model: structure, another place, parts without any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import poisson

from termsel_match.images.rasters import FloatArray, Mask, spread_pixels

LEVEL = 0.01
"""Level of a test up to which a structure or a cluster is not taken for chance."""

_NEIGHBOURS = 8
"""How many of the nearest residuals are compared with each."""

_MIN_RESIDUALS = 12
"""Fewest residuals whose structure is judged."""

_PERMUTATIONS = 499
"""Permutations of the residuals that show what chance does."""

_BARE_RADIUS = 1.5
"""Radius of a circle, in mean distances of candidates, that chance leaves empty in 1 of 1000 cases:
exp(-pi 1.5^2)."""

_CLUSTER = 4
"""Fewest candidates that count as agreeing on another position."""


@dataclass(frozen=True)
class ResidualStructure:
    """What residuals of neighbours have in common.

    Parameters
    ----------
    level : float
        Share of random permutations of the residuals in which neighbours are as alike.
    size : float
        Root mean square of what neighbours have in common [px], both axes together.
    image_part : str
        Part of the image where it is largest.
    away : tuple of float
        Mean residual there, line and sample [px].
    """

    level: float
    size: float
    image_part: str
    away: tuple[float, float]


def residual_structure(image: FloatArray, residuals: FloatArray, limit: float,
                       size: tuple[int, int], rng: np.random.Generator) -> ResidualStructure | None:
    """Return what residuals of neighbours have in common; None if there are too few residuals.

    The measure is Moran's I for vectors: the mean product of a residual and the mean of its
    neighbours, which are the eight nearest residuals, or a third of all if that is fewer. As noise
    of neighbours is independent, this estimates the variance of what they have in common. How
    often chance makes it as large is found by permutations.

    Parameters
    ----------
    image, residuals : ndarray, shape (n, 2)
        Positions in the image and residuals, line and sample [px].
    limit : float
        Length to which longer residuals are cut in the test [px].
    size : tuple of int
        Lines and samples of the image.
    rng : numpy.random.Generator
        Source of the permutations.

    References
    ----------
    Moran 1950: Notes on continuous stochastic phenomena. Biometrika 37, 17-23.
    """
    count = len(image)
    if count < _MIN_RESIDUALS:
        return None
    # The nearest of all is the residual itself, which is left out.
    near = cKDTree(image).query(image, min(_NEIGHBOURS, count // 3) + 1)[1][:, 1:]
    length = np.linalg.norm(residuals, axis=1)
    # Longer residuals are cut to the limit: otherwise a single one would decide the test.
    cut = residuals * np.minimum(1, limit / np.maximum(length, 1e-12))[:, None]
    cut -= cut.mean(axis=0)

    def likeness(values: FloatArray) -> float:
        """Return the mean product of each vector (n, 2) with the mean of its neighbours."""
        return float((values * values[near].mean(axis=1)).sum(axis=1).mean())

    observed = likeness(cut)
    # Without structure any residual could be at any position.
    n_as_alike = sum(likeness(rng.permutation(cut)) >= observed for _ in range(_PERMUTATIONS))
    # Where the median of a residual and its neighbours is large, most of them are off alike.
    local = np.concatenate([residuals[:, None], residuals[near]], axis=1)
    middle = np.median(local, axis=1)
    worst = int(np.linalg.norm(middle, axis=1).argmax())
    return ResidualStructure((1 + n_as_alike) / (1 + _PERMUTATIONS),
                             max(likeness(residuals), 0.0) ** 0.5,
                             part_of(image[worst], size), tuple(middle[worst].tolist()))


@dataclass(frozen=True)
class OtherPlace:
    """Candidates that disagree with the model and agree with each other.

    Parameters
    ----------
    count : int
        How many candidates agree with each other.
    away : tuple of float
        Median residual of these candidates, line and sample [px].
    image_part : str
        Part of the image in which their median position is.
    """

    count: int
    away: tuple[float, float]
    image_part: str


def find_other_place(image: FloatArray, residuals: FloatArray, radius: float,
                     size: tuple[int, int]) -> OtherPlace | None:
    """Return the largest group of candidates that agree on another position than the model's.

    Wrong matches are spread evenly over the area that is searched. The number of others within a
    radius of one then follows the Poisson distribution of their density. As a group is looked for
    around each candidate, the probability of the largest is multiplied by their number.

    Parameters
    ----------
    image, residuals : ndarray, shape (n, 2)
        Positions and residuals of the candidates that disagree, line and sample [px].
    radius : float
        Largest distance of the residuals of a group from that of its middle one [px].
    size : tuple of int
        Lines and samples of the image.

    Returns
    -------
    OtherPlace or None
        None if there are fewer than four such candidates, or chance may explain the group.
    """
    if len(residuals) < _CLUSTER:
        return None
    tree = cKDTree(residuals)
    around = tree.query_ball_point(residuals, radius)
    groups = np.array([len(neighbours) for neighbours in around])
    largest = int(groups.argmax())
    # The area searched is taken to be the circle that holds all residuals.
    search = max(float(np.linalg.norm(residuals, axis=1).max()), radius)
    expected = len(residuals) * (radius / search) ** 2
    # Bonferroni: n P(others >= group - 1). The candidate in the middle is none of the others, and
    # poisson.sf(k) is P(others > k).
    chance = len(residuals) * float(poisson.sf(groups[largest] - 2, expected))
    if groups[largest] < _CLUSTER or chance > LEVEL:
        return None
    members = around[largest]
    return OtherPlace(int(groups[largest]), tuple(np.median(residuals[members], axis=0).tolist()),
                      part_of(np.median(image[members], axis=0), size))


def unsupported_share(image: FloatArray, overlap: Mask, size: tuple[int, int]) -> tuple[float, str]:
    """Return which share of an overlap has no agreeing candidate nearby, and where that is.

    A candidate is near within 1.5 times the distance that candidates would have if they were spread
    evenly over the overlap.

    Parameters
    ----------
    image : ndarray, shape (n, 2)
        Positions of the candidates that agree, line and sample [px].
    overlap : ndarray of bool, shape (a, b)
        Where image and reference both show the ground, at positions spread evenly over the image.
    size : tuple of int
        Lines and samples of the image.

    Returns
    -------
    share : float
    image_part : str
        Part of the image that has the median of the positions without a candidate nearby; "" if
        there are none.
    """
    positions = spread_pixels(size, overlap.shape)[overlap.ravel()]
    area = size[0] * size[1] * float(overlap.mean())
    distances = cKDTree(image).query(positions)[0]
    # n candidates that are spread evenly over an area are sqrt(area / n) apart.
    bare = distances > _BARE_RADIUS * (area / len(image)) ** 0.5
    image_part = part_of(np.median(positions[bare], axis=0), size) if bare.any() else ""
    return float(bare.mean()), image_part


def part_of(position: FloatArray, size: tuple[int, int]) -> str:
    """Return which ninth of an image a position (line, sample) is in, as "the upper left part".

    The middle ninth is "the middle". `size` has the lines and samples of the image.
    """
    down, right = np.clip(3 * position / np.array(size), 0, 2).astype(int).tolist()
    words = [direction for direction in (("upper", "", "lower")[down], ("left", "", "right")[right])
             if direction]
    return f"the {' '.join(words)} part" if words else "the middle"
