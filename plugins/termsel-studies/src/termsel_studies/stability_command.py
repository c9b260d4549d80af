"""The command `termsel stability`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from termsel import TermselError
from termsel.toolkit import echo, json_text, print_json, print_table, say_written, show_messages
from termsel.toolkit.commands import RunOptions, run_options, search_bar
from termsel.toolkit.runs import INTERRUPTED

if TYPE_CHECKING:
    from termsel import FeatureSet
    from termsel_studies.frequencies import Stability

_SOLVER, _CRITERION = "all-terms", "press"
"""Solver and criterion that fit given terms to control and selection points together, without a
search."""


@click.command()
@click.option("--repeats", type=click.IntRange(2, 10_000), default=20, show_default=True,
              help="How many times control and selection points are drawn.")
@click.option("--threshold", type=click.FloatRange(0, 1, min_open=True), default=0.6,
              show_default=True, help="Frequency from which on a term is stable.")
@run_options
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder for stability.json, the result of the stable terms, and exports.")
def stability(repeats: int, threshold: float, **arguments: Any) -> None:
    """Show how often each term is selected as control and selection points change.

    Terms selected often are fitted to control and selection points together. Independent check
    points assess them. It takes the options of `termsel run`; the budget is that of each
    search, and --export and --report write the model of the stable terms.

    \b
    Examples:
      termsel stability --points gcp.csv --crs EPSG:4979
      termsel stability --problem rfm-terms --points gcp.csv --crs EPSG:4979 --set order=2
    """
    run_settings = RunOptions(**arguments)
    show_messages()

    from termsel.toolkit.runs import problem_for
    from termsel_studies import frequencies as frequencies_module

    # Wrong arguments are refused before the searches, which take long.
    export_files, page = run_settings.further_files()
    features, options = run_settings.read()
    problem = run_settings.problem or problem_for(features, run_settings.dataset)
    _lock_folder(run_settings)
    _refuse_methods(run_settings)
    with search_bar(problem, run_settings.quiet) as observe:
        repeated = frequencies_module.selection_frequencies(
            problem, repeats=repeats, threshold=threshold, features=features, options=options,
            dataset=run_settings.dataset, model=run_settings.model, solver=run_settings.solver,
            criterion=run_settings.criterion, **run_settings.budget,
            observers=[observe] if observe else [])
    if run_settings.as_json:
        print_json(repeated.to_dict())
    else:
        _print_frequencies(repeated)
    if repeated.determined:
        unstable = [term for term in repeated.terms if term not in repeated.stable]
        if unstable and not run_settings.as_json:
            echo("For a result with the stable terms run\n  " + run_settings.command(
                problem, _SOLVER, _CRITERION,
                _options_of_fit(problem, run_settings, run_settings.options, unstable)))
        if run_settings.out is not None:
            settings = _options_of_fit(problem, run_settings, options, unstable)
            _write_fit_and_frequencies(repeated, (export_files, page), problem, run_settings,
                                       features, settings)
    else:
        _write_frequencies(repeated, run_settings.out)
        if export_files or page:
            raise TermselError("the stable terms alone are no model, so nothing is exported",
                               hint="Lower --threshold, such as --threshold 0.5, or raise "
                                    "--repeats.")
    if repeated.interrupted:
        echo(f"Interrupted after {len(repeated.selections)} of {repeats} selections.", err=True)
        sys.exit(INTERRUPTED)


def _lock_folder(run_settings: RunOptions) -> None:
    """Lock the folder of --out, if there is one, until the command ends.

    Raises TermselError if the folder has results that may not be replaced, or if another program
    uses it.
    """
    from termsel import require_replaceable
    from termsel.toolkit.files import STABILITY, lock_output_folder

    if run_settings.out is None:
        return
    require_replaceable([run_settings.out / STABILITY], reads=run_settings.reads,
                        overwrite=run_settings.overwrite, makes_folder=True)
    click.get_current_context().with_resource(
        lock_output_folder(run_settings.out, overwrite=run_settings.overwrite))


def _refuse_methods(run_settings: RunOptions) -> None:
    """Raise TermselError if --method is given, as methods do not search.

    For the strategy auto, print a note that the solver of the problem runs instead.
    """
    if run_settings.method is not None:
        raise TermselError("--method is for a model without a search, and this repeats a search",
                           hint="Leave --method out, or call termsel run.")
    if run_settings.strategy == "auto":
        echo("Note: the strategy auto searches for no terms. Each repetition runs the problem's "
             "solver instead.", err=True)


def _write_frequencies(repeated: Stability, folder: Path | None) -> None:
    """Write stability.json into a folder and say so; nothing for None."""
    from termsel.toolkit import write_text
    from termsel.toolkit.files import STABILITY

    if folder is not None:
        write_text(folder / STABILITY, json_text(repeated.to_dict()))
        say_written([folder / STABILITY])


def _print_frequencies(repeated: Stability) -> None:
    """Print the frequency of each term, how many are stable, and how well their model predicts.

    If the stable terms are no model, the last line says so; without independent points it is left
    out.
    """
    # The most frequent first; terms that are alike stay in the order of the model.
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
        echo(f"Fitted to control and selection points together: {independent.total:.3f} px on "
             f"{independent.n} independent check points.")


def _options_of_fit(problem: str, run_settings: RunOptions, options: Mapping[str, str],
                    off: Sequence[str]) -> dict[str, str]:
    """Return the options by name of a plain fit of all terms but those of `off`.

    Of `options`, they are those that the problem, the model, the criterion, the data or a reader
    declares: a plain fit refuses options of the search, such as a population. force_off lists the
    terms that the user forced off, then those of `off`.
    """
    from termsel.toolkit import registry
    from termsel.toolkit.runs import DATA_OPTIONS

    extensions_by_name = registry()
    recipe = extensions_by_name.get("problems", problem)
    extensions = [extensions_by_name.get("models", run_settings.model or recipe.model),
                  extensions_by_name.get("criteria", _CRITERION),
                  *(entry.object for entry in extensions_by_name.entries("readers"))]
    declared = [*recipe.options, *DATA_OPTIONS]
    for extension in extensions:
        declared += extension.declared_options
    names_of_options = {option.name for option in declared}
    settings = {key: value for key, value in options.items() if key in names_of_options}
    # Each term once, those of the user first.
    forced_off = settings.get("force_off", "").split(",")
    return {**settings, "force_off": ",".join(dict.fromkeys([*filter(None, forced_off), *off]))}


def _write_fit_and_frequencies(
    repeated: Stability, outputs: tuple[Mapping[str, Path], Path | None], problem: str,
    run_settings: RunOptions, features: FeatureSet | None, options: Mapping[str, str],
) -> None:
    """Fit the stable terms; write the result with the frequencies into the folder of --out.

    `outputs` are the paths of exports by format, and the path of the report or None: these files
    are written too. `options` are those of the fit, which force the other terms off.
    """
    from termsel import run, write_result
    from termsel.toolkit.files import RECORD, STABILITY
    from termsel.toolkit.models import TermFrequencies

    export_files, page = outputs
    assert run_settings.out is not None
    fitted = run(problem, features=features, dataset=run_settings.dataset,
                 source=run_settings.source,
                 model=run_settings.model, solver=_SOLVER, criterion=_CRITERION,
                 options=options)
    content = repeated.to_dict()
    result = fitted.with_(stability=TermFrequencies(
        content["repeats"], content["threshold"], content["frequency"]),
        # As a file of the result it is written with the others, or none of them is.
        files={**fitted.files, STABILITY: json_text(content)})
    write_result(result, run_settings.out)
    say_written([run_settings.out / STABILITY, run_settings.out / RECORD])
    run_settings.write(result, export_files, page)
