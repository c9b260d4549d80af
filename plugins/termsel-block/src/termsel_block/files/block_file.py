"""Read a block: the TOML file that names its images, and the tables of ties."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from termsel import FeatureSet, TermselError, get, open_raster, read, read_rpc
from termsel.toolkit import count_in_words, options_of_file, require_regular, unguard_cell
from termsel.toolkit.coordinates import (
    LOCAL,
    UNITS,
    crs_with_z_unit,
    is_unit_open,
    normalise,
    short_crs_name,
)
from termsel.toolkit.files import (
    KINDS_OF_JSON,
    is_cut,
    makers_of,
    mismatch_in_words,
    parts_of,
    read_delivered_rpc,
    read_toml,
)
from termsel_block.block import CORRECTIONS, Block, BlockImage, Ties
from termsel_block.estimation.equations import image_pairs
from termsel_block.files.asp import asp_rows, is_asp
from termsel_block.geometry.control import points_in_use
from termsel_block.geometry.physical import MODELS, hint_for_block

COLUMNS = {"id": ("id", "tie", "name", "point"), "image": ("image", "img", "scene"),
           "line": ("line", "row", "y_pix"), "sample": ("sample", "col", "column", "x_pix")}
"""Known names of the columns of a table of ties."""

_NAME = "block.toml"
"""What examples call the file of a block."""

_EXAMPLE = "termsel block-example DIR writes a block to begin with."
# TOML has no null.
_KINDS = {kind: words for kind, words in KINDS_OF_JSON.items() if kind != "null"} | {
    "str": "text in quotes"}
# Ties that a note names.
_NAMED_TIES = 5
# Images that a message names.
_NAMED_IMAGES = 8
# Fewest ties and control features of an image, together.
_MIN_FEATURES = 3
# Most bytes of an image's name, in UTF-8.
_LONGEST_IMAGE_NAME = 100
# Lines or samples that no image has.
_MAX_POSITION = 1e7
# Ratio of a tie's distance to the reach of the other ties of the image, beyond which it is wrong.
_MAX_REACH_RATIO = 20.0
# Least reach [px], for ties that are all near each other.
_MIN_REACH = 500.0
# Difference [px] below which two measurements are copies: nobody repeats one so exactly.
_SAME_POSITION = 1e-3


class _Image(msgspec.Struct, forbid_unknown_fields=True):
    """An image as the file states it."""

    name: str
    points: str | None = None
    lines: str | None = None
    rpc: str | None = None
    image: str | None = None
    model: str = "auto"
    options: dict[str, str | int | float | bool] = {}


class _File(msgspec.Struct, forbid_unknown_fields=True):
    """The file of a block."""

    crs: str
    ties: str | list[str]
    image: list[_Image]
    dem: str | None = None
    z_unit: str | None = None


@dataclass(frozen=True)
class _Common:
    """What a block's file states for all images: its CRS, the unit of heights and a DEM."""

    file: Path
    crs: str
    z_unit: str | None
    dem: Path | None

    @property
    def folder(self) -> Path:
        """Folder of the file of the block, which its paths are relative to."""
        return self.file.parent


