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
@click.option("--solver", "solvers", multiple=True, metavar="NAME", help="A solver of terms.")
@click.option("--problem", metavar="NAME", help="Problem of the solvers; that of the set else.")
@click.option("--model", "models", multiple=True, metavar="NAME",
              help="A model, fitted to control and check points.")
@click.option("--package", "packages", multiple=True, metavar="MODULE[:FUNCTION]",
              help="A function of your own; georeference, if none is named. With --check: one "
                   "that results may be of.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE",
              help="Option of the solvers and models.")
@click.option("--alone", is_flag=True, help="Without auto and other packages.")
@click.option("--quick", is_flag=True, help="One set of each kind: about a minute.")
@click.option("--sets", "pattern", default="", metavar="TEXT",
              help="Only sets whose name contains this.")
@click.option("--real", metavar="DIR", help="Folder of real sets; each states its licence.",
              type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--processes", type=click.IntRange(1, 256), default=1, show_default=True,
              help="Processes on this machine.")
@click.option("--scheduler", default="", metavar="ADDRESS", help="A dask scheduler.")
@click.option("--out", metavar="DIR", type=click.Path(file_okay=False, path_type=Path),
              help="Folder for table.csv, index.html and a file of results of each method.")
@click.option("--check", "checked", metavar="DIR", help="Repeat the results in a folder; those of "
              "packages where --package names them.",
              type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--files", metavar="DIR", type=click.Path(file_okay=False, path_type=Path),
              help="Write the sets as files, with their description, and run nothing.")
@click.option("--overwrite", is_flag=True, help="Replace files that are there.")
def bench(solvers: tuple[str, ...], problem: str | None, models: tuple[str, ...],
          packages: tuple[str, ...], settings: tuple[str, ...], alone: bool, quick: bool,
          pattern: str, real: Path | None, processes: int, scheduler: str, out: Path | None,
          checked: Path | None, files: Path | None, overwrite: bool) -> None:
    """Compare methods of georeferencing on forty simulated sets.

    A method sees control and check points, lines and the RPC of a set. 1,000 independent points
    judge it. Without --alone, auto, GDAL, Orthority, RANSAC, scikit-learn and scripts with DEAP
    and pymoo run next to your methods.

    \b
    Examples:
      termsel bench --quick
      termsel bench --solver ga --set population=300 --out mine
      termsel bench --package mymodule:fit --alone
      termsel bench --check mine
    """
    show_messages()
    chosen = {"--check": checked, "--files": files}
    methods = _methods(solvers, problem, models, packages, parse_settings(settings), alone=alone)
    given = [name for name, value in chosen.items() if value is not None]
    trusted = packages if checked is not None else ()
    others = solvers or models or (packages and not trusted) or alone or out or real
    if len(given) == 2 or (given and others):
        raise TermselError(f"{given[0]} goes with no method and no other task",
                           hint="Give it with --sets or --quick alone; --check also with "
                                "--package, which says what code of the results may run.")
    names = _sets(pattern, quick=quick)
    if files is not None:
        _write_files(files, names, overwrite=overwrite)
    elif checked is not None:
        sys.exit(_check(checked, pattern, processes, trusted))
    else:
        _run(methods, names, real, processes, scheduler, out, overwrite=overwrite)


def _methods(solvers: Sequence[str], problem: str | None, models: Sequence[str],
             packages: Sequence[str], options: dict[str, str], *, alone: bool) -> list[Method]:
    from termsel_bench.methods.base import AUTO, PEERS, Method

    if options and not solvers and not models:
        raise TermselError("--set is an option of no method", hint="Add --solver or --model.")
    if problem and not solvers:
        raise TermselError("--problem is for solvers", hint="Add --solver NAME.")
    mine = [*(Method("solver", name, options, problem or "") for name in solvers),
            *(Method("model", name, options) for name in models),
            *(Method("package", name) for name in packages)]
    if alone and not mine:
        raise TermselError("there is no method to run",
                           hint="Add --solver, --model or --package, or leave --alone out.")
    return mine if alone else [AUTO, *mine, *(Method("peer", name) for name in PEERS)]


