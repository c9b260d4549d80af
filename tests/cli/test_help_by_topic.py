"""Help is short and by topic, and files need no options."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from termsel.cli.main import cli
from termsel.plugins.commands import COMMANDS, GROUPS, PACKAGES
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import registry


def printed(*words: str) -> str:
    done = CliRunner().invoke(cli, [*words])
    assert done.exit_code == 0, done.output
    return done.output


def test_help_names_every_installed_command_in_a_group() -> None:
    text = printed("--help")
    for name in {*COMMANDS, *registry().names("commands")}:
        assert any(name in names for names in GROUPS.values()), name
        assert f"  {name} " in text
    for group in GROUPS:
        assert f"{group}:\n" in text


def test_the_table_of_packages_has_their_commands() -> None:
    of_packages = {name for commands in PACKAGES.values() for name in commands}
    assert set(registry().names("commands")) <= of_packages
    assert not of_packages & set(COMMANDS)


def test_the_help_of_run_fits_a_screen_and_all_options_are_at_hand() -> None:
    assert len(printed("run", "--help").splitlines()) <= 50
    every = printed("run", "--help-all")
    for option in ("--areas", "--fit-crs", "--patience", "--allow-remote", "--then"):
        assert option not in printed("run", "--help")
        assert option in every
    assert "9223372036854775807" not in every


def test_list_without_a_kind_counts_all() -> None:
    text = printed("list")
    for kind in KINDS:
        assert f"termsel list {kind}" in text


@pytest.mark.parametrize("names", [
    ["scene.points"], ["scene.points", "scene.tif"], ["scene.tif", "scene.points"]])
def test_files_are_told_apart_by_their_names(example_files: Path, names: list[str]) -> None:
    files = [str(example_files / name) for name in names]
    assert printed("run", *files, "--quiet").startswith("scene.points: 60 points")


def test_two_files_of_one_kind_are_refused(example_files: Path) -> None:
    points, others = (str(example_files / name) for name in ("gcps.csv", "scene.points"))
    done = CliRunner().invoke(cli, ["run", points, others])
    assert done.exit_code == 2
    assert "are both points" in done.output
