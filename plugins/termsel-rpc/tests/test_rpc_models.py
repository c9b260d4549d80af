"""The models of termsel-rpc, as installed."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_rpc", reason="termsel-rpc is not installed: "
                    "pip install -e plugins/termsel-rpc")

import termsel
from termsel import (
    FeatureSet,
    Fit,
    LeastSquares,
    Lines,
    Points,
    Rpc,
    Scaling,
    SensorModel,
    TermselError,
    read_rpc,
    rpc_of,
)
from termsel.simulate import read_geometry, scene_truth, write_geometry
from termsel.testing import Check, checks
from termsel.toolkit import make_scaling, registry
from termsel.toolkit.files import rpb_text
from termsel_rpc import Ce90, PushbroomRefine, RpcAffine, RpcDrift, RpcField, RpcJitter, RpcShift
from termsel_rpc.simulated import (
    DATASET_NAME,
    PITCH,
    ROLL,
    ROLL_DRIFT,
    RPC_FILE,
    SCENE,
    YAW,
    nominal_sensor,
)

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")

FloatArray = NDArray[np.float64]

MODELS = ("rpc-shift", "rpc-drift", "rpc-affine", "pushbroom-refine")
COLUMNS = {"rpc-shift": 1, "rpc-drift": 2, "rpc-affine": 3}
VENDORS = ("rpc_IKONOS.txt", "md_dg.RPB", "rpc_PLEIADES.xml", "rpc_WV3.xml",
           "md_kompsat.rpc", "md_ov_rpc.txt", "rpc_PLANET_L1A.txt")

AROUND_RPC = (Scaling((48.5, 34.8, 1850.0), (0.02, 0.016, 80.0), (3500.0, 4000.0), 8000.0),
              "EPSG:4979")
IN_UTM = (Scaling((271300.0, 3854000.0, 1850.0), (2000.0, 2000.0, 80.0), (3500.0, 4000.0), 8000.0),
          "EPSG:32639")
TURNS = {"translation": "turning the camera does not just shift the image"}


@pytest.fixture(scope="module")
def data_folder() -> Path:
    """Real data that are not part of the project; tests that need them are skipped without."""
    here = Path(__file__).resolve()
    folder = Path(os.environ.get("TERMSEL_DATA", here.parents[4] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real data are not here; set TERMSEL_DATA to their folder")
    return folder


def suites() -> dict[str, tuple[Check, ...]]:
    of = {"rpc": DATASET_NAME}
    found = {model.name: checks(model, options=[of], place=AROUND_RPC)
             for model in (RpcShift, RpcDrift, RpcAffine)}
    found["rpc-jitter"] = checks(RpcJitter, options=[{**of, "intervals": 2}, {
        **of, "intervals": 2, "across": True}], place=AROUND_RPC)
    found["rpc-field"] = checks(RpcField, options=[of], place=AROUND_RPC)
    found["rpc-affine of ends"] = checks(
        RpcAffine, options=[{**of, "line_form": "parametric"}], place=AROUND_RPC)
    found["rpc-affine in UTM"] = checks(RpcAffine, options=[of], place=IN_UTM)
    found["pushbroom-refine"] = checks(
        PushbroomRefine, options=[{"geometry": DATASET_NAME, "biases": biases}
                                  for biases in ("attitude", "position")],
        place=AROUND_RPC, expected_failures=TURNS)
    found["ce90"] = checks(Ce90())
    return found


@pytest.mark.slow_cases("pushbroom-refine-fit")
@pytest.mark.parametrize("check", [pytest.param(check, id=f"{name}-{check.name}")
                                   for name, listed in suites().items() for check in listed])
def test_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize(("kind", "name"), [
    *(("models", name) for name in MODELS), ("criteria", "ce90"), ("problems", "rpc-gcps"),
    ("datasets", DATASET_NAME)])
def test_is_registered_under_its_name(kind: str, name: str) -> None:
    entry = next(e for e in registry().entries(kind) if e.name == name)
    assert entry.provided_by == "termsel-rpc"
    assert not registry().failures(kind)


# Refinement of vendors' RPCs, compared with GDAL and plain least squares


def by_gdal(rpc: Rpc, ground: FloatArray, folder: Path) -> FloatArray:
    """Return line and sample by GDAL, counted as in termsel."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import RPCTransformer

    with rasterio.open(folder / "scene.tif", "w", driver="GTiff", width=1, height=1, count=1,
                       dtype="uint8"):
        pass
    (folder / "scene.RPB").write_text(rpb_text(rpc))
    with rasterio.open(folder / "scene.tif") as raster, \
            RPCTransformer(raster.rpcs) as transformer:
        rows, columns = transformer.rowcol(*ground.T, op=np.asarray)
    return np.column_stack([rows, columns]) - 0.5


