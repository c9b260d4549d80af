"""Control lines in an adjustment: weights, and the least squares of distances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from termsel import TermselError, prepare, simulate_scene
from termsel.adjustment.equations import approximate_image, line_normals, row_weights
from termsel.data.features import FeatureSet, Lines, Points, empty_points
from termsel.data.scaling import make_scaling
from termsel.fitting.least_squares import fit
from termsel.models.quotient import RationalFunctions


def lines_of_a_scene(n: int) -> FeatureSet:
    """The first lines of the embedded scene that are not wrong by a quadratic, in [-1, 1]."""
    task = prepare("owdis-lines")
    whole = fit(task.model, task.observations.control, task.scaling)
    good = np.abs(whole.line_errors()).sum(axis=2).max(axis=1) < 3.0
    features = task.observations.control.take(good)
    return task.scaling.features(features.take(np.arange(len(features)) < n))


def test_a_line_given_in_both_directions_is_one_line() -> None:
    ground = np.array([[[0.0, 0.0, 1.0], [5.0, 1.0, 2.0]], [[0.0, 1.0, 1.0], [5.0, 1.0, 2.0]]])
    assert len(Lines(("A", "B"), ground[..., :2], ground)) == 2
    ground[1] = ground[0, ::-1]
    with pytest.raises(TermselError, match="lines 'A' and 'B' have the same ground vertices"):
        Lines(("A", "B"), ground[..., :2], ground)


def test_weights_by_hand() -> None:
    # An image that is the ground: vertices at the ends and in the middle of their lines.
    rng = np.random.default_rng(0)
    ground = rng.uniform(-1, 1, (30, 3)) * (1, 1, 0)
    points = Points(tuple(f"p{i}" for i in range(30)), ground[:, :2], ground,
                    np.full((30, 2), 2.0))
    lines = Lines(("a", "b"), [[[0, 0], [0.2, 0]], [[0, 0.4], [0.3, 0]]],
                  [[[0, 0, 0], [0.1, 0, 0]], [[-0.15, 0.6, 0], [0.45, -0.2, 0]]], (1.0, 4.0))
    weights = row_weights(FeatureSet(points, lines))
    # Given are 60 times 2.0, 1.0 and 4.0; their median is 2.0.
    assert weights[:60] == pytest.approx(1.0)
    # Line a: an end weighs like a coordinate, the middle root 2 of it; sigma is half the median.
    assert weights[60:62] == pytest.approx([2.0, 2.0 * np.sqrt(2.0)])
    # Line b: both vertices a whole length from the middle.
    assert weights[62:] == pytest.approx(0.5 / np.sqrt(0.5 + 2.0))


def test_without_deviations_a_point_weighs_one() -> None:
    features = FeatureSet(Points(("p", "q", "r"), [[0, 0], [0, 1], [1, 0]],
                                 [[0, 0, 0], [0, 1, 0], [1, 0, 0]]))
    assert (row_weights(features) == 1.0).all()


@pytest.mark.parametrize(("order", "ridge"), [(1, 0.0), (2, 0.0), (1, 0.01)])
def test_a_fit_to_lines_is_the_least_squares_of_distances(order: int, ridge: float) -> None:
    features = lines_of_a_scene(100)
    model = RationalFunctions(order=order, ridge=ridge)
    below = np.array([".den" in name for name in model.terms])
    terms = np.array([not name.endswith(("XY", "XZ", "YZ", "X2", "Z2")) or ".num" in name
                      for name in model.terms])
    found = fit(model, features, make_scaling(features), terms)
    scaled = found.scaling.features(features)
    normal, rho = (np.repeat(one, 2, axis=0) for one in line_normals(scaled.lines))
    weight = row_weights(scaled)

    def distances(x: np.ndarray) -> np.ndarray:
        coefficients = np.zeros(len(terms))
        coefficients[terms] = x
        image = model.project(coefficients, scaled.lines.ground.reshape(-1, 3))
        return np.concatenate([weight * (rho - np.einsum("na,na->n", normal, image)),
                               np.sqrt(ridge) * coefficients[below]])

    x = found.adjustment.coefficients[terms]
    best = least_squares(distances, x, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    # Nothing is left to gain, and the search of another algorithm ends at the same place.
    assert (distances(x) ** 2).sum() == pytest.approx(2 * best.cost, rel=1e-6)
    first = model.equations(scaled)
    start = np.linalg.lstsq(first.A[:, terms], first.b, rcond=None)[0]
    assert (distances(x) ** 2).sum() <= (distances(start) ** 2).sum()


def test_a_shared_denominator_keeps_off_zero_in_the_scene() -> None:
    """With a term for every other line, noise alone would let it grow to a pole."""
    scene = simulate_scene("ikonos-hamedan", n_points=74, n_lines=120, wrong_lines=0, seed=3)
    control = scene.with_(points=empty_points())
    scaling = make_scaling(control)
    held, free, plain = (fit(RationalFunctions(order=3, **options), control, scaling)
                         for options in ({"denominators": "shared"},
                                         {"denominators": "shared", "ridge": 0.0},
                                         {"denominators": "none"}))
    ground = scaling.features(control).ground_vertices()
    below = held.model.denominators(held.adjustment.coefficients, ground)
    assert below is not None
    assert np.abs(below - 1).max() < 0.1
    # More terms can only come nearer to the lines.
    assert held.control_rmse().total < plain.control_rmse().total  # type: ignore[union-attr]
    assert free.control_rmse().total > 2 * plain.control_rmse().total  # type: ignore[union-attr]


def test_what_the_control_determines_stays_determined_when_iterated() -> None:
    # With blunders among them the iteration heads for a pole, where its equations degenerate.
    task = prepare("owdis-lines-terms")
    control, scaling = task.observations.control, task.scaling
    first = fit(task.model, control, scaling, iterated=False)
    last = fit(task.model, control, scaling)
    assert first.adjustment.feasible
    assert last.adjustment.feasible
    assert last.control_rmse().total <= first.control_rmse().total


def test_vertices_are_placed_with_heights_or_without() -> None:
    features = lines_of_a_scene(40)
    both = [approximate_image(features, heights=heights) for heights in (True, False, True, False)]
    assert np.abs(both[0] - both[1]).max() > 1e-4
    for one, again in zip(both[:2], both[2:], strict=True):
        np.testing.assert_array_equal(one, again)
        assert not one.flags.writeable  # all who ask share it
    other = approximate_image(lines_of_a_scene(40), heights=False)
    np.testing.assert_allclose(other, both[1], rtol=1e-12)
