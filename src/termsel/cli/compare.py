"""The command `termsel compare`."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path
from typing import Any

import click

from termsel.cli.bars import study_bar
from termsel.cli.completion import complete
from termsel.cli.messages import echo, say_once, say_written, show_messages, take_pending
from termsel.cli.options.run_options import COLUMNS_OPTION, parse_settings, take_reading
from termsel.cli.options.shared import progress_option, remote_option
from termsel.cli.tables import print_table
from termsel.cli.topics import Whole
from termsel.core.errors import TermselError, count_in_words, make_printable
from termsel.core.files.names import free_name, no_such_file_error
from termsel.core.interrupts import INTERRUPTED
from termsel.core.options import MOST_RUNS

EXIT_FAILED = 1
"""Exit code where an image has no result; all others have theirs."""


@click.command()
@click.argument("files", nargs=-1, type=click.Path(path_type=Path), metavar="[STUDY.toml]")
@click.option("--problem", metavar="NAMES", shell_complete=complete("problems"),
              help="Problems, with commas between them.")
@click.option("--dataset", metavar="NAMES", shell_complete=complete("datasets"),
              help="Data sets, with commas between them; by default each problem's own.")
@click.option("--points", metavar="FILES", multiple=True,
              help="Files of points, an image each; a pattern in quotes stands for many files.")
@click.option("--lines", metavar="FILES", multiple=True,
              help="Files of lines; they go with the points of the same name.")
@click.option("--crs", metavar="CRS", help="CRS of the ground coordinates of all files.")
@click.option("--candidates", metavar="FILE", type=click.Path(path_type=Path),
              help="Projections that --crs auto chooses from for old maps, a CRS a line.")
@click.option("--dem", metavar="FILE", help="Raster of heights for the points of all files.")
@COLUMNS_OPTION
@click.option("--accept", metavar="RMSE",
              help="Largest RMSE with which an image is fit for use, such as 5m or 2px.")
@click.option("--model", metavar="NAMES", shell_complete=complete("models"),
              help="Sensor models, with commas between them.")
@click.option("--solver", metavar="NAMES", shell_complete=complete("solvers"),
              help="Search methods, with commas between them.")
@click.option("--criterion", metavar="NAMES", shell_complete=complete("criteria"),
              help="Criteria of a search, with commas between them.")
@click.option("--method", metavar="NAMES", shell_complete=complete("methods"),
              help="Methods in place of the automatic choice, with commas between them; auto is "
                   "that choice.")
@click.option("--strategy", metavar="NAMES",
              help="auto, as-asked or both. By default auto, unless models, solvers, criteria or "
                   "a budget are given.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="An option for every run that has it; may be repeated.")
@click.option("--seeds", type=Whole(1, MOST_RUNS), help="Seeds 1 to N.")
@click.option("--splits", type=Whole(1, MOST_RUNS),
              help="Draws of the roles of points, for points without one.")
@click.option("--evaluations", type=Whole(1, 10**12),
              help="Budget of each search; that of exact is --seconds, as it looks at many subsets "
                   "in one step.")
@click.option("--generations", type=Whole(1, 10**12),
              help="Stop each search after N generations.")
@click.option("--patience", type=Whole(1, 10**12),
              help="End a search after N generations without a gain above --set tolerance.")
@click.option("--seconds", type=click.FloatRange(0, 1e9, min_open=True),
              help="Stop each search after S seconds.")
@click.option("--timeout", type=click.FloatRange(0, 1e9, min_open=True),
              help="A run that takes longer than S seconds fails.")
@click.option("--export", "exports", metavar="FORMAT", multiple=True,
              shell_complete=complete("writers"),
              help="With the strategy auto, export each image's model; may be repeated.")
@click.option("--measures", metavar="NAMES", shell_complete=complete("measures"),
              help="Figures of plugins, a column each, with commas between several.")
@click.option("--measure", metavar="NAME",
              help="Figure by which methods are compared: fitness, check, independent, or one of "
                   "--measures. By default the fitness if the methods differ only in the solver, "
                   "otherwise the RMSE at independent check points.")
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder of the journal and the tables. Repeat the command to resume an "
                   "earlier one.")
@click.option("--workers", type=Whole(1, 1024), default=1, show_default=True,
              help="Processes at a time on this machine.")
@click.option("--scheduler", metavar="ADDRESS",
              help="Dask scheduler that does the runs, such as tcp://host:8786.")
@click.option("--dry-run", is_flag=True,
              help="Show the runs, and the time they take by one of each kind.")
@click.option("--status", metavar="DIR", type=click.Path(path_type=Path),
              help="Show how far the study of a folder is.")
@click.option("--verbose", is_flag=True,
              help="Of a batch, print every image, reason and note, as in summary.txt.")
@click.option("--quiet", is_flag=True, help="No progress bar.")
@progress_option
@remote_option
def compare(files: tuple[Path, ...], out: Path | None, workers: int, scheduler: str | None,
            dry_run: bool, status: Path | None, verbose: bool, quiet: bool, **options: Any,
            ) -> None:
    """Compare problems, models and solvers over many seeds, or run many images.

    A study file or the options say what is combined. Every combination is a cell, and every
    finished cell is kept at once: whatever ends the command, the same command goes on. Of many
    images each gets a verdict: plausible (with --accept fit for use), doubtful or unfit. The
    exit code is 1 where one failed.

    \b
    Examples:
      termsel compare study.toml --out study --workers 2
      termsel compare study.toml --dry-run
      termsel compare --problem rfm-terms --solver ga,ica,pso --seeds 30 \\
          --evaluations 10000 --out study
      termsel compare --points 'images/*.csv' --crs EPSG:4979 --out result
      termsel compare --points 'images/*.csv' --dem dem.tif --accept 5m --out result
      termsel compare --status study
    """
    # A look at a study that may be running elsewhere: nothing is locked or written.
    if status is not None:
        _show_status(status)
        return
    study, keys = _study_asked_for(files, options)
    # Only the name is checked here: the file is read when its cells are made.
    if study is not None and not study.exists():
        raise no_such_file_error(study)
    if dry_run:
        _show_plan(study, keys, workers)
        return
    if out is None:
        error = TermselError("--out is missing",
                             hint="Give a folder for journal and tables: --out DIR.")
        error.options["--out"] = free_name("study")
        raise error
    show_messages()

    from termsel.studies import compare as comparing
    from termsel.studies.maps import next_command
    from termsel.studies.outputs import (
        next_command_of_searches,
        screen,
        study_summary,
        write_outputs,
    )

    with say_once(), study_bar(quiet) as observe:
        results = comparing.compare(study, out=out, workers=workers, scheduler=scheduler,
                                    observers=(observe,) if observe else (), **keys)
    if not results.complete:
        done = len(results.records)
        echo(f"Interrupted: {done} of {count_in_words(len(results.cells), results.noun)} are "
             "finished and "
             "kept. "
             "The same command goes on.", err=True)
        sys.exit(INTERRUPTED)
    written = write_outputs(results, out)
    are_images = results.noun == "image"
    if are_images:
        # The doubts about a file are not printed by themselves: they are among its reasons.
        take_pending()
    echo(screen(results) if are_images and not verbose else study_summary(results), nl=False)
    say_written(written)
    if results.failures:
        echo(f"{results.failures} of {count_in_words(len(results.cells), 'image')} failed.",
             err=True)
    # The last line is what to type.
    command = next_command(results, out) if are_images else next_command_of_searches(results)
    if command:
        echo(command)
    # An image that fails stops no other: a script learns of it by the exit code alone.
    if results.failures:
        sys.exit(EXIT_FAILED)


def _several_files_error(files: tuple[Path, ...]) -> TermselError:
    """Return the error for several study files, or for tables of points in their place."""
    tables = [path for path in files if path.suffix.casefold() != ".toml"]
    if not tables:
        return TermselError(f"there are {len(files)} study files",
                            hint="Give one study file at a time.")
    first = tables[0]
    pattern = shlex.quote(str(first.with_name(f"*{first.suffix}")))
    return TermselError("this is no study file, which ends in .toml", file=first,
                        hint="Of many images, a file of points each: termsel compare --points "
                             f"{pattern} --out DIR.")


def _study_asked_for(files: tuple[Path, ...], options: dict[str, Any]) -> tuple[Path | None,
                                                                                dict[str, Any]]:
    """Return the study file and {}, or None and the keys of a study that the options stand for.

    With points all `files` are further files of points. Raises TermselError if both or neither of a
    study file and options are given, for several study files, and for further files of points next
    to lines.
    """
    keys = _keys_of(options)
    points = options["points"]
    if points:
        # The shell writes out a pattern such as --points *.csv: all but the first of its files come
        # without an option.
        if files and options["lines"]:
            raise TermselError(f"{files[0]} is neither an option nor its value",
                               hint="Quote the patterns: --points 'a/*.csv' --lines 'b/*.csv'.")
        keys["data"][0]["points"] = [*points, *map(str, files)]
        return None, keys
    if len(files) > 1:
        raise _several_files_error(files)
    if files and keys:
        # A study is one file that says everything: an option beside it would not be in its record.
        raise TermselError(f"{files[0]} and the option --{_first_option(options)} exclude each "
                           "other",
                           hint=f"Write it into {files[0]}, which says all of a study, or leave "
                                f"{files[0]} out.")
    if not files and not keys:
        raise TermselError("there is nothing to compare",
                           hint="Give a study file, --points FILES or --problem NAMES.")
    return (files[0] if files else None), keys


def _first_option(options: dict[str, Any]) -> str:
    # Of empty options, click gives None, and an empty tuple where one may be repeated.
    return next("set" if name == "settings" else name for name, value in options.items()
                if value not in (None, ()))


def _keys_of(options: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a study file that options stand for.

    `termsel compare` takes either a study file or options, and both become the same table: one
    option of several names is a list of the file, and what is not given is left out, so that the
    study's defaults hold. Raises TermselError for options that exclude or need each other.
    """
    lists = {"problems": "problem", "models": "model", "solvers": "solver",
             "criteria": "criterion", "methods": "method", "strategies": "strategy"}
    keys: dict[str, Any] = {}
    # Options are singular, the keys of a study file plural.
    for key, name in lists.items():
        if options[name] is not None:
            keys[key] = [text.strip() for text in options[name].split(",")]
    files = {kind: list(options[kind]) for kind in ("points", "lines") if options[kind]}
    if options["dataset"] is not None and files:
        raise TermselError("--dataset cannot be combined with files",
                           hint="Give --dataset NAMES, or --points FILES.")
    file_options = {name: options[name] for name in ("crs", "dem", "columns")
                    if options[name] is not None}
    if file_options and not files:
        raise TermselError(f"--{next(iter(file_options))} requires --points or --lines",
                           hint="Give --points FILES, or leave it out.")
    if options["dataset"] is not None:
        keys["data"] = [text.strip() for text in options["dataset"].split(",")]
    candidates = options["candidates"]
    if candidates is not None and not files:
        raise TermselError("--candidates requires --points or --lines",
                           hint="Give --points FILES, or leave it out.")
    settings = parse_settings(options["settings"], projection_candidates=None
                              if candidates is None else str(candidates))
    if files:
        of_reading = take_reading(settings)
        keys["data"] = [{**files, **file_options,
                         **({"options": of_reading} if of_reading else {})}]
    # Left out where not given: a study has its own defaults, which an empty budget would hide.
    limits = ("evaluations", "generations", "patience", "seconds", "timeout")
    budget = {name: options[name] for name in limits if options[name] is not None}
    measures = [text.strip() for text in (options["measures"] or "").split(",") if text]
    optional = {"budget": budget, "options": settings,
                "exports": list(options["exports"]), "seeds": options["seeds"],
                "splits": options["splits"], "measure": options["measure"],
                "accept": options["accept"], "measures": measures}
    return {**keys, **{key: value for key, value in optional.items() if value}}


