"""Write the control points of a result as a georeference annotation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import Fit, Option, Result, TermselError, Writer
from termsel.toolkit import FloatArray, say_deviation, write_text
from termsel.toolkit.coordinates import LOCAL, to_wgs84, transformation_between
from termsel_iiif.annotation import FORMAT_NAME, MASK, SOURCE, TRANSFORMATION
from termsel_iiif.reader import CENTRE
from termsel_iiif.viewer import (
    TRANSFORMATIONS,
    Forward,
    forward,
    from_mercator,
    kind_of,
    kind_of_fit,
    spread_places,
    to_mercator,
)

# Kinds of transformation whose largest differences from the model [px] are within this are alike.
_ALIKE_PX = 0.01

_IMAGE_ID = Option("image_id", "", "Address of the IIIF image, such as "
                                   "https://example.org/iiif/map1; by default that of the "
                                   "annotation that was read.")
_SERVICE = Option("service", "ImageService2", "Type of that address.", choices=(
    "ImageService1", "ImageService2", "ImageService3", "Canvas"))


class AnnotationWriter(Writer):
    """Control points as a georeference annotation of version 1 of the extension.

    The transformation is that of the extension with the name of the fitted model (poly2d with all
    terms to the third degree, projective2d, helmert2d, tps). For another model it is the one that
    comes nearest. What a viewer makes of it is compared with the model, in px and metres. Points
    left out as blunders are not in it, and no point with the role off. What a viewer cannot
    express, such as an effect of heights, is not in it either.
    """

    name = FORMAT_NAME
    summary = "control points as a IIIF georeference annotation, for Allmaps and other viewers"
    needs = ("points with a CRS, and the address of the image in IIIF: --set "
             "image_id=https://example.org/iiif/map1")
    suffix = "_annotation.json"
    declared_options: ClassVar[tuple[Option, ...]] = (_IMAGE_ID, _SERVICE)

    def accepts(self, result: Result) -> bool:
        """Return True if there are points in a CRS of the Earth, and the image has an address."""
        address = self.options["image_id"] or _attribute(result, SOURCE)
        return bool(address and len(result.features.points)) and result.features.crs != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the points that are in use as a Georeference Annotation of the IIIF.

        Outliers that were rejected are left out, as they would bend the map in a viewer. The
        transformation is that of `_choose_transformation`. If the points came from an annotation,
        its mask, source and id are written again, unless the options state another image. Raises
        TermselError without points, a CRS of the Earth, or the address of the image.
        """
        if not self.accepts(result):
            raise TermselError(
                "an annotation requires points in a CRS of the Earth, and the address of the image",
                hint="Give it with --set image_id=https://example.org/iiif/map1.")
        points = result.features.points
        excluded = {outlier.id for outlier in result.outliers if outlier.excluded}
        is_used = [role != "off" and name not in excluded
                   for name, role in zip(points.ids, points.roles, strict=True)]
        used = points.take(is_used)
        source = self._choose_source(result)
        ground = used.ground.copy()
        # Unknown heights would make longitudes and latitudes unknown, though they hardly depend on
        # heights.
        ground[:, 2] = np.nan_to_num(ground[:, 2])
        places_on_earth = to_wgs84(result.features.crs)(ground)
        features = [{
            "type": "Feature",
            "properties": {
                "resourceCoords": [_shorten_px(sample + CENTRE), _shorten_px(line + CENTRE)]},
            "geometry": {"type": "Point", "coordinates": [_plain_number(lon), _plain_number(lat)]},
        } for (line, sample), (lon, lat) in zip(
            used.image.tolist(), places_on_earth[:, :2].tolist(), strict=True)]
        stated_before = _json_of_attribute(result, TRANSFORMATION)
        stated = _choose_transformation(
            result.exported, used.image, places_on_earth[:, :2], stated_before)
        annotation = source.pop("annotation", None)
        content = {"type": "Annotation", **({"id": annotation} if annotation else {}),
                   "@context": ["http://iiif.io/api/extension/georef/1/context.json",
                                "http://iiif.io/api/presentation/3/context.json"],
                   "motivation": "georeferencing",
                   "target": {"type": "SpecificResource", "source": source,
                              "selector": {"type": "SvgSelector",
                                           "value": self._choose_mask(result)}},
                   "body": {"type": "FeatureCollection",
                            **({"transformation": stated} if stated else {}),
                            "features": features}}
        write_text(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")

    def _choose_source(self, result: Result) -> dict[str, Any]:
        """Return the image as JSON has it: that of the options, or else the one that was read.

        A height and width that it does not state are those of the features, if they are known.
        """
        source = _json_of_attribute(result, SOURCE) or {}
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
    def _choose_mask(result: Result) -> str:
        """Return the part of the image that the map shows, as an SVG: the selector.

        It is the one that was read with the points, or else a rectangle: the whole image or, if its
        size is not known, the box around the points.
        """
        text = _attribute(result, MASK)
        if text:
            return text
        if result.features.image_size is None:
            low = result.features.points.image.min(axis=0)
            high = result.features.points.image.max(axis=0)
        else:
            low = np.zeros(2)
            high = np.array(result.features.image_size, dtype=float)
        first_line, first_sample, last_line, last_sample = (round(value) for value in (*low, *high))
        # SVG has x before y, and so the sample before the line.
        size = f' width="{last_sample}" height="{last_line}"' if result.features.image_size else ""
        return (f'<svg{size}><polygon points="{first_sample},{first_line} '
                f'{first_sample},{last_line} {last_sample},{last_line} '
                f'{last_sample},{first_line}" /></svg>')


def _choose_transformation(fitted: Fit, image: FloatArray, lonlat: FloatArray,
                           stated_before: Any) -> dict[str, Any] | None:
    """Return the transformation that an annotation states, and log how far a viewer will be off.

    It is the kind that the model is of, or else the simplest of those that come nearest to it.
    `image` (n, 2) are lines and samples of the points, and `lonlat` (n, 2) their longitudes and
    latitudes [deg]. `stated_before` is what an annotation that was read stated: it is returned
    unchanged if it is of the same kind, or if the points determine none. None if there is neither.
    """
    # Viewers fit transformations themselves, in the plane of web maps.
    plane = to_mercator(lonlat)
    by_kind = {}
    for key in TRANSFORMATIONS:
        by_points = forward(key, image, plane)
        if by_points is not None:
            by_kind[key] = by_points
    kind_of_model = kind_of_fit(fitted)
    viewed = {key: _places_in_viewer(fitted, by_points) for key, by_points in by_kind.items()
              if kind_of_model in (None, key)}
    if not viewed:
        return stated_before if isinstance(stated_before, dict) else None
    # The largest distance in the image [px]; a position that the model cannot project is infinitely
    # far.
    worst = {key: float(np.nan_to_num(np.hypot(*(fitted.project(ground) - at).T), nan=np.inf
                                      ).max(initial=0.0)) for key, (ground, at) in viewed.items()}
    # The simplest kind that is nearly as near as the nearest.
    key = next(key for key in viewed if worst[key] <= min(worst.values()) + _ALIKE_PX)
    kind = TRANSFORMATIONS[key]
    ignored = ", and ignores heights" if fitted.model.uses_height else ""
    say_deviation(FORMAT_NAME, fitted, *viewed[key], f", by a viewer with {kind.label}{ignored}")
    return stated_before if kind_of(stated_before) is kind else kind.statement


def _places_in_viewer(fitted: Fit, by_points: Forward) -> tuple[FloatArray, FloatArray]:
    """Return ground (m, 3) where a viewer puts places all over the image, and these places (m, 2).

    Places that it puts nowhere are left out, and so are those in the sky of an oblique photo, for
    which the model has no ground. All are kept if the model has ground for none.
    """
    height = float(fitted.ground_box()[0][2]) if fitted.model.uses_height else 0.0
    # All over the image, as a viewer shows all of it, and not at the points alone; but not in the
    # sky of an oblique photo, where no place is right.
    at = spread_places(fitted)
    on_ground = np.isfinite(fitted.locate(at, np.full(len(at), height))).all(axis=1)
    if on_ground.any():
        at = at[on_ground]
    # Web Mercator ends at the poles, and a transformation may leave it.
    lonlat = from_mercator(by_points(at))
    is_finite = np.isfinite(lonlat).all(axis=1)
    at = at[is_finite]
    lonlat = lonlat[is_finite]
    to_crs = transformation_between("EPSG:4979", fitted.control.crs, strict=False)
    ground = to_crs(np.column_stack([lonlat, np.full(len(at), height)]))
    finite = np.isfinite(ground[:, :2]).all(axis=1)
    return np.asarray(ground[finite]), at[finite]


def _attribute(result: Result, name: str) -> str:
    """Return an attribute of the first point that has it, as text; "" if no point has it."""
    # The reader gives it to the first point, which may have been left out since.
    cells = result.features.points.attributes.get(name, ())
    return next((str(cell) for cell in cells if cell), "")


def _json_of_attribute(result: Result, name: str) -> Any:
    """Return the value of an attribute of the points, read as JSON; None if no point has it."""
    text = _attribute(result, name)
    return json.loads(text) if text else None


def _shorten_px(value: float) -> float | int:
    """Return a position [px] to nine decimals, without those that rounding leaves in a sum."""
    return _plain_number(round(value, 9))


def _plain_number(value: float) -> float | int:
    """Return a whole number as an integer, which JSON writes without decimals; others unchanged."""
    return int(value) if value == int(value) else value
