"""What candidates say against a model: structure, another place, parts without any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import poisson

from termsel_match.images.rasters import FloatArray, Mask, spread_pixels

LEVEL = 0.01
"""Permutation level at which residuals are not by chance."""
_NEIGHBOURS = 8
# Residuals; of fewer nothing is seen.
_MIN_RESIDUALS = 12
_PERMUTATIONS = 499
# Mean distances of candidates: in so wide a circle chance leaves none in 1 of 1000.
_BARE_RADIUS = 1.5
# Candidates that agree on another place; fewer are not counted.
_CLUSTER = 4


@dataclass(frozen=True)
class ResidualStructure:
    """Residuals that neighbours have in common.

    Parameters
    ----------
    level : float
        Share of permutations of the residuals in which neighbours are as alike.
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
    """Return what residuals of neighbours have in common; None for too few.

    Moran's I of vectors, with the eight nearest as neighbours. Its level is that of permutations,
    in which residuals beyond the limit are cut to it. The mean product of a residual and the mean
    of its neighbours estimates the variance of what they have in common: noise has no part in it.

    Parameters
    ----------
    image, residuals : ndarray, shape (n, 2)
        Line and sample [px].
    limit : float
        [px]
    size : tuple of int
        Lines and samples of the image.
    rng : numpy.random.Generator

    References
    ----------
    Moran 1950: Notes on continuous stochastic phenomena. Biometrika 37, 17-23.
    """
    count = len(image)
    if count < _MIN_RESIDUALS:
        return None
    # The eight nearest of each, itself left out.
    near = cKDTree(image).query(image, min(_NEIGHBOURS, count // 3) + 1)[1][:, 1:]
    length = np.linalg.norm(residuals, axis=1)
    # Errors beyond the limit count as those at it, so that one of them is not all of the figure.
    cut = residuals * np.minimum(1, limit / np.maximum(length, 1e-12))[:, None]
    cut -= cut.mean(axis=0)

    def likeness(values: FloatArray) -> float:
        return float((values * values[near].mean(axis=1)).sum(axis=1).mean())

    observed = likeness(cut)
    # By chance any residual could be at any place: so they are permuted.
    n_as_alike = sum(likeness(rng.permutation(cut)) >= observed for _ in range(_PERMUTATIONS))
    # The median of a residual and its neighbours: where it is large, all of them are off.
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
    away : tuple of float
        Line and sample from where the model sees them [px].
    image_part : str
        Part of the image where their middle is.
    """

    count: int
    away: tuple[float, float]
    image_part: str


def find_other_place(image: FloatArray, residuals: FloatArray, radius: float,
                     size: tuple[int, int]) -> OtherPlace | None:
    """Return the largest group of wrong candidates that agree, if chance does not explain it.

    Wrong matches lie anywhere in the search. So the others expected within a radius of one are
    the Poisson distribution's, by the density of all; the level is divided by the trials.

    Parameters
    ----------
    image, residuals : ndarray, shape (n, 2)
        Of the candidates that disagree [px].
    radius : float
        Of a group [px].
    size : tuple of int
        Lines and samples of the image.
    """
    if len(residuals) < _CLUSTER:
        return None
    tree = cKDTree(residuals)
    around = tree.query_ball_point(residuals, radius)
    groups = np.array([len(neighbours) for neighbours in around])
    largest = int(groups.argmax())
    # Wrong matches lie anywhere in a circle of the largest distance.
    search = max(float(np.linalg.norm(residuals, axis=1).max()), radius)
    expected = len(residuals) * (radius / search) ** 2
    # Poisson's probability of so many others by chance, times the number of trials.
    chance = len(residuals) * float(poisson.sf(groups[largest] - 2, expected))
    if groups[largest] < _CLUSTER or chance > LEVEL:
        return None
    members = around[largest]
    return OtherPlace(int(groups[largest]), tuple(np.median(residuals[members], axis=0).tolist()),
                      part_of(np.median(image[members], axis=0), size))


def unsupported_share(image: FloatArray, overlap: Mask, size: tuple[int, int]) -> tuple[float, str]:
    """Return the share of what image and reference show that has no candidate near, and where.

    Near is within 1.5 times the distance of candidates if they were spread evenly.

    Parameters
    ----------
    image : ndarray, shape (n, 2)
        Candidates that agree [px].
    overlap : ndarray of bool, shape (a, b)
        Where both show the ground, at places spread evenly over the image.
    size : tuple of int
        Lines and samples of the image.
    """
    positions = spread_pixels(size, overlap.shape)[overlap.ravel()]
    area = size[0] * size[1] * float(overlap.mean())
    # The distance of candidates, if they were spread evenly over the area, is sqrt(area / n).
    away = cKDTree(image).query(positions)[0]
    bare = away > _BARE_RADIUS * (area / len(image)) ** 0.5
    image_part = part_of(np.median(positions[bare], axis=0), size) if bare.any() else ""
    return float(bare.mean()), image_part


def part_of(position: FloatArray, size: tuple[int, int]) -> str:
    """Return in words which ninth of an image a place (line, sample) is in: "the upper left part".
    """
    down, right = np.clip(3 * position / np.array(size), 0, 2).astype(int).tolist()
    words = [direction for direction in (("upper", "", "lower")[down], ("left", "", "right")[right])
             if direction]
    return f"the {' '.join(words)} part" if words else "the middle"