def _show_status(folder: Path) -> None:
    """Print the progress of the study in a folder, and who is at work on it."""
    from termsel.studies.cells.folder import study_progress

    progress, holder = study_progress(folder)
    echo(f"{progress.finished} of {count_in_words(progress.total, 'run')}: {progress.text()}.")
    if progress.finished < progress.total:
        echo(f"{progress.time_left()[0].upper()}{progress.time_left()[1:]}.")
    if progress.worst:
        echo(f"Worst so far: {progress.worst}.")
    echo(f"At work: {holder}." if holder else "Nobody is at work on it.")


_BUSY = 1.5
"""Time by the clock by that of the processor from which on a machine is busy with other work."""
_LONG = 5.0
"""Seconds of a study, on an idle machine, that are worth a word on that."""
_STARTING = 1.5
"""Seconds of the processor that a study takes to start, and to write its tables."""

MOST_LISTED = 100
"""Files that a dry run lists."""


def _list_files(study: Path | None, keys: dict[str, Any]) -> None:
    """Print the files that a study would read, before any is read.

    The study may be a stranger's, and may name, or link to, any file of this computer: each file
    outside of the folder of the study is marked as such. Nothing is printed if it reads none.
    """
    from termsel.studies.compare import requested_study
    from termsel.studies.plan.data import files_of

    spec, folder = requested_study(study, keys)
    files = files_of(spec, folder)
    if not files:
        return
    echo(f"Reads {count_in_words(len(files), 'file')}:")
    own_folder = folder.resolve()
    for file in files[:MOST_LISTED]:
        target = file.resolve()
        link = "" if target == file else f"{target}, "
        elsewhere = ""
        if not target.is_relative_to(own_folder):
            elsewhere = f" ({link}outside of the folder of the study)"
        echo(f"  {make_printable(str(file), keep='')}{make_printable(elsewhere, keep='')}")
    if len(files) > MOST_LISTED:
        echo(f"  and {len(files) - MOST_LISTED:,} more")
    echo("")


