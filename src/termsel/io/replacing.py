"""Which files a command may replace: none that it reads, and no other without permission."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from termsel.errors import TermselError
from termsel.files.names import is_there
from termsel.files.rasters import open_raster
from termsel.io.result_folder import files_of_result


def require_replaceable(files: Iterable[Path], *, reads: Iterable[object] = (),
                        overwrite: bool = False) -> None:
    """Refuse to replace a file that is read, and any other without permission.

    Call it before long work, with every file that is written and everything that is read (paths of
    files and of folders of results, values of options); what is not the name of a file does not
    matter. However a name is spelt (relative, through links, in another case where the disk ignores
    it), the file counts. So do the sources of a VRT.
    """
    there = [file for file in files if is_there(file)]
    if not there:
        return
    read = list(_sources(reads))
    for file in there:
        for source in read:
            if file.samefile(source):
                known = "" if str(source) == str(file) else f", as {source}"
                raise TermselError(f"this command reads this file{known}, and would replace it",
                                   file=file, hint="Choose another name for what is written.")
    if not overwrite:
        raise TermselError("this file already exists", file=there[0],
                           hint="Choose another name, or add --overwrite.")


def _sources(reads: Iterable[object]) -> Iterator[Path]:
    """Yield the files that are there, with those of results and the sources of VRTs."""
    waiting = [Path(read) for read in reads if isinstance(read, str | Path)]
    seen: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in seen or not os.path.exists(path):
            continue
        seen.add(path)
        yield path
        if path.is_dir():
            waiting += files_of_result(path)
        elif _is_vrt(path):
            with open_raster(path) as raster:
                waiting += [Path(file) for file in raster.files]


def _is_vrt(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return b"<VRTDataset" in file.read(1024)
    except OSError:
        return False