def ground_of(rpc: Rpc, n: int, seed: int = 0) -> FloatArray:
    share = np.random.default_rng(seed).uniform(-0.8, 0.8, (n, 3))
    if rpc.ground_scale[0] == 1:  # far beyond the image
        share *= 0.005
    return np.asarray(share * rpc.ground_scale + rpc.ground_offset)


def polynomial(image: FloatArray, width: int) -> FloatArray:
    return np.column_stack([np.ones(len(image)), image])[:, :width]


BIAS = np.array([[12.5, -20.25], [3e-4, -2e-4], [1e-4, 5e-4]])
"""Of line and sample: constant [px], by line, by sample."""


@pytest.mark.parametrize("vendor", VENDORS)
@pytest.mark.parametrize("name", COLUMNS)
def test_fit_is_that_of_least_squares_on_what_gdal_projects(
        name: str, vendor: str, data_folder: Path, tmp_path: Path) -> None:
    file = data_folder / "rpc" / "original" / vendor
    rpc = read_rpc(file)
    ground, others = ground_of(rpc, 20), ground_of(rpc, 50, seed=1)
    seen, seen_there = (by_gdal(rpc, places, tmp_path) for places in (ground, others))
    width = COLUMNS[name]
    rng = np.random.default_rng(2)
    measured = seen + polynomial(seen, width) @ BIAS[:width] + rng.normal(0, 0.5, (20, 2))
    coefficients = np.linalg.lstsq(polynomial(seen, width), measured - seen, rcond=None)[0]
    expected = seen_there + polynomial(seen_there, width) @ coefficients
    fitted = refined(name, file, ground, measured)
    np.testing.assert_allclose(fitted.project(others), expected, atol=1e-6)
    assert len(fitted.model.terms) == 2 * width


def least_squares(model: SensorModel, control: FeatureSet) -> Fit:
    """Return the fit of all terms to all control, whether or not it determines them."""
    return LeastSquares().fit(model, control, make_scaling(control), *(
        np.ones(n, dtype=bool) for n in (len(model.terms), len(control))))


def refined(name: str, file: object, ground: FloatArray, image: FloatArray, *,
            crs: str = "EPSG:4979") -> Fit:
    model: SensorModel = registry().get("models", name)(rpc=str(file))
    control = FeatureSet(Points(tuple(map(str, range(len(ground)))), image, ground), crs=crs)
    return least_squares(model, control)


@pytest.mark.parametrize("vendor", VENDORS)
@pytest.mark.parametrize(("name", "how", "allowed"), [
    ("rpc-shift", "exact", 1e-6), ("rpc-drift", None, 0.01), ("rpc-affine", None, 0.01)])
def test_refined_rpc_projects_as_the_model_through_gdal(
        name: str, how: str | None, allowed: float, vendor: str, data_folder: Path,
        tmp_path: Path) -> None:
    file = data_folder / "rpc" / "original" / vendor
    rpc = read_rpc(file)
    ground, width = ground_of(rpc, 40), COLUMNS[name]
    seen = rpc.project(ground)
    fitted = refined(name, file, ground, seen + polynomial(seen, width) @ BIAS[:width])
    found = rpc_of(fitted)
    assert how is None or found.how == how
    assert found.worst <= allowed
    inside = ground_of(rpc, 200, seed=3)
    inside = inside[((fitted.project(inside) >= fitted.image_box()[0])
                     & (fitted.project(inside) <= fitted.image_box()[1])).all(axis=1)]
    low, high = ground[:, 2].min(), ground[:, 2].max()
    inside = inside[(inside[:, 2] >= low) & (inside[:, 2] <= high)]
    assert len(inside) > 20
    away = by_gdal(found.rpc, inside, tmp_path) - fitted.project(inside)
    assert np.abs(away).max() <= allowed


