"""Old maps: prime meridians, and the projection that a map or a series was drawn in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")
pytest.importorskip("pyproj", reason="pyproj is not installed: pip install pyproj")

import termsel
from termsel import FeatureSet, FitData, Points, TermselError
from termsel.testing import checks, invoke
from termsel.toolkit.coordinates import normalise, transformation_between
from termsel_cameras.sheets.candidates import (
    Projection,
    candidate_projections,
    candidates_of,
    projections_of_file,
)
from termsel_cameras.sheets.choosing import (
    as_probable_as_the_best,
    choose_by_points,
    rank_by_series,
)
from termsel_cameras.sheets.meridians import meridian_of
from termsel_cameras.sheets.paper import Sheet, matrix_of, paper_of, values_of
from termsel_cameras.sheets.reading import from_greenwich
from termsel_cameras.sheets.series import SHEET_OF_SERIES, paper_of_text, stated_paper
from termsel_cameras.sheets.series_file import series_of, with_series_columns

CONIC = "+proj=lcc +lat_1=43.5 +lat_2=48.5 +lat_0=46 +lon_0=8 +datum=WGS84 +units=m +no_defs"
FLAT = "+proj=eqc +lat_ts=46 +lon_0=8 +datum=WGS84 +units=m +no_defs"
EVERY = f"{CONIC}  # conic\n{FLAT}  # flat\n\n+proj=merc +lon_0=8 +datum=WGS84 +units=m +no_defs\n"

FloatArray = NDArray[np.float64]


def sheet(n: int, seed: int, middle: tuple[float, float] = (8.0, 46.0),
          extent: float = 6.0) -> FeatureSet:
    """Return points of a map in a conic projection; measured to 1 px."""
    rng = np.random.default_rng(seed)
    degrees = np.array(middle) + rng.uniform(-extent, extent, (n, 2)) * [1.0, 0.7]
    ground = np.column_stack([degrees, np.zeros(n)])
    x, y, _ = transformation_between("EPSG:4326", CONIC)(ground).T
    image = np.column_stack([-y, x]) / (extent * 40.0) + 4000.0 + rng.normal(0.0, 1.0, (n, 2))
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)), image,
                             np.column_stack([degrees, np.full(n, np.nan)])), crs="EPSG:4326")


def table(features: FeatureSet, path: Path, shift: float = 0.0) -> Path:
    rows = [f"{name},{line},{sample},{x - shift},{y}" for name, (line, sample), (x, y, _) in zip(
        features.points.ids, features.points.image, features.points.ground, strict=True)]
    path.write_text("\n".join(["id,line,sample,x,y", *rows]), encoding="utf-8")
    return path


def test_degrees_from_ferro_or_paris_are_degrees(tmp_path: Path) -> None:
    features = sheet(6, 0)
    path = table(features, tmp_path / "ferro.csv", meridian_of("Ferro"))
    read = termsel.read(path, crs="EPSG:4326", prime_meridian="ferro")
    np.testing.assert_allclose(read.points.ground[:, :2], features.points.ground[:, :2])
    assert meridian_of("2.5") == 2.5
    with pytest.raises(TermselError, match="no prime meridian 'atlantis'"):
        meridian_of("atlantis")
    with pytest.raises(TermselError, match="longitudes in degrees"):
        termsel.read(path, crs="local", prime_meridian="paris")


@pytest.mark.parametrize(("meridian", "names", "told"), [
    ("paris", "x,y", True), ("paris", "lon_gon,lat_gon", False), ("ferro", "x,y", False)])
def test_a_map_of_paris_may_be_in_grads(meridian: str, names: str, told: bool, tmp_path: Path,
                                        caplog: pytest.LogCaptureFixture) -> None:
    path = table(sheet(6, 0), tmp_path / "map.csv")
    path.write_text(path.read_text("utf-8").replace("x,y", names), encoding="utf-8")
    termsel.read(path, crs="EPSG:4326", prime_meridian=meridian)
    assert ("name the columns lon_gon and lat_gon" in caplog.text) == told


def test_a_map_across_180_degrees_has_candidates_of_its_place() -> None:
    points = Points(("A", "B", "C"), np.zeros((3, 2)),
                    np.array([[176.0, -15.0, np.nan], [-177.0, -17.0, np.nan],
                              [178.0, -20.0, np.nan]]))
    features = FeatureSet(points, crs="EPSG:4326")
    candidates = candidates_of([features], None, None)
    assert "+lon_0=179.50000" in candidates[0].crs
    assert candidates[-1].crs == "EPSG:32760"
    # 140 deg west of Washington is 142.95 deg east of Greenwich.
    west = features.with_(points=replace(points, ground=np.array([
        [-140.0, 50.0, np.nan], [-139.0, 50.5, np.nan], [-140.0, 51.0, np.nan]])))
    assert from_greenwich(west, -77.05).points.ground[0, 0] == pytest.approx(142.95)


def test_a_map_of_the_world_has_candidates_that_show_all_of_it() -> None:
    world = candidate_projections(np.array([[-160.0, -55.0], [170.0, 75.0]]))
    names = {projection.name: projection.crs for projection in world}
    assert {"Robinson", "Winkel tripel", "Mollweide"} <= set(names)
    # Of the middle 5 E, as few points have it, and of Greenwich, as most maps have it.
    assert "+lon_0=0.00000" in names["Robinson"]
    continent = candidate_projections(np.array([[-15.0, -33.0], [50.0, 35.0]]))
    assert "Robinson" not in {projection.name for projection in continent}


def test_independent_points_do_not_say_which_projections_are_tried() -> None:
    ground = np.array([[7.0, 45.0, np.nan], [8.0, 46.0, np.nan], [20.0, 50.0, np.nan]])
    points = Points(("A", "B", "C"), np.zeros((3, 2)), ground,
                    roles=("control", "control", "independent"))
    features = FeatureSet(points, crs="EPSG:4326")
    control = features.with_(points=points.take([True, True, False]))
    assert candidates_of([features], None, None) == candidates_of([control], None, None)
    # Nor of how many turns longitudes are from Greenwich.
    far = np.array([[190.0, 45.0, np.nan], [300.0, 46.0, np.nan], [310.0, 50.0, np.nan]])
    points = replace(points, ground=far, roles=("control", "independent", "independent"))
    moved = from_greenwich(features.with_(points=points), -20.0)
    assert moved.points.ground[0, 0] == pytest.approx(170.0)
    independent = features.with_(points=points.take([False, True, True]))
    with pytest.raises(TermselError, match="no map has control points"):
        candidates_of([independent], None, None)


def test_the_projection_of_a_map_is_found(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    candidates = tmp_path / "mine.txt"
    candidates.write_text(EVERY, encoding="utf-8")
    read = termsel.read(table(sheet(10, 1), tmp_path / "map.csv"), crs="auto",
                        projection_candidates=str(candidates))
    assert read.fit_crs == normalise(CONIC)
    assert "of 3 projections conic predicts the points best" in caplog.text
    stated = termsel.read(tmp_path / "map.csv", crs="EPSG:4326", projection=FLAT)
    assert stated.fit_crs == normalise(FLAT)
    with pytest.raises(TermselError, match="for a projection that is chosen"):
        termsel.read(tmp_path / "map.csv", crs="EPSG:4326", map_century=18)


@pytest.mark.parametrize("words", [["map-series"], ["flight-camera", "--size", 100, 100]])
def test_the_file_of_json_has_no_name_of_a_table(words: list[object], tmp_path: Path) -> None:
    done = invoke(*words, "sheet.csv", "-o", tmp_path / "series.csv")
    assert done.exit_code == 2
    assert "this file is written as JSON, not as .csv. Name it series.json." in done.stderr


def test_a_folder_of_sheets_is_answered_by_its_files(tmp_path: Path) -> None:
    (tmp_path / "a.points").write_text("mapX,mapY\n", encoding="utf-8")
    assert f"Give its files: termsel map-series {tmp_path}/*.points." in \
        invoke("map-series", tmp_path).stderr


def test_a_doubt_about_all_sheets_is_said_once(tmp_path: Path) -> None:
    files = [table(sheet(4, seed), tmp_path / f"{seed}.csv") for seed in range(3)]
    done = invoke("map-series", *files, "--prime-meridian", "paris")
    assert done.exit_code == 0, done.stderr
    assert done.stderr.count("name the columns lon_gon and lat_gon") == 1
    assert "that on grads concerns 2 further sheets as well" in done.stderr


def test_a_sheet_without_a_crs_is_in_degrees_if_it_can_be(tmp_path: Path) -> None:
    wide = [f"{10.0 * i},{50.0 + 3.0 * (i % 2)},{700 * i},{500 + 130 * (i % 2)}"
            for i in range(8)]  # half a continent: which projection it is in may be asked
    (tmp_path / "wide.csv").write_text("x,y,sample,line\n" + "\n".join(wide), encoding="utf-8")
    done = invoke("map-series", tmp_path / "wide.csv")
    assert done.exit_code == 0, done.stderr
    metres = [f"{430_000 + 900 * i},{5_200_000 + 700 * (i % 2)},{700 * i},{500 + 130 * (i % 2)}"
              for i in range(8)]
    (tmp_path / "m.csv").write_text("x,y,sample,line\n" + "\n".join(metres), encoding="utf-8")
    refused = invoke("map-series", tmp_path / "m.csv")
    assert refused.exit_code == 2
    assert "the CRS of the ground coordinates is unknown" in refused.stderr


def test_sheets_of_a_series_share_their_projection(tmp_path: Path) -> None:
    sheets = [sheet(10, 2), *(sheet(4, seed, (7.0 + seed / 5, 45.0), 1.5) for seed in range(3))]
    candidates = tmp_path / "mine.txt"
    candidates.write_text(EVERY, encoding="utf-8")
    files = [table(one, tmp_path / f"{i}.csv") for i, one in enumerate(sheets)]
    done = invoke("map-series", *files, "--candidates", candidates, "-o",
                  tmp_path / "series.json")
    assert done.exit_code == 0, done.stderr
    assert "Chosen for 4 sheets: conic" in done.stdout
    assert "Paper by 4 sheets" in done.stdout
    read = termsel.read(files[1], crs="EPSG:4326", series=str(tmp_path / "series.json"))
    assert read.fit_crs == normalise(CONIC)
    # The other three sheets, not this one itself.
    assert paper_of_text(stated_paper(read)).sheets == 3
    (tmp_path / "wrong.json").write_text('{"projection": "", "sheets": [{}]}', encoding="utf-8")
    with pytest.raises(TermselError, match="no file of a series"):
        termsel.read(files[1], crs="EPSG:4326", series=str(tmp_path / "wrong.json"))


BONNE = "+proj=bonne +lat_1=45 +lon_0=2.3372 +ellps=clrk80ign +units=m +no_defs"
SINUSOIDAL = "+proj=sinu +lon_0=2.8 +datum=WGS84 +units=m +no_defs"
MERCATOR = "+proj=merc +lon_0=2.8 +datum=WGS84 +units=m +no_defs"
POLYCONIC = "+proj=poly +lat_0=47 +lon_0=2.8 +datum=WGS84 +units=m +no_defs"


def series_sheet(crs: str, number: int, seed: int, noise: float) -> FeatureSet:
    """Return one of eight sheets drawn in a projection: five have four points at the corners."""
    rng = np.random.default_rng([seed, number])
    count = 4 if number < 5 else 18
    corner = np.array([1.2 + 0.75 * (number % 4), 47.0 + 0.45 * (number // 4)])
    degrees = corner + rng.uniform(0.0, 1.0, (count, 2)) * [0.6, 0.36]
    if count == 4:
        degrees = corner + np.array([[0.03, 0.03], [0.57, 0.03], [0.03, 0.33], [0.57, 0.33]])
    ground = np.column_stack([degrees, np.zeros(count)])
    plan = transformation_between("EPSG:4326", crs)(ground)[:, :2]
    values = np.array([np.log(0.15), 0.0, 0.007, 0.002])
    values += rng.normal(0.0, [0.0008, 0.02, 0.0008, 0.0008])
    image = ((plan - plan.mean(axis=0)) @ matrix_of(values).T)[:, ::-1] * [-1.0, 1.0] + 3000.0
    image += rng.normal(0.0, noise, image.shape)
    return FeatureSet(Points(tuple(f"P{i}" for i in range(count)), image,
                             np.column_stack([degrees, np.full(count, np.nan)])), crs="EPSG:4326")


@pytest.mark.slow_cases(
    "+proj=bonne +lat_1=45 +lon_0=2.3372 +ellps=clrk80ign +units=m +no_defs-0.5",
    "+proj=merc +lon_0=2.8 +datum=WGS84 +units=m +no_defs-0.5",
    "+proj=poly +lat_0=47 +lon_0=2.8 +datum=WGS84 +units=m +no_defs-0.5",
    "+proj=poly +lat_0=47 +lon_0=2.8 +datum=WGS84 +units=m +no_defs-4.0")
@pytest.mark.parametrize("noise", [0.5, 4.0])
@pytest.mark.parametrize("crs", [BONNE, MERCATOR, POLYCONIC])
def test_a_series_is_of_the_projection_in_which_its_sheets_are_alike(
        crs: str, noise: float) -> None:
    sheets = [series_sheet(crs, number, 1, noise) for number in range(8)]
    # The right one is the last.
    others = [other for other in (SINUSOIDAL, MERCATOR, POLYCONIC) if other != crs]
    if crs in (BONNE, POLYCONIC):  # hardly distinct at this size
        others = [SINUSOIDAL, MERCATOR]
    candidates = [Projection(other, other) for other in (*others, crs)]
    ranked = rank_by_series(sheets, candidates)
    assert [one.crs for one in as_probable_as_the_best(ranked, candidates)] == [crs]
    # A sheet given twice tells what it tells once.
    assert rank_by_series([*sheets, sheets[0]], candidates) == ranked


@pytest.mark.slow
def test_a_series_says_which_projections_it_does_not_tell_apart(tmp_path: Path) -> None:
    files = [table(series_sheet(BONNE, number, 2, 1.5), tmp_path / f"{number}.csv")
             for number in range(8)]
    candidates = tmp_path / "mine.txt"
    candidates.write_text(f"{SINUSOIDAL}  # sinusoidal\n{BONNE}  # Bonne\n"
                          f"{POLYCONIC}  # polyconic\n", encoding="utf-8")
    done = invoke("map-series", *files, "--candidates", candidates)
    assert "Chosen for 8 sheets: Bonne." in done.stdout
    assert "whether it is this one or another: polyconic. If the map" in done.stdout


@pytest.mark.slow
def test_sheets_borrow_nothing_in_projections_that_they_contradict(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    files = [table(series_sheet(POLYCONIC, number, 2, 1.5), tmp_path / f"{number}.csv")
             for number in range(8)]
    candidates = tmp_path / "mine.txt"
    shared = tmp_path / "series.json"

    def said_of(*crss: str) -> str:
        candidates.write_text("\n".join(crss), encoding="utf-8")
        return invoke("map-series", *files, "--candidates", candidates, "-o", shared,
                      "--overwrite").stdout

    assert "the sheets contradict the projections of --candidates" in said_of(MERCATOR, SINUSOIDAL)
    alone = termsel.read(files[0], crs="EPSG:4326")
    lent = termsel.read(files[0], crs="EPSG:4326", series=str(shared))
    assert "lends nothing" in caplog.text
    assert (lent.fit_crs, lent.points.attributes) == (alone.fit_crs, alone.points.attributes)
    # One of them that is right is enough, even where the list has one that is as good.
    assert "contradict" not in said_of(MERCATOR, BONNE)
    assert termsel.read(files[0], crs="EPSG:4326", series=str(shared)).fit_crs == normalise(BONNE)


def test_one_sheet_is_no_series_to_choose_by() -> None:
    assert rank_by_series([series_sheet(BONNE, 6, 3, 1.0)], [Projection("Bonne", BONNE)]) == []


def paper_sheet(n: int, seed: int, wild: bool = False) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return a sheet of one paper and scanner, other places, and where these are seen."""
    rng = np.random.default_rng(seed)
    values = np.array([-2.3, 0.0, 0.004, -0.003]) + rng.normal(0.0, [0.001, 0.005, 0.001, 0.001])
    plan = rng.uniform(-15_000.0, 15_000.0, (n + 100, 2))
    true = (plan @ matrix_of(values).T)[:, ::-1] * [-1.0, 1.0] + 2000.0
    image = true + rng.normal(0.0, 3.0, true.shape)
    corner = np.array([4e5 + 3e4 * seed, 5e6])
    ground = np.column_stack([corner + plan, np.full(n + 100, np.nan)])
    roles = ("control",) * n
    if wild:
        image[n:n + 3] += 500.0
        roles += ("independent",) * 3
    m = len(roles)
    points = Points(tuple(f"P{i}" for i in range(m)), image[:m], ground[:m], roles=roles)
    return FeatureSet(points, crs="EPSG:32632"), ground[n:], true[n:]


