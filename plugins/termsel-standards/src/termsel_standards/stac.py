"""Write where an image lies, and how accurately, as an item of a SpatioTemporal Asset Catalog."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any, ClassVar

from termsel import Option, Result, TermselError, Writer
from termsel.files.atomic import write_text
from termsel.measurements.coordinates.crs import LOCAL, horizontal
from termsel_standards.outline import outline_of

VERSION = "1.1.0"
"""Of STAC."""
EXTENSIONS = ("https://stac-extensions.github.io/projection/v2.0.0/schema.json",
              "https://stac-extensions.github.io/processing/v1.2.0/schema.json",
              "https://stac-extensions.github.io/accuracy/v1.0.0-beta.1/schema.json")
_AUTHORITY = re.compile(r"[A-Z]+:\w+")


class StacItem(Writer):
    """Item of a SpatioTemporal Asset Catalog: outline, CRS, processing and accuracy.

    The fields are those of the extensions projection, processing and accuracy. Without independent
    points there is no accuracy in it. The date is when the item was made, unless `date` says when
    the image was taken. Where the model does not hold at the borders of the image, the outline is
    the rectangle around the features.
    """

    name = "stac-item"
    summary = "item of a STAC catalogue: outline of the image, CRS and accuracy"
    needs = "a CRS of the Earth"
    suffix = "_stac.json"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("href", "", "Address of the image, or its path from the item; by default no asset."),
        Option("date", "", "When the image was taken, such as 2024-05-31T10:20:30Z; by default "
                           "unknown, and the item has the time at which it was made."))

    def accepts(self, result: Result) -> bool:
        """Return True if the ground coordinates have a CRS of the Earth."""
        return result.features.crs != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the item."""
        if not self.accepts(result):
            raise TermselError("a STAC item requires a CRS of the Earth",
                               hint="State the CRS of the ground coordinates when you run termsel.")
        made = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        outline = outline_of(result)
        box = [*outline.min(axis=0).tolist(), *outline.max(axis=0).tolist()]
        code = horizontal(result.features.crs)
        properties: dict[str, Any] = {
            "datetime": _time(self.options["date"]) or made, "created": made,
            "proj:code": code if _AUTHORITY.fullmatch(code) else None,
            "processing:software": {"termsel": result.versions.get("termsel", "")},
            "processing:lineage": f"{result.model} by {result.solver}, fitted to "
                                  f"{result.data.source} (sha256 {result.data.sha256})"}
        if result.accuracy and result.accuracy.ground:
            # Of the run: the exported fit may have used the independent points.
            properties["accuracy:geometric_rmse"] = result.accuracy.ground.total
        href = self.options["href"]
        item = {
            "type": "Feature", "stac_version": VERSION, "stac_extensions": list(EXTENSIONS),
            "id": PurePath(href or result.data.source).stem or "scene",
            "geometry": {"type": "Polygon", "coordinates": [outline.tolist()]}, "bbox": box,
            "properties": properties, "links": [],
            "assets": {"image": {"href": href, "roles": ["data"]}} if href else {}}
        write_text(path, json.dumps(item, indent=2, ensure_ascii=False) + "\n")


def _time(date: str) -> str:
    """Return a date as RFC 3339 has it, in UTC; "" for none."""
    if not date:
        return ""
    try:
        when = datetime.fromisoformat(date)
    except ValueError:
        raise TermselError(f"the date {date!r:.40} cannot be read",
                           hint="Give it as 2024-05-31T10:20:30Z.") from None
    when = when if when.tzinfo else when.replace(tzinfo=UTC)
    return when.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
