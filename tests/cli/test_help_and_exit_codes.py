"""The command line as a frame: help, names, plugins' commands, errors and exit codes."""

import json
import os
import re
import subprocess
import sys
from importlib.metadata import distributions
from textwrap import dedent

import pytest

import termsel
from termsel import __version__
from termsel.__main__ import ALLOCATIONS
from termsel.cli import main, tables
from termsel.cli.main import cli
from termsel.core.errors import unknown_name_error
from termsel.plugins import registry as manager
from termsel.plugins.commands import COMMANDS, PACKAGES
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import Registry
from termsel.runs.request import DATA_OPTIONS

PLUGIN = """
    import click
    from termsel import TermselError, hookimpl

    @hookimpl
    def termsel_commands(cli):
        @cli.command()
        @click.argument('how')
        def greet(how):
            '''Greet the photogrammetrist.'''
            if how == 'fault':
                raise ZeroDivisionError('no\\nluck')
            if how == 'refuse':
                raise TermselError('no greeting', file='gcp.csv', line=7, hint='Try hello')
            if how == 'interrupt':
                raise KeyboardInterrupt
            if how == 'seven':
                return 7
            if how in ('disk', 'stdout'):
                import errno
                file = ('map.tif',) if how == 'disk' else ()
                raise OSError(errno.ENOSPC, 'No space left on device', *file)
            click.echo(how)
"""


@pytest.fixture
def built_in(monkeypatch):
    """Without the plugins that happen to be installed."""
    names = Registry([])
    monkeypatch.setattr(manager, "registry", lambda: names)
    return names


@pytest.fixture
def plugin_folder(tmp_path):
    """Return a folder with one sound and one broken plugin."""
    for module, code in (("greeter", PLUGIN), ("broken", "import no_such_module")):
        (tmp_path / f"{module}.py").write_text(dedent(code))
        info = tmp_path / f"{module}-2.5.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {module}-package\nVersion: 2.5\n")
        (info / "entry_points.txt").write_text(f"[termsel]\n{module} = {module}\n")
    return tmp_path


@pytest.fixture
def with_plugins(plugin_folder, monkeypatch):
    monkeypatch.syspath_prepend(plugin_folder)
    monkeypatch.delitem(sys.modules, "greeter", raising=False)
    names = Registry([point for found in distributions(path=[str(plugin_folder)])
                      for point in found.entry_points])
    monkeypatch.setattr(manager, "registry", lambda: names)
    return names


def shell(*args, folder=None, **environment):
    """Run termsel in a process of its own."""
    path = os.pathsep.join(str(p) for p in [folder, *sys.path] if p)
    return subprocess.run(
        [sys.executable, "-m", "termsel", *args], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": path, "TERMSEL_PLUGINS": "greeter-package",
             "TERMSEL_DEBUG": "", **environment})