def test_a_sheet_of_four_points_borrows_the_paper_of_its_neighbours() -> None:
    series = series_of([paper_sheet(15, seed)[0] for seed in range(6)], "")
    ratios = []
    for seed in range(10, 18):
        features, ground, image = paper_sheet(4, seed)
        borrowed = SHEET_OF_SERIES.fit(FitData.of(with_series_columns(features, series)))
        alone = termsel.fit(features, "poly2d", degree=1)
        errors = [np.sqrt(((fit.project(ground) - image) ** 2).sum(axis=1).mean())
                  for fit in (borrowed, alone)]
        ratios.append(errors[0] / errors[1])
    assert np.median(ratios) < 0.8
    assert "6 other sheets of the series lend it" in SHEET_OF_SERIES.describe(borrowed)


def test_sheets_of_unlike_scale_are_no_series(tmp_path: Path,
                                              caplog: pytest.LogCaptureFixture) -> None:
    features, ground, _ = paper_sheet(8, 20)
    maps = []
    for seed, scale in enumerate((0.5, 0.8, 1.3, 2.0)):
        other = paper_sheet(15, seed)[0]
        maps.append(other.with_(points=replace(other.points, image=scale * other.points.image)))
    lent = with_series_columns(features, series_of(maps, ""))
    reason = SHEET_OF_SERIES.declines(FitData.of(lent))
    assert reason is not None
    assert "differ by" in reason
    # Auto then takes the sheet by itself.
    alone, beside = (termsel.run(features=sheet).project(ground) for sheet in (features, lent))
    np.testing.assert_array_equal(alone, beside)
    file = tmp_path / "series.json"
    file.write_text(series_of(maps, "").text(), encoding="utf-8")
    termsel.write_points_csv(features.points, tmp_path / "sheet.csv")
    termsel.read(tmp_path / "sheet.csv", crs="local", series=str(file))
    assert "lends no paper" in caplog.text
    like = series_of([paper_sheet(15, seed)[0] for seed in range(4)], "")
    assert SHEET_OF_SERIES.declines(FitData.of(with_series_columns(features, like))) is None


