"""Why a library could not read or write a file, in words that help."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from pathlib import Path

_NOTHING = "See previous exception for details"
_FULL = ("No space left", "disk is full", "Disk quota exceeded", "database or disk is full")
_FULL_DISK_BYTES = 1 << 20
"""Bytes of free space below which a disk is called full."""


def reason_of(error: BaseException, *paths: Path) -> str:
    """Return why a library failed: the first exception of the chain that says something.

    GDAL often says only that something failed before. `paths` are the folders or files that were
    written: where one of their disks is full, that is the reason.
    """
    chain = list(_exception_chain(error))
    messages = [str(error_of_chain).strip() for error_of_chain in chain]
    says_full = any(mark in " ".join(messages) for mark in _FULL)
    full_codes = (errno.ENOSPC, errno.EDQUOT)
    has_code = any(isinstance(cause, OSError) and cause.errno in full_codes for cause in chain)
    if says_full or has_code or any(map(_is_full, paths)):
        return "the disk is full"
    # The innermost message that does not point at another says most.
    telling = [text for text in messages if text and _NOTHING not in text]
    if telling:
        return telling[-1] if _NOTHING in messages[0] else telling[0]
    return messages[0].replace(_NOTHING, "").strip(" .") or type(error).__name__


def _exception_chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an exception, then its cause or context, and so on to the first of the chain.

    A chain that comes back to an exception ends there.
    """
    visited: set[int] = set()
    while error is not None and id(error) not in visited:
        visited.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _is_full(path: Path) -> bool:
    """Return whether the disk of a file, or of the folder that it would be in, is full.

    Returns False where that cannot be told.
    """
    folders = (path, *path.absolute().parents)
    folder = next((candidate for candidate in folders if candidate.is_dir()), None)
    try:
        return folder is not None and shutil.disk_usage(folder).free < _FULL_DISK_BYTES
    except OSError:
        return False
