"""Points that determine no interpolation."""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel.auto.shrunken import Interpolated
from termsel.data.features import FeatureSet, Points
from termsel.data.scaling import make_scaling
from termsel.fitting.fit import Undetermined


@pytest.mark.parametrize("n", [2, 20])
def test_points_in_a_row_are_not_only_called_too_few(n: int) -> None:
    steps = np.linspace(0.0, 900.0, n)
    control = FeatureSet(Points(
        tuple(f"p{i}" for i in range(n)), np.column_stack([steps, 2.0 * steps]),
        np.column_stack([steps, 3.0 * steps, np.zeros(n)])))
    model = termsel.get("models", "field")()
    with pytest.raises(Undetermined, match=f"{n} control points do not determine an interpolation: "
                                           "they are too few, or lie in a row"):
        Interpolated().fit(model, control, make_scaling(control),
                           np.ones(len(model.terms), dtype=bool), np.ones(n, dtype=bool))
