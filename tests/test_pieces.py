"""Lines of several pieces under one id: one feature, with all its rows."""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel.criteria import CheckRmse, KFold, Press
from termsel.features import FeatureSet, Lines, Points
from termsel.models.polynomial import Affine, Polynomial3D
from termsel.problems.selection import Inputs, SelectionProblem
from termsel.testing.scenes import imaged, random_coefficients, seeded

MODEL = Polynomial3D(degree=2)
PIECES = 3


def scene(points: int = 0) -> tuple[FeatureSet, Points]:
    """Return lines of which pieces 1 to 3 share an id, not side by side, and check points."""
    rng = seeded()
    truth = random_coefficients(MODEL, rng)
    features = imaged(MODEL, truth, rng, points=points, lines=30)
    ids = list(features.lines.ids)
    ids[4] = ids[17] = ids[2]
    lines = Lines(tuple(ids), features.lines.image + rng.normal(0, 1e-3, (30, 2, 2)),
                  features.lines.ground)
    return features.with_(lines=lines), imaged(MODEL, truth, rng, points=20).points


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


@pytest.mark.parametrize("points", [0, 12])
@pytest.mark.parametrize("criterion", [CheckRmse(), Press(), KFold(folds=40), KFold()])
def test_a_gene_switches_all_pieces(criterion: termsel.Criterion, points: int) -> None:
    features, check = scene(points)
    problem = SelectionProblem(Inputs(MODEL, features, check, 1000.0, criterion),
                               terms=False, features=True)
    assert problem.genome.size == points + 28
    genes = np.ones((3, problem.genome.size), dtype=bool)
    off = features.ids.index("l3")
    genes[1, off] = genes[2, -1] = False
    found = problem.evaluate(genes)
    assert (found.violation == 0).all()
    # The same without the feature at all, where nothing else depends on what is on offer.
    rest = features.take(genes[1])
    alone = SelectionProblem(Inputs(MODEL, rest, check, 1000.0, criterion),
                             terms=False, features=True)
    if criterion.options.get("folds", 40) == 40:
        expected = alone.evaluate(np.ones((1, alone.genome.size), dtype=bool)).objectives[0]
        np.testing.assert_allclose(found.objectives[1], expected, rtol=1e-9)
    assert "l3" not in problem.decode(genes[1]).features


def test_leaving_out_one_by_one_is_press() -> None:
    """With all of a feature's pieces left out, the figure is that of fits without it."""
    features, check = scene(4)
    problem = SelectionProblem(Inputs(MODEL, features, check, 1000.0, Press()),
                               terms=False, features=True)
    genes = np.ones((1, len(features)), dtype=bool)
    found = problem.evaluate(genes).objectives[0, 0]
    total, count = 0.0, 0
    equations = MODEL.equations(features)
    for i in range(len(features)):
        rest = equations.feature != i
        x = np.linalg.lstsq(equations.A[rest], equations.b[rest])[0]
        # The rows of a polynomial are the errors themselves, of points and of vertices.
        total += ((equations.A @ x - equations.b)[~rest] ** 2).sum()
        count += 1 if i < 4 else int((~rest).sum())
    assert found == pytest.approx(1000 * np.sqrt(total / count), rel=1e-9)


def test_result_of_a_run_with_pieces() -> None:
    features, check = scene()
    features = features.with_(points=Points(
        check.ids, check.image, check.ground,
        roles=("check", "independent") * 10))
    result = termsel.run("owdis-lines", features=features, model=Affine.name, generations=2,
                         options={"population": 20, "polish": False})
    assert result.data["counts"]["lines"] == 28
    kinds = [r.kind for r in result.residuals if r.id == "l3"]
    assert kinds == [f"vertex {i + 1}" for i in range(2 * PIECES)]
    used = {r.used for r in result.residuals if r.id == "l3"}
    assert used == {"l3" in result.selection.features}


def test_most_rows_the_features_can_give() -> None:
    features, check = scene()
    with pytest.raises(termsel.TermselError, match="gives 14 equations with 5 features at most"):
        SelectionProblem(Inputs(MODEL, features, check, 1.0, CheckRmse(), {"max_features": 5}),
                         terms=False, features=True)