def read_block(path: Path | str) -> Block:
    """Return the block of a TOML file; paths in it are relative to its folder.

    Parameters
    ----------
    path : path-like
        With `crs`, `ties` (a table id,image,line,sample, or several), optionally `dem` and
        `z_unit`, and for each image a table ``[[image]]`` with `name` and any of `points`, `lines`,
        `rpc`, `image` and `model`.

    Returns
    -------
    Block
        The images with their control, and the ties that they share.

    Raises
    ------
    TermselError
        If the file, or one that it names, is missing or wrong, if an image has too few ties and
        control, or if ties look like copies; the error has the file and, if known, the line.

    Examples
    --------
    >>> from termsel.testing import invoke
    >>> from termsel_block import read_block
    >>> written = invoke("block-example", "scene")
    >>> [image.name for image in read_block("scene/block.toml").images]
    ['A', 'B', 'C']
    """
    path = Path(path)
    if path.is_dir() and (path / _NAME).is_file():
        raise TermselError("this is a folder, expected the file of a block", file=path,
                           hint=f"Give {path / _NAME}.")
    if path.is_dir():
        raise TermselError("this folder has no file of a block", file=path, hint=_EXAMPLE)
    table, text = read_toml(path, "the file of a block", _EXAMPLE)
    try:
        stated = msgspec.convert(table, type=_File)
    except msgspec.ValidationError as error:
        _refuse_unknown_key(str(error), text, path)
        if "crs" not in table:
            raise TermselError("the block has no CRS", file=path,
                               hint="Add that of its points as the first line, such as "
                                    'crs = "EPSG:4979".'
                               ) from error
        mismatch = mismatch_in_words(str(error), _KINDS, _key_in_words)
        raise TermselError(f"this is not the file of a block: {mismatch}", file=path,
                           hint=_EXAMPLE) from error
    names = [image.name for image in stated.image]
    _check_names(names, path)
    # Relative paths let a folder move together with its files.
    folder = path.parent
    common = _Common(path, _crs_of_block(stated, path), stated.z_unit,
                     folder / stated.dem if stated.dem else None)
    if not stated.ties:
        raise TermselError("the block names no file of ties", file=path, hint=_EXAMPLE)
    images = tuple(_read_image(image, common) for image in stated.image)
    files = [stated.ties] if isinstance(stated.ties, str) else list(stated.ties)
    ties, notes = read_ties([folder / file for file in files], names)
    _refuse_unconnected_images(images, ties, path)
    _refuse_copies(names, ties, path)
    files += [stated.dem] if stated.dem else []
    for image in stated.image:
        files += [file for file in (image.points, image.lines, image.rpc, image.image) if file]
    return Block(common.crs, images, ties, common.dem, notes,
                 tuple(folder / file for file in files))


def _crs_of_block(stated: _File, path: Path) -> str:
    """Return the CRS of a block, with heights in the unit that its file states if it states one.

    Raises TermselError, with the file and the line of `z_unit`, for a unit that it cannot have.
    """
    crs = normalise(stated.crs)
    if stated.z_unit is None:
        return crs
    try:
        return crs_with_z_unit(crs, stated.z_unit)
    except TermselError as error:
        text = path.read_text(encoding="utf-8-sig")
        raise TermselError(error.what, file=path, line=_line_of("z_unit", text),
                           hint=error.hint) from error


def _refuse_unconnected_images(images: Sequence[BlockImage], ties: Ties, path: Path) -> None:
    """Raise TermselError for the first image with fewer ties and control than `_MIN_FEATURES`."""
    count = np.bincount(ties.image, minlength=len(images))
    for image, n in zip(images, count.tolist(), strict=True):
        n_control = 0 if image.features is None else (
            len(points_in_use(image.features)) + len(image.features.lines))
        if n + n_control < _MIN_FEATURES:
            raise TermselError(f"image {image.name!r} has {n} ties and {n_control} control "
                               "features, so that nothing joins it to the block", file=path,
                               hint=f"Give it {_MIN_FEATURES} ties or more, or remove it.")


def _refuse_copies(names: Sequence[str], ties: Ties, path: Path) -> None:
    """Raise TermselError if ties look like copied rows.

    They do if all ties of an image, `_MIN_FEATURES` or more, are at one position, or if all that
    two images share are at the same positions in both.
    """
    rows_of_image = [np.flatnonzero(ties.image == i) for i in range(len(names))]
    # A few ties may be at one position by chance.
    for name, rows in zip(names, rows_of_image, strict=True):
        if len(rows) < _MIN_FEATURES:
            continue
        if np.ptp(ties.position[rows], axis=0).max() < _SAME_POSITION:
            raise TermselError(f"all {len(rows)} ties of image {name!r} are at one position in it",
                               file=path, hint="Check the columns line and sample of the ties.")
    for i, j, first, second in image_pairs(
            [ties.tie[rows] for rows in rows_of_image], len(ties.names)):
        if i == j or len(first) < _MIN_FEATURES:
            continue
        difference = (ties.position[rows_of_image[i][first]]
                      - ties.position[rows_of_image[j][second]])
        if np.abs(difference).max() < _SAME_POSITION:
            raise TermselError(f"images {names[i]!r} and {names[j]!r} have all {len(first)} "
                               "common ties at the same positions", file=path,
                               hint="Remove the one that is a copy, or correct its ties.")


