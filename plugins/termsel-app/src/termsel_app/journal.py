"""The journal of a session: its files in the first line, and then one line a change.

A line is on the disk before the page hears of the change. The next start reads the lines again; one
that was cut off, as when the machine lost power, is dropped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Any

from termsel import TermselError
from termsel.toolkit import lock_folder, path_inside, require_regular
from termsel_app.control import MAX_FEATURES, ControlFeatures, Patch, checked_record

JOURNAL_SCHEMA = "termsel-app-1"
JOURNAL_NAME = "session.jsonl"
MAX_JOURNAL_BYTES = 2**28
"""Bytes of a journal that are read."""
MAX_REPEATED = 2_000_000
"""Changes of features that are repeated from a journal at most; they take about 2 s."""


class Journal:
    """A journal that is open for appending.

    Parameters
    ----------
    file : io.FileIO
    path : pathlib.Path
        Its name, for messages.
    """

    def __init__(self, file: FileIO, path: Path) -> None:
        self._file = file
        self._path = path

    def begin(self, header: Mapping[str, Any]) -> None:
        """Write the first line of a new session: the schema and the header, which names its files.
        """
        self.append({"schema": JOURNAL_SCHEMA, **header})

    def append(self, entry: Mapping[str, Any]) -> None:
        """Write an entry, and wait until it is on the disk.

        Raises TermselError if that fails; the journal is then as it was before.
        """
        # An entry is one line, so that a crash can damage the last line alone.
        text = json.dumps(entry, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        end = self._file.seek(0, os.SEEK_END)
        try:
            content = memoryview(f"{text}\n".encode())
            # A disk that is nearly full may take but a part at once.
            while content:
                content = content[self._file.write(content):]
            os.fsync(self._file.fileno())
        except OSError as error:
            # The next entry would continue the line of half an entry, and be lost with it.
            self._file.truncate(end)
            raise TermselError(
                f"the change could not be saved: {error.strerror or error}", file=self._path,
                hint="Nothing that was measured before is lost. Make room, then do it again."
            ) from error


@contextmanager
def open_journal(folder: Path) -> Iterator[
        tuple[Journal, dict[str, Any] | None, ControlFeatures]]:
    """Open the journal of a folder, which nobody else can open meanwhile.

    Yields the journal, its header, and the features as the last change left them. A new journal has
    no header yet: None (see `Journal.begin`). An entry at the end that is incomplete is cut off,
    and a journal to which nothing was written is removed on leaving.

    Raises
    ------
    TermselError
        If another program has the journal open, or if its file cannot be opened, or is no journal.
    """
    with lock_folder(folder, "Another `termsel app` has this session open: use its page, or choose "
                     "another --out."):
        path = path_inside(folder, JOURNAL_NAME)
        if path.exists():
            require_regular(path)
        try:
            file = open(path, "a+b", buffering=0, opener=_open_without_links)  # noqa: SIM115
        except OSError as error:
            raise TermselError(f"the session cannot be written: {error.strerror}", file=path,
                               hint="Choose another --out.") from error
        with file, _removed_if_empty(file, path):
            entries, length = read_entries(file, path)
            # A line without an end was cut off by a crash, and never confirmed on the page.
            file.truncate(length)
            journal = Journal(file, path)
            if not entries:
                yield journal, None, ControlFeatures()
            else:
                yield journal, _parse_header(entries[0], path), replay_journal(entries[1:], path)


@contextmanager
def _removed_if_empty(file: FileIO, path: Path) -> Iterator[None]:
    """Remove the journal `path` at the end of the block if nothing was written to it.

    So a session that could not begin, as its image cannot be read, leaves no journal.
    """
    try:
        yield
    finally:
        if not os.fstat(file.fileno()).st_size:
            path.unlink(missing_ok=True)


def header_of(folder: Path) -> dict[str, Any]:
    """Return the header of the session in a folder.

    Raises TermselError if there is no journal, or it cannot be read, is empty or is damaged.
    """
    path = path_inside(folder, JOURNAL_NAME)
    require_regular(path)
    try:
        with open(path, "rb", buffering=0, opener=_open_without_links) as file:
            entries, _ = read_entries(file, path)
    except OSError as error:
        raise TermselError(f"the session cannot be read: {error.strerror}", file=path,
                           hint="Check the permissions of its folder.") from error
    if not entries:
        raise TermselError("the session is empty", file=path,
                           hint="Remove its folder, or choose another --out.")
    return _parse_header(entries[0], path)


def _open_without_links(name: str, flags: int) -> int:
    """Open a file as an opener of `open` does; raise OSError for a symbolic link.

    A link in a folder that others can write to could lead to any file of the user.
    """
    # Windows does not have the flag.
    return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def read_entries(file: FileIO, path: Path) -> tuple[list[dict[str, Any]], int]:
    """Return the entries of a journal, and its length [bytes] up to the end of the last whole line.

    A last line without an end is left out. Raises TermselError for a whole line that is no JSON
    object, or a journal of more than `MAX_JOURNAL_BYTES`.
    """
    file.seek(0)
    if os.fstat(file.fileno()).st_size > MAX_JOURNAL_BYTES:
        raise TermselError("the session is too large to be read", file=path,
                           hint="Export its points, and begin another one: --out DIR.")
    content = file.readall() or b""
    # What follows the last end of a line was cut off when it was written.
    length = content.rfind(b"\n") + 1
    entries = []
    for number, line in enumerate(content[:length].splitlines(), 1):
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise TermselError(f"this line is not an entry of a session: {error}",
                               file=path, line=number,
                               hint="Was the file edited? Remove the line, or choose another "
                                    "--out.") from error
        if not isinstance(entry, dict):
            raise TermselError("this line is not an entry of a session", file=path, line=number,
                               hint="Was the file edited? Remove the line, or choose another "
                                    "--out.")
        entries.append(entry)
    return entries, length


def _parse_header(entry: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the first entry of a journal without its schema.

    Raises TermselError if the schema is not that of a session.
    """
    if entry.get("schema") != JOURNAL_SCHEMA:
        raise TermselError("this is no session of termsel app: its first line lacks "
                           f"{JOURNAL_SCHEMA}",
                           file=path, line=1,
                           hint="Give the folder of a session, or choose another --out.")
    return {key: value for key, value in entry.items() if key != "schema"}


