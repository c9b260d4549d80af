"""Columns that say which rows are in use, whatever they are called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import termsel

ROWS = ("id,line,sample,x,y", "A,0,0,5.0,44.0", "B,0,900,5.1,44.0", "C,900,0,5.0,43.9",
        "D,900,900,5.1,43.9")


def table(folder: Path, *columns: tuple[str, str]) -> Path:
    """Return the path of a table with further columns: a name and four cells, between blanks."""
    rows = list(ROWS)
    for name, cells in columns:
        rows = [f"{row},{cell}" for row, cell in zip(rows, (name, *cells.split()), strict=True)]
    path = folder / "points.csv"
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def off_in(path: Path, **options: str) -> list[str]:
    points = termsel.read(path, crs="EPSG:4326", **options).points
    return [name for name, role in zip(points.ids, points.roles, strict=True) if role == "off"]


@pytest.mark.parametrize(("name", "cells"), [
    ("use", "1 1 0 1"), ("Used?", "yes yes no yes"), ("Activo", "sí sí no sí"),
    ("in_use", "true true false true"), ("使用", "是 是 否 是"), ("вкл", "да да нет да"),
    ("gültig", "ja ja nein ja"), ("OK", "1.0 1.0 0.0 1.0"), ("Outlier", "0 0 1 0"),
    ("excluded", "False False True False"), ("выброс", "нет нет да нет")])
def test_rows_that_flags_switch_off_are_off_and_said(
        name: str, cells: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = table(tmp_path, (name, cells))
    assert off_in(path) == ["C"]
    assert f"by column {name!r}, 1 of 4 rows is not used" in caplog.text


@pytest.mark.parametrize(("name", "cells"), [
    ("use", "1 1 1 1"), ("use", "0 0 0 0"), ("use", "1 0 2 1"), ("monument", "1 0 1 1"),
    ("use", "road road house road")])
def test_what_is_no_flag_stays_an_attribute(name: str, cells: str, tmp_path: Path,
                                            caplog: pytest.LogCaptureFixture) -> None:
    path = table(tmp_path, (name, cells))
    assert off_in(path) == []
    assert "not used" not in caplog.text
    assert termsel.read(path, crs="EPSG:4326").points.attributes[name].tolist() == cells.split()


def test_several_flags_must_all_leave_a_row_in_use(tmp_path: Path,
                                                   caplog: pytest.LogCaptureFixture) -> None:
    assert off_in(table(tmp_path, ("use", "1 0 1 1"), ("outlier", "0 0 0 1"))) == ["B", "D"]
    assert "by column 'use' and 'outlier', 2 of 4 rows are not used" in caplog.text


def test_a_column_called_enabled_decides_alone(tmp_path: Path) -> None:
    assert off_in(table(tmp_path, ("enabled", "1 1 0 1"), ("use", "1 0 1 1"))) == ["C"]
    assert off_in(table(tmp_path, ("use", "1 0 1 1"), ("role", "off check control control"))
                  ) == ["A", "B"]


def test_flags_in_either_sense_are_named_with_a_command(tmp_path: Path,
                                                        caplog: pytest.LogCaptureFixture) -> None:
    path = table(tmp_path, ("status", "1 0 1 1"))
    assert off_in(path) == []
    assert "--columns enabled=status leaves the others out" in caplog.text
    assert off_in(path, columns="enabled=status") == ["B"]


@pytest.mark.parametrize(("name", "cells"), [
    ("check", "0 1 0 1"), ("Is CP", "no yes no yes"), ("检查点", "否 是 否 是")])
def test_flags_of_check_points_are_named_with_an_option(
        name: str, cells: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert off_in(table(tmp_path, (name, cells))) == []
    true_word = cells.split()[1]
    assert (f"column {name!r} is not read: if {true_word} stands for a check point, --role "
            "ID=independent") in caplog.text


def test_roles_by_another_name_are_named_with_a_command(tmp_path: Path,
                                                        caplog: pytest.LogCaptureFixture) -> None:
    path = table(tmp_path, ("tipo", "Control Check Control Independent"))
    assert not any(termsel.read(path, crs="EPSG:4326").points.roles)
    assert "column 'tipo' looks like roles" in caplog.text
    assert "--columns role=tipo reads it" in caplog.text
    roles = termsel.read(path, crs="EPSG:4326", columns="role=tipo").points.roles
    assert roles == ("control", "check", "control", "independent")


def test_a_point_that_a_flag_switches_off_takes_no_part(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    image = rng.uniform(0, 2000, (12, 2))
    ground = np.column_stack([4e5 + 2 * image[:, 1], 5e6 - 2 * image[:, 0]])
    ground[4] += 700.0
    rows = [f"P{i},{line:.1f},{sample:.1f},{x:.2f},{y:.2f},{int(i != 4)}"
            for i, ((line, sample), (x, y)) in enumerate(zip(image, ground, strict=True))]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(["id,line,sample,x,y,active", *rows]), encoding="utf-8")
    result = termsel.run(features=termsel.read(path, crs="EPSG:32631"))
    assert "P4" not in result.fit.control.ids
    assert np.abs(result.project(ground[:4, :]) - image[:4]).max() < 0.5
