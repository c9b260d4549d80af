"""Which files a command may replace: none that it reads, and no other without permission."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from shlex import quote

from termsel.core.errors import TermselError
from termsel.core.files.endings import EXPECTED
from termsel.core.files.names import free_name, is_there
from termsel.core.remedies import Remedy
from termsel.data.rasters import open_raster
from termsel.io.result_folder import files_of_result
from termsel.results.result import Result

_NEXT_TO = (".RPB", ".rpb", ".IMD", ".tfw", ".TFW", ".aux")
_AFTER = ("_RPC.TXT", "_rpc.txt", "_RPC.XML", "_metadata.txt")
_APPENDED = (".aux.xml", ".ovr", ".msk", ".points")
"""What GDAL and QGIS read next to an image: with another suffix, name, or more of it."""


_ENDINGS = {"CSV": (".csv", ".txt"), "JSON": (".json",)}
"""Endings of what termsel writes, by its kind; the first is the usual one."""


def require_replaceable(files: Iterable[Path], *, reads: Iterable[object] = (),
                        overwrite: bool = False, makes_folder: bool = False,
                        written_as: str | None = None, beside: bool = True) -> None:
    """Raise TermselError unless all files may be written.

    A file may not be written if the command reads it, if it exists and may not be replaced, or if
    the system does not allow it. Commands ask before long work: nobody should learn after it that
    there is no such folder. A file that is read counts however its name is spelt (relative, through
    links, in another case where the disk ignores it). The sources of a VRT are read, too, and so
    are the files with RPCs, georeferences and pyramids next to an image.

    Parameters
    ----------
    files : iterable of Path
        All that would be written.
    reads : iterable
        All that is read: paths of files and of folders of results, values of options. What is not
        the name of a file does not matter.
    overwrite : bool
        Whether other files may be replaced.
    makes_folder : bool
        Whether the command makes the folder that they are in.
    written_as : {"CSV", "JSON"}, optional
        What the files hold: a name whose ending says another kind is refused, as other programs
        open a file as its ending says. Other endings, and none, are free.
    beside : bool
        Whether files next to an image count as read, which GDAL takes with it. An export is made to
        be such a file: `overwrite` may replace the one of an earlier export.

    Returns
    -------
    None
        If all files may be written.

    Raises
    ------
    TermselError
        For the first file at fault, which it names.

    Examples
    --------
    >>> import termsel
    >>> from pathlib import Path
    >>> termsel.require_replaceable([Path("new.csv")], reads=["old.csv"])
    """
    files = list(files)
    # What does not exist yet cannot be lost.
    existing = [file for file in files if is_there(file)]
    for file in files:
        _require_writable(file, makes_folder)
    if existing:
        _refuse_read(existing, _files_in_use(reads, beside), makes_folder)
    if written_as is not None:
        for file in files:
            _refuse_other_ending(file, written_as)
    if existing and not overwrite:
        raise TermselError("this file already exists", file=existing[0],
                           hint=f"Choose another name, or add {Remedy('overwrite')}.")


def require_no_source(output: Path, result: Result) -> None:
    """Raise TermselError for an output that the points or lines of a result were read from.

    A result keeps the names of its files as they were typed.
    """
    for name in result.data.source.split(", "):
        if is_there(Path(name)) and is_there(output) and output.samefile(name):
            raise TermselError("the features of this result come from this file, which would be "
                               "replaced", file=output, hint=_other_output(output))


def _other_output(file: Path, makes_folder: bool = False) -> str:
    """Return what to type so that another file, or folder, is written than this one."""
    if makes_folder:
        return f"Choose another folder: {Remedy('out', 'DIR')}."
    other = quote(free_name(file))
    return f"Choose another name for the output: {Remedy('output', other)}."


def _refuse_read(files: Iterable[Path], reads: Iterable[Path], makes_folder: bool) -> None:
    """Raise TermselError for a file that is read, under whatever name."""
    sources = list(reads)
    for file in files:
        # samefile compares device and number, which are the same under any name.
        for source in sources:
            if file.samefile(source):
                alias = "" if str(source) == str(file) else f", as {source}"
                raise TermselError(f"this command reads this file{alias}, and would replace it",
                                   file=file, hint=_other_output(file, makes_folder))


def _refuse_other_ending(file: Path, written_as: str) -> None:
    """Raise TermselError for a name that says another kind of file than is written."""
    suffix = file.suffix.lower()
    own_endings = _ENDINGS[written_as]
    if suffix not in own_endings and suffix in EXPECTED:
        raise TermselError(f"this file is written as {written_as}, not as {suffix}", file=file,
                           hint=f"Name it {file.with_suffix(own_endings[0]).name}.")


def _require_writable(file: Path, makes_folder: bool) -> None:
    """Refuse the name of a file that cannot be written: no folder, no permission, another kind.

    With `makes_folder` the command makes the folder itself, if the first one above it that exists
    allows that.
    """
    # Through links, as the file behind them is the one that is written.
    target = Path(os.path.realpath(file))
    if os.path.lexists(target) and not target.is_file():
        raise TermselError("this is a folder, expected a file" if file.is_dir() else
                           "this is not an ordinary file and cannot be replaced", file=file,
                           hint="Give the name of a file to write.")
    folder = target.parent
    if makes_folder:
        folder = next(parent for parent in target.parents if os.path.lexists(parent))
    if not folder.is_dir():
        if os.path.lexists(folder):
            why = f"{folder} is a file, not a folder"
        else:
            why = "there is no such folder"
    elif not os.access(folder, os.W_OK | os.X_OK):
        why = f"no permission to write to the folder {folder}"
    else:
        return
    raise TermselError(f"cannot write this file: {why}", file=file,
                       hint="Make the folder, or give another name."
                       if not os.path.lexists(folder) else "Give another name.")


def _files_in_use(reads: Iterable[object], beside: bool) -> Iterator[Path]:
    """Yield the paths among `reads` that exist, and all files that are read with them.

    These are the files in folders of results, the sources of VRTs to the end of the chain, and if
    `beside` those that GDAL takes with an image. What is no path is ignored.
    """
    waiting = [Path(read) for read in reads if isinstance(read, str | Path)]
    visited: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in visited or not os.path.exists(path):
            continue
        visited.add(path)
        yield path
        if path.is_dir():
            waiting += files_of_result(path)
            continue
        # RPCs, worldfiles, overviews and the like, by their usual names.
        if beside:
            names = [*(path.with_suffix(end) for end in _NEXT_TO),
                     *(path.with_name(path.stem + end) for end in _AFTER),
                     *(path.with_name(path.name + end) for end in _APPENDED)]
            waiting += filter(is_there, names)
        # The sources of a virtual raster may be virtual rasters again.
        if _is_vrt(path):
            with open_raster(path) as raster:
                waiting += [Path(file) for file in raster.files]


def _is_vrt(path: Path) -> bool:
    """Return whether a path is a file that begins as a virtual raster.

    Returns False for a file that cannot be read.
    """
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return b"<VRTDataset" in file.read(1024)
    except OSError:
        return False
