"""Write a file completely or not at all."""

from __future__ import annotations

import os
import platform
import secrets
import shutil
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir

from termsel.core.errors import TermselError


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` when the block succeeds.

    It has the same name, in a private folder on the same disk; the block creates the file. An
    existing `path` is replaced through symbolic links, and its permissions are kept. When the block
    fails, it stays as it was. Raises TermselError if the file cannot be written, also for OSErrors
    of the block.
    """
    target = Path(os.path.realpath(path))
    # Replacing a folder fails anyway; replacing a device, such as /dev/null, must not succeed.
    if os.path.lexists(target) and not os.path.isfile(target):
        raise TermselError("this is a folder, expected a file" if target.is_dir() else
                           "this is not an ordinary file and cannot be replaced", file=path,
                           hint="Give the name of a file to write.")
    # Checked before the block, which may take long; the message has the name as it was given.
    if not os.access(target.parent, os.W_OK | os.X_OK):
        why = "no permission" if os.path.isdir(target.parent) else "there is no such folder"
        raise _cannot_write(path, why)
    try:
        with private_folder(target.parent) as folder:
            temporary = folder / target.name
            yield temporary
            sync(temporary)
            put_in_place(temporary, target)
            sync(target.parent)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from error


def put_in_place(file: Path, target: Path) -> None:
    """Replace `target` by `file`, which takes its owner and permissions, in one step.

    Both are on one disk, `file` was synced to it, and `target` is no link; it may be missing.
    """
    with suppress(FileNotFoundError):
        before = target.stat()
        if sys.platform != "win32":
            with suppress(PermissionError):  # only the superuser gives files away
                os.chown(file, before.st_uid, before.st_gid)
        file.chmod(before.st_mode & 0o7777)
    file.replace(target)


def sync(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, are on the disk."""
    if path.is_dir():
        with suppress(OSError):  # some disks have no such thing for folders, nor has Windows
            _sync_descriptor(path, os.O_RDONLY)
        return
    _sync_descriptor(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)


def _sync_descriptor(path: Path, mode: int) -> None:
    """Wait until a file or folder is on the disk."""
    descriptor = os.open(path, mode)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path, hint: str = "Choose another --out.") -> None:
    """Make a folder, and those above it, unless it is there.

    Raises TermselError, with the remedy `hint`, if it is a file, or cannot be made.

    Examples
    --------
    >>> from pathlib import Path
    >>> make_folder(Path("."))
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = f"this folder cannot be made: {error.strerror or error}"
        for parent in (folder, *folder.absolute().parents):
            if parent.is_file():
                if parent == folder:
                    reason = "this is a file, expected a folder"
                else:
                    reason = f"this folder cannot be made, as {parent} is a file"
                break
        raise TermselError(reason, file=folder, hint=hint) from error


_PREFIX = ".termsel-"


@contextmanager
def private_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a new folder that only this user can read, and remove it at the end.

    Parameters
    ----------
    parent : pathlib.Path, optional
        Where it is made; by default in the system's folder for temporary files.

    Raises
    ------
    TermselError
        If no folder can be made in the system's folder.
    OSError
        If none can be made in `parent`.
    """
    try:
        folder = _make_folder(Path(gettempdir()) if parent is None else parent)
    except OSError as error:
        # A caller that names a parent knows what could not be written there, and says so.
        if parent is not None:
            raise
        raise TermselError(
            f"cannot write temporary files: {error.strerror or error}",
            hint="Make room on the disk, or name another folder in the variable TMPDIR."
            ) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)  # gone after a rename; never hide an error


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a private folder that becomes `folder` in the end, completely or not at all.

    A block that fails or is interrupted leaves nothing behind, neither half a folder nor the
    private one. Raises TermselError where the name is taken, or the folder above it is missing, a
    file or cannot be written to.
    """
    if os.path.lexists(folder):
        raise TermselError("this folder exists already" if folder.is_dir() else
                           "a file of this name exists already", file=folder,
                           hint="Name a new folder.")
    if not folder.absolute().parent.is_dir():
        parent = folder.absolute().parent
        raise TermselError(f"{parent} is a file, not a folder" if parent.exists() else
                           "the folder above this one does not exist", file=folder,
                           hint="Make it first, or name another folder.")
    try:
        # On the same disk, where a rename is one step.
        with private_folder(folder.absolute().parent) as unfinished:
            yield unfinished
            unfinished.chmod(0o755)
            unfinished.rename(folder)
    except OSError as error:
        raise TermselError(f"cannot write this folder: {error.strerror or error}", file=folder,
                           hint="Check that the folder above it exists and has free space."
                           ) from error


def _make_folder(parent: Path) -> Path:
    """Make a private folder with a name of this process in a folder, and return it."""
    _remove_left(parent)  # processes that were killed leave theirs behind
    folder = parent / f"{_PREFIX}{_machine_word()}-{os.getpid()}-{secrets.token_hex(6)}"
    folder.mkdir(mode=0o700)
    return folder


def _remove_left(parent: Path) -> None:
    """Remove the private folders of processes of this user that have ended."""
    for folder in parent.glob(f"{_PREFIX}{_machine_word()}-*-*"):
        process = folder.name.split("-")[2]
        if process.isdecimal() and not _is_running(int(process)):
            shutil.rmtree(folder, ignore_errors=True)


def _machine_word() -> str:
    """Return a word for this machine: elsewhere process numbers mean other processes."""
    try:
        space = os.readlink("/proc/self/ns/pid")  # containers may share a disk and a name
    except OSError:
        space = ""
    return f"{zlib.crc32(f'{platform.node()} {space}'.encode()):08x}"


def _is_running(process: int) -> bool:
    """Return whether a process still exists; True where that cannot be told."""
    if sys.platform == "win32":  # os.kill would end it; what is left there stays
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _cannot_write(path: Path | str, why: str) -> TermselError:
    """Return the error for a file that cannot be written, and why."""
    return TermselError(f"cannot write this file: {why}", file=path,
                        hint="Check that the folder exists, is writable and has free space.")


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write `data` to `path`, completely or not at all; TermselError if it cannot be written."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write text as UTF-8 with its line ends as they are, as `write_bytes`."""
    write_bytes(path, utf8_bytes(text))


def utf8_bytes(text: str) -> bytes:
    """Return UTF-8, in which names of files that are not UTF-8 have the bytes that they have."""
    return text.encode("utf-8", errors="surrogateescape")
