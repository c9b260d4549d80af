"""Write where an image lies, and how accurately, as an item of a SpatioTemporal Asset Catalog."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any, ClassVar

from termsel import Option, Result, TermselError, Writer
from termsel.toolkit import write_text
from termsel.toolkit.coordinates import LOCAL, horizontal_crs
from termsel_standards.outline import bounds_of, geometry_of, outline_of
from termsel_standards.quality.report import file_sha256

VERSION = "1.1.0"
"""Version of STAC."""
EXTENSIONS = {"proj": "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
              "processing": "https://stac-extensions.github.io/processing/v1.2.0/schema.json",
              "file": "https://stac-extensions.github.io/file/v2.1.0/schema.json",
              "accuracy": "https://stac-extensions.github.io/accuracy/v1.0.0-beta.1/schema.json"}
"""Extensions by the prefix of their fields; an item declares those whose fields it has."""
# The beginning of a multihash: the function is SHA-256, and 32 bytes follow.
_SHA256 = "1220"
_AUTHORITY = re.compile(r"[A-Z]+:\w+")


class StacItem(Writer):
    """Item of a SpatioTemporal Asset Catalog: outline, CRS, processing and accuracy.

    The fields are those of the extensions projection, processing, file and accuracy. Without
    independent points there is no accuracy in it, and without the image no size and checksum. The
    date is when the item was made, unless `date` says when the image was taken. Where the model
    does not hold at the borders of the image, the outline is the rectangle around the features.
    """

    name = "stac-item"
    summary = "item of a STAC catalogue: outline of the image, CRS and accuracy"
    needs = "a CRS of the Earth"
    suffix = "_stac.json"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("href", "", "Address of the image, or its path from the item; by default no asset."),
        Option("image", None, "The image; its size and checksum are stated."),
        Option("date", "", "When the image was taken, such as 2024-05-31T10:20:30Z; by default "
                           "unknown, and the item has the time at which it was made."))

    def accepts(self, result: Result) -> bool:
        """Return True if the ground coordinates have a CRS of the Earth."""
        return result.features.crs != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the outline and accuracy of the image as an item into the file `path`.

        Raises TermselError without a CRS of the Earth, for a date that cannot be read, and for an
        image that cannot be read.
        """
        if not self.accepts(result):
            raise TermselError("a STAC item requires a CRS of the Earth",
                               hint="State the CRS of the ground coordinates when you run termsel.")
        created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        outline = outline_of(result)
        code = horizontal_crs(result.features.crs)
        properties: dict[str, Any] = {
            "datetime": _rfc3339_time(self.options["date"]) or created, "created": created,
            "proj:code": code if _AUTHORITY.fullmatch(code) else None,
            "processing:software": {"termsel": result.versions.get("termsel", "")},
            "processing:lineage": f"{result.model} by {result.solver}, fitted to "
                                  f"{result.data.source} (sha256 {result.data.sha256})"}
        if result.accuracy and result.accuracy.ground:
            # The accuracy is that of the run: an exported fit may have used the independent points.
            properties["accuracy:geometric_rmse"] = result.accuracy.ground.total
        asset = self._image_asset()
        item = {
            "type": "Feature", "stac_version": VERSION,
            "stac_extensions": _extensions_of([*properties, *asset]),
            "id": PurePath(asset.get("href", "") or result.data.source).stem or "scene",
            "geometry": geometry_of(outline), "bbox": list(bounds_of(outline)),
            "properties": properties, "links": [], "assets": {"image": asset} if asset else {}}
        write_text(path, json.dumps(item, indent=2, ensure_ascii=False) + "\n")

    def _image_asset(self) -> dict[str, Any]:
        """Return the image as an asset: its address, and if it is given its checksum and size.

        Without an address the name of the image is taken; {} if there is neither. Raises
        TermselError if the image cannot be read.
        """
        image = self.options["image"]
        href = self.options["href"]
        if image is None:
            return {"href": href, "roles": ["data"]} if href else {}
        path = Path(image)
        return {"href": href or path.name, "roles": ["data"],
                "file:checksum": _SHA256 + file_sha256(path), "file:size": path.stat().st_size}


def _extensions_of(fields: list[str]) -> list[str]:
    """Return the addresses of the extensions that named fields are of, by their prefixes."""
    prefixes = {field.partition(":")[0] for field in fields if ":" in field}
    return [uri for prefix, uri in EXTENSIONS.items() if prefix in prefixes]


def _rfc3339_time(date: str) -> str:
    """Return a date in the form of RFC 3339, in UTC; "" for "".

    A date without a zone is taken for UTC. Raises TermselError for a text that is no date.
    """
    if not date:
        return ""
    try:
        when = datetime.fromisoformat(date)
    except ValueError:
        raise TermselError(f"the date {date!r:.40} cannot be read",
                           hint="Give it as 2024-05-31T10:20:30Z.") from None
    when = when if when.tzinfo else when.replace(tzinfo=UTC)
    return when.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