def test_known_correction_is_found_term_by_term() -> None:
    rpc = read_rpc(RPC_FILE)
    ground = ground_of(rpc, 15)
    seen = rpc.project(ground)
    fitted = refined("rpc-affine", DATASET_NAME, ground, seen + polynomial(seen, 3) @ BIAS)
    found = dict(zip(fitted.model.terms, fitted.adjustment.coefficients, strict=True))
    middle, scale = np.array(fitted.scaling.image_offset), fitted.scaling.image_scale
    for axis, name in enumerate(("line", "sample")):
        constant = BIAS[0, axis] + middle @ BIAS[1:, axis]
        assert found[f"{name}.bias:1"] * scale == pytest.approx(constant, abs=1e-6)
        assert found[f"{name}.bias:line"] == pytest.approx(BIAS[1, axis], abs=1e-9)
        assert found[f"{name}.bias:sample"] == pytest.approx(BIAS[2, axis], abs=1e-9)


@pytest.mark.parametrize("name", ["rpc-shift", "rpc-drift", "rpc-affine"])
def test_one_denominator_for_both_axes_keeps_the_refined_rpc_exact(
        name: str, tmp_path: Path) -> None:
    rpc = read_rpc(RPC_FILE)
    rpc = replace(rpc, sample_denominator=rpc.line_denominator)
    (tmp_path / "one.RPB").write_text(rpb_text(rpc))
    ground = ground_of(rpc, 15)
    seen = rpc.project(ground)
    fitted = refined(name, tmp_path / "one.RPB", ground, seen + polynomial(seen, 3) @ BIAS)
    assert isinstance(fitted.model, termsel.SensorModel)
    own = fitted.model.as_rpc(fitted.adjustment.coefficients)
    assert own is not None
    others = ground_of(rpc, 100, seed=1)
    np.testing.assert_allclose(own.project(others), fitted.project(others), atol=1e-8)
    assert rpc_of(fitted).how == "exact"


@pytest.mark.parametrize("form", ["vector", "parametric"])
def test_lines_refine_as_points_do(form: str) -> None:
    rpc, rng = read_rpc(RPC_FILE), np.random.default_rng(4)
    vertices = ground_of(rpc, 24).reshape(12, 2, 3)
    seen = rpc.project(vertices.reshape(-1, 3))
    image = (seen + polynomial(seen, 3) @ BIAS).reshape(12, 2, 2)
    along = rng.uniform(-0.2, 0.2, (12, 2, 1)) * (image[:, 1:] - image[:, :1])
    lines = Lines(tuple(f"L{i}" for i in range(12)), image + along, vertices)
    control = FeatureSet(lines=lines, crs="EPSG:4979")
    fitted = least_squares(RpcAffine(rpc=DATASET_NAME, line_form=form), control)
    others = ground_of(rpc, 30, seed=1)
    seen = rpc.project(others)
    np.testing.assert_allclose(fitted.project(others), seen + polynomial(seen, 3) @ BIAS,
                               atol=1e-6)


def test_ground_coordinates_may_be_projected() -> None:
    pyproj = pytest.importorskip("pyproj")
    rpc = read_rpc(RPC_FILE)
    ground = ground_of(rpc, 15)
    image = rpc.project(ground) + np.array([4.0, -3.0])
    turn = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:32639", always_xy=True)
    utm = np.column_stack([*turn.transform(ground[:, 0], ground[:, 1]), ground[:, 2]])
    fitted = refined("rpc-shift", DATASET_NAME, utm, image, crs="EPSG:32639")
    np.testing.assert_allclose(fitted.project(utm), image, atol=1e-4)
    found = rpc_of(fitted)
    assert found.how == "exact"
    np.testing.assert_allclose(found.rpc.project(ground), image, atol=1e-4)


# The rigorous model


