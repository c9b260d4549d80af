"""What a message says to type is typed, and works."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

Call = Callable[..., SimpleNamespace]


@pytest.mark.slow
@pytest.mark.parametrize(("option", "value"), [
    ("--degree", "1"), ("--smoothing", "0.1"), ("--z-unit", "metre"), ("--roles", "random"),
    ("--folds", "4"), ("--population", "10"), ("--imperialists", "0.2"), ("--mask", "shared"),
    ("--max-features", "12")])
def test_each_option_of_a_part_is_advised_as_it_works(option: str, value: str, call: Call,
                                                      example_files: Path) -> None:
    points = example_files / "points.csv"
    advised = advised_words(call("run", points, option, value))
    of_search = () if {"--model", "--set"} > set(advised) else ("--generations", "1")
    done = call("run", points, *advised, *of_search, "--quiet")
    assert done.exit_code == 0, done.stderr


@pytest.mark.parametrize(("option", "words"), [
    ("--degree", "--model poly3d --set degree=1"), ("--z-unit", "--set z_unit=1"),
    ("--folds", "--criterion"), ("--mask", "--problem"), ("--imperialists", "--solver ica --set")])
def test_an_option_of_a_part_is_advised_with_its_part(option: str, words: str, call: Call,
                                                      example_files: Path) -> None:
    assert words in shlex.join(advised_words(call("run", example_files / "points.csv", option, 1)))


def advised_words(refused: SimpleNamespace) -> list[str]:
    """Return the words that a refusal says to type."""
    assert refused.exit_code == 2
    advice = re.search(r"(?:add|by) (--.*?)[.;\n]", refused.stderr)
    assert advice, refused.stderr
    return shlex.split(advice[1])


def test_heights_are_not_set_by_an_option_of_a_camera(call: Call, example_files: Path) -> None:
    done = call("run", example_files / "scene.points", "--height", "250")
    assert "It belongs to termsel project, rectify" in done.stderr
    assert "--set" not in done.stderr
    advised = call("run", example_files / "scene.points", "--dem", example_files / "dem.tif")
    assert advised.exit_code == 0


def test_a_number_in_place_of_a_raster(call: Call, example_files: Path) -> None:
    for words in (("rectify", "result", "x.tif", "-o", "map.tif"), ("project", "result", "x.csv")):
        assert "One height for all of the ground is given so: --height 250." in call(
            *words, "--dem", "250").stderr
    done = call("run", example_files / "gcps.csv", "--dem", "250")
    assert done.stderr.startswith("Error: --dem takes a file, and 250 is a number.")


def test_a_file_before_the_folder_of_its_result(call: Call, tmp_path: Path) -> None:
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "result.json").write_text("{}")
    (tmp_path / "places.csv").write_text("id,x,y,z\n")
    result, places = tmp_path / "result", tmp_path / "places.csv"
    assert f"Type termsel project {result} {places}\n" in call("project", places, result).stderr
    assert (f"Type termsel rectify {result} {places} --output FILE\n"
            in call("rectify", places, result).stderr)


@pytest.mark.slow
def test_a_chart_that_a_result_lacks_names_those_that_it_has(call: Call, example_files: Path,
                                                             tmp_path: Path) -> None:
    pytest.importorskip("altair")
    result = tmp_path / "result"
    call("run", example_files / "points.csv", "--method", "affine", "--out", result, "--quiet")
    for further in ((), ("-o", tmp_path / "front.svg")):
        done = call("plot", result, "front", *further)
        assert done.exit_code == 2
        assert "Charts that it has: residuals, ground" in done.stderr
    done = call("plot", result, "residuals")
    typed = re.search(r"Type termsel (.*)", done.stderr)
    assert typed
    *words, _ = shlex.split(typed[1])
    assert call(*words, tmp_path / "residuals.svg").exit_code == 0
