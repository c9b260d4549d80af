"""The command `termsel stability`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from termsel.cli.completion import complete
from termsel.cli.messages import echo, say_written, show_messages
from termsel.cli.remote import allow_remote
from termsel.cli.run import parse_settings, read_files, require_files
from termsel.cli.tables import json_text, print_json, print_table
from termsel.errors import TermselError
from termsel.options import SEED


@click.command()
@click.option("--problem", metavar="NAME", shell_complete=complete("problems"), required=True,
              help="A problem that selects terms from points.")
@click.option("--dataset", metavar="NAME", shell_complete=complete("datasets"),
              help="A data set known by name; the problem's own by default.")
@click.option("--points", metavar="FILE", type=click.Path(path_type=Path),
              help="Points, in any format `termsel run` reads.")
@click.option("--areas", metavar="FILE", type=click.Path(path_type=Path),
              help="Areas, by their corners; their centroids are points.")
@click.option("--format", "form", metavar="NAME", shell_complete=complete("readers"),
              multiple=True, help="Read the file in this format, whatever it looks like.")
@click.option("--dem", metavar="FILE", type=click.Path(path_type=Path),
              help="Raster of heights, for points that have none.")
@click.option("--raster", metavar="FILE",
              help="The image the points were measured in, for formats that need it.")
@click.option("--crs", metavar="CRS", help="CRS of the ground coordinates.")
@click.option("--fit-crs", metavar="CRS", help="Coordinates the model is fitted in.")
@click.option("--off", metavar="IDS", multiple=True, help="Leave out these points, as P07,P12.")
@click.option("--role", metavar="ID=ROLE", multiple=True,
              help="Role of a point, whatever the file says; may be repeated.")
@click.option("--model", metavar="NAME", shell_complete=complete("models"), help="Sensor model.")
@click.option("--solver", metavar="NAME", shell_complete=complete("solvers"), help="Solver.")
@click.option("--criterion", metavar="NAME", shell_complete=complete("criteria"),
              help="What is minimised.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="An option of the problem, model, solver, criterion, data or file format.")
@click.option("--repeats", type=click.IntRange(2, 10_000), default=20, show_default=True,
              help="How many times control and check points are drawn.")
@click.option("--threshold", type=click.FloatRange(0, 1, min_open=True), default=0.6,
              show_default=True, help="Frequency from which on a term is stable.")
@click.option("--seed", type=click.IntRange(0, SEED), default=1, show_default=True)
@click.option("--generations", type=click.IntRange(1, 10**12), help="Budget of each search.")
@click.option("--evaluations", type=click.IntRange(1, 10**12), help="Likewise.")
@click.option("--seconds", type=click.FloatRange(0, 1e9, min_open=True), help="Likewise.")
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder for stability.json.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@allow_remote
def stability(
    problem: str, dataset: str | None, points: Path | None, areas: Path | None,
    form: tuple[str, ...], dem: Path | None, raster: str | None, crs: str | None,
    fit_crs: str | None, off: tuple[str, ...], role: tuple[str, ...], model: str | None,
    solver: str | None, criterion: str | None, settings: tuple[str, ...], repeats: int,
    threshold: float, seed: int, generations: int | None, evaluations: int | None,
    seconds: float | None, out: Path | None, overwrite: bool, as_json: bool,
) -> None:
    """Show how often each term is selected as control and check points change.

    Terms selected often are fitted to control and check points together. Independent points judge
    them.

    \b
    Examples:
      termsel stability --problem rfm-terms --points gcp.csv --crs EPSG:4979 --set order=2
    """
    options = parse_settings(settings, fit_crs=fit_crs, off=",".join(off) or None,
                             role=",".join(role) or None)
    of_points = {"--format": form, "--dem": dem, "--raster": raster, "--crs": crs}
    files = points is not None or areas is not None
    require_files(of_points, files)
    if dataset is not None and files:
        raise TermselError("--dataset cannot be combined with files",
                           hint="Give --dataset NAME, or --points FILE.")
    if areas is not None:
        options.setdefault("areas_as", "centroid")
    given = dict(options)
    show_messages()

    from termsel.files.atomic import write_text
    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import claim_folder
    from termsel.runs import stability as module

    if out is not None:
        require_replaceable([out / "stability.json"], overwrite=overwrite,
                            reads=[points, areas, dem, raster, *options.values()])
        claim_folder(out, overwrite=True)
    features = read_files(points, None, options, areas=areas, crs=crs, format=form, dem=dem,
                          raster=raster) if files else None
    found = module.stability(
        problem, repeats=repeats, threshold=threshold, seed=seed, generations=generations,
        evaluations=evaluations, seconds=seconds, options=options, dataset=dataset,
        model=model, solver=solver, criterion=criterion, features=features)
    if out is not None:
        write_text(out / "stability.json", json_text(found.to_dict()))
        say_written([out / "stability.json"])
    if as_json:
        print_json(found.to_dict())
        return
    order = (-found.frequency).argsort(kind="stable")
    print_table(("term", "frequency", ""), [
        (found.terms[i], f"{found.frequency[i]:.2f}",
         "stable" if found.terms[i] in found.stable else "") for i in order])
    sizes = found.selections.sum(axis=1)
    echo(f"\n{repeats} selections of {sizes.min()} to {sizes.max()} terms; "
         f"{len(found.stable)} terms in at least {threshold:.0%} of them.")
    independent = found.rmse.get("independent")
    if not found.determined:
        echo("The stable terms alone are no model. Lower --threshold.")
    elif independent is not None:
        echo(f"Fitted to control and check together: {independent.total:.3f} px on "
             f"{independent.n} independent points.")
    others = [term for term in found.terms if term not in found.stable]
    if found.determined and others:
        data = {"--dataset": dataset, "--points": points, "--areas": areas, **of_points,
                "--model": model}
        echo("For a result with the stable terms run\n"
             f"  {_command(problem, data, model, given, others)}")


def _command(problem: str, data: Mapping[str, object], model: str | None,
             given: Mapping[str, str], off: Sequence[str]) -> str:
    """Return the command that fits the terms not in `off` to the same data, for the shell."""
    from termsel.files.remote import remote_allowed
    from termsel.plugins.registry import registry
    from termsel.runs.task import DATA_OPTIONS

    names = registry()
    recipe = names.get("problems", problem)
    parts = [names.get("models", model or recipe.model), names.get("criteria", "press"),
             *(entry.object for entry in names.entries("readers"))]
    # Options of the solver and the criterion of the searches mean nothing to this fit.
    known = {option.name for options in (
        recipe.options, DATA_OPTIONS, *(part.declared_options for part in parts))
        for option in options}
    settings = {key: value for key, value in given.items() if key in known}
    before = settings.get("force_off", "").split(",")
    settings["force_off"] = ",".join(dict.fromkeys([*filter(None, before), *off]))
    words = ["termsel", "run", "--problem", problem]
    for name, value in data.items():
        for one in value if isinstance(value, tuple) else [value]:
            words += [] if one is None else [name, str(one)]
    words += ["--solver", "all-terms", "--criterion", "press"]
    for key, value in settings.items():
        words += ["--set", f"{key}={value}"]
    return shlex.join([*words, "--allow-remote"] if remote_allowed() else words)
