"""Small drawings of residuals, for lists of many images."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("termsel_studies", reason="termsel-studies is not installed: "
                    "pip install -e plugins/termsel-studies")

import termsel
from termsel import TableBlock
from termsel.toolkit.charts import Document, Section, render_page
from termsel_studies.small import MAX_ARROWS, draw_residual_thumbnail


def scene(n: int, noise: float) -> termsel.FeatureSet:
    """Return control of an affine image."""
    rng = np.random.default_rng(n)
    ground = np.column_stack([rng.uniform(0, 4000, (n, 2)), np.zeros(n)])
    image = ground[:, :2] * [0.5, -0.5] + [10, 2010] + rng.normal(0, noise, (n, 2))
    return termsel.FeatureSet(termsel.Points(tuple(f"P{i}" for i in range(n)), image, ground),
                              crs="local", image_size=(2100, 2100))


def test_an_arrow_of_a_drawing_points_from_computed_to_measured() -> None:
    features = scene(12, 0.1)
    points = features.points
    image = points.image.copy()
    image[4] += [0.0, 40.0]  # to the right
    result = termsel.run("poly-terms", features=features.with_(points=replace(
        points, image=image)))
    assert [one.id for one in result.outliers] == ["P4"]
    drawn = draw_residual_thumbnail(result.view)
    ring = re.search(r'<circle cx="([\d.]+)" cy="([\d.]+)"', drawn)
    assert ring is not None
    x, y = map(float, ring.groups())
    assert (x, y) == pytest.approx((image[4, 1] * 120 / 2099, image[4, 0] * 120 / 2099), abs=0.1)
    arrow = re.search(rf"M{x:.1f} {y:.1f}l([-\d.]+) ([-\d.]+)", drawn)
    assert arrow is not None
    right, down = map(float, arrow.groups())
    assert right > 50 * abs(down)


def test_rounding_has_no_arrows_and_no_scale() -> None:
    result = termsel.run(features=scene(3, 0.0))
    assert 0.0 < max(row.distance for row in result.residuals) < 1e-9
    assert "px</text>" not in draw_residual_thumbnail(result.view)


@pytest.mark.slow
def test_the_page_of_two_hundred_images_is_small() -> None:
    result = termsel.run("poly-terms", solver="all-terms", features=scene(1000, 1.0),
                         options={"degree": 1})
    many = draw_residual_thumbnail(result.view)
    assert many.count("M") <= 3 * MAX_ARROWS + 1
    assert "1000 residuals, the largest" in many
    drawn = [many] * 200
    table = TableBlock("200 images", ("image",), [(f"image {i}",) for i in range(200)],
                       pictures=drawn)
    text = render_page(Document("Study", "", (), (Section("Images", (table,)),)))
    assert len(text) < 3.5e6