def _key_in_words(key: str) -> str:
    """Return the words for a decoder's key, such as "rpc of image number 4" for image[3].rpc.

    They are "the file" for the file as a whole.
    """
    in_image = re.match(r"image\[(\d+)\]\.?(.*)", key)
    if in_image is None:
        return key or "the file"
    # People count from one.
    image = f"image number {int(in_image[1]) + 1}"
    return f"{in_image[2]} of {image}" if in_image[2] else image


def _image_in_words(location: str) -> str:
    """Return the image of a decoder's location, such as " of image number 2"; "" if it has none."""
    image = re.search(r"image\[(\d+)\]", location)
    return f" of image number {int(image[1]) + 1}" if image else ""


def _refuse_unknown_key(message: str, text: str, path: Path) -> None:
    """Raise TermselError if the message of a decoder is about an unknown key.

    The error has the line of the key in the text of the file, and the nearest known key. For the
    file of a study it has the command for that.
    """
    unknown = re.match(r"Object contains unknown field `(.+?)`(.*)", message)
    if unknown is None:
        return
    image_words = _image_in_words(unknown[2])
    keys = (_Image if image_words else _File).__struct_fields__
    near = get_close_matches(unknown[1], keys, n=1)
    if re.search(r"^\s*(problems|solvers|seeds)\s*=", text, re.MULTILINE):
        raise TermselError("this file is of a study, not of a block", file=path,
                           hint=f"Run it by termsel compare {path} --out DIR.")
    guess = f"Did you mean {near[0]!r}? " if near else ""
    raise TermselError(f"unknown key {unknown[1]!r}{image_words or ' of a block'}", file=path,
                       line=_line_of(unknown[1], text),
                       hint=f"{guess}Known: {', '.join(keys)}.")


def _line_of(key: str, text: str) -> int | None:
    """Return the number of the first line that states a key, from 1; None if none does."""
    states = re.compile(rf"\s*(\[\[?\s*)?[\"']?{re.escape(key)}[\"']?\s*[=\].]")
    return next((number for number, line in enumerate(text.splitlines(), 1)
                 if states.match(line)), None)


