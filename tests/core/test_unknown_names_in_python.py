"""Calls from Python that cannot be: arguments and names of termsel say which one was meant."""

import re
import traceback
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
import pytest

import termsel
import termsel.toolkit
from termsel.core.remedies import ReadRemedy, Remedy, called_in_python, in_python


@pytest.mark.parametrize(("arguments", "words"), [
    ({"points": "gcps.csv"}, "features='gcps.csv'"),
    ({"rcp": "vendor.RPB"}, "Did you mean rpc?"),
    # What the command line sets by --set, and by options of its own.
    ({"population": 1}, "options={'population': 1}"),
    ({"fit_crs": "polar"}, "options={'fit_crs': 'polar'}"),
    ({"off": "P1"}, "options={'off': 'P1'}"),
    # What reading takes, options of readers included.
    ({"dem": "dem.tif"}, "termsel.read(FILE, dem='dem.tif')"),
    ({"raster": "map.tif"}, "termsel.read(FILE, raster='map.tif')"),
    ({"lines": "lines.csv"}, "termsel.read(FILE, 'lines.csv')"),
    ({"report": True}, "result.report('report.html')"),
    ({"whatever": 1}, "Its arguments are problem, features, crs,")])
def test_an_unknown_argument_of_run_says_what_is_meant(arguments: dict, words: str) -> None:
    name = next(iter(arguments))
    with pytest.raises(TypeError, match=re.escape(f"run() has no argument '{name}'.")) as caught:
        termsel.run(**arguments)
    assert words in str(caught.value)
    with pytest.raises(TypeError, match=re.escape("prepare() has no argument")):
        termsel.prepare("poly-terms", **arguments)


@pytest.mark.parametrize(("function", "argument", "words"), [
    ("rectify", "out", "Did you mean output?"),
    ("read_result", "path", "Its arguments are folder."),
    ("simulate_scene", "points", "Did you mean n_points?"),
    ("read_rpc", "pat", "Did you mean path?"), ("search", "second", "Did you mean seconds?")])
def test_other_functions_name_the_nearest_argument(
        function: str, argument: str, words: str) -> None:
    with pytest.raises(TypeError, match=re.escape(f"{function}() has no argument '{argument}'. "
                                                  f"{words}")):
        getattr(termsel, function)(**{argument: 1})


@pytest.mark.parametrize(("name", "meant"), [
    ("Run", "run"), ("load", "read_result"), ("open", "read_result"),
    ("read_results", "read_result"), ("Results", "Result"), ("Point", "Points")])
def test_an_unknown_name_of_the_module_says_which_is_meant(name: str, meant: str) -> None:
    with pytest.raises(AttributeError, match=re.escape(
            f"termsel has no '{name}'. Did you mean {meant}?")):
        getattr(termsel, name)


def test_python_adds_no_guess_of_its_own() -> None:
    with pytest.raises(AttributeError) as caught:
        _ = termsel.Run
    shown = "".join(traceback.format_exception(caught.value))
    assert shown.count("Did you mean") == 1


@pytest.mark.parametrize(("values", "words"), [
    (("gcps.csv", "vendor.RPB"), "features='gcps.csv', an RPC is rpc='vendor.RPB'"),
    (("poly-terms", "gcps.csv"), "Points and lines are features='gcps.csv'.")])
def test_run_says_the_names_of_files_given_by_position(values: tuple, words: str) -> None:
    with pytest.raises(TypeError, match="takes 1 argument by position, not 2") as caught:
        termsel.run(*values)
    assert words in str(caught.value)


def test_other_functions_say_which_arguments_have_a_place() -> None:
    with pytest.raises(TypeError, match=re.escape(
            "rectify() takes 3 arguments by position, not 4. By position: result, image, output. "
            "Give others by name: dem=, ")):
        termsel.rectify("result", "scene.tif", "map.tif", "dem.tif")


def test_the_beginning_of_a_name_comes_before_a_name_that_looks_alike() -> None:
    # The result has been given.
    with pytest.raises(TypeError, match=re.escape("Did you mean resolution or resampling?")):
        termsel.rectify("result", "scene.tif", "map.tif", res=10)


@pytest.mark.parametrize("verb", ["export", "rectify", "write_result"])
def test_the_name_of_a_folder_in_place_of_a_result_is_to_be_read(verb: str) -> None:
    further = {"export": ("rpb", "x.RPB"), "rectify": ("scene.tif", "map.tif"),
               "write_result": ("other",)}[verb]
    with pytest.raises(termsel.TermselError, match=re.escape(
            f"termsel.{verb}(termsel.read_result('result'), ...)")):
        getattr(termsel, verb)("result", *further)
    with pytest.raises(termsel.TermselError, match="takes a result, not an object of the type int"):
        getattr(termsel, verb)(5, *further)


