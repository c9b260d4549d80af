"""A value that was copied wrongly is named, with what it may have been."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from termsel import FeatureSet, Points
from termsel.data.features import FloatArray
from termsel.data.record.figures import Outlier
from termsel.data.slips import slip_among, slips_of_row, slips_of_value
from termsel.runs.slips import notes_on_slips

Call = Callable[..., SimpleNamespace]

ROW = 5
"""The point that is wrong."""


class Plane:
    """An image of pixels of 2 m, with line 0 in the north."""

    def project(self, ground: FloatArray) -> FloatArray:
        """Return line and sample, (n, 2), of ground positions (n, 3)."""
        return np.column_stack([4_004_321.0 - ground[:, 1], ground[:, 0] - 500_123.0]) / 2.0


def scattered_points(seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return image (n, 2) and ground coordinates (n, 3) of points, exact to about a pixel."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(500_200.0, 508_000.0, 20),
                              rng.uniform(3_997_000.0, 4_004_200.0, 20),
                              rng.uniform(100.0, 300.0, 20)]).round(2)
    return (Plane().project(ground) + rng.normal(0.0, 0.8, (20, 2))).round(2), ground


def notes_of(image: FloatArray, ground: FloatArray, **stated: object) -> list[str]:
    """Return the notes on slips of the point that is wrong."""
    names = tuple(f"P{number}" for number in range(len(image)))
    features = FeatureSet(points=Points(names, image, ground), crs="EPSG:32639", **stated)
    error = float(np.abs(Plane().project(ground) - image).max(axis=1)[ROW])
    outlier = Outlier(id=names[ROW], kind="point", role="control", error=error,
                      certainty="certain", excluded=True)
    return list(notes_on_slips(features, [outlier], Plane(), 1.0))  # type: ignore[arg-type]


def test_a_slip_on_the_ground_is_named_with_the_value_that_fits() -> None:
    image, ground = scattered_points()
    image[ROW, 1] += (503_719.25 - ground[ROW, 0]) / 2.0
    right = ground[ROW, 0] = 503_719.25
    for wrong, reason in ((-right, "the sign turned"), (5_037_192.5, "the decimal point moved"),
                          (507_319.25, "two digits exchanged")):
        ground[ROW, 0] = wrong
        [note] = notes_of(image, ground)
        assert note.startswith("P5 would fit to ")
        assert f"x = {right:.12g} in place of {wrong:.12g}: {reason}?" in note


def test_a_slip_in_the_image_is_named_by_its_place() -> None:
    # The file may count lines and samples from elsewhere, and so has other values.
    image, ground = scattered_points()
    image[ROW] = image[ROW, ::-1]
    [note] = notes_of(image, ground)
    assert "with another line and sample: line and sample exchanged?" in note


def test_values_in_other_units_are_named_by_their_place() -> None:
    image, ground = scattered_points()
    ground[ROW, 1] *= 10
    [note] = notes_of(image, ground, named_units={"y": "km"})
    assert "with another y: the decimal point moved?" in note


def test_an_ordinary_blunder_is_named_a_slip_at_most_once_in_a_hundred() -> None:
    # An offset along one axis is what digits that are exchanged imitate most.
    rng = np.random.default_rng(3)
    named = 0
    for trial in range(300):
        image, ground = scattered_points(trial)
        image[ROW, trial % 2] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(1.0, 3.0)
        named += len(notes_of(image.round(2), ground))
    assert named <= 3


def test_slip_of_a_run_leads_to_its_correction(call: Call, tmp_path: Path) -> None:
    image, ground = scattered_points()
    local = (ground[:, :2] - 500_000.0).round(2)
    local[ROW, 1] *= 10
    rows = [f"P{number},{','.join(map(str, row))}"
            for number, row in enumerate(np.column_stack([image, local]))]
    path = tmp_path / "wrong.csv"
    path.write_text("\n".join(["# crs: local", "id,line,sample,x,y", *rows]) + "\n")
    screen = " ".join(call("run", path, "--method", "affine", "--quiet").stdout.split())
    assert "P5 would fit to " in screen
    assert "Next: correct P5 in the file if its source says so, then run again" in screen


def test_a_slip_beyond_the_crs_is_named_where_it_is_refused(call: Call, tmp_path: Path) -> None:
    def refused(x: float, y: float) -> str:
        places = [(48.51, 34.77), (48.52, 34.81), (x, y), (48.49, 34.79), (48.55, 34.76)]
        path = tmp_path / "table.csv"
        path.write_text("\n".join([
            "# crs: EPSG:4326", "id,line,sample,x,y",
            *(f"P{number},{number ** 2},{7 * number % 5},{place[0]},{place[1]}"
              for number, place in enumerate(places))]) + "\n")
        done = call("run", path)
        assert done.exit_code == 2
        return str(done.stderr)

    assert ("is it x = 48.53, with the decimal point moved? Correct it, or leave it out: --off P2."
            in refused(485.3, 34.78))
    assert "decimal point" not in refused(200.2, 148.5)


def test_slips_of_values_keep_the_digits_that_were_typed() -> None:
    slips = list(slips_of_value(485.08))
    assert (48.508, "the decimal point moved") in slips
    assert (845.08, "two digits exchanged") in slips
    assert (-485.08, "the sign turned") in slips
    assert [*slips_of_value(0.0), *slips_of_value(float("nan"))] == []


def test_only_one_slip_is_a_reason() -> None:
    others = np.array([48.1, 48.2, 48.3])
    assert slip_among(482.0, others) == (48.2, "the decimal point moved")
    assert slip_among(482.0, np.array([1.0, 500.0, 90.0])) is None
    assert slip_among(482.0, others[:2]) is None


def test_a_row_is_changed_in_one_place() -> None:
    row = np.array([100.0, 200.0, 3.0, 4.0, np.nan])
    for slip in slips_of_row(row):
        changed = [name for name, before, after in zip(
            ("line", "sample", "x", "y", "z"), row, slip.row, strict=True)
            if before != after and np.isfinite(after)]
        assert set(changed) == set(slip.columns)
