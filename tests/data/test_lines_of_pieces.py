"""Lines of several pieces under one id: one feature, with all its rows."""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel.adjustment.equations import line_normals
from termsel.data.features import FeatureSet, Lines, Points
from termsel.models.polynomial import Affine, Polynomial3D
from termsel.selection.criteria import CheckRmse, KFold, Press
from termsel.selection.problems.base import ProblemData
from termsel.selection.problems.selection import SelectionProblem
from termsel.testing.scenes import imaged_features, random_coefficients, seeded_generator

MODEL = Polynomial3D(degree=2)
PIECES = 3


def scene(points: int = 0) -> tuple[FeatureSet, Points]:
    """Return lines of which pieces 1 to 3 share an id, not side by side, and check points."""
    rng = seeded_generator()
    truth = random_coefficients(MODEL, rng)
    features = imaged_features(MODEL, truth, rng, points=points, lines=30)
    ids = list(features.lines.ids)
    ids[4] = ids[17] = ids[2]
    lines = Lines(tuple(ids), features.lines.image + rng.normal(0, 1e-3, (30, 2, 2)),
                  features.lines.ground)
    return features.with_(lines=lines), imaged_features(MODEL, truth, rng, points=20).points


def test_pieces_are_one_feature() -> None:
    features, _ = scene(points=5)
    assert len(features.lines) == 30
    assert len(features) == 5 + 28 == len(features.ids) == len(set(features.ids))
    rows = MODEL.equations(features).feature
    name = features.ids.index("l3")
    assert (rows == name).sum() == 2 * PIECES
    assert rows.max() == 32
    without = features.take(np.arange(33) != name)
    assert without.ids == tuple(i for i in features.ids if i != "l3")
    assert len(without.lines) == 27


def test_heights_that_one_piece_lacks() -> None:
    features, _ = scene()
    ground = features.lines.ground.copy()
    ground[[4, 17], :, 2] = np.nan
    lines = Lines(features.lines.ids, features.lines.image, ground)
    assert FeatureSet(lines=lines).without_height() == ("l3",)


def test_a_point_cannot_have_the_id_of_pieces() -> None:
    features, _ = scene()
    with pytest.raises(termsel.TermselError, match="id of a point and of a line"):
        features.with_(points=Points(("l3",), [[0, 0]], [[0, 0, 0]]))


def without(equations: termsel.Equations, left_out: np.ndarray) -> np.ndarray:
    """Return the coefficients of a fit to the rows of all other features."""
    rows = ~left_out[equations.feature]
    return np.linalg.lstsq(equations.A[rows], equations.b[rows])[0]


def squares(feature: FeatureSet, coefficients: np.ndarray) -> np.ndarray:
    """Return the squared errors of a point, or of the vertices of a line's pieces."""
    image = MODEL.project(coefficients, feature.ground_vertices())
    if len(feature.points):
        return ((image - feature.points.image) ** 2).sum(axis=1)
    normal, rho = (np.repeat(part, 2, axis=0) for part in line_normals(feature.lines))
    return (rho - (normal * image).sum(axis=1)) ** 2


@pytest.mark.parametrize("points", [0, 12])
def test_a_gene_switches_all_pieces(points: int) -> None:
    features, check = scene(points)
    problem = SelectionProblem(ProblemData(MODEL, features, check, 1000.0, CheckRmse()),
                               terms=False, features=True)
    assert problem.genome.size == points + 28
    off = np.array([name == "l3" for name in features.ids])
    found = problem.evaluate(np.array([~off, np.ones_like(off)])).objectives[:, 0]
    for figure, left_out in zip(found, (off, np.zeros_like(off)), strict=True):
        errors = MODEL.project(without(MODEL.equations(features), left_out), check.ground)
        errors -= check.image
        expected = 1000 * np.sqrt((errors**2).sum(axis=1).mean())
        assert figure == pytest.approx(expected, rel=1e-9)
    assert "l3" not in problem.decode(~off).features


@pytest.mark.parametrize("points", [0, 4])
@pytest.mark.parametrize("criterion", [Press(), KFold(folds=40)])
def test_a_feature_is_predicted_with_all_pieces_left_out(criterion: termsel.Criterion,
                                                         points: int) -> None:
    """With more folds than features each is left out alone, as by press."""
    features, check = scene(points)
    problem = SelectionProblem(ProblemData(MODEL, features, check, 1000.0, criterion),
                               terms=False, features=True)
    off = np.array([name in ("l5", "l9") for name in features.ids])
    found = problem.evaluate(~off[None]).objectives[0, 0]
    equations = MODEL.equations(features)
    errors = []
    for i in np.flatnonzero(~off):
        alone = np.arange(len(off)) == i
        errors.append(squares(features.take(alone), without(equations, off | alone)))
    assert len(errors[features.ids.index("l3")]) == 2 * PIECES
    expected = 1000 * np.sqrt(np.concatenate(errors).mean())
    assert found == pytest.approx(expected, rel=1e-9)


def test_result_of_a_run_with_pieces() -> None:
    features, check = scene()
    features = features.with_(points=Points(
        check.ids, check.image, check.ground,
        roles=("check", "independent") * 10))
    result = termsel.run("owdis-lines", features=features, model=Affine.name, generations=2,
                         options={"population": 20, "polish": False})
    assert result.data.counts.lines == 28
    kinds = [r.kind for r in result.residuals if r.id == "l3"]
    assert kinds == [f"vertex {i + 1}" for i in range(2 * PIECES)]
    used = {r.used for r in result.residuals if r.id == "l3"}
    assert used == {"l3" in result.selection.features}


def test_most_rows_the_features_can_give() -> None:
    features, check = scene()
    with pytest.raises(termsel.TermselError, match="gives 14 equations with at most 5 features"):
        SelectionProblem(ProblemData(MODEL, features, check, 1.0, CheckRmse(), {"max_features": 5}),
                         terms=False, features=True)
