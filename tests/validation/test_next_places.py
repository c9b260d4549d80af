"""Where to measure next: the ranking against brute force, and against really adding points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.data.features import FeatureSet, FloatArray, Points, empty_points
from termsel.fitting.fit import Fit
from termsel.fitting.next_places import MIN_DISTANCE, error_covariances, rank_places
from termsel.fitting.scene import scene_grid
from termsel.io.plan import GRID, plan
from termsel.simulate import scene_truth, simulate_scene
from termsel.simulate.catalogue import SCENES
from tests.formats.test_vertical_datum import camera, control, needs_rpc


def _fit(points: Points) -> Fit:
    return termsel.fit(FeatureSet(replace(points, roles=())), "regularised-cubic")


def _farthest(mine: FloatArray, places: FloatArray, count: int) -> list[int]:
    chosen: list[int] = []
    for _ in range(count):
        others = np.concatenate([mine, places[chosen]])
        away = np.linalg.norm(places[:, None] - others, axis=2).min(axis=1)
        chosen.append(int(np.argmax(away)))
    return chosen


def _after(name: str, seed: int) -> tuple[float, float, float]:
    """Return the true RMSE with 5 points more: planned, in the largest gaps, at random."""
    points = simulate_scene(name, seed=seed, n_points=150).points
    rng = np.random.default_rng(seed)
    order = rng.permutation(150)
    mine, spare, others = order[:10], order[10:60], order[60:]
    ground = points.ground[others]
    truth = scene_truth(name, seed=seed).sensor.project(ground)
    planned = rank_places(_fit(points.take(mine)), points.ground[spare], ground, 5).order
    gap = _farthest(points.image[mine], points.image[spare], 5)
    found = []
    for which in (planned, gap, rng.permutation(50)[:5]):
        wrong = _fit(points.take(np.concatenate([mine, spare[which]]))).project(ground) - truth
        found.append(float(np.log((wrong**2).sum(axis=1).mean()) / 2))
    return found[0], found[1], found[2]


@pytest.mark.slow
def test_planned_points_help_more_than_random_ones_and_those_in_the_largest_gaps() -> None:
    planned, gap, anywhere = np.array([_after(name, seed) for name in SCENES
                                       for seed in range(8)]).T
    assert planned.mean() < gap.mean() - 0.02
    assert planned.mean() < anywhere.mean() - 0.2


def test_greedy_choice_is_the_best_by_brute_force() -> None:
    points = simulate_scene("spot-isfahan", seed=3, n_points=40).points
    fitted = _fit(points.take(np.arange(12)))
    candidates, scene = points.ground[12:24], points.ground[24:]
    found = rank_places(fitted, candidates, scene, 3, min_distance=0.0)
    both = error_covariances(fitted, np.concatenate([candidates, scene]))
    assert both is not None
    assert both.factors is not None

    def mean_after(chosen: list[int]) -> float:
        """Return the mean variance, conditioned on all measurements at once."""
        flat = both.factors.reshape(-1, both.factors.shape[2])  # type: ignore[union-attr]
        everything = flat @ flat.T
        rows = [2 * i + axis for i in chosen for axis in (0, 1)]
        noise = np.diag([both.noise[axis] for _ in chosen for axis in (0, 1)])
        gain = everything[:, rows] @ np.linalg.solve(
            everything[np.ix_(rows, rows)] + noise, everything[rows])
        left = np.diag(everything - gain)[2 * len(candidates):]
        return float(left.sum() / len(scene))

    chosen: list[int] = []
    for step, best in enumerate(found.order):
        values = [np.inf if i in chosen else mean_after([*chosen, i]) for i in range(12)]
        assert best == int(np.argmin(values))
        chosen.append(int(best))
        assert found.sigma[step] == pytest.approx(
            np.sqrt(min(values)) * fitted.scaling.image_scale, rel=1e-6)
    assert found.sigma_before > found.sigma[0] > found.sigma[1] > found.sigma[2]


def test_a_model_of_lines_plans_by_its_own_adjustment() -> None:
    scene = simulate_scene("ikonos-hamedan", wrong_lines=0)
    fitted = termsel.fit(scene.with_(points=empty_points()), "affine")
    found = rank_places(fitted, scene.points.ground[:20], scene.points.ground, 3)
    assert len(set(found.order.tolist())) == 3
    assert (np.diff([found.sigma_before, *found.sigma]) < 0).all()


@pytest.mark.parametrize(("model", "count"), [("tps", 15), ("tps", 30), ("field", 24)])
def test_a_local_model_is_planned_by_its_own_sigma(model: str, count: int) -> None:
    points = simulate_scene("ikonos-hamedan", n_points=60).points
    if model == "tps":
        points = replace(points, ground=points.ground * [1.0, 1.0, np.nan])
    fitted = termsel.fit(
        FeatureSet(replace(points.take(np.arange(count)), roles=()), crs="EPSG:4979"), model)
    scene = points.ground[30:]
    found = rank_places(fitted, scene, scene, 5)
    assert found.sigma_before == pytest.approx(
        np.sqrt((fitted.sigma(scene)**2).sum(axis=1).mean()), rel=0.01)
    assert (np.diff([found.sigma_before, *found.sigma]) < 0).all()


def test_a_plan_of_many_points_in_a_plane_starts_from_sigma() -> None:
    rng = np.random.default_rng(5)
    places = rng.uniform(0.0, 2000.0, (400, 2))
    image = places[:, ::-1] / 2 + 20.0 * np.sin(places / 300.0) + rng.normal(0.0, 0.3, (400, 2))
    ground = np.column_stack([places, np.full(400, np.nan)])
    fitted = termsel.fit(FeatureSet(Points(tuple(map(str, range(400))), image, ground)), "poly2d")
    scene = ground[:60]
    found = rank_places(fitted, scene, scene, 2)
    assert found.sigma_before == pytest.approx(
        np.sqrt((fitted.sigma(scene)**2).sum(axis=1).mean()), rel=1e-6)
    assert (np.diff([found.sigma_before, *found.sigma]) < 0).all()


def test_without_redundancy_nothing_can_be_planned() -> None:
    points = simulate_scene("ikonos-hamedan", n_points=20).points
    fitted = termsel.fit(FeatureSet(replace(points.take(np.arange(4)), roles=())), "affine")
    with pytest.raises(termsel.TermselError, match="uncertainty of this model is not known"):
        rank_places(fitted, points.ground, points.ground, 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "r"
    termsel.run("rfm-terms", features=simulate_scene("irs1c-mashad", n_points=30), out=path)
    return path


def _termsel(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    return done.exit_code, done.stdout, done.stderr


def test_plan_on_a_grid_over_the_image(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "next.csv"
    code, out, err = _termsel("plan", folder, "-n", 4, "-o", table)
    assert code == 0
    assert len(out.splitlines()) == 5
    assert "px now" in err
    header, *rows = table.read_text().splitlines()[1:]
    assert header == "id,line,sample,x,y,z,uncertainty_px"
    values = np.array([[float(cell) for cell in row.split(",")[1:]] for row in rows])
    assert ((values[:, :2] >= 0) & (values[:, :2] < 4000)).all()
    assert (np.diff(values[:, 5]) < 0).all()
    result = termsel.read_result(folder).as_exported()
    np.testing.assert_allclose(result.project(values[:, 2:5]), values[:, :2], atol=1e-3)


@pytest.mark.slow
def test_unknown_heights_stay_unknown(tmp_path: Path) -> None:
    points = simulate_scene("irs1c-mashad", n_points=30).points
    ground = points.ground.copy()
    ground[:, 2] = np.nan
    termsel.run(features=FeatureSet(replace(points, ground=ground), crs="EPSG:4979"),
                out=tmp_path / "r")
    code, _, _ = _termsel("plan", tmp_path / "r", "-n", 2, "-o", tmp_path / "next.csv")
    assert code == 0
    rows = (tmp_path / "next.csv").read_text().splitlines()[2:]
    assert [row.split(",")[5] for row in rows] == ["", ""]


def test_plan_among_given_places(folder: Path, tmp_path: Path) -> None:
    places = simulate_scene("irs1c-mashad", seed=5, n_points=12).points
    table = tmp_path / "places.csv"
    table.write_text("id,x,y,z\n" + "".join(
        f"C{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(places.ground.tolist())))
    code, out, _ = _termsel("plan", folder, "--candidates", table, "-n", 50)
    assert code == 0
    rows = [line.split() for line in out.splitlines()[1:]]
    ids = [row[0] for row in rows]
    assert sorted(ids) == sorted(f"C{i}" for i in range(12))
    x, y, z = places.ground.max(axis=0).tolist()
    x += 0.5 * np.ptp(places.ground[:, 0])
    table.write_text(f"{table.read_text()}far,{x},{y},{z}\n")
    _, fewer, err = _termsel("plan", folder, "--candidates", table, "-n", 3)
    assert [line.split() for line in fewer.splitlines()[1:]] == rows[:3]
    assert "1 candidate left out, as the image does not show it: far." in err


@pytest.mark.parametrize(("text", "words"), [
    (None, "does not exist"), ("id,x,y\nA,1,2\n", "no column"),
    ("id,line,sample\nA,1,2\n", "image positions; ground positions x,y,z are needed"),
    ("id,x,y,z\nA,59.6,36.3,\n", "height is blank"),
    ("# crs: EPSG:32640\nid,x,y,z\nA,1,2,3\n", "declares the CRS")])
def test_bad_candidates_give_one_message(folder: Path, tmp_path: Path, text: str | None,
                                         words: str) -> None:
    table = tmp_path / "places.csv"
    if text is not None:
        table.write_text(text)
    code, _, err = _termsel("plan", folder, "--candidates", table)
    assert code == 2
    assert words in err


def test_a_table_is_not_replaced_unasked(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "next.csv"
    table.write_text("mine")
    assert _termsel("plan", folder, "-o", table)[0] == 2
    assert table.read_text() == "mine"
    assert _termsel("plan", folder, "-o", table, "--overwrite")[0] == 0


def test_plan_is_completed_and_listed() -> None:
    code, out, _ = _termsel("--help")
    assert code == 0
    assert "plan" in out


def _least_distance(image: FloatArray) -> float:
    apart = np.linalg.norm(image[:, None] - image, axis=2)
    return float(apart[np.triu_indices(len(image), 1)].min())


@pytest.mark.slow
def test_places_of_a_plan_keep_a_distance() -> None:
    closest = []
    for name, scene in SCENES.items():
        result = termsel.run("rfm-terms", features=simulate_scene(name, n_points=30))
        distance = MIN_DISTANCE * max(scene.image_size)
        assert _least_distance(plan(result, 8).values[:, :2]) >= 0.99 * distance
        grid = scene_grid(result.fit, GRID)[1]
        order = rank_places(result.fit, grid, grid, 8, min_distance=0.0).order
        closest.append(_least_distance(result.project(grid[order])) / distance)
    assert min(closest) < 0.9  # what it would be without


def test_of_candidates_that_are_close_together_one_is_proposed_first() -> None:
    points = simulate_scene("ikonos-hamedan", n_points=40).points
    fitted = _fit(points.take(np.arange(12)))
    alone = points.ground[12:20]
    best = rank_places(fitted, alone, points.ground, 3).order.tolist()
    twins = np.repeat(alone, 2, axis=0) + np.tile([[0.0, 0, 0], [1e-5, 0, 0]], (8, 1))  # a metre
    order = rank_places(fitted, twins, points.ground, 16).order
    assert [number // 2 for number in order[:3]] == best
    assert sorted(order.tolist()) == list(range(16))  # those that are close follow in the end


@needs_rpc
def test_a_plan_by_an_rpc_alone_says_that_the_size_is_not_known(
        caplog: pytest.LogCaptureFixture) -> None:
    features = control(4)
    wide = replace(camera(), image_scale=(4000.0, 4000.0),
                   line_numerator=(0.0, 0.0, -0.25, 0.05, *[0.0] * 16),
                   sample_numerator=(0.0, 0.25, *[0.0] * 18))
    places = plan(termsel.run(features=replace(features, rpc=wide)), 3)
    assert "the size of the image is not known" in caplog.text
    assert (places.values[:, :2] >= 0).all()
    assert (places.values[:, :2] <= 2 * 1000.0).all()
    caplog.clear()
    plan(termsel.run(features=replace(features, image_size=(2000, 2000))), 1)
    assert "not known" not in caplog.text
