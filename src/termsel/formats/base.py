"""What every file format shares: the interfaces of readers and writers, reading text."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from termsel.core.errors import TermselError, first_names_in_words
from termsel.core.files.atomic import private_folder
from termsel.core.files.names import is_open_pipe, is_there, no_such_file_error, refuse_pipe
from termsel.core.isolation.arrays import returns_type
from termsel.core.isolation.calls import Check
from termsel.core.options import Configurable, Option
from termsel.data.features import FeatureSet
from termsel.formats.encodings import decode, decode_file, head_in_utf8

if TYPE_CHECKING:
    from termsel.results.result import Result

MAX_FILE_BYTES = 512 << 20
"""Bytes of a file that is read at once; a sparse file can claim any size."""

LARGEST_IMAGE = 200_000.0
"""Pixels along a side: no image is larger."""

_HEAD = 65536  # bytes shown to sniff(): room for a long comment before a header
_Image = TypeVar("_Image", str, float)


_IN_WORDS = {
    "Expecting property name enclosed in double quotes": "a name in double quotes is missing",
    "Expecting value": "a value is missing, or a comma is too many",
    "Expecting ',' delimiter": "a comma is missing",
    "Expecting ':' delimiter": "a colon is missing",
    "Extra data": "more follows after its end",
    "Unterminated string starting at": "a text begins that has no closing quote",
    "Illegal trailing comma before end of object": "a comma is too many",
    "Illegal trailing comma before end of array": "a comma is too many",
}
"""What a user reads for what json says."""

IMAGE_NAME = Option("image_name", None, "Name of the image, for files with several images.")
"""Option of readers that choose the points of one image."""


def _answer_fault(_checked_object: Configurable, value: Any, *_args: Any) -> str | None:
    """Return how a yes or no is at fault; None if it is True or False."""
    # Plugins answer, and a truth value of another kind, such as a match, would pass as True.
    if isinstance(value, bool | np.bool_):
        return None
    return f"returned {value!r:.100}; expected True or False"


def _files_fault(_checked_object: Configurable, value: Any, *_args: Any) -> str | None:
    """Return how a value is at fault that should be a tuple of paths; None if it is not."""
    if isinstance(value, tuple) and value and all(isinstance(file, Path) for file in value):
        return None
    return f"returned {value!r:.100}; expected a tuple of paths"


class Reader(Configurable, ABC):
    """Reads one format of ground control features.

    Options that a reader declares are given with ``--set``, or to `termsel.read`.

    Attributes
    ----------
    name : str
        As in ``termsel list readers``.
    summary : str
        One line: what a file of this format holds and how it begins.
    areas : bool
        Whether it reads areas, given with ``--areas``, as points or lines. Such a
        reader has the option `areas_as`: "boundary" for lines, "centroid" for points.
    states_origin : bool
        Whether the format says which place of the image has the coordinates (0, 0). If not, it is
        the centre of the upper-left pixel, or what the option `image_origin` says.
    default_origin : str
        Where image coordinates count from, as a choice of `image_origin`, if the format says so but
        the height of the image decides, such as "bottom-left-corner"; "" for other formats. `read`
        then leaves them as they are in the file.
    folders : bool
        Whether it also reads folders, such as a product of several files; `sniff` is then asked
        with an empty head.
    general : bool
        Whether it reads files of many kinds, so that a reader of their own kind comes before it.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> class Blanks(termsel.Reader):
    ...     "Points as id, X, Y, Z, line, sample between blanks."
    ...     name = "blanks-demo"
    ...     summary = "id, X, Y, Z, line, sample, separated by blanks"
    ...
    ...     def sniff(self, path, head):
    ...         return path.suffix == ".blanks"
    ...
    ...     def read(self, path):
    ...         rows = [line.split() for line in path.read_text().splitlines()]
    ...         numbers = np.array([row[1:] for row in rows], dtype=float)
    ...         ids = tuple(row[0] for row in rows)
    ...         points = termsel.Points(ids, image=numbers[:, 3:], ground=numbers[:, :3])
    ...         return termsel.FeatureSet(points=points, crs="EPSG:4979")
    >>> Blanks().name
    'blanks-demo'
    """

    kind = "reader"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "sniff": _answer_fault, "read": returns_type(FeatureSet),
        "placed": returns_type(TermselError),
        "parts": returns_type(dict)}

    name: ClassVar[str]
    summary: ClassVar[str]
    areas: ClassVar[bool] = False
    states_origin: ClassVar[bool] = True
    default_origin: ClassVar[str] = ""
    folders: ClassVar[bool] = False
    general: ClassVar[bool] = False

    @abstractmethod
    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the file is of this format, judged by its content.

        Parameters
        ----------
        path : pathlib.Path
        head : bytes
            The first 64 KiB of the file. Text in another encoding is in UTF-8 there, as
            `termsel.toolkit.read_text` reads the file.
        """

    @abstractmethod
    def read(self, path: Path) -> FeatureSet:
        """Return the features of a file.

        Parameters
        ----------
        path : pathlib.Path
            A file that `sniff` knows, or that the user says is of this format.

        Returns
        -------
        FeatureSet
            Image coordinates as line and sample with the centre of the upper-left pixel at
            (0, 0); `crs` is "" where the file does not declare one.

        Raises
        ------
        TermselError
            Naming file, line and column, for anything in the file that the user must correct.
        """

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options that read each part of a file that has several, by name.

        Parts are the maps of a page, for example, which a study takes one by one. A file without
        parts gives {}.
        """
        # A file of one part needs no option.
        return {}

    def placed(self, error: TermselError, path: Path) -> TermselError:
        """Return an error that was found after reading, with the file it is in.

        A reader that knows the lines of features overrides this to add line and column.

        Parameters
        ----------
        error : TermselError
            Its `ids` name the features, its `column` a coordinate, such as "x" or "y2".
        path : pathlib.Path
            The file that was read.

        Returns
        -------
        TermselError
            The same error, with its `file`, and without its `column`.
        """
        # A coordinate is a column in a table alone, whose reader knows its heading.
        error.column = None
        return error_in_file(error, path)


class Writer(Configurable, ABC):
    """Writes a result in one format.

    Options that a writer declares are given with ``--image``, ``--dem`` and ``--set``.

    Attributes
    ----------
    name : str
        As in ``termsel export --to``.
    summary : str
        One line that says what is written and who reads it.
    needs : str
        What of a result, an installation or an image it requires, for ``termsel describe``.
    suffix : str
        Ending of the file names that ``termsel run --export`` chooses.

    Examples
    --------
    >>> import termsel
    >>> class Names(termsel.Writer):
    ...     "Names of the terms in use."
    ...     name = "names-demo"
    ...     summary = "the terms in use, one a line"
    ...     suffix = ".txt"
    ...
    ...     def accepts(self, result):
    ...         return True
    ...
    ...     def write(self, result, path):
    ...         path.write_text("\\n".join(result.selection.terms))
    >>> Names().suffix
    '.txt'
    """

    kind = "writer"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "accepts": _answer_fault, "files": _files_fault, "write": None}

    name: ClassVar[str]
    summary: ClassVar[str]
    needs: ClassVar[str] = ""
    suffix: ClassVar[str] = ""

    @abstractmethod
    def accepts(self, result: Result) -> bool:
        """Return True if this format can hold `result`."""

    def files(self, path: Path) -> tuple[Path, ...]:
        """Return all files written for `path`; none is replaced without permission."""
        return (path,)

    @abstractmethod
    def write(self, result: Result, path: Path) -> None:
        """Write `result` to `path`.

        `termsel.toolkit.write_text` writes it completely or not at all.

        Raises
        ------
        TermselError
            If the result does not fit the format or the file cannot be written.
        """


def error_in_file(error: TermselError, file: Path | None, line: int | None = None,
                  column: str | None = None) -> TermselError:
    """Return a copy of an error with the place where it was found.

    Line and column stay as they are where none are given. The error itself is not changed, as
    another caller may keep it and place it elsewhere.
    """
    placed = copy(error)
    placed.file = file
    placed.line = line or error.line
    placed.column = column or error.column
    return placed


def image_of(path: Path, images: Iterable[_Image], asked_for: _Image | None, option: str) -> _Image:
    """Return which image of a file is read: the one that was asked for, or the only one.

    Parameters
    ----------
    path : Path
        The file, for messages.
    images : iterable of str or float
        The name or number of the image of each point.
    asked_for : str, float or None
        What the user has chosen, if anything.
    option : str
        How to choose, such as "image_name=NAME", for messages.

    Raises
    ------
    TermselError
        If the file has no point of the image asked for, if it has several images and none is asked
        for, or if no point names its image. The message names those with the most points.
    """
    # Of a mapping by images, Counter itself would take the values for counts.
    counts = Counter(iter(images))
    if not counts:
        raise TermselError("no point of this file names its image", file=path,
                           hint=f"Leave --set {option} out, or name the image of each point.")
    names_in_file = sorted(counts)
    name = names_in_file[0] if asked_for is None and len(names_in_file) == 1 else asked_for
    if name is not None and name in counts:
        return name
    # Those with most points first: an image of one or two is too little for most models.
    ordered = sorted(names_in_file, key=lambda image: -counts[image])
    labels = [f"{image:g}" if isinstance(image, float) else image or "without a name"
              for image in ordered]
    # Counts say something only where a file lists an image once for each of its points.
    note = ""
    if max(counts.values()) > 1:
        labels = [f"{label} ({counts[image]})"
                  for label, image in zip(labels, ordered, strict=True)]
        note = ", with their numbers of points"
    hint = f"Choose one with --set {option}"
    # Images with names are parts of the file, so that a study takes them all.
    if not any(isinstance(image, float) for image in names_in_file):
        hint += ", or fit each with termsel compare --points FILE --out DIR"
    refused = "" if asked_for is None else f"no image {asked_for!r} is in this file: "
    raise TermselError(f"{refused}the file has points of the images "
                       f"{first_names_in_words(labels)}{note}", file=path, hint=f"{hint}.")


def read_text(path: Path) -> str:
    """Return the text of a file in any usual encoding, line ends as they are.

    A byte order mark is left out, and an encoding that is none of Unicode is noted. What termsel
    itself wrote is read by `read_utf8`.

    Raises
    ------
    TermselError
        If the file cannot be read, is binary, or is in none of these encodings; the message has the
        line.
    """
    return decode_file(read_data(path), path)


def read_utf8(path: Path) -> str:
    """Return the text of a UTF-8 file, such as termsel writes, without a byte order mark.

    Raises TermselError as `read_text` does, for text in another encoding too.
    """
    data = read_data(path)
    text, encoding = decode(data, path)
    if not encoding.startswith("utf-8"):
        raise TermselError(f"the text of this file is {encoding}, expected UTF-8", file=path,
                           hint="Save it with the encoding UTF-8.")
    return text


def read_data(path: Path) -> bytes:
    """Return the content of a file.

    Raises TermselError if it is no regular file, too large, or cannot be read.
    """
    refuse_pipe(path)
    try:
        # Before it is read: a sparse file may claim more than there is memory.
        if path.stat().st_size > MAX_FILE_BYTES:
            raise TermselError(f"this file is larger than {MAX_FILE_BYTES >> 20} MiB, the most "
                               "that is read of a text or table", file=path,
                               hint="Split it. An image is given with --image, a DEM with --dem.")
        return path.read_bytes()
    except OSError as error:
        raise _unreadable_error(path, error) from error


def parse_json(text: str, hint: str) -> Any:
    """Return the value of a text in JSON.

    Raises TermselError, with `hint`, for a text that is not JSON, with its line, and for one that
    is nested too deeply or has a number of too many digits.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        # An error at the end of the text means that the text breaks off.
        is_cut = error.pos >= len(text.rstrip())
        reason = "the file breaks off here" if is_cut else _IN_WORDS.get(error.msg, error.msg)
        raise TermselError(f"this is not JSON: {reason}", line=error.lineno, hint=hint
                           ) from error
    except RecursionError:
        raise TermselError("this JSON is nested too deeply", hint=hint) from None
    # Python refuses whole numbers of more digits than it can convert in a moment.
    except ValueError as error:
        raise TermselError("this JSON has a number of too many digits", hint=hint) from error


