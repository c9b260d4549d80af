"""Charts, pictures and pages of results: what they show is what the record says."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli import plot
from termsel.cli.main import cli
from termsel.data.record.figures import as_plain_data
from termsel.results import library
from termsel.results.charts import maps
from termsel.results.plots import KINDS
from termsel.results.repeat import reason_for_no_command, repeating_command

altair = pytest.importorskip("altair")
pytest.importorskip("vl_convert")

Call = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a search with a front."""
    folder = tmp_path_factory.mktemp("searched") / "result"
    termsel.run("rfm-terms", solver="nsga2", evaluations=2000, out=folder)
    return folder


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a selection of lines, with blunders among them."""
    folder = tmp_path_factory.mktemp("lines") / "result"
    termsel.run("owdis-lines", evaluations=2000, out=folder)
    return folder


@pytest.fixture(scope="module")
def empires() -> termsel.Result:
    """Return a search by empires."""
    return termsel.run("poly-terms", solver="ica", evaluations=600, options={"population": 40})


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a selection repeated with other points."""
    folder = tmp_path_factory.mktemp("repeated") / "result"
    done = CliRunner().invoke(cli, [
        "stability", "--problem", "poly-terms", "--set", "degree=2", "--evaluations", "60",
        "--repeats", "3", "--quiet", "--report", "--out", str(folder)])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture(scope="module")
def chosen() -> termsel.Result:
    """Return a choice by auto."""
    return termsel.run("poly-terms")


def rows_of(chart: object) -> dict[str, list[dict[str, object]]]:
    """Return all data of a chart."""
    return chart.to_dict()["datasets"]  # type: ignore[attr-defined]


def test_an_arrow_is_measured_minus_computed(searched: Path) -> None:
    result = termsel.read_result(searched)
    points = result.features.points
    error = points.image - result.fit.project(points.ground)
    drawn = {row["id"]: row for row in result.view.in_image}
    assert set(drawn) == {name for name, role in zip(points.ids, points.roles, strict=True)
                          if role != "off"}
    for name, place, (line, sample) in zip(points.ids, points.image, error, strict=True):
        if name in drawn:
            assert (drawn[name]["line"], drawn[name]["sample"]) == pytest.approx(tuple(place))
            assert (drawn[name]["dl"], drawn[name]["ds"]) == pytest.approx((line, sample), rel=1e-3)


def test_arrows_end_at_the_rim_of_the_map() -> None:
    rows = [{"x": 1.0, "y": 1.0, "dx": 0.1, "dy": 0.0}]
    extent = maps.Extent((0.0, 2.0), (0.0, 2.0), 5.0)
    assert not extent.cuts(rows, ("x", "y"), ("dx", "dy"))
    assert extent.cuts([{**rows[0], "dy": -0.3}], ("x", "y"), ("dx", "dy"))


def test_the_map_on_the_ground_is_in_metres(searched: Path) -> None:
    result = termsel.read_result(searched)
    independent = [row["metres"] for row in result.view.on_ground if row["role"] == "independent"]
    assert result.accuracy is not None
    assert result.accuracy.ground is not None
    assert np.sqrt(np.mean(np.square(independent))) == pytest.approx(
        result.accuracy.ground.total, rel=1e-3)


def test_members_of_a_front_have_the_errors_that_the_record_says(searched: Path) -> None:
    view = termsel.read_result(searched).view
    front = view.record.front
    assert len(front) > 3
    for i, said in enumerate(front):
        for role in ("check", "independent"):
            squares = [(row["dls"][i] ** 2 + row["dss"][i] ** 2) * view.unit**2
                       for row in view.members if row["role"] == role]
            assert np.sqrt(np.mean(squares)) == pytest.approx(
                getattr(said.rmse, role).total, rel=5e-3)


