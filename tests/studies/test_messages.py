"""What a study says while it runs names the image it is about."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from termsel.core.isolation.parts import missing_package_error
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.simulate import simulate_scene
from termsel.studies import outputs
from termsel.studies.plan.data import data_of
from termsel.studies.plan.spec import Spec, spec_of
from termsel.studies.study import Study


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_messages_of_many_images_name_the_image(
        workers: int, tmp_path: Path) -> None:
    for seed, name in ((1, "100 %d"), (2, "b")):  # a name that looks like a format
        scene = simulate_scene("ikonos-hamedan", seed=seed, n_points=24, n_lines=0)
        write_points_csv(scene.points, tmp_path / f"{name}.csv", crs=scene.crs)
    done = subprocess.run(
        [sys.executable, "-m", "termsel", "compare", "--points", "*.csv", "--crs", "EPSG:4979",
         "--out", "out", "--quiet", "--workers", str(workers), "--export", "qgis-points"],
        cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    warnings = sorted(line for line in done.stderr.splitlines() if "qgis-points: at most" in line)
    assert [line.partition(": qgis-points")[0] for line in warnings] == [
        "Warning: 100 %d.csv", "Warning: b.csv"]


def test_that_tables_have_no_heights_is_said_once(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("id,line,sample,x,y\nP1,1,2,3,4\nP2,5,6,7,9\n")
    spec = spec_of({"data": [{"points": "*.csv", "crs": "local"}], "strategies": ["auto"]})
    with caplog.at_level("INFO", logger="termsel"):
        assert len(data_of(spec, tmp_path)) == 3
    assert "a.csv has no column for z, so its heights are unknown" in caplog.messages[0]
    assert caplog.messages[1:] == ["Note: so it is in 2 further images."]


def test_images_of_one_table_are_counted_as_images(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = [f"{image}{n},{image},{n},{n % 2},{n},{n * n}" for image in "abc" for n in range(4)]
    (tmp_path / "gcps.csv").write_text("\n".join(("id,image,line,sample,x,y", *rows)))
    spec = spec_of({"data": [{"points": "gcps.csv", "crs": "local"}], "strategies": ["auto"]})
    with caplog.at_level("INFO", logger="termsel"):
        assert len(data_of(spec, tmp_path)) == 3
    assert caplog.messages[1:] == ["Note: so it is in 2 further images."]


def test_that_x_and_y_are_pixels_is_said_once(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("id,E,N,H,x,y\nP1,1,2,3,4,7\nP2,5,6,7,9,8\n")
    spec = spec_of({"data": [{"points": "*.csv", "crs": "local"}], "strategies": ["auto"]})
    with caplog.at_level("INFO", logger="termsel"):
        assert len(data_of(spec, tmp_path)) == 3
    assert sum("are read as sample and line" in message for message in caplog.messages) == 1
    assert caplog.messages[1:] == ["Note: so it is in 2 further images."]


def test_messages_outside_a_study_stay_as_they_are(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="termsel"):
        logging.getLogger("termsel.io.export").warning("Warning: %d px", 3)
    assert caplog.messages == ["Warning: 3 px"]


@pytest.mark.parametrize(("page", "says_which_package"), [
    (None, True), (lambda study: "<html>", False)])
def test_the_text_of_images_is_their_own(
        monkeypatch: pytest.MonkeyPatch, page: Callable[[Study], str] | None,
        says_which_package: bool) -> None:
    def of_searches(study: Study) -> str:
        raise AssertionError("images are no searches")

    output = outputs.StudyOutput((), lambda study, out: (), of_searches, page)
    monkeypatch.setattr(outputs, "values_of_slot", lambda slot: [output])
    text = outputs.study_summary(Study(Spec(strategies=("auto",)), {}, {}, None))
    assert ("A page of all images comes with the package termsel-studies, which " in text) \
        == says_which_package


def test_a_package_that_cannot_be_loaded_is_not_called_missing(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel.core.isolation.parts.distribution", lambda name: name)
    error = missing_package_error("study", "the page of a study requires")
    assert "termsel-studies, which is installed, but cannot be loaded" in str(error)
    assert "termsel plugins says why" in str(error)