def read_head(path: Path, expected: str) -> bytes:
    """Return the first 64 KiB of a file, those of a text in UTF-8 whatever its encoding.

    Raises TermselError if it is a folder, empty or cannot be read; `expected` is a sentence on what
    it should be.
    """
    if is_there(path) and path.is_dir():
        # A folder in place of a table may be meant as the tables of many images.
        of_many = _files_of_points_in_words(path) if "table" in expected else ""
        raise TermselError("this is a folder, expected a file", file=path,
                           hint=f"{expected}{of_many}")
    refuse_pipe(path)
    try:
        with path.open("rb") as file:
            # UTF-16 may have twice as many bytes.
            head = head_in_utf8(file.read(2 * _HEAD))[:_HEAD]
    except OSError as error:
        raise _unreadable_error(path, error) from error
    if not head.strip():
        raise TermselError("the file is empty", file=path, hint=expected)
    return head


_OF_POINTS = (".csv", ".points", ".txt", ".xlsx", ".geojson", ".json", ".gpkg")


def _files_of_points_in_words(folder: Path) -> str:
    """Return a sentence with the command for the files of points in a folder.

    Returns "" if it has none, or cannot be read.
    """
    try:
        counts = Counter(file.suffix.lower() for file in folder.iterdir())
    except OSError:
        return ""
    # The most frequent ending: a folder may have notes next to the tables.
    ending = max(_OF_POINTS, key=lambda ending: counts[ending])
    if not counts[ending]:
        return ""
    pattern = quote(f"{folder}/*{ending}")
    return f" Of many images, a file each: termsel compare --points {pattern} --out DIR."


