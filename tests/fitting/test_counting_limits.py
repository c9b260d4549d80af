"""Features, adjustments, models and fits where one more, one less or another order matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, stats

import termsel
from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import solve
from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.options import Option
from termsel.data.coordinates.places import distance_beyond_hull
from termsel.data.coordinates.plausible import check_ground
from termsel.data.features import FeatureSet, FloatArray, Lines, Points
from termsel.data.monomials import RPC00B, monomial_name
from termsel.data.roles import SPLITS, observations_by_role, observe
from termsel.data.rpc import Rpc
from termsel.data.scaling import make_scaling
from termsel.fitting.figures import restrict_to_control, term_significance
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.models.polynomial import Affine
from termsel.models.quotient import RationalFunctions, pole_violation


def points(n: int, prefix: str = "P", *, noise: float = 0.0, seed: int = 0,
           roles: tuple[str, ...] = ()) -> Points:
    """Points of an affine image of 400 x 400 px."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(0, 4, (n, 3))
    return Points(tuple(f"{prefix}{i}" for i in range(n)),
                  imaged(ground) + rng.normal(0, noise, (n, 2)) if noise else imaged(ground),
                  ground, None, roles)


def imaged(ground: FloatArray) -> FloatArray:
    x, y, z = np.moveaxis(ground, -1, 0)
    return np.stack([100 * y + 5 * x + z, 100 * x - 5 * y - 2 * z], axis=-1)


def lines(n: int, noise: float) -> Lines:
    rng = np.random.default_rng(7)
    ground = rng.uniform(0, 4, (n, 2, 3))
    return Lines(tuple(f"L{i}" for i in range(n)),
                 imaged(ground) + rng.normal(0, noise, (n, 2, 2)), ground)


def fitted(control: FeatureSet, used: np.ndarray | None = None) -> Fit:
    return LEAST_SQUARES.fit(Affine(), control, make_scaling(control), np.ones(8, dtype=bool),
                             np.ones(len(control), dtype=bool) if used is None else used)


def test_unknown_deviations_are_the_median_known_one() -> None:
    known = replace(points(3, "A"), sigma=np.array([[1.0, 1.0], [2.0, 3.0], [5.0, 9.0]]))
    both = known.join(points(2, "B", seed=1))
    assert both.sigma is not None
    np.testing.assert_array_equal(both.sigma[3:], np.full((2, 2), 2.5))


@pytest.mark.parametrize("how", ["file", "stratified", "random"])
def test_points_that_are_off_stay_off_however_roles_are_assigned(how: str) -> None:
    given = points(12, roles=("off", "control", "check", "independent") * 3)
    rng, named = np.random.default_rng(0), {one.name: one for one in SPLITS}
    seen = observe(FeatureSet(given), split=named.get(how), rng=rng)
    assert seen.off == ("P0", "P4", "P8")
    assert (seen.features.points.roles == given.roles) == (how == "file")


def test_distances_count_by_the_longer_side_of_the_control() -> None:
    control = np.array([(0.0, 0.0), (0.0, 40.0), (10.0, 0.0), (10.0, 40.0)])
    np.testing.assert_allclose(
        distance_beyond_hull(control, np.array([(20.0, 5.0), (5.0, 60.0)])), [0.25, 0.5])


def test_one_point_near_the_origin_of_a_projection_is_no_degree() -> None:
    ground = np.array([(100.0, 50.0, 0.0), (4e3, 4e3, 0.0), (5e3, 9e3, 0.0)])
    some = Points(("A", "B", "C"), np.arange(6.0).reshape(3, 2), ground)
    check_ground(FeatureSet(some, crs="EPSG:32639"))
    far = Points(("A", "B", "C"), some.image, [ground[0], (4e5, 4e6, 0), (4.1e5, 4.02e6, 0)])
    with pytest.raises(TermselError, match="1 of 3 points looks like degrees"):
        check_ground(FeatureSet(far, crs="EPSG:32639"))
    with pytest.raises(TermselError, match="look like degrees, but EPSG:32639 is a projected CRS"):
        check_ground(FeatureSet(some.take([0]), crs="EPSG:32639"))


def test_redundancy_counts_terms_also_where_they_are_not_determined() -> None:
    columns = np.random.default_rng(0).normal(size=(6, 3))
    columns[:, 2] = columns[:, 0]
    found = solve(Equations(columns, np.arange(6.0), np.arange(6)))
    assert (found.n_equations, found.n_terms, found.rank) == (6, 3, 2)
    assert (found.redundancy, found.violation) == (3, 1)


@pytest.mark.parametrize("seed", range(40))
def test_a_rank_that_is_not_full_is_that_of_qr_with_pivoting(seed: int) -> None:
    """Also of columns of very unlike lengths, of zeros, and of more columns than rows."""
    rng = np.random.default_rng(seed)
    rows, terms = (int(number) for number in rng.integers(2, 30, 2))
    rank = int(rng.integers(1, min(rows, terms) + 1))
    columns = (rng.normal(size=(rows, rank)) * 10.0 ** rng.uniform(-5.0, 0.0, rank)
               @ rng.normal(size=(rank, terms)))
    columns[:, rng.integers(0, terms)] = 0.0
    columns *= 10.0 ** rng.uniform(-3.0, 3.0, terms)
    found = solve(Equations(columns, rng.normal(size=rows), np.arange(rows)))
    lengths = np.linalg.norm(columns, axis=0)
    live = columns[:, lengths > 0.0] / lengths[lengths > 0.0]
    diagonal = np.abs(np.diag(linalg.qr(live, mode="r", pivoting=True)[0]))
    assert found.rank == (diagonal > 1e-8).sum()


