"""Files that are put into a folder and its subfolders all together, or not at all."""

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
    """Yield a private folder, whose files are moved into `folder` when the `with` block ends.

    Files of the same names are replaced, and others stay. If the block or a move fails, the folder
    has what it had before, and is removed if it did not exist.

    Parameters
    ----------
    folder : Path
        Where the files belong; it is made if need be.
    last : str
        Name of the file that is moved last: where it is, all others are.

    Raises
    ------
    TermselError
        If another process is at work in the folder, or a file cannot be written.
    """
    # Folders that this creates, so that it can remove them if nothing comes into them.
    created_folders = [parent for parent in (folder, *folder.absolute().parents)
                       if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with lock_folder(folder), private_folder(folder) as private:
            new = private / "new"
            old = private / "old"
            new.mkdir()
            old.mkdir()
            yield new
            files = sorted((file for file in new.rglob("*") if file.is_file()),
                           key=lambda file: file == new / last)
            _move_into_place(files, new, old, folder)
    except OSError as error:
        raise TermselError(f"cannot write the block: {error.strerror or error}", file=folder,
                           hint="Check that the folder is writable and has free space, or choose "
                                "another --out.") from error
    finally:
        for parent in created_folders:
            # A folder with files is not removed: rmdir fails.
            with suppress(OSError):
                parent.rmdir()


def _move_into_place(files: list[Path], new: Path, old: Path, folder: Path) -> None:
    """Move files from `new` to the same places in `folder`, and those that were there to `old`.

    Missing subfolders are created. If a move fails or is interrupted, all moves are undone, and the
    exception is raised.
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
            for source, destination in ((folder / name, old / name), (file, folder / name)):
                if os.path.lexists(source):
                    source.rename(destination)
                    moves.append((source, destination))
        sync(folder)
    # BaseException includes KeyboardInterrupt.
    except BaseException:
        for source, destination in reversed(moves):
            destination.rename(source)
        for parent in reversed(new_folders):
            parent.rmdir()
        raise
