"""Ground lines of a GIS, joined with the image lines that were measured for them."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from itertools import chain
from math import isfinite
from pathlib import Path
from shlex import quote

import numpy as np

from termsel.core.errors import TermselError, first_names_in_words
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray, Lines
from termsel.data.tables.columns import LINES
from termsel.data.tables.tabular import columns_of, common_attributes
from termsel.formats.base import Reader, error_in_file, read_head
from termsel.formats.readers.geojson import Feature, numbers_at, read_geojson, sniff_geojson
from termsel.formats.readers.tables import read_table
from termsel.formats.readers.vector import LAYER, is_vector, read_layer

log = logging.getLogger(__name__)

_IMAGE = {name: LINES[name] for name in ("id", "line1", "sample1", "line2", "sample2")}
_GEOMETRIES = {"LineString": 1, "MultiLineString": 2}

_JOIN = (
    Option("image_lines", None, "Table of image lines: id,line1,sample1,line2,sample2. Pieces of "
                                "one line have the same id."),
    Option("join", "id", "Property or column with the id of each ground line."),
)


class GeoJsonLines(Reader):
    """Ground lines as GeoJSON, joined with image lines.

    The image lines are a table, or the property `ji` of each ground line: a list of [column, row]
    along it, which need not be conjugate to the ground vertices. The page on ground lines shows
    how polylines are joined. Without a "crs" of its own the file is in WGS84.
    """

    states_origin = False
    name = "geojson-lines"
    summary = "GeoJSON ground lines; image lines as the property ji or in a table (--image-lines)"
    declared_options = _JOIN

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a collection of lines."""
        return sniff_geojson(head, "(Multi)?LineString")

    def read(self, path: Path) -> FeatureSet:
        """Return the lines; errors name file, feature and property."""
        features, crs = read_geojson(path, _GEOMETRIES)
        has_heights = any(isfinite(vertex[2]) for feature in features
                          for vertices in feature.vertex_lists for vertex in vertices)
        # RFC 7946: longitude, latitude and, where there is one, the height above the ellipsoid.
        return _join_image_lines(
            path, features, crs or ("EPSG:4979" if has_heights else "EPSG:4326"), **self.options)


