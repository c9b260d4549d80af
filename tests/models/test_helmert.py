"""The plane similarity: as in scikit-image, by two points, in degrees, with features selected."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.transform import SimilarityTransform

import termsel
from termsel import FeatureSet, Helmert2D, Points
from termsel.data.features import FloatArray


def seen(ground: FloatArray, scale: float, angle: float, *, mirrored: bool = False) -> FloatArray:
    """Return line and sample of ground seen from above, turned counter-clockwise."""
    x, y = ground[:, 0] * scale, ground[:, 1] * scale * (-1 if mirrored else 1)
    right = np.cos(angle) * x - np.sin(angle) * y
    up = np.sin(angle) * x + np.cos(angle) * y
    return np.stack([3000.0 - up, 400.0 + right], axis=1)


def scene(n: int, noise: float = 0.0, angle: float = 2.0, *, mirrored: bool = False,
          crs: str = "local") -> FeatureSet:
    rng = np.random.default_rng(5)
    # Wider than high: one scale of the scaled coordinates would not be one on the ground.
    ground = np.column_stack([rng.uniform((0, 0), (9000, 2000), (n, 2)), np.full(n, np.nan)])
    image = seen(ground, 0.25, angle, mirrored=mirrored) + noise * rng.standard_normal((n, 2))
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)), image, ground), crs=crs)


def test_it_is_the_similarity_of_scikit_image() -> None:
    features, others = scene(9, 3.0), scene(40).points.ground
    # x right and y up, as on paper
    paper = features.points.image[:, ::-1] * [1, -1]
    theirs = SimilarityTransform.from_estimate(features.points.ground[:, :2], paper)
    found = termsel.fit(features, model="helmert2d").project(others)
    np.testing.assert_allclose(found[:, ::-1] * [1, -1], theirs(others[:, :2]), atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi])
@pytest.mark.parametrize("mirrored", [False, True])
def test_two_points_determine_it(angle: float, mirrored: bool) -> None:
    features = scene(12, angle=angle, mirrored=mirrored)
    two = features.take(np.arange(12) < 2)
    fitted = termsel.fit(two, Helmert2D(mirrored=mirrored))
    assert np.abs(fitted.errors(features.points)).max() < 1e-6
    wrong = termsel.fit(two, Helmert2D(mirrored=not mirrored))  # fits its two points, and no others
    assert np.abs(wrong.errors(two.points)).max() < 1e-6
    assert np.abs(wrong.errors(features.points)).max() > 100


def test_one_point_is_refused_with_what_is_needed() -> None:
    with pytest.raises(termsel.TermselError, match="2 equations for the 4 terms") as refusal:
        termsel.fit(scene(1), Helmert2D())
    assert "at least 2" in str(refusal.value.hint)


def test_degrees_are_brought_to_one_unit() -> None:
    rng = np.random.default_rng(6)
    metres = rng.uniform(-1000, 1000, (10, 2))
    one = 6371000.0 * np.pi / 180
    degrees = np.column_stack([7.0 + metres[:, 0] / one / np.cos(np.radians(60.0)),
                               60.0 + metres[:, 1] / one, np.zeros(10)])
    features = FeatureSet(Points(tuple(map(str, range(10))), seen(metres, 0.5, 0.7), degrees),
                          crs="EPSG:4326")
    fitted = termsel.fit(features, model="helmert2d")
    # The cosine at the middle of the points holds up to their half-range in latitude.
    assert np.abs(fitted.errors(features.points)).max() < 0.2


def test_features_are_selected_under_it() -> None:
    features = scene(20, 0.5)
    image = features.points.image.copy()
    image[3] += 60.0
    points = Points(features.points.ids, image, features.points.ground, roles=("control",) * 12
                    + ("check",) * 8)
    result = termsel.run("owdis-points", features=FeatureSet(points), model="helmert2d",
                         generations=20)
    assert "P3" not in result.selection.features
    assert result.selection.terms == Helmert2D().terms
    assert result.rmse["check"].total < 2


def test_deviations_of_a_similarity_hold_where_the_image_is_no_similar_one() -> None:
    """Twelve points do not show a shear of a pixel, which other polynomials may have."""
    squares = []
    for seed in range(40):
        rng = np.random.default_rng([7, seed])
        share = rng.uniform(0.0, 1.0, (112, 2))
        middle = 2.0 * share - 1.0
        bent = 0.4 * np.sin(3.0 * middle[:, ::-1] + rng.uniform(0.0, 6.0, 2))
        image = 1000.0 * share + middle @ rng.normal(0.0, 0.6, (2, 2)) + bent
        ground = np.column_stack([500.0 * share[:, 1], -500.0 * share[:, 0],
                                  np.full(len(share), np.nan)])
        measured = image[:12] + rng.normal(0.0, 0.5, (12, 2))
        points = Points(tuple(map(str, range(12))), measured, ground[:12])
        fitted = termsel.fit(FeatureSet(points, crs="local"), "helmert2d")
        errors = fitted.project(ground[12:]) - image[12:]
        squares.append(np.mean((errors / fitted.sigma(ground[12:]))**2))
    # By the noise alone the errors are 1.2 to 1.3 standard deviations.
    assert 0.8 < np.sqrt(np.mean(squares)) < 1.1
