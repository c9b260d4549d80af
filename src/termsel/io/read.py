"""Files of ground control features, read by the installed readers."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from difflib import get_close_matches
from functools import partial
from itertools import zip_longest
from pathlib import Path
from shlex import quote
from typing import Any
from zipfile import is_zipfile

import numpy as np

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, count_in_words, unknown_name_error
from termsel.core.files.atomic import private_folder
from termsel.core.files.names import JOURNAL, is_there
from termsel.core.isolation.faults import PluginFault, is_own, name_of
from termsel.core.isolation.parts import missing_package_error, values_of_slot
from termsel.core.options import Option
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import (
    LOCAL,
    WGS84,
    CrsLike,
    crs_text,
    normalise,
    short_crs_name,
)
from termsel.data.coordinates.crs_columns import note_on_other_crs
from termsel.data.coordinates.earth import say_turned, unknown_crs_error
from termsel.data.coordinates.plausible import check_ground, note_on_wrong_coordinates
from termsel.data.coordinates.true_lengths import note_on_scale, with_degrees
from termsel.data.features import FeatureSet, empty_lines, empty_points
from termsel.data.georeferenced import warn_of_incomplete, warn_of_map
from termsel.data.image_files import image_file_of
from termsel.data.roles import asked_roles, with_roles
from termsel.data.rpc import Rpc
from termsel.data.tables.columns import LINES, OPTIONAL, POINTS, columns_text, parse_columns
from termsel.formats.base import (
    Reader,
    error_in_file,
    parse_json,
    read_head,
    read_once,
    read_text,
)
from termsel.formats.crs_files import crs_next_to, prj_next_to, stated_crs, warn_of_other_crs
from termsel.formats.heights import with_heights
from termsel.formats.image_origin import (
    IMAGE_ORIGIN,
    UP,
    image_size_of,
    note_on_exif_orientation,
    require_inside,
    say_other_number,
    with_image_origin,
)
from termsel.formats.readers.advice import (
    EXPECTED,
    TO_MEASURE,
    keep_readable_guesses,
    unknown_table_error,
)
from termsel.formats.readers.tables import TableReader
from termsel.formats.repeated import REPEATED, average_while_reading
from termsel.formats.rpc_files import read_delivered_rpc, size_with_rpc, with_rpc
from termsel.formats.stated_roles import stating_roles, without_off
from termsel.formats.swapped import SWAPPED, exchange_back
from termsel.formats.z_unit import Z_UNIT, refuse_other_units, with_z_unit
from termsel.models.image_part import RPC_OFFSET, RPC_SCALE, ImagePart, part_of
from termsel.plugins.registry import built_in, registry

log = logging.getLogger(__name__)

Origin = Callable[..., FeatureSet]
"""Takes features and whether their format says where it counts from; see `with_image_origin`."""

READ_OPTIONS = (Z_UNIT, RPC_OFFSET, RPC_SCALE, REPEATED, IMAGE_ORIGIN, SWAPPED)
"""Options of reading, whatever the format; see `read_options` for those of packages."""

CHOSEN, PROJECTION = "auto", "projection"
"""CRS of degrees of a map whose projection is chosen, and the option of reading that does so."""

OF_PACKAGES = "reading"
"""Place of parts with options of reading: each has `options`, and `read` features with them."""

_THE_TABLE = Path("the table")
"""What messages call a table in Python, which has no file."""

_LEAST_LIKENESS = 0.76
"""Likeness, by difflib: sgima_line and roles are near a name, rule is not."""

_NOISE = bytes(range(1, 256)) * 4
"""What no reader recognises, unless it recognises anything."""


@explains_arguments()
def read(
    points: Any = None,
    lines: Path | str | None = None,
    *,
    areas: Path | str | None = None,
    crs: CrsLike | None = None,
    format: str | Sequence[str] = (),
    dem: Path | str | None = None,
    columns: str | Mapping[str, Any] | None = None,
    rpc: Rpc | Path | str | None = None,
    z_unit: str | None = None,
    rpc_offset: str | None = None,
    rpc_scale: float | str | None = None,
    repeated: str | None = None,
    image: Path | str | None = None,
    image_origin: str | None = None,
    swapped: str | None = None,
    off: str | None = None,
    role: str | None = None,
    **options: Any,
) -> FeatureSet:
    """Return the control features in files of points, lines and areas.

    Parameters
    ----------
    points : path-like or table, optional
        A file, or a DataFrame of pandas or geopandas, a list of dicts or a dict of columns.
    lines, areas : path-like, optional
        Files; at least one of the three is given. Areas become lines or, with
        ``areas_as="centroid"``, points.
    crs : str, int or CRS, optional
        CRS of the ground coordinates, where no file declares it: "EPSG:n" or the number n, "WGS84
        UTM 16N", WKT, a string of PROJ, a CRS of pyproj or rasterio, "local", or a file that has
        it: WKT, a raster or a layer; "auto" for degrees on an old map, whose projection is chosen
        (termsel-cameras). By default that in a file NAME.prj next to the points.
    format : str or sequence of str, optional
        Names of the readers, in the order of the files; by default judged by the content.
    dem : path-like, optional
        Raster of heights, from which unknown ones are taken; see
        `termsel.formats.heights.with_heights`.
    columns : str or mapping, optional
        Which column of a table is which, by name or number: "line=Zeile,sample=4".
    rpc : Rpc or path-like, optional
        The vendor's RPC of the image: a file that `read_rpc` reads, or the image itself.
    z_unit : {"metre", "us-ft", "ft", "crs"}, optional
        Unit of z, where the CRS does not say it; "crs" is that of x and y.
    rpc_offset : str, optional
        Line and sample of the image that the RPC is of at which this image begins, "700,900" [px].
    rpc_scale : float, optional
        Pixels of the image that the RPC is of in one pixel of this image, along either axis.
    repeated : {"refuse", "average"}, optional
        What is done with points of a table at the same ground coordinates: by default they are
        refused, all by name; their mean in the image may stand for them.
    image : path-like, optional
        The image: its size is known from it, and its RPC where it has one and none is given.
    image_origin : str, optional
        Where a table counts lines and samples from: "top-left" for the centre of the upper-left
        pixel, "corner" for its outer corner, "y-up", "y-up-corner", "bottom-left" or
        "bottom-left-corner" for lines upwards.
    swapped : {"xy", "line-sample"}, optional
        Coordinates that the file has exchanged; they are exchanged back.
    off : str, optional
        Ids of features that a run leaves out, with commas between them: they may lie outside the
        image, and their cells in a column of roles are not read.
    role : str, optional
        Roles of points that a run states, "P07=check,P12=control": their cells in a column of roles
        are not read.
    **options
        Options of the readers, such as `raster` of "qgis-points", and of packages, such as
        `camera_focal` of termsel-cameras.

    Returns
    -------
    FeatureSet
        Points and lines with their CRS; line and sample are 0 in the centre of the first px.

    Raises
    ------
    TermselError
        Naming file, line and column, for anything the user can correct.

    Examples
    --------
    >>> import termsel
    >>> rows = [{"id": "A", "line": 10.0, "sample": 20.0, "x": 500000.0, "y": 4e6, "z": 100.0},
    ...         {"id": "B", "line": 30.0, "sample": 40.0, "x": 500100.0, "y": 4e6, "z": 110.0}]
    >>> features = termsel.read(rows, crs="EPSG:32639")
    >>> features.ids
    ('A', 'B')
    """
    # Options are those of packages, such as the camera of termsel-cameras, or of the readers.
    given_options = {key: value for key, value in options.items() if value is not None}
    of_packages = {option.name: given_options.pop(option.name) for option in read_options()
                   if option.name in given_options} if given_options else {}
    crs = None if crs is None else crs_text(crs)
    if crs is not None and crs.strip().lower() == CHOSEN:
        if not any(option.name == PROJECTION for option in read_options()):
            raise missing_package_error(PROJECTION, f"--crs {CHOSEN} requires")
        of_packages.setdefault(PROJECTION, CHOSEN)
        crs = CHOSEN
    of_readers = given_options
    if columns:
        of_readers["columns"] = columns_text(columns)
    formats = [format] if isinstance(format, str) else format
    size = None if image is None else image_size_of(image)
    # An image may have its RPC inside it or beside it, as vendors deliver it.
    if rpc is None and image is not None:
        rpc = read_delivered_rpc(image)
    image_part = part_of(rpc_offset, rpc_scale)
    size_for_origin = size_with_rpc(rpc) if size is None and image_part is None else size
    origin = partial(with_image_origin, choice=image_origin, size=size_for_origin)
    if image_part is not None and rpc is None:
        raise TermselError("rpc_offset and rpc_scale are of an RPC, and none is given",
                           hint="Give it with --rpc FILE, or leave them out.")
    if points is not None and not isinstance(points, str | Path):
        if lines is not None or areas is not None or format:
            raise TermselError("a table in Python is read alone",
                               hint="Read files by themselves and join them with "
                                    "FeatureSet.with_.")
        with average_while_reading(repeated), stating_roles(off, role):
            features = _with_image_size(
                _read_frame(points, crs, of_readers, origin, swapped, z_unit=z_unit), image, size,
                off)
            features = _with_rpc_and_heights(features, dem, rpc, z_unit, image_part,
                                             asked_roles(off, role))
            return _with_packages(features, of_packages, image)
    # Each file is read once, though it may be given as points and lines: a pipe ends.
    with ExitStack() as stack:
        stack.enter_context(average_while_reading(repeated))
        stack.enter_context(stating_roles(off, role))
        image_lines = of_readers.get("image_lines")
        once = {Path(path): stack.enter_context(read_once(Path(path)))
                for path in dict.fromkeys((points, lines, areas, image_lines)) if path is not None}
        paths = [None if path is None else once[Path(path)] for path in (points, lines, areas)]
        if image_lines is not None:
            of_readers["image_lines"] = str(once[Path(image_lines)])
        readers = readers_of([path for path in paths if path is not None], formats)
        if image is not None and paths[0] is not None:
            of_readers |= _options_of_image(paths[0], Path(image), readers, formats, of_readers)
        try:
            features = read_features(*paths[:2], areas=paths[2], crs=crs, readers=readers,
                                     formats=formats, options=of_readers, origin=origin,
                                     swapped=swapped, z_unit=z_unit)
        except TermselError as error:
            if image is not None and error.code == "crs-unknown":
                _propose_prj_of(Path(image), error)
            raise
        features = _with_image_size(features, image, size, off)
        if image is not None and points is not None:
            say_other_number(str(points), image)
    files = [path for path in (points, lines, areas) if path is not None]
    try:
        features = _with_rpc_and_heights(features, dem, rpc, z_unit, image_part,
                                         asked_roles(off, role))
        return _with_packages(features, of_packages, image)
    except TermselError as error:
        raise (error_in_file(error, Path(files[0])) if error.file is None else error) from error


def _propose_prj_of(image: Path, error: TermselError) -> None:
    """Add the .prj beside an image to the error for points without a CRS."""
    prj = prj_next_to(image)
    # It may be that of another map, so it is not taken unasked.
    if prj is not None:
        error.hint = f"{error.hint} If the points are in the CRS beside the image: --crs {prj}."


def _options_of_image(path: Path, image: Path, readers: Sequence[type[Reader]],
                      formats: Sequence[str], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of the reader with which only the points of one image are read.

    One is the part of the file that has the name of the image, unless `options` names an image
    already. The other is the image as the raster of a reader that takes one. There are no options
    for a file of one image.
    """
    reader = find_reader(path, readers, next(iter(formats), None), options)
    image_options: dict[str, Any] = {}
    if "image_name" not in options:
        options_by_part = {name.casefold(): part for name, part in reader.parts(path).items()}
        # A part may have the name of the image without its ending, as with Metashape.
        name = image.name.casefold()
        stem = name.rpartition(".")[0]
        image_options |= options_by_part.get(name) or options_by_part.get(stem) or {}
    takes_raster = any(option.name == "raster" for option in reader.declared_options)
    if takes_raster and "raster" not in options:
        image_options["raster"] = str(image)
    return image_options


