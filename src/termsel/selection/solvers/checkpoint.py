"""The file from which a stopped search goes on, in another process too.

A search asks for the same evaluations again if it begins with the same seed. Its file therefore
holds the evaluations, in the order in which they were asked for. A search that is resumed begins
anew, takes from the file what is there, and computes the rest. That is the same for every solver,
as no solver has to keep its own state.

The file has a line of JSON for each population, after a first line with the format. A line that a
killed process left incomplete is dropped.
"""

from __future__ import annotations

import logging
import time
from base64 import b64encode
from collections import deque
from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from termsel.adjustment.solve import round_to_nine_digits
from termsel.core.errors import TermselError
from termsel.core.version import __version__
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.solvers.base import Solver

log = logging.getLogger(__name__)

CHECKPOINT_SCHEMA = "termsel-checkpoint-1"

_WRITE_SECONDS = 0.5  # seconds between two writes

_UNKNOWN = -1e99
"""What stands for an unknown number in a digest of data."""

_TOLERANCE = 1e-6
"""Relative difference of two evaluations of one selection that may be rounding."""


class _Line(msgspec.Struct, forbid_unknown_fields=True):
    """Evaluations of one population, of one stage of the run.

    `digest` shows which individuals they are of; `values` are little-endian float64, the objectives
    and the violation of each; `seconds` is what the search had taken by then.
    """

    stage: int
    digest: str
    values: bytes
    seconds: float


class _Head(msgspec.Struct, forbid_unknown_fields=True):
    """First line of the file."""

    schema: str
    version: str
    data: str = ""
    """Digest of what is searched, by `digest_of_data`; "" where nobody says."""


class Checkpoint:
    """The file of the searches of one run.

    Parameters
    ----------
    path : path-like
        It is made if it is not there.
    data : str, optional
        Digest of the data that are searched, by `digest_of_data`. Figures that were evaluated show
        other data, too, but only where they have a part in them.

    Raises
    ------
    TermselError
        For another file, one of other data, and for one that cannot be read or written.
    """

    def __init__(self, path: Path | str, data: str = "") -> None:
        """Read the file, or begin it; raises TermselError as the class says."""
        self.path = Path(path)
        self._data = data
        self._lines: dict[int, list[_Line]] = {}
        self._stages = 0
        try:
            content = self.path.read_bytes() if self.path.exists() else b""
            # A process that was killed may have left half a line.
            complete = content[:content.rfind(b"\n") + 1]
            # The file stays as it is until it is known to be a checkpoint.
            if content:
                self._read(complete.splitlines())
                with self.path.open("r+b") as file:
                    file.truncate(len(complete))
            else:
                head = msgspec.json.encode(_Head(CHECKPOINT_SCHEMA, __version__, data))
                self.path.write_bytes(head + b"\n")
        except OSError as error:
            raise TermselError(f"the checkpoint cannot be used: {error.strerror or error}",
                               file=self.path, hint="Check the name and the permissions of the "
                               "file, and free space, or name another.") from error

    def _read(self, lines: Sequence[bytes]) -> None:
        """Keep the lines of an earlier process by their stage; note another version of termsel.

        Raises TermselError if they are no checkpoint, or that of other data, or one is damaged.
        """
        try:
            # Another file by mistake: its content must not be lost.
            head = msgspec.json.decode(lines[0], type=_Head) if lines else None
        except msgspec.DecodeError:
            head = None
        if head is None or head.schema != CHECKPOINT_SCHEMA:
            raise TermselError("this file is no checkpoint of a search, and stays as it is",
                               hint="Give the name of a new file.", file=self.path)
        if head.data and self._data and head.data != self._data:
            raise _error_for_other_data(self.path)
        if head.version != __version__:
            log.warning("Note: %s was begun by termsel %s; this is %s.", self.path, head.version,
                        __version__)
        for number, text in enumerate(lines[1:], start=2):
            try:
                line = msgspec.json.decode(text, type=_Line)
            except msgspec.DecodeError:
                raise TermselError("this line of the checkpoint is damaged",
                                   hint="Remove it and all lines after it.",
                                   file=self.path, line=number) from None
            self._lines.setdefault(line.stage, []).append(line)

    @property
    def seconds(self) -> float:
        """How long the next search, with its local refinement, has run in earlier processes."""
        return max((self._lines[stage][-1].seconds for stage in (self._stages, self._stages + 1)
                    if stage in self._lines), default=0.0)

    def next_search(self, start: float) -> tuple[Stage, Stage]:
        """Return the stages of the next search: its own, and that of its local refinement.

        `start` is when the search began, by `time.perf_counter`.
        """
        # Even numbers are searches, odd ones their local refinements.
        numbers = (self._stages, self._stages + 1)
        self._stages += 2
        search, refinement = (Stage(self.path, number, deque(self._lines.get(number, ())), start)
                              for number in numbers)
        return search, refinement


