"""The RMSE that is predicted for new points, where the model leaves more than noise."""

from __future__ import annotations

import numpy as np
import pytest

import termsel

CAMERA = np.array([0.0, 0.0, 5000.0])
FOCAL = 6000.0


def photo_of_hills(count: int, seed: int) -> termsel.Points:
    """Return points of a vertical photo, 4.6 km above hills of 400 m, measured to 0.5 px."""
    rng = np.random.default_rng(seed)
    east, north = rng.uniform(-2000.0, 2000.0, (2, count))
    height = 200.0 + 200.0 * np.sin(east / 700.0) * np.cos(north / 900.0)
    ground = np.column_stack([east, north, height])
    distance = CAMERA[2] - height
    image = np.column_stack([-FOCAL * north / distance, FOCAL * east / distance])
    return termsel.Points(tuple(map(str, range(count))), image + rng.normal(0, 0.5, image.shape),
                          ground)


@pytest.mark.parametrize("model", ["dlt2d", "projective2d"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_projection_without_heights_predicts_what_relief_does_to_it(model: str, seed: int,
                                                                      ) -> None:
    features = termsel.FeatureSet(photo_of_hills(40, seed), crs="local")
    result = termsel.run(features=features, model=model)
    new = photo_of_hills(400, seed + 100)
    true = float(np.sqrt(((result.project(new.ground) - new.image) ** 2).sum(axis=1).mean()))
    control = result.rmse["control"]
    assert result.predicted is not None
    assert control is not None
    # A new point is predicted no better than one that the fit has seen.
    assert result.predicted.rmse > control.total
    assert 0.65 * true < result.predicted.rmse < 1.6 * true