def test_monomials_of_an_rpc_stand_in_the_order_of_rpc00b() -> None:
    assert " ".join(map(monomial_name, RPC00B)) == (
        "1 X Y Z XY XZ YZ X2 Y2 Z2 XYZ X3 XY2 XZ2 X2Y Y3 YZ2 X2Z Y2Z Z3")


@pytest.mark.parametrize(("slope", "violation"), [(0.95, 0.05), (0.91, 0.01), (0.89, 0.0)])
def test_the_least_denominator_of_all_places_counts(slope: float, violation: float) -> None:
    model = RationalFunctions(order=1)
    coefficients = np.zeros((1, len(model.terms)))
    coefficients[0, model.terms.index("line.den:X")] = slope
    ground = np.array([(-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    assert pole_violation(model, coefficients, ground) == pytest.approx(violation, abs=1e-12)


@pytest.mark.parametrize(("offset", "here", "beyond_it"), [
    (179.9, 180.05, -179.95), (-179.9, -180.05, 179.95)])
def test_an_rpc_goes_on_beyond_the_antimeridian(offset: float, here: float,
                                                beyond_it: float) -> None:
    one = (1.0,) + (0.0,) * 19
    rpc = Rpc((500.0, 500.0), (500.0, 500.0), (offset, 10.0, 0.0), (0.2, 0.2, 100.0),
              (0.0, 0.0, -1.0) + (0.0,) * 17, one, (0.0, 1.0) + (0.0,) * 18, one)
    there = rpc.project([[beyond_it, 10.1, 0.0]])
    np.testing.assert_allclose(there, rpc.project([[here, 10.1, 0.0]]), atol=1e-6)
    np.testing.assert_allclose(there[0], [250.0, 500 + 500 * (here - offset) / 0.2], atol=1e-6)


def test_lines_next_to_points_are_left_out_under_their_own_names() -> None:
    control = FeatureSet(points(9, noise=0.5), lines(8, 0.5))
    whole = fitted(control)
    assert whole.model.name == "affine"
    found = whole.leave_one_out
    for out in (0, 8, 9, 16):
        used = np.arange(len(control)) != out
        mine = [r for r in fitted(control, used).residuals if r.id == control.ids[out]]
        theirs = [r for r in found if r.id == control.ids[out]]
        assert len(mine) == (1 if out < 9 else 2)
        for one, other in zip(mine, theirs, strict=True):
            assert (one.line, one.sample) == pytest.approx((other.line, other.sample), rel=1e-6)


def test_the_box_of_an_image_has_lines_before_samples() -> None:
    control = FeatureSet(points(8), image_size=(100, 300))
    assert fitted(control).image_box() == ((0.0, 0.0), (99.0, 299.0))
    image = control.points.image
    assert fitted(replace(control, image_size=None)).image_box() == (
        tuple(image.min(axis=0)), tuple(image.max(axis=0)))


def test_a_fit_to_control_and_check_cannot_be_repeated_with_the_control_alone() -> None:
    observations = observations_by_role(
        FeatureSet(points(12, noise=0.5, roles=("control", "check") * 6)))
    shown = restrict_to_control(fitted(observations.together), observations)
    assert shown.control is observations.control
    with pytest.raises(TermselError, match="has given coefficients, so no feature can be"):
        shown.leave_one_out_rmse()
    own = fitted(observations.control)
    assert restrict_to_control(own, observations) is own


def test_significance_is_two_sided() -> None:
    found = termsel.fit(FeatureSet(points(20, noise=3.0)), "affine")
    freedom = found.adjustment.redundancy
    for one in term_significance(found).values():
        assert one.p == pytest.approx(2 * stats.t.sf(one.t, freedom), rel=1e-9)


@pytest.mark.parametrize(("text", "value"), [
    ("true", True), ("yes", True), ("on", True), ("1", True), (" True ", True), (True, True),
    ("false", False), ("no", False), ("off", False), ("0", False), ("FALSE", False),
    (False, False)])
def test_words_for_true_and_false(text: object, value: bool) -> None:
    assert Option("mixed", False, "", bool).parse(text) is value


@pytest.mark.parametrize("text", ["", "2", "y", "wahr"])
def test_other_words_are_neither(text: str) -> None:
    with pytest.raises(TermselError, match=r"option 'mixed' does not accept .* Accepted: true \| "):
        Option("mixed", False, "", bool).parse(text)


@pytest.mark.parametrize(("name", "near"), [
    ("RPB", "'rpb'?"), ("rpc", "'rpb' or 'rpc-txt' or 'rpc-vrt'?"), ("stac-items-v2", "'stac'?"),
    ("ply", "")])
def test_names_that_may_be_meant_stand_without_a_long_list(name: str, near: str) -> None:
    names = ["rpb", "rpc-txt", "rpc-vrt", "stac"]
    few = str(unknown_name_error("writer", name, names))
    guess = f"Did you mean {near} " if near else ""
    assert few == f"unknown writer {name!r}. {guess}Known: rpb, rpc-txt, rpc-vrt, stac."
    many = str(unknown_name_error("writer", name, [*names, *(f"{i:09d}" for i in range(30))]))
    assert ("Known: " in many) is not bool(near)


@pytest.mark.parametrize(("n", "end"), [(39, "n38."), (40, "n39."), (41, "n39 and 1 more."),
                                        (50, "n39 and 10 more.")])
def test_an_unknown_name_lists_forty_known_ones(n: int, end: str) -> None:
    error = unknown_name_error("thing", "zzz", [f"n{i:02d}" for i in range(n)])
    assert str(error).startswith("unknown thing 'zzz'. Known: n00, n01, ")
    assert str(error).endswith(f", {end}")