def _show_plan(study: Path | None, keys: dict[str, Any], workers: int) -> None:
    """Print the files and the kinds of cells of a study, with the time that all cells take.

    Nothing is run but up to four cells of each kind, for their times. The study is that of the
    file `study`, or of the `keys` of the options. The time is for `workers` processes on a machine
    as busy as now, and where that is very busy, also on an idle one.
    """
    from termsel.studies.compare import estimate
    from termsel.studies.execution.progress import duration_in_words

    _list_files(study, keys)
    # `seconds` is the mean time of all cells of a kind, by those that were run.
    total_seconds = 0.0
    loading_seconds = 0.0
    cells = 0
    rows = []
    ended_early = False
    clock = time.perf_counter()
    cpu = time.process_time()
    for kind, number, seconds, reason, loading in estimate(study, **keys):
        ended_early |= reason.startswith("out of time")
        rows.append((*kind, str(number), "-" if seconds is None else f"{seconds:.2f}", reason))
        total_seconds += (seconds or 0.0) * number
        loading_seconds += loading
        cells += number
    print_table(("problem", "strategy", "model", "criterion", "solver", "runs", "s each", ""),
                rows)
    about = "more than" if ended_early else "about"
    # How many times as long as their processor time the cells lasted, as other programs ran too.
    slowdown = (time.perf_counter() - clock) / max(time.process_time() - cpu, 1e-6)
    # A batch starts, and loads what the first run of each kind needs.
    duration = total_seconds / workers + loading_seconds + slowdown * _STARTING
    echo(f"\n{count_in_words(cells, 'run')}; {about} {duration_in_words(duration)} with "
         f"{count_in_words(workers, 'worker')}.")
    if slowdown > _BUSY and duration / slowdown > _LONG:
        echo("That is with a machine as busy as now; about "
             f"{duration_in_words(duration / slowdown)} on an idle one.")
    if workers == 1 and total_seconds > 60:
        echo("--workers N runs N of them at a time.")