def test_independent_points_do_not_tell_the_paper() -> None:
    features = [paper_sheet(8, seed)[0] for seed in range(3)]
    with_wild = [paper_sheet(8, seed, wild=True)[0] for seed in range(3)]
    assert series_of(with_wild, "") == series_of(features, "")


def test_the_numbers_of_a_sheet_are_those_of_its_matrix() -> None:
    values = np.array([-1.2, 2.9, 0.01, -0.02])
    np.testing.assert_allclose(values_of(matrix_of(values)), values, atol=1e-12)


def test_sheets_about_half_a_turn_have_a_mean_turn_there() -> None:
    sheets = [Sheet((0.0, turn, 0.0, 0.0), (1e-8,) * 4, 1.0, 10, ()) for turn in (3.13, -3.13)]
    assert abs(abs(paper_of(sheets).means[1]) - np.pi) < 0.01


def test_the_sheet_of_a_series_keeps_the_rules() -> None:
    series = series_of([paper_sheet(15, seed)[0] for seed in range(3)], "")
    features = [with_series_columns(paper_sheet(n, 10 + n)[0], series) for n in (4, 9)]
    for check in checks(SHEET_OF_SERIES, features=features):
        check.run()


def test_independent_points_take_no_part() -> None:
    features = sheet(10, 3)
    wild = features.points.image.copy()
    wild[7:] += 500.0
    roles = ("control",) * 7 + ("independent",) * 3
    other = replace(features, points=replace(features.points, image=wild, roles=roles))
    mine = replace(features, points=features.points.take(np.arange(10) < 7))
    candidates = candidate_projections(np.array([[2.0, 41.0], [14.0, 51.0]]), 20)[:3]
    assert choose_by_points([other], candidates) == choose_by_points([mine], candidates)


