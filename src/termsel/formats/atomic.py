"""Write a file completely or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from termsel.errors import TermselError


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` when the block succeeds.

    Parameters
    ----------
    path : path-like
        The file to write; one that exists is replaced, through symbolic links.

    Yields
    ------
    pathlib.Path
        A path in the same folder and with the same suffix; the block creates the file. It
        is removed when the block fails, and `path` is then as it was.

    Raises
    ------
    TermselError
        If the file cannot be written; an OSError in the block is reported the same way.
    """
    target = Path(path).resolve()
    # Replacing a folder fails anyway; replacing a device, such as /dev/null, must not succeed.
    if target.exists() and not target.is_file():
        raise TermselError("this is not an ordinary file and cannot be replaced", file=path,
                           hint="Give the name of a file to write.")
    # Before long work, and with the name as given.
    if not os.access(target.parent, os.W_OK | os.X_OK):
        why = "no permission" if target.parent.is_dir() else "there is no such folder"
        raise _cannot_write(path, why)
    # Not tempfile: its files are private to the user, those of open() follow the umask. The
    # suffix stays because some libraries choose the format by it.
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(6)}{target.suffix}")
    try:
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from error
    finally:
        with suppress(OSError):  # gone after success; never hide the first error
            temporary.unlink()


def _cannot_write(path: Path | str, why: str) -> TermselError:
    return TermselError(f"cannot write this file: {why}", file=path,
                        hint="Check that the folder exists, is writable and has free space.")


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write `data` to `path`, completely or not at all.

    Raises
    ------
    TermselError
        If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path` as UTF-8 with its line ends as they are, completely or not at all.

    Raises
    ------
    TermselError
        If the file cannot be written.
    """
    write_bytes(path, text.encode("utf-8"))