def _check_names(names: Sequence[str], path: Path) -> None:
    """Raise TermselError for names that cannot be those of folders, and for fewer than two images.

    The result of an image gets a folder of its name, so that names must differ in more than
    capitals, and have no separator.
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise TermselError(f"{count} images are called {name!r}", file=path,
                               hint="Give each image a different name.")
        if (not name.strip() or name != Path(name).name or name.startswith(".")
                or not name.isprintable() or len(name.encode()) > _LONGEST_IMAGE_NAME):
            short_name = name if len(name) <= _LONGEST_IMAGE_NAME else f"{name[:20]}..."
            raise TermselError(f"{short_name!r} cannot be the name of an image, whose result gets "
                               "a folder of that name", file=path,
                               hint="Use letters, digits, - and _, and at most "
                                    f"{_LONGEST_IMAGE_NAME} bytes.")
    # Windows and macOS do not distinguish capitals in the names of files.
    for folder, count in Counter(name.casefold() for name in names).items():
        if count > 1:
            same_folder = [repr(name) for name in names if name.casefold() == folder]
            raise TermselError(f"the images {' and '.join(same_folder)} would share one folder "
                               "on a file system without case", file=path,
                               hint="Give them names that differ in more than capitals.")
    if len(names) < 2:
        images = count_in_words(len(names), "image") if names else "no image"
        raise TermselError(f"a block has two images or more, and this one has {images}", file=path,
                           hint="Add [[image]] for each; for one image use termsel run.")


def _read_image(stated: _Image, common: _Common) -> BlockImage:
    """Return an image of the block with size, RPC and control read from its files.

    `stated` is its entry in the file of the block. If no RPC is named, that of the raster is used
    if it has one. Raises TermselError if a file is missing or wrong, for an RPC in a block without
    a CRS, for a model that the image cannot have, and for an RPC that termsel fitted to the
    control.
    """
    path = common.file
    folder = common.folder
    for key in ("points", "lines", "rpc", "image"):
        file = getattr(stated, key)
        if file and not (folder / file).exists():
            raise TermselError(f"the file {file!r}, {key} of image {stated.name!r}, does not exist",
                               file=path, hint="Correct its name, or put it there: names count "
                                    f"from {folder.resolve()}.")
    raster = folder / stated.image if stated.image else None
    size = None
    if raster is not None:
        with open_raster(raster) as opened:
            size = opened.shape
    rpc = rpc_file = None
    if stated.rpc:
        rpc_file = folder / stated.rpc
        rpc = read_rpc(rpc_file)
    elif raster is not None:
        # Many rasters have an RPC in their tags or next to them, but none is required.
        with suppress(TermselError):
            rpc = read_delivered_rpc(raster)
            rpc_file = None if rpc is None else raster
    # Corrections of RPCs are written by termsel-rpc, after minutes of adjustment.
    if rpc is not None and find_spec("termsel_rpc") is None:
        raise TermselError("an image with an RPC requires the package termsel-rpc, which is not "
                           "installed", file=rpc_file,
                           hint="In a clone of termsel: pip install ./plugins/termsel-rpc.")
    if rpc is not None and common.crs == LOCAL:
        raise TermselError(f"image {stated.name!r} has an RPC, which needs geographic "
                           "coordinates, and the block is in plane coordinates without a CRS",
                           file=path, hint="State the CRS of the ground coordinates.")
    # Options that name a file are relative to the block's folder, as all paths are.
    options = {key: str(folder / value) if isinstance(value, str) and value
               and (folder / value).is_file() else value for key, value in stated.options.items()}
    _check_model(stated, options, rpc is not None, path)
    features = None
    of_dem = frozenset[str]()
    if stated.points or stated.lines:
        features = _control_features(stated, common)
        if rpc is not None and (makers := makers_of(rpc, features)):
            # The record of an RPC may list part of a large set of control alone.
            at_least = "at least " if is_cut(rpc) else ""
            other_control = "" if is_cut(rpc) else ", or other control"
            raise TermselError(
                f"the RPC of image {stated.name!r} was fitted by termsel to "
                f"{at_least}{len(makers)} of its {len(features)} control features, which would "
                "seem to confirm it",
                file=rpc_file, hint=f"Give the RPC that the vendor delivered{other_control}.",
                ids=makers)
        of_dem = frozenset() if common.dem is None else _without_height(stated, common)
    return BlockImage(stated.name, features, rpc, rpc_file, raster, size=size, model=stated.model,
                      of_dem=of_dem, options=options)


def _check_model(stated: _Image, options: Mapping[str, Any], has_rpc: bool, path: Path) -> None:
    """Raise TermselError for a model that an image cannot have, or options that it does not take.

    Corrections require an RPC, other models that there is none; `path` is the file of the block,
    for messages.
    """
    if stated.model in CORRECTIONS:
        if not has_rpc and stated.model != "auto":
            raise TermselError(f"image {stated.name!r} has the model {stated.model!r}", file=path,
                               hint="A correction requires an RPC: give rpc or an image that has "
                                    "one.")
        if stated.options:
            raise TermselError(f"image {stated.name!r} has options, which {stated.model!r} does "
                               "not take", file=path,
                               hint="Options are of a model such as scanner.")
        return
    if has_rpc:
        raise TermselError(f"image {stated.name!r} has the model {stated.model!r}", file=path,
                           hint=f"Known with an RPC: {', '.join(CORRECTIONS)}.")
    # The model is made only to refuse bad options now, with the file in the error.
    try:
        with options_of_file(path):
            get("models", stated.model)(**options)
    except TermselError as error:
        hint = hint_for_block(error.hint)
        # Most models that the hint would list have no priors, and so cannot be used here.
        if error.code == "model-unknown":
            hint = f"{hint.partition('Known:')[0]}{MODELS}"
        raise TermselError(f"image {stated.name!r}: {error.what}", file=path,
                           hint=hint) from error


def _without_height(stated: _Image, common: _Common) -> frozenset[str]:
    """Return the ids of an image's points and lines whose files state no height."""
    # With the DEM the heights would be filled in.
    features = _read_control(stated, replace(common, dem=None))
    points = features.points
    lines = features.lines
    is_missing = np.concatenate([np.isnan(points.ground[:, 2]),
                                 np.isnan(lines.ground[..., 2]).any(axis=1)])
    return frozenset(name for name, has_none in zip(
        [*points.ids, *lines.ids], is_missing.tolist(), strict=True) if has_none)