def read_options() -> tuple[Option, ...]:
    """Return the options of reading, those of installed packages among them."""
    of_packages: list[Option] = []
    for package in values_of_slot(OF_PACKAGES):
        of_packages += package.options
    return (*READ_OPTIONS, *of_packages)


def refuse_misspelt(options: Iterable[str]) -> None:
    """Raise TermselError for an option that begins as those of reading do and is none of them.

    So camera_fokal is refused, as there is camera_focal.
    """
    names = [option.name for option in read_options()]
    for key in options:
        group, _, further = key.partition("_")
        if further and group in names and key not in names:
            raise unknown_name_error("option", key,
                                     [name for name in names if name.startswith(group)])


def _with_packages(features: FeatureSet, values: Mapping[str, Any],
                   image: Path | str | None) -> FeatureSet:
    """Return features with the additions of packages, by their options or by the image."""
    if values or image is not None:
        for package in values_of_slot(OF_PACKAGES):
            features = package.read(features, values, image)
    return features


def parts_of(path: Path, format: str | None = None, **options: Any) -> dict[str, dict[str, Any]]:
    """Return the options with which `read` takes each part of a file of several, by name."""
    readers = readers_of([path], [format] if format else [])
    return find_reader(path, readers, format, options).parts(path)


def features_of(source: Any, crs: CrsLike | None = None,
                columns: str | Mapping[str, Any] | None = None) -> FeatureSet:
    """Return features, points or lines or both, from a FeatureSet, a file or a table.

    A FeatureSet is returned as it is; files and tables are read as `read` does. `crs` and `columns`
    say what a file or table does not.

    Raises
    ------
    TermselError
        If a file or table cannot be read, or if `crs` or `columns` come with a FeatureSet.
    """
    if isinstance(source, FeatureSet):
        if crs is not None or columns is not None:
            raise TermselError(f"the features have the CRS {source.crs} already",
                               hint="Give crs and columns with a file or a table alone.")
        return source
    crs = None if crs is None else crs_text(crs)
    if not isinstance(source, str | Path):
        return read(source, crs=crs, columns=columns)
    # The same file as one of points and one of lines: it may hold either, or both.
    with read_once(Path(source)) as path:
        features = read_features(
            path, path, crs=crs, either=True,
            options={"columns": columns_text(columns)} if columns else {},
            readers=readers_of([path], ()), origin=partial(with_image_origin, choice=None))
    try:
        return with_z_unit(with_degrees(features), None)
    except TermselError as error:
        raise error_in_file(error, Path(source)) from error


