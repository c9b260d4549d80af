"""One process at a time in the folder of a study."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Literal

from termsel.errors import TermselError

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; the system takes it away from a process that ends.

    Raises TermselError if another process holds it: which one, on which machine and since when.
    """
    with _opened(folder, "a+b") as file:
        # Who asks for the status holds it for a moment.
        for _ in range(5):
            if _taken(file):
                break
            time.sleep(0.1)
        else:
            raise TermselError(f"{_holder(file)} is at work on this study", file=folder,
                               hint="Wait for it, or choose another --out. "
                                    f"`termsel compare --status {folder}` shows how far it is.")
        file.truncate(0)
        file.write(f"process {os.getpid()} on {platform.node() or 'this machine'} since "
                   f"{time.strftime('%Y-%m-%d %H:%M:%S')}".encode())
        file.flush()
        yield
        file.truncate(0)


def holder(folder: Path) -> str | None:
    """Return who is at work in a folder: process, machine and since when; None if nobody is."""
    if not (folder / LOCK).exists():
        return None
    with _opened(folder, "r+b") as file:
        return None if _taken(file) else _holder(file)


@contextmanager
def _opened(folder: Path, mode: Literal["a+b", "r+b"]) -> Iterator[BinaryIO]:
    try:
        file = open(folder / LOCK, mode)  # noqa: SIM115 (closed below)
    except OSError as error:
        raise TermselError(f"cannot write to the folder: {error.strerror}", file=folder,
                           hint="Choose another --out.") from error
    try:
        yield file
    finally:
        file.close()


def _holder(file: BinaryIO) -> str:
    file.seek(0)
    return file.read(200).decode(errors="replace").strip() or "another process"


if sys.platform == "win32":
    import msvcrt

    def _taken(file: BinaryIO) -> bool:
        file.seek(1 << 30)  # what is locked cannot be read by others, so not the text itself
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _taken(file: BinaryIO) -> bool:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True