@pytest.mark.parametrize(("arguments", "words"), [
    ({"seed": "one"}, "seed is 'one', expected a whole number from 0"),
    ({"seed": -1}, "seed is -1, expected"), ({"seed": 1.0}, "seed is 1.0, expected"),
    ({"seed": True}, "seed is True, expected"), ({"seed": 2**63}, "expected a whole number from 0"),
    ({"out": 5}, "out is 5, expected the name of a folder"),
    ({"checkpoint": 5}, "checkpoint is 5, expected the name of a file"),
    ({"overwrite": "no"}, "overwrite is 'no', expected True or False"),
    ({"options": [("degree", 2)]}, "options is of the type list, expected a dict"),
    ({"observers": 5}, "observers is 5, expected a list of functions"),
    ({"columns": 5}, "columns is 5, expected a text or a dict"),
    ({"rpc": 5}, "rpc is 5, expected the name of a file"),
    ({"source": 5}, "source is 5, expected a text"),
    ({"memory": "result"}, "memory is 'result', expected a termsel.Memory"),
    ({"generations": "5"}, "the budget of generations is '5', not a number"),
    ({"seconds": "3s"}, "the budget of seconds is '3s', not a number")])
def test_run_refuses_a_value_of_the_wrong_kind_before_it_reads(
        arguments: dict, words: str) -> None:
    # The file is not there: what is wrong with the argument is said first.
    with pytest.raises(termsel.TermselError, match=re.escape(words)):
        termsel.run(features="nowhere.csv", **arguments)


def test_messages_to_python_name_arguments_and_no_options(tmp_path: Path) -> None:
    table = tmp_path / "points.csv"
    table.write_text("id,x,y,line,sample\n" + "".join(
        f"P{i},{500000 + 7 * i * i},{4000000 + 90 * i},{i * 3},{i * i}\n" for i in range(9)))
    out = tmp_path / "result"
    result = termsel.run("poly-terms", generations=1, out=out)
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: termsel.run(features=table), "State it with crs: EPSG:4979"),
        (lambda: termsel.read(table, crs="EPSG:32639", columns={"x": "east"}), "column 'east'"),
        (lambda: termsel.run("poly-terms", generations=1, out=out), "add overwrite=True"),
        (lambda: termsel.export(result, "points-csv", table), "add overwrite=True"),
        (lambda: termsel.rectify(result, table, tmp_path / "map.tif", resolution=np.nan),
         "the resolution of a map cannot be nan"),
        (lambda: termsel.read(), "Give points=FILE, lines=FILE or areas=FILE")]
    for call, words in calls:
        with pytest.raises(termsel.TermselError, match=re.escape(words)) as caught:
            call()
        assert "--" not in str(caught.value)


@pytest.mark.parametrize(("text", "words"), [
    ("Leave --crs out, or state --crs EPSG:4979.", "Leave crs out, or state crs='EPSG:4979'."),
    ("Give --dem FILE or --height 12.5.", "Give termsel.read(TABLE, dem=FILE) or height=12.5."),
    ("Add --set swapped=xy; --no-final takes it", "Add swapped='xy'; final=False takes it"),
    ("Give the role by --role ID=control, or measure.", "Give the role by role='ID=control', or "
                                                        "measure."),
    ("Of many: termsel compare --points 'a/*.csv' --out DIR. Leave --points out.",
     "Of many: termsel compare --points 'a/*.csv' --out DIR. Leave features out.")])
def test_options_become_arguments(text: str, words: str) -> None:
    assert in_python(text, ("features", "crs", "options", "out")) == words


@pytest.mark.parametrize(("remedy", "typed", "in_read"), [
    (Remedy("solver", "exact"), "--solver exact", "solver='exact'"),
    (Remedy("crs", "EPSG:4979"), "--crs EPSG:4979", "crs='EPSG:4979'"),
    (Remedy("overwrite"), "--overwrite", "overwrite=True"), (Remedy("dem"), "--dem", "dem"),
    (Remedy("points", "FILE"), "--points FILE", "features=FILE"),
    (ReadRemedy("swapped", "xy"), "--set swapped=xy", "swapped='xy'")])
