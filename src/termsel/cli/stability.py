"""The command `termsel stability`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.completion import complete
from termsel.cli.messages import show_messages
from termsel.cli.run import parse_settings
from termsel.cli.tables import print_json, print_table


@click.command()
@click.option("--problem", metavar="NAME", shell_complete=complete("problems"), required=True,
              help="A problem that selects terms from points.")
@click.option("--dataset", metavar="NAME", shell_complete=complete("datasets"),
              help="A data set known by name; the problem's own by default.")
@click.option("--points", metavar="FILE", type=click.Path(path_type=Path),
              help="Points, in any format `termsel run` reads.")
@click.option("--crs", metavar="CRS", help="CRS of the ground coordinates.")
@click.option("--model", metavar="NAME", shell_complete=complete("models"), help="Sensor model.")
@click.option("--solver", metavar="NAME", shell_complete=complete("solvers"), help="Solver.")
@click.option("--criterion", metavar="NAME", shell_complete=complete("criteria"),
              help="What is minimised.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="An option of the problem, model, solver, criterion or data.")
@click.option("--repeats", type=click.IntRange(min=2), default=20, show_default=True,
              help="How many times control and check points are drawn.")
@click.option("--threshold", type=click.FloatRange(0, 1, min_open=True), default=0.6,
              show_default=True, help="Frequency from which on a term is stable.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--evaluations", type=click.IntRange(min=1), help="Budget of each search.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def stability(
    problem: str, dataset: str | None, points: Path | None, crs: str | None, model: str | None,
    solver: str | None, criterion: str | None, settings: tuple[str, ...], repeats: int,
    threshold: float, seed: int, evaluations: int | None, as_json: bool,
) -> None:
    """Show how often each term is selected as control and check points change.

    Terms selected often are fitted to control and check points together. Independent points judge
    them.

    \b
    Examples:
      termsel stability --problem rfm-terms --points gcp.csv --crs EPSG:4979 --set order=2
    """
    show_messages()

    from termsel.io.read import read
    from termsel.runs import stability as module

    found = module.stability(
        problem, repeats=repeats, threshold=threshold, seed=seed, evaluations=evaluations,
        options=parse_settings(settings), dataset=dataset, model=model, solver=solver,
        criterion=criterion, features=None if points is None else read(points, crs=crs))
    if as_json:
        print_json(found.to_dict())
        return
    order = (-found.frequency).argsort(kind="stable")
    print_table(("term", "frequency", ""), [
        (found.terms[i], f"{found.frequency[i]:.2f}",
         "stable" if found.terms[i] in found.stable else "") for i in order])
    sizes = found.selections.sum(axis=1)
    click.echo(f"\n{repeats} selections of {sizes.min()} to {sizes.max()} terms; "
               f"{len(found.stable)} terms in at least {threshold:.0%} of them.")
    independent = found.rmse.get("independent")
    if not found.determined:
        click.echo("The stable terms alone are no model. Lower --threshold.")
    elif independent is not None:
        click.echo(f"Fitted to control and check together: {independent.total:.3f} px on "
                   f"{independent.n} independent points.")
    others = [term for term in found.terms if term not in found.stable]
    if found.determined and others:
        click.echo("For a result with the stable terms run the same data and model by\n"
                   f"  termsel run --problem {problem} --solver all-terms --criterion press "
                   f"--set force_off={','.join(others)}")
