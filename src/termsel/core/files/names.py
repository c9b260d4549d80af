"""Names of files: what is there, what can be read, and what other libraries take."""

from __future__ import annotations

import glob
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path

from termsel.core.errors import TermselError, count_in_words
from termsel.core.files.atomic import private_folder

JOURNAL = "journal.jsonl"
"""Of a study: in the folder that has it, no result may be written."""

RECORD = "result.json"
"""Of a result: a folder that has it is one."""

CERTIFICATE = "certificate.json"
"""Of the proof of `exact`, in the folder of a result."""

STABILITY = "stability.json"
"""Of ``termsel stability``, in the folder of the result of the stable terms."""


def is_there(path: Path) -> bool:
    """Return whether a file or folder exists; raises TermselError if it cannot be looked for."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    # The name may be too long, its folder not be searched, or links lead in a circle.
    except OSError as error:
        raise TermselError(f"cannot look for this file: {error.strerror or error}", file=path,
                           hint="Check the name, and the permissions of its folder.") from error
    return True


_ADDRESS = re.compile(r"(https?|ftp|s3|gs):/+", re.IGNORECASE)
"""How addresses begin; a path of Python has made one slash of two."""


def no_such_file_error(path: Path | str) -> TermselError:
    """Return the error for a file that is not there.

    It has a remedy of its own for an address on a server, and for a pattern such as ``*.csv`` that
    the shell did not expand.
    """
    address = _ADDRESS.match(str(path))
    if address:
        address_text = f"{address[1]}://{str(path)[address.end():]}"
        return TermselError("this is an address on a server, and termsel downloads nothing",
                            file=address_text, hint="Download the file, and give its name here.")
    # Quoted patterns, and those of Windows, come as they were typed.
    matching = sorted(glob.iglob(str(path))) if glob.has_magic(str(path)) else []
    if matching:
        return TermselError(f"this is a pattern of {count_in_words(len(matching), 'file')}, "
                            "expected one file", file=path,
                            hint=f"Give one of them, such as {matching[0]}. Points of many images, "
                                 f"a file each: termsel compare --points '{path}' --out DIR.")
    return TermselError("this file does not exist", file=path,
                        hint="Check the name and the folder.")


def is_open_pipe(path: Path) -> bool:
    """Return whether this is a pipe that the shell has opened: ``<(...)`` or /dev/stdin."""
    return str(path).startswith(("/dev/", "/proc/")) and _file_type(path) == stat.S_IFIFO


def refuse_pipe(path: Path) -> None:
    """Raise TermselError for a pipe or a device, which cannot be read twice or never ends."""
    if _file_type(path) not in (None, stat.S_IFREG, stat.S_IFDIR):
        raise TermselError("this is a pipe or a device, expected a file", file=path,
                           hint="Save its content to a file, and give that file.")


def require_regular(path: Path, named_by: object = None) -> None:
    """Raise TermselError for a folder, pipe or device, which a file may name or be next to.

    `named_by` is that file, which the message then names.
    """
    file_type = _file_type(path)
    if file_type in (None, stat.S_IFREG):
        return
    noun, hint = "a pipe or a device", "Save its content to a file, and give that file."
    if file_type == stat.S_IFDIR:
        noun, hint = "a folder", "Give a file in its place, or move the folder away."
    prefix = "" if named_by is None or str(named_by) == str(path) else f"{path.name!r}: "
    raise TermselError(f"{prefix}this is {noun}, expected a file",
                       file=path if named_by is None else named_by, hint=hint)


def _file_type(path: Path) -> int | None:
    """Return the type of a file as stat has it, such as S_IFREG; None if it cannot be looked at."""
    try:
        return stat.S_IFMT(path.stat().st_mode)
    except OSError:  # whoever opens it says why
        return None


_HIDDEN = (".lock", ".termsel")
"""What hidden names of termsel in the folder of a result begin with."""


def path_inside(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder of a result, study or block; it need not exist.

    Raises TermselError for a link or a pipe: the folder may have come with data, and only names
    that the user types are followed to where they lead.
    """
    path = folder / name
    refuse_link(path)
    require_regular(path)
    return path


def refuse_link(path: Path) -> None:
    """Raise TermselError for a link in a folder that may have come with data."""
    if os.path.islink(path):
        raise _link_error(path)


