"""Control points as Orthority's GeoJSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel import Option, Result, TermselError, Writer
from termsel.toolkit import make_printable, write_text
from termsel.toolkit.coordinates import LOCAL, normalise, to_wgs84
from termsel.toolkit.files import chosen_points, say_measured


class OrthorityGeojson(Writer):
    """The selected control points as Orthority's GeoJSON, which GIS programs also open."""

    name = "orthority-geojson"
    summary = "selected control points as GeoJSON, which Orthority and GIS programs read"
    needs = ("control points with heights, in a CRS; pyproj (termsel[gis]) if that is not WGS84; "
             "--image for the name of the image")
    suffix = "_gcps.geojson"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("image", None, "The image; its name is written with each point."),)

    def accepts(self, result: Result) -> bool:
        """Return True for control points with heights and a CRS."""
        points = result.fit.control.points
        return bool(len(points) and normalise(result.features.crs) != LOCAL
                    and not np.isnan(points.ground[:, 2]).any())

    def write(self, result: Result, path: Path) -> None:
        """Write the selected points as GeoJSON, with longitude, latitude and height on WGS84.

        Each has its image position, `ji`, its residual and the columns of its file. Logs that it
        holds no model. Raises TermselError if a height or the CRS is missing.
        """
        if not self.accepts(result):
            raise TermselError(f"this result cannot be written as {self.name}", file=path,
                               hint="It requires control points with heights and a CRS.")
        points = chosen_points(result)
        errors = np.asarray(result.fit.errors(points))
        ground = to_wgs84(result.features.crs)(points.ground)
        image = self.options["image"]
        features = []
        for i, name in enumerate(points.ids):
            # In Orthority samples come before lines, in ji as in residuals.
            line, sample = points.image[i].tolist()
            features.append({
                "type": "Feature",
                "properties": {
                    **{key: texts[i] for key, texts in points.attributes.items()},
                    "filename": make_printable(Path(image).name) if image is not None else "",
                    "id": name, "ji": [sample, line], "info": "", "role": points.roles[i],
                    "residual": errors[i, ::-1].tolist()},
                "geometry": {"type": "Point", "coordinates": ground[i].tolist()}})
        collection = {"type": "FeatureCollection", "features": features}
        write_text(path, json.dumps(collection, ensure_ascii=False, indent=1, allow_nan=False)
                   + "\n")
        say_measured(self.name)