class VectorLines(Reader):
    """Ground lines of a GeoPackage, Shapefile or FlatGeobuf, joined as in GeoJSON."""

    states_origin = False
    name = "vector-lines"
    summary = "GeoPackage, Shapefile, FlatGeobuf of ground lines; requires --image-lines, pyogrio"
    declared_options = (*_JOIN, LAYER)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for the first bytes of a GeoPackage, Shapefile or FlatGeobuf."""
        return is_vector(head)

    def read(self, path: Path) -> FeatureSet:
        """Return the lines; errors name file and feature."""
        options = dict(self.options)
        features, crs = read_layer(path, options.pop("layer"), _GEOMETRIES, "--set layer=NAME")
        return _join_image_lines(path, features, crs, **options)


def _no_join_error(path: Path, join: str, names: list[str]) -> TermselError:
    """Return the error for ground lines without the property that shows which is which."""
    if names:
        hint = (f"Their properties are {', '.join(names)}. Say which one does: "
                f"--set join={_example_of(names)}.")
    else:
        hint = f"They have no properties. Give each line a property {join!r}."
    error = TermselError(f"the ground lines have no property {join!r} that names each line",
                         file=path, hint=hint)
    if len(names) == 1:
        error.options["--set"] = f"join={names[0]}"
    return error


def _no_image_lines_error(path: Path, join: str, names: list[str]) -> TermselError:
    """Return the error for lines on the ground alone, with all options that join them."""
    joined_by = f" --set join={_example_of(names)}" if names and join not in names else ""
    return TermselError(
        "the file has lines on the ground alone", file=path,
        hint="Give their image lines as a table id,line1,sample1,line2,sample2: --lines "
             f"{quote(str(path))} --image-lines FILE{joined_by}. Or give each line the property "
             "ji, a list of [column, row].")


def _example_of(names: list[str]) -> str:
    """Return the only name, or the word that stands for one of several."""
    return quote(names[0]) if len(names) == 1 else "PROPERTY"


def _join_image_lines(path: Path, features: list[Feature], crs: str, image_lines: str | None,
                      join: str) -> FeatureSet:
    """Return the lines of a GIS together with the image lines of their ids, piece by piece.

    Parameters
    ----------
    path, features : the file of ground lines, and its features
    crs : str
    image_lines : the table of lines measured in the image; None where features have them (`ji`)
    join : the property whose value is the id in that table

    A feature with several lines has as many pieces, which share its id. Raises TermselError where
    the property is missing, or an image line has no ground; ground lines that were not measured are
    counted in the log.
    """
    names = list(dict.fromkeys(chain.from_iterable(feature.properties for feature in features)))
    if image_lines is None and "ji" not in names:
        raise _no_image_lines_error(path, join, names)
    if join not in names:
        raise _no_join_error(path, join, names)
    ground: dict[str, list[FloatArray]] = {}
    described: dict[str, list[dict[str, str]]] = {}
    image = {} if image_lines is None else _read_image_lines(Path(image_lines))
    for feature in features:
        name = feature.text(join)
        if image_lines is None:
            if not name:
                raise feature.error("its id is blank", join, "Give every line an id.")
            # A feature of several lines has a piece of the image line for each.
            image.setdefault(name, []).extend(_image_lines_of_ji(feature))
        if name in image:
            ground.setdefault(name, []).extend(
                _drop_repeated_vertices(np.array(vertices)) for vertices in feature.vertex_lists)
            described.setdefault(name, []).append(feature.attributes({join, "ji", "sigma"}))
    # Only an image line without ground is a mistake: not every ground line is measured.
    missing = [name for name in image if name not in ground]
    if missing:
        raise TermselError(f"{len(missing)} of {len(image)} image lines have no ground line: "
                           f"{first_names_in_words(missing)}", file=path, column=join,
                           hint="Check the ids, or choose their column with --set join=NAME.")
    idle = len({feature.text(join) for feature in features}) - len(image)
    if idle:
        log.info("Lines: %d of %s are not used, as they were not measured in the "
                 "image.", idle, path.name)
    ids: list[str] = []
    images: list[FloatArray] = []
    grounds: list[FloatArray] = []
    for name, measured in image.items():
        try:
            for image_piece, ground_piece in _pieces_of_feature(name, measured, ground[name]):
                ids.append(name)
                images.append(image_piece)
                grounds.append(ground_piece)
        except TermselError as error:
            raise error_in_file(error, path) from error
    # Pieces of one feature have one description, where theirs agree.
    shared = {name: common_attributes(rows) for name, rows in described.items()}
    try:
        lines = Lines(tuple(ids), np.stack(images), np.stack(grounds),
                      attributes=columns_of([shared[name] for name in ids]))
    except TermselError as error:
        raise error_in_file(error, path) from error
    return FeatureSet(lines=lines, crs=crs)


def _pieces_of_feature(name: str, image: list[FloatArray], ground: list[FloatArray],
                       ) -> Iterable[tuple[FloatArray, FloatArray]]:
    """Yield image and ground, (2, 2) and (2, 3), of the pieces of one feature.

    `image` are its image lines, (2, 2) each, and `ground` its ground lines, (n, 3) each. A single
    image line holds for all of the ground; of several, each is that of one ground segment, in
    order. Raises TermselError for a line of zero length, and for other numbers of pieces.
    """
    if any(len(vertices) < 2 for vertices in ground):
        raise TermselError(f"line {name!r} has zero length on the ground", ids=[name],
                           hint="A control line needs two different points.")
    if len(image) == 1:
        # All vertices lie on a single image line, whatever their number. They are taken in pairs,
        # each vertex once; an odd last one is paired with the vertex before it.
        for vertices in ground:
            for start in range(0, len(vertices), 2):
                start = min(start, len(vertices) - 2)
                yield image[0], vertices[start:start + 2]
        return
    segments = []
    for vertices in ground:
        segments += [vertices[i:i + 2] for i in range(len(vertices) - 1)]
    if len(segments) != len(image):
        raise TermselError(
            f"line {name!r} has {len(image)} pieces in the image and {len(segments)} on the ground",
            ids=[name], hint="Measure one image line for the whole of a straight line, or one for "
                             "each segment of the ground line, in order.")
    yield from zip(image, segments, strict=True)


def _drop_repeated_vertices(vertices: FloatArray) -> FloatArray:
    """Return vertices (n, 3) without those at the X and Y of the previous one."""
    # A vertex that is there twice would give a segment without a direction.
    moved = (vertices[1:, :2] != vertices[:-1, :2]).any(axis=1)
    return np.asarray(vertices[np.concatenate([[True], moved])])


def _read_image_lines(path: Path) -> dict[str, list[FloatArray]]:
    """Return the image lines by id, each (2, 2) line and sample, in the order of the rows."""
    read_head(path, "Expected a table headed id,line1,sample1,line2,sample2.")
    table = read_table(path, _IMAGE)
    image: dict[str, list[FloatArray]] = {}
    for name, ends in zip(table.ids(), table.stack("line1", "sample1", "line2", "sample2"),
                          strict=True):
        image.setdefault(name, []).append(ends.reshape(2, 2))
    return image


def _image_lines_of_ji(feature: Feature) -> list[FloatArray]:
    """Return the image lines, (2, 2) each, along the property ji.

    Raises TermselError if it has fewer than two vertices.
    """
    ji = feature.pixels()
    if not numbers_at(ji, 1, (2,)) or len(ji) < 2:
        raise feature.error(
            "it has no image line", "ji", "Give a table of image lines with --image-lines FILE, or "
            "the property ji as a list of [column, row].")
    vertices = np.array(ji, dtype=np.float64)[:, ::-1]
    return [vertices[i:i + 2] for i in range(len(vertices) - 1)]