def test_known_biases_of_attitude_are_found() -> None:
    """What is wrong with the nominal attitude, but for the drift that constants cannot take."""
    nominal = nominal_sensor()
    truth = replace(scene_truth(SCENE).sensor)
    end = truth.centre[0] * truth.line_period
    true = replace(nominal, **{
        name: replace(getattr(nominal, name), drift=(
            getattr(nominal, name).drift[0] + by, *getattr(nominal, name).drift[1:]))
        for name, by in (("roll", ROLL * truth.ifov), ("pitch", PITCH * truth.ifov),
                         ("yaw", YAW / truth.centre[1]))})
    fitted = refined_pushbroom(true, biases="attitude")
    found = dict(zip(fitted.model.terms, fitted.adjustment.coefficients, strict=True))
    scale = fitted.scaling.image_scale
    assert found["roll"] * scale == pytest.approx(ROLL, abs=1e-4)
    assert found["pitch"] * scale == pytest.approx(PITCH, abs=1e-4)
    assert found["yaw"] * truth.centre[1] == pytest.approx(YAW, abs=1e-4)
    # The scene's own attitude differs from this by the drift and the jitter alone.
    left = truth.roll(np.array([end])) - true.roll(np.array([end]))
    assert left / truth.ifov == pytest.approx(ROLL_DRIFT, abs=0.2)


def test_the_geometry_is_linearised_by_its_derivatives() -> None:
    fitted = refined_pushbroom(nominal_sensor(), biases="both")
    ground = fitted.scaled_control.points.ground
    image, columns = fitted.model.first_order(ground)  # type: ignore[attr-defined]
    step = np.random.default_rng(0).normal(size=columns.shape[-1]) * 1e-3
    moved = fitted.model.project(step, ground)
    np.testing.assert_allclose(moved - image, columns @ step, rtol=1e-3, atol=1e-6)


def refined_pushbroom(true: object, n: int = 30, **options: str) -> Fit:
    ground = ground_of(read_rpc(RPC_FILE), n)
    image = true.project(ground)  # type: ignore[attr-defined]
    control = FeatureSet(Points(tuple(map(str, range(n))), image, ground), crs="EPSG:4979")
    return least_squares(PushbroomRefine(geometry=DATASET_NAME, **options), control)


@pytest.mark.parametrize("biases", ["position", "both"])
def test_a_bias_of_position_is_corrected(biases: str) -> None:
    true = replace(nominal_sensor(), offset=(40.0, -25.0, 30.0))
    fitted = refined_pushbroom(true, biases=biases)
    others = ground_of(read_rpc(RPC_FILE), 50, seed=1)
    np.testing.assert_allclose(fitted.project(others), true.project(others), atol=1e-3)
    if biases == "position":
        unit = fitted.scaling.image_scale * true.ifov * true.altitude
        np.testing.assert_allclose(fitted.adjustment.coefficients * unit, true.offset, atol=0.01)


def test_large_biases_need_more_than_one_step() -> None:
    """Three degrees of yaw: far from linear."""
    nominal = nominal_sensor()
    true = replace(nominal, yaw=replace(nominal.yaw, drift=(np.radians(3.0),
                                                            *nominal.yaw.drift[1:])))
    fitted = refined_pushbroom(true)
    assert fitted.control_rmse() is not None
    assert fitted.control_rmse().total < 1e-4  # type: ignore[union-attr]
    scaled = fitted.scaling.features(fitted.control)
    linear = fitted.model.equations(scaled)
    one_step = np.asarray(np.linalg.lstsq(linear.A, linear.b, rcond=None)[0], dtype=float)
    away = fitted.model.project(one_step, scaled.points.ground) - scaled.points.image
    assert np.abs(away).max() * fitted.scaling.image_scale > 0.1


def test_refined_geometry_becomes_an_rpc() -> None:
    true = replace(nominal_sensor(), offset=(40.0, -25.0, 30.0))
    fitted = refined_pushbroom(true, biases="position")
    found = rpc_of(fitted)
    assert found.worst < 0.01
    others = ground_of(read_rpc(RPC_FILE), 50, seed=1)
    np.testing.assert_allclose(found.rpc.project(others), true.project(others), atol=0.01)


def test_geometry_comes_from_a_file(tmp_path: Path) -> None:
    sensor = replace(nominal_sensor(), offset=(1.0, 2.0, 3.0))
    write_geometry(sensor, tmp_path / "scene.json")
    assert read_geometry(tmp_path / "scene.json") == sensor
    model = PushbroomRefine(geometry=str(tmp_path / "scene.json"))
    assert model.sensor == sensor
    assert PushbroomRefine(**model.options).sensor == sensor


