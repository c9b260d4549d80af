"""The journal of a study: one line for each finished cell, which no interruption takes away.

Every line is JSON with a checksum. A line is written with a single call and never changed. What was
being written when a disk was full or a process killed is cut off when the journal is opened again.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal

from msgspec import Meta, ValidationError, convert

from termsel.core.errors import TermselError, count_in_words
from termsel.core.files.names import JOURNAL, is_there, open_inside, path_inside
from termsel.data.record.figures import RecordPart, as_plain_data
from termsel.formats.base import read_data

STUDY_SCHEMA = "termsel-study-1"

_SYNC = 1.0
"""Seconds between waits for the disk: a power failure costs at most the cells of that time."""

State = Literal["done", "infeasible", "failed"]


Number = float | None

Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]


class Figures(RecordPart, frozen=True):
    """What the columns of a finished cell may hold: a journal with anything else was forged."""

    objective: str | None = None
    chosen: str | None = None
    proven: bool = False
    fitness: Number = None
    optimum: Number = None
    control: Number = None
    check: Number = None
    independent: Number = None
    predicted: Number = None
    predicted_low: Number = None
    predicted_high: Number = None
    predicted_m: Number = None
    independent_m: Number = None
    pixel: Number = None
    without_height: int = 0
    n_control: int = 0
    n_check: int = 0
    n_independent: int = 0
    n_terms: int = 0
    n_features: int = 0
    n_genes: int = 0
    evaluations: int = 0
    refinement_evaluations: int = 0
    generations: int = 0
    excluded: int = 0
    blunders: tuple[str, ...] = ()
    place: tuple[Degrees, Degrees] | None = None
    exchanged: tuple[Degrees, Degrees] | None = None
    mirrored: bool | None = None
    doubt: str = ""
    notes: tuple[str, ...] = ()
    measures: Mapping[str, Number] = {}
    seconds: float = 0.0
    cpu_seconds: float = 0.0


class CellRecord(RecordPart, frozen=True):
    """A finished cell."""

    cell: str
    """Key of the cell."""
    state: State
    """How it ended."""
    reason: str
    """Why it has no result; empty if it has one."""
    figures: Mapping[str, Any]
    """Its columns in the table of the study, by name; empty if it failed."""
    trace: list[Annotated[list[float], Meta(min_length=3, max_length=3)]]
    """Evaluations, best value and CPU seconds at every improvement."""
    front: list[Annotated[list[float], Meta(min_length=2)]]
    """Objectives of each member of its front."""

    def __post_init__(self) -> None:
        """Raise TermselError for a front whose members have different objectives."""
        if len(set(map(len, self.front))) > 1:
            raise ValueError("front: its members have different numbers of objectives")


@dataclass
class Journal:
    """Records of finished cells by their key, and the file they are appended to.

    The records are those of all cells in the file, whether they belong to the study or not.
    """

    path: Path
    records: dict[str, CellRecord] = field(default_factory=dict)
    # of termsel and what it computes with, when the study was begun; empty if new
    versions: Mapping[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)  # what was wrong with the file
    _file: BinaryIO | None = None
    _end: int = 0
    _synced: float = 0.0

    def open(self, versions: Mapping[str, str]) -> None:
        """Cut off a torn last line, begin the file if it is new, refuse one of other versions.

        A study goes on with the versions that it was begun with: figures of different programs
        would stand in one table. Raises TermselError naming what has changed, and where the file
        cannot be written.
        """
        # Numbers of one study must be of one program.
        if self.versions and dict(self.versions) != dict(versions):
            pairs = {name: (self.versions.get(name, "none"), versions.get(name, "none"))
                     for name in sorted({*self.versions, *versions})}
            changed = [f"{name} {before} (now {current})"
                       for name, (before, current) in pairs.items() if before != current]
            raise TermselError(f"this study was begun with {', '.join(changed)}", file=self.path,
                               hint="Results may differ between versions. Use those versions, or "
                                    "choose another --out.")
        try:
            # Whatever was torn is cut off, so that the next line begins at the start of one.
            self._file = open(self.path, "ab",  # noqa: SIM115 (closed by `close`)
                              opener=open_inside)
            self._file.truncate(self._end)
        except OSError as error:
            raise self._unwritable_error(error) from error
        if not self.versions:
            self.versions = dict(versions)
            self._write({"schema": STUDY_SCHEMA, "versions": self.versions})

    def append(self, record: CellRecord) -> None:
        """Add the record of a cell; if the disk refuses it, the journal stays as it was."""
        self._write(as_plain_data(record))
        self.records[record.cell] = record

    def close(self) -> None:
        """Wait until all is on the disk."""
        if self._file is not None:
            # fsync returns when the disk has the data; close alone does not wait.
            os.fsync(self._file.fileno())
            self._file.close()
            self._file = None

    def _write(self, record: Mapping[str, Any]) -> None:
        """Append a record as one line; a part of it that is written is taken back on failure.

        Raises TermselError where the file cannot be written.
        """
        assert self._file is not None
        line = _seal_record(record)
        try:
            # Without a buffer in between, so that a killed process leaves a torn line at worst.
            unwritten = line
            while unwritten:
                unwritten = unwritten[os.write(self._file.fileno(), unwritten):]
            if time.monotonic() - self._synced > _SYNC:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            # Half a line would be taken for damage later.
            os.ftruncate(self._file.fileno(), self._end)
            raise self._unwritable_error(error) from error
        self._end += len(line)

    def _unwritable_error(self, error: OSError) -> TermselError:
        """Return the error for a journal that cannot be written, and how to go on."""
        return TermselError(
            f"cannot write the journal: {error.strerror or error}", file=self.path,
            hint=f"{count_in_words(len(self.records), 'finished run')} are kept. Make space, then "
                 "repeat the command to go on.")


def read_journal(folder: Path) -> Journal:
    """Return the journal of a folder, empty if there is none; nothing is changed on the disk.

    Each line of the journal is a finished cell. A crash may tear the last line, which is cut off
    later; damage in the middle costs the cells of these lines, which are run again. Raises
    TermselError for a file that is no journal, or of another version of its schema.
    """
    journal = Journal(path_inside(folder, JOURNAL))
    try:
        content = read_data(journal.path)
    except TermselError:
        if not is_there(journal.path):
            return journal
        raise
    lines = content.splitlines(keepends=True)
    damaged = []
    for number, line in enumerate(lines, 1):
        record = _record_of_line(line)
        if record is None:
            # The last line may be torn by a crash; one in the middle is damage.
            if number == len(lines):
                break
            damaged.append(number)
        elif "schema" in record:
            if record["schema"] != STUDY_SCHEMA:
                raise TermselError(f"this journal has the schema {record['schema']!r}, not "
                                   f"{STUDY_SCHEMA!r}", file=journal.path,
                                   hint="Use the version of termsel that wrote it.")
            journal.versions = record["versions"]
        else:
            try:
                cell = convert(record, CellRecord)
                convert(cell.figures, Figures)
            except (ValidationError, UnicodeEncodeError):  # half a character, \ud800
                damaged.append(number)
            else:
                journal.records[cell.cell] = cell
        # Damaged lines in the middle stay; they are only not used.
        journal._end += len(line)
    if journal._end < len(content):
        journal.remarks.append(f"The last line of {journal.path} was torn and is cut off.")
    if damaged:
        journal.remarks.append(
            f"{journal.path} is damaged in {count_in_words(len(damaged), 'line')}, the first of "
            f"them line {damaged[0]}. Those runs are repeated.")
    if content and not (journal.versions or journal.records) and not _torn_at_once(lines):
        raise TermselError("this is not the journal of a study", file=journal.path,
                           hint="Choose another --out.")
    return journal


def _torn_at_once(lines: list[bytes]) -> bool:
    """Return whether a process was killed while it wrote the very first line."""
    return len(lines) == 1 and b'{"record":{"schema"'.startswith(lines[0][:19])


def _seal_record(record: Mapping[str, Any]) -> bytes:
    """Return a record as a line with its checksum."""
    text = _entry_text(record)
    return f'{{"record":{text},"sha256":"{_checksum_of_text(text)}"}}\n'.encode()


def _record_of_line(line: bytes) -> Mapping[str, Any] | None:
    """Return the record of a line; None if it is torn or damaged."""
    # A line is complete with its line end.
    if not line.endswith(b"\n"):
        return None
    try:
        sealed = json.loads(line)
        record = sealed["record"]
        is_valid = isinstance(record, dict) and (
            "schema" not in record or isinstance(record.get("versions"), dict))
        # The text is made again from what was read, so that any change of it shows.
        is_valid = is_valid and _checksum_of_text(_entry_text(record)) == sealed["sha256"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return record if is_valid else None


def _entry_text(record: Mapping[str, Any]) -> str:
    """Return a record as a line of the journal; raises ValueError for NaN or infinity."""
    return json.dumps(record, separators=(",", ":"), allow_nan=False)


def _checksum_of_text(text: str) -> str:
    """Return a checksum of the text of an entry."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
