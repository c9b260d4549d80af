"""Who looks at independent points and then takes another fit has no independent ones left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from click.testing import CliRunner

import termsel
from termsel.cli.main import cli

SCENE = termsel.simulate_scene("ikonos-hamedan", roles=(12, 12, 26), n_lines=0)


def _fit(out: Path, degree: int = 2, features: termsel.FeatureSet = SCENE,
         **more: object) -> termsel.Result:
    return termsel.run("poly-terms", features=features, solver="all-terms",
                       options={"degree": degree}, out=out, **more)


def _spent(result: termsel.Result) -> tuple[str, ...] | None:
    assert result.accuracy is not None
    noted = [note for note in result.notes if "no longer independent" in note]
    assert len(noted) == bool(result.accuracy.spent_by)
    return result.accuracy.spent_by


def test_another_fit_over_the_same_points_spends_them(tmp_path: Path) -> None:
    assert _spent(_fit(tmp_path / "first")) is None
    again = _fit(tmp_path / "second", degree=3)
    assert _spent(again) == ("first",)
    assert "26 independent check points are no longer independent" in again.notes[-1]
    assert "already assessed another fit, in first." in again.notes[-1]
    assert "these points already assessed another fit" in again.summary()
    assert "These check points already assessed" in again.summary(verbose=True)
    read = termsel.read_result(tmp_path / "second")
    assert _spent(read) == ("first",)
    assert read.summary() == again.summary()


def test_the_same_fit_again_spends_nothing(tmp_path: Path) -> None:
    _fit(tmp_path / "first")
    assert _spent(_fit(tmp_path / "second")) is None
    assert _spent(_fit(tmp_path / "first", overwrite=True)) is None


def test_a_replaced_result_is_remembered(tmp_path: Path) -> None:
    _fit(tmp_path / "only")
    _fit(tmp_path / "only", degree=3, overwrite=True)
    assert _spent(_fit(tmp_path / "only", degree=3, overwrite=True)) == ("only",)


def test_other_points_spend_nothing(tmp_path: Path) -> None:
    _fit(tmp_path / "first")
    other = termsel.simulate_scene("ikonos-hamedan", seed=5)
    assert _spent(_fit(tmp_path / "second", degree=3, features=other)) is None


def test_a_point_that_was_control_before_is_not_spent(tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", roles=(20, 20, 20), n_lines=0)
    termsel.run("poly-terms", features=scene, solver="all-terms", out=tmp_path / "first",
                options={"degree": 2})
    swapped = {"control": "independent", "independent": "control"}
    points = replace(scene.points, roles=tuple(
        swapped.get(role, role) for role in scene.points.roles))
    result = termsel.run("poly-terms", features=scene.with_(points=points), solver="all-terms",
                         out=tmp_path / "second", options={"degree": 3})
    assert _spent(result) is None


def test_damaged_neighbours_stop_no_run(tmp_path: Path) -> None:
    for number, content in enumerate([
            "{", "[]", '{"schema": 3}', 9999 * "[", '{"schema": "termsel-result-1"}',
            '{"schema": "termsel-result-1", "checksums": {}, "accuracy": [1], "fit": 2}']):
        for name in (f"damaged {number}", f"alone {number}"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "result.json").write_text(content)
        (tmp_path / f"damaged {number}" / "points.csv").write_text("nonsense\n")
    assert _spent(_fit(tmp_path / "good")) is None


def test_the_command_says_it(tmp_path: Path) -> None:
    command = ["run", "--problem", "poly-terms", "--solver", "all-terms", "--out"]
    first = CliRunner().invoke(cli, [*command, str(tmp_path / "a"), "--set", "degree=2"])
    second = CliRunner().invoke(cli, [*command, str(tmp_path / "b"), "--set", "degree=3"])
    assert "already assessed" not in first.output
    assert "already assessed another fit" in " ".join(second.output.split())
