"""Fields of layers of points are known by the names that columns of tables may have."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

from termsel.data.tables.columns import _FURTHER, POINTS, columns_by_meaning

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


@pytest.mark.parametrize(("field", "heading"), [
    ("H [km]", "z [km]"), ("z_ft", "z_ft"), ("Höhe (cm)", "z (cm)"), ("altitude", "z"),
    (None, "z")])
def test_units_in_names_of_fields_reach_the_command_line(field: str | None, heading: str) -> None:
    assert field_names.heading("z", field).replace(" ", "") == heading.replace(" ", "")
    assert field is None or field_of("z", ["name", field]) == field