def with_blunder(features: FeatureSet, place: int, shift: tuple[float, float]) -> FeatureSet:
    """Return points of which one is clicked elsewhere in the image."""
    image = features.points.image.copy()
    image[place] += shift
    return features.with_(points=replace(features.points, image=image))


@pytest.mark.slow_cases("large-0", "large-3", "large-9", "small-0", "small-3")
@pytest.mark.parametrize("place", [0, 3, 9])
@pytest.mark.parametrize("shift", [(-40.0, 60.0), (900.0, 400.0)], ids=["small", "large"])
def test_a_map_with_a_blunder_takes_the_projection_of_its_other_points(
        place: int, shift: tuple[float, float]) -> None:
    candidates = candidate_projections(np.array([[2.0, 41.8], [14.0, 50.2]]), 19)
    features = sheet(10, 5)
    others = features.with_(points=features.points.take(np.arange(10) != place))
    wrong = choose_by_points([with_blunder(features, place, shift)], candidates)
    assert wrong == choose_by_points([others], candidates)
    assert wrong.chosen.rmse < 5.0


def test_a_blunder_on_a_sheet_is_not_taken_for_its_paper() -> None:
    features = paper_sheet(8, 3)[0]
    series = series_of([features, with_blunder(features, 2, (300.0, -200.0)),
                        features.with_(points=features.points.take(np.arange(8) != 2))], "")
    right, wrong, without = series.sheets
    assert wrong.values == without.values
    assert wrong.noise == without.noise < 2.0 * right.noise


