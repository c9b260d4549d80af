"""The conformance suites of readers and writers: built in, and broken on purpose."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from termsel.core.errors import TermselError
from termsel.core.files.atomic import write_text
from termsel.data.features import FeatureSet, Lines, Points
from termsel.formats.base import Reader, Writer, read_text
from termsel.formats.readers.csv_tables import (
    LinesCsv,
    PointsCsv,
    write_lines_csv,
    write_points_csv,
)
from termsel.results.result import Result
from termsel.testing import Check, check, checks, example_results

with TemporaryDirectory() as folder:
    _path, _rng = Path(folder) / "example.csv", np.random.default_rng(3)
    _heights = _rng.uniform(0, 900, (9, 1))
    _heights[4] = np.nan
    POINTS = Points(("Süd, 1", *(f"p{i}" for i in range(8))), _rng.uniform(0, 1e4, (9, 2)),
                    np.hstack([_rng.uniform(4e5, 5e5, (9, 2)), _heights]),
                    _rng.uniform(0.1, 1, (9, 2)), ("control", "off", "") * 3)
    write_points_csv(POINTS, _path, "EPSG:32639")
    POINTS_FILE = _path.read_bytes()
    LINES = Lines(tuple(f"#{i}" for i in range(9)), _rng.uniform(0, 1e4, (9, 2, 2)),
                  _rng.uniform(0, 900, (9, 2, 3)))
    write_lines_csv(LINES, _path)
    LINES_FILE = _path.read_bytes()

POINTS_READ = FeatureSet(POINTS, crs="EPSG:32639")
LINES_READ = FeatureSet(lines=LINES, crs="")


class DemoJson(Writer):
    """The smallest writer."""

    name = "demo-json"
    summary = "the coefficients of rational functions as JSON"

    def accepts(self, result: Result) -> bool:
        return result.model == "rfm"

    def write(self, result: Result, path: Path) -> None:
        if not self.accepts(result):
            raise TermselError("only rational functions can be written", file=path)
        write_text(path, json.dumps(result.to_dict()["coefficients"]))


def verify_json(result: Result, path: Path) -> None:
    assert json.loads(path.read_text()) == result.to_dict()["coefficients"]


SUITES = {
    "points-csv": checks(PointsCsv, content=POINTS_FILE, expected=POINTS_READ,
                         filename="points.csv"),
    "lines-csv": checks(LinesCsv(), content=LINES_FILE, expected=LINES_READ, filename="lines.csv"),
    "demo-json": checks(DemoJson, filename="model.json", verify=verify_json)}


@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{check.name}")
    for name, checks in SUITES.items() for check in checks])
def test_sound(check: Check) -> None:
    check.run()


# Broken readers


class Unnamed(PointsCsv):
    """No name."""

    name = ""


class Turned(PointsCsv):
    """Sample and line exchanged."""

    def read(self, path: Path) -> FeatureSet:
        points = super().read(path).points
        return FeatureSet(Points(points.ids, points.image[:, ::-1], points.ground, points.sigma,
                                 points.roles), crs="EPSG:32639")


class Indexes(PointsCsv):
    """Writes an index next to the file."""

    def read(self, path: Path) -> FeatureSet:
        path.with_suffix(".idx").write_text("")
        return super().read(path)


class Shy(PointsCsv):
    """Recognises nothing."""

    def sniff(self, path: Path, head: bytes) -> bool:
        return False


class Greedy(PointsCsv):
    """Recognises everything."""

    def sniff(self, path: Path, head: bytes) -> bool:
        return True


class Hasty(PointsCsv):
    """Decodes what may not be text."""

    def sniff(self, path: Path, head: bytes) -> bool:
        return "line,sample" in head.decode()


class Naive(PointsCsv):
    """Takes the file to be as it should."""

    def read(self, path: Path) -> FeatureSet:
        _crs, _header, *rows = path.read_bytes().decode().split("\n")
        cells = [row.split(",") for row in rows if row]
        values = np.array([[float(v or "nan") for v in c[2:7]] for c in cells])
        return FeatureSet(Points(tuple(c[0] for c in cells), values[:, :2], values[:, 2:]))


class Nameless(PointsCsv):
    """Errors without the file."""

    def read(self, path: Path) -> FeatureSet:
        try:
            return super().read(path)
        except TermselError as error:
            raise TermselError(error.what) from error


class Lenient(PointsCsv):
    """Takes whatever is in no table for no points."""

    def read(self, path: Path) -> FeatureSet:
        try:
            path.read_text(encoding="utf-8")
            return super().read(path)
        except (TermselError, UnicodeDecodeError):
            return FeatureSet()


class UnixOnly(PointsCsv):
    """Knows one kind of line end."""

    def read(self, path: Path) -> FeatureSet:
        if "\r" in read_text(path):
            raise TermselError("there is a carriage return", file=path)
        return super().read(path)


BROKEN_READERS = [
    (Unnamed, "declaration", "with the name ''"),
    (Turned, "reads_example", "image coordinates of points"),
    (Indexes, "reads_example", "it creates files next to the one read"),
    (Shy, "sniffs_example", "must be True"),
    (Greedy, "sniffs_anything", "must be False, not True"),
    (Hasty, "sniffs_anything", "raises UnicodeDecodeError"),
    (Naive, "truncated", "IndexError|ValueError"),
    (Lenient, "empty_file", "read as if nothing were wrong"),
    (Naive, "binary_file", "raises UnicodeDecodeError"),
    (Naive, "missing_file", "raises FileNotFoundError"),
    (Nameless, "missing_file", "does not name the file"),
    (Lenient, "wrong_encoding", "UTF-16 is read with the ids of points"),
    (UnixOnly, "line_ends", "line ends of Windows is refused"),
]


# Broken writers


class Wordless(DemoJson):
    """No summary."""

    summary = " "


class Unsure(DemoJson):
    """Answers with something."""

    def accepts(self, result: Result) -> Any:
        return result.model


class Picky(DemoJson):
    """Accepts nothing."""

    def accepts(self, result: Result) -> bool:
        return False


class Elsewhere(DemoJson):
    """Writes to another place."""

    def write(self, result: Result, path: Path) -> None:
        super().write(result, path.with_suffix(".txt"))


class Untidy(DemoJson):
    """Leaves a temporary file."""

    def write(self, result: Result, path: Path) -> None:
        super().write(result, path)
        path.with_name("tmp123").write_text("")


class Meddles(DemoJson):
    """Adds to the result."""

    def write(self, result: Result, path: Path) -> None:
        super().write(result, path)
        assert isinstance(result.versions, dict)
        result.versions["touched"] = str(len(result.versions))


class Direct(DemoJson):
    """Opens the file and writes."""

    def write(self, result: Result, path: Path) -> None:
        path.write_text(json.dumps(result.to_dict()["coefficients"]))


class FirstEmptied(DemoJson):
    """Refuses after the file was emptied."""

    def write(self, result: Result, path: Path) -> None:
        path.write_text("")
        super().write(result, path)


class HalfWritten(DemoJson):
    """Says it failed, and leaves half a file."""

    def write(self, result: Result, path: Path) -> None:
        try:
            path.write_text(json.dumps(result.to_dict()["coefficients"]))
        except OSError as error:
            raise TermselError("cannot write", file=path) from error


BROKEN_WRITERS = [
    (Wordless, "declaration", "says nothing of itself"),
    (Unsure, "accepts_answers", "must be True or False, not 'rfm'"),
    (Picky, "accepts_answers", r"accepts\(\) refuses all results"),
    (Elsewhere, "writes_file", "to the path given"),
    (Untidy, "writes_file", "tmp123"),
    (Meddles, "result_unchanged", "changes the result"),
    (Direct, "unwritable_path", "raises FileNotFoundError"),
    (Direct, "refuses_others", "must raise TermselError"),
    (FirstEmptied, "refuses_others", "is lost"),
]


# They are found out


def assert_found(checks: tuple[Check, ...], name: str, message: str) -> None:
    [check] = [check for check in checks if check.name == name]
    with pytest.raises(AssertionError, match=message) as caught:
        check.run()
    assert str(caught.value).startswith(f"{name}: ")


@pytest.mark.parametrize(("broken", "name", "message"), BROKEN_READERS)
def test_broken_reader(broken: type[Reader], name: str, message: str) -> None:
    assert_found(checks(broken(), content=POINTS_FILE, expected=POINTS_READ), name, message)


@pytest.mark.parametrize(("broken", "name", "message"), BROKEN_WRITERS)
def test_broken_writer(broken: type[Writer], name: str, message: str) -> None:
    assert_found(checks(broken(), filename="model.json"), name, message)
    if broken is Meddles:
        # It has changed the results that all tests of writers share.
        example_results.cache_clear()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
def test_half_written_file() -> None:
    assert_found(checks(HalfWritten(), filename="model.json"), "whole_or_nothing",
                 "after a full disk the file that was there")


@pytest.mark.parametrize(("checks", "broken", "elsewhere"), [
    (SUITES["points-csv"], BROKEN_READERS, set()),
    (SUITES["demo-json"], BROKEN_WRITERS, {"whole_or_nothing"})])
def test_every_check_can_fail(checks: tuple[Check, ...], broken: list[Any],
                              elsewhere: set[str]) -> None:
    assert {check.name for check in checks} == {name for _, name, _ in broken} | elsewhere


def test_all_at_once() -> None:
    with pytest.raises(AssertionError, match="reads_example: "):
        check(Turned(), content=POINTS_FILE, expected=POINTS_READ)
    with pytest.raises(AssertionError, match="writes_file: "):
        check(Elsewhere(), filename="model.json")
