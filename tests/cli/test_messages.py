"""What people read who typed or gave something wrong: the option or file, the fault, a remedy."""

from __future__ import annotations

import ast
import os
import re
import shlex
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from zipfile import ZipFile

import click
import numpy as np
import pytest
from click.testing import CliRunner

from termsel import TermselError, read
from termsel.__main__ import silence_warnings
from termsel.cli.main import cli
from termsel.cli.usage import usage_message
from termsel.plugins.registry import registry

ROOT = Path(__file__).parents[2]


def refused(*words: str) -> str:
    done = CliRunner().invoke(cli, [*words], prog_name="termsel")
    assert done.exit_code == 2, done.output
    return done.stderr


def commands() -> Iterator[tuple[str, click.Command]]:
    """Yield every installed command with its name."""
    parent = click.Context(cli, info_name="termsel")
    for name in (*cli.list_commands(parent), *registry().names("commands")):
        command = cli.get_command(parent, name)
        assert command is not None
        yield name, command


def message_of(command: click.Command, name: str, words: list[str]) -> str:
    """Return what a command says of options that it cannot read."""
    parent = click.Context(cli, info_name="termsel")
    try:
        command.make_context(name, list(words), parent=parent)
    except click.UsageError as error:
        error.ctx = error.ctx or click.Context(command, parent=parent, info_name=name)
        return usage_message(error)
    raise AssertionError(f"{name} takes {words}")


def test_no_option_of_any_command_answers_in_words_of_python() -> None:
    numbers = (click.INT, click.FLOAT)
    tried = 0
    for name, command in commands():
        for option in command.params:
            is_number = option.type in numbers or isinstance(
                option.type, click.IntRange | click.FloatRange)
            if not isinstance(option, click.Option) or not is_number:
                continue
            message = message_of(command, name, [option.opts[0], *["5m"] * option.nargs])
            assert message.startswith(f"Error: {option.opts[0]} "), message
            assert "number" in message
            assert message.removesuffix("-all").endswith(f"All options: termsel {name} --help")
            assert not re.search(r"valid|float|integer|range|<=", message), message
            tried += 1
    assert tried > 40


@pytest.mark.parametrize(("words", "message"), [
    (["--seconds", "5s"], "--seconds is '5s', which is not a number. --seconds is in "
                          "seconds: 5."),
    (["--seconds", "2min"], "--seconds is '2min', which is not a number. --seconds is in "
                            "seconds: 120."),
    (["--seed", "1.5"], "--seed is '1.5', which is not a whole number. Type --seed N."),
    (["--generations", "0"], "--generations is 0, expected a whole number of at least 1."),
    (["--strategy", "aut"], "--strategy is 'aut', expected auto or as-asked. Did you mean "
                            "'auto'?"),
    (["--outt", "x"], "there is no option --outt. Did you mean --out?"),
    (["--qqq", "x"], "there is no option --qqq."),
    (["--points"], "--points has no value. Type --points FILE."),
    (["--quiet=1"], "--quiet takes no value.")])
def test_an_option_that_cannot_be_read_is_named_with_a_remedy(words: list[str],
                                                              message: str) -> None:
    assert refused("run", *words) == f"Error: {message}\nAll options: termsel run --help-all\n"


def test_letters_that_were_exchanged_are_asked_for() -> None:
    assert "Did you mean 'dlt2d' or 'dlt3d'?" in refused("run", "--dataset", "ikonos-hamedan",
                                                         "--model", "dtl")


def test_words_beyond_those_of_a_command_are_shown_with_what_it_takes() -> None:
    assert "'b' is more than this command takes: termsel report [OPTIONS] DIR." \
        in refused("report", "a", "b")


def test_a_folder_of_images_leads_to_compare(example_files: Path) -> None:
    folder = example_files / "images"
    assert f"termsel compare --points '{folder}/*.csv' --out DIR" \
        in refused("run", "--points", str(folder))


