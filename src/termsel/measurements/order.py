"""The order of features, which does not depend on that of the rows of a file."""

from __future__ import annotations

import re

from termsel.measurements.features import FeatureSet

_NUMBER = re.compile(r"([0-9]+)")


def in_order(features: FeatureSet) -> FeatureSet:
    """Return features in the order of their ids, in which P2 comes before P10.

    What chance or ties decide is then the same, however the rows of a file are ordered.
    """
    points, lines = ([i for _, i in sorted((_by_name(name), i) for i, name in enumerate(part.ids))]
                     for part in (features.points, features.lines))
    return features.with_(points=features.points.take(points), lines=features.lines.take(lines))


def _by_name(name: str) -> tuple[list[tuple[int, str]], str]:
    """Return what sorts numbers in a name by their value; names that differ sort apart."""
    # Of two numbers without leading zeros the longer one is larger, however long they are.
    parts = [part.lstrip("0") if i % 2 else part for i, part in enumerate(_NUMBER.split(name))]
    return [(len(part) if i % 2 else 0, part) for i, part in enumerate(parts)], name