@pytest.mark.parametrize("number", range(5))
@pytest.mark.parametrize("crs", [BONNE, POLYCONIC])
def test_four_points_that_fit_several_projections_by_chance_take_a_middle_one(
        crs: str, number: int) -> None:
    """Not the one of them all that fits best, from which the others may be far."""
    features = series_sheet(crs, number, 4, 1.5)
    candidates = candidates_of([features], None, None)
    choice = choose_by_points([features], candidates)
    assert len(choice.as_probable) > 5
    assert choice.chosen in choice.as_probable
    corner = np.array([1.2 + 0.75 * (number % 4), 47.0 + 0.45 * (number // 4)])
    degrees = corner + np.random.default_rng(9).uniform(0.0, 1.0, (50, 2)) * [0.6, 0.36]
    ground = np.column_stack([degrees, np.zeros(50)])

    def seen_in(other: str) -> FloatArray:
        return termsel.fit(replace(features, fit_crs=other), "poly2d", degree=1).project(ground)

    from_true = [np.sqrt(((seen_in(other.crs) - seen_in(crs))**2).sum(axis=1).mean())
                 for other in choice.as_probable]
    place = choice.as_probable.index(choice.chosen)
    assert from_true[place] < 0.6 * max(from_true)
    assert from_true[place] < 1.0


def test_many_points_of_a_map_show_its_projection() -> None:
    features = series_sheet(SINUSOIDAL, 6, 5, 0.5)
    candidates = [Projection(crs, crs) for crs in (BONNE, MERCATOR, POLYCONIC, SINUSOIDAL)]
    choice = choose_by_points([features], candidates)
    assert choice.as_probable == (choice.chosen,)
    assert choice.chosen.crs == SINUSOIDAL


def test_paper_is_hardly_stretched() -> None:
    """Four points of a map fit each affine map of it; its projection gives the paper no stretch."""
    flat = "+proj=eqc +lat_ts=47 +lon_0=2 +datum=WGS84 +units=m +no_defs"
    square = "+proj=eqc +lat_ts=0 +lon_0=2 +datum=WGS84 +units=m +no_defs"
    for crs in (flat, square):
        features = series_sheet(crs, 0, 1, 0.5)
        choice = choose_by_points([features], [Projection("flat", flat),
                                               Projection("square", square)])
        assert choice.chosen.crs == crs
        assert choice.as_probable == (choice.chosen,)


def test_the_screen_says_that_points_do_not_tell_projections_apart(tmp_path: Path) -> None:
    few = table(series_sheet(BONNE, 0, 2, 1.5), tmp_path / "few.csv")
    said = invoke("run", "--points", few, "--crs", "auto").stderr
    assert "of 15 projections the points do not tell " in said
    assert "its map differs least from those in the others, by " in said


def test_a_century_has_its_projections(tmp_path: Path) -> None:
    place = np.array([[2.0, 41.0], [14.0, 51.0]])
    assert "Bonne" in {one.name for one in candidate_projections(place, 19)}
    assert "UTM 32N" not in {one.name for one in candidate_projections(place, 19)}
    (tmp_path / "wrong.txt").write_text("EPSG:4326\nnonsense\n", encoding="utf-8")
    with pytest.raises(TermselError) as refused:
        projections_of_file(tmp_path / "wrong.txt")
    assert refused.value.line == 2


@pytest.mark.slow
def test_a_batch_of_maps_chooses_among_candidates_of_a_file(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    candidates = tmp_path / "mine.txt"
    candidates.write_text(EVERY, encoding="utf-8")
    (tmp_path / "maps").mkdir()
    for seed in range(2):
        table(sheet(6, seed), tmp_path / "maps" / f"{seed}.csv")
    done = invoke("compare", "--points", tmp_path / "maps" / "*.csv", "--crs", "auto",
                  "--candidates", candidates, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    assert caplog.text.count("of 3 projections conic predicts the points best") == 2


def test_candidates_are_of_files(tmp_path: Path) -> None:
    refused = invoke("compare", "--problem", "rfm-terms", "--candidates", tmp_path / "mine.txt",
                     "--out", tmp_path / "out")
    assert refused.exit_code == 2
    assert "--candidates requires --points or --lines" in refused.stderr


def test_a_projection_on_an_ellipsoid_without_a_datum_is_one_of_a_map(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    bonne = "+proj=bonne +lat_1=46 +lon_0=8 +a=6376523 +rf=308.64 +units=m +no_defs"
    path = table(sheet(6, 0), tmp_path / "map.csv")
    control = termsel.read(path, crs="EPSG:4326", projection=bonne)
    fitted = termsel.fit(control, "poly2d", degree=1)
    places = control.points.ground
    np.testing.assert_allclose(fitted.locate(fitted.project(places), np.zeros(6))[:, :2],
                               places[:, :2], atol=1e-7)
    assert "no datum" not in caplog.text
    # For all other uses a note says that where this is on the Earth is not known well.
    transformation_between(bonne.replace("+lat_1=46", "+lat_1=46.25"), "EPSG:4979")
    # PROJ calls a CRS without a name unknown, which names nothing; its method does.
    assert "Note: the CRS custom Bonne has an ellipsoid and no datum" in caplog.text
