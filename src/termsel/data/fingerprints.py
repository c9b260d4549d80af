"""Which control an RPC was fitted to: digests that a written RPC carries and that are found again.

An RPC that was fitted to points cannot be tested by them. Its file looks like a vendor's, so that
it says by which features it was made.
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import blake2b

import numpy as np

from termsel.data.features import FeatureSet, FloatArray, select
from termsel.data.rpc import Rpc

KEPT = 300
"""Digests that an RPC carries: the smallest, so that those of two sets can be compared."""

_DIGEST_BYTES = 6
_IMAGE_DECIMALS = 2  # [px]
_METRE_DECIMALS = 2
_DEGREE_DECIMALS = 7  # some cm
_LARGEST_DEGREES = 360.0
_CHANCE = 1e-6
"""Share of sets of other features that are taken for the remaining control of an RPC."""
ERROR_DIGITS = 6
"""Digits of the stated errors of an RPC that termsel fitted: those behind them say that it did."""


def with_control_record(rpc: Rpc, control: FeatureSet) -> Rpc:
    """Return an RPC with a record of the control it was fitted to, added to any record it has.

    The `KEPT` smallest digests are kept. The stated errors are rounded to `ERROR_DIGITS` digits, by
    which a file that termsel wrote is recognised.
    """
    digests = {digest for pair in _vertex_digests(control) for digest in pair}
    bias = _rounded_error(rpc.error_bias)
    random = _rounded_error(rpc.error_random)
    return replace(rpc, control_count=rpc.control_count + len(control),
                   control_digests=tuple(sorted(digests.union(rpc.control_digests))[:KEPT]),
                   error_bias=bias, error_random=random)


def _rounded_error(error: float | None) -> float | None:
    """Return a stated error with `ERROR_DIGITS` digits; None for 0, which says nothing."""
    return float(f"{error:.{ERROR_DIGITS - 1}e}") if error else None


def makers_of(rpc: Rpc, features: FeatureSet) -> list[str]:
    """Return the ids of features that an RPC's own record says it was fitted to.

    Without a record there are none. A line counts if one of its vertices is recorded.
    """
    if not rpc.control_digests:
        return []
    recorded = set(rpc.control_digests)
    is_maker = np.zeros(len(features), dtype=bool)
    for feature, pair in zip(features.vertex_feature, _vertex_digests(features), strict=True):
        is_maker[feature] |= not recorded.isdisjoint(pair)
    return list(select(features.ids, is_maker))


def is_cut(rpc: Rpc) -> bool:
    """Return whether an RPC may have been fitted to more features than its digests cover."""
    return len(rpc.control_digests) >= KEPT


def are_remaining_makers(rpc: Rpc, features: FeatureSet) -> bool:
    """Return whether features seem to be what is left of an RPC's control without its makers.

    An RPC keeps the smallest digests of its control, so that the rest of its control has no digest
    below the largest kept one. Digests are uniformly distributed. So features that are not of its
    control have none below it with the probability (1 - share)^digests only, where share is how
    large the largest kept digest is among all possible ones. They are taken for the rest if this
    is less than `_CHANCE`, and never if the RPC's record is complete.
    """
    if not is_cut(rpc):
        return False
    largest = max(rpc.control_digests)
    digests = {digest for pair in _vertex_digests(features) for digest in pair}
    if min(digests, default="") <= largest:
        return False
    # Digests are numbers of _DIGEST_BYTES bytes, written in hexadecimal digits of one length.
    share = int(largest, 16) / 256.0**_DIGEST_BYTES
    return bool((1.0 - share)**len(digests) < _CHANCE)


def _vertex_digests(features: FeatureSet) -> list[tuple[str, str]]:
    """Return a digest of the image position, and one of the ground position, for each vertex.

    They are separate, as a point is still the same if only one changes: if it is measured anew in
    the image, or its ground coordinates are converted.
    """
    ground = features.ground_vertices()[:, :2]
    is_degrees = np.abs(ground).max(initial=0.0) <= _LARGEST_DEGREES
    return list(zip(
        _control_digests("image", features.image_vertices(), _IMAGE_DECIMALS),
        _control_digests("ground", ground, _DEGREE_DECIMALS if is_degrees else _METRE_DECIMALS),
        strict=True))


def _control_digests(kind: str, positions: FloatArray, decimals: int) -> list[str]:
    """Return a digest of each position (n, 2), rounded so that files of few decimals agree."""
    rounded = np.round(positions, decimals) + 0.0  # no -0
    return [blake2b(f"{kind} {first:.{decimals}f} {second:.{decimals}f}".encode(),
                    digest_size=_DIGEST_BYTES).hexdigest() for first, second in rounded.tolist()]
