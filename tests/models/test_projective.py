"""Projective models compared with scikit-image and the textbook."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.transform import ProjectiveTransform

import termsel
from termsel.adjustment import solve
from termsel.data.features import FeatureSet, FloatArray, Points, empty_lines
from termsel.models.projective import DLT2D, DLT3D, Projective2D
from termsel.models.quotient import RationalFunctions, RationalModel


def points(image: FloatArray, ground: FloatArray) -> FeatureSet:
    return FeatureSet(Points(tuple(f"P{i}" for i in range(len(ground))), image, ground))


def scene(n: int, noise: float = 0.0, seed: int = 2) -> FeatureSet:
    """Return points of a plane that a camera sees at a slant; heights are of no account."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, (n, 3))
    x, y = ground[:, 0], ground[:, 1]
    image = np.stack([0.1 + 0.5 * x - 0.4 * y, -0.2 + 0.3 * x + 0.6 * y], axis=1)
    image /= (1 + 0.2 * x - 0.3 * y)[:, None]
    return points(image + noise * rng.standard_normal((n, 2)), ground)


def fitted(model: RationalModel, features: FeatureSet, ground: FloatArray) -> FloatArray:
    return model.project(solve(model.equations(features)).coefficients, ground)


@pytest.mark.parametrize(("n", "noise"), [(4, 0.05), (12, 0.0)])
@pytest.mark.parametrize("model", [Projective2D(), DLT2D(relief="plane")])
def test_a_plane_is_mapped_as_by_scikit_image(model: RationalModel, n: int, noise: float) -> None:
    # Four points leave no choice; of more, scikit-image minimises another norm.
    features, ground = scene(n, noise), scene(50, seed=3).points.ground
    theirs = ProjectiveTransform.from_estimate(features.points.ground[:, :2],
                                               features.points.image)
    np.testing.assert_allclose(fitted(model, features, ground), theirs(ground[:, :2]), atol=1e-9)


def test_dlt3d_solves_the_textbook_equations() -> None:
    rng = np.random.default_rng(4)
    X, Y, Z = ground = rng.uniform(-1, 1, (3, 15))
    below = 1 + 0.1 * X - 0.2 * Y + 0.15 * Z
    x = (0.5 * X + 0.1 * Y - 0.3 * Z + 0.2) / below + rng.normal(0, 0.01, 15)
    y = (-0.1 * X + 0.6 * Y + 0.2 * Z - 0.1) / below + rng.normal(0, 0.01, 15)
    # x + L9 xX + L10 xY + L11 xZ = L1 X + L2 Y + L3 Z + L4, and y with L5 to L8.
    rows, right = [], []
    for i in range(15):
        at = [X[i], Y[i], Z[i], 1]
        rows += [[*at, 0, 0, 0, 0, -x[i] * X[i], -x[i] * Y[i], -x[i] * Z[i]],
                 [0, 0, 0, 0, *at, -y[i] * X[i], -y[i] * Y[i], -y[i] * Z[i]]]
        right += [x[i], y[i]]
    L = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    model = DLT3D()
    found = dict(zip(model.terms, solve(model.equations(
        points(np.stack([x, y], axis=1), ground.T))).coefficients, strict=True))
    names = ["X", "Y", "Z", "1"]
    expected = {**{f"line.num:{name}": L[i] for i, name in enumerate(names)},
                **{f"sample.num:{name}": L[4 + i] for i, name in enumerate(names)},
                **{f"den:{name}": L[8 + i] for i, name in enumerate("XYZ")}}
    assert found == pytest.approx(expected, abs=1e-10)


def test_dlt3d_has_the_columns_of_an_rfm() -> None:
    rfm = RationalFunctions(order=1, denominators="shared")
    ground = scene(9).points.ground
    assert DLT3D().terms == rfm.terms
    np.testing.assert_array_equal(DLT3D().blocks(ground).line, rfm.blocks(ground).line)


def test_dlt2d_is_a_dlt_on_ground_whose_height_is_a_product() -> None:
    """The DLT on Z = d0 + d1 X + d2 Y + d3 XY, computed as it stands, is recovered in full."""
    rng = np.random.default_rng(5)
    control, others = rng.uniform(-1, 1, (2, 20, 3))
    d = np.array([0.3, -0.2, 0.4, 0.7])
    dlt = rng.uniform(-0.2, 0.2, 11)

    def raised(ground: FloatArray) -> FloatArray:
        x, y = ground[:, 0], ground[:, 1]
        return np.stack([x, y, d[0] + d[1] * x + d[2] * y + d[3] * x * y], axis=1)

    features = points(DLT3D().project(dlt, raised(control)), control)
    found = fitted(DLT2D(), features, others)
    np.testing.assert_allclose(found, DLT3D().project(dlt, raised(others)), atol=1e-9)
    assert np.abs(fitted(Projective2D(), features, others) - found).max() > 1e-3


def test_their_terms() -> None:
    above = [f"{side}.num:{name}" for side in ("line", "sample") for name in ("1", "X", "Y")]
    assert list(Projective2D().terms) == [*above, "den:X", "den:Y"]
    assert DLT2D(relief="plane").terms == Projective2D().terms
    assert len(DLT2D().terms) == len(DLT3D().terms) == 11
    assert DLT2D().terms[-1] == "den:XY"


@pytest.mark.slow_cases("dlt2d", "projective2d")
@pytest.mark.parametrize("name", ["projective2d", "dlt2d", "dlt3d"])
def test_their_terms_and_lines_can_be_selected(name: str) -> None:
    for problem in ("poly-terms", "owdis-lines"):
        result = termsel.run(problem, model=name, generations=3,
                             options={"population": 20, "polish": False})
        assert result.feasible
        assert result.rmse["independent"] is not None


def test_plane_models_take_features_without_heights() -> None:
    features = scene(12)
    ground = features.points.ground.copy()
    ground[:, 2] = np.nan
    flat = features.with_(points=Points(features.points.ids, features.points.image, ground),
                          lines=empty_lines())
    for model in (Projective2D(), DLT2D()):
        np.testing.assert_array_equal(model.equations(flat).A, model.equations(features).A)