def _read_control(stated: _Image, common: _Common) -> FeatureSet:
    """Return the control of an image as `termsel.read` reads it, with heights from the DEM if any.

    Errors of it are raised with hints for the file of a block.
    """
    folder = common.folder
    try:
        return read(folder / stated.points if stated.points else None,
                    folder / stated.lines if stated.lines else None, crs=common.crs,
                    z_unit=common.z_unit, dem=common.dem, **_part_of(stated, folder))
    except TermselError as error:
        raise TermselError(error.what.replace("--crs says", "the block says"), file=error.file,
                           line=error.line, column=error.column,
                           hint=hint_for_block(error.hint)) from error


def _part_of(stated: _Image, folder: Path) -> dict[str, Any]:
    """Return the options that read the points of an image from a file of several images.

    {} if the image has no file of points, or that is of one image. The image is found by its name
    in the block or that of its file, with or without the ending. Raises TermselError if the file
    has no points of it.
    """
    if stated.points is None:
        return {}
    path = folder / stated.points
    options_by_image = parts_of(path)
    if not options_by_image:
        return {}
    # The name in the block comes before that of the image's file.
    names = [stated.name, *([Path(stated.image).name] if stated.image else [])]
    for name in names:
        for image, options in options_by_image.items():
            if name in (image, Path(image).stem):
                return options
    listed = ", ".join(list(options_by_image)[:_NAMED_IMAGES])
    raise TermselError(f"the file has points of several images, such as {listed}, and none of "
                       f"{stated.name!r}", file=path,
                       hint="Give the image of the block the name that the file has for it.")


def _control_features(stated: _Image, common: _Common) -> FeatureSet:
    """Return the control of an image, in the CRS of the block and with heights.

    Raises TermselError if it is in another CRS, or if a height is neither stated nor in the DEM.
    """
    path = common.file
    crs = common.crs
    points = common.folder / stated.points if stated.points else None
    features = _read_control(stated, common)
    # Nothing that follows would transform it.
    if normalise(features.crs) != crs:
        _refuse_guessed_unit(stated, features, common)
        raise TermselError(f"the control of image {stated.name!r} is in "
                           f"{short_crs_name(features.crs)}, the block in {short_crs_name(crs)}",
                           file=points or path,
                           hint="Transform it, or state its CRS as that of the block.")
    heights = np.concatenate([features.points.ground[:, 2], features.lines.ground[..., 2].ravel()])
    if np.isnan(heights).any():
        n = int(np.isnan(heights).sum())
        raise TermselError(f"{n} {'place' if n == 1 else 'places'} of the control of image "
                           f"{stated.name!r} {'has' if n == 1 else 'have'} no height",
                           file=points or path,
                           hint="Give heights, or a raster of them as dem in the block's file.")
    return features