def refuse_links(folder: Path) -> None:
    """Raise TermselError for a folder for results with links anywhere, or named pipes.

    Hidden entries that are not termsel's, such as `.venv` and `.git` where results go to the folder
    of a project, are left alone: nothing is written there.
    """
    waiting = [folder]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as entries:
                for entry in entries:
                    if entry.name.startswith(".") and not entry.name.startswith(_HIDDEN):
                        continue
                    refuse_link(Path(entry.path))
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(Path(entry.path))
                    elif not entry.is_file(follow_symlinks=False):
                        require_regular(Path(entry.path))
        except OSError:  # whoever writes there says why that is not possible
            continue


def _link_error(path: Path) -> TermselError:
    """Return the error for a link in the folder of a result, study or block."""
    return TermselError("this is a link, and in the folder of a result, study or block no link is "
                        "followed", file=path,
                        hint="Remove it, or choose another --out. A link whose name you type "
                             "yourself is followed.")


_GRIDS = re.compile(
    r"""(?:grids|file|model|init)\s*=\s*(?:""|["'])?[^\s"\]]*[/\\]"""
    r"""|PARAMETERFILE\s*[\[(]\s*"(?:[^"]|"")*"\s*,\s*"[^"]*[/\\]"""
    r"""|PROJ4_GRIDS"\s*,\s*"[^"]*[/\\]""", re.IGNORECASE)
"""A grid of datum shifts in WKT or in a string of PROJ, by the name of a file or an address."""


_CRS = re.compile(r"""(?:proj|init)\s*=|\w\s*[\[(]\s*["\u201c\u201d]""", re.IGNORECASE)
"""What every CRS and operation has that could name a grid: a string of PROJ, or WKT."""


def may_be_crs(text: str) -> bool:
    """Return whether a text of an unknown kind could be a CRS that names a grid."""
    return _CRS.search(text) is not None


def refuse_grids(crs: str, file: object = None) -> None:
    """Raise TermselError for a CRS that names a file or an address, which PROJ would open.

    Grids by name alone are those of PROJ's own folder.

    Raises
    ------
    TermselError
        If the CRS names a file with its folder, or an address.
    """
    # WKT may have typographic quotation marks, too.
    if _GRIDS.search(re.sub("[\u201c\u201d]", '"', crs)):
        raise TermselError("this CRS names the file of a grid, which termsel does not open",
                           file=file, hint="Put the grid into PROJ's folder, and give its name "
                                           "alone; or transform the coordinates to another CRS.")


def open_inside(name: str, flags: int) -> int:
    """Open a file as `os.open` does, and fail where it is a link."""
    return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


@contextmanager
def utf8_name(path: Path | str) -> Iterator[Path | str]:
    """Yield a name for libraries that take only UTF-8: the path, or that of a link to it."""
    if _is_utf8(Path(path)):
        yield path
        return
    path = Path(path)
    with private_folder() as folder:
        # Files with the same stem are linked too, as GDAL looks for them next to an image.
        for file in (path, *path.parent.glob(f"{glob.escape(path.stem)}*")):
            with suppress(FileExistsError):
                (folder / _as_utf8(file.name)).symlink_to(file.absolute())
        yield folder / _as_utf8(path.name)


@contextmanager
def utf8_folder(folder: Path) -> Iterator[Path]:
    """Yield a name in UTF-8 of a folder to write to: its own, or that of a link to it."""
    if _is_utf8(folder):
        yield folder
        return
    with private_folder() as link_folder:
        (link_folder / "folder").symlink_to(folder.absolute(), target_is_directory=True)
        yield link_folder / "folder"


def _is_utf8(path: Path) -> bool:
    """Return whether the absolute name of a file can be encoded in UTF-8."""
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError:
        return False
    return True


def _as_utf8(name: str) -> str:
    """Return the name of a file with replacements for bytes that are no UTF-8."""
    return os.fsencode(name).decode("utf-8", errors="replace")


def free_name(wanted: Path | str) -> str:
    """Return a name that nothing has yet: the wanted one, or one with a number."""
    path = Path(wanted)
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return str(next(name for name in chain([path], numbered) if not name.exists()))
