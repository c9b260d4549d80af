"""Which points may take part in what several images show."""

from __future__ import annotations

from termsel import FeatureSet

KEPT_ASIDE = ("independent", "off")


def without_independent(features: FeatureSet) -> FeatureSet:
    """Return features without independent check points and points that are off."""
    points = features.points
    roles = points.roles or ("",) * len(points)
    return features.with_(points=points.take([role not in KEPT_ASIDE for role in roles]))
