"""Readers and writers of packages that are at fault: what is said, and that no file is harmed."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.isolation.faults import PluginFault
from termsel.data.features import FeatureSet
from termsel.io.export import export
from termsel.plugins.registry import Registry
from termsel.results.result import Result
from termsel.runs.run import run
from tests.csv_texts import read_file
from tests.faulty import altered, always, leaving, raising, told_of


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    return termsel.simulate_scene("ikonos-hamedan")


class Bars(termsel.Reader):
    """A sound reader."""

    name, summary = "bars", "points between bars"

    def sniff(self, path: Path, head: bytes) -> bool:
        return head.startswith(b"|")

    def read(self, path: Path) -> FeatureSet:
        return FeatureSet(termsel.Points(("a",), [[1.0, 2.0]], [[3.0, 4.0, 5.0]]))


def _readers(*readers: type[termsel.Reader]) -> list[type[termsel.Reader]]:
    return [*(entry.object for entry in Registry([]).entries("readers")), *readers]


# What a second reader does when it is asked about the file of the sound one; what is said.
SNIFF = [
    (raising, "reader 'faulty' of the module tests failed in sniff(): ValueError"),
    (leaving, "failed in sniff(): SystemExit: 3"),
    (always("yes"), "sniff() returned 'yes'; expected True or False"),
    (always(None), "sniff() returned None; expected True or False"),
    (always(True), "reader 'faulty' of the module tests recognises any file, so it is not used"),
]


@pytest.mark.parametrize(("fault", "message"), SNIFF)
def test_faulty_sniff_takes_no_file_of_another(
        fault: Any, message: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "a.txt"
    file.write_text("|1|2|")
    faulty = altered(Bars, "sniff", fault)
    for readers in ([Bars, faulty], [faulty, Bars]):
        caplog.clear()
        assert read_file(file, _readers(*readers)).points.ids == ("a",)
        assert message in caplog.text


def test_two_readers_that_recognise_a_file(tmp_path: Path,
                                           caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "a.txt"
    file.write_text("|1|2|")
    other = altered(Bars, "extra", None, "other-bars")
    with pytest.raises(TermselError, match=r"several readers recognise this file: reader 'bars'"
                                           r".*--format bars or --format other-bars"):
        read_file(file, _readers(Bars, other))
    assert read_file(file, _readers(Bars, other), "other-bars").points.ids == ("a",)
    own = tmp_path / "b.csv"
    own.write_text("id,role,line,sample,x,y,z\np,,1,2,3,4,5\n")
    greedy = altered(Bars, "sniff", always(True))
    assert read_file(own, _readers(greedy)).points.ids == ("p",)
    assert "reader 'faulty' of the module tests recognises b.csv too" in caplog.text


@pytest.mark.parametrize(("fault", "message"), [
    (raising, "failed in read(): ValueError"), (leaving, "failed in read(): SystemExit: 3"),
    (always(None), "read() returned nothing; expected FeatureSet"),
    (always([1]), "read() returned an object of type list; expected FeatureSet"),
    (lambda self, path: FeatureSet(termsel.Points(("a", "a"), np.ones((2, 2)), np.ones((2, 3)))),
     "'a'")])
def test_faulty_read(fault: Any, message: str, tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("|1|2|")
    with pytest.raises(TermselError) as caught:
        read_file(file, _readers(altered(Bars, "read", fault)))
    told_of(caught, message, "reader 'faulty'")


@pytest.mark.parametrize(("fault", "message"), [
    (raising, "failed in placed(): ValueError"),
    (always(None), "placed() returned nothing; expected TermselError")])
def test_faulty_place_of_an_error(fault: Any, message: str, tmp_path: Path,
                                  monkeypatch: pytest.MonkeyPatch) -> None:
    far = FeatureSet(termsel.Points(("a",), [[1.0, 2.0]], [[3.0, 400.0, 5.0]]), crs="EPSG:4979")
    reader = altered(altered(Bars, "read", always(far)), "placed", fault)
    monkeypatch.setattr(Registry, "entries", lambda self, kind: [SimpleNamespace(object=reader)])
    (tmp_path / "a.txt").write_text("|")
    with pytest.raises(PluginFault) as caught:
        termsel.read(tmp_path / "a.txt")
    told_of(caught, message, "reader 'faulty'")


class Note(termsel.Writer):
    """A sound writer."""

    name, summary = "note", "a line of text"

    def accepts(self, result: Result) -> bool:
        return True

    def write(self, result: Result, path: Path) -> None:
        path.write_text("ok")


@pytest.fixture(scope="module")
def result(scene: FeatureSet) -> Result:
    return run("poly-terms", features=scene, solver="all-terms", options={"degree": 1})


@pytest.mark.parametrize(("method", "fault", "message"), [
    ("accepts", raising, "failed in accepts(): ValueError"),
    ("accepts", always(None), "accepts() returned None; expected True or False"),
    ("files", always("a.txt"), "files() returned 'a.txt'; expected a tuple of paths"),
    ("files", always(()), "files() returned (); expected a tuple of paths"),
    ("write", raising, "failed in write(): ValueError"),
    ("write", leaving, "failed in write(): SystemExit: 3")])
def test_faulty_writer(method: str, fault: Any, message: str, result: Result, tmp_path: Path,
                       monkeypatch: pytest.MonkeyPatch) -> None:
    writer = altered(Note, method, fault)
    monkeypatch.setattr(Registry, "get", lambda self, kind, name: writer)
    with pytest.raises(PluginFault) as caught:
        export(result, "faulty", tmp_path / "a.txt")
    told_of(caught, message, "writer 'faulty'")
    assert not list(tmp_path.iterdir())
