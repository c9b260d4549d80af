"""The command `termsel run`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from termsel.cli.bars import search_bar
from termsel.cli.completion import complete
from termsel.cli.messages import echo, say_written, show_messages
from termsel.cli.remote import allow_remote
from termsel.errors import TermselError
from termsel.options import SEED

if TYPE_CHECKING:
    from termsel.measurements.features import FeatureSet

INTERRUPTED = 130


@click.command()
@click.option("--problem", metavar="NAME", shell_complete=complete("problems"),
              help="The problem to solve; see `termsel list problems`. By default the "
                   "strategy auto answers: owdis-lines where there are lines, else rfm-terms, or "
                   "poly-terms where heights are not known.")
@click.option("--dataset", metavar="NAME", shell_complete=complete("datasets"),
              help="A data set known by name; the problem's own by default.")
@click.option("--points", metavar="FILE", type=click.Path(path_type=Path),
              help="Points, in any format of `termsel list readers`.")
@click.option("--lines", metavar="FILE", type=click.Path(path_type=Path),
              help="Control lines, likewise.")
@click.option("--areas", metavar="FILE", type=click.Path(path_type=Path),
              help="Areas, by their corners: as lines along their edges, or as centroids where "
                   "points are the control; --set areas_as=boundary or centroid chooses.")
@click.option("--format", "formats", metavar="NAME", multiple=True,
              shell_complete=complete("readers"),
              help="Read the file in this format, whatever it looks like. With several files, give "
                   "one for each, in the order points, lines, areas.")
@click.option("--dem", metavar="FILE", type=click.Path(path_type=Path),
              help="Raster of heights, for points and lines that have none.")
@click.option("--raster", metavar="FILE",
              help="The image the points were measured in, for formats that need it.")
@click.option("--image-lines", metavar="FILE",
              help="Image lines id,line1,sample1,line2,sample2, for ground lines from a GIS.")
@click.option("--crs", metavar="CRS",
              help="CRS of the ground coordinates: EPSG:4979 for longitude, latitude and "
                   "ellipsoidal height; `local` for plane coordinates without a CRS.")
@click.option("--fit-crs", metavar="CRS",
              help="Coordinates the model is fitted in: geodetic, projected (UTM), geocentric or "
                   "EPSG:n. auto takes the one of the first three that predicts best.")
@click.option("--off", metavar="IDS", multiple=True,
              help="Leave out these points and lines, such as P07,P12.")
@click.option("--role", metavar="ID=ROLE", multiple=True,
              help="Role of a point, whatever the file says: control, check, independent or off; "
                   "may be repeated.")
@click.option("--model", metavar="NAME", shell_complete=complete("models"),
              help="Sensor model; see `termsel list models`.")
@click.option("--solver", metavar="NAME", shell_complete=complete("solvers"),
              help="Solver; see `termsel list solvers`.")
@click.option("--criterion", metavar="NAME", shell_complete=complete("criteria"),
              help="What is minimised; see `termsel list criteria`.")
@click.option("--strategy", type=click.Choice(["auto", "as-asked"]),
              help="`auto` chooses among plain and shrunken models of points and lines by "
                   "predicted RMSE; `as-asked` runs the problem's solver. auto is the default for "
                   "rfm-terms, poly-terms, and where no problem is named, unless you ask for a "
                   "method or a budget.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="An option of the problem, model, solver, criterion, data or file format; "
                   "may be repeated. `termsel describe NAME` lists them.")
@click.option("--seed", type=click.IntRange(0, SEED), default=1, show_default=True,
              help="Seed of the search; the same seed gives the same selection.")
@click.option("--generations", type=click.IntRange(1, 10**12),
              help="Stop after N generations beyond the first population.")
@click.option("--evaluations", type=click.IntRange(1, 10**12),
              help="Stop the solver after N evaluations; the local refinement has its own.")
@click.option("--seconds", type=click.FloatRange(0, 1e9, min_open=True),
              help="Stop after S seconds.")
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder for result.json, residuals.csv, summary.txt and the features.")
@click.option("--export", "exports", metavar="FORMAT", multiple=True,
              shell_complete=complete("writers"),
              help="Write the result to --out in this format too; may be repeated.")
@click.option("--overwrite", is_flag=True, help="Replace an earlier result in --out.")
@click.option("--json", "as_json", is_flag=True, help="Print result.json alone on stdout.")
@click.option("--quiet", is_flag=True, help="No progress bar.")
@allow_remote
def run(
    problem: str | None, dataset: str | None, points: Path | None, lines: Path | None,
    areas: Path | None, formats: tuple[str, ...], dem: Path | None, raster: str | None,
    image_lines: str | None, crs: str | None, fit_crs: str | None, off: tuple[str, ...],
    role: tuple[str, ...], model: str | None, solver: str | None, criterion: str | None,
    strategy: str | None, settings: tuple[str, ...], seed: int, generations: int | None,
    evaluations: int | None, seconds: float | None, out: Path | None, exports: tuple[str, ...],
    overwrite: bool, as_json: bool, quiet: bool,
) -> None:
    """Search for the terms or control features that serve best.

    Check points judge each selection. Independent points judge the result and take no part in any
    choice. Ctrl-C ends the search and keeps the best selection so far.

    \b
    Examples:
      termsel run --points gcp.csv --crs EPSG:4979 --out result
      termsel run --points gcp.csv --crs EPSG:4979 --off P07,P12 --role P03=independent
      termsel run --problem owdis-lines
      termsel run --problem poly-terms --points gcp.csv --crs local --set degree=5
      termsel run --problem rfm-terms --points image.points --dem heights.tif
      termsel run --problem owdis-lines --points points.csv --lines roads.csv \\
          --crs EPSG:32639 --model poly3d --seed 7 --json > result.json
    """
    options = parse_settings(settings, fit_crs=fit_crs, off=",".join(off) or None,
                             role=",".join(role) or None)
    files = [path for path in (points, lines, areas) if path is not None]
    if dataset is not None and files:
        raise TermselError("--dataset cannot be combined with files",
                           hint="Give --dataset NAME, or --points FILE and --lines FILE.")
    of_files = {"--crs": crs, "--format": formats, "--dem": dem, "--raster": raster,
                "--image-lines": image_lines}
    require_files(of_files, bool(files))
    if problem is None and not files:
        raise TermselError("there is nothing to run",
                           hint="Give --points FILE or --lines FILE, or --problem NAME for its "
                                "simulated data.")
    if exports and out is None:
        raise TermselError("--export requires --out", hint="Give a folder: --out DIR.")
    show_messages()

    from termsel.io.export import export, writer_of
    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import RECORD, files_of_result, names_of
    from termsel.plugins.registry import registry
    from termsel.runs import run as running

    # A name that is not known is said before a long search.
    exported = {to: f"result{writer_of(to).suffix or f'.{to}'}" for to in exports}
    if out is not None:
        written = [file for to, name in exported.items()
                   for file in writer_of(to).files(out / name)]
        reads = [*files, dem, raster, image_lines, *options.values()]
        require_replaceable(files_of_result(out), reads=reads, overwrite=True)
        require_replaceable(written, reads=reads, overwrite=overwrite)
    features = None
    if areas is not None and problem and registry().get("problems", problem).control == "points":
        options.setdefault("areas_as", "centroid")
    if files:
        features = read_files(points, lines, options, areas=areas, crs=crs, format=formats,
                              dem=dem, raster=raster, image_lines=image_lines)
    source = ", ".join(str(path) for path in (*files, image_lines) if path is not None)
    with search_bar(problem or running.problem_for(features), quiet) as observe:
        result = running.run(
            problem, strategy=strategy, features=features, dataset=dataset, source=source or None,
            model=model, solver=solver, criterion=criterion, options=options, seed=seed,
            generations=generations, evaluations=evaluations, seconds=seconds,
            observers=[observe] if observe else [], out=out, overwrite=overwrite)
    echo(result.to_json() if as_json else result.summary(), nl=False)
    if out is not None:
        say_written([f"{out}/{RECORD}", *names_of(result.features)[1:]])
        for to, name in exported.items():
            say_written(export(result, to, out / name, overwrite=overwrite))
    if result.interrupted:
        echo("Interrupted: this is the best so far. The same command"
             f"{' with --overwrite' if out else ''} repeats the whole run.", err=True)
        sys.exit(INTERRUPTED)


def require_files(of_files: Mapping[str, object], given: bool) -> None:
    """Refuse options that say something of a file where none is given."""
    for name, value in of_files.items():
        if value and not given:
            raise TermselError(f"{name} requires --points or --lines",
                               hint=f"Give --points FILE, or leave {name} out.")


def parse_settings(settings: tuple[str, ...], **own: str | None) -> dict[str, str]:
    """Return the options of ``--set KEY=VALUE``, with those that commands have as their own.

    Raises
    ------
    TermselError
        For a setting without an equals sign, or a key set twice.
    """
    options: dict[str, str] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise TermselError(f"--set {setting!r} is not of the form KEY=VALUE",
                               hint="For example --set population=300.")
        if key.strip() in options:
            raise TermselError(f"--set {key.strip()} is given twice", hint="Give it once.")
        options[key.strip()] = value.strip()
    for key, given in own.items():
        if given is not None and options.setdefault(key, given) != given:
            raise TermselError(f"{key} is given twice", hint="Give it once.")
    return options


def read_files(points: Path | None, lines: Path | None, settings: dict[str, str],
               **given: Any) -> FeatureSet:
    """Read the files, with those settings that are options of readers, which are taken out."""
    from termsel.io.read import read
    from termsel.plugins.registry import registry

    known = {option.name for entry in registry().entries("readers")
             for option in entry.object.declared_options}
    options = {key: settings.pop(key) for key in list(settings) if key in known}
    for key in options:
        if given.get(key) is not None:
            raise TermselError(f"{key} is given twice", hint="Give it once.")
    return read(points, lines, **{**given, **options})
