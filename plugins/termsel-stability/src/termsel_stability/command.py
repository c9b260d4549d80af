"""The command `termsel stability`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from termsel import TermselError
from termsel.toolkit import (
    INTERRUPTED,
    Asked,
    echo,
    json_text,
    print_json,
    print_table,
    run_options,
    say_written,
    search_bar,
    show_messages,
)

if TYPE_CHECKING:
    from termsel import FeatureSet
    from termsel_stability.frequencies import Stability

_SOLVER, _CRITERION = "all-terms", "press"
"""What fits given terms to control and check points together."""


@click.command()
@click.option("--repeats", type=click.IntRange(2, 10_000), default=20, show_default=True,
              help="How many times control and check points are drawn.")
@click.option("--threshold", type=click.FloatRange(0, 1, min_open=True), default=0.6,
              show_default=True, help="Frequency from which on a term is stable.")
@run_options
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder for stability.json, the result of the stable terms, and exports.")
def stability(repeats: int, threshold: float, **given: Any) -> None:
    """Show how often each term is selected as control and check points change.

    Terms selected often are fitted to control and check points together. Independent points judge
    them. It takes the options of `termsel run`; the budget is that of each search, and --export
    and --report write the model of the stable terms.

    \b
    Examples:
      termsel stability --points gcp.csv --crs EPSG:4979
      termsel stability --problem rfm-terms --points gcp.csv --crs EPSG:4979 --set order=2
    """
    asked = Asked(**given)
    show_messages()

    from termsel import require_replaceable
    from termsel.toolkit import STABILITY, claimed, problem_for, write_text
    from termsel_stability import frequencies as module

    exported = asked.exported()
    page = asked.page()
    features, options = asked.read()
    problem = asked.problem or problem_for(features, asked.dataset)
    if asked.out is not None:
        require_replaceable([asked.out / STABILITY], reads=asked.reads,
                            overwrite=asked.overwrite, makes_folder=True)
        click.get_current_context().with_resource(claimed(asked.out, overwrite=asked.overwrite))
    if asked.strategy == "auto":
        echo("Note: the strategy auto searches for no terms. Each repetition runs the problem's "
             "solver instead.", err=True)
    with search_bar(problem, asked.quiet) as observe:
        repeated = module.stability(
            problem, repeats=repeats, threshold=threshold, features=features, options=options,
            dataset=asked.dataset, model=asked.model, solver=asked.solver,
            criterion=asked.criterion, **asked.budget, observers=[observe] if observe else [])
    if asked.as_json:
        print_json(repeated.to_dict())
    else:
        _show(repeated)
    others = [term for term in repeated.terms if term not in repeated.stable]
    if repeated.determined and others and not asked.as_json:
        echo("For a result with the stable terms run\n  " + asked.command(
            problem, _SOLVER, _CRITERION, _for_stable(problem, asked, asked.options, others)))
    if asked.out is not None and not repeated.determined:
        write_text(asked.out / STABILITY, json_text(repeated.to_dict()))
        say_written([asked.out / STABILITY])
    if (exported or page) and not repeated.determined:
        raise TermselError("the stable terms alone are no model, so nothing is exported",
                           hint="Lower --threshold.")
    if asked.out is not None and repeated.determined:
        _write(repeated, exported, page, problem, asked, features,
               _for_stable(problem, asked, options, others))
    if repeated.interrupted:
        echo(f"Interrupted after {len(repeated.selections)} of {repeats} selections.", err=True)
        sys.exit(INTERRUPTED)


def _show(repeated: Stability) -> None:
    """Print the frequencies and what became of the stable terms."""
    order = (-repeated.frequency).argsort(kind="stable")
    print_table(("term", "frequency", ""), [
        (repeated.terms[i], f"{repeated.frequency[i]:.2f}",
         "stable" if repeated.terms[i] in repeated.stable else "") for i in order])
    sizes = repeated.selections.sum(axis=1)
    echo(f"\n{len(sizes)} selections of {sizes.min()} to {sizes.max()} terms; "
         f"{len(repeated.stable)} terms in at least {repeated.threshold:.0%} of them.")
    independent = repeated.rmse.get("independent")
    if not repeated.determined:
        echo("The stable terms alone are no model. Lower --threshold.")
    elif independent is not None:
        echo(f"Fitted to control and check together: {independent.total:.3f} px on "
             f"{independent.n} independent points.")


def _for_stable(problem: str, asked: Asked, options: Mapping[str, str],
                off: Sequence[str]) -> dict[str, str]:
    """Return the options of a fit without some terms: not those of the searches alone."""
    from termsel.toolkit import DATA_OPTIONS, registry

    names = registry()
    recipe = names.get("problems", problem)
    parts = [names.get("models", asked.model or recipe.model), names.get("criteria", _CRITERION),
             *(entry.object for entry in names.entries("readers"))]
    known = {option.name for group in (
        recipe.options, DATA_OPTIONS, *(part.declared_options for part in parts))
        for option in group}
    settings = {key: value for key, value in options.items() if key in known}
    before = settings.get("force_off", "").split(",")
    return {**settings, "force_off": ",".join(dict.fromkeys([*filter(None, before), *off]))}


def _write(repeated: Stability, exported: Mapping[str, Path], page: Path | None, problem: str,
           asked: Asked, features: FeatureSet | None, options: Mapping[str, str]) -> None:
    """Write the fit of the stable terms: its record with the frequencies, exports, its page."""
    from termsel import run
    from termsel.toolkit import RECORD, STABILITY, TermFrequencies, write_result

    assert asked.out is not None
    fitted = run(problem, features=features, dataset=asked.dataset, source=asked.source,
                         model=asked.model, solver=_SOLVER, criterion=_CRITERION,
                         options=options)
    said = repeated.to_dict()
    result = replace(fitted, stability=TermFrequencies(
        said["repeats"], said["threshold"], said["frequency"]),
        files={**fitted.files, STABILITY: json_text(said)})  # both, or neither
    write_result(result, asked.out)
    say_written([asked.out / STABILITY, asked.out / RECORD])
    asked.write(result, exported, page)
