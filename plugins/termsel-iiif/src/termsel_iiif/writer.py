"""Write the control points of a result as a georeference annotation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import Option, Result, TermselError, Writer
from termsel.files.atomic import write_text
from termsel.formats.deviation import say_nearest
from termsel.measurements.coordinates.crs import LOCAL, to_wgs84
from termsel_iiif.annotation import MASK, NAME, SOURCE, TRANSFORMATION
from termsel_iiif.reader import CENTRE

TRANSFORMATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "similarity": ("helmert", {"type": "helmert"}),
    "order 1": ("polynomial of order 1", {"type": "polynomial", "options": {"order": 1}}),
    "projective": ("projective", {"type": "projective"}),
    "order 2": ("polynomial of order 2", {"type": "polynomial", "options": {"order": 2}}),
    "order 3": ("polynomial of order 3", {"type": "polynomial", "options": {"order": 3}}),
    "spline": ("thinPlateSpline", {"type": "thinPlateSpline"})}
"""Transformations of the extension, by termsel's names, the simplest first."""

_IMAGE = Option("image_id", "", "Address of the IIIF image, such as https://example.org/iiif/map1; "
                                "by default that of the annotation that was read.")
_SERVICE = Option("service", "ImageService2", "Type of that address.", choices=(
    "ImageService1", "ImageService2", "ImageService3", "Canvas"))


class AnnotationWriter(Writer):
    """Control points as a georeference annotation of version 1 of the extension.

    The transformation is the one of the extension that comes nearest to the fitted model; its
    deviation in px and metres is said. Points left out as blunders are not in it, and no point with
    the role off. What a viewer cannot express, such as an effect of heights, is not in it either.
    """

    name = NAME
    summary = "control points as a IIIF georeference annotation, for Allmaps and other viewers"
    needs = "points with a CRS; --set image_id=URL unless an annotation was read"
    suffix = "_annotation.json"
    declared_options: ClassVar[tuple[Option, ...]] = (_IMAGE, _SERVICE)

    def accepts(self, result: Result) -> bool:
        """Return True if there are points in a CRS of the Earth, and the image has an address."""
        named = self.options["image_id"] or _first(result, SOURCE)
        return bool(named and len(result.features.points)) and result.features.crs != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the annotation."""
        if not self.accepts(result):
            raise TermselError(
                "an annotation requires points in a CRS of the Earth, and the address of the image",
                hint="Give it with --set image_id=https://example.org/iiif/map1.")
        points = result.features.points
        wrong = {one.id for one in result.outliers if one.excluded}
        use = [role != "off" and name not in wrong
               for name, role in zip(points.ids, points.roles, strict=True)]
        used = points.take(use)
        source = self._source(result)
        ground = used.ground.copy()
        ground[:, 2] = np.nan_to_num(ground[:, 2])
        places = to_wgs84(result.features.crs)(ground)
        features = [{
            "type": "Feature",
            "properties": {"resourceCoords": [_short(sample + CENTRE), _short(line + CENTRE)]},
            "geometry": {"type": "Point", "coordinates": [_short(lon, 9), _short(lat, 9)]},
        } for (line, sample), (lon, lat) in zip(used.image.tolist(), places[:, :2].tolist(),
                                                strict=True)]
        nearest = say_nearest(self.name, result.exported, used.ground[:, :2], used.image,
                              {key: label for key, (label, _) in TRANSFORMATIONS.items()},
                              "by a viewer with {}")
        # Without any, a viewer takes its own.
        transformation = (_kept(result, TRANSFORMATION) if nearest is None
                          else TRANSFORMATIONS[nearest][1])
        annotation = source.pop("annotation", None)
        stated = {"type": "Annotation", **({"id": annotation} if annotation else {}),
                  "@context": ["http://iiif.io/api/extension/georef/1/context.json",
                               "http://iiif.io/api/presentation/3/context.json"],
                  "motivation": "georeferencing",
                  "target": {"type": "SpecificResource", "source": source,
                             "selector": {"type": "SvgSelector", "value": self._mask(result)}},
                  "body": {"type": "FeatureCollection",
                           **({"transformation": transformation} if transformation else {}),
                           "features": features}}
        write_text(path, json.dumps(stated, indent=2, ensure_ascii=False) + "\n")

    def _source(self, result: Result) -> dict[str, Any]:
        """Return the image: of the options, or of the annotation that was read."""
        source = _kept(result, SOURCE) or {}
        if self.options["image_id"]:
            source = {"id": self.options["image_id"], "type": self.options["service"]}
        height, width = result.features.image_size or (None, None)
        for name, length in (("height", height), ("width", width)):
            if source.get(name) is None:
                source.pop(name, None)
                if length is not None:
                    source[name] = int(length)
        return source

    @staticmethod
    def _mask(result: Result) -> str:
        """Return the selector that was read, or that of the whole image."""
        text = _first(result, MASK)
        if text:
            return text
        if result.features.image_size is None:
            low, high = result.features.points.image.min(axis=0), result.features.points.image.max(
                axis=0)
        else:
            low, high = np.zeros(2), np.array(result.features.image_size, dtype=float)
        top, left, bottom, right = (round(value) for value in (*low, *high))
        size = f' width="{right}" height="{bottom}"' if result.features.image_size else ""
        return (f'<svg{size}><polygon points="{left},{top} {left},{bottom} {right},{bottom} '
                f'{right},{top}" /></svg>')


def _first(result: Result, name: str) -> str:
    """Return what an attribute says at the first point that has it."""
    cells = result.features.points.attributes.get(name, ())
    return next((str(cell) for cell in cells if cell), "")


def _kept(result: Result, name: str) -> Any:
    """Return what an attribute keeps as JSON, or None."""
    text = _first(result, name)
    return json.loads(text) if text else None


def _short(value: float, digits: int = 6) -> float | int:
    """Return a number without digits that only binary fractions have."""
    rounded = round(value, digits)
    return int(rounded) if rounded == int(rounded) else rounded