def test_two_files_of_points_are_to_be_joined_or_compared(example_files: Path) -> None:
    first, second = (str(example_files / name) for name in ("gcps.csv", "scene.points"))
    message = refused("run", first, second)
    assert f"{first} and {second} are both points" in message
    assert f"termsel compare --points {shlex.quote(first)} {shlex.quote(second)} --out" in message


def test_an_image_alone_is_asked_for_its_points(example_files: Path) -> None:
    message = refused("run", str(example_files / "scene.tif"))
    assert "this raster has no ground control points. If its points are in a file" \
        in message


def test_heights_among_the_files_are_not_taken_for_the_image(example_files: Path) -> None:
    done = CliRunner().invoke(cli, ["run", str(example_files / "scene.points"),
                                    str(example_files / "dem.tif"), "--quiet"])
    assert done.exit_code == 0, done.output
    assert "dem.tif is read as heights (--dem)" in done.stderr
    assert "60 of 60 heights from dem.tif" in done.stderr


def test_an_address_is_shown_as_it_was_typed() -> None:
    message = refused("run", "https://example.org/gcps.csv")
    assert message.startswith("Error: https://example.org/gcps.csv: this is an address on a server")


def test_words_are_not_taken_for_a_table(example_files: Path) -> None:
    message = refused("run", "--points", str(example_files / "README.txt"))
    assert "this is text, not a table of points" in message


@pytest.mark.parametrize(("header", "missing"), [
    ("id,line,sample", "image coordinates alone: columns for x and y are missing"),
    ("id,x,y", "ground coordinates alone: columns for line and sample are missing")])
def test_a_table_of_one_pair_says_which_pair_is_missing(tmp_path: Path, header: str,
                                                        missing: str) -> None:
    table = tmp_path / "points.csv"
    table.write_text("\n".join([header, *(f"P{i},{10 * i},{20 * i}" for i in range(6))]))
    assert missing in refused("run", "--points", str(table), "--crs", "EPSG:4979")


def test_a_table_given_as_a_raster_is_called_text(example_files: Path) -> None:
    table = str(example_files / "gcps.csv")
    assert "this is a file of text, not a raster" in refused("run", table, "--image", table)


def test_json_is_no_raster_to_convert(tmp_path: Path) -> None:
    path = tmp_path / "series.json"
    path.write_text('{"projection": "EPSG:4326"}')
    assert "this is a file of text, not a raster" in refused("check", str(path))