def _with_image_size(features: FeatureSet, image: Path | str | None, size: tuple[int, int] | None,
                     off: str | None) -> FeatureSet:
    """Return features with the file of their image, and its size where they do not state one.

    Without an image or its size they are returned as they are. Raises TermselError for a feature
    outside the image; those that are off, by their own role or by `off` (ids with commas between
    them), may lie there. Warns of an image that is incomplete, whose georeferencing contradicts the
    features, or that other programs show turned.
    """
    if image is None or size is None:
        return features
    # Roles are given later: here they only tell which features may lie outside.
    in_use = with_roles(features, asked_roles(off, None)) if off else features
    require_inside(in_use, size, image)
    warn_of_incomplete(image)
    warn_of_map(features, image)
    note_on_exif_orientation(image)
    return replace(features, image_size=features.image_size or size,
                   image_file=image_file_of(image))


def _with_rpc_and_heights(features: FeatureSet, dem: Path | str | None,
                          rpc: Rpc | Path | str | None, z_unit: str | None,
                          image_part: ImagePart | None, roles: Mapping[str, str]) -> FeatureSet:
    """Return features with an RPC, with z in the unit of the CRS, and with heights from a DEM.

    Each is done only where it is given. Longitudes and latitudes in grads become degrees before.
    `roles` are those that the run asks for, by id; features that are off, by these or by their own
    role, may lie outside the DEM.
    """
    features = with_degrees(features)
    if rpc is not None:
        features = with_rpc(features, rpc, image_part)
    dem_path = None if dem is None else Path(dem)
    features = with_z_unit(features, z_unit, dem_path)
    if dem_path is None:
        return features
    # Points of a table without a column of roles have no role at all.
    own_roles = dict(zip(features.points.ids, features.points.roles, strict=False))
    ids_off = [name for name, role in {**own_roles, **roles}.items() if role == "off"]
    return with_heights(features, dem_path, ids_off)


