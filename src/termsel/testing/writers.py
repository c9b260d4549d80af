"""What every writer of results must do."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Points
from termsel.formats.base import Writer
from termsel.models.quotient import RationalFunctions
from termsel.results.result import Result
from termsel.runs.searching import result_of_search
from termsel.runs.task import prepare
from termsel.selection.solvers.search import search
from termsel.testing.cases import (
    Case,
    Suite,
    declaration_check,
    label_with_options,
    make_instance,
    require,
    require_refused,
)
from termsel.testing.scenes import imaged_features, random_coefficients, seeded_generator

OLD = b"what was there before"

Verify = Callable[[Result, Path], None]


@dataclass(frozen=True, eq=False)
class Export:
    """A writer and its inputs.

    `verify` takes a result and the file it was written to; it raises if they do not agree.
    """

    writer: Writer
    results: tuple[Result, ...]
    filename: str
    verify: Verify | None

    def accepted(self) -> list[Result]:
        """Return the results the writer accepts, at least one."""
        accepted = [result for result in self.results if self.writer.accepts(result)]
        require(accepted, "accepts() refuses all results; give some that it accepts as `results`")
        return accepted


def accepts_answers(export: Export) -> None:
    """It shows for every result whether it can write it, and can write some."""
    for result in export.results:
        answer = export.writer.accepts(result)
        require(isinstance(answer, bool), f"accepts() must be True or False, not {answer!r}")
    export.accepted()


def writes_file(export: Export) -> None:
    """It writes the requested file and leaves nothing temporary, whatever was there."""
    for result in export.accepted():
        with TemporaryDirectory() as folder:
            path = Path(folder) / export.filename
            # Twice: to a new file, and over one that is there.
            for _ in range(2):
                export.writer.write(result, path)
                require(path.is_file() and path.stat().st_size, "write() writes no file, or an "
                                                                "empty one, to the path given")
                _require_tidy(path)
                if export.verify is not None:
                    export.verify(result, path)
                path.write_bytes(OLD)


def result_unchanged(export: Export) -> None:
    """It does not change its inputs."""
    for result in export.accepted():
        before = result.to_json()
        with TemporaryDirectory() as folder:
            export.writer.write(result, Path(folder) / export.filename)
        require(result.to_json() == before, "write() changes the result it is given")
# In a folder that is removed, since a writer may write several files.


def unwritable_path(export: Export) -> None:
    """A path that cannot be written is refused by its name."""
    for result in export.accepted():
        with TemporaryDirectory() as folder:
            _require_write_refused(export, result, Path(folder) / "missing" / export.filename,
                                   "a path in a folder that does not exist")
            occupied = Path(folder) / export.filename
            occupied.mkdir()
            _require_write_refused(export, result, occupied, "a path where there is a folder")
            require(occupied.is_dir() and not list(occupied.iterdir()), "it writes into a folder "
                    "with the name of the file")
            _require_tidy(occupied)


def refuses_others(export: Export) -> None:
    """A result it does not accept is refused, and an existing file is not changed."""
    for result in export.results:
        if not export.writer.accepts(result):
            with TemporaryDirectory() as folder:
                path = Path(folder) / export.filename
                path.write_bytes(OLD)
                try:
                    export.writer.write(result, path)
                except TermselError:
                    _require_old(path, "a result it does not accept")
                else:
                    raise AssertionError("write() of a result that accepts() does not take must "
                                         "raise TermselError")


def whole_or_nothing(export: Export) -> None:
    """When the disk is full, the error names the file, and an existing file is kept.

    The full disk is a limit on the size of files, which Windows does not have; there the check
    does nothing.
    """
    if sys.platform == "win32":
        return
    for result in export.accepted():
        with TemporaryDirectory() as folder:
            path = Path(folder) / export.filename
            export.writer.write(result, path)
            size = path.stat().st_size
            path.write_bytes(OLD)
            # Half of what it needs, so that it fails in the middle.
            with _file_size_limited(size // 2):
                _require_write_refused(export, result, path, "a full disk")
            _require_old(path, "a full disk")


def cases(writer: type[Writer] | Writer, *, filename: str,
          results: Iterable[Result] | None = None, verify: Verify | None = None) -> list[Case]:
    """Return a writer with results to write."""
    writer_object = make_instance(writer)
    to_write = None if results is None else tuple(results)
    return [Case(label_with_options(writer_object, {}), lambda: Export(
        writer_object, example_results() if to_write is None else to_write, filename, verify))]


SUITE = Suite((
    declaration_check("writers", lambda export: export.writer), accepts_answers, writes_file,
    result_unchanged, unwritable_path, refuses_others, whole_or_nothing), cases)


@cache  # results to write, the same for every writer
def example_results() -> tuple[Result, ...]:
    """Return results to write, like those of many runs.

    One has rational functions and geographic coordinates, one a 2-D polynomial and plane
    coordinates. Both select terms for 60 points that were computed, not measured.

    Returns
    -------
    tuple of Result
        The two results, in this order.

    Examples
    --------
    >>> from termsel.testing import example_results
    >>> [len(result.features.points) for result in example_results()]
    [60, 60]
    """
    model = RationalFunctions(order=1)
    rng = seeded_generator()
    points = imaged_features(model, random_coefficients(model, rng), rng, points=60).points
    image = 4000.0 + 4000.0 * points.image + rng.normal(0.0, 0.3, (60, 2))
    ids = ("Kreuzung 1, Süd", *points.ids[1:])
    size = (8001, 8001)
    geographic = FeatureSet(Points(ids, image, [7.5, 47.1, 500.0]
                                   + points.ground * [0.06, 0.04, 200.0]),
                            crs="EPSG:4979", image_size=size)
    plane = FeatureSet(Points(ids, image, 4000.0 * points.ground), crs="local", image_size=size)
    results = []
    for problem, features in (("rfm-terms", geographic), ("poly-terms", plane)):
        task = prepare(problem, features=features, solver="random", options={"population": 50})
        results.append(result_of_search(task, search(task.problem, task.solver, generations=1)))
    return tuple(results)


def _require_write_refused(export: Export, result: Result, path: Path, description: str) -> None:
    """Raise AssertionError unless the writer fails with an error that names the file."""
    require_refused(lambda: export.writer.write(result, path), path, description,
                    "goes unnoticed: write through termsel.core.files.atomic")


def _require_old(path: Path, description: str) -> None:
    """Require that the earlier file is unchanged, and no other file is beside it."""
    require(path.read_bytes() == OLD,
            f"after {description} the file that was there before is lost; write through "
            "termsel.core.files.atomic")
    _require_tidy(path)


def _require_tidy(path: Path) -> None:
    """Require no other files next to the one written, except those with the same stem."""
    remaining = [p.name for p in path.parent.iterdir() if not p.name.startswith(path.stem)]
    require(not remaining, f"temporary files are left behind: {', '.join(remaining)}")


@contextmanager
def _file_size_limited(size: int) -> Iterator[None]:
    """Limit the size of the files that this process writes [byte] during a block."""
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
