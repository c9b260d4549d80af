"""One process at a time in the folder of a result or a study."""

from __future__ import annotations

import errno
import os
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Literal

from termsel.core.errors import TermselError
from termsel.core.files.names import open_inside, path_inside, refuse_links

LOCK = ".lock"

_HELD = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
"""What systems say where another process holds a lock; all else is that nothing can be locked."""


@contextmanager
def lock_folder(folder: Path,
                hint: str = "Wait for it, or choose another --out.") -> Iterator[None]:
    """Hold the lock of a folder during a block; the system takes it away from a process that ends.

    Raises TermselError if another process holds it, with that process, its machine and since when;
    if the folder cannot be written to; and if there is a link anywhere in it, as it may have come
    with data and lead elsewhere.
    """
    refuse_links(folder)
    with _hold_lock(folder, hint) as file:
        try:
            # A process that does not get the lock reads here which one has it.
            file.truncate(0)
            file.write(f"process {os.getpid()} on {platform.node() or 'this machine'} since "
                       f"{time.strftime('%Y-%m-%d %H:%M:%S')}".encode())
        except OSError as error:  # the disk is full
            raise _unwritable_error(folder, error) from error
        yield


@contextmanager
def _hold_lock(folder: Path, hint: str) -> Iterator[FileIO]:
    """Yield the file of a lock that is held, and remove the file at the end.

    Raises TermselError, with `hint`, where another process still holds it after 0.4 s.
    """
    # Several trials, as a process that asks who holds it (`lock_holder`) holds it for a moment.
    for i in range(5):
        if i:
            time.sleep(0.1)
        with _open_lock(folder, "a+b") as file:
            if not _take_lock_of_folder(file, folder):
                continue
            # The process that held it before may have removed this file since it was opened, and a
            # lock on a removed file would exclude nobody.
            if not _is_at(file, folder / LOCK):
                continue
            try:
                yield file
            finally:
                _remove(file, folder / LOCK)
            return
    raise TermselError(f"{lock_holder(folder) or 'another process'} is at work in this folder",
                       file=folder, hint=hint)


def take_turn(path: Path, seconds: float) -> FileIO | None:
    """Return a lock on a file, for work that one process does at a time, once nobody else holds it.

    Returns None where it is not free after so many seconds, or the file cannot be opened or locked:
    callers must not depend on having it. `end_turn` gives it back.
    """
    deadline = time.monotonic() + seconds
    with suppress(OSError), ExitStack() as files:
        file = files.enter_context(open(path, "a+b", buffering=0))
        while time.monotonic() < deadline:
            # Polled, as no system lets a process wait for a lock and for a time at once.
            if _try_lock(file):
                files.pop_all()  # it is closed by `end_turn`
                return file
            time.sleep(_POLL_SECONDS)
    return None


_POLL_SECONDS = 0.05
"""Seconds between two attempts at a lock: short to who waits, and hardly any work."""


def end_turn(file: FileIO) -> None:
    """Let other processes have their turn."""
    _remove(file, Path(str(file.name)))
    file.close()


def lock_holder(folder: Path) -> str | None:
    """Return who is at work in a folder: process, machine and since when; None if nobody is.

    It is "another process" where that has not written its name yet.
    """
    if not path_inside(folder, LOCK).exists():
        return None
    with _open_lock(folder, "r+b") as file:
        if _take_lock_of_folder(file, folder):
            return None
        # Held by another process: it wrote its name at the beginning.
        file.seek(0)
        return file.read(200).decode(errors="replace").strip() or "another process"


@contextmanager
def _open_lock(folder: Path, mode: Literal["a+b", "r+b"]) -> Iterator[FileIO]:
    """Yield the open file of a folder's lock; a link in its place is not followed.

    Raises TermselError where it cannot be opened.
    """
    try:
        file = open(folder / LOCK, mode, buffering=0,  # noqa: SIM115 (closed below)
                    opener=open_inside)
    except OSError as error:
        raise _unwritable_error(folder, error) from error
    try:
        yield file
    finally:
        file.close()


def _take_lock_of_folder(file: FileIO, folder: Path) -> bool:
    """Take the lock of a folder if no other process has it, and return whether it is taken.

    Raises TermselError where the folder cannot be written to.
    """
    try:
        return _try_lock(file)
    except OSError as error:
        raise _unwritable_error(folder, error) from error


def _try_lock(file: FileIO) -> bool:
    """Take a lock and return True; return False if another process has it."""
    try:
        _lock(file)
    except OSError as error:
        # Any other error is one of the file system, such as a share without locks.
        if error.errno in _HELD:
            return False
        raise
    return True


def _unwritable_error(folder: Path, error: OSError) -> TermselError:
    """Return the error for a folder that cannot be written to."""
    return TermselError(f"cannot write to the folder: {error.strerror or error}", file=folder,
                        hint="Choose another --out.")


def _is_at(file: FileIO, path: Path) -> bool:
    """Return whether an open file is the one that a path names now."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


if sys.platform == "win32":
    import msvcrt

    def _lock(file: FileIO) -> None:
        file.seek(1 << 30)  # what is locked cannot be read by others, so not the text itself
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

    def _remove(file: FileIO, path: Path) -> None:
        file.close()
        with suppress(OSError):  # another process has opened it by now
            path.unlink()
else:
    import fcntl

    def _lock(file: FileIO) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _remove(_file: FileIO, path: Path) -> None:
        with suppress(OSError):  # the folder itself may be gone, or be read-only by now
            path.unlink()
