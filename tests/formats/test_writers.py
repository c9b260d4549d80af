"""Writers: whole or nothing, read back by termsel, GDAL and others."""

from __future__ import annotations

import logging
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

import termsel
from termsel.core.errors import TermselError
from termsel.core.files.atomic import write_bytes
from termsel.data.features import FeatureSet, Points
from termsel.data.monomials import RPC00B
from termsel.data.rasters import empty_tiff
from termsel.fitting.rpc_fit import rpc_of
from termsel.formats.readers.csv_tables import LinesCsv, PointsCsv
from termsel.formats.rpc_files import read_rpc, rpb_text
from termsel.formats.vrt import picture_for
from termsel.formats.writers.grids import GcpGridVrt, GeolocationVrt
from termsel.formats.writers.rpcs import (
    Rpb,
    RpcTxt,
    RpcVrt,
    _require_same_by_gdal,
    require_read_back,
)
from termsel.formats.writers.selections import (
    GcpVrt,
    LinesTable,
    PointsTable,
    QgisPointsWriter,
)
from termsel.results.result import Result
from termsel.testing import Check, checks, example_results

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
rasterio = pytest.importorskip("rasterio")
pyproj = pytest.importorskip("pyproj")


def _mashad(crs: str = "EPSG:4979", **options: object) -> Result:
    """Return a result of all terms over a simulated scene, its ground coordinates in a CRS."""
    features = termsel.simulate_scene("irs1c-mashad")
    if crs != "EPSG:4979":
        turn = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
        lon, lat, height = features.points.ground.T
        ground = np.column_stack([*turn.transform(lon, lat), height])
        features = replace(features, crs=crs, points=replace(features.points, ground=ground))
    chosen: dict[str, object] = {"model": "poly3d", "solver": "all-terms", **options}
    return termsel.run("rfm-terms", features=features, **chosen)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def geographic() -> Result:
    return _mashad()


@pytest.fixture(scope="module")
def utm() -> Result:
    return _mashad("EPSG:32640")


@pytest.fixture(scope="module")
def of_lines() -> Result:
    return termsel.run("owdis-lines", generations=2, options={"population": 30, "polish": False})


# The suite of every writer; the example results have random coefficients and selections, so
# that grids are made of a fitted scene.

SUITES: dict[str, tuple[Check, ...]] = {
    writer.name: checks(writer, filename=f"scene{writer.suffix}")
    for writer in (QgisPointsWriter(), GcpVrt(), PointsTable())}


@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{check.name}")
    for name, checks in SUITES.items() for check in checks])
def test_conformance(check: Check) -> None:
    check.run()


@pytest.mark.parametrize("writer", [Rpb(), RpcTxt(), RpcVrt(), GcpGridVrt(across=5),
                                    GeolocationVrt(step=500), LinesTable()], ids=lambda w: w.name)
def test_conformance_on_fitted_scenes(writer: termsel.Writer, geographic: Result,
                                      of_lines: Result) -> None:
    local = geographic.with_(fit=replace(geographic.fit, control=replace(
        geographic.fit.control, crs="local")))
    results = [geographic, of_lines] + ([local] if "rpc" in writer.name else [])
    for check in checks(writer, filename=f"scene{writer.suffix}", results=results):
        check.run()


# RPCs


