"""What is known on the ground: each image's own control, and heights of ties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel import FeatureSet, Points, line_normals
from termsel_block.geometry.frame import FloatArray, Frame


@dataclass(frozen=True, eq=False)
class OwnControl:
    """The control of one image: rows of known places, and what was measured there.

    A point is two rows, its line and its sample. A control line is a row for each of its two ground
    vertices, which must lie on the image line.

    Parameters
    ----------
    local : ndarray, shape (n, 3)
        Places in the frame [m].
    normal : ndarray, shape (n, 2)
        Direction in the image in which a row measures.
    value : ndarray, shape (n,)
        The measured distance along it [px].
    sigma : ndarray, shape (n,)
        Relative standard deviation; 1 where none is stated.
    feature : tuple of str
        Point or line of each row.
    """

    local: FloatArray
    normal: FloatArray
    value: FloatArray
    sigma: FloatArray
    feature: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.value)

    def points(self) -> tuple[FloatArray, FloatArray]:
        """Return the positions (n, 3) [m] and line and sample (n, 2) [px] of the points alone."""
        # The two rows of a point have different directions, those of a line the same one.
        at = np.flatnonzero((self.normal[::2] != self.normal[1::2]).any(axis=1))
        return self.local[2 * at], np.stack([self.value[2 * at], self.value[2 * at + 1]], axis=1)


def control_equations(features: FeatureSet | None, frame: Frame) -> OwnControl:
    """Return the equations of points with the role control, check or none, and of all lines.

    A point has two rows, its line and its sample, and a line one for each vertex. None has no rows.
    """
    if features is None:
        return OwnControl(np.empty((0, 3)), np.empty((0, 2)), np.empty(0), np.empty(0), ())
    points = points_in_use(features)
    lines = features.lines
    n = len(points)
    k = len(lines)
    # Deviations are relative, as the block estimates that of all control.
    sigma = np.ones((n, 2)) if points.sigma is None else points.sigma / np.median(points.sigma)
    line_sigma = np.ones(k) if lines.sigma is None else lines.sigma / np.median(lines.sigma)
    # Both ground vertices of a line lie on the image line normal . (line, sample) = rho.
    normal, rho = line_normals(lines)
    axes = np.tile(np.eye(2), (n, 1))
    return OwnControl(
        np.concatenate([np.repeat(frame.local(points.ground), 2, axis=0),
                        frame.local(lines.ground.reshape(-1, 3))]),
        np.concatenate([axes, np.repeat(normal, 2, axis=0)]),
        np.concatenate([points.image.ravel(), np.repeat(rho, 2)]),
        np.concatenate([sigma.ravel(), np.repeat(line_sigma, 2)]),
        tuple(np.repeat(points.ids, 2).tolist() + np.repeat(lines.ids, 2).tolist()))


def points_in_use(features: FeatureSet) -> Points:
    """Return the points that the adjustment may use: all but independent ones and those off."""
    return features.points.take([role not in ("independent", "off")
                                 for role in features.points.roles])