def readers_of(paths: Sequence[Path], formats: Sequence[str]) -> list[type[Reader]]:
    """Return the readers to ask about files: the built-in ones, or all with those of plugins.

    Looking for plugins takes longer than reading a table. Plugins are not looked for where built-in
    readers recognise every file, and every format in `formats` is theirs.
    """
    built_in_readers: list[type[Reader]] = [
        entry.object for entry in built_in().entries("readers")]
    # True as long as nothing but built-in readers is needed; the first file that is not stops it.
    names = {reader.name for reader in built_in_readers}
    are_recognised = names.issuperset(formats)
    for path in dict.fromkeys(paths):
        if not are_recognised:
            break
        are_recognised = is_there(path) and path.is_file()
        if are_recognised:
            head = read_head(path, EXPECTED)
            are_recognised = any(reader().sniff(path, head) for reader in built_in_readers)
    if are_recognised:
        return built_in_readers
    return [entry.object for entry in registry().entries("readers")]


def _read_frame(frame: Any, crs: str | None, options: Mapping[str, Any],
                origin: Origin | None = None, swapped: str | None = None, *,
                z_unit: str | None = None) -> FeatureSet:
    """Return the features of a table in Python, such as a DataFrame, checked as those of a file.

    `swapped` is what was asked for of columns that are exchanged, None for nothing. Doubts about
    columns and coordinates are logged. Raises TermselError for options that only files have, a
    missing CRS, and coordinates that cannot be.
    """
    from termsel.formats.readers.frames import read_frame

    for name in options.keys() - {"columns", "decimal"}:
        raise TermselError(f"a table in Python has no option {name!r}", hint="Leave it out.")
    features = exchange_back(read_frame(frame, **options), swapped)
    if origin is not None:
        features = origin(features, states_own=False)
    measured = replace(features, crs=_agreed_crs({_THE_TABLE: features}, _stated_crs(crs)))
    _require_crs(measured, [_THE_TABLE], "columns" not in options and swapped is None)
    _warn_of_misspelt(_THE_TABLE, measured)
    refuse_other_units(measured.named_units, measured.crs, are_heights_open=True)
    check_ground(without_off(measured), z_unit)
    _say_doubts(measured)
    return measured


def find_reader(path: Path, readers: Iterable[type[Reader]], format: str | None = None,
                options: Mapping[str, Any] | None = None) -> Reader:
    """Return the reader that recognises the content of a file (see `_reader_that_recognises`).

    `format` names the reader to use, whatever the content looks like. Each reader takes the options
    it declares. Raises TermselError if there is no such reader, an option does not accept its
    value, the file is missing, empty or not readable, or no reader recognises the file or folder.
    """
    usable = []
    # A reader gets its own options alone: those of others are no fault of this file.
    for reader_class in readers:
        declared = {option.name for option in reader_class.declared_options}
        usable.append(reader_class(**{name: value for name, value in (options or {}).items()
                                      if name in declared}))
    named = [reader for reader in usable if reader.name == format]
    if format is not None and not named:
        raise unknown_name_error("file format", format, [reader.name for reader in usable])
    if is_there(path) and path.is_dir():
        readers_of_folders = [reader for reader in named or usable if reader.folders]
        folder_reader = _reader_that_recognises(path, b"", readers_of_folders)
        if folder_reader is not None:
            return folder_reader
        _refuse_own_folder(path)
    # Also where a format is named: a file that is missing or empty is said to be so first.
    head = read_head(path, EXPECTED)
    if named:
        return named[0]
    reader = _reader_that_recognises(path, head, usable)
    if reader is not None:
        return reader
    # No reader knows the content: what it seems to be decides what helps, the surest first.
    if any(name in head for name in (b"LINE_NUM_COEFF", b"lineNumCoef", b"Global_RFM")):
        raise TermselError("this file contains an RPC and no control points", file=path,
                           code="rpc-alone",
                           hint="Give control with --points and the RPC with --rpc; auto then "
                                "corrects it. " + registry().missing("rpc-gcps"))
    _refuse_other_content(path, head)
    error = unknown_table_error(path, EXPECTED, str((options or {}).get("columns", "")))
    if error is not None:
        raise error
    # No spreadsheet, which is an archive as well.
    if head.startswith(b"PK") and is_zipfile(path):
        raise TermselError("this is a ZIP archive", file=path, code="format-unknown",
                           hint="Unpack it, and give the file of points or lines that it has: "
                                f"unzip {quote(str(path))}.")
    binary = b"\0" in head
    rasters = registry().missing("gdal-gcps") if binary or b"<VRTDataset" in head else ""
    raise TermselError(f"this {'binary file' if binary else 'file'} is in no format that termsel "
                       "knows", file=path, code="format-unknown",
                       hint=f"{EXPECTED} If it is a raster with control points, "
                       f"gdal-gcps reads it. {rasters}" if rasters else EXPECTED)


def _refuse_own_folder(path: Path) -> None:
    """Raise TermselError for a folder that termsel wrote, with the command that shows it.

    Other folders pass.
    """
    for name, noun, command in (("result.json", "result", "termsel report"),
                                (JOURNAL, "study", "termsel compare --status"),
                                ("block.json", "block", "termsel report")):
        if (path / name).is_file():
            raise TermselError(f"this folder has a {noun}, expected a file of points or lines",
                               file=path, hint=f"{command} {path} shows the {noun}. For a run give "
                                               "a file.")