def test_an_rpc_by_heights_of_no_stated_datum_is_said(
        geographic: Result, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    Rpb().write(geographic, tmp_path / "stated.RPB")
    assert "Warning" not in caplog.text
    undeclared = replace(geographic.features,
                         heights="9 of 9 heights from dem.tif, bilinear; vertical datum: "
                                 "not declared by the raster")
    Rpb().write(geographic.with_(features=undeclared), tmp_path / "scene.RPB")
    assert "An RPC takes ellipsoidal heights: if these are above a geoid" in caplog.text
    assert " px for each 10 m between the two" in caplog.text


@pytest.mark.parametrize("crs", ["EPSG:4979", "EPSG:32640"])
def test_rpcs_of_fits_in_any_crs(crs: str) -> None:
    result = _mashad(crs)
    found = rpc_of(result.fit)
    assert found.how == ("exact" if crs == "EPSG:4979" else "the selected")
    assert found.worst < (1e-9 if crs == "EPSG:4979" else 0.05)
    degrees = termsel.simulate_scene("irs1c-mashad").points.ground
    apart = found.rpc.project(degrees) - result.project(result.features.points.ground)
    assert np.abs(apart).max() <= max(found.worst, 1e-9)


def test_terms_that_were_not_selected_are_zero_and_denominators_begin_with_one() -> None:
    result = termsel.run("rfm-terms", dataset="irs1c-mashad", solver="random", generations=2)
    rpc = result.to_rpc()
    names = {name for name in result.selection.terms if ".num" in name or ".den" in name}
    written = sum(np.count_nonzero(part) for part in (
        rpc.line_numerator, rpc.sample_numerator, rpc.line_denominator[1:],
        rpc.sample_denominator[1:]))
    assert written == len(names) == len(result.selection.terms)
    assert rpc.line_denominator[0] == rpc.sample_denominator[0] == 1.0


@pytest.mark.parametrize(("model", "options", "how"), [
    ("affine", {}, "exact"), ("poly3d", {"degree": 3}, "exact"), ("dlt3d", {}, "exact"),
    ("poly2d", {"degree": 3}, "exact"), ("poly2d", {"degree": 4}, "all 78 (small denominators)"),
    ("rfm", {"order": 1, "denominators": "shared"}, "exact")])
def test_which_models_are_rpcs(model: str, options: dict[str, object], how: str,
                               caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "termsel")
    result = _mashad(model=model, options=options)
    found = rpc_of(result.fit)
    assert found.how == how
    assert ("refitted" in caplog.text) == (how != "exact")
    if how != "exact":
        assert f"at most {found.worst:.2g} px" in caplog.text


def test_plane_coordinates_are_no_rpc() -> None:
    local = example_results()[1]
    assert not Rpb().accepts(local)
    with pytest.raises(TermselError, match="without a CRS cannot be transformed to longitude"):
        local.to_rpc()


def test_an_rpc_that_gdal_cannot_use_is_not_written() -> None:
    rpc = rpc_of(_mashad(model="affine").fit).rpc
    flat = replace(rpc, line_numerator=(0.5,) + (0.0,) * 19)
    with pytest.raises(TermselError, match=r"^GDAL cannot use this RPC: "):
        require_read_back(flat, rpb_text(flat), ".RPB")
    with pytest.raises(TermselError, match="read back differs from the one that was written"):
        require_read_back(flat, rpb_text(rpc), ".RPB")


def test_an_rpc_that_gdal_evaluates_otherwise_at_some_places_is_refused(tmp_path: Path) -> None:
    rpc = rpc_of(_mashad(model="affine").fit).rpc
    # A cubic term of 1e-3 px at the edge, but below the tolerance near the middle.
    column = RPC00B.index((3, 0, 0))
    cubic = list(rpc.line_numerator)
    cubic[column] += 1e-3 / rpc.image_scale[0]
    image = tmp_path / "scene.tif"
    write_bytes(image, empty_tiff())
    (tmp_path / "scene.RPB").write_text(rpb_text(rpc))
    _require_same_by_gdal(rpc, image)
    with pytest.raises(TermselError, match=r"differs by up to 0\.00(09\d*|1) px\. The model is"):
        _require_same_by_gdal(replace(rpc, line_numerator=tuple(cubic)), image)


def test_vendors_file_of_higher_priority_is_warned_of(
        geographic: Result, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    image = tmp_path / "scene.tif"
    warnings.simplefilter("ignore")
    with rasterio.open(image, "w", driver="GTiff", width=4000, height=4000, count=1,
                       dtype="uint8", sparse_ok=True):
        pass
    RpcTxt(image=str(image)).write(geographic, tmp_path / "scene_RPC.TXT")
    assert "Warning" not in caplog.text
    vendor = replace(geographic.to_rpc(), image_offset=(0.0, 0.0))
    (tmp_path / "scene.RPB").write_text(rpb_text(vendor))
    RpcTxt().write(geographic, tmp_path / "scene_RPC.TXT")
    assert "GDAL uses the RPC of scene.RPB and not that of scene_RPC.TXT" in caplog.text
    caplog.clear()
    Rpb(image=str(image)).write(geographic, tmp_path / "other.RPB")
    assert "GDAL does not use this RPC" in caplog.text
    # A VRT needs no file to be moved away.
    RpcVrt(image=str(image)).write(geographic, tmp_path / "scene.vrt")
    with rasterio.open(tmp_path / "scene.vrt") as vrt:  # in the default domain, where OTB looks
        assert vrt.tags()["METADATATYPE"] == "GE"
    assert read_rpc(tmp_path / "scene.vrt") == geographic.to_rpc()
    with rasterio.open(tmp_path / "scene.vrt") as raster:
        assert raster.rpcs.line_off == geographic.to_rpc().image_offset[0]


# Selections


def _some_left_out() -> Result:
    """Return a result in UTM with 20 of 30 control points selected, one point off."""
    features = termsel.simulate_scene("irs1c-mashad", n_points=60)
    turn = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:32640", always_xy=True)
    lon, lat, height = features.points.ground.T
    roles = ("off", *("control", "check", "control", "independent") * 15)[:60]
    points = replace(features.points, roles=roles, ground=np.column_stack(
        [*turn.transform(lon, lat), height]))
    return termsel.run("owdis-points", features=replace(features, crs="EPSG:32640", points=points),
                       model="affine", generations=3, options={
                           "population": 30, "max_features": 20, "polish": False})


@pytest.fixture(scope="module")
def selected() -> Result:
    return _some_left_out()


def _lines(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]


def test_qgis_points(selected: Result, tmp_path: Path) -> None:
    path = tmp_path / "scene.points"
    QgisPointsWriter().write(selected, path)
    assert path.read_text().startswith('#CRS: PROJCRS["WGS 84 / UTM zone 40N"')
    header, *rows = _lines(path)
    assert header == ["mapX", "mapY", "sourceX", "sourceY", "enable", "dX", "dY", "residual"]
    values = np.array(rows, dtype=float)
    points = selected.features.points
    assert np.array_equal(values[:, :2], points.ground[:, :2])
    assert np.array_equal(values[:, 2], points.image[:, 1] + 0.5)
    assert np.array_equal(values[:, 3], -points.image[:, 0] - 0.5)
    assert [name for name, on in zip(points.ids, values[:, 4], strict=True) if on] == list(
        selected.selection.features)
    # As in a file of QGIS itself: computed minus measured, right and down.
    computed = selected.project(points.ground)
    assert np.allclose(values[:, 2] + values[:, 5], computed[:, 1] + 0.5)
    assert np.allclose(-values[:, 3] + values[:, 6], computed[:, 0] + 0.5)
    assert np.allclose(values[:, 7], np.hypot(values[:, 5], values[:, 6]))


def test_points_csv_is_read_again_with_the_selection(selected: Result, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    PointsTable().write(selected, path)
    read = PointsCsv().read(path)
    assert read.crs == "EPSG:32640"
    assert np.array_equal(read.points.ground, selected.features.points.ground)
    assert np.array_equal(read.points.image, selected.features.points.image)
    control = [name for name, role in zip(read.points.ids, read.points.roles, strict=True)
               if role == "control"]
    assert control == list(selected.selection.features)
    assert read.points.roles.count("off") == 1 + 30 - len(control)


def test_lines_csv_is_read_again_with_the_selection(of_lines: Result, tmp_path: Path) -> None:
    path = tmp_path / "lines.csv"
    LinesTable().write(of_lines, path)
    read = LinesCsv().read(path)
    assert read.lines.ids == of_lines.selection.features
    with pytest.raises(TermselError, match=r"cannot be written as qgis-points.*residuals-gpkg"):
        QgisPointsWriter().write(of_lines, path)


def test_lines_csv_keeps_deviations(of_lines: Result, tmp_path: Path) -> None:
    control = of_lines.fit.control
    sigma = np.arange(1.0, 1.0 + len(control.lines))
    weighed = of_lines.features.with_(lines=replace(control.lines, sigma=sigma))
    path = tmp_path / "lines.csv"
    LinesTable().write(of_lines.with_(features=weighed), path)
    chosen = np.isin(control.lines.ids, of_lines.selection.features)
    np.testing.assert_array_equal(LinesCsv().read(path).lines.sigma, sigma[chosen])


def test_gcps_are_gdals(selected: Result, tmp_path: Path) -> None:
    path = tmp_path / "gcps.vrt"
    GcpVrt().write(selected, path)
    with rasterio.open(path) as raster:
        gcps, crs = raster.gcps
        assert raster.shape == (4000, 4000)
    assert crs.to_epsg() == 32640
    points = selected.features.points
    assert [gcp.id for gcp in gcps] == list(selected.selection.features)
    for gcp in gcps:
        i = points.ids.index(gcp.id)
        assert (gcp.row - 0.5, gcp.col - 0.5) == pytest.approx(tuple(points.image[i]))
        assert (gcp.x, gcp.y, gcp.z) == tuple(points.ground[i])


def test_names_with_markup_survive_a_vrt(tmp_path: Path) -> None:
    result = example_results()[0]
    points = replace(result.features.points,
                     ids=('a<b>&"c"', *result.features.points.ids[1:]))
    control = replace(result.fit.control, points=points.take(
        np.array(points.roles) == "control"))
    named = result.with_(features=replace(result.features, points=points),
                    fit=replace(result.fit, control=control),
                    selection=structs.replace(result.selection, features=control.ids))
    GcpVrt().write(named, tmp_path / "gcps.vrt")
    with rasterio.open(tmp_path / "gcps.vrt") as raster:
        assert [gcp.id for gcp in raster.gcps[0]] == list(control.ids)


def test_readers_take_what_is_written(selected: Result, tmp_path: Path) -> None:
    points, chosen = selected.features.points, set(selected.selection.features)
    which = [name in chosen for name in points.ids]
    for writer in (QgisPointsWriter(), GcpVrt()):
        path = tmp_path / f"scene{writer.suffix}"
        writer.write(selected, path)
        read = termsel.read(path)
        on = np.array([role != "off" for role in read.points.roles])
        assert np.allclose(read.points.image[on], points.image[which], rtol=0, atol=1e-9)
        assert read.crs == "EPSG:32640"
        assert np.array_equal(read.points.ground[on, :2], points.ground[which, :2])


# Grids


def _dem(path: Path, heights: np.ndarray, west: float, north: float, pixel: float) -> Path:
    from affine import Affine

    with rasterio.open(path, "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0],
                       count=1, dtype="float32", crs="EPSG:4326", transform=Affine(
                           pixel, 0.0, west, 0.0, -pixel, north)) as raster:
        raster.write(heights.astype(np.float32), 1)
    return path


def test_grids_lie_on_the_terrain(geographic: Result, tmp_path: Path) -> None:
    slope = 900.0 + 400.0 * np.linspace(0.0, 1.0, 500)[None, :] * np.ones((500, 1))
    dem = _dem(tmp_path / "dem.tif", slope, 59.3, 36.6, 0.0012)
    GcpGridVrt(dem=str(dem), across=7).write(geographic, tmp_path / "grid.vrt")
    with rasterio.open(tmp_path / "grid.vrt") as raster:
        gcps = raster.gcps[0]
    assert len(gcps) == 64
    ground = np.array([(gcp.x, gcp.y, gcp.z) for gcp in gcps])
    image = np.array([(gcp.row - 0.5, gcp.col - 0.5) for gcp in gcps])
    assert np.abs(geographic.project(ground) - image).max() < 1e-3
    assert np.ptp(ground[:, 2]) > 100
    GeolocationVrt(dem=str(dem), step=100).write(geographic, tmp_path / "g.vrt")
    with rasterio.open(tmp_path / "g_xy.tif") as raster:
        x, y = raster.read()
    with_height = geographic.locate([[2000.0, 1000.0]], lambda xy: np.interp(
        xy[:, 0], 59.3 + 0.0012 * (np.arange(500) + 0.5), slope[0]))
    assert np.abs(with_height[0, :2] - (x[21, 11], y[21, 11])).max() < 1e-7


def test_level_ground_is_warned_of(geographic: Result, tmp_path: Path,
                                   caplog: pytest.LogCaptureFixture) -> None:
    GcpGridVrt().write(geographic, tmp_path / "grid.vrt")
    assert "without a raster of heights (--dem) the ground is taken as level" in caplog.text
    caplog.clear()
    GcpGridVrt(height=1000.0).write(geographic, tmp_path / "grid.vrt")
    assert "Warning" not in caplog.text


def test_an_image_of_another_size_is_refused(geographic: Result, tmp_path: Path) -> None:
    (tmp_path / "small.tif").write_bytes(empty_tiff())
    for writer in (RpcVrt, GcpVrt, GcpGridVrt, GeolocationVrt):
        with pytest.raises(TermselError, match="the image has 1 lines and 1 samples, the image"):
            writer(image=str(tmp_path / "small.tif")).write(geographic, tmp_path / "x.vrt")
        assert not (tmp_path / "x.vrt").exists()


@pytest.mark.parametrize("axis", [0, 1])
def test_an_image_holds_all_features_or_is_refused(geographic: Result, tmp_path: Path,
                                                   axis: int) -> None:
    (tmp_path / "small.tif").write_bytes(empty_tiff())
    unknown = geographic.with_(features=replace(geographic.features, image_size=None))
    image = np.zeros_like(geographic.features.points.image)
    # The edges of the only pixel are at -0.5 and 0.5; 5 px beyond is an error of measuring.
    for place, fits, message in (
            (5.5, True, ""), (5.6, False, "lines and 1 samples, but points extend to line"),
            (-5.5, True, ""), (-5.6, False, "before the first pixel of the image")):
        image[3, axis] = place
        within = unknown.with_(features=replace(unknown.features, points=replace(
            unknown.features.points, image=image)))
        if fits:
            assert picture_for(within, tmp_path / "small.tif").size == (1, 1)
            continue
        with pytest.raises(TermselError, match=message):
            picture_for(within, tmp_path / "small.tif")
    assert picture_for(geographic, None).size == geographic.features.image_size


def test_plane_models_need_no_heights(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(0.0, 1000.0, (40, 2)), np.full(40, np.nan)])
    image = np.column_stack([500.0 - 0.5 * ground[:, 1], 0.5 * ground[:, 0]])
    image += rng.normal(0.0, 0.1, (40, 2))
    points = Points(tuple(f"p{i}" for i in range(40)), image, ground)
    result = termsel.run("poly-terms", features=FeatureSet(points, crs="EPSG:32640"),
                         solver="all-terms", model="poly2d", options={"degree": 2})
    for writer in (GcpGridVrt(), GcpVrt(), QgisPointsWriter(), PointsTable(),
                   GeolocationVrt(step=50), RpcVrt()):
        writer.write(result, tmp_path / f"scene{writer.suffix}")
