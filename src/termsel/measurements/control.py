"""The features that models are fitted to, with their scaling and their relief.

Heights serve where they are off a plane, and are so without any one or two of the features: a
feature whose height alone is off the plane has the leverage 1, so that what its height does cannot
be told from an error, and no other feature predicts it. Of two such features each has the other
alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.measurements.scaling import Scaling, scaling_of

FLAT = 1e-8
"""Scaled distance from a plane up to which heights are taken to lie on it: rounding."""

CARRIED = 0.01
"""Share of the sum of squared distances from a plane. Features without which no more is left carry
the relief."""

ENOUGH = 8
"""Number of features from which on two of them may carry the relief. Without two of fewer, hardly
anything is left that could be off a plane."""


@dataclass(frozen=True, eq=False)
class Control:
    """Features that models are fitted to, whatever the roles of the points.

    Parameters
    ----------
    features : FeatureSet
    scaling : Scaling
        That of these features.
    heights : bool
        Whether models with heights are fitted; else plane ones.
    """

    features: FeatureSet
    scaling: Scaling
    heights: bool

    @classmethod
    def of(cls, features: FeatureSet, heights: bool | None = None) -> Self:
        """Return features with their scaling; by default with heights where these differ."""
        control = cls(features, scaling_of(features), bool(heights))
        return control if heights is not None else replace(
            control, heights=heights_differ(control))

    def __len__(self) -> int:
        return len(self.features)

    @property
    def scaled(self) -> FeatureSet:
        """The features in scaled coordinates."""
        return self.scaling.features(self.features)

    def take(self, mask: BoolArray) -> Self:
        """Return some of the features, with a scaling of their own; itself where all are taken."""
        return self if mask.all() else self.of(self.features.take(mask), self.heights)


def heights_differ(control: Control) -> bool:
    """Return whether all features have heights, and these do not lie on a plane."""
    if control.features.without_height():
        return False
    plane, z, _ = _vertices(control)
    return bool(np.abs(_about_plane(plane, z)[0]).max() > FLAT)


def carriers(control: Control, most: int = 2) -> tuple[str, ...]:
    """Return the ids of one or two features without which all heights lie on a plane; or none.

    All ids where heights lie on a plane already. Heights are known. `most`, 1 or 2, is how many
    are looked for; of fewer than `ENOUGH` one.
    """
    most = most if len(control) >= ENOUGH else 1
    plane, z, owner = _vertices(control)
    keep, chosen = np.ones(len(z), dtype=bool), list[int]()
    rest, free = _about_plane(plane, z)
    if np.abs(rest).max() <= FLAT:
        return control.features.ids
    total = float(rest @ rest)
    while len(chosen) < most:
        # What the sum of squares falls by without a vertex: its residual squared by 1 - leverage.
        gain = np.bincount(owner[keep], rest**2 / free, minlength=len(control))
        chosen.append(int(np.argmax(gain)))
        keep &= owner != chosen[-1]
        rest, free = _about_plane(plane[keep], z[keep])
        if float(rest @ rest) <= CARRIED * total:
            return tuple(control.features.ids[i] for i in chosen)
    return ()


def _vertices(control: Control) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return columns of a plane, scaled heights and the feature of each point and vertex."""
    scaled = control.scaling.ground(control.features.ground_vertices())
    return (np.column_stack([np.ones(len(scaled)), scaled[:, :2]]), scaled[:, 2],
            control.features.vertex_feature)


def _about_plane(plane: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far heights are off the closest plane, and 1 minus the leverage of each."""
    q = np.linalg.qr(plane)[0]
    return z - q @ (q.T @ z), np.maximum(1.0 - (q**2).sum(axis=1), np.finfo(float).eps)
