"""The list of mutants fits the code and the tests there are; tests/mutants.py runs them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from termsel.rooms import ROOMS

ROOT = Path(__file__).parents[1]
MUTANTS: list[dict[str, Any]] = tomllib.loads((ROOT / "tests/mutants.toml").read_text())["mutant"]
WITHOUT = {"version", "rooms"}
"""Rooms without logic of their own."""


def test_there_are_many_and_none_is_listed_twice() -> None:
    assert len({(one["file"], one["old"], one["new"]) for one in MUTANTS}) == len(MUTANTS) >= 60


@pytest.mark.parametrize("one", MUTANTS, ids=lambda one: f"{one['file']}: {one['new']}")
def test_a_mutant_changes_a_part_of_one_line(one: dict[str, Any]) -> None:
    assert set(one) == {"file", "old", "new", "tests"}
    assert one["old"] != one["new"]
    assert "\n" not in one["old"] + one["new"]
    assert (ROOT / one["file"]).read_text().count(one["old"]) == 1


def test_every_room_and_every_plugin_has_some() -> None:
    places = [Path(one["file"]).parts for one in MUTANTS]
    rooms = {parts[2].removesuffix(".py") for parts in places if parts[0] == "src"}
    assert set(ROOMS) - rooms == WITHOUT
    packages = {path.parts[-3] for path in ROOT.glob("plugins/*/src/*") if path.is_dir()
                and not path.name.endswith(".egg-info")}
    assert {parts[1] for parts in places if parts[0] == "plugins"} == packages


@pytest.mark.parametrize("name", sorted({test for one in MUTANTS for test in one["tests"]}))
def test_the_tests_that_should_notice_exist(name: str) -> None:
    file, _, test = name.partition("::")
    text = (ROOT / file).read_text()
    assert re.search(rf"^def {test.partition('[')[0]}{'' if test else 'test_'}", text, re.MULTILINE)
