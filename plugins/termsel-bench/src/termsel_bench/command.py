"""The command `termsel bench`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from termsel import TermselError
from termsel.toolkit import echo, json_text, parse_settings, print_table, say_written, show_messages

if TYPE_CHECKING:
    from termsel_bench.methods.base import Method
    from termsel_bench.protocol import Score

REFUTED = 2
"""Exit code where a result is not that of its method."""


@click.command()
@click.option("--method", "method_names", multiple=True, metavar="NAME",
              help="A method of `termsel list methods`.")
@click.option("--solver", "solvers", multiple=True, metavar="NAME", help="A solver of terms.")
@click.option("--problem", metavar="NAME", help="Problem of the solvers; that of the set else.")
@click.option("--model", "models", multiple=True, metavar="NAME",
              help="A model, fitted to control and selection points.")
@click.option("--package", "packages", multiple=True, metavar="MODULE[:FUNCTION]",
              help="A function of your own; georeference, if none is named. With --check: one "
                   "that results may be of.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE",
              help="Option of the solvers and models.")
@click.option("--alone", "without_others", is_flag=True, help="Without auto and other packages.")
@click.option("--suite", type=click.Choice(["simulated", "measured"]), default="simulated",
              show_default=True, help="Forty simulated sets, or 133 measured ones: old maps, "
              "vertical photos and automatic matches.")
@click.option("--quick", is_flag=True, help="One set of each kind: about a minute.")
@click.option("--sets", "pattern", default="", metavar="TEXT",
              help="Only sets whose name contains this.")
@click.option("--real", metavar="DIR", help="Folder of real sets; each states its licence.",
              type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--processes", type=click.IntRange(1, 256), default=1, show_default=True,
              help="Processes on this machine.")
@click.option("--scheduler", default="", metavar="ADDRESS", help="A dask scheduler.")
@click.option("--out", "folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path),
              help="Folder for table.csv, index.html and a file of results of each method.")
@click.option("--check", "checked", metavar="DIR", help="Repeat the results in a folder; those of "
              "packages where --package names them.",
              type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--files", metavar="DIR", type=click.Path(file_okay=False, path_type=Path),
              help="Write the sets as files, with their description, and run nothing.")
@click.option("--overwrite", is_flag=True, help="Replace files that are there.")
def bench(method_names: tuple[str, ...], solvers: tuple[str, ...], problem: str | None,
          models: tuple[str, ...], packages: tuple[str, ...], settings: tuple[str, ...],
          without_others: bool, suite: str, quick: bool, pattern: str, real: Path | None,
          processes: int, scheduler: str, folder: Path | None, checked: Path | None,
          files: Path | None, overwrite: bool) -> None:
    """Compare methods of georeferencing on simulated or measured sets.

    A method sees control and check points, lines and the RPC of a set. 1,000 independent points
    judge a simulated set; of a measured one each point is hidden once, and the median of the
    distances judges it. Without --alone, auto, GDAL, Orthority, OpenCV, RANSAC, scikit-learn and
    scripts with DEAP and pymoo run next to your methods.

    \b
    Examples:
      termsel bench --quick
      termsel bench --suite measured --sets measured-map
      termsel bench --solver ga --set population=300 --out mine
      termsel bench --package mymodule:fit --alone
      termsel bench --check mine
    """
    show_messages()
    tasks = {"--check": checked, "--files": files}
    # All options are looked at before any set is simulated.
    own_methods = _methods_of_options(
        method_names, solvers, problem, models, packages, parse_settings(settings))
    methods = _with_others(own_methods, without_others=without_others)
    # At most one task; without one methods are run.
    named = [name for name, value in tasks.items() if value is not None]
    # A file of results must not say itself what code is run.
    trusted = packages if checked is not None else ()
    other_options = method_names or solvers or models or (packages
                                          and not trusted) or without_others or folder or real
    if len(named) == 2 or (named and other_options):
        raise TermselError(f"{named[0]} goes with no method and no other task",
                           hint="Give it with --sets or --quick alone; --check also with "
                                "--package, which says what code of the results may run.")
    # A check repeats the sets that its files name, of either suite.
    if checked is not None:
        sys.exit(_check(checked, pattern, processes, trusted, quick=quick))
    if suite == "measured":
        names = _measured_sets_like(pattern, quick=quick)
    else:
        names = _simulated_sets_like(pattern, quick=quick)
    if files is not None and suite == "measured":
        _write_measured(files, names, overwrite=overwrite)
    elif files is not None:
        _write_files(files, names, overwrite=overwrite)
    else:
        _run(methods, names, real, processes, scheduler, folder, overwrite=overwrite)


def _methods_of_options(names: Sequence[str], solvers: Sequence[str], problem: str | None,
                        models: Sequence[str], packages: Sequence[str],
                        options: dict[str, str]) -> list[Method]:
    """Return the methods that the options name.

    Raises TermselError for --set or --problem without a method that takes it.
    """
    from termsel_bench.methods.base import Method

    if options and not solvers and not models:
        raise TermselError("--set has no method to set options of", hint="Add --solver or --model.")
    if problem and not solvers:
        raise TermselError("--problem is for solvers", hint="Add --solver NAME.")
    return [*(Method("method", name) for name in names),
            *(Method("solver", name, options, problem or "") for name in solvers),
            *(Method("model", name, options) for name in models),
            *(Method("package", name) for name in packages)]


def _with_others(own_methods: list[Method], *, without_others: bool) -> list[Method]:
    """Return auto, the methods and those of other packages, or the methods alone.

    Raises TermselError if they are to be alone, and there are none.
    """
    from termsel_bench.methods.base import AUTO, PEERS, Method

    if without_others and not own_methods:
        raise TermselError("there is no method to run",
                           hint="Add --method, --solver, --model or --package, or leave --alone "
                                "out.")
    return own_methods if without_others else [AUTO, *own_methods,
                                               *(Method("peer", name) for name in PEERS)]


def _simulated_sets_like(pattern: str, *, quick: bool) -> list[str]:
    """Return the names of simulated sets that contain `pattern`; raises TermselError if none does.
    """
    from termsel_bench.scenes.catalogue import QUICK, set_names

    names = [name for name in set_names(pattern) if not quick or name in QUICK]
    if not names:
        raise TermselError(f"--quick has no set {pattern!r}", hint="Leave --quick out.")
    return names


def _measured_sets_like(pattern: str, *, quick: bool) -> list[str]:
    """Return the names of measured sets that contain `pattern`; if quick, the first of each kind.

    Raises TermselError if there is none.
    """
    from termsel_bench.scenes.measured import first_of_each_kind, measured_names

    names = measured_names(pattern)
    return first_of_each_kind(names) if quick else names


def _run(methods: Sequence[Method], names: Sequence[str], real: Path | None, processes: int,
         scheduler: str, folder: Path | None, *, overwrite: bool) -> None:
    """Run methods on sets and print the table; with a folder, write table, page and results there.

    Each set that is finished is told on stderr. Raises TermselError for files that are there and
    may not be replaced, before anything is run.
    """
    from termsel import require_replaceable
    from termsel_bench.protocol import score_all
    from termsel_bench.scenes.measured import MEASURED
    from termsel_bench.scenes.real import real_folders
    from termsel_bench.tables import losses, ratios_by_kind

    if folder is not None:
        # An error must come before hours of work.
        require_replaceable([folder / "table.csv", folder / "index.html"], reads=[],
                            overwrite=overwrite, makes_folder=True)
    folders = [] if real is None else real_folders(real)
    scored: list[Score] = []
    total = (len(names) + len(folders)) * len(methods)
    for score in score_all(methods, names, folders, processes=processes, scheduler=scheduler):
        scored.append(score)
        if len(scored) % len(methods) == 0:
            # A line for each set, as methods of one set come one after the other.
            echo(f"{len(scored)} of {total}: {score.set_name}", err=True)
    header, rows = ratios_by_kind(scored)
    print_table(header, rows)
    # Measured sets have blunders among their hidden points: a mean would show those alone.
    if scored[0].set_name.startswith(MEASURED):
        figure = "median error of hidden points"
    else:
        figure = "RMSE of independent check points"
    echo(f"\nMedian ratio of the {figure} to the least of each set.")
    lost_sets = losses(scored, methods[0].title)
    if len(methods) > 1:
        names_of_lost = ", ".join(loss.set_name for loss, _ in lost_sets)
        echo(f"{methods[0].title} loses on {len(lost_sets)} of {len(names) + len(folders)} sets"
             + (f": {names_of_lost}" if lost_sets else "") + ".")
    for title in dict.fromkeys(score.method.title for score in scored):
        method_scores = [score for score in scored if score.method.title == title]
        if all(score.why for score in method_scores):
            echo(f"{title} has no result on any set: {method_scores[0].why.rstrip('.')}.")
    if folder is not None:
        _write(scored, folder, methods[0].title)


def _write(scored: Sequence[Score], folder: Path, title: str) -> None:
    """Write table, page and results into a folder; `title` is the method whose losses are listed.
    """
    from termsel.toolkit import make_folder, write_text
    from termsel.toolkit.charts import render_page
    from termsel.toolkit.files import refuse_links
    from termsel_bench.page import scores_document
    from termsel_bench.submitted import texts_of
    from termsel_bench.tables import csv_text

    make_folder(folder)
    refuse_links(folder)
    texts = {"table.csv": csv_text(scored),
             "index.html": render_page(scores_document(scored, title)),
             **texts_of(scored)}
    for name, text in texts.items():
        write_text(folder / name, text)
    say_written([folder / name for name in texts])


def _write_files(folder: Path, names: Sequence[str], *, overwrite: bool) -> None:
    """Write simulated sets as files into a folder, with their description in Croissant's JSON.

    Raises TermselError if the description would be replaced and `overwrite` is false.
    """
    from termsel import require_replaceable
    from termsel.toolkit import make_folder, write_text
    from termsel.toolkit.files import refuse_links
    from termsel_bench.scenes.catalogue import METADATA, simulated_set
    from termsel_bench.scenes.croissant import croissant_description

    require_replaceable([folder / METADATA], reads=[], overwrite=overwrite, makes_folder=True)
    # All sets are simulated first, so that an error leaves no folder.
    sets = [simulated_set(name) for name in names]
    make_folder(folder)
    refuse_links(folder)
    for bench_set in sets:
        for file, text in (bench_set.files() | bench_set.crs_files()).items():
            write_text(folder / file, text)
    write_text(folder / METADATA, json_text(croissant_description(sets)) + "\n")
    say_written([folder / METADATA])
    echo(f"{len(sets)} sets are in {folder}.")


def _write_measured(folder: Path, names: Sequence[str], *, overwrite: bool) -> None:
    """Write measured sets as files into a folder, with their description in Croissant's JSON.

    Raises TermselError if a file would be replaced and `overwrite` is false.
    """
    from termsel import require_replaceable
    from termsel.toolkit import make_folder, write_text
    from termsel.toolkit.files import refuse_links
    from termsel_bench.scenes.catalogue import METADATA
    from termsel_bench.scenes.croissant import croissant_of_measured
    from termsel_bench.scenes.measured import build_published_files

    files = build_published_files(names)
    # All files are checked before the first is written.
    require_replaceable([folder / METADATA, *(folder / name for name in files)], reads=[],
                        overwrite=overwrite, makes_folder=True)
    make_folder(folder)
    refuse_links(folder)
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        write_text(folder / name, text)
    write_text(folder / METADATA, json_text(croissant_of_measured(names, files)) + "\n")
    say_written([folder / METADATA])
    echo(f"{len(names)} sets are in {folder}.")


def _check(folder: Path, pattern: str, processes: int, packages: Sequence[str], *,
           quick: bool) -> int:
    """Run the methods of the results in a folder again, and print the verdicts.

    Only sets whose names contain `pattern` are repeated; if quick, only those of --quick. Returns
    the exit code: `REFUTED` if a result is refuted, so that scripts notice, else 0.
    """
    from termsel_bench.submitted import check, read_submitted

    checks = [check(checked, pattern, quick=quick, processes=processes)
              for checked in read_submitted(folder, packages)]
    print_table(("file", "method", "sets", "largest difference", "verdict"), [
        (checked.submitted.path.name, checked.submitted.method.title, str(checked.repeated),
         f"{checked.worst:.2%}", "refuted: " + ", ".join(checked.refuted) if checked.refuted
         else "confirmed")
        for checked in checks])
    return REFUTED if any(checked.refuted for checked in checks) else 0
