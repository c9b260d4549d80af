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
MOST_REPEATED = 2_000_000
"""Changes of features that are repeated from a journal, 2 s."""


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
        """Write an entry and wait until it is on the disk.

        Raises TermselError where that fails; then the journal is as it was before.
        """
        # One line an entry, so that a torn one is only the last.
        text = json.dumps(entry, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        end = self._file.seek(0, os.SEEK_END)
        try:
            content = memoryview(f"{text}\n".encode())
            while content:  # a disk that is nearly full takes a part
                content = content[self._file.write(content):]
            os.fsync(self._file.fileno())
        except OSError as error:
            # Half an entry would hide all that follow.
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
            file = open(path, "a+b", buffering=0, opener=_without_links)  # noqa: SIM115
        except OSError as error:
            raise TermselError(f"the session cannot be written: {error.strerror}", file=path,
                               hint="Choose another --out.") from error
        with file, _unless_empty(file, path):
            entries, length = read_entries(file, path)
            # What a crash has cut off was never confirmed on the page.
            file.truncate(length)
            journal = Journal(file, path)
            if not entries:
                yield journal, None, ControlFeatures()
            else:
                yield journal, _parse_header(entries[0], path), replay_journal(entries[1:], path)


@contextmanager
def _unless_empty(file: FileIO, path: Path) -> Iterator[None]:
    """Remove the journal at the end if nothing was written to it."""
    try:
        yield
    finally:
        # Opened for nothing, as where an image cannot be read.
        if not os.fstat(file.fileno()).st_size:
            path.unlink(missing_ok=True)


def header_of(folder: Path) -> dict[str, Any]:
    """Return the header of the session in a folder; raises TermselError if there is none."""
    path = path_inside(folder, JOURNAL_NAME)
    require_regular(path)
    try:
        with open(path, "rb", buffering=0, opener=_without_links) as file:
            entries, _ = read_entries(file, path)
    except OSError as error:
        raise TermselError(f"the session cannot be read: {error.strerror}", file=path,
                           hint="Check the permissions of its folder.") from error
    if not entries:
        raise TermselError("the session is empty", file=path,
                           hint="Remove its folder, or choose another --out.")
    return _parse_header(entries[0], path)


def _without_links(name: str, flags: int) -> int:
    """Open a file as `open` does, but fail on a symbolic link, which could lead anywhere."""
    # A link in a folder of strangers could lead anywhere; Windows has no such flag.
    return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def read_entries(file: FileIO, path: Path) -> tuple[list[dict[str, Any]], int]:
    """Return the entries of a journal, and its length [bytes] up to the end of the last whole line.

    Raises TermselError for a line that is no entry, or a journal too large to be read.
    """
    file.seek(0)
    if os.fstat(file.fileno()).st_size > MAX_JOURNAL_BYTES:
        raise TermselError("the session is too large to be read", file=path,
                           hint="Export its points, and begin another one: --out DIR.")
    content = file.readall() or b""
    length = content.rfind(b"\n") + 1  # what follows was cut off
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
    """Return the header in the first entry of a journal; raises TermselError if it is no session's.
    """
    if entry.get("schema") != JOURNAL_SCHEMA:
        raise TermselError("this is no session of termsel app: its first line lacks "
                           f"{JOURNAL_SCHEMA}",
                           file=path, line=1,
                           hint="Give the folder of a session, or choose another --out.")
    return {key: value for key, value in entry.items() if key != "schema"}


def replay_journal(entries: list[dict[str, Any]], path: Path) -> ControlFeatures:
    """Return the features after all changes of a journal, whose first entry is the header.

    `entries` are those after the header. Raises TermselError with the line that cannot be repeated.
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
        repeated += len(patches)  # each undo and redo may be of all features
        if len(control) > MAX_FEATURES or repeated > MOST_REPEATED:
            raise TermselError(f"a session has at most {MAX_FEATURES:,} features and "
                               f"{MOST_REPEATED:,} changes of them", file=path, line=number,
                               hint="Export its points, and begin another one: --out DIR.")
    return control


def patches_of(entry: Mapping[str, Any]) -> list[Patch]:
    """Return the patches of an entry with a change; raises TermselError if it has none."""
    change = entry.get("change")
    if not isinstance(change, list) or not all(
            isinstance(pair, list) and len(pair) == 2 for pair in change):
        raise TermselError("it has no change")
    patches = []
    for pair in change:
        before, after = (
            None if record is None else checked_record(_parse_record(record)) for record in pair)
        patches.append(Patch(before, after))
    return patches


def _parse_record(record: Any) -> dict[str, Any]:
    """Return a record; raises TermselError if it is no JSON object."""
    if not isinstance(record, dict):
        raise TermselError("it has no points or lines")
    return record


def entry_of(patches: list[Patch]) -> dict[str, Any]:
    """Return the entry of a journal for a change, which `patches_of` reads again."""
    return {"change": [[patch.before, patch.after] for patch in patches]}
