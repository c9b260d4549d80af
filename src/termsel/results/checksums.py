"""Checksums by which a result that was changed since its run is told from what the run wrote."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from termsel.data.features import FeatureSet
from termsel.data.record.record import Checksums

SEALS = "checksums"
"""Key of the checksums in result.json."""


def of_features(features: FeatureSet) -> str:
    """Return a checksum of ids, coordinates, roles, standard deviations, CRS and RPC."""
    digest = hashlib.sha256(features.crs.encode())
    if features.rpc is not None:
        digest.update(msgspec.json.encode(features.rpc.numbers()))
    digest.update("\n".join(features.points.roles).encode())
    for sigma in (features.points.sigma, features.lines.sigma):
        if sigma is not None:
            digest.update(sigma.tobytes())
    for content in (features.points, features.lines):
        digest.update("\n".join(content.ids).encode())
        digest.update(content.image.tobytes())
        digest.update(np.where(np.isnan(content.ground), np.nan, content.ground).tobytes())
    return digest.hexdigest()


def of_certificate(content: Mapping[str, Any]) -> str:
    """Return the checksum that a certificate without its own has (`termsel.check.checksum`)."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def of_attributes(features: FeatureSet) -> str | None:
    """Return a checksum of the columns of attributes, None where there are none.

    It is not part of `of_features`: results of the same control are told by that, whatever else its
    files say of it.
    """
    # By name and value, points before lines, so that their order in a file does not matter.
    columns = []
    for content in (features.points, features.lines):
        columns.append({name: cells.tolist() for name, cells in content.attributes.items()})
    return hashlib.sha256(json.dumps(columns).encode()).hexdigest() if any(columns) else None


def of_record(record: Mapping[str, Any]) -> str:
    """Return a checksum of the content of result.json, whatever its layout, without checksums."""
    # Sorted keys: the layout of the file is not part of its content.
    text = json.dumps({key: value for key, value in record.items() if key != SEALS},
                      sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def checksums_of(content: Mapping[str, Any], features: FeatureSet) -> Checksums:
    """Return the checksums of the content of result.json and of its features."""
    return Checksums(of_record(content), of_features(features), of_attributes(features))
