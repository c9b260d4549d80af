"""A batch of images: what is said of one names it and is kept, and those that stand out are named.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.earth import is_mirrored
from termsel.data.features import FeatureSet, Points
from termsel.studies.cells.neighbours import _note_on_mirrored, batch_of, location_figures
from termsel.studies.compare import estimate
from termsel.studies.outputs import write_outputs


def image(lon: float, lat: float, count: int = 5, seed: int = 0) -> FeatureSet:
    """A photograph from above, of an area some km wide."""
    rng = np.random.default_rng(seed)
    # The first three are on no line.
    apart = np.concatenate([[[0.0, 0.0], [1.0, 0.1], [0.2, 1.0]], rng.uniform(0, 1, (count, 2))])
    apart = apart[:count]
    ground = np.column_stack([lon + 0.02 * apart[:, 0], lat + 0.02 * apart[:, 1],
                              rng.uniform(100, 200, count)])
    pixels = np.column_stack([1000.0 - 900.0 * apart[:, 1], 50.0 + 700.0 * apart[:, 0]])
    return FeatureSet(Points(tuple(f"P{i}" for i in range(count)), pixels, ground),
                      crs="EPSG:4979")


def exchanged(features: FeatureSet) -> FeatureSet:
    points = features.points
    return features.with_(points=replace(points, ground=points.ground[:, [1, 0, 2]]))


def mirrored(features: FeatureSet) -> FeatureSet:
    points = features.points
    return features.with_(points=replace(points, image=points.image * [1.0, -1.0]))


def said(images: dict[str, FeatureSet]) -> tuple[str, ...]:
    return batch_of({name: location_figures(one) for name, one in images.items()}).sentences


def batch(count: int = 8) -> dict[str, FeatureSet]:
    return {f"{i}.csv": image(11.3 + 0.05 * i, 46.5, seed=i) for i in range(count)}


def test_images_with_exchanged_coordinates_are_named_with_both_places() -> None:
    images = batch()
    images |= {name: exchanged(images[name]) for name in ("2.csv", "5.csv")}
    elsewhere, turned = said(images)
    assert elsewhere == ("6 images are near 46.5 N, 11.5 E, 2 near 11.5 N, 46.5 E (are x and y "
                         "swapped?): 2.csv, 5.csv.")
    assert turned.startswith("2 images are mirror images of the ground, unlike the other 6")


def test_a_wrong_sign_and_another_place_are_told_apart() -> None:
    images = batch() | {"west.csv": image(-11.4, 46.5), "far.csv": image(24.0, 60.0)}
    sentences = " ".join(said(images))
    assert "(is a sign wrong?): west.csv." in sentences
    assert "1 near 60.0 N, 24.0 E (are coordinates and CRS right?): far.csv." in sentences


@pytest.mark.parametrize("count", [3, 4, 9])
def test_an_image_is_mirrored_or_not_from_three_points_on(count: int) -> None:
    assert is_mirrored(image(8.0, 47.0, count)) is False
    assert is_mirrored(mirrored(image(8.0, 47.0, count))) is True
    images = batch() | {"turned.csv": mirrored(image(11.3, 46.5, count))}
    assert said(images) == ("1 image is a mirror image of the ground, unlike the other 8 (are x and"
                            " y exchanged there, or line and sample?): turned.csv.",)


@pytest.mark.parametrize("count", [2, 4, 8])
def test_half_of_a_batch_that_is_mirrored_is_named(count: int) -> None:
    images = batch(count)
    names = [f"{i}.csv" for i in range(count // 2)]
    images |= {name: mirrored(images[name]) for name in names}
    verb = "is a mirror image" if count == 2 else "are mirror images"
    assert said(images) == (
        f"{count // 2} of {count} images {verb} of the ground, the others are not (are x and y "
        f"exchanged, or line and sample?): {', '.join(names)}.",)
    doubts = batch_of({name: location_figures(one) for name, one in images.items()}).doubts
    assert list(doubts) == names


def test_two_points_or_points_on_a_line_do_not_tell_a_mirror_image() -> None:
    on_line = image(8.0, 47.0, 5)
    along = np.linspace(0, 1, 5)[:, None]
    on_line = on_line.with_(points=replace(
        on_line.points, image=along * [100.0, 200.0],
        ground=np.column_stack([8 + 0.02 * along, 47 + 0.03 * along, 0 * along])))
    assert is_mirrored(image(8.0, 47.0, 2)) is None
    assert is_mirrored(on_line) is None


def test_maps_that_all_count_lines_upwards_are_no_outliers_but_one_that_does_not_is() -> None:
    maps = {name: mirrored(one) for name, one in batch().items()}
    assert said(maps) == ()
    assert said(maps | {"down.csv": image(11.3, 46.5)}) == (
        "1 image is no mirror image of the ground, unlike the other 8 (are x and y exchanged "
        "there, or line and sample?): down.csv.",)


def test_images_all_over_the_world_have_no_outliers() -> None:
    rng = np.random.default_rng(2)
    places = np.column_stack([rng.uniform(-170, 170, 12), rng.uniform(-60, 60, 12)])
    assert said({f"{i}": image(*place, seed=i) for i, place in enumerate(places.tolist())}) == ()
    assert said({"a": image(0.0, 10.0), "b": image(50.0, 10.0)}) == ()


def test_images_on_both_sides_of_the_dateline_are_near_each_other() -> None:
    assert said({f"{i}": image(lon, 52.0, seed=i)
                 for i, lon in enumerate((179.8, 179.95, -179.9, -179.8))}) == ()


def test_what_is_said_of_an_image_is_in_its_result_the_table_and_the_pages(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    images = batch(4)
    images["3.csv"] = exchanged(images["3.csv"])
    for name, one in images.items():
        rows = ["id,line,sample,x,y,z,sigma_lin"]
        rows += [f"{point},{seen[0]},{seen[1]},{place[0]:.9f},{place[1]:.9f},{place[2]},1"
                 for point, seen, place in zip(one.points.ids, one.points.image, one.points.ground,
                                               strict=True)]
        if name == "0.csv":
            rows = [row.rpartition(",")[0] for row in rows]
        (tmp_path / name).write_text("\n".join(rows))
    out = tmp_path / "out"
    study = termsel.compare({"data": [{"points": str(tmp_path / "?.csv"), "crs": "EPSG:4979"}]},
                            out=out)
    write_outputs(study, out)
    warnings = [one for one in caplog.messages if "look swapped" in one]
    assert warnings
    assert all(one.startswith("Warning: ") and "3.csv: " in one for one in warnings)
    with (out / "study.csv").open() as file:
        rows = {Path(row["data"]).name: row for row in csv.DictReader(file)}
    assert rows["0.csv"]["place"] == "46.5 N, 11.3 E"
    assert rows["0.csv"]["doubt"] == ""
    assert "look swapped" in rows["3.csv"]["doubt"]
    assert "while 3 other images of the batch are near 46.5 N" in rows["3.csv"]["doubt"]
    for name in ("1.csv", "3.csv"):
        assert "Did you mean sigma_line?" in rows[name]["notes"]
    assert "sigma_line" not in rows["0.csv"]["notes"]
    found = {path: json.loads(path.read_text()) for path in out.rglob("result.json")}
    swapped = next(one for path, one in found.items() if path.parent.name == "3")
    assert any("look swapped" in note and "swapped='xy'" in note for note in swapped["notes"])
    assert any("Did you mean sigma_line?" in note for note in swapped["notes"])
    for page in ("summary.md", "report.html"):
        text = (out / page).read_text()
        assert "3 images are near 46.5 N" in text
        assert "3.csv" in text
        # The reason of the verdict, and the note with the remedy.
        assert text.count("look swapped") == 2


def test_the_note_of_a_single_run_says_that_axes_look_swapped() -> None:
    result = termsel.run(features=exchanged(image(11.3, 46.5, 8)))
    assert any("look swapped" in note for note in result.notes)
    upright = termsel.run(features=image(11.3, 46.5, 8))
    assert not any("swapped" in note for note in upright.notes)


@pytest.mark.parametrize("sizes", [[3, *[10] * 20, *[30] * 9], [*[8] * 40, 100], [5, 5]])
def test_the_time_of_a_batch_is_that_of_images_of_all_sizes(
        sizes: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    timed = []

    def done(cell: object, features: FeatureSet) -> object:
        timed.append(len(features))
        record = type("Record", (), {"figures": {"seconds": float(len(features))}, "reason": ""})
        return type("Outcome", (), {"record": record})

    monkeypatch.setattr("termsel.studies.compare.do", done)
    data = {f"{i}": image(11.0, 46.0, size, seed=i) for i, size in enumerate(sizes)}
    (_, number, seconds, _, _), = estimate(data=data)
    assert number == len(sizes)
    assert len(timed) <= 4
    assert number * seconds == pytest.approx(sum(sizes), rel=0.2)


def test_the_time_of_a_batch_is_of_images_that_were_not_seen_before(
        monkeypatch: pytest.MonkeyPatch) -> None:
    seen = set()

    def done(cell: SimpleNamespace, features: FeatureSet) -> object:
        # What was found of the same features before is remembered.
        seconds = 0.1 if features in seen else 1.0
        seen.add(features)
        record = type("Record", (), {"figures": {"seconds": seconds}, "reason": ""})
        return type("Outcome", (), {"record": record})

    monkeypatch.setattr("termsel.studies.compare.do", done)
    data = {f"{i}": image(11.0, 46.0, 9, seed=i) for i in range(5)}
    (_, _, seconds, _, _), = estimate(data=data)
    assert seconds == pytest.approx(1.0)


@pytest.mark.parametrize(("wait", "is_said"), [(4.0, True), (1.1, False)])
def test_a_busy_machine_is_said_with_the_time(
        wait: float, is_said: bool, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    from termsel.cli import compare

    clock = iter([0.0, 8.0 * wait])
    cpu = iter([0.0, 8.0])
    monkeypatch.setattr(compare, "time", SimpleNamespace(
        perf_counter=lambda: next(clock), process_time=lambda: next(cpu)))
    monkeypatch.setattr("termsel.studies.compare.estimate", lambda *_, **__: iter(
        [(("rfm-terms", "auto", "", "press", "auto"), 10, 4.0, "", 2.5 * wait)]))
    monkeypatch.setattr(compare, "_list_files", lambda *_: None)
    compare._show_plan(None, {}, 1)
    shown = capsys.readouterr().out
    # The start and what the first run loads come on top: 1.5 and 2.5 s on an idle one.
    assert f"10 runs; about {40 + 4 * wait:.0f} s with 1 worker." in shown
    assert ("with a machine as busy as now; about 14 s on an idle one" in shown) == is_said


def test_one_other_image_is_not_others() -> None:
    settings = {"a": {"mirrored": True}, "b": {"mirrored": False}}
    [(sentence, doubts)] = _note_on_mirrored(settings)
    assert sentence.startswith("1 of 2 images is a mirror image of the ground")
    assert "unlike 1 other of the batch" in doubts["a"]


def test_a_list_of_files_of_points_is_a_study_of_images(tmp_path: Path) -> None:
    files = []
    for name in ("first", "second"):
        files.append(tmp_path / f"{name}.csv")
        points = termsel.simulate_scene("ikonos-hamedan", n_points=12).points
        rows = [f"{x!r},{y!r},{z!r},{line!r},{sample!r}" for (x, y, z), (line, sample) in zip(
            points.ground.tolist(), points.image.tolist(), strict=True)]
        files[-1].write_text("\n".join(["x,y,z,line,sample", *rows, ""]))
    for given in (files, str(tmp_path / "*.csv")):
        study = termsel.compare(given, crs="EPSG:4979")
        assert study.rows.to_pandas()["data"].to_list() == [
            path.as_posix() for path in files]
    with pytest.raises(termsel.TermselError, match="is 5, expected the name of a file"):
        termsel.compare([5])
    with pytest.raises(termsel.TermselError, match="data is given next to a list of files"):
        termsel.compare(files, data=["ikonos-hamedan"])
