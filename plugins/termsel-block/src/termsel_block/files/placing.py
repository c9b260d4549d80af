"""Files of several folders that are put in place together, or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from termsel import TermselError
from termsel.toolkit import locked, private_folder, sync


@contextmanager
def together(folder: Path, last: str) -> Iterator[Path]:
    """Yield a private folder, whose files come into a folder when the block succeeds.

    Files that are there are replaced, and others stay. If anything fails, the folder has what it
    had; if it was not there, it is not.

    Parameters
    ----------
    folder : Path
    last : str
        File that comes last: where it is, everything is.

    Raises
    ------
    TermselError
        If another process is at work in the folder, or a file cannot be written.
    """
    above = [place for place in (folder, *folder.absolute().parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder), private_folder(folder) as made:
            new = made / "new"
            old = made / "old"
            new.mkdir()
            old.mkdir()
            yield new
            files = sorted((file for file in new.rglob("*") if file.is_file()),
                           key=lambda file: file == new / last)
            _put(files, new, old, folder)
    except OSError as error:
        raise TermselError(f"cannot write the block: {error.strerror or error}", file=folder,
                           hint="Check that the folder is writable and has free space, or choose "
                                "another --out.") from error
    finally:
        for place in above:
            with suppress(OSError):  # it has something
                place.rmdir()


def _put(files: list[Path], new: Path, old: Path, folder: Path) -> None:
    """Move files to where they belong, and back if one cannot be moved."""
    moves: list[tuple[Path, Path]] = []
    made: list[Path] = []
    try:
        for file in files:
            name = file.relative_to(new)
            for parent in reversed(name.parents[:-1]):
                if not (folder / parent).exists():
                    (folder / parent).mkdir()
                    made.append(folder / parent)
                (old / parent).mkdir(exist_ok=True)
            for start, end in ((folder / name, old / name), (file, folder / name)):
                if os.path.lexists(start):
                    start.rename(end)
                    moves.append((start, end))
        sync(folder)
    except BaseException:
        for start, end in reversed(moves):
            end.rename(start)
        for place in reversed(made):
            place.rmdir()
        raise