def _refuse_other_content(path: Path, head: bytes) -> None:
    """Raise TermselError for settings, web pages, XML, JSON of other content, and damaged JSON.

    No reader recognises the file, and a general message would help nobody: its first bytes, `head`,
    may show what it is. A failed download is a web page, metadata of an image are JSON or XML, and
    GeoJSON may have polygons. Any file called .toml is one of settings. Files of any other content
    pass.
    """
    text = head.decode("utf-8-sig", errors="replace").lstrip()
    if path.suffix.lower() == ".toml":
        raise TermselError("this is a file of settings, expected points or lines", file=path,
                           hint="A study: termsel compare FILE --out DIR. A block: termsel block "
                                "FILE --out DIR.")
    if path.suffix.lower() in (".json", ".geojson") and text[:1] in ("{", "["):
        try:
            parse_json(read_text(path), "Copy or download it again.")
        except TermselError as error:
            raise error_in_file(error, path) from error
    if text[:14].lower().startswith(("<!doctype html", "<html")):
        raise TermselError("this file is a web page, not data", file=path,
                           hint="Often it stands for a download that failed: fetch the data again.")
    # A VRT is a raster, which a package may read.
    if text.startswith("<") and not text.startswith("<VRTDataset"):
        root = re.search(r"<([A-Za-z_][\w.:-]{0,60})", text)
        if root and root[1].lower() == "kml":
            raise TermselError("KML has positions on the ground alone, and none in the image",
                               file=path, hint="Convert it: ogr2ogr points.gpkg FILE. "
                                               f"{TO_MEASURE}")
        name = f" (<{root[1]}>)" if root else ""
        raise TermselError(f"this is XML{name} of no kind that termsel reads, or it is damaged",
                           file=path, hint=EXPECTED)
    if re.match(r'\{\s*"', text) and '"type"' not in text:
        raise TermselError("this is JSON without control points that termsel reads, such as the "
                           "description of an image", file=path, hint=EXPECTED)
    if text.startswith("{") and '"FeatureCollection"' in text:
        geometries = set(re.findall(r'"type"\s*:\s*"((?:Multi)?(?:Point|LineString|Polygon))"',
                                    text))
        if geometries & {"Point", "LineString"}:
            return  # an annotation of another format
        if geometries:
            content = f"geometry of the type {' and '.join(sorted(geometries))}"
        else:
            content = "no geometry"
        raise TermselError(f"this is GeoJSON with {content}", file=path,
                           hint="termsel reads features of the type Point or LineString with the "
                                "image coordinates among their properties. Of polygons give the "
                                "centroids, or a table of the corners as areas.")


def _reader_that_recognises(path: Path, head: bytes, readers: Sequence[Reader]) -> Reader | None:
    """Return the reader that recognises a file by its first bytes; None if none does.

    Of plugins, a general reader stands back if another recognises the file. A built-in reader comes
    before all of them, and those that are left are noted. Otherwise, of several the one is returned
    that does not recognise noise. Raises TermselError if more than one does not, or none.
    """
    built_in_reader = next((reader for reader in readers
                            if is_own(type(reader)) and reader.sniff(path, head)), None)
    claims: list[Reader] = []
    # A reader that fails is passed over, so that it keeps no file from the others.
    for reader in readers:
        if is_own(type(reader)):
            continue
        try:
            if reader.sniff(path, head):
                claims.append(reader)
        except PluginFault as fault:
            log.warning("Warning: %s", fault)
    # A general reader, as of any JSON, stands back behind one of a certain format.
    claims = [reader for reader in claims if not reader.general] or claims
    if built_in_reader is not None:
        for reader in claims:
            log.warning("Note: %s recognises %s too; %s reads it so.", name_of(reader),
                        path.name, Remedy("format", reader.name))
        return built_in_reader
    if len(claims) < 2:
        return claims[0] if claims else None
    selective_readers = [reader for reader in claims if not _recognises_noise(reader, path)]
    if len(selective_readers) == 1:
        return selective_readers[0]
    names = [reader.name for reader in claims]
    raise TermselError(
        f"several readers recognise this file: {', '.join(map(name_of, claims))}", file=path,
        hint=f"Choose one: {' or '.join(str(Remedy('format', name)) for name in names)}.")


def _recognises_noise(reader: Reader, path: Path) -> bool:
    """Return whether a reader recognises random bytes as its format, too; if so, warn.

    `path` is the file that it recognised.
    """
    with private_folder() as folder:
        # Of the same name, as a reader may go by the ending.
        noise = folder / path.name
        noise.write_bytes(_NOISE)
        if not reader.sniff(noise, _NOISE):
            return False
    log.warning("Warning: %s recognises any file, so it is not used without %s.",
                name_of(reader), Remedy("format", reader.name))
    return True


