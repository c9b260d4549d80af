"""Pages of hostile ids, of large images, and of a drawing library that fails."""

from __future__ import annotations

import base64
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.thumbnail import make_thumbnail
from termsel.results.plots import save, styled_chart

altair = pytest.importorskip("altair")
pytest.importorskip("vl_convert")

HOSTILE = ("</script><img src=x onerror=alert(1)>", "{{7*7}} ${x} %s",
           "\u0627\u0644\u0646\u0642\u0637\u0629 42", "a \"quoted\" & 'single' id", "x" * 200,
           "=cmd|' /C calc'!A0", "datum['id']")


@pytest.mark.slow
def test_hostile_ids_are_text(tmp_path: Path) -> None:
    features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    points = features.points
    ids = (*HOSTILE, *points.ids[len(HOSTILE):])
    named = features.with_(points=termsel.Points(
        ids, points.image, points.ground, points.sigma, points.roles))
    termsel.run("poly-terms", features=named, solver="random", evaluations=100).report(
        tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "<img" not in text[:text.index("<script>")]
    assert text.count("</script>") == 3
    for name in HOSTILE:
        assert f">{name}<" in unescape(text) or f"{name}</button>" in unescape(text)


@pytest.mark.parametrize(("size", "shown"), [((400, 3000), (133, 1000)), ((50, 60), (50, 60))])
def test_an_image_is_reduced_to_a_thousand_pixels(size: tuple[int, int], shown: tuple[int, int],
                                                  tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", height=size[0], width=size[1],
                       count=1, dtype="uint16") as image:
        image.write(np.linspace(0, 60_000, size[0] * size[1]).reshape(size), 1)
    text, own = make_thumbnail(tmp_path / "a.tif")
    assert own == size
    content = base64.b64decode(text.partition(",")[2])
    with rasterio.MemoryFile(content) as file, file.open() as jpeg:
        assert jpeg.shape == shown
        assert jpeg.read(1).min() < 120 < 240 < jpeg.read(1).max()


NAMES = ("constructor", "toString", "valueOf", "hasOwnProperty", "__proto__")


@pytest.mark.slow
def test_ids_may_be_what_objects_of_javascript_have(tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    image = scene.points.image.copy()
    image[:5] += [8, 5]  # so that they are among the worst
    points = replace(scene.points, ids=(*NAMES, *scene.points.ids[5:]), image=image)
    result = termsel.run("rfm-terms", features=termsel.FeatureSet(points, crs=scene.crs),
                         strategy="as-asked", solver="all-terms", criterion="press")
    save(styled_chart(result.view, "worst"), tmp_path / "worst.svg")
    drawn = (tmp_path / "worst.svg").read_text()
    shown = {row["id"] for row in result.view.worst[:25]} & set(NAMES)
    assert len(shown) > 2
    assert all(f">{name}" in drawn for name in shown)
    result.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    for name in NAMES:
        assert f'"{name}\\u2060"' in page
        assert f'"id":"{name}"' not in page


@pytest.mark.slow_cases(".svg")
@pytest.mark.parametrize("suffix", [".svg", ".png", ".pdf"])
def test_a_fault_of_the_drawing_library_ends_no_process_of_ours(
        suffix: str, tmp_path: Path) -> None:
    def of(name: str) -> Any:
        return altair.Chart(altair.Data(values=[{"a": name}])).mark_text().encode(text="a:N")

    with pytest.raises(TermselError, match="cannot draw this chart: a fault of compiled code"):
        save(of("a\x1bb"), tmp_path / f"bad{suffix}")  # the library aborts its process
    with pytest.raises(TermselError, match="cannot draw this chart"):
        save(of("\ud800"), tmp_path / f"bad{suffix}")  # it raises
    save(of("a"), tmp_path / f"good{suffix}")
    assert [path.name for path in tmp_path.iterdir()] == [f"good{suffix}"]