def _refuse_guessed_unit(stated: _Image, features: FeatureSet, common: _Common) -> None:
    """Raise TermselError if control differs from the block in a unit of heights that was guessed.

    A DEM, an RPC or the name of a column may show the unit of one image, and nothing that of the
    ties, which are in the block's.
    """
    if common.z_unit is not None or not is_unit_open(common.crs):
        return
    for unit in UNITS:
        if normalise(features.crs) == crs_with_z_unit(common.crs, unit):
            raise TermselError(f"z of the control of image {stated.name!r} is in "
                               f"{features.z_unit}, and the block does not state its unit",
                               file=common.file,
                               hint=f'Add z_unit = "{unit}" below the CRS.')


def read_ties(files: Sequence[Path], images: Sequence[str]) -> tuple[Ties, tuple[str, ...]]:
    """Return the ties of tables id,image,line,sample and of ASP's match files, and notes.

    Ties in one image alone are left out, and a note says so.

    Raises
    ------
    TermselError
        For a file that cannot be read, an unknown image, a tie that is measured twice in one image
        or lies far from all others, and if no tie is in two images.
    """
    index = {name: i for i, name in enumerate(images)}
    first_at: dict[tuple[str, int], tuple[Path, int]] = {}
    # Line and sample of each measurement, in the order of `first_at`.
    positions: list[tuple[float, float]] = []
    matches = [file for file in files if is_asp(file)]
    for file, number, name, (image_name, *position) in asp_rows(matches, images):
        first_at[name, index[image_name]] = file, number
        positions.append((position[0], position[1]))
    for file in files:
        for line, row in [] if file in matches else _table_rows(file):
            name = row["id"]
            image = index.get(row["image"])
            if image is None:
                near = get_close_matches(row["image"], images, 1)
                raise TermselError(f"the block has no image {row['image']!r}", file=file, line=line,
                                   column="image", hint=f"Did you mean {near[0]!r}?" if near else
                                   f"Its images are {', '.join(images[:8])}.")
            if (name, image) in first_at:
                other_file, at = first_at[name, image]
                raise TermselError(
                    f"tie {name!r} is measured twice in image {row['image']!r}, the first time in "
                    f"line {at}" + (f" of {other_file}" if other_file != file else ""), file=file,
                    line=line,
                    hint="Keep one of them, or give two ties two names.")
            first_at[name, image] = file, line
            positions.append((_number_of_cell(row["line"], file, line, "line"),
                              _number_of_cell(row["sample"], file, line, "sample")))
    # Only the first position that is in no image is reported.
    for k, axis in np.argwhere(np.abs(np.array(positions).reshape(-1, 2)) > _MAX_POSITION)[:1]:
        file, line = list(first_at.values())[k]
        column = ("line", "sample")[axis]
        raise TermselError(f"{positions[k][axis]:g} is no {column} of an image", file=file,
                           line=None if file in matches else line, column=column,
                           hint="Write positions in px, such as 1234.5.")
    _refuse_remote_ties(first_at, positions, images, matches)
    count = Counter(name for name, _ in first_at)
    names = tuple(name for name in count if count[name] > 1)
    single = [name for name in count if count[name] == 1]
    if not names:
        raise TermselError("there are no ties" if not count else
                           f"none of the {len(count)} ties is in two images",
                           file=files[0] if files else None,
                           hint="A tie has the same id in each image that sees it.")
    number_of = {name: i for i, name in enumerate(names)}
    rows = [(number_of[name], image, *position)
            for (name, image), position in zip(first_at, positions, strict=True)
            if name in number_of]
    table = np.array(rows)
    notes: tuple[str, ...] = ()
    if single:
        further = ", ..." if len(single) > _NAMED_TIES else ""
        notes = (f"{len(single)} {'tie is' if len(single) == 1 else 'ties are'} in one image alone "
                 f"and left out: {', '.join(single[:_NAMED_TIES])}{further}.",)
    return Ties(names, table[:, 0].astype(np.intp), table[:, 1].astype(np.intp),
                table[:, 2:]), notes