def read_features(points: Path | None, lines: Path | None, *, areas: Path | None = None,
                  crs: str | None, readers: Iterable[type[Reader]], formats: Sequence[str] = (),
                  options: Mapping[str, Any] | None = None, either: bool = False,
                  origin: Origin | None = None, swapped: str | None = None,
                  z_unit: str | None = None) -> FeatureSet:
    """Return the points, lines and areas of one file each, in one CRS.

    A file that holds points and lines is given as both; with `either`, it may have points or lines
    alone. Areas become points or lines. `formats` names readers, in the order of the files.
    `origin` turns image coordinates of formats that leave open where they count from; `swapped`
    says which coordinates the files have exchanged, `z_unit` in what unit heights are.

    Raises TermselError if no reader can be found (`find_reader`); if the content is invalid; if no
    file's reader has an option that is given; if a file holds no features of its kind, or others
    that were not asked for; if the CRS is not known, or is stated twice and differently; if
    coordinates cannot be in it; if features of two kinds have one id.
    """
    read_with = partial(_features_of_files, points, lines, areas=areas, readers=list(readers),
                        formats=formats, either=either, origin=origin, swapped=swapped,
                        z_unit=z_unit)
    try:
        return read_with(crs=crs, options=options or {})
    except TermselError as error:
        if error.guesses:
            if "--set" in error.options:
                # The guesses take lines as counted upwards, which this option would state.
                read_guess = partial(read_with,
                                     origin=partial(with_image_origin, choice=UP, size=None))
            else:
                read_guess = read_with
            error = keep_readable_guesses(error, partial(
                _fitness_of_columns, read_guess, crs, options or {}))
        columns = error.options.get("--columns", "?")
        # A message proposes all that is still missing. Where the same columns were given already,
        # or some are not known, nothing else would be asked next.
        if crs is None and "?" not in columns and columns != (options or {}).get("columns"):
            next_options = _options_asked_next(read_with, {**(options or {}), "columns": columns})
            error.options = {**next_options, **error.options}
        raise


def _options_asked_next(read_with: Callable[..., FeatureSet],
                        options: Mapping[str, Any]) -> dict[str, str]:
    """Return the options that a message would ask for if `options` were given.

    Without any error the files can be read with these options, and there are no further ones.
    """
    try:
        with _silence_log():
            read_with(crs=None, options=options)
    except TermselError as error:
        return error.options
    return {}


def _fitness_of_columns(read_with: Callable[..., FeatureSet], crs: str | None,
                        options: Mapping[str, Any], columns: str) -> int:
    """Return 0 if files cannot be read with these columns, 1 if they can, 2 also within their CRS.

    Where no CRS is stated, they may also be read as plane coordinates without one: it is the
    columns that are tried, and the CRS is asked for next.
    """
    for stated in (crs,) if crs is not None else (None, LOCAL):
        try:
            with _silence_log():
                features = read_with(crs=stated, options={**options, "columns": columns})
        except TermselError:
            continue
        # What lies beyond the area of the stated CRS is hardly what its columns are meant for.
        return 1 if note_on_wrong_coordinates(without_off(features)) else 2
    return 0


@contextmanager
def _silence_log() -> Iterator[None]:
    """Log nothing during the block, in which readings are only tried."""
    logger = logging.getLogger("termsel")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


def _features_of_files(points: Path | None, lines: Path | None, *, areas: Path | None,
                       crs: str | None, readers: Sequence[type[Reader]], formats: Sequence[str],
                       options: Mapping[str, Any], either: bool,
                       origin: Origin | None, swapped: str | None,
                       z_unit: str | None) -> FeatureSet:
    """Return the features of all files in one CRS, checked, for the arguments of `read_features`.

    These steps follow each other, as each needs the one before: the reader of each file, its
    features with axes exchanged and counted from the upper left, their kinds, the CRS in which all
    files agree, units of columns, and positions that the CRS can have. Every error names the file;
    doubts about columns and positions are logged.

    Raises TermselError without any file, for more formats than files, and where one of these steps
    fails.
    """
    if points is None and lines is None and areas is None:
        raise TermselError("no file of points or lines is given",
                           hint="Give --points FILE, --lines FILE or --areas FILE.")
    # What the user states holds for all files, and is needed before the first is read.
    stated = _stated_crs(crs)
    paths = list(dict.fromkeys(path for path in (points, lines, areas) if path is not None))
    if len(formats) > len(paths):
        raise TermselError(f"{len(formats)} formats are given for "
                           f"{count_in_words(len(paths), 'file')}",
                           hint="Give --format once per file, that of the points first.")
    # A file for which no format is given has None, and is recognised by its content.
    reader_of = {path: find_reader(path, readers, format_name, options)
                 for path, format_name in zip_longest(paths, formats)}
    _refuse_idle(options, reader_of)
    sets = _read_each_file(reader_of, origin, swapped, is_format_named=bool(formats))
    for path, features in sets.items():
        _warn_of_misspelt(path, features)
        if reader_of[path].areas or path == areas:
            _check_areas(path, reader_of[path], path == areas and path not in (points, lines))
            continue
        counts = {"points": len(features.points), "lines": len(features.lines)}
        # A file that may hold either kind is judged by what it holds.
        if not (either and any(counts.values())):
            _require_given_kinds(path, counts, {"points": path == points, "lines": path == lines})
    # What describes the image and the columns is taken from the first file that states it.
    image_sizes = [features.image_size for features in sets.values() if features.image_size]
    image_origins = [features.image_origin for features in sets.values() if features.image_origin]
    named_units = [features.named_units for features in sets.values() if features.named_units]
    measured = FeatureSet(
        empty_points() if points is None else sets[points].points,
        empty_lines() if lines is None else sets[lines].lines,
        _agreed_crs(sets, stated),
        image_sizes[0] if image_sizes else None,
        image_origin=image_origins[0] if image_origins else "",
        named_units=named_units[0] if named_units else {})
    # Where the columns were declared, swapped axes are no mistake of a guess.
    _require_crs(measured, sets, not options.get("columns") and swapped is None)
    for path, features in sets.items():
        try:
            refuse_other_units(features.named_units, measured.crs, are_heights_open=True)
        except TermselError as error:
            raise error_in_file(error, path) from error
    if areas is not None:
        measured = _with_areas(measured, sets[areas], areas)
    try:
        check_ground(without_off(measured), z_unit)
    except TermselError as error:
        # The first feature at fault names the file in which it is.
        path = next(path for path, features in sets.items() if error.ids[0] in features.ids)
        raise reader_of[path].placed(error, path) from error
    _say_doubts(measured)
    return measured