def replay_journal(entries: list[dict[str, Any]], path: Path) -> ControlFeatures:
    """Return the features after all changes of a journal; `entries` are those after the header.

    Raises TermselError, with the line in the journal, for an entry that cannot be repeated, and for
    more features or changes than a session may have.
    """
    control = ControlFeatures()
    repeated = 0
    # Line 1 is the header.
    for number, entry in enumerate(entries, 2):
        try:
            if "undo" in entry:
                patches: Sequence[Patch] = control.undo()
            elif "redo" in entry:
                patches = control.redo()
            else:
                patches = patches_of(entry)
                control.apply(patches)
        except TermselError as error:
            raise TermselError(f"this change cannot be repeated: {error.what}", file=path,
                               line=number, hint="Was the file edited? Remove the line, or choose "
                                                 "another --out.") from error
        # An undo or redo is a short entry that may change all features: a few lines could take
        # hours.
        repeated += len(patches)
        if len(control) > MAX_FEATURES or repeated > MAX_REPEATED:
            raise TermselError(f"a session has at most {MAX_FEATURES:,} features and "
                               f"{MAX_REPEATED:,} changes of them", file=path, line=number,
                               hint="Export its points, and begin another one: --out DIR.")
    return control


def patches_of(entry: Mapping[str, Any]) -> list[Patch]:
    """Return the patches in an entry of a journal.

    Raises TermselError if it has no change, or one whose features are not valid.
    """
    change = entry.get("change")
    if not isinstance(change, list) or not all(
            isinstance(pair, list) and len(pair) == 2 for pair in change):
        raise TermselError("it has no change")
    patches = []
    for pair in change:
        before, after = (
            None if record is None else checked_record(_require_object(record)) for record in pair)
        patches.append(Patch(before, after))
    return patches


def _require_object(record: Any) -> dict[str, Any]:
    """Return a record as it is; raise TermselError if it is no JSON object."""
    if not isinstance(record, dict):
        raise TermselError("it has no points or lines")
    return record


def entry_of(patches: list[Patch]) -> dict[str, Any]:
    """Return the entry of a journal for a change, which `patches_of` reads again."""
    return {"change": [[patch.before, patch.after] for patch in patches]}