def _refuse_remote_ties(first_at: Mapping[tuple[str, int], tuple[Path, int]],
                        positions: Sequence[tuple[float, float]], images: Sequence[str],
                        matches: Sequence[Path]) -> None:
    """Raise TermselError for a tie that is farther from its image's others than any image reaches.

    `first_at` has file and line of each measurement, by tie and number of its image in `images`;
    `positions` are line and sample of these measurements. Files in `matches` are binary, so that
    the error has no line of them.
    """
    measured = np.array(positions).reshape(-1, 2)
    image_of = np.array([image for _, image in first_at], int)
    for image, name in enumerate(images):
        in_image = np.flatnonzero(image_of == image)
        if not len(in_image):
            continue
        # The median is not moved by a wrong tie, as the mean is.
        middle = np.median(measured[in_image], axis=0)
        distances = np.abs(measured[in_image] - middle).max(axis=1)
        # Half of the width or height that nine of ten ties take.
        reach = max(float(np.quantile(distances, 0.9, method="lower")), _MIN_REACH)
        worst = int(distances.argmax())
        if distances[worst] <= _MAX_REACH_RATIO * reach:
            continue
        at = int(in_image[worst])
        file, line = list(first_at.values())[at]
        tie = list(first_at)[at][0]
        raise TermselError(
            f"tie {tie!r} is at line {measured[at, 0]:,.0f}, sample {measured[at, 1]:,.0f} of "
            f"image {name!r}, and the others are within {reach:,.0f} px of line "
            f"{middle[0]:,.0f}, sample {middle[1]:,.0f}", file=file,
            line=None if file in matches else line,
            hint="Correct the row, or remove it.")


def _table_rows(file: Path) -> list[tuple[int, dict[str, str]]]:
    """Return the number of the line, from 1, and the cells by column of each row of a table.

    Columns are id, image, line and sample. Raises TermselError, with the file, if the table cannot
    be read, if it has none or two of one of these columns, or if a row has too few or many cells.
    """
    try:
        require_regular(file)
        with file.open(newline="", encoding="utf-8-sig") as opened:
            reader = csv.reader(opened)
            header = [cell.strip().lower() for cell in next(reader, [])]
            at = {}
            for meaning, aliases in COLUMNS.items():
                columns = [i for i, cell in enumerate(header) if cell in aliases]
                if len(columns) != 1:
                    raise TermselError(f"this table has {'no' if not columns else 'more than one'} "
                                       f"column {meaning!r}", file=file, line=1,
                                       hint="A table of ties is headed id,image,line,sample, "
                                            "with commas.")
                at[meaning] = columns[0]
            rows = []
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue
                # Cells beyond the header are decimal commas, unless they are empty.
                if len(cells) <= max(at.values()) or any(
                        cell.strip() for cell in cells[len(header):]):
                    hint = "Complete the row, or remove it."
                    if len(cells) >= len(header):
                        hint = ("Write decimal points, not commas, and put text with commas in "
                                "quotes.")
                    raise TermselError(f"this row has {len(cells)} cells, expected "
                                       f"{len(header)}", file=file, line=reader.line_num,
                                       hint=hint)
                rows.append((reader.line_num, {name: unguard_cell(cells[i].strip())
                                               for name, i in at.items()}))
            return rows
    except OSError as error:
        if isinstance(error, FileNotFoundError):
            reason = "this file of ties does not exist"
        else:
            reason = f"cannot read the ties: {error.strerror}"
        raise TermselError(reason, file=file, hint="Check its name at ties = in the file of the "
                           "block. It is a table headed id,image,line,sample.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TermselError(f"this is not a table: {error}", file=file,
                           hint="Give a table headed id,image,line,sample, in UTF-8.") from error


def _number_of_cell(text: str, file: Path, line: int, column: str) -> float:
    """Return the finite number in a cell; raises TermselError, with file, line and column, if it
    has none.
    """
    with suppress(ValueError):
        value = float(text)
        if math.isfinite(value):
            return value
    raise TermselError(f"{text!r} is not a number", file=file, line=line, column=column,
                       hint="Write positions in px, such as 1234.5.")
