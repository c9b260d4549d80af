"""Which control an RPC was fitted to: digests that a written RPC carries and that are found again.

An RPC that was fitted to points cannot be tested by them. Its file looks like a vendor's, so that
it says by which features it was made.
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import blake2b

import numpy as np

from termsel.data.features import FeatureSet, FloatArray
from termsel.data.rpc import Rpc

KEPT = 300
"""Digests that an RPC carries: the smallest, so that those of two sets can be compared."""

_DIGEST_BYTES = 6
_IMAGE_DECIMALS = 2  # [px]
_METRE_DECIMALS = 2
_DEGREE_DECIMALS = 7  # some cm
_LARGEST_DEGREES = 360.0


def made_by(rpc: Rpc, control: FeatureSet) -> Rpc:
    """Return an RPC that keeps a record of the control it was fitted to, and of any before that."""
    digests = {digest for pair in _vertex_digests(control) for digest in pair}
    return replace(rpc, control_count=rpc.control_count + len(control),
                   control_digests=tuple(sorted(digests.union(rpc.control_digests))[:KEPT]))


def makers_of(rpc: Rpc, features: FeatureSet) -> list[str]:
    """Return the ids of features that an RPC was fitted to by its own record; [] without one."""
    if not rpc.control_digests:
        return []
    known = set(rpc.control_digests)
    is_maker = [bool(known.intersection(pair)) for pair in _vertex_digests(features)]
    n_points = len(features.points)
    # Lines have two vertices each.
    of_lines = [any(is_maker[first:first + 2]) for first in range(n_points, len(is_maker), 2)]
    of_features = is_maker[:n_points] + of_lines
    return [name for name, maker in zip(features.ids, of_features, strict=True) if maker]


def _vertex_digests(features: FeatureSet) -> list[tuple[str, str]]:
    """Return digests of the image and of the ground position of points and vertices of lines.

    Two of them, as a point that is measured anew in the image, or whose coordinates are converted,
    is still the same.
    """
    ground = features.ground_vertices()[:, :2]
    is_degrees = np.abs(ground).max(initial=0.0) <= _LARGEST_DEGREES
    return list(zip(
        _digests("image", features.image_vertices(), _IMAGE_DECIMALS),
        _digests("ground", ground, _DEGREE_DECIMALS if is_degrees else _METRE_DECIMALS),
        strict=True))


def _digests(kind: str, positions: FloatArray, decimals: int) -> list[str]:
    rounded = np.round(positions, decimals) + 0.0  # no -0
    return [blake2b(f"{kind} {first:.{decimals}f} {second:.{decimals}f}".encode(),
                    digest_size=_DIGEST_BYTES).hexdigest() for first, second in rounded.tolist()]