def test_warnings_of_libraries_reach_nobody_who_did_not_ask(
        monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("TERMSEL_DEBUG", raising=False)
    monkeypatch.delenv("PYTHONWARNINGS", raising=False)
    monkeypatch.setattr("sys.warnoptions", [])
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        silence_warnings()
        np.float64(1.0) / np.float64(0.0)
        warnings.warn("of a library", DeprecationWarning, stacklevel=1)
    assert capfd.readouterr().err == ""
    # Processes that a study starts are as silent.
    assert os.environ["PYTHONWARNINGS"] == "ignore"


def test_all_points_at_one_pixel_are_refused_without_a_word_of_numpy(tmp_path: Path) -> None:
    table = tmp_path / "points.csv"
    rows = [f"P{i},100,200,48.{i},34.{i * i},{i}" for i in range(12)]
    table.write_text("\n".join(["id,line,sample,x,y,z", *rows]))
    message = refused("run", str(table), "--crs", "EPSG:4979")
    assert message.startswith("Error: all control points have the same place in the image.")


@pytest.mark.parametrize("words", [
    ["compare", "--points", "POINTS", "--out"], ["run", "--points", "POINTS", "--out"],
    ["bench", "--quick", "--out"], ["block-example"], ["example"], ["match-example"],
    ["new-plugin", "demo", "--kind", "model", "--into"]])
def test_a_file_in_place_of_a_folder_is_called_a_file(words: list[str], example_files: Path,
                                                      tmp_path: Path) -> None:
    (tmp_path / "afile").write_text("x")
    points = str(example_files / "gcps.csv")
    message = refused(*(points if word == "POINTS" else word for word in words),
                      str(tmp_path / "afile"))
    assert re.search(r"is a file|a file of this name", message), message
    assert "File exists" not in message
    assert (tmp_path / "afile").read_text() == "x"


@pytest.mark.parametrize(("name", "text", "message"), [
    ("study.toml", "x = 1", "A study: termsel compare FILE --out DIR."),
    ("empty.csv", "", "the file is empty"),
    ("bad.json", '{"a": 1', "this is not JSON: the file breaks off here"),
    ("swapped.csv", "id,line,sample,x,y,z\nA,1,2,3\n",
     "line 2: the row ends after 4 of 6 cells, before y, z.")])
def test_a_file_that_is_no_table_leads_further(name: str, text: str, message: str,
                                               tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    assert message in refused("run", str(tmp_path / name), "--crs", "EPSG:4979")


@pytest.mark.parametrize("command", ["compare", "block"])
def test_points_in_place_of_a_study_or_block_are_recognised(command: str, tmp_path: Path,
                                                            example_files: Path) -> None:
    message = refused(command, str(example_files / "gcps.csv"), "--out", str(tmp_path / "out"))
    assert "which is TOML" in message
    assert "Tables of points are given by --points FILE" in message


def test_a_folder_that_termsel_wrote_leads_to_its_command(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    assert f"termsel report {tmp_path} shows the result" in refused("run", str(tmp_path))


def test_a_file_in_place_of_a_command_leads_to_run(example_files: Path) -> None:
    points = str(example_files / "gcps.csv")
    assert f"Points are fitted by: termsel run '{points}'" in refused(points)


def test_a_misspelt_option_of_a_model_is_recognised(example_files: Path) -> None:
    message = refused("run", str(example_files / "gcps.csv"), "--set", "degre=2")
    assert "Did you mean 'degree'? It is an option of the model poly2d" in message


def test_the_method_of_an_rpc_asks_for_one(example_files: Path) -> None:
    message = refused("run", str(example_files / "gcps.csv"), "--method", "rpc")
    assert "no RPC is given. Give it with --rpc FILE" in message
    assert "Measure more" not in message


@pytest.mark.parametrize(("words", "message"), [
    (["run", "x.csv", "--degree", "2"],
     "add --model poly3d --set degree=2; for points without heights, --model poly2d"),
    (["run", "--runs", "3"], "there is no option --runs.\n"),
    (["accuracy", "x", "--crs", "EPSG:4326"],
     "there is no option --crs. It belongs to termsel run, compare, rectify. Known: --survey"),
    (["project", "x", "--points", "y", "--out", "z"], "Did you mean --output?"),
    (["rectify", "x", "y", "-o", "z", "--epsg", "4326"], "Did you mean --crs?"),
    (["auto-georeference", "x.tif", "--dem", "y.tif", "-o", "z.jpg"],
     "z.jpg: a map is written as GeoTIFF, not as .jpg. Name it z.tif"),
    (["auto-georeference", "x.tif", "--dem", "y.tif", "-o", "z.csv"],
     "z.csv: a map is written as GeoTIFF, not as .csv. Name it z.tif."),
    (["auto-georeference", "x.tif", "--map", "y.geojson", "-o", "z.tif"],
     "there is no option --map. Did you mean --vectors?"),
    (["run", "x.csv", "--off", "C1", "C2"],
     "C2: this file does not exist. If it is an id, write ids with commas and without blanks: "
     "--off ID,C2."),
    (["stability", "."], "It is a folder, and this command takes a file of points: --points FILE."),
    (["run", "x.csv", "--report", "page.pdf"], "--report takes no name: it writes report.html"),
    (["run", "list.pdf"], "list.pdf: termsel reads no points from a file .pdf. If it has a table "
                          "of points, save that as CSV or XLSX"),
    (["run", "points.HTM"], "termsel reads no points from a file .htm. If it has"),
    (["plot", "residuals", "result", "-o", "x.svg"], "DIR comes before KIND: termsel plot result"),
    (["stability", "x.csv"], "A file of points is given so: --points "),
    (["bench", "--check", "nowhere"], "--check is 'nowhere', which does not exist. Check the name"),
    (["accuracy", "nowhere"], "nowhere: there is no result here: this folder does not exist."),
    # What is known elsewhere is not guessed.
    (["run", "--res", "5"], "there is no option --res. It belongs to termsel rectify"),
    (["describe", "EPSG:4326"], "Give it to a command: --crs EPSG:4326."),
    (["list", "plugins"], "termsel plugins lists them."),
    (["block", "a.csv", "b.csv"], "It takes one TOML file, which names all others: termsel block "
                                  "--help shows an example.")])
def test_what_strangers_type(words: list[str], message: str) -> None:
    assert message in refused(*words)


@pytest.mark.parametrize("words", [["describe", "image"], ["describe", "result"],
                                   ["describe", "my"], ["list", "images"]])
def test_no_name_is_suggested_that_is_like_another_by_chance(words: list[str]) -> None:
    assert "Did you mean" not in refused(*words)


def test_a_name_with_blanks_that_was_not_quoted_is_found(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my points.csv").write_text("id,line,sample,x,y\n")
    message = refused("run", "my", "points.csv")
    assert "'my points.csv' does. A name with blanks needs quotation marks: 'my points.csv'." \
        in message
    assert "--off" not in message


def test_an_archive_is_said_to_be_one(tmp_path: Path) -> None:
    with ZipFile(tmp_path / "z.zip", "w") as archive:
        archive.writestr("gcps.csv", "id,line,sample,x,y\n")
    assert "z.zip: this is a ZIP archive. Unpack it, and give the file of points or lines that " \
        "it has: unzip " in refused("run", str(tmp_path / "z.zip"))


@pytest.mark.parametrize("count", [2, 3])
def test_where_too_few_points_plan_nothing_one_more_is_asked_for(
        example_files: Path, tmp_path: Path, count: int) -> None:
    rows = (example_files / "gcps.csv").read_text().splitlines()[:count + 2]
    table, result = tmp_path / "few.csv", tmp_path / "r"
    table.write_text("\n".join(rows))
    done = CliRunner().invoke(cli, ["run", str(table), "--out", str(result)])
    assert "Next: measure at least one more point, then run again with it" in done.output
    assert f"{count} control points leave too little to judge it by. Measure one more" \
        in refused("plan", str(result))


def test_places_are_planned_by_a_fit_to_lines(example_files: Path, tmp_path: Path) -> None:
    words = ["run", "--lines", str(example_files / "lines.csv"), "--quiet"]
    for name, further in (("r", []), ("by-one", ["--model", "poly3d"])):
        result = str(tmp_path / name)
        assert CliRunner().invoke(cli, [*words, *further, "--out", result]).exit_code == 0
        assert CliRunner().invoke(cli, ["plan", result]).exit_code == 0


def test_a_table_of_places_says_that_the_image_is_missing(tmp_path: Path) -> None:
    table = tmp_path / "places.csv"
    table.write_text("name,east,north,elev\n" + "".join(
        f"P{i},48.{i},34.{i * i},100\n" for i in range(8)))
    message = refused("run", str(table), "--crs", "EPSG:4979")
    assert "has ground coordinates alone: columns for line and sample are missing" in message
    assert "?" not in message


def test_a_file_given_twice_and_a_folder_among_files(example_files: Path, tmp_path: Path) -> None:
    table = str(example_files / "gcps.csv")
    assert f"{table} is given twice. Give it once." in refused("run", table, table)
    assert f"{tmp_path}: this is a folder, and a run takes files." \
        in refused("run", table, str(tmp_path))


def test_a_result_takes_places_in_its_crs_and_its_page_is_no_pdf(example_files: Path) -> None:
    # The command has no --crs.
    places = example_files.parent / "places.csv"
    places.write_text("id,x,y,z\np1,270548.794,3854107.257,1800\n")
    result = example_files.parent / "for-places"
    assert CliRunner().invoke(cli, ["run", str(example_files / "gcps.csv"), "--quiet", "--out",
                                    str(result), "--overwrite"]).exit_code == 0
    message = refused("project", str(result), "--points", str(places))
    assert "The points must be in the CRS of the control, EPSG:4979: transform them" in message
    assert "--crs" not in message
    page = result / "report.pdf"
    assert "a page is HTML, not .pdf. Name it report.html" \
        in refused("report", str(result), "-o", str(page))
    assert not page.exists()


def test_a_list_of_toml_that_never_ends_is_said_where_it_begins(tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text('title = "x"\nproblems = ["rfm-terms"\nseeds = 3\n')
    assert "line 2: this is not TOML: the list that begins here has no closing bracket" \
        in refused("compare", str(study), "--out", str(tmp_path / "out"))


def test_a_folder_with_results_inside_names_them(tmp_path: Path) -> None:
    for name in ("A", "B"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text("{}")
    folders = f"{tmp_path / 'A'}, {tmp_path / 'B'}."
    assert f"Give one of them: {folders}" in refused("plan", str(tmp_path))
    assert f"one of these within it: {folders}" in refused("report", str(tmp_path))


OF_OTHER_PROGRAMS = {"--config", "--file", "--formats"}
"""Options of GDAL's programs and of pyproj sync, which messages name with their command."""


def texts_of(call: ast.Call) -> Iterator[str]:
    """Yield the texts among the arguments of a call, f-strings without what they format."""
    for node in ast.walk(call):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


Calls = list[tuple[str, str, ast.Call]]


@pytest.fixture(scope="module")
def calls() -> Calls:
    """Every call that makes a message: where it is, the name of what is called, and the call."""
    found = []
    for path in [*ROOT.glob("src/**/*.py"), *ROOT.glob("plugins/*/src/**/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            function = node.func
            name = function.attr if isinstance(function, ast.Attribute) else \
                function.id if isinstance(function, ast.Name) else ""
            if name in ("TermselError", "Undetermined", "BadCell", "warning", "info", "echo"):
                found.append((f"{path.relative_to(ROOT)}:{node.lineno}", name, node))
    return found


def pieces_of(calls: Calls) -> Iterator[tuple[str, str]]:
    """Yield where each message is made, and a piece of its text."""
    for place, _, call in calls:
        for piece in texts_of(call):
            yield place, piece


def test_options_that_messages_name_are_options_of_some_command(calls: Calls) -> None:
    known = OF_OTHER_PROGRAMS.union(
        name for _, command in commands() for option in command.params
        if isinstance(option, click.Option) for name in (*option.opts, *option.secondary_opts))
    known |= {"--help"}  # every command has it
    named = [(place, option) for place, piece in pieces_of(calls)
             for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z]", piece)]
    assert len(named) > 200
    assert [found for found in named if found[1] not in known] == []


def test_commands_that_messages_name_are_commands(calls: Calls) -> None:
    parent = click.Context(cli, info_name="termsel")
    known = {*cli.list_commands(parent), *registry().names("commands")}
    named = [(place, word) for place, piece in pieces_of(calls)
             for word in re.findall(r"(?:[`:] ?|[Rr]un:? )termsel ([a-z][a-z-]+)", piece)]
    assert len(named) > 20
    assert [found for found in named if found[1] not in known] == []


def test_the_next_command_of_every_first_screen_is_one_that_can_be_typed() -> None:
    parent = click.Context(cli, info_name="termsel")
    next_commands = {command for screen in (ROOT / "tests/report/screens").glob("*.txt")
                     for command in re.findall(r"Next: (termsel [^(\n]+)", screen.read_text())}
    assert len(next_commands) >= 2
    for text in next_commands:
        _, name, *words = shlex.split(text)
        command = cli.get_command(parent, name)
        assert command is not None, text
        command.make_context(name, words, parent=parent)


def test_what_is_wrong_with_a_file_comes_with_a_remedy(calls: Calls) -> None:
    """Every error that names a file says what to do."""
    errors = [(place, {keyword.arg for keyword in call.keywords})
              for place, name, call in calls if name == "TermselError"]
    assert len(errors) > 500
    assert [place for place, names in errors if "file" in names and "hint" not in names] == []


def test_every_command_that_writes_a_file_replaces_none_unless_asked() -> None:
    # A study goes on in its folder, and replaces its own tables alone.
    without = [name for name, command in commands()
               if {"output", "out"} & {param.name for param in command.params}
               and "overwrite" not in {param.name for param in command.params}]
    assert without == ["compare"]


def utm_table(folder: Path, changed: dict[int, str]) -> str:
    """Write 10 points in UTM, some with another easting, and return the file's name."""
    table = folder / "utm.csv"
    eastings = {i: str(270000 + 90 * i) for i in range(10)} | changed
    rows = [f"P{i},{37 * i % 100},{53 * i % 90},{eastings[i]},{3850000 + i * i},9"
            for i in range(10)]
    table.write_text("\n".join(["# crs: EPSG:32639", "id,line,sample,x,y,z", *rows]))
    return str(table)


def test_a_digit_too_many_in_one_row_is_not_taken_for_feet(tmp_path: Path) -> None:
    message = refused("run", utm_table(tmp_path, {3: "2700270"}))
    assert "is it x = 270027, with the decimal point moved?" in message
    assert "feet" not in message


def test_rows_in_metres_among_degrees_are_counted(tmp_path: Path) -> None:
    table = tmp_path / "mixed.csv"
    table.write_text("# crs: EPSG:4979\nid,line,sample,x,y,z\n" + "".join(
        f"P{i},{i},{i * i},{48 + i / 100 if i > 2 else 270000},34.{i},9\n" for i in range(10)))
    assert "3 of 10 rows look like metres" in refused("run", str(table))


def test_one_number_in_all_rows_names_the_column(tmp_path: Path) -> None:
    table = tmp_path / "same.csv"
    table.write_text("id,line,sample,x,y,z\n" + "".join(
        f"P{i},100,{20 * i},48.{i},34.{i * i},{i}\n" for i in range(12)))
    message = refused("run", str(table), "--crs", "EPSG:4979")
    assert "column 'line': all points have line 100" in message
    assert "--columns line=NAME" in message


def test_a_point_outside_the_image_can_be_left_out(example_files: Path, tmp_path: Path) -> None:
    table = tmp_path / "gcps.csv"
    rows = (example_files / "gcps.csv").read_text().splitlines()
    cells = rows[22].split(",")
    cells[2] = "-21.5"
    table.write_text("\n".join([*rows[:22], ",".join(cells), *rows[23:]]))
    image = example_files / "scene.tif"
    assert f"Or leave it out: --off {cells[0]}." in refused("run", str(table), str(image))
    assert len(read(table, image=image, off=cells[0])) == 97


def test_a_database_is_not_called_a_raster(tmp_path: Path) -> None:
    database = tmp_path / "roads.gpkg"
    database.write_bytes(b"SQLite format 3\0" + bytes(200))
    with pytest.raises(TermselError, match="If it holds vectors, give an image in its place"):
        read([], image=database)


def test_two_points_are_not_sent_to_leave_one_out(tmp_path: Path) -> None:
    table = tmp_path / "two.csv"
    table.write_text("id,line,sample,x,y,z\nA,1,2,48.1,34.1,5\nB,30,90,48.2,34.3,9\n")
    message = refused("stability", "--points", str(table), "--crs", "EPSG:4979", "--problem",
                      "rfm-terms")
    assert "are needed. Measure more" in message
    assert "press" not in message


def test_a_word_of_the_summary_leads_to_the_name_of_the_model(example_files: Path) -> None:
    message = refused("run", str(example_files / "gcps.csv"), "--model", "quadratic")
    assert "multiquadric'?" not in message
    assert "Name it poly2d, or poly3d with heights, and --set degree=2." in message


@pytest.mark.parametrize("words", [
    ("run", "gcps.csv", "--set", "layer=roads"),
    ("project", "result", "--points", "gcps.csv", "--layer", "roads")])
def test_a_layer_of_a_text_table_is_refused(
        words: tuple[str, ...], tmp_path: Path, call: Callable[..., SimpleNamespace],
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gcps.csv").write_text("# crs: local\nid,line,sample,x,y,z\n" + "".join(
        f"P{i},{100 * (i % 3)},{100 * (i // 3)},{1000 * (i // 3)},{-1000 * (i % 3)},5\n"
        for i in range(9)))
    call("run", "gcps.csv", "--out", "result")
    refused = call(*words)
    assert refused.exit_code == 2
    assert "a text table has no layers or sheets, and layer 'roads' is asked for" in refused.stderr


def test_advice_on_too_few_points_names_the_option_that_leaves_them_out(
        tmp_path: Path, call: Callable[..., SimpleNamespace]) -> None:
    """A role given to a point that --off names would be refused."""
    points = tmp_path / "few.csv"
    points.write_text("# crs: local\nid,line,sample,x,y\nA,1,2,1,-2\nB,9,2,1,-9\nC,3,7,7,-3\n")
    refused = call("run", points, "--off", "A,B")
    assert refused.stderr.strip().endswith("Leave fewer out: --off is A,B.")
    assert "--role ID=control" in call("run", points, "--role", "A=off", "--role", "B=off").stderr


def test_an_option_of_the_command_given_by_set_is_named(call: Callable[..., SimpleNamespace],
                                                        ) -> None:
    refused = call("run", "--problem", "poly-terms", "--set", "generations=5")
    assert refused.exit_code == 2
    assert "Type --generations 5." in refused.stderr
    # An option of the GA has the name of one of the command.
    assert "by itself" not in call("run", "--problem", "poly-terms", "--set", "points=0").stderr


def test_limits_of_numbers_are_written_out(call: Callable[..., SimpleNamespace]) -> None:
    refused = call("run", "--problem", "poly-terms", "--seconds", "-1")
    assert "--seconds is -1, expected a number above 0." in refused.stderr


def test_termsel_alone_prints_its_help_without_an_error() -> None:
    done = CliRunner().invoke(cli, [])
    assert done.exit_code == 2
    assert done.stderr.startswith("Usage: ")
    assert "rectify" in done.stderr


@pytest.mark.parametrize(("command", "option"), [("run", ["--points"]), ("run", [])])
def test_a_pattern_or_a_folder_of_files_is_answered_by_what_it_has(
        command: str, option: list[str], tmp_path: Path) -> None:
    for name in ("a.points", "b.points", "a.tif"):
        (tmp_path / name).write_text("mapX,mapY\n")
    pattern = f"{tmp_path}/*.points"
    done = CliRunner().invoke(cli, [command, *option, pattern])
    assert (f"{pattern}: this is a pattern of 2 files, expected one file. Give one of them, such "
            f"as {tmp_path}/a.points.") in done.stderr
    assert f"termsel compare --points '{pattern}' --out DIR" in done.stderr
    done = CliRunner().invoke(cli, [command, *option, str(tmp_path)])
    assert f"{tmp_path}: this is a folder, expected a file" in done.stderr
    assert f"termsel compare --points '{pattern}' --out DIR" in done.stderr


def test_one_column_for_two_meanings_is_refused(example_files: Path) -> None:
    message = refused("run", str(example_files / "gcps.csv"), "--columns", "x=3,y=3")
    assert "--columns takes this column for both x and y. Name a column for each" in message


def test_a_command_of_a_package_left_out_is_not_taken_for_a_slip(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERMSEL_PLUGINS", "")
    registry.cache_clear()
    try:
        message = refused("block", "block.toml")
    finally:
        monkeypatch.undo()
        registry.cache_clear()
    assert "Did you mean" not in message
