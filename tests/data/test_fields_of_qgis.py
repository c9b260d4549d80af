"""Fields of layers of points are known by the names that columns of tables may have."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

import termsel
from termsel.data.tables.columns import _FURTHER, POINTS, columns_by_meaning, fold_name
from termsel.formats.readers.flags import _CHECKS, _EITHER, _IN_USE, _OUT_OF_USE

PLUGIN = Path(__file__).parents[2] / "plugins" / "qgis-termsel" / "qgis_termsel"

sys.path.insert(0, str(PLUGIN))
field_names = import_module("field_names")
sys.path.remove(str(PLUGIN))
KNOWN, field_of = field_names.KNOWN, field_names.field_of


@pytest.mark.parametrize("meaning", ["id", "line", "sample", "z"])
def test_all_names_of_the_command_line_are_known(meaning: str) -> None:
    for name in [*POINTS[meaning], *_FURTHER[meaning], *KNOWN[meaning].split()]:
        assert field_of(meaning, ["geom", name.upper(), "other"]) == name.upper()
    # "fid" and "sourceY" are QGIS's own, which tables have not.
    for name in KNOWN[meaning].split()[:-1]:
        assert columns_by_meaning([name], POINTS)[meaning] == [0] or name.startswith("source")


def test_units_accents_and_signs_count_for_nothing() -> None:
    fields = ["Höhe [m]", "Bild-Zeile", "X_Pixel", "Punkt-Nr."]
    assert field_of("z", fields) == "Höhe [m]"
    assert field_of("line", fields) == "Bild-Zeile"
    assert field_of("sample", fields) == "X_Pixel"
    assert field_of("id", fields) == "Punkt-Nr."
    assert field_of("role", fields) is None


def test_all_names_of_flags_and_deviations_are_passed_on() -> None:
    names = [*_IN_USE, *_OUT_OF_USE, *_EITHER, *_CHECKS, *POINTS["enabled"],
             *dict.fromkeys([*POINTS["sigma_line"], *POINTS["sigma_sample"]]), "Sigma_line [px]"]
    assert field_names.passed_on([*names, "Easting", "note", "use"], ["use"]) == [
        name for name in names if name != "use"]
    words = map(fold_name, field_names.PASSED_ON.split())
    assert set(words) <= {fold_name(name) for name in names}


@pytest.mark.parametrize(("field", "heading"), [
    ("H [km]", "z [km]"), ("z_ft", "z_ft"), ("Höhe (cm)", "z (cm)"), ("altitude", "z"),
    (None, "z")])
def test_units_in_names_of_fields_reach_the_command_line(field: str | None, heading: str) -> None:
    assert field_names.heading("z", field).replace(" ", "") == heading.replace(" ", "")
    assert field is None or field_of("z", ["name", field]) == field


def test_a_korean_flag_leaves_points_out(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    path = tmp_path / "flags.csv"
    path.write_text("id,line,sample,x,y,사용\nA,1,2,30,40,1\nB,9,3,31,48,0\nC,4,8,36,43,1\n",
                    encoding="utf-8")
    assert termsel.read(path, crs="local").points.roles == ("", "off", "")
    assert "by column '사용', 1 of 3 rows is not used" in caplog.text