def _read_each_file(reader_of: Mapping[Path, Reader], origin: Origin | None, swapped: str | None,
                    *, is_format_named: bool) -> dict[Path, FeatureSet]:
    """Return the features of each file, in image coordinates from the centre of the first pixel.

    Coordinates that are `swapped` are exchanged back, and `origin` turns image coordinates that
    count from elsewhere. All files are read before any is turned. Errors name the file; where the
    user named a format, the hint on a missing column says that this may be wrong.
    """
    sets: dict[Path, FeatureSet] = {}
    for path, reader in reader_of.items():
        try:
            features = reader.read(path)
            sets[path] = features if swapped is None else exchange_back(features, swapped)
        except TermselError as error:
            if is_format_named and error.code == "column-missing":
                error.hint = f"{error.hint} Without --format the content tells the format."
            raise
    if origin is None:
        return sets
    # A file that cannot be read is the first fault to be told, before any note on an origin.
    for path, reader in reader_of.items():
        try:
            sets[path] = origin(sets[path], states_own=reader.states_origin,
                                default=reader.default_origin)
        except TermselError as error:
            raise error_in_file(error, path) from error
    return sets


def _say_doubts(features: FeatureSet) -> None:
    """Warn of coordinates that the CRS can have and that are nevertheless likely to be wrong.

    They are if a column names another CRS, if only some of the coordinates fit the CRS, or if axes
    look swapped. A projection that stretches lengths is noted. Features that are off are not
    looked at.
    """
    features_in_use = without_off(features)
    if crs_doubt := note_on_other_crs(features_in_use):
        log.warning("Warning: %s", crs_doubt)
    # Where only some coordinates are wrong, whether all look swapped means nothing.
    if coordinate_doubt := note_on_wrong_coordinates(features_in_use):
        log.warning("Warning: %s", coordinate_doubt)
    else:
        say_turned(features_in_use)
    note_on_scale(features_in_use)


def _warn_of_misspelt(path: Path, features: FeatureSet) -> None:
    """Warn of columns that take no part in the fit and have nearly the name of one that does."""
    points = features.points
    lines = features.lines
    for features_of_kind, columns, roles in (
            (points, POINTS, points.roles), (lines, LINES, ())):
        # A column that was read cannot be the one that the misspelt name was meant for.
        was_read = {"role": any(roles), "enabled": any(roles)}
        missing: list[str] = []
        for meaning in sorted(OPTIONAL & columns.keys()):
            if not was_read.get(meaning, features_of_kind.sigma is not None):
                missing += columns[meaning]
        for name in features_of_kind.attributes:
            for near in get_close_matches(name.casefold(), missing, n=1, cutoff=_LEAST_LIKENESS):
                log.warning("Warning: column %r of %s is not used. Did you mean %s?",
                            name, path, near)


def _check_areas(path: Path, reader: Reader, asked_for: bool) -> None:
    """Raise TermselError where a file of areas is given as another one, or another one as areas.

    `asked_for` says whether the file was given as areas alone, and not also as points or lines.
    """
    if not reader.areas:
        raise TermselError("this is a file of points or lines, not of areas", file=path,
                           hint="Give points with --points and lines with --lines.")
    if not asked_for:
        raise TermselError("the file has areas", file=path,
                           hint="Give it as areas, not as points or lines: termsel run "
                                f"--areas {path}.")


def _with_areas(features: FeatureSet, areas: FeatureSet, path: Path) -> FeatureSet:
    """Return the features together with the areas, as points or lines as they were read.

    Raises TermselError, with the file of the areas, for an id that both have, and for features that
    do not go together.
    """
    shared_ids = set(features.ids) & set(areas.ids)
    if shared_ids:
        raise TermselError(f"{min(shared_ids)!r} is the id of an area and of a point or line",
                           file=path, hint="Give one of them another id.", ids=shared_ids)
    try:
        return features.with_(points=features.points.join(areas.points),
                              lines=features.lines.join(areas.lines))
    except TermselError as error:
        raise error_in_file(error, path) from error


def _refuse_idle(options: Mapping[str, Any], reader_of: Mapping[Path, Reader]) -> None:
    """Raise TermselError for an option of reading, or a declared column, that no reader here takes.
    """
    for key in options:
        if not any(key in reader.options for reader in reader_of.values()):
            names = dict.fromkeys(reader.name for reader in reader_of.values())
            raise TermselError(
                f"{' and '.join(names)} {'have' if len(names) > 1 else 'has'} no option {key!r}",
                file=" and ".join(map(str, reader_of)),
                hint="Remove it, or choose another format with --format.")
    if columns := str(options.get("columns", "")):
        _refuse_idle_columns(columns, reader_of)