@contextmanager
def read_once(path: Path) -> Iterator[Path]:
    """Yield a file for readers, which open it several times: the path, or a copy of a pipe.

    Errors in the block that name the copy name the pipe.

    Raises TermselError for a pipe that carries more than `MAX_FILE_BYTES`, or cannot be read.
    """
    # A named pipe that no shell has opened is left to the readers, which refuse it: whoever waits
    # for it may wait for ever.
    if not is_open_pipe(path):
        yield path
        return
    with private_folder() as folder:
        copy = folder / path.name
        try:
            with path.open("rb") as pipe:
                content = pipe.read(MAX_FILE_BYTES + 1)
            if len(content) > MAX_FILE_BYTES:
                raise TermselError(f"this pipe carries more than {MAX_FILE_BYTES >> 20} MiB",
                                   file=path,
                                   hint="Save its content to a file, and give that file.")
            copy.write_bytes(content)
        except OSError as error:
            raise _unreadable_error(path, error) from error
        try:
            yield copy
        except TermselError as error:
            raise error_in_file(error,
                                Path(str(error.file).replace(str(copy), str(path)))) from error


def _unreadable_error(path: Path, error: OSError) -> TermselError:
    """Return the error for a file that does not exist or cannot be read."""
    if isinstance(error, FileNotFoundError):
        return no_such_file_error(path)
    if is_there(path) and path.is_dir():
        return TermselError("this is a folder, expected a file", file=path,
                            hint="Give a file in it.")
    return TermselError(f"cannot read this file: {error.strerror or error}", file=path,
                        hint="Give a file that you may read.")
