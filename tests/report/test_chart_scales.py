"""Scales, units and bands of charts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec import convert

import termsel
from termsel.core.errors import rounded_size_text
from termsel.data.record.record import Record
from termsel.results.charts import bars
from termsel.results.charts.maps import ground_extent, image_extent
from termsel.results.charts.search import refinement_remark
from termsel.results.pictures import with_margins
from termsel.results.theme import with_theme
from tests.records import baseline, record, roles

altair = pytest.importorskip("altair")
pytest.importorskip("vl_convert")


def rows_of(chart: object) -> dict[str, list[dict[str, object]]]:
    """Return all data of a chart."""
    return chart.to_dict()["datasets"]  # type: ignore[attr-defined]


def test_the_empires_in_the_history_are_those_of_the_search() -> None:
    seen: list[list[int]] = []

    def look(progress: Any) -> None:
        details = progress.generation.details
        if "empire" in details:
            seen.append([int((details["empire"] == i).sum()) for i in range(3)])

    result = termsel.run("poly-terms", solver="ica", evaluations=900, observers=[look],
                         options={"population": 12, "imperialists": 0.25, "contested": 3})
    assert [list(one.empires) for one in result.history] == seen
    assert 0 in seen[-1]  # one has vanished, and keeps its place


def test_a_long_search_is_thinned_and_keeps_its_ends() -> None:
    from termsel.results.charts.search import evenly_spaced

    history = [{"evaluations": i} for i in range(10_007)]
    shown = evenly_spaced(history, 400)
    assert len(shown) == 400
    assert (shown[0], shown[-1]) == (history[0], history[-1])
    gaps = np.diff([one["evaluations"] for one in shown])
    assert gaps.max() - gaps.min() <= 1
    assert evenly_spaced(history[:400], 400) == history[:400]


@pytest.mark.slow_cases("residuals", "worst")
@pytest.mark.parametrize("kind", ["residuals", "ground", "worst"])
def test_residuals_of_rounding_alone_are_not_exaggerated(kind: str, tmp_path: Path) -> None:
    ground = np.array([[0.0, 0, 0], [900, 100, 5], [300, 800, 9]])
    image = np.array([[5.5, 7.25], [455.1, 30.4], [160.7, 401.3]])
    result = termsel.run("poly-terms", features=termsel.FeatureSet(
        termsel.Points(("a", "b", "c"), image, ground, roles=("control",) * 3)))
    drawn = getattr(result.plot, kind)()
    for param in drawn.to_dict().get("params", []):
        if param.get("name") == "exaggeration":
            assert param["value"] == 1
    from termsel.results.plots import save
    save(drawn, tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_a_caption_states_the_evaluations_of_the_refinement_that_the_report_states() -> None:
    record = termsel.run("poly-terms", solver="ga", evaluations=400,
                         options={"polish": True}).view.record
    assert record.polish is not None
    refined = record.polish.evaluations
    assert f"{record.evaluations - refined:,} evaluations; the local refinement used {refined:,} " \
        in refinement_remark(SimpleNamespace(record=record))
    plain = termsel.run("poly-terms", solver="ga", evaluations=400,
                        options={"polish": False}).view.record
    assert plain.polish is None
    assert refinement_remark(SimpleNamespace(record=plain)) == ""


def test_a_caption_names_fits_that_the_chart_leaves_out_with_their_figures() -> None:
    def fit(name: str, error: float) -> dict[str, Any]:
        return baseline(name, 8, roles(1.0, 2.0, error))

    view = SimpleNamespace(record=convert(record(
        baselines=[fit("dlt", 2.5), fit("affine", 3.5), fit("cubic", 987.6)]), Record))
    shown, left_out = bars.rows_of_fits(view)
    assert left_out == {"cubic": 987.6}
    assert "cubic" not in {row["fit"] for row in shown}
    assert "cubic (988 px)" in bars.caption_on_others(view)


@pytest.mark.parametrize("facets", [False, True])
def test_a_caption_is_no_wider_than_its_chart(facets: bool) -> None:
    data = altair.InlineData(values=[{"a": 1}])
    for width in (140, 280, 560):
        chart = altair.Chart(data).mark_point().properties(width=width)
        shown = with_theme(chart.facet("a:N") if facets else chart, "Title", "words of it " * 20)
        lines = shown.to_dict()["title"]["subtitle"]
        # 84 letters of this size take 560 px.
        assert 0.75 * width < 560 / 84 * max(map(len, lines)) <= width


@pytest.mark.parametrize(("n", "least", "most"), [(40, 0.02, 0.06), (900, 0.004, 0.021)])
def test_many_arrows_are_short_enough_to_be_told_apart(n: int, least: float, most: float) -> None:
    rng = np.random.default_rng(5)
    ground = np.column_stack([rng.uniform(0, 4000, (n, 2)), np.zeros(n)])
    image = ground[:, [1, 0]] + rng.normal(0, 1, (n, 2))
    view = termsel.run("poly-terms", model="affine", solver="all-terms", criterion="press",
                       features=termsel.FeatureSet(
                           termsel.Points(tuple(map(str, range(n))), image, ground,
                                          roles=("control",) * n), image_size=(4000, 4000))).view
    for extent, rows, vector in ((image_extent(view), view.in_image, ("ds", "dl")),
                                 (ground_extent(view), view.on_ground, ("dx", "dy"))):
        lengths = [np.hypot(row[vector[0]], row[vector[1]]) for row in rows]
        # In widths of the map: n positions lie n**-0.5 of it apart.
        assert least < extent.scale * np.median(lengths) / 4000 < most


def test_the_map_of_uncertainty_reaches_to_the_last_feature() -> None:
    features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    view = termsel.run("poly-terms", solver="all-terms", features=replace(
        features, image_size=None)).view
    image = features.points.image
    for axis, (low, high) in (("line", ("line", "line2")), ("sample", ("sample", "sample2"))):
        column = image[:, 0 if axis == "line" else 1]
        margin = 0.04 * np.ptp(column)
        assert min(cell[low] for cell in view.sigma) < column.min() + margin
        assert max(cell[high] for cell in view.sigma) > column.max() - margin


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_result_without_heights_is_shown_in_metres() -> None:
    scene = termsel.run(dataset="old-map").features
    assert np.isnan(scene.points.ground[:, 2]).all()
    result = termsel.run("poly-terms", features=replace(scene, crs="EPSG:2100"))
    assert result.view.units_per_metre == 1.0


@pytest.mark.parametrize(("errors", "broken"), [
    ([60.0, 1, 0.9, 0.8], {"F0"}), ([80.0, 40, 1, 0.9, 0.8, 0.7, 0.5], {"F0", "F1"}),
    ([8.0, 4, 2, 1], set()), ([1.0], set()), ([0.0, 0.0], set()), ([], set())])
def test_one_blunder_does_not_flatten_all_bars(errors: list[float], broken: set[str]) -> None:
    view: Any = SimpleNamespace(worst=[
        {"id": f"F{i}", "role": "control", "distance": error,
         "blunder": "certain" * (i == 0 and error > 9)}
        for i, error in enumerate(errors)])
    shown = max(rows_of(bars.bars_of_worst(view)).values(), key=len, default=[])
    assert {row["id"] for row in shown if row.get("broken")} == broken
    assert {row["label"] for row in shown if row.get("broken")} == {
        f"{rounded_size_text(error)} px" + ", blunder" * (i == 0) for i, error in enumerate(errors)
        if f"F{i}" in broken}
    ends = [row["end"] for row in shown]
    assert not broken or max(ends) < 12 * float(np.median(ends))
    assert bool(bars.caption_on_breaks(view)) == bool(broken)  # which the caption says


@pytest.mark.parametrize(("crs", "unit", "axes"), [
    ("EPSG:4979", 9e-6, ("longitude [°], EPSG:4979", "latitude [°]")),
    ("EPSG:32639", 1.0, ("x [m], EPSG:32639", "y [m]")),
    ("EPSG:2263", 1 / 0.3048006, ("x [0.3048 m], EPSG:2263", "y [0.3048 m]")),
    ("local", None, ("x [unit not known], local", "y [unit not known]"))])
def test_axes_on_the_ground_have_units(crs: str, unit: float | None,
                                       axes: tuple[str, str]) -> None:
    from termsel.results.charts import maps

    view: Any = SimpleNamespace(record=SimpleNamespace(data=SimpleNamespace(crs=crs)),
                                units_per_metre=unit)
    assert maps._axis_titles(view) == axes


def test_a_drawing_has_a_margin_for_wider_letters() -> None:
    drawn = with_margins('<svg width="600" height="99.5" viewBox="0 0 600 99.5">'
                         '<rect width="600" height="99.5" fill="#ffffff"/><g/></svg>')
    assert drawn == ('<svg width="664" height="99.5" viewBox="-18 0 664 99.5">'
                     '<rect x="-18" width="664" height="99.5" fill="#ffffff"/><g/></svg>')
