"""What is made of a result that no model fits says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel


@pytest.mark.parametrize("is_random", [True, False])
def test_an_export_of_random_points_says_that_no_model_fits(
        is_random: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    features = termsel.simulate_scene("ikonos-hamedan", seed=1, roles=(24, 0, 0), n_lines=0)
    if is_random:
        image = np.random.default_rng(0).uniform(0, 5000, (24, 2))
        features = features.with_(points=replace(features.points, image=image))
    result = termsel.run(features=features)
    caplog.clear()
    termsel.export(result, "rpc-txt", tmp_path / "scene_RPC.TXT")
    assert ("no model fits these points" in caplog.text) == is_random