def _sets(pattern: str, *, quick: bool) -> list[str]:
    from termsel_bench.scenes.catalogue import QUICK, set_names

    names = [name for name in set_names(pattern) if not quick or name in QUICK]
    if not names:
        raise TermselError(f"--quick has no set {pattern!r}", hint="Leave --quick out.")
    return names


def _run(methods: Sequence[Method], names: Sequence[str], real: Path | None, processes: int,
         scheduler: str, out: Path | None, *, overwrite: bool) -> None:
    from termsel import require_replaceable
    from termsel_bench.protocol import scores
    from termsel_bench.scenes.real import real_folders
    from termsel_bench.tables import by_kind, losses

    if out is not None:
        require_replaceable([out / "table.csv", out / "index.html"], reads=[],
                            overwrite=overwrite, makes_folder=True)
    folders = [] if real is None else real_folders(real)
    found: list[Score] = []
    total = (len(names) + len(folders)) * len(methods)
    for one in scores(methods, names, folders, processes=processes, scheduler=scheduler):
        found.append(one)
        if len(found) % len(methods) == 0:
            echo(f"{len(found)} of {total}: {one.set_name}", err=True)
    header, rows = by_kind(found)
    print_table(header, rows)
    echo("\nMedian ratio of the RMSE of independent points to the least of each set.")
    lost = losses(found, methods[0].title)
    if len(methods) > 1:
        echo(f"{methods[0].title} loses on {len(lost)} of {len(names) + len(folders)} sets"
             + (": " + ", ".join(mine.set_name for mine, _ in lost) if lost else "") + ".")
    for title in dict.fromkeys(one.method.title for one in found):
        mine = [one for one in found if one.method.title == title]
        if all(one.why for one in mine):
            echo(f"{title} has no result on any set: {mine[0].why}.")
    if out is not None:
        _write(found, out, methods[0].title)


def _write(found: Sequence[Score], out: Path, title: str) -> None:
    from termsel.toolkit import page, refuse_links, write_text
    from termsel_bench.page import document
    from termsel_bench.submitted import texts_of
    from termsel_bench.tables import csv_text

    out.mkdir(parents=True, exist_ok=True)
    refuse_links(out)
    texts = {"table.csv": csv_text(found), "index.html": page(document(found, title)),
             **texts_of(found)}
    for name, text in texts.items():
        write_text(out / name, text)
    say_written([out / name for name in texts])


def _write_files(folder: Path, names: Sequence[str], *, overwrite: bool) -> None:
    from termsel import require_replaceable
    from termsel.toolkit import refuse_links, write_text
    from termsel_bench.scenes.catalogue import METADATA, simulated
    from termsel_bench.scenes.croissant import described

    require_replaceable([folder / METADATA], reads=[], overwrite=overwrite, makes_folder=True)
    sets = [simulated(name) for name in names]
    folder.mkdir(parents=True, exist_ok=True)
    refuse_links(folder)
    for one in sets:
        for file, text in one.files().items():
            write_text(folder / file, text)
    write_text(folder / METADATA, json_text(described(sets)) + "\n")
    say_written([folder / METADATA])
    echo(f"{len(sets)} sets are in {folder}.")


def _check(folder: Path, pattern: str, processes: int, packages: Sequence[str]) -> int:
    from termsel_bench.submitted import check, read_submitted

    found = [check(one, pattern, processes=processes) for one in read_submitted(folder, packages)]
    print_table(("file", "method", "sets", "largest difference", "verdict"), [
        (one.submitted.path.name, one.submitted.method.title, str(one.repeated),
         f"{one.worst:.2%}", "refuted: " + ", ".join(one.refuted) if one.refuted else "confirmed")
        for one in found])
    return REFUTED if any(one.refuted for one in found) else 0