def test_vendor_rpc_is_that_of_the_nominal_sensor() -> None:
    sensor, rng = nominal_sensor(), np.random.default_rng(0)
    image = rng.uniform(0, 1, (200, 2)) * [sensor.n_lines - 1, sensor.n_samples - 1]
    height = rng.uniform(1690, 2000, 200)
    ground = np.column_stack([sensor.locate(image, height), height])
    np.testing.assert_allclose(read_rpc(RPC_FILE).project(ground), image, atol=1e-4)


# What cannot be


@pytest.mark.parametrize(("model", "option", "words"), [
    (RpcShift, "rpc", "--rpc FILE"), (RpcDrift, "rpc", "--rpc FILE"),
    (RpcAffine, "rpc", "--rpc FILE"), (PushbroomRefine, "geometry", "--set geometry=FILE")])
def test_without_a_geometry_it_says_how_to_give_one(model: type[SensorModel], option: str,
                                                    words: str) -> None:
    made = model()
    assert made.terms == model(**{option: DATASET_NAME}).terms  # as termsel describe shows them
    with pytest.raises(TermselError, match=f"{model.name!r} requires .* {words}"):
        made.prepared(*AROUND_RPC)


@pytest.mark.parametrize(("model", "option"), [(RpcShift, "rpc"), (PushbroomRefine, "geometry")])
def test_missing_file_is_named(model: type[SensorModel], option: str, tmp_path: Path) -> None:
    with pytest.raises(TermselError, match=r"no-such\.txt.*this file does not exist"):
        model(**{option: str(tmp_path / "no-such.txt")})


@pytest.mark.parametrize("content", [
    "{", "[]", '{"schema": "termsel-pushbroom-1"}', "\0"])
def test_damaged_geometry_is_refused(content: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text(content)
    with pytest.raises(TermselError, match=r"scene\.json"):
        PushbroomRefine(geometry=str(path))


def test_a_field_of_the_geometry_is_amiss(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    write_geometry(nominal_sensor(), path)
    text = path.read_text()
    for old, new in (('"ifov": ', '"ifov": -'), ('"jitter": []', '"jitter": [1]'),
                     ('"n_lines": 7000', '"n_lines": "many"')):
        assert old in text
        path.write_text(text.replace(old, new))
        with pytest.raises(TermselError, match=r"scene\.json"):
            PushbroomRefine(geometry=str(path))


@pytest.mark.parametrize("name", ["rpc-shift", "pushbroom-refine"])
def test_points_elsewhere_are_refused_with_both_places(name: str) -> None:
    options = {"geometry" if "push" in name else "rpc": DATASET_NAME}
    with pytest.raises(TermselError, match=r"is of another place \(34.8 N, 48.5 E\) "
                                           r"than the control \(32.6 N, 51.7 E\)"):
        termsel.prepare("owdis-points", dataset="spot-isfahan", model=name, options=options)


def test_longitudes_go_round() -> None:
    rpc = read_rpc(RPC_FILE)
    ground = ground_of(rpc, 15)
    image = rpc.project(ground) + np.array([4.0, -3.0])
    fitted = refined("rpc-shift", DATASET_NAME, ground - [360.0, 0.0, 0.0], image)
    assert fitted.control_rmse().total < 1e-6  # type: ignore[union-attr]


def test_local_coordinates_are_refused() -> None:
    rpc = read_rpc(RPC_FILE)
    ground = ground_of(rpc, 15)
    with pytest.raises(TermselError, match="without a CRS"):
        refined("rpc-shift", DATASET_NAME, ground, rpc.project(ground), crs="local")


def test_an_rpc_that_was_replaced_next_to_its_image_is_read_again(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="extra gis is not installed")
    image = tmp_path / "scene.tif"
    with rasterio.open(image, "w", driver="GTiff", width=4, height=4, count=1,
                       dtype="uint8") as raster:
        raster.write(np.zeros((1, 4, 4), dtype=np.uint8))
    rpc = read_rpc(RPC_FILE)
    moved = replace(rpc, image_offset=(rpc.image_offset[0] + 100.0, rpc.image_offset[1]))
    for stated in (rpc, moved):
        (tmp_path / "scene.RPB").write_text(rpb_text(stated), encoding="utf-8")
        assert RpcShift(rpc=str(image)).rpc.image_offset == pytest.approx(stated.image_offset)