class Stage:
    """The evaluations of one stage: those that are known, and those that are added."""

    def __init__(self, path: Path, number: int, lines: deque[_Line], start: float) -> None:
        """Begin with the `lines` of this stage in the file; `start` is when the search began."""
        self.path = path
        self._number = number
        self._lines = lines
        self._start = start
        self._unwritten: list[_Line] = []
        self._written = time.perf_counter()
        self._n_replayed = 0
        self._is_compared = False

    @property
    def is_replaying(self) -> bool:
        """Whether evaluations of the file are still to come."""
        return bool(self._lines)

    def replay_next(self, keys: Sequence[bytes], problem: Problem, genes: Any) -> Evaluation | None:
        """Return the next evaluation of the file, or None where the file has come to its end.

        It is that of the individuals `genes`, whose keys are `keys`, which are counted as replayed.
        An evaluation of the first of them alone, cut short by a smaller budget, is passed over.
        Raises TermselError for a file of another search or of other data.
        """
        while self._lines:
            line = self._lines.popleft()
            values = np.frombuffer(line.values, dtype="<f8")
            columns = len(problem.objectives) + 1
            n = len(values) // columns
            # The digest of the selections shows whether this is the same search.
            if (n == 0 or len(values) % columns or n > len(keys)
                    or line.digest != _checksum_of_state(keys[:n])):
                raise self._error_for_other_search()
            # The last population of a smaller budget was cut short: it is evaluated as a whole.
            if n < len(keys):
                continue
            # A copy that can be written to, in the byte order of this machine.
            table = values.reshape(n, columns).astype(np.float64)
            evaluation = Evaluation(table[:, :-1], table[:, -1])
            # Once some selection was compared, the same data give the same figures ever after.
            if not self._is_compared:
                self._require_same(evaluation, problem, genes)
            self._n_replayed += n
            return evaluation
        return None

    def _require_same(self, evaluation: Evaluation, problem: Problem, genes: Any) -> None:
        """Evaluate a population again: other data give other figures.

        Raises TermselError if they differ. What has no solution shows nothing, as it is infinite
        whatever the data: only a population with a solution sets `_is_compared`.
        """
        evaluated_now = problem.evaluate(genes)
        is_solved = (evaluation.violation <= 0) & np.isfinite(evaluation.objectives).all(axis=1)
        self._is_compared = bool(is_solved.any())
        if not (_are_alike(evaluated_now.objectives, evaluation.objectives)
                and _are_alike(evaluated_now.violation, evaluation.violation)):
            raise _error_for_other_data(self.path)

    def _error_for_other_search(self) -> TermselError:
        """Return the error for a checkpoint that another search has written."""
        where = f"from evaluation {self._n_replayed + 1:,} on " if self._n_replayed else ""
        return TermselError(
            f"this search differs {where}from the one of the checkpoint",
            hint="Give the same problem, data, solver, options and seed, or the name of a new "
                 "file. A budget may grow where no local refinement follows, and with ga where the "
                 "population is given.", file=self.path)

    def add(self, keys: Sequence[bytes], evaluation: Evaluation) -> None:
        """Add an evaluation; it is written at once, or with others half a second later."""
        # Binary, as decimals would cost more time than some evaluations; little-endian on any
        # machine.
        values = np.column_stack([evaluation.objectives, evaluation.violation]).astype("<f8")
        seconds = time.perf_counter()
        self._unwritten.append(_Line(self._number, _checksum_of_state(keys), values.tobytes(),
                                     seconds - self._start))
        # A search may make hundreds of populations a second.
        if seconds - self._written > _WRITE_SECONDS:
            self.write()

    def write(self) -> None:
        """Write the lines added since the last time; raises TermselError if that fails."""
        content = b"".join(msgspec.json.encode(line) + b"\n" for line in self._unwritten)
        try:
            with self.path.open("ab") as file:
                file.write(content)
        except OSError as error:
            raise TermselError(f"the checkpoint cannot be written: {error.strerror or error}",
                               file=self.path, hint="Check the folder, and the free space on "
                                                    "the disk.") from error
        self._unwritten = []
        self._written = time.perf_counter()


def require_resumable(solver: Solver) -> None:
    """Raise TermselError for a solver that does its work elsewhere than in evaluations."""
    if not solver.can_resume:
        raise TermselError(f"solver {solver.name!r} keeps no checkpoint: what takes its time is no "
                           "evaluation", hint="Leave the checkpoint out.")


def digest_of_data(control: FeatureSet, check: Points) -> str:
    """Return a digest of control and selection points: names, positions, weights and CRS.

    Numbers count to nine digits, as another machine may round them otherwise.
    """
    digest = blake2b(digest_size=12)
    points = control.points
    lines = control.lines
    # A NUL ends each text, and an empty one each list, so that none runs into the next.
    for text in (control.crs, control.fit_crs or "", *points.ids, "", *lines.ids, "", *check.ids):
        digest.update(f"{text}\0".encode())
    for values in (points.image, points.ground, points.sigma, lines.image, lines.ground,
                   lines.sigma, check.image, check.ground, check.sigma):
        if values is None:
            digest.update(b"none")
            continue
        # Adding 0 turns -0 into 0, which is another number by its bytes.
        known = np.nan_to_num(values, nan=_UNKNOWN)
        digest.update(np.ascontiguousarray(round_to_nine_digits(known) + 0.0, "<f8").tobytes())
    return b64encode(digest.digest()).decode()


def _error_for_other_data(path: Path) -> TermselError:
    """Return the error for a checkpoint whose search was of other data."""
    return TermselError("the checkpoint is of other data, or of another problem",
                        hint="Give the name of a new file, or what the file was made with.",
                        file=path)


def _checksum_of_state(keys: Sequence[bytes]) -> str:
    """Return a checksum of the keys of individuals, in their order."""
    return b64encode(blake2b(b"".join(keys), digest_size=12).digest()).decode()


def _are_alike(values: FloatArray, others: FloatArray) -> bool:
    """Return whether objectives are equal but for the rounding of another processor."""
    return bool(np.allclose(values, others, rtol=_TOLERANCE, atol=0.0))