@pytest.mark.slow
def test_every_chart_is_one_altair_chart_that_says_what_to_look_for(
        searched: Path, chosen: termsel.Result, empires: termsel.Result, repeated: Path) -> None:
    drawn = set()
    for result in (termsel.read_result(searched), chosen, empires,
                   termsel.read_result(repeated)):
        for kind in KINDS.values():
            if kind.missing(result.view):
                with pytest.raises(termsel.TermselError, match=f"no chart {kind.name}"):
                    getattr(result.plot, kind.name)()
                continue
            if kind.name in drawn:
                continue
            chart = getattr(result.plot, kind.name)()
            assert isinstance(chart, altair.TopLevelMixin)
            spec = chart.to_dict()
            assert spec["title"]["text"] == kind.title
            caption = kind.caption(result.view)
            assert caption.startswith(kind.look)
            assert " ".join(spec["title"]["subtitle"]).startswith(caption)
            drawn.add(kind.name)
    assert drawn == set(KINDS) == set(plot.CHART_NAMES)


def test_the_bands_of_empires_are_their_countries(empires: termsel.Result) -> None:
    shown = max(rows_of(empires.plot.empires()).values(), key=len)
    history = empires.history
    assert len(shown) == sum(len(one.empires) for one in history)
    for one in history:
        assert sum(one.empires) == 40
        assert [row["countries"] for row in shown
                if row["evaluations"] == one.evaluations] == list(one.empires)


def test_who_enables_a_renderer_of_altair_gets_it(chosen: termsel.Result) -> None:
    drawn = chosen.plot.candidates()
    with altair.renderers.enable("mimetype"):
        shown = drawn._repr_mimebundle_()
    assert any("vegalite" in kind for part in (shown if isinstance(shown, tuple) else (shown,))
               for kind in part)


def test_a_page_that_was_written_is_to_be_opened(tmp_path: Path) -> None:
    folder = tmp_path / "result"
    done = CliRunner().invoke(cli, [
        "run", "--dataset", "ikonos-hamedan", "--method", "affine", "--report", "--out",
        str(folder)])
    assert f"Next: open {folder / 'report.html'}" in done.output


def test_frequencies_are_those_of_the_selections(searched: Path, repeated: Path) -> None:
    front = termsel.read_result(searched)
    shown = {row["term"]: row["share"]
             for row in max(rows_of(front.plot.frequency()).values(), key=len)}
    members = [set(one.selection.terms) for one in front.front]
    assert set(shown) == set.union(*members)
    for term, share in shown.items():
        assert share == pytest.approx(sum(term in one for one in members) / len(members), abs=1e-4)
    said = json.loads((repeated / "stability.json").read_text())
    again = termsel.read_result(repeated)
    assert again.stability is not None
    assert again.stability.frequency == said["frequency"]
    assert list(again.selection.terms) == said["stable"]
    page = (repeated / "report.html").read_text()
    assert "terms are in at least 60% of 3 selections" in page
    shown = {row["term"]: row for row in max(rows_of(again.plot.frequency()).values(), key=len)}
    assert {term for term, row in shown.items() if row.get("used")} == set(said["stable"])
    assert all(row["share"] == pytest.approx(said["frequency"][term], abs=1e-4)
               for term, row in shown.items())


def test_baselines_show_the_record(chosen: termsel.Result) -> None:
    shown = max(rows_of(chosen.plot.baselines()).values(), key=len)
    here = {(row["fit"], row["role"]): row["rmse"] for row in shown}
    assert here["this result", "independent"] == chosen.rmse["independent"].total
    assert len(here) == 2 * (len(chosen.baselines) + 1)


def test_blunders_stand_first_and_are_marked(lines: Path) -> None:
    result = termsel.read_result(lines)
    blunders = {one.id for one in result.outliers}
    assert blunders
    worst = result.view.worst[:len(blunders)]
    assert {row["id"] for row in worst} == blunders
    assert all(row["blunder"] for row in worst)


@pytest.mark.slow
def test_blunders_that_auto_leaves_out_are_shown() -> None:
    features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    points = features.points
    image = points.image.copy()
    image[[3, 30]] += 40.0
    result = termsel.run("poly-terms", features=features.with_(points=termsel.Points(
        points.ids, image, points.ground, points.sigma, points.roles)))
    out = {one.id for one in result.outliers}
    assert {points.ids[3], points.ids[30]} <= out
    shown = {row["id"]: row for row in result.view.worst if row["blunder"]}
    assert set(shown) == out
    assert min(row["distance"] for row in shown.values()) > 20


