"""Ground control points as GeoJSON, the format of Orthority, with some more properties."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from termsel.errors import TermselError
from termsel.formats.base import Reader, located
from termsel.formats.readers.geojson import (
    Feature,
    numbers_at,
    read_geojson,
    sniff_geojson,
    vertices,
)
from termsel.measurements.features import ROLES, FeatureSet, Points
from termsel.measurements.tables.attributes import columns_of
from termsel.options import Option

_USED = frozenset({"id", "filename", "ji", "role", "enabled", "sigma_px", "info"})


class GeoJsonPoints(Reader):
    """Points with their column and row as the property `ji`, as Orthority reads and writes them.

    Further properties may be `id`, `filename` of the image, `role`, `enabled` and `sigma_px`, one
    standard deviation or a pair for column and row. Without a "crs" of its own the file is in
    WGS84, with ellipsoidal heights if there are any.
    """

    name = "geojson-points"
    summary = "GeoJSON points with the property ji = [column, row], as from Orthority"
    declared_options = (
        Option("image_name", None, "Name of the image, for files with several images."),
    )

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a collection of points."""
        return sniff_geojson(head, "Point")

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, feature and property."""
        features, crs = read_geojson(path, {"Point": 0})
        features = self._of_image(path, features)
        ground = np.array([next(vertices(feature))[0] for feature in features])
        image = np.array([_ji(feature)[::-1] for feature in features], dtype=np.float64)
        ids = [feature.text("id") or f"P{feature.number}" for feature in features]
        roles = [_role(feature) for feature in features]
        try:
            points = Points(tuple(ids), image, ground, _sigma(features), tuple(roles),
                            columns_of([one.attributes(_USED) for one in features]))
        except TermselError as error:
            raise located(error, path) from error
        flat = bool(np.isnan(ground[:, 2]).all())
        return FeatureSet(points, crs=crs or ("EPSG:4326" if flat else "EPSG:4979"))

    def _of_image(self, path: Path, features: list[Feature]) -> list[Feature]:
        names = sorted({feature.text("filename") for feature in features})
        wanted = self.options["image_name"] or (names[0] if len(names) == 1 else None)
        if wanted not in names:
            raise TermselError("the file has points of the images "
                               + ", ".join(name or "without a name" for name in names),
                               file=path, hint="Choose one with --set image_name=NAME.")
        return [feature for feature in features if feature.text("filename") == wanted]


def _ji(feature: Feature) -> list[float]:
    ji: Any = feature.pixels()
    if not numbers_at(ji, 0, (2,)):
        raise feature.error("it has no image coordinates", "ji",
                            "Add the property ji as [column, row].")
    return list(ji)


def _role(feature: Feature) -> str:
    role = feature.text("role").lower()
    if role and role not in ROLES:
        raise feature.error(f"unknown role {role!r}", "role",
                            f"Roles are {', '.join(ROLES)}, or blank.")
    return "off" if feature.properties.get("enabled") in (False, 0) else role


def _sigma(features: list[Feature]) -> np.ndarray | None:
    """Return standard deviations of line and sample, None where there are none."""
    values = [feature.pixels("sigma_px") for feature in features]
    if all(value is None for value in values):
        return None
    rows = []
    for feature, value in zip(features, values, strict=True):
        pair = value if isinstance(value, list) else [value, value]
        if not numbers_at(pair, 0, (2,)):
            raise feature.error("its standard deviation is missing or not a number", "sigma_px",
                                "Give it for every point, or for none.")
        rows.append(pair[::-1])
    return np.array(rows, dtype=np.float64)
