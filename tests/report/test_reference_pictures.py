"""Every kind of picture next to a reference that people have looked at.

References are in `tests/pictures`. After a change that is meant, look at the new ones:

    python tests/report/test_reference_pictures.py
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import termsel
from termsel.data.record.search import HistoryRow
from termsel.results import view
from termsel.results.plots import KINDS, styled_chart
from termsel.results.theme import with_theme
from termsel.studies.cells.journal import CellRecord
from termsel.studies.plan.spec import spec_of
from termsel.studies.study import Study
from termsel_studies import figures
from termsel_studies.figures import figures_of
from termsel_studies.small import draw_residual_thumbnail

pytest.importorskip("altair")
vl_convert = pytest.importorskip("vl_convert")

REFERENCES = Path(__file__).parents[1] / "pictures"
SMALLER = ((view, "SIGMA_SIDE", 6), (figures, "_MOST_PANELS", 2))
"""What keeps the references small: fewer cells of the map, fewer panels."""
TOLERANCE = 2.0
"""Pixels of the picture by which places may differ."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_OWN = ("id", "clip-path", "fill-opacity", "aria-label", "style")
"""Attributes that are not compared: names, and what is said of marks by their numbers."""


def scene() -> termsel.FeatureSet:
    """Return 24 points of a bent image, one of them a blunder, and errors that are no chance."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-1, 1, 6), np.linspace(-1, 1, 4)))
    z = np.sin(3 * x + y)
    i = np.arange(24)
    image = np.column_stack([400 - 350 * y + 20 * z + 8 * x * y,
                             500 + 450 * x - 15 * z + 6 * y * y])
    image += 0.4 * np.column_stack([np.sin(7.1 * i), np.cos(4.3 * i * i)])
    image[9] += [0.0, 14.0]
    ground = np.column_stack([5000 + 900 * x, 8000 + 700 * y, 300 + 40 * z])
    roles = ("control", "check", "control", "independent") * 6
    return termsel.FeatureSet(termsel.Points([f"P{k}" for k in i], image, ground, None, roles),
                              crs="EPSG:32639", image_size=(800, 1000))


@cache
def chosen() -> termsel.Result:
    """Return a choice by auto, next to fits whose figures no rounding decides."""
    found = termsel.run("rfm-terms", features=scene())
    return found.with_(baselines=tuple(one for one in found.baselines if one.name in (
        "affine", "dlt", "quadratic", "regularised-quadratic")))


@cache
def searched() -> termsel.Result:
    """Return proven optima by size, with a history that was made up: those of searches may vary."""
    found = termsel.run("poly-terms", features=scene(), solver="exact", options={
        "degree": 2, "off": "P9"})
    sizes = [[6, 6, 5, 3], [7, 6, 4, 3], [8, 7, 5, 0], [11, 9, 0, 0]]
    return found.with_(history=tuple(
        HistoryRow(evaluations=20 * (k + 1), best=9.0 / (k + 1), median=30.0 / (k + 1),
                   feasible=(0.25, 0.5, 0.9, 1.0)[k], empires=tuple(one))
        for k, one in enumerate(sizes)))


def study() -> Study:
    """Return a study whose runs were made up."""
    cells, records = {}, {}
    for i in range(6):
        for s, solver in enumerate(("ga", "ica", "pso")):
            for seed in (1, 2):
                key = f"{i} {solver} {seed}"
                cells[key] = {"problem": "poly-terms", "data": f"image {i}", "split": 0,
                              "strategy": "as-asked", "model": "poly2d",
                              "criterion": "check-rmse", "solver": solver, "seed": seed}
                best = 1 + 0.1 * i + (0.02, 0.2, 0.5)[s] * seed
                records[key] = CellRecord(
                    key, "done", "", {"fitness": best, "objective": "check-rmse",
                                      "evaluations": 200, "optimum": None,
                                      "independent": best, "cpu_seconds": 0.5},
                    [[10, 3 * best, 0.01], [40 * (s + 1), best, 0.1 * (s + 1)]], [])
    return Study(spec_of({"problems": ["poly-terms"], "solvers": ["ga", "ica", "pso"],
                          "seeds": 2}), cells, records, None)


def of_result(name: str) -> Any:
    result = searched() if name in ("front", "convergence", "empires", "frequency", "terms",
                                    "correlations") else chosen()
    return styled_chart(result.view, name)


def of_study(name: str) -> Any:
    one = next(figure for figure in figures_of(study()) if figure.name == name)
    return with_theme(one.chart, one.title, one.look)


PICTURES: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(KINDS, of_result),
    **{f"study-{name}": lambda key: of_study(key.partition("-")[2]) for name in (
        "ecdf-evaluations", "ecdf-cpu-seconds", "convergence", "performance-profile",
        "critical-difference")}}


def drawn(name: str) -> str:
    """Return a picture as SVG."""
    if name == "small":
        return draw_residual_thumbnail(chosen().view)
    return str(vl_convert.vegalite_to_svg(PICTURES[name](name).to_json(indent=None)))


def marks(svg: str) -> Iterator[tuple[str, str, list[float]]]:
    """Yield what a picture has: elements with their text and colours, and their numbers."""
    for element in ElementTree.fromstring(svg).iter():
        words, numbers = [element.tag, (element.text or "").strip()], []
        for name, value in sorted(element.attrib.items()):
            if name in _OWN:
                continue
            if name in ("fill", "stroke", "class", "font-family", "role"):
                words.append(f"{name}={value}" if "#gradient" not in value else name)
                continue
            words.append(name + _NUMBER.sub("#", value))
            numbers += [float(number) for number in _NUMBER.findall(value)]
        yield element.tag, " ".join(words), numbers


@pytest.mark.parametrize(("noise", "least", "most"), [(0.3, 1, 1), (60.0, 20, 500)])
def test_the_bar_of_residuals_can_be_seen(noise: float, least: float, most: float) -> None:
    rng = np.random.default_rng(2)
    ground = np.column_stack([rng.uniform(0, 4000, (12, 2)), np.zeros(12)])
    image = ground[:, [1, 0]] + rng.normal(0, noise, (12, 2))
    result = termsel.run("poly-terms", model="affine", solver="all-terms",
                         criterion="press", features=termsel.FeatureSet(termsel.Points(
                             tuple(map(str, range(12))), image, ground, roles=("control",) * 12),
                             image_size=(4000, 4000)))
    shown = result.plot.residuals().to_dict()
    [bar] = [row for rows in shown["datasets"].values() for row in rows
             if str(row.get("text", "")).endswith(" px")]
    [drawn] = [param["value"] for param in shown["params"] if param["name"] == "exaggeration"]
    assert least <= bar["length"] <= most
    assert 0.015 * 4000 < drawn * bar["length"] < 0.3 * 4000


@pytest.mark.slow_cases("front", "residuals", "worst")
@pytest.mark.parametrize("name", [*PICTURES, "small"])
def test_a_picture_is_like_its_reference(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module, key, value in SMALLER:
        monkeypatch.setattr(module, key, value)
    expected = list(marks((REFERENCES / f"{name}.svg").read_text()))
    actual = list(marks(drawn(name)))
    assert [words for _, words, _ in actual] == [words for _, words, _ in expected]
    for (_, words, now), (_, _, before) in zip(actual, expected, strict=True):
        np.testing.assert_allclose(now, before, atol=TOLERANCE, rtol=0.01, err_msg=words)


def test_every_reference_has_its_picture_and_they_are_small() -> None:
    files = sorted(REFERENCES.glob("*"))
    assert {path.stem for path in files} == {*PICTURES, "small"}
    assert sum(path.stat().st_size for path in files) < 600_000


@pytest.mark.parametrize(("before", "after"), [
    ('stroke="#c8003c"', 'stroke="#0072b2"'), ("translate(", "translate(9"), (">P9<", ">P8<")])
def test_another_picture_is_noticed(before: str, after: str) -> None:
    reference = (REFERENCES / "worst.svg").read_text()
    assert before in reference
    one, other = list(marks(reference)), list(marks(reference.replace(before, after, 1)))
    assert any(a[1] != b[1] or not np.allclose(a[2], b[2], atol=TOLERANCE, rtol=0.01)
               for a, b in zip(one, other, strict=True))


if __name__ == "__main__":
    for module, key, value in SMALLER:
        setattr(module, key, value)
    REFERENCES.mkdir(exist_ok=True)
    for picture in (*PICTURES, "small"):
        (REFERENCES / f"{picture}.svg").write_text(drawn(picture))
