"""Why a library could not read or write a file, in words that help."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from pathlib import Path

_NOTHING = "See previous exception for details"
_FULL = ("No space left", "disk is full", "Disk quota exceeded", "database or disk is full")
_LEAST = 1 << 20
"""Bytes of free space below which a disk is called full."""


def reason_of(error: BaseException, *places: Path) -> str:
    """Return why a library failed: the first exception of the chain that says something.

    GDAL often says only that something failed before. `places` are the folders or files that were
    written: where one of their disks is full, that is the reason.
    """
    chain = list(_chain(error))
    said = [str(one).strip() for one in chain]
    if any(mark in text for text in said for mark in _FULL) or any(
            isinstance(one, OSError) and one.errno in (errno.ENOSPC, errno.EDQUOT)
            for one in chain) or any(map(_is_full, places)):
        return "the disk is full"
    # The innermost one that is not about another says most.
    telling = [text for text in said if text and _NOTHING not in text]
    if telling:
        return telling[-1] if _NOTHING in said[0] else telling[0]
    return said[0].replace(_NOTHING, "").strip(" .") or type(error).__name__


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an exception and those that it came of."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _is_full(place: Path) -> bool:
    """Return whether the disk of a file, or of the folder that it would be in, is full."""
    folder = next((one for one in (place, *place.absolute().parents) if one.is_dir()), None)
    try:
        return folder is not None and shutil.disk_usage(folder).free < _LEAST
    except OSError:
        return False
