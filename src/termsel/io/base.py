"""What every file format shares: the interfaces, and finding the reader for a file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from termsel.crs import EXAMPLES, check_ground, normalise
from termsel.errors import TermselError, unknown_name
from termsel.features import FeatureSet, join_lines, join_points, no_lines, no_points
from termsel.options import Configurable

if TYPE_CHECKING:
    from termsel.result import Result

_HEAD = 65536  # bytes shown to sniff(): room for a long comment before a header
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


class Reader(Configurable, ABC):
    """Reads one format of ground control features.

    The options a reader declares are given by ``--set``, or to `termsel.read`.

    Attributes
    ----------
    name : str
        As in ``termsel list readers``.
    summary : str
        One line that says what a file of this format holds and how it begins.
    areas : bool
        Whether what it returns as points or lines are areas, which ``--areas`` takes. Such a
        reader has the option `areas_as`: "boundary" for lines, "centroid" for points.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    areas: ClassVar[bool] = False

    @abstractmethod
    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the file is of this format, judged by its content.

        Parameters
        ----------
        path : pathlib.Path
        head : bytes
            The first 64 KiB of the file.
        """

    @abstractmethod
    def read(self, path: Path) -> FeatureSet:
        """Return the features of a file.

        Parameters
        ----------
        path : pathlib.Path

        Returns
        -------
        FeatureSet
            Image coordinates as line and sample with the centre of the upper-left pixel at
            (0, 0); `crs` is "" where the file does not declare one.

        Raises
        ------
        TermselError
            Naming file, line and column, for anything in the file the user must mend.
        """


class Writer(Configurable, ABC):
    """Writes a result in one format.

    The options a writer declares are given by ``--image``, ``--dem`` and ``--set``.

    Attributes
    ----------
    name : str
        As in ``termsel export --to``.
    summary : str
        One line that says what is written and who reads it.
    suffix : str
        What the names of such files end with, as ``termsel run --export`` names them.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    suffix: ClassVar[str] = ""

    @abstractmethod
    def accepts(self, result: Result) -> bool:
        """Return True if this format can hold `result`."""

    def files(self, path: Path) -> tuple[Path, ...]:
        """Return all files that are written for `path`, none of which is replaced unasked."""
        return (path,)

    @abstractmethod
    def write(self, result: Result, path: Path) -> None:
        """Write `result` to `path`, whole or not at all (`termsel.io.atomic`).

        Raises
        ------
        TermselError
            If the result does not fit the format or the file cannot be written.
        """


