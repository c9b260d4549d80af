"""A vendor's RPC and one point or more: the candidates of the strategy auto."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_rpc", reason="termsel-rpc is not installed: "
                    "pip install -e plugins/termsel-rpc")


import termsel
from termsel import FeatureSet, Points, Result, Rpc, read_rpc
from termsel.testing import checks, invoke
from termsel.toolkit import rpc_txt_text
from termsel.toolkit.files import rpb_text, rpc_items
from termsel_rpc.belief import CORRECTION_KINDS, Belief, correction_grid
from termsel_rpc.correction import CORRECTIONS
from termsel_rpc.jitter import CANDIDATE as JITTERED
from termsel_rpc.local import CANDIDATE as LOCAL
from termsel_rpc.simulated import RPC_FILE

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")

FloatArray = NDArray[np.float64]

BIAS = np.array([[12.0, -7.0], [2.0, 3.0], [-1.0, 1.5]])
"""Of 1, line and sample, at the edge of the image [px]."""


@pytest.fixture(scope="module")
def data_folder() -> Path:
    """Real data that are not part of the project; tests that need them are skipped without."""
    here = Path(__file__).resolve()
    folder = Path(os.environ.get("TERMSEL_DATA", here.parents[4] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real data are not here; set TERMSEL_DATA to their folder")
    return folder


def scene(n: int, width: int = 1, *, rpc: Rpc | None = None, seed: int = 0, noise: float = 0.3,
          role: str = "") -> FeatureSet:
    """Return points of an image whose RPC has an error of so many of the columns of BIAS."""
    rpc = rpc or read_rpc(RPC_FILE)
    rng = np.random.default_rng(seed)
    share = rng.uniform(-0.8, 0.8, (n, 3))
    ground = rpc.locate(share[:, :2] * rpc.image_scale + rpc.image_offset,
                        share[:, 2] * rpc.ground_scale[2] + rpc.ground_offset[2])
    image = wrong(rpc, ground, width) + rng.normal(0, noise, (n, 2))
    return FeatureSet(Points(tuple(f"{role}{i}" for i in range(n)), image, ground,
                             roles=(role,) * n), crs="EPSG:4979", rpc=rpc)


def wrong(rpc: Rpc, ground: FloatArray, width: int) -> FloatArray:
    """Return where places are, which the RPC sees elsewhere."""
    seen = rpc.project(ground)
    unit = (seen - rpc.image_offset) / rpc.image_scale
    columns = np.column_stack([np.ones(len(unit)), unit])
    return np.asarray(seen + columns[:, :width] @ BIAS[:width])


@pytest.mark.parametrize(("model", "width"),
                         [("rpc-shift", 1), ("rpc-drift", 2), ("rpc-affine", 3)])
def test_sigma_of_a_correction_is_true_beyond_its_points(model: str, width: int) -> None:
    # A free polynomial predicts some of these points a little better, and by chance. It knows
    # nothing of the rest of the image, where it said 20 px; nor does the trend of a misfit, which
    # said 5 px.
    rpc = read_rpc(RPC_FILE)
    steps = np.linspace(-1, 1, 5)
    places = np.stack([axis.ravel() for axis in np.meshgrid(steps, steps)], axis=1)
    ground = rpc.locate(places * rpc.image_scale + rpc.image_offset,
                        np.full(len(places), rpc.ground_offset[2]))
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        share = rng.uniform(-1, 1, (40, 3)) * [0.3, 0.3, 0.5] - [0.5, 0.5, 0]
        seen = rpc.locate(share[:, :2] * rpc.image_scale + rpc.image_offset,
                          share[:, 2] * rpc.ground_scale[2] + rpc.ground_offset[2])
        points = Points(tuple(map(str, range(40))), wrong(rpc, seen, width)
                        + rng.normal(0, 0.3, (40, 2)), seen, sigma=np.full((40, 2), 0.3))
        fitted = termsel.fit(FeatureSet(points, crs="EPSG:4979"), model, rpc=str(RPC_FILE))
        away = fitted.project(ground) - wrong(rpc, ground, width)
        sigma = fitted.sigma(ground)
        assert sigma.max() < 1.5
        ratios.append((away / sigma)**2)
    # No RPC is without a misfit of some hundredths of a pixel, which sigma counts; here there is
    # none, and it would be most of the little that is left of the errors of a shift.
    assert 0.1 < np.mean(ratios) < 2.5


def test_jitter_is_a_candidate_that_keeps_the_rules_and_finds_it() -> None:
    def shaken(n: int, seed: int) -> FeatureSet:
        features = scene(n, 2, seed=seed)
        rpc = features.rpc
        assert isinstance(rpc, Rpc)
        unit = (rpc.project(features.points.ground)[:, :1] - rpc.image_offset[0]) \
            / rpc.image_scale[0]
        image = features.points.image + np.sin(8 * unit + [0, 1]) * [2, 1.5]
        return replace(features, points=replace(features.points, image=image))

    for check in checks(JITTERED, features=[scene(3), shaken(120, 0)]):
        check.run()
    others = shaken(200, 1)
    for features, most in ((shaken(120, 0), 0.65), (scene(120, 2), 3.5)):
        fitted = termsel.fit(features, "rpc-jittered")
        away = fitted.project(others.points.ground) - others.points.image
        assert np.sqrt((away**2).sum(axis=1).mean()) < most
    assert fitted.model.options["intervals"] == 2  # no more where there is no jitter
    assert "over 2 intervals" in JITTERED.describe(fitted)
    with pytest.raises(termsel.TermselError, match="no RPC is given"):
        termsel.fit(replace(others, rpc=None), "rpc-jittered")


def bumpy(n: int, seed: int, noise: float = 0.3) -> FeatureSet:
    """Return points of an image whose RPC has errors that are local, of some 6 px."""
    features = scene(n, 3, seed=seed, noise=noise)
    rpc = features.rpc
    assert isinstance(rpc, Rpc)
    line, sample = ((rpc.project(features.points.ground) - rpc.image_offset) / rpc.image_scale).T
    image = features.points.image + 6 * np.column_stack(
        [np.sin(4 * line) * np.cos(3 * sample), np.cos(5 * sample + 1) * np.sin(2 * line)])
    return replace(features, points=replace(features.points, image=image))


@pytest.mark.slow
def test_local_errors_of_an_rpc_call_for_a_random_field(tmp_path: Path) -> None:
    for check in checks(LOCAL, features=[scene(3), scene(30, 2), bumpy(40, 0)]):
        check.run()
    features, others = bumpy(30, 0), bumpy(200, 1, noise=0.0)

    def missed(fitted: termsel.Fit) -> float:
        away = fitted.project(others.points.ground) - others.points.image
        return float(np.sqrt((away**2).sum(axis=1).mean()))

    fitted = termsel.fit(features, "rpc-with-field")
    assert missed(fitted) < 0.6 * missed(termsel.fit(features, "rpc"))
    sigma = np.sqrt((fitted.sigma(others.points.ground)**2).sum(axis=1).mean())
    assert 0.5 < missed(fitted) / sigma < 2
    result = termsel.run(features=features, out=tmp_path / "r")
    assert result.strategy is not None
    assert result.strategy.chosen == "rpc-with-field"
    assert "The points show local deformation" in result.summary()
    again = termsel.read_result(tmp_path / "r").fit.project(others.points.ground)
    np.testing.assert_allclose(again, result.fit.project(others.points.ground), atol=1e-6)


def test_a_field_is_not_laid_over_an_rpc_that_needs_none() -> None:
    for features in (scene(30, 3), scene(5)):
        with pytest.raises(termsel.TermselError):
            termsel.fit(features, "rpc-with-field")
    with pytest.raises(termsel.TermselError, match="no RPC is given"):
        termsel.fit(replace(bumpy(30, 0), rpc=None), "rpc-with-field")


def off(result: Result, features: FeatureSet, width: int) -> float:
    """Return by how much places all over the image are missed, root mean square [px]."""
    others = scene(200, seed=1, rpc=features.rpc)
    true = wrong(features.rpc, others.points.ground, width)  # type: ignore[arg-type]
    away = result.fit.project(others.points.ground) - true
    return float(np.sqrt((away**2).sum(axis=1).mean()))


@pytest.mark.parametrize("candidate", CORRECTIONS, ids=lambda one: one.name)
def test_every_candidate_keeps_the_rules(candidate: termsel.Method) -> None:
    for check in checks(candidate, features=[scene(6, 3), scene(2), scene(30, 2)]):
        check.run()


def test_errors_without_each_are_those_of_the_rest() -> None:
    rng = np.random.default_rng(0)
    rows, right = rng.normal(size=(10, 6)), rng.normal(size=10)
    feature = np.repeat(np.arange(5), 2)
    whole = Belief(rows, right, feature, correction_grid(range(len(CORRECTION_KINDS))))
    errors, density = whole.without_each
    rest = Belief(rows[2:], right[2:], feature[2:] - 1, whole.grid)
    np.testing.assert_allclose(errors[:2], right[:2] - rows[:2] @ rest.coefficients, atol=1e-6)
    assert density[0] == pytest.approx(whole.log - rest.log, abs=1e-6)


@pytest.mark.slow_cases("12-3-0.6")
@pytest.mark.parametrize(("n", "width", "allowed"), [
    (1, 1, 3.0), (2, 1, 1.0), (4, 1, 0.6), (6, 2, 0.8), (12, 3, 0.6)])
def test_the_error_of_an_rpc_is_found(n: int, width: int, allowed: float) -> None:
    features = scene(n, width)
    result = termsel.run(features=features)
    assert result.strategy.chosen == "rpc"  # type: ignore[union-attr]
    assert off(result, features, width) < allowed


@pytest.mark.filterwarnings("ignore:.*far outside the control")
def test_scatter_of_rough_points_is_no_affine_error() -> None:
    # Three points with a noise of 5 px: an affine correction fits them exactly.
    ratios = []
    within = []
    for seed in range(16):
        features = scene(3, 1, seed=seed, noise=5.0)
        places = scene(60, 1, seed=100 + seed, noise=0.0).points
        fitted = CORRECTIONS[0].fit(termsel.FitData.of(features))
        errors = fitted.project(places.ground) - places.image
        assert features.rpc is not None
        noise = features.points.image - wrong(features.rpc, features.points.ground, 1)
        # A shift by the points is off by their mean noise.
        ratios.append(np.sqrt((errors**2).sum(axis=1).mean()) / np.linalg.norm(noise.mean(axis=0)))
        within.append((np.abs(errors) < 1.645 * fitted.sigma(places.ground)).mean())
    assert np.median(ratios) < 1.2
    assert np.mean(within) > 0.75


def test_a_good_rpc_stays_as_it_is() -> None:
    features = scene(2, 0)
    result = termsel.run(features=features)
    assert off(result, features, 0) < 0.3
    assert "support no correction" in result.strategy.reason  # type: ignore[union-attr]


def test_what_is_not_known_at_the_corners_is_said_and_true() -> None:
    """One point says nothing of a drift; four do."""
    corner = read_rpc(RPC_FILE).ground_offset + 0.8 * np.array(read_rpc(RPC_FILE).ground_scale)
    one, four = (termsel.run(features=scene(n)).fit.sigma(corner[None]).max() for n in (1, 4))
    assert one > 3.0
    assert four < 1.5


def test_a_result_keeps_the_rpc(tmp_path: Path) -> None:
    features = scene(3)
    result = termsel.run(features=features, out=tmp_path / "r")
    again = termsel.read_result(tmp_path / "r")
    assert again.features.rpc == features.rpc
    np.testing.assert_allclose(again.fit.sigma(features.points.ground),
                               result.fit.sigma(features.points.ground))
    assert again.summary() == result.summary()
    changed = (tmp_path / "r" / "result.json").read_text().replace('"image_scale"', '"image_size"')
    (tmp_path / "r" / "result.json").write_text(changed)
    with pytest.raises(termsel.TermselError, match=r"damaged|changed"):
        termsel.read_result(tmp_path / "r")


@pytest.mark.slow_cases("8-rpc_IKONOS.txt", "8-rpc_WV3.xml")
@pytest.mark.parametrize("vendor", ["rpc_IKONOS.txt", "rpc_WV3.xml", "rpc_PLANET_L1B.txt"])
@pytest.mark.parametrize("n", [1, 8])
def test_an_exported_rpc_has_the_correction_through_gdal(
        n: int, vendor: str, data_folder: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import RPCTransformer

    features = scene(n, 3, rpc=read_rpc(data_folder / "rpc" / "original" / vendor))
    result = termsel.run(features=features)
    with rasterio.open(tmp_path / "scene.tif", "w", driver="GTiff", width=1, height=1, count=1,
                       dtype="uint8"):
        pass
    termsel.export(result, "rpb", tmp_path / "scene.RPB")
    others = scene(100, seed=2, rpc=features.rpc).points.ground
    with rasterio.open(tmp_path / "scene.tif") as raster, \
            RPCTransformer(raster.rpcs) as transformer:
        rows, columns = transformer.rowcol(*others.T, op=np.asarray)
    away = np.column_stack([rows, columns]) - 0.5 - result.fit.project(others)
    assert np.abs(away).max() < 0.05


@pytest.mark.slow
def test_one_blunder_among_five_is_named() -> None:
    for seed in range(5):
        features = scene(5, 2, seed=seed)
        points = features.points
        image = points.image.copy()
        image[seed] += [15.0, -20.0]
        result = termsel.run(features=features.with_(points=replace(points, image=image)))
        assert [one.id for one in result.outliers] == [str(seed)]
        assert result.outliers[0].excluded


def test_an_rpc_of_another_place_is_named_and_not_used(data_folder: Path) -> None:
    other = read_rpc(data_folder / "rpc" / "original" / "rpc_WV3.xml")
    result = termsel.run(features=replace(scene(5), rpc=other))
    assert not result.strategy.chosen.startswith("rpc")  # type: ignore[union-attr]
    assert any("The RPC is not used: rpc_WV3.xml is of another place (" in note
               for note in result.notes)
    with pytest.raises(termsel.TermselError, match=r"one point is not enough.*another place"):
        termsel.run(features=replace(scene(1), rpc=other))


def test_an_rpc_of_another_image_of_the_place_is_named() -> None:
    rpc = read_rpc(RPC_FILE)
    line, sample = rpc.image_offset
    lines, samples = rpc.image_scale
    far = replace(rpc, image_offset=(line + 9000.0, sample), image_scale=(-lines, -samples))
    result = termsel.run(features=replace(scene(5), rpc=far))
    assert any("more than half of its image" in note for note in result.notes)


def bent_far(shift: float) -> FeatureSet:
    """Points of an image that no correction of its RPC explains, and that begins elsewhere."""
    features = scene(40, 1)
    points = features.points
    bent = points.image + 900 * ((points.image[:, :1] - 3500) / 3500) ** 2 + shift
    return features.with_(points=replace(points, image=bent))


@pytest.mark.parametrize(("shift", "is_doubted"), [(0.0, False), (3000.0, True)])
def test_an_rpc_that_is_not_used_is_told_with_its_distance(shift: float, is_doubted: bool) -> None:
    features = bent_far(shift)
    assert features.rpc is not None
    off = features.points.image - features.rpc.project(features.points.ground)
    line, sample = np.median(off, axis=0)
    notes = termsel.run(features=features).notes
    note = next(note for note in notes if note.startswith("The RPC is not used"))
    assert f"(median: {line:+,.0f} px in line, {sample:+,.0f} px in sample)" in note
    assert ("is it of another image" in note) == is_doubted
    assert ("by more than chance explains" in note) != is_doubted


def test_an_rpc_that_does_not_fit_what_a_polynomial_fits_is_at_fault(tmp_path: Path) -> None:
    termsel.write_points_csv(bent_far(3000.0).points, tmp_path / "p.csv", crs="EPSG:4979")
    (tmp_path / "a.RPB").write_text(rpb_text(read_rpc(RPC_FILE)))
    _, text = command("run", "--points", tmp_path / "p.csv", "--rpc", tmp_path / "a.RPB",
                      "--model", "rpc-shift", "--out", tmp_path / "r")
    screen = " ".join(text.split())
    assert "not detectable: the RPC does not fit these points, which a" in screen
    assert "columns, the units" not in screen
    assert "Next: give the RPC of this image, or leave it out" in screen
    assert " as small" in screen


@pytest.mark.parametrize(("change", "said"), [
    ({"crs": "local"}, "without a CRS"), ({"height": np.nan}, "needs ellipsoidal heights")])
def test_points_that_cannot_correct_it_are_named(change: dict[str, object], said: str) -> None:
    features = scene(5)
    if "crs" in change:
        features = replace(features, crs="local")
    else:
        ground = features.points.ground.copy()
        ground[:, 2] = np.nan
        features = features.with_(points=replace(features.points, ground=ground))
    result = termsel.run(features=features)
    assert any("The RPC is not used" in note and said in note for note in result.notes)


@pytest.mark.slow
def test_clearly_better_points_are_preferred_to_an_rpc() -> None:
    """Of an image that was resampled after its RPC was made."""
    features = scene(40, 1)
    points = features.points
    bent = points.image + 60 * ((points.image[:, :1] - 3500) / 3500) ** 2
    result = termsel.run(features=features.with_(points=replace(points, image=bent)))
    assert result.strategy.chosen != "rpc"  # type: ignore[union-attr]
    assert "corrected RPC" in result.strategy.reason  # type: ignore[union-attr]


def command(*words: object) -> tuple[int, str]:
    found = invoke(*map(str, words))
    return found.exit_code, found.output


def test_an_rpc_in_any_form_gives_the_same(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    features, rpc = scene(1), read_rpc(RPC_FILE)
    termsel.write_points_csv(features.points, tmp_path / "p.csv", crs="EPSG:4979")
    (tmp_path / "a.RPB").write_text(rpb_text(rpc))
    (tmp_path / "a_RPC.TXT").write_text(rpc_txt_text(rpc))
    shape = {"driver": "GTiff", "width": 8000, "height": 8000, "count": 1, "dtype": "uint8",
             "sparse_ok": True}
    with rasterio.open(tmp_path / "tags.tif", "w", **shape) as raster:
        raster.rpcs = rasterio.rpc.RPC.from_gdal(rpc_items(rpc))
    with rasterio.open(tmp_path / "a.tif", "w", **shape):
        pass
    found = []
    for name, file in (("--rpc", "a.RPB"), ("--rpc", "a_RPC.TXT"), ("--image", "tags.tif"),
                       ("--image", "a.tif")):
        code, text = command("run", "--points", tmp_path / "p.csv", name, tmp_path / file,
                             "--quiet", "--json")
        assert code == 0, text
        found.append(list(json.loads(text)["coefficients"].values()))
    np.testing.assert_allclose(found, [found[0]] * 4, rtol=1e-6)


@pytest.mark.parametrize(("words", "said"), [
    (["--problem", "rpc-gcps"], "one point or more corrects it"),
    (["--model", "rpc-shift", "--solver", "ga"], "one point or more corrects it"),
    (["--problem", "rpc-gcps", "--strategy", "auto"], "add --rpc FILE")])
def test_what_needs_more_points_says_which_command_does(
        words: list[str], said: str, tmp_path: Path) -> None:
    termsel.write_points_csv(scene(4).points, tmp_path / "p.csv", crs="EPSG:4979")
    code, text = command("run", "--points", tmp_path / "p.csv", "--rpc", RPC_FILE, *words)
    assert code == 2
    assert said in text


def test_models_that_refine_an_rpc_take_that_of_the_features() -> None:
    features = scene(40)
    result = termsel.run(features=features, model="rpc-shift", generations=2)
    assert result.rmse["control"].total < 1.0  # type: ignore[union-attr]


def test_a_study_has_a_column_of_rpcs(tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 1)):
        termsel.write_points_csv(scene(3, seed=seed).points, tmp_path / f"{name}.csv",
                                 crs="EPSG:4979")
        (tmp_path / f"{name}.RPB").write_text(rpb_text(read_rpc(RPC_FILE)))
    (tmp_path / "study.toml").write_text('[[data]]\npoints = "*.csv"\nrpc = "*.RPB"\n')
    study = termsel.compare(tmp_path / "study.toml", out=tmp_path / "out", workers=1)
    assert [row["state"] for row in study.rows] == ["done"] * 2
    assert {row["chosen"] for row in study.rows} == {"rpc"}


@pytest.mark.parametrize("role", range(4))
def test_an_rpc_names_a_wrong_independent_point(role: int) -> None:
    """A single independent point is no witness against itself; the RPC knows that it is wrong."""
    features = scene(4)
    image = features.points.image.copy()
    image[1] += [80.0, -60.0]
    roles = ["control"] * 4
    roles[role] = "independent"
    result = termsel.run(features=replace(
        features, points=replace(features.points, image=image, roles=tuple(roles))))
    assert [one.id for one in result.outliers] == [features.points.ids[1]]
    opening = result.summary().partition("How accurate")[0]
    assert "none found" not in opening
    right = termsel.run(features=replace(
        features, points=replace(features.points, roles=tuple(roles))))
    assert not right.outliers
