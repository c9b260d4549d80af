"""Files of several folders that are put in place together, or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from termsel import TermselError
from termsel.toolkit import lock_folder, private_folder
from termsel.toolkit.files import sync


@contextmanager
def place_together(folder: Path, last: str) -> Iterator[Path]:
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
    # Folders that this creates, so that it can remove them if nothing comes into them.
    above = [parent for parent in (folder, *folder.absolute().parents) if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with lock_folder(folder), private_folder(folder) as private:
            new = private / "new"
            old = private / "old"
            new.mkdir()
            old.mkdir()
            yield new
            # The last file shows that all are there: it is moved when the others are.
            files = sorted((file for file in new.rglob("*") if file.is_file()),
                           key=lambda file: file == new / last)
            _move_into_place(files, new, old, folder)
    except OSError as error:
        raise TermselError(f"cannot write the block: {error.strerror or error}", file=folder,
                           hint="Check that the folder is writable and has free space, or choose "
                                "another --out.") from error
    finally:
        for parent in above:
            # It has something.
            with suppress(OSError):
                parent.rmdir()


def _move_into_place(files: list[Path], new: Path, old: Path, folder: Path) -> None:
    """Move files from `new` to their places in `folder`, and those that were there to `old`.

    If one cannot be moved, or on an interruption, all are moved back and the error is raised.
    """
    moves: list[tuple[Path, Path]] = []
    new_folders: list[Path] = []
    try:
        for file in files:
            name = file.relative_to(new)
            for subfolder in reversed(name.parents[:-1]):
                if not (folder / subfolder).exists():
                    (folder / subfolder).mkdir()
                    new_folders.append(folder / subfolder)
                (old / subfolder).mkdir(exist_ok=True)
            # The old file is moved away, then the new one takes its place.
            for start, end in ((folder / name, old / name), (file, folder / name)):
                if os.path.lexists(start):
                    start.rename(end)
                    moves.append((start, end))
        sync(folder)
    # BaseException has interruptions, too; moves are undone in the opposite order.
    except BaseException:
        for start, end in reversed(moves):
            end.rename(start)
        for parent in reversed(new_folders):
            parent.rmdir()
        raise