def imported(*words, then=""):
    """Return what a command of its own prints, and the modules it has imported at its end."""
    code = (f"import sys; sys.argv = ['termsel', *{words!r}]\n"
            "from termsel.__main__ import main\n"
            "try: main()\n"
            f"except SystemExit: {then}print(*sys.modules, file=sys.stderr)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout, set(done.stderr.split())


def test_help_imports_nothing_heavy():
    text, loaded = imported("--help")
    assert "Research:" in text
    assert "termsel.cli.main" in loaded
    assert not loaded & {"numpy", "scipy", "numba", "deap", "pymoo", "rich", "pluggy",
                         "importlib.metadata", "termsel.cli.run"}


def test_imports_are_not_searched_for_cycles_all_the_time():
    _, printed = imported("--version", then="import gc; print(gc.get_threshold()[0], "
                                            "file=sys.stderr); ")
    assert str(ALLOCATIONS) in printed


def test_what_few_use_is_imported_by_those_who_use_it():
    _, loaded = imported("list", "models", then="import termsel.runs.run; ")
    assert {"termsel_rpc.jitter", "termsel.adjustment.kernels"} <= loaded
    assert not loaded & {"numba", "scipy.stats", "scipy.spatial", "scipy.optimize",
                         "scipy.interpolate", "pymoo", "pyproj"}


def test_a_choice_for_few_points_imports_no_part_of_scipy_and_no_proofs():
    text, loaded = imported("run", "--problem", "rfm-terms", "--quiet")
    assert "to choose and fit the model" in text
    # numba itself looks for scipy, and takes none of its parts.
    assert not loaded & {"scipy.linalg", "scipy.optimize", "scipy.sparse", "scipy.spatial",
                         "termsel.selection.best_subsets.subsets", "termsel.runs.steps"}


def test_few_points_are_fitted_planned_and_exported_without_scipy_and_urllib(tmp_path):
    """Systems with more terms than equations are among the models, and a grid has heights."""
    points = termsel.simulate_scene("ikonos-hamedan", roles=(24, 0, 0), n_lines=0).points
    termsel.write_points_csv(points, tmp_path / "points.csv", "EPSG:4979")
    result = str(tmp_path / "result")
    _, loaded = imported("run", "--points", str(tmp_path / "points.csv"), "--out", result)
    text, loaded_by_plan = imported("plan", result)
    assert "uncertainty_px" in text
    # For its options each format of each package is looked at.
    _, loaded_by_export = imported("export", result, "--to", "points-csv",
                                   "-o", str(tmp_path / "exported.csv"))
    assert (tmp_path / "exported.csv").exists()
    for modules in (loaded, loaded_by_plan, loaded_by_export):
        assert not modules & {"scipy.linalg", "scipy.sparse", "scipy.spatial", "urllib.request"}


def test_help_tells_all_commands_as_they_tell_themselves(call):
    text = call("--help").stdout
    for name, (_, summary) in COMMANDS.items():
        assert f"\n  {name} " in text
        command = cli.get_command(None, name)
        assert command.help.partition("\n")[0] == summary
        assert call(name, "--help").exit_code == 0


def test_help_has_no_group_whose_packages_are_not_installed(call, monkeypatch):
    monkeypatch.setattr(main, "find_spec", lambda _: None)
    done = call("--help")
    assert done.exit_code == 0
    assert "\nFit:\n" in done.stdout
    assert "Images:" not in done.stdout
    assert not [name for commands in PACKAGES.values() for name in commands
                if f"\n  {name} " in done.stdout]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_gives_examples(call, name):
    text = call(name, "--help").stdout
    assert re.search(rf"^  Examples:\n+(.*\n)*    .*\btermsel {name}\b", text, re.MULTILINE)


def test_version(call):
    assert call("--version").stdout == f"termsel {__version__}\n"


@pytest.mark.parametrize("kind", KINDS)
def test_list_as_json_is_an_array_of_three_fields(call, built_in, kind):
    done = call("list", kind, "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    listed = json.loads(done.stdout)
    assert [entry["name"] for entry in listed] == built_in.names(kind)
    for entry in listed:
        assert set(entry) == {"name", "summary", "provided_by"}


def test_list_in_a_pipe_is_aligned_text(call, built_in):
    lines = call("list", "models").stdout.splitlines()
    column = lines[0].index("provided by")
    assert lines[0].startswith("name ")
    assert all(line[column:] == "termsel" for line in lines[1:])
    assert [line.split()[0] for line in lines[1:]] == built_in.names("models")


def test_list_on_a_terminal_is_a_table_that_shows_brackets(monkeypatch, capsys):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    tables.print_table(("name", "summary"), [("a", "RMSE [px]"), ("b", "[bold]none")])
    drawn = capsys.readouterr().out
    assert "RMSE [px]" in drawn
    assert "[bold]none" in drawn
    assert "─" in drawn


def test_list_warns_of_broken_plugins_on_stderr(call, with_plugins):
    done = call("list", "models", "--json")
    assert json.loads(done.stdout)
    assert done.stderr.startswith("Warning: plugin 'broken' of broken-package 2.5: cannot be")


def test_everything_with_a_name_can_be_described(call, built_in):
    for kind in KINDS:
        for entry in built_in.entries(kind):
            done = call("describe", entry.name)
            assert done.exit_code == 0, entry.name
            # A reader and a writer may share the name of their format.
            assert f"{entry.name}: {KINDS[kind].in_words} of termsel" in done.stdout.splitlines()
            assert entry.summary in done.stdout
            declared = (entry.object.options if kind == "problems"
                        else getattr(entry.object, "declared_options", ()))
            for option in declared:
                assert f"\n{option.name} " in done.stdout
                assert option.accepts in done.stdout
                assert option.doc in done.stdout


def test_describe_says_what_a_writer_needs(call, built_in):
    for entry in built_in.entries("writers"):
        shown = call("describe", entry.name).stdout
        assert (f"Needs: {entry.object.needs}\n" in shown) == bool(entry.object.needs)
    assert entry.object.needs == "control lines"
    for name in ("rpc-vrt", "gcp-grid-vrt", "geolocation-vrt", "gcp-vrt"):
        assert "--image for a VRT that has pixels" in built_in.get("writers", name).needs
    assert "control points" in built_in.get("writers", "points-csv").needs


def test_options_of_the_data_are_described_once(call, built_in):
    shown = call("describe", "data").stdout
    for option in DATA_OPTIONS:
        assert f"\n{option.name} " in shown
        assert option.doc in shown
    for entry in built_in.entries("problems"):
        assert "termsel describe data" in call("describe", entry.name).stdout


def test_describe_leads_with_purpose_main_options_and_an_example(call):
    lines = call("describe", "rfm-terms").stdout.splitlines()
    assert lines[2] == "Which terms of a rational function model to use."
    assert lines[4].startswith("Main options: mask, mixed, force_on, and ")
    assert lines[5] == "Example:      termsel run --problem rfm-terms --points FILE --out result"


def test_names_that_two_kinds_share_are_listed_once():
    # A reader and a writer are called points-csv.
    shown = str(unknown_name_error("name", "x", ["b", "a", "b"]))
    assert "Known: a, b." in shown


def test_describe_tells_terms_of_models_and_defaults_of_problems(call, built_in):
    model = call("describe", "termsel:rfm").stdout
    terms = built_in.get("models", "rfm")().terms
    assert f"Terms at the default options: {len(terms)}" in model
    assert all(term in model for term in terms)
    problem = call("describe", "poly-terms").stdout
    recipe = built_in.get("problems", "poly-terms")
    for default in (recipe.model, recipe.dataset, recipe.criterion, recipe.solver, recipe.source):
        assert f" {default}\n" in problem
    assert "Measurements: simulated" in call("describe", "spot-isfahan").stdout
    assert re.search(r"^mixed +false +true \| false ", problem, re.MULTILINE)


def test_describe_tells_options_of_the_solver_and_of_others(call):
    shown = call("describe", "zakaryaie-2015").stdout
    assert re.search(r"^Solver: +ica --set population=100 ", shown, re.MULTILINE)
    assert re.search(r"^With ga: +--set population=50\b", shown, re.MULTILINE)
    assert re.search(r"^With pso: +--set population=30$", shown, re.MULTILINE)
    assert "With ica:" not in shown


def test_describe_of_a_model_whose_terms_fail(call, built_in, monkeypatch):
    class Ill(built_in.get("models", "poly2d")):
        @property
        def terms(self):
            raise ZeroDivisionError

    entry = manager.Entry("ill", "Ill.", "someone", Ill)
    monkeypatch.setattr(Registry, "find", lambda *_: [("models", entry)])
    done = call("describe", "ill")
    assert done.exit_code == 0
    assert "Terms cannot be listed: " in done.stdout
    assert "failed in terms(): ZeroDivisionError" in done.stdout


def test_plugins_are_listed_with_what_is_wrong(call, with_plugins):
    records = json.loads(call("plugins", "--json").stdout)
    assert [(r["name"], r["distribution"], r["version"], r["status"]) for r in records] == [
        ("builtin", "termsel", __version__, "ok"), ("broken", "broken-package", "2.5", "broken"),
        ("greeter", "greeter-package", "2.5", "ok")]
    assert records[2]["hooks"] == ["termsel_commands"]
    assert "no_such_module" in records[1]["reasons"][0]
    text = call("plugins").stdout
    assert "Command 'greet' of greeter-package: Greet the photogrammetrist." in text
    assert "Broken: plugin 'broken' of broken-package 2.5: cannot be imported" in text


@pytest.mark.parametrize(("args", "message"), [
    (["lits", "models"], "Error: unknown command 'lits'. Did you mean 'list'?"),
    (["list", "cameras"], "KIND is 'cameras', expected problems, models, "),
    (["list", "model"], "or writers. Did you mean 'models'?"),
    (["new-plugin", "mine", "--kind", "modle"], "kind of plugin 'modle'. Did you mean 'model'?"),
    (["--colour"], "there is no option --colour."),
    (["plot", "--bounds", "1"], "there is no option --bounds. Known: --output, "),
    (["describe", "rfn"], "Error: unknown name 'rfn'. Did you mean 'rfm'?\n"),
    (["describe", "modle"], "Error: unknown name 'modle'. Give the name of a problem, model, "
     "solver or other thing: termsel list models shows those of the models."),
    (["describe", "zzzz"], "termsel list models shows those of models, and so on."),
    (["completion", "tcsh"], "'tcsh', expected bash, zsh or fish."),
])
def test_what_the_user_can_correct_is_one_message_and_exit_code_2(call, built_in, args, message):
    done = call(*args)
    assert done.exit_code == 2
    assert done.stdout == ""
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("Error:") == 1


def test_commands_of_plugins(call, with_plugins):
    assert call("greet", "hello").stdout == "hello\n"
    assert call("greeter-package:greet", "hello").stdout == "hello\n"
    done = call("greet", "refuse")
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == "Error: gcp.csv, line 7: no greeting. Try hello\n"
    assert call("greet", "interrupt").exit_code == 130
    assert call("greet", "seven").exit_code == 7
    unknown = call("gret")
    assert "Did you mean 'greet'?" in unknown.stderr
    assert "does not work (broken-package): see termsel plugins" in unknown.stderr


def test_a_full_disk_is_the_plugins_own_unless_it_is_that_of_stdout(plugin_folder):
    done = shell("greet", "disk", folder=plugin_folder)
    assert done.returncode == 2
    assert "the command 'greet' of greeter-package 2.5 failed: OSError" in done.stderr
    done = shell("greet", "stdout", folder=plugin_folder)
    assert done.returncode == 2
    assert "Error: cannot write to stdout: No space left on device" in done.stderr
    assert "greeter-package" not in done.stderr


def test_a_broken_plugin_is_a_command_that_says_why(call, with_plugins):
    for args in (["broken"], ["broken", "--any", "thing"]):
        done = call(*args)
        assert done.exit_code == 2
        assert "broken-package 2.5: cannot be imported: ModuleNotFoundError" in done.stderr
    helped = call("broken", "--help")
    assert helped.exit_code == 0
    assert "This command is broken: plugin 'broken' of broken-package 2.5" in " ".join(
        helped.stdout.split())


def test_a_fault_of_a_plugin_is_one_paragraph_and_exit_code_2(plugin_folder):
    done = shell("greet", "fault", folder=plugin_folder)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.search(r", line \d+: the command 'greet' of greeter-package 2.5 failed: "
                     r"ZeroDivisionError: no luck\. ", done.stderr)
    assert "report it to its author" in done.stderr
    assert "Traceback" not in done.stderr
    shown = shell("greet", "fault", folder=plugin_folder, TERMSEL_DEBUG="1")
    assert shown.returncode == 2
    assert "Traceback (most recent call last)" in shown.stderr


@pytest.mark.slow_cases("args1")
@pytest.mark.skipif(os.name == "nt", reason="closed pipes are told otherwise on Windows")
@pytest.mark.parametrize("args", [["--help"], ["list", "solvers"], ["list", "--help"]])
def test_a_closed_pipe_is_quiet(args):
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([sys.executable, "-m", "termsel", *args], stdout=writing,
                          stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_completion_scripts(call, name):
    done = call("completion", name)
    assert (done.exit_code, done.stderr) == (0, "")
    assert f"_TERMSEL_COMPLETE={name}_complete" in done.stdout


@pytest.mark.parametrize(("words", "expected"), [
    ("termsel de", ["describe"]),
    ("termsel list mo", ["models"]),
    ("termsel describe owdis-l", ["owdis-lines", "owdis-lines-terms"]),
    ("termsel run --problem poly-t", ["poly-terms"]),
    ("termsel run --model poly2", ["poly2d"]),
    ("termsel run --solver all", ["all-terms"]),
    ("termsel run --dataset geo", ["geoeye-tehran"]),
])
def test_commands_and_names_are_completed(call, built_in, monkeypatch, words, expected):
    monkeypatch.setenv("_TERMSEL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    done = call()
    assert [line.partition(",")[2] for line in done.stdout.split()] == expected


@pytest.mark.parametrize(("words", "message"), [
    # What other programs call it.
    (["fit", "gcps.csv"], "unknown command 'fit'. Did you mean run? Fit a model to control points"),
    (["warp"], "unknown command 'warp'. Did you mean rectify? Resample an image to a map"),
    (["xyzzy"], "unknown command 'xyzzy'. All commands, in groups: termsel --help."),
    (["describe", "export"], "export is a command. termsel export --help describes it."),
    (["describe", "polynomial"], "Did you mean 'poly2d' or 'poly3d'?"),
    # By what it does, where no name is similar.
    (["describe", "imperialist"], "Did you mean 'ica'?"),
    (["run", "--problem", "poly-terms", "--solver", "genetic"], "Did you mean 'ga'?")])
def test_what_is_called_otherwise_is_found_by_what_it_does(call, words, message):
    done = call(*words)
    assert done.exit_code == 2
    assert message in done.stderr


@pytest.mark.parametrize("files", [(), ("a.csv", "--points", "b.csv")])
def test_points_to_project_are_given_once(call, files):
    done = call("project", "result", *files)
    assert done.exit_code == 2
    assert "Give one table: termsel project result ground.csv" in done.stderr
