"""Whether heights tell what a height does in the image, and which features they rest on."""

from __future__ import annotations

import numpy as np

from termsel.candidates.candidate import heights_differ
from termsel.measurements.features import FeatureSet, FloatArray
from termsel.measurements.scaling import scaling_of

CARRIED = 0.01
"""Part of the heights' sum of squares about a plane below which what is left carries nothing."""


ENOUGH = 8
"""Number of features from which on two of them may be said to carry the heights: without two of
fewer, hardly anything is left to be off a plane."""


def heights_hold(features: FeatureSet, most: int = 2) -> bool:
    """Return whether heights differ from a plane, also without any one or two of the features.

    Where they rest on a single feature, its leverage is 1: what its height does cannot be told
    from an error, and no other feature predicts it. Of two each has the other alone.

    Parameters
    ----------
    features : FeatureSet
    most : int
        Number of features that heights must not rest on.
    """
    return heights_differ(features) and not carriers(features, most)


def carriers(features: FeatureSet, most: int = 2) -> tuple[str, ...]:
    """Return the features, at most so many, without which all heights lie on a plane; or ().

    Parameters
    ----------
    features : FeatureSet
        Heights are known.
    most : int
        1 where there are fewer than ENOUGH.
    """
    most = most if len(features) >= ENOUGH else 1
    scaled = scaling_of(features).ground(features.ground_vertices())
    owner = features.vertex_feature
    plane, z = np.column_stack([np.ones(len(scaled)), scaled[:, :2]]), scaled[:, 2]
    keep, found = np.ones(len(z), dtype=bool), list[int]()
    rest, room = _about_plane(plane, z)
    total = float(rest @ rest)
    while len(found) < most:
        gain = np.bincount(owner[keep], rest**2 / room, minlength=len(features))
        found.append(int(np.argmax(gain)))
        keep &= owner != found[-1]
        rest, room = _about_plane(plane[keep], z[keep])
        if float(rest @ rest) <= CARRIED * total:
            return tuple(features.ids[i] for i in found)
    return ()


def _about_plane(plane: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far heights are off the closest plane, and 1 minus the leverage of each."""
    q = np.linalg.qr(plane)[0]
    return z - q @ (q.T @ z), np.maximum(1.0 - (q**2).sum(axis=1), np.finfo(float).eps)