def test_a_remedy_is_typed_as_its_reader_types(remedy: object, typed: str, in_read: str) -> None:
    assert str(remedy) == typed
    with called_in_python("read", ("features", "crs")):
        assert str(remedy) == in_read


def test_notes_to_python_name_arguments(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    table = tmp_path / "points.csv"
    scene = FEATURES.points
    table.write_text("# crs: EPSG:4979\nid,x,y,z,line,sample\n" + "".join(
        f"P{i},{y!r},{x!r},{z!r},{line!r},{sample!r}\n" for i, ((x, y, z), (line, sample)) in
        enumerate(zip(scene.ground.tolist(), scene.image.tolist(), strict=True))))
    termsel.run(features=table)
    assert "termsel.read(FILE, swapped='xy') exchanges them" in caplog.text
    assert "--" not in caplog.text


@pytest.mark.parametrize("of", [lambda: RESULT.fit, lambda: RESULT])
def test_places_far_outside_the_control_are_told(
        of: Callable[[], termsel.Fit], caplog: pytest.LogCaptureFixture) -> None:
    ground = RESULT.fit.control.points.ground[:3]
    of().project(ground)
    assert not caplog.text
    exchanged = ground[:, [1, 0, 2]]
    of().project(exchanged)
    assert "3 rows are far outside the control, and the model is not valid there" in caplog.text
    assert "x and y look exchanged" in caplog.text
    caplog.clear()
    of().project(ground + np.array([9.0, 9.0, 0.0]))
    assert "far outside" in caplog.text
    assert "exchanged" not in caplog.text


FEATURES = termsel.simulate_scene("ikonos-hamedan")
RESULT = termsel.run("poly-terms", generations=1)


@pytest.mark.parametrize(("call", "words"), [
    (lambda: termsel.read(5.0), "features cannot be read from the type float"),
    (lambda: termsel.read("a.csv", lines=5), "lines is 5, expected the name of a file"),
    (lambda: termsel.read("a.csv", off=["A"]), "off is of the type list, expected a text"),
    (lambda: termsel.export(RESULT, 5, "a.RPB"), "to is 5, expected a name"),
    (lambda: termsel.rectify(RESULT, "a.tif", "b.tif", bounds=5),
     "bounds is 5, expected 4 numbers"),
    (lambda: termsel.rectify(RESULT, "a.tif", "b.tif", height="1 m"),
     "height is '1 m', expected a number"),
    (lambda: termsel.read_result(None), "folder is None, expected the name of a folder"),
    (lambda: termsel.simulate_scene("ikonos-hamedan", n_points=1.5),
     "n_points is 1.5, expected a whole number"),
    (lambda: termsel.compare(workers="2"), "workers is '2', expected a whole number"),
    (lambda: termsel.write_rpc("a.RPB", "b.RPB"), "rpc is 'a.RPB', expected a termsel.Rpc"),
    (lambda: termsel.rpc_of(5), "fitted is 5, expected a termsel.Fit"),
    (lambda: RESULT.project("here"), "ground is 'here', expected an array of numbers"),
    (lambda: RESULT.locate([[1.0, 2.0]], "high"),
     "the heights are 'high', expected numbers, or a function such as an open DEM"),
    (lambda: RESULT.fit.rmse([1.0]), "points is of the type list, expected a termsel.Points. "
                                     "termsel.read(FILE).points makes one"),
    (lambda: termsel.to_pymoo("poly-terms"), "expected a termsel.Problem. termsel.prepare(")])
def test_an_argument_of_the_wrong_kind_is_named(call: Callable[[], object], words: str) -> None:
    with pytest.raises(termsel.TermselError, match=re.escape(words)):
        call()


@pytest.mark.parametrize(("call", "words"), [
    (lambda: termsel.export("a.RPB", RESULT), "export() lacks path: export(result, to, path)."),
    (lambda: termsel.get("affine"), "get() lacks name: get(kind, name)."),
    (lambda: termsel.export(RESULT), "export() lacks to and path: export(result, to, path)."),
    (lambda: RESULT.plot("residuals"), "plot is no function"),
    (lambda: RESULT.plot.residuals("a.svg"), "residuals() takes 0 arguments by position, not 1. It "
                                             "returns a chart of Altair")])
def test_a_call_that_cannot_be_says_what_can(call: Callable[[], object], words: str) -> None:
    with pytest.raises(TypeError, match=re.escape(words)):
        call()


@pytest.mark.parametrize(("get", "words"), [
    (lambda: RESULT.predict, "Result has no 'predict'. Image positions are result.project("),
    (lambda: RESULT.export, "termsel.export(result, FORMAT, PATH) writes it"),
    (lambda: RESULT.plott, "Did you mean plot?"),
    (lambda: RESULT.fit.predict, "Image positions are fit.project(ground)"),
    (lambda: FEATURES.x, "It is features.points.ground[:, 0]."),
    (lambda: FEATURES.points.lat, "It is points.ground[:, 1].")])
def test_a_missing_attribute_says_where_it_is(get: Callable[[], object], words: str) -> None:
    with pytest.raises(AttributeError, match=re.escape(words)):
        get()


def test_a_seed_of_numpy_is_a_seed() -> None:
    result = termsel.run("poly-terms", seed=np.int64(3), generations=np.int64(1))
    assert result.seed == 3


@pytest.mark.parametrize("errors", [[1.0, 2.0, 3.0], [[1.0, 2.0, 3.0]], 5.0, np.empty((0, 2))])
def test_ce90_says_the_shape_it_takes(errors: object) -> None:
    with pytest.raises(termsel.TermselError, match=re.escape("expected (n, 2)")):
        termsel.ce90(errors)


def test_a_name_that_is_like_no_other_is_only_refused() -> None:
    with pytest.raises(AttributeError, match=r"^termsel has no 'xyzzy'\.$"):
        _ = termsel.xyzzy
    with pytest.raises(AttributeError, match=r"^termsel\.toolkit has no 'xyzzy'\.$"):
        _ = termsel.toolkit.xyzzy


@pytest.fixture(scope="module")
def result() -> termsel.Result:
    scene = termsel.simulate_scene("ikonos-hamedan", seed=1, roles=(20, 0, 8), n_lines=0)
    return termsel.run(features=scene, method="affine")


def test_every_command_that_python_has_under_no_name_of_its_own_is_explained() -> None:
    from termsel.cli.main import cli
    from termsel.plugins.registry import registry

    context = click.Context(cli, info_name="termsel")
    for command in (*cli.list_commands(context), *registry().names("commands")):
        name = command.replace("-", "_")
        if hasattr(termsel, name):
            continue
        with pytest.raises(AttributeError, match="Did you mean ") as caught:
            getattr(termsel, name)
        meant = str(caught.value).partition("Did you mean ")[2].removesuffix("?")
        if meant.startswith("Result."):
            assert hasattr(termsel.Result, meant.partition(".")[2]) or (
                meant.partition(".")[2] in termsel.Result.__annotations__)
        else:
            assert meant == f"termsel {command} on the command line"


@pytest.mark.parametrize(("name", "words"), [
    ("read_points", "read?"), ("read_csv", "read?"), ("locate", "Result.locate?"),
    ("accuracy", "Result.accuracy?"), ("match_points", "termsel match-points on the command")])
def test_names_of_other_programs_lead_to_those_of_termsel(name: str, words: str) -> None:
    with pytest.raises(AttributeError, match=re.escape(f"Did you mean {words}")):
        getattr(termsel, name)


@pytest.mark.parametrize("name", ["to_image", "rowcol", "xy", "to_world", "score", "coef_", "crs"])
def test_attributes_of_other_libraries_lead_to_one_that_is_there(
        name: str, result: termsel.Result) -> None:
    for thing, root in ((result, "result"), (result.fit, "fit")):
        with pytest.raises(AttributeError) as caught:
            getattr(thing, name)
        named = re.search(rf"\b{root}\.([a-z.]+)", str(caught.value))
        assert named is not None, caught.value
        value: object = thing
        for part in named[1].strip(".").split("."):
            value = getattr(value, part)


def test_brackets_lead_to_what_holds_the_values(result: termsel.Result) -> None:
    with pytest.raises(TypeError, match=re.escape("['line']. It is features.points.image[:, 0]")):
        _ = result.features["line"]
    with pytest.raises(TypeError, match=re.escape("residuals.to_pandas().set_index('id')")):
        _ = result.residuals["P1"]
    assert result.residuals[0].id == next(iter(result.residuals)).id
    with pytest.raises(TypeError, match=re.escape("Result has no ['rmse']. Write .rmse")):
        _ = result["rmse"]
    with pytest.raises(AttributeError, match=re.escape("It is accuracy.image.total")):
        _ = result.accuracy.rmse
    assert result.accuracy.image.total > 0


@pytest.mark.parametrize("name", ["Points", "Lines"])
def test_what_is_made_of_arrays_says_how_a_table_becomes_one(name: str) -> None:
    with pytest.raises(TypeError, match=re.escape(f"{name}() lacks image and ground. termsel.re")):
        getattr(termsel, name)("table")


def test_places_are_rows_of_numbers(result: termsel.Result) -> None:
    pandas = pytest.importorskip("pandas")
    x, y, z = result.features.points.ground[0]
    with pytest.raises(TypeError, match=re.escape("as a row: project([[")):
        result.project(x, y, z)
    with pytest.raises(TypeError, match=re.escape("locate([[1, 2]], 300)")):
        result.locate(1, 2, 300)
    with pytest.raises(termsel.TermselError, match="give x, y and z of each place"):
        result.project([[x, y]])
    table = pandas.DataFrame({"id": ["A"], "x": [x], "y": [y], "z": [z]})
    with pytest.raises(termsel.TermselError, match=re.escape("TABLE[['x', 'y', 'z']]")):
        result.project(table)
    assert np.isfinite(result.project(table[["x", "y", "z"]])).all()
    with pytest.raises(termsel.TermselError, match=re.escape("pandas.read_csv('places.csv'")):
        result.project("places.csv")


def test_a_crs_of_another_library_is_written_as_text() -> None:
    pyproj = pytest.importorskip("pyproj")
    scene = termsel.simulate_scene("ikonos-hamedan", seed=1)
    table = scene.points.to_pandas()
    with pytest.raises(termsel.TermselError, match=re.escape("Write crs='EPSG:4979'.")):
        termsel.write_points_csv(scene.points, "points.csv", crs=4979)
    with pytest.raises(termsel.TermselError, match=re.escape("Write crs=CRS.to_wkt()")):
        termsel.write_points_csv(scene.points, "points.csv", crs=pyproj.CRS(4979))
    termsel.fit(table, "affine", crs=pyproj.CRS(4979).to_wkt())


def test_files_that_were_given_are_named_again_in_the_call_to_write() -> None:
    with pytest.raises(TypeError, match=re.escape("termsel.read('mine.csv', image='a.tif')")):
        termsel.run(features="mine.csv", image="a.tif")
    with pytest.raises(TypeError, match=re.escape("open_dem('dem.tif', crs='EPSG:4979')")):
        termsel.open_dem("dem.tif")
    with pytest.raises(TypeError, match="bounded by evaluations=, generations= or seconds="):
        termsel.run(features="mine.csv", n_trials=100)


def test_a_table_that_lies_on_its_side_and_options_in_a_dict() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", seed=1)
    table = scene.points.to_pandas()
    with pytest.raises(termsel.TermselError, match=re.escape("give TABLE.T")):
        termsel.fit(table.T, "affine", crs="EPSG:4979")
    with pytest.raises(termsel.TermselError, match=re.escape("degree=VALUE")):
        termsel.fit(scene, "poly3d", options={"degree": 1})


def test_heights_that_lack_are_read_with_the_table(caplog: pytest.LogCaptureFixture) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", seed=1)
    table = scene.points.to_pandas()
    table.loc[2, "z"] = np.nan
    termsel.fit(table, "affine", crs="EPSG:4979")
    assert "(termsel.read(TABLE, dem=FILE))" in caplog.text
    assert "--" not in caplog.text


def test_the_file_of_a_study_is_to_be_run(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text("")
    with pytest.raises(termsel.TermselError, match=re.escape("study.toml --out DIR runs a study")):
        termsel.read_study(tmp_path / "study.toml")


def test_exchanged_arguments_are_told_in_their_order(result: termsel.Result) -> None:
    with pytest.raises(termsel.TermselError, match="The format comes first"):
        termsel.export(result, "a.RPB", "rpb")
    with pytest.raises(termsel.TermselError, match="The result comes before the image"):
        termsel.rectify("scene.tif", result, "map.tif")
    with pytest.raises(termsel.TermselError, match=re.escape("result.to_rpc()")):
        termsel.write_rpc(result, "a.RPB")
    with pytest.raises(TypeError, match=re.escape("as a table: points.to_pandas()")):
        _ = result.features.points["P1"]


def test_a_format_is_not_led_to_options_that_no_writer_has() -> None:
    """A method and a solver have names of formats nearly; `export` takes neither."""
    for name in ("rpc", "ridge", "affine"):
        with pytest.raises(termsel.TermselError) as caught:
            termsel.get("writers", name)
        assert "method" not in str(caught.value)
        assert "solver" not in str(caught.value)