def located(error: TermselError, file: Path, line: int | None = None,
            column: str | None = None) -> TermselError:
    """Return `error` with the place it was found at.

    Parameters
    ----------
    error : TermselError
    file : pathlib.Path
    line, column : optional
        Kept as they are in `error` where not given.
    """
    return TermselError(error.what, hint=error.hint, file=file, line=line or error.line,
                        column=column or error.column, ids=error.ids)


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file, without a byte order mark, line ends as they are.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    TermselError
        If the file cannot be read, is binary or is in another encoding.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from error
    if is_utf16(data):
        raise _utf16(path)
    if b"\0" in data:
        raise TermselError("this is a binary file, expected UTF-8 text", file=path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[:error.start].count(b"\n") + 1
        raise TermselError("this text is not UTF-8", file=path, line=line,
                           hint="Save it again with the encoding UTF-8.") from error


def read_head(path: Path, expected: str) -> bytes:
    """Return the first 64 KiB of a file.

    Parameters
    ----------
    path : pathlib.Path
    expected : str
        A sentence on what the file should be.

    Raises
    ------
    TermselError
        If the file is missing, empty, a folder or not readable.
    """
    if path.is_dir():
        raise TermselError("this is a folder, expected a file", file=path, hint=expected)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except FileNotFoundError as error:
        raise TermselError("there is no such file", file=path,
                           hint="Check the name and the folder it is given from.") from error
    except OSError as error:
        raise _unreadable(path, error) from error
    if not head.strip():
        raise TermselError("the file is empty", file=path, hint=expected)
    return head


def read_file(path: Path, readers: Iterable[Reader], format: str | None = None,
              options: Mapping[str, Any] | None = None) -> FeatureSet:
    """Return the features of a file, with the first reader that recognises its content.

    Parameters
    ----------
    path, readers, format, options
        As `find_reader`.

    Raises
    ------
    TermselError
        As `find_reader`, or if the content is at fault.
    """
    return find_reader(path, readers, format, options).read(path)


def find_reader(path: Path, readers: Iterable[Reader], format: str | None = None,
                options: Mapping[str, Any] | None = None) -> Reader:
    """Return the first reader that recognises the content of a file.

    Parameters
    ----------
    path : pathlib.Path
    readers : iterable of Reader
        In the order they are asked.
    format : str, optional
        The name of the reader to use, whatever the content looks like.
    options : mapping, optional
        Each reader takes those it declares.

    Raises
    ------
    TermselError
        If there is no such reader, an option does not take its value, the file is missing,
        empty, a folder or not readable, or no reader recognises it.
    """
    known = [_with_options(reader, options or {}) for reader in readers]
    chosen = [reader for reader in known if reader.name == format]
    if format is not None and not chosen:
        raise unknown_name("file format", format, [reader.name for reader in known])
    expected = "Expected one of: " + "; ".join(f"{r.name}: {r.summary}" for r in known) + "."
    head = read_head(path, expected)
    for reader in chosen or known:
        if chosen or reader.sniff(path, head):
            return reader
    if is_utf16(head):
        raise _utf16(path)
    kind = "binary file" if b"\0" in head else "file"
    raise TermselError(f"this {kind} is in no format termsel knows", file=path, hint=expected)


def _with_options(reader: Reader, given: Mapping[str, Any]) -> Reader:
    own = {o.name: given[o.name] for o in reader.declared_options if o.name in given}
    return type(reader)(**{**reader.options, **own}) if own else reader


def read_features(points: Path | None, lines: Path | None, *, areas: Path | None = None,
                  crs: str | None, readers: Iterable[Reader], formats: Sequence[str] = (),
                  options: Mapping[str, Any] | None = None) -> FeatureSet:
    """Return the points, lines and areas of a file each, in one CRS.

    Parameters
    ----------
    points, lines, areas : pathlib.Path, optional
        At least one of them. A file that holds points and lines is given as both. Areas become
        points or lines.
    crs : str, optional
        What the user states; needed where no file declares one.
    readers : iterable of Reader
    formats : sequence of str
        Names of the readers of the files, in their order, as far as they are to be forced.
    options : mapping, optional
        Options of the readers.

    Raises
    ------
    TermselError
        As `read_file`; if no file's reader has such an option; if a file holds no features of
        its kind, or others that were not asked for; if the CRS is not known or stated twice
        and differently; if coordinates cannot be in it; if features of two kinds have one id.
    """
    if points is None and lines is None and areas is None:
        raise TermselError("no file of features is given",
                           hint="Give --points FILE, --lines FILE or --areas FILE.")
    known = list(readers)
    stated = None if crs is None else normalise(crs)
    paths = list(dict.fromkeys(path for path in (points, lines, areas) if path is not None))
    if len(formats) > len(paths):
        raise TermselError(f"{len(formats)} formats are given for {len(paths)} files",
                           hint="Give --format once for each file, that of the points first.")
    chosen = {path: find_reader(path, known, name, options)
              for path, name in zip_longest(paths, formats)}
    _refuse_idle(options or {}, chosen)
    sets = {path: reader.read(path) for path, reader in chosen.items()}
    for path, features in sets.items():
        if chosen[path].areas or path == areas:
            _check_areas(path, chosen[path], path == areas and path not in (points, lines))
            continue
        counts = {"points": len(features.points), "lines": len(features.lines)}
        _check_kinds(path, counts, {"points": path == points, "lines": path == lines})
    measured = FeatureSet(
        no_points() if points is None else sets[points].points,
        no_lines() if lines is None else sets[lines].lines,
        _agreed_crs(sets, stated),
        next((one.image_size for one in sets.values() if one.image_size), None))
    if areas is not None:
        measured = _with_areas(measured, sets[areas], areas)
    try:
        check_ground(measured)
    except TermselError as error:
        place = next(path for path, one in sets.items() if error.ids[0] in one.ids)
        raise located(error, place) from error
    return measured


def _check_areas(path: Path, reader: Reader, asked: bool) -> None:
    if not reader.areas:
        raise TermselError(f"the file holds no areas: it is read as {reader.name}", file=path,
                           hint="Give points with --points and lines with --lines.")
    if not asked:
        raise TermselError("the file holds areas", file=path, hint="Give it with --areas alone.")


def _with_areas(features: FeatureSet, areas: FeatureSet, path: Path) -> FeatureSet:
    """Return the features with areas among them, each as what it was read as."""
    both = set(features.ids) & set(areas.ids)
    if both:
        raise TermselError(f"{min(both)!r} is the id of an area and of a point or line",
                           file=path, hint="Give every feature an id of its own.", ids=both)
    try:
        return features.with_(points=join_points(features.points, areas.points),
                              lines=join_lines(features.lines, areas.lines))
    except TermselError as error:
        raise located(error, path) from error


def _refuse_idle(options: Mapping[str, Any], chosen: Mapping[Path, Reader]) -> None:
    for key in options:
        if not any(key in reader.options for reader in chosen.values()):
            raise TermselError(
                f"option {key!r} means nothing to " + " and ".join(
                    f"{reader.name}, the format of {path}" for path, reader in chosen.items()),
                hint="Leave it out, or force another format with --format.")


def _check_kinds(path: Path, counts: dict[str, int], asked: dict[str, bool]) -> None:
    there = [kind for kind, count in counts.items() if count]
    for kind in counts:
        if asked[kind] and kind not in there:
            raise TermselError(f"the file holds no {kind}", file=path, hint=" ".join(
                f"It holds {other}: give it with --{other}." for other in there) or None)
    for kind in there:
        if not asked[kind]:
            raise TermselError(f"the file also holds {kind}", file=path,
                               hint=f"Give it with --{kind} too, or keep points and lines in "
                                    "files of their own.")


def _agreed_crs(sets: dict[Path, FeatureSet], stated: str | None) -> str:
    agreed, source = stated, "--crs"
    for path, features in sets.items():
        if not features.crs:
            continue
        try:
            declared = normalise(features.crs)
        except TermselError as error:
            raise located(error, path) from error
        if agreed is None:
            agreed, source = declared, str(path)
        # EPSG:4979 only adds the meaning of the heights to EPSG:4326, as the user may.
        elif declared != agreed and (stated, declared) != ("EPSG:4979", "EPSG:4326"):
            raise TermselError(
                f"the file declares the CRS {declared}, but {source} says {agreed}", file=path,
                hint="Mend the one that is wrong; termsel does not transform coordinates.")
    if agreed is None:
        raise TermselError("the CRS of the ground coordinates is not known",
                           file=" and ".join(str(path) for path in sets),
                           hint=f"State it with --crs: {EXAMPLES}.")
    return agreed


def _unreadable(path: Path, error: OSError) -> TermselError:
    return TermselError(f"cannot read this file: {error.strerror or error}", file=path)


def is_utf16(head: bytes) -> bool:
    """Return True for text that begins with the byte order mark of UTF-16."""
    return head.startswith(_UTF16)


def _utf16(path: Path) -> TermselError:
    return TermselError("this text is UTF-16, expected UTF-8", file=path,
                        hint="Save it again with the encoding UTF-8.")