@pytest.mark.parametrize(("suffix", "head"), [
    ("svg", b"<svg"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_a_picture_is_written(call: Call, searched: Path, tmp_path: Path, suffix: str,
                              head: bytes) -> None:
    picture = tmp_path / f"picture.{suffix}"
    assert call("plot", searched, "terms", "-o", picture).exit_code == 0
    assert picture.read_bytes().startswith(head)
    again = call("plot", searched, "terms", "-o", picture)
    assert again.exit_code == 2
    assert "already exists" in again.stderr
    assert call("plot", searched, "terms", "-o", picture, "--overwrite").exit_code == 0


@pytest.mark.parametrize(("words", "says"), [
    (("{}", "terms", "-o", "x.gif"), ".svg, .png or .pdf"),
    (("{}", "terms", "-o", "x"), ".svg, .png or .pdf"),
    (("{}", "termz", "-o", "x.svg"), "terms"),
    (("terms", "{}", "-o", "x.svg"), "Error: DIR comes before KIND: termsel plot "),
    (("{}", "candidates", "-o", "x.svg"), "it was not chosen automatically (strategy auto)"),
    (("nowhere", "terms", "-o", "x.svg"), "there is no result here"),
    (("{}", "terms", "-o", "-"), "cannot write to stdout"),
    (("{}", "terms", "-o", "no/folder/x.svg"), "there is no such folder"),
])
def test_a_mistake_is_said_in_one_sentence(call: Call, searched: Path, tmp_path: Path,
                                           monkeypatch: pytest.MonkeyPatch,
                                           words: tuple[str, ...], says: str) -> None:
    monkeypatch.chdir(tmp_path)
    done = call("plot", *(word.format(searched) for word in words))
    assert done.exit_code == 2
    assert says in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("module", "words"), [
    ("altair", ("plot", "{}", "terms", "-o", "{out}.svg")),
    ("altair", ("report", "{}", "-o", "{out}.html")),
    ("vl_convert", ("plot", "{}", "terms", "-o", "{out}.svg"))])
def test_without_the_extra_the_message_names_it(
        call: Call, searched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str,
        words: tuple[str, ...]) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    done = call(*(word.format(searched, out=tmp_path / "x") for word in words))
    assert done.exit_code == 2
    assert 'pip install "termsel[report]"' in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_run_writes_its_report(call: Call, tmp_path: Path) -> None:
    words = ("run", "--problem", "poly-terms", "--solver", "random", "--evaluations", "200",
             "--quiet", "--report")
    assert "--report requires --out" in call(*words).stderr
    assert call(*words, "--out", tmp_path / "r").exit_code == 0
    page = tmp_path / "r" / "report.html"
    assert "How accurate is it?" in page.read_text()
    assert "already exists" in call("report", tmp_path / "r").stderr
    assert call("report", tmp_path / "r", "--overwrite").exit_code == 0
    assert "would replace it" in call("report", tmp_path / "r", "--overwrite", "-o",
                                      tmp_path / "r" / "result.json").stderr


def test_the_six_answers_come_in_order(searched: Path, tmp_path: Path) -> None:
    result = termsel.read_result(searched)
    result.report(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert re.findall(r"<h2[^>]*>(.*?)</h2>", text[:text.index("<script")]) == [
        "How accurate is it?", "Is it better than conventional models?",
        "Which points or lines are outliers?", "In which areas is the model uncertain?",
        "Which terms and features were selected, and why?", "How can it be repeated?"]
    assert f"RMSE {result.rmse['independent'].total:.3g} px" in text
    assert f"{result.accuracy.ground.total:.3g} m on the ground" in text  # type: ignore[union-attr]
    sums = json.loads((searched / "result.json").read_text())["checksums"]
    assert all(f">{value}</td>" in text for value in sums.values())
    shown = text[:text.index("<script")]
    assert "termsel report" not in shown  # it is that report
    assert "Not saved" not in shown
    with pytest.raises(termsel.TermselError, match="already exists"):
        result.report(tmp_path / "page.html")


@pytest.mark.slow
def test_the_page_allows_nothing_but_itself(searched: Path, tmp_path: Path) -> None:
    termsel.read_result(searched).report(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy[1]
    head = text[:text.index("<script>")]
    assert not re.search(r"(?:src|href)=[\"']?(?:https?:|//)", head)


@pytest.mark.slow
def test_a_page_of_a_thousand_features_is_small(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    middle = rng.uniform(0, 4000, (1000, 1, 2))
    ground = np.concatenate([middle + rng.normal(0, 60, (1000, 2, 2)),
                             rng.uniform(0, 300, (1000, 2, 1))], axis=2)
    image = ground[..., :2] * [0.5, -0.5] + [0, 2000] + rng.normal(0, 0.5, (1000, 2, 2))
    lines = termsel.Lines([f"road line {i}" for i in range(1000)], image, ground)
    places = np.column_stack([rng.uniform(0, 4000, (60, 2)), rng.uniform(0, 300, 60)])
    points = termsel.Points(
        [f"point {i}" for i in range(60)],
        places[:, :2] * [0.5, -0.5] + [0, 2000] + rng.normal(0, 0.5, (60, 2)), places,
        roles=("check", "independent") * 30)
    result = termsel.run("owdis-lines", solver="nsga2", evaluations=1000,
                         features=termsel.FeatureSet(points, lines, crs="EPSG:32639"))
    assert len(result.front) > 8
    result.report(tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size < 3e6


def test_of_many_residuals_the_largest_and_some_others_are_shown(
    chosen: termsel.Result, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("termsel.results.view.DRAWN", 30)
    monkeypatch.setattr("termsel.results.view.LARGEST_RESIDUALS", 10)
    count, largest = len(chosen.residuals), sorted(r.distance for r in chosen.residuals)[-10:]
    step = -(-count // 20)
    fresh = chosen.with_()  # what is shown is kept
    view = fresh.view
    assert 20 <= len(view.in_image) == len(view.on_ground) <= 30 < count
    assert {row["id"] for row in view.worst} <= {row["id"] for row in view.in_image}
    np.testing.assert_allclose([row["distance"] for row in view.worst], largest[::-1], rtol=1e-3)
    fresh.report(tmp_path / "page.html")
    said = (f"Shown are the 10 largest of {count} residuals, and one in {step} of all. The file "
            "residuals.csv has all of them.")
    assert (tmp_path / "page.html").read_text().count(said) == 2



@pytest.mark.slow_cases("lines", "searched")
@pytest.mark.parametrize("fixture", ["searched", "lines", "repeated"])
def test_the_command_repeats_the_run(call: Call, request: pytest.FixtureRequest, fixture: str,
                                     monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = request.getfixturevalue(fixture)
    monkeypatch.chdir(folder)
    record = json.loads((folder / "result.json").read_text())
    words = shlex.split(repeating_command(termsel.read_result(folder)).replace("\\\n", " "))
    assert call(*words[1:], "--quiet", "--out", tmp_path / "again").exit_code == 0
    again = json.loads((tmp_path / "again" / "result.json").read_text())
    for key in ("terms", "features"):
        assert sorted(again["selection"][key]) == sorted(record["selection"][key])
    for role, figures in record["rmse"].items():
        if figures["n"]:
            assert again["rmse"][role] == pytest.approx(figures, rel=1e-9)
    assert again["budget"] == record["budget"]
    assert again["evaluations"] == record["evaluations"]


@pytest.mark.slow
def test_the_command_repeats_a_run_with_an_rpc_and_an_image(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, example_files: Path) -> None:
    shutil.copytree(example_files, tmp_path / "files")
    monkeypatch.chdir(tmp_path / "files")
    features = termsel.read("gcps.csv", rpc="vendor.RPB", image="scene.tif")
    first = termsel.run(features=features, problem="rpc-gcps", evaluations=50, out="r")
    assert "--rpc result.json" in repeating_command(first)
    monkeypatch.chdir("r")
    again = termsel.read("points.csv", crs="EPSG:4979", rpc="result.json")
    assert again.image_size == first.features.image_size == (500, 600)
    assert again.rpc == first.features.rpc
    (tmp_path / "files" / "r" / "result.json").write_text('{"schema": 1, "data": {"rpc": {}}}')
    with pytest.raises(termsel.TermselError, match="the RPC in this result was changed"):
        termsel.read_rpc("result.json")


@pytest.mark.slow
def test_budgets_are_in_the_record_and_the_command(tmp_path: Path) -> None:
    result = termsel.run("poly-terms", solver="random", generations=np.int64(7), seconds=95,
                         patience=30, out=tmp_path / "r")
    assert as_plain_data(result.budget) == {"generations": 7, "seconds": 95.0, "patience": 30}
    record = json.loads((tmp_path / "r" / "result.json").read_text())
    assert record["budget"] == as_plain_data(result.budget)
    assert "--generations 7 " in repeating_command(result)
    assert repeating_command(result).replace("\\\n", " ").split()[-6:] == [
        "--generations", "7", "--seconds", "95", "--patience", "30"]
    result.report(tmp_path / "page.html")
    assert "so the result depends on the machine" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_what_no_command_repeats_is_said(tmp_path: Path) -> None:
    from termsel.selection.solvers.heuristics.yardsticks import RandomSearch

    class Own(RandomSearch):
        """Random search of one's own."""

        name = "own-search"

    result = termsel.run("poly-terms", solver=Own, evaluations=50)
    result.report(tmp_path / "own.html")
    text = (tmp_path / "own.html").read_text()
    assert ("No command repeats this run, as no plugin provides its solver "
            "tests.report.test_report") in text
    assert "termsel run \\" not in text
    task = termsel.prepare("poly-terms")
    genes = task.problem.genome.random(np.random.default_rng(1), 1)[0]
    result = termsel.assess(termsel.GivenGenes(genes), task)
    assert "genes were given" in reason_for_no_command(result)


@pytest.mark.slow
def test_the_image_lies_below_the_residuals(searched: Path, call: Call, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    size = json.loads((searched / "result.json").read_text())["data"]["image_size"]
    for name, (high, wide) in (("right", size), ("wrong", (50, 60))):
        with rasterio.open(tmp_path / f"{name}.tif", "w", driver="GTiff", height=high, width=wide,
                           count=1, dtype="uint8", compress="deflate") as image:
            image.write(np.zeros((high, wide), dtype="uint8"), 1)
    page = tmp_path / "page.html"
    wrong = call("report", searched, "-o", page, "--image", tmp_path / "wrong.tif")
    assert wrong.exit_code == 2
    assert "Give the image that the points were measured in" in wrong.stderr
    assert not page.exists()
    assert call("report", searched, "-o", page, "--image", tmp_path / "right.tif").exit_code == 0
    assert "data:image/jpeg;base64," in page.read_text()


def test_the_drawing_library_is_put_together_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = list[str]()
    monkeypatch.setattr(library, "drawing_bundle",
                        lambda snippet: made.append(snippet) or "draw('</script>é\r\n')")
    monkeypatch.setattr(library, "_CACHE_FOLDER", tmp_path / "kept")

    def text() -> str:
        library.read_library.cache_clear()
        return library.read_library()

    try:
        for _ in range(2):
            assert text() == "draw('<\\/script>é\r\n')"
        assert len(made) == 1
        (kept,) = (tmp_path / "kept").iterdir()
        for damaged in (b"", b"alert(1)", kept.read_bytes()[:-1]):
            kept.write_bytes(damaged)
            assert text() == "draw('<\\/script>é\r\n')"
        assert len(made) == 4
        kept.unlink()
        kept.parent.rmdir()
        kept.parent.write_text("no folder")  # nothing can be kept
        assert text() == text() == "draw('<\\/script>é\r\n')"
        assert len(made) == 6
    finally:
        library.read_library.cache_clear()