def _refuse_idle_columns(columns: str, reader_of: Mapping[Path, Reader]) -> None:
    """Raise TermselError for a meaning of a column that no table among these files has."""
    tables = [reader for reader in reader_of.values() if isinstance(reader, TableReader)]
    if len(tables) < len(reader_of):
        return  # readers of other formats have meanings of their own
    known = {meaning: None for reader in tables for meaning in reader.aliases}
    idle = [meaning for meaning in parse_columns(columns) if meaning not in known]
    if idle:
        nearest = _nearest_meaning(idle[0], known)
        raise TermselError(
            f"--columns names {' and '.join(idle)}, which this table does not have",
            file=" and ".join(map(str, reader_of)),
            hint=f"Its columns are {', '.join(known)}: --columns {nearest}=NAME.")


def _nearest_meaning(meaning: str, known: Collection[str]) -> str:
    """Return the known meaning of a column that is nearest to another one, else "line".

    A table of points knows no line1 and x2: their names without the digit, line and x, are it.
    """
    stem = meaning.rstrip("12")
    return next((name for name in known if name.startswith(stem)), "line")


def _require_given_kinds(path: Path, counts: dict[str, int], expected: dict[str, bool]) -> None:
    """Raise TermselError where a file lacks features it was given for, or has others as well.

    Both mappings are by "points" and "lines": `counts` has the features that the file holds, and
    `expected` whether it was given as a file of them.
    """
    kinds_present = [kind for kind, count in counts.items() if count]
    for kind in counts:
        if expected[kind] and kind not in kinds_present:
            hint = " ".join(
                f"It has {present}, and is given for them already: leave --{kind} out."
                if expected[present] else f"It has {present}: give it with --{present}."
                for present in kinds_present)
            raise TermselError(f"the file has no {kind}", file=path, hint=hint or None)
    for kind in kinds_present:
        if not expected[kind]:
            raise TermselError(f"the file also has {kind}", file=path,
                               hint=f"Give it with --{kind} too, or keep points and lines in "
                                    "separate files.")


def _stated_crs(crs: str | None) -> str | None:
    """Return the normal form of a CRS that is stated; CHOSEN and None stay as they are."""
    return crs if crs == CHOSEN else stated_crs(crs)


def _agreed_crs(sets: dict[Path, FeatureSet], stated: str | None) -> str:
    """Return the CRS of all files: that which is stated, or that in which they agree.

    `sets` are the features by their file, and `stated` is what the user says. A .prj file beside a
    table counts where neither says anything. EPSG:4326 and EPSG:4979 agree where only one of them
    has heights. What the user says counts where coordinates are not possible in the CRS that their
    file declares, and a warning says so. Raises TermselError where two files, or a file and the
    user, contradict each other. Where the projection is to be chosen, files that declare none are
    in degrees.
    """
    if stated == CHOSEN:
        return _agreed_crs(sets, None) or "EPSG:4326"
    agreed = stated
    source = "--crs"
    for path, features in sets.items():
        # A .prj file is looked for only where nobody says the CRS.
        crs = features.crs or ("" if stated else crs_next_to(path))
        if not crs:
            if stated:
                warn_of_other_crs(path, stated)
            continue
        try:
            declared = normalise(crs)
        except TermselError as error:
            raise error_in_file(error, path) from error
        if agreed is None:
            agreed = declared
            source = str(path)
        elif {declared, agreed} == WGS84 and _may_add_heights(sets.values(), stated):
            agreed = "EPSG:4979"
        elif declared != agreed and stated and _contradicts_crs(features, declared):
            log.warning("Warning: %s declares the CRS %s, in which its coordinates are not "
                        "possible. %s is used.", path, short_crs_name(declared),
                        Remedy("crs", short_crs_name(stated)))
        elif declared != agreed:
            difference = ("They differ in the heights alone. " if {declared, agreed} == WGS84
                          else "")
            if stated:
                remedy = "Leave --crs out, or correct the file"
            else:
                remedy = "Transform one of the files, or correct what they declare"
            of_python = path == _THE_TABLE
            if stated and of_python:
                remedy = (f"Leave --crs out, or give TABLE.to_crs({short_crs_name(stated)!r}), "
                          "which transforms the geometry")
            declaring = "geometry" if of_python else "file"
            contradiction = TermselError(
                f"the {declaring} declares the CRS {short_crs_name(declared)}, but {source} says "
                f"{short_crs_name(agreed)}",
                file=path,
                hint=f"{difference}{remedy}; termsel does not transform coordinates.")
            # WKT is too long to type.
            if stated and declared == short_crs_name(declared):
                contradiction.options["--crs"] = declared
            raise contradiction
    return agreed or ""


def _contradicts_crs(features: FeatureSet, declared: str) -> bool:
    """Return whether coordinates are not possible in the CRS that their file declares."""
    try:
        check_ground(replace(features, crs=declared))
    except TermselError:
        return True
    return False


def _may_add_heights(sets: Iterable[FeatureSet], stated: str | None) -> bool:
    """Return whether EPSG:4979 may stand for EPSG:4326, to which it adds the meaning of heights.

    It may if the user has stated it, or if no features in EPSG:4326 have heights.
    """
    if stated is not None:
        return stated == "EPSG:4979"
    return not any(np.isfinite(features.ground_vertices()[:, 2]).any() for features in sets
                   if features.crs and normalise(features.crs) == "EPSG:4326")


def _require_crs(features: FeatureSet, files: Iterable[Path], may_turn: bool) -> None:
    """Raise TermselError for features without a CRS; it names their files."""
    if not features.crs:
        error = unknown_crs_error(features, may_turn)
        error.file = " and ".join(map(str, files))
        raise error
