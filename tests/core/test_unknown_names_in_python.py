"""Names that Python does not find: arguments and names of termsel say which one was meant."""

import re

import pytest

import termsel
import termsel.toolkit


@pytest.mark.parametrize(("arguments", "words"), [
    ({"points": "gcps.csv"}, "features='gcps.csv'"),
    ({"rcp": "vendor.RPB"}, "Did you mean rpc?"),
    # What the command line sets by --set, and by options of its own.
    ({"population": 1}, "options={'population': 1}"),
    ({"fit_crs": "polar"}, "options={'fit_crs': 'polar'}"),
    ({"off": "P1"}, "options={'off': 'P1'}"),
    # What reading takes, options of readers included.
    ({"dem": "dem.tif"}, "termsel.read('points.csv', dem='dem.tif')"),
    ({"raster": "map.tif"}, "termsel.read('points.csv', raster='map.tif')"),
    ({"lines": "lines.csv"}, "termsel.read('points.csv', 'lines.csv')"),
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


def test_a_name_that_is_like_no_other_is_only_refused() -> None:
    with pytest.raises(AttributeError, match=r"^termsel has no 'xyzzy'\.$"):
        _ = termsel.xyzzy
    with pytest.raises(AttributeError, match=r"^termsel\.toolkit has no 'xyzzy'\.$"):
        _ = termsel.toolkit.xyzzy
