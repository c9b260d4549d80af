"""What each image of a batch is fit for, with its reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import termsel
from termsel import TermselError
from termsel.studies.cells.images import folders_of
from termsel.studies.cells.table import with_notes_once
from termsel.studies.cells.verdicts import (
    DOUBTFUL,
    FIT,
    PLAUSIBLE,
    UNFIT,
    Accept,
    verdicts_of,
)
from termsel.testing import invoke


def row(**figures: Any) -> dict[str, Any]:
    return {"strategy": "auto", "state": "done", "reason": "", "doubt": "", "notes": None,
            "predicted": 1.0, "predicted_low": 0.7, "predicted_high": 1.5, "independent": None,
            "n_independent": 0, "pixel": 2.0, "blunders": [], "n_control": 12, "n_check": 0,
            "excluded": 0, **figures}


@pytest.mark.parametrize(("figures", "accept", "verdict", "why"), [
    ({}, "2px", FIT, "RMSE 1.00 px (0.70 to 1.50) meets 2 px"),
    ({}, "1px", DOUBTFUL, "so 1 px is not certain"),
    ({}, "0.5px", UNFIT, "0.5 px is asked for"),
    ({}, "3.5m", FIT, "RMSE 2.00 m (1.40 to 3.00) meets 3.5 m"),
    ({"pixel": None}, "3m", DOUBTFUL, "not known in m"),
    ({"independent": 3.0, "n_independent": 30}, "2px", UNFIT, "RMSE 3.00 px"),
    ({"independent": 3.0, "n_independent": 5}, "2px", DOUBTFUL, "more than predicted"),
    ({"predicted": None, "independent": None}, None, DOUBTFUL, "cannot be estimated"),
    ({"blunders": ["a", "b", "c", "d"], "excluded": 4}, None, DOUBTFUL, "4 blunders among 16"),
    ({"doubt": "Its axes look swapped."}, None, UNFIT, "swapped"),
    # Maps of an archive may be of any place.
    ({"doubt": "Near 40.8 N, 119.2 W, while 9 other images of the batch are near 51.9 N, 2.2 E: "
               "are coordinates and CRS right?"}, None, DOUBTFUL, "40.8 N"),
    ({"notes": ["The known camera is not used: the points show 3,495 px, not 1,750 px. Check it."]},
     None, DOUBTFUL, "the known camera is not used: the points show 3,495 px, not 1,750 px"),
    # A caution on errors that are accepted is none.
    *(({"notes": [f"Between the points the map may be off by {size} px: the RMSE holds near them "
                  "only."]}, accept, verdict, why) for size, accept, verdict, why in (
        ("2.4", "5m", FIT, "meets 5 m"), ("2.6", "5m", DOUBTFUL, "off by 2.6 px"),
        ("1.9", "2px", FIT, "meets 2 px"), ("1,041", "5px", DOUBTFUL, "off by 1,041 px"),
        ("0.10", None, DOUBTFUL, "off by 0.10 px"))),
    ({"notes": ["Extrapolation: the standard deviation of the model is up to 4.9 px at the corners "
                "of the image, 5 times the RMSE, which holds within the control."]}, "5px", FIT,
     "meets 5 px"),
    ({"notes": ["The RPC is not used: it needs heights."]}, None, PLAUSIBLE, "nothing contradicts"),
    ({"state": "failed", "reason": "too few points"}, None, UNFIT, "too few points"),
    ({}, None, PLAUSIBLE, "nothing contradicts its figures; not verified"),
    ({"n_independent": 4}, None, PLAUSIBLE, "nothing contradicts its figures; 4 independent check"),
    ({"predicted_low": 0.3}, None, DOUBTFUL, "12 points leave its RMSE between 0.30 and 1.50"),
    ({"predicted_low": 0.3}, "2px", FIT, "meets 2 px; not verified")])
def test_the_interval_decides_and_what_contradicts_it(
        figures: dict[str, Any], accept: str | None, verdict: str, why: str) -> None:
    found = verdicts_of([row(**figures)], (accept and Accept.of(accept)) or None)
    assert found[0][0] == verdict
    assert why in found[0][1]


def test_an_image_unlike_the_others_is_doubtful() -> None:
    rows = [row(), row(), row(), row(predicted=9.0, predicted_high=12.0)]
    assert [verdict for verdict, _ in verdicts_of(rows, None)] == [*[PLAUSIBLE] * 3, DOUBTFUL]


def test_notes_of_most_images_stand_once() -> None:
    rows = with_notes_once([row(notes=["all", "one"]), row(notes=["all"]), row(notes=["all"])])
    assert [each["notes"] for each in rows] == [["all", "one"], None, None]


def test_folders_are_named_by_the_image() -> None:
    labels = {str(i): {"strategy": "auto", "data": data, "split": 0, "problem": "p"}
              for i, data in enumerate(["a/one.csv", "a/two.csv", "b/two.csv", "list.txt#IMG.JPG"])}
    assert list(folders_of(labels).values()) == ["one", "a_two.csv", "b_two.csv", "IMG"]


def test_a_size_needs_its_unit() -> None:
    with pytest.raises(TermselError, match="--accept is '5 km', expected a length with its unit"):
        Accept.of("5 km")
    assert Accept.of(str(Accept.of("2.5 m"))) == Accept(2.5, "m")


def test_a_batch_ends_with_a_code_where_an_image_failed(tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", roles=(6, 0, 0))
    rows = [f"{name};{line};{sample};{x};{y};{z}" for name, (line, sample), (x, y, z) in zip(
        scene.points.ids, scene.points.image, scene.points.ground, strict=True)]
    good = "\n".join(["Nr;Zeile;s;east;n;hoch", *rows])
    (tmp_path / "good.csv").write_text(good, encoding="utf-8")
    (tmp_path / "bad.csv").write_text(good.splitlines()[0], encoding="utf-8")
    words = ("compare", "--points", str(tmp_path / "*.csv"), "--crs", scene.crs, "--columns",
             "id=Nr,line=Zeile,sample=s,x=east,y=n,z=hoch", "--accept", "50px", "--quiet",
             "--out", tmp_path / "out")
    done = invoke(*words)
    assert done.exit_code == 1
    assert "1 of 2 images failed" in done.stderr
    table = (tmp_path / "out" / "study.csv").read_text("utf-8")
    assert "unfit" in table
    assert "fit for use" in table
    assert (tmp_path / "out" / "images" / "good" / "result.json").exists()
