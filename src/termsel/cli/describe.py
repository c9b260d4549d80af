"""The command `termsel describe`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

from termsel.cli.completion import complete
from termsel.cli.messages import echo
from termsel.cli.tables import print_table
from termsel.core.errors import TermselError, likely_names, unknown_name_error
from termsel.plugins.commands import COMMANDS

if TYPE_CHECKING:
    from termsel.core.options import Option
    from termsel.plugins.registry import Entry
    from termsel.selection.problems.recipes import Recipe


@click.command()
@click.argument("name", shell_complete=complete())
def describe(name: str) -> None:
    """Describe a problem, model, solver or other named thing.

    The purpose comes first, then an example with the main options, then the details. Set options
    with `termsel run --set KEY=VALUE`. `termsel describe data` lists the options of the data and
    of reading them, such as those of a known camera.

    \b
    Examples:
      termsel describe owdis-lines
      termsel describe rfm
      termsel describe ga
    """
    if name == DATA:
        _describe_data()
        return
    from termsel.plugins.kinds import KINDS
    from termsel.plugins.registry import registry

    names = registry()
    entries = names.find(name)
    if not entries:
        # The name may be of any kind, so that the nearest one is looked for among all.
        summaries = {entry.name: entry.summary for kind in KINDS for entry in names.entries(kind)}
        if _is_crs(name):
            raise TermselError(f"{name} is a coordinate reference system, which termsel does not "
                               "describe", hint=f"Give it to a command: --crs {name}.")
        if name in COMMANDS or name in names.names("commands"):
            raise TermselError(f"{name} is a command", hint=f"termsel {name} --help describes it.")
        raise _unknown_name_error(name, summaries, names.hint(name, *KINDS))
    # One name may be a model and a solver: all of them are described.
    for i, (kind, entry) in enumerate(entries):
        if i:
            echo()
        echo(f"{entry.name}: {KINDS[kind].in_words} of {entry.provided_by}")
        _print_lead(kind, entry)
        _DESCRIBE.get(kind, _describe_format)(entry)


def _is_crs(name: str) -> bool:
    """Return whether a name is that of an authority for a CRS, such as EPSG:4326."""
    from termsel.data.coordinates.crs import normalise

    if not _OF_AUTHORITY.fullmatch(name):
        return False
    # A thing of a package has a name of the same form, "package:name".
    try:
        normalise(name)
    except TermselError:
        return False
    return True


_OF_AUTHORITY = re.compile(r"[A-Za-z_0-9]+:\w+")


def _unknown_name_error(name: str, summaries: Mapping[str, str], hint: str) -> TermselError:
    """Return the error for an unknown name, whose hint shows similar names or else where to look.

    That is the command that lists the things of a kind, of the one whose word is similar to the
    name, if any.
    """
    from termsel.plugins.kinds import KINDS

    error = unknown_name_error("name", name, summaries, hint, summaries)
    if "Did you mean" not in str(error):
        # A word such as "solver" names a kind of thing, of which a list can be shown.
        words = {word: kind for kind in KINDS for word in (kind, KINDS[kind].word)}
        near = likely_names(name, list(words))
        kind = words[near[0]] if near else "models"
        if near:
            example = f"termsel list {kind} shows those of the {kind}"
        else:
            example = f"termsel list {kind} shows those of {kind}, and so on"
        error.hint = (f"{hint} Give the name of a problem, model, solver or other thing: "
                      f"{example}.".strip())
    return error


DATA = "data"
"""Name under which the options of the data are described: every problem has them."""

KEY_OPTIONS = 3
"""Options that are named together with the purpose of a thing."""

_EXAMPLES = {
    "problems": "termsel run --problem {name} --points FILE{lines} --out result",
    "models": "termsel run --points FILE --model {name} --out result",
    "solvers": "termsel run --problem rfm-terms --points FILE --solver {name} --out result",
    "criteria": "termsel run --problem rfm-terms --points FILE --criterion {name} --out result",
    "methods": "termsel run --points FILE --method {name} --out result",
    "objectives": "termsel run --problem rfm-terms --points FILE --solver nsga2 --set "
                  "objectives=check-rmse,{name}",
    "splits": "termsel run --points FILE --set roles={name} --out result",
    "datasets": "termsel run --dataset {name} --out result",
    "readers": "termsel run --points FILE --format {name} --out result",
    "writers": "termsel export result --to {name} --output FILE",
    "matchers": "termsel match-points IMAGE --reference MAP --matcher {name}"}
"""A command for a thing of each kind; others say themselves how they are used."""


def _print_lead(kind: str, entry: Entry) -> None:
    """Print the purpose of a thing, its main options and an example."""
    thing = entry.object
    echo(f"\n{entry.summary}\n")
    # Recipes have the options of their problem; other things declare theirs on the class.
    options = tuple(getattr(thing, "options" if kind == "problems" else "declared_options", ()))
    if options:
        names = ", ".join(option.name for option in options[:KEY_OPTIONS])
        further = f", and {len(options) - KEY_OPTIONS} more" if len(options) > KEY_OPTIONS else ""
        echo(f"Main options: {names}{further}")
    if kind in _EXAMPLES:
        lines = " --lines FILE" if getattr(thing, "control", "points") != "points" else ""
        echo(f"Example:      {_EXAMPLES[kind].format(name=entry.name, lines=lines)}")


def _describe_data() -> None:
    """Print the options of the data, then those of reading files."""
    from termsel.io.read import read_options
    from termsel.runs.request import DATA_OPTIONS

    echo("Options of the data, for every problem:")
    _option_table(DATA_OPTIONS)
    echo("\nOptions of reading the files, whatever their format; a format has more: "
         "termsel describe FORMAT.")
    _option_table(read_options())


def _describe_problem(entry: Entry) -> None:
    """Print the defaults of a problem and its options."""
    recipe = entry.object
    # A search ends by the first of these rules that is met.
    rules = []
    if recipe.generations:
        rules.append(f"{recipe.generations} generations")
    if recipe.patience:
        rules.append(f"{recipe.patience} generations without a gain")
    other_solvers = {f"with {solver}": _option_settings(options).strip()
                     for solver, options in recipe.solver_options.items()
                     if solver != recipe.solver}
    _print_pairs({
        "model": recipe.model + _option_settings(recipe.model_options), "data set": recipe.dataset,
        "criterion": recipe.criterion,
        "solver": recipe.solver + _option_settings(recipe.solver_options.get(recipe.solver, {})),
        **other_solvers,
        "ends after": ", or ".join(rules) or "the budget of every search",
        "control": recipe.control, "source": recipe.source})
    _print_options([*recipe.options, *_options_of_prepared_problem(recipe)])
    echo("\nOptions of the data: termsel describe data. Model, solver and criterion have their own "
         "options, too: termsel describe NAME.")


def _options_of_prepared_problem(recipe: Recipe) -> list[Option]:
    """Return the options of a recipe's problem that depend on its data; [] if it has none."""
    from termsel.runs.task import prepare
    from termsel.selection.problems.recipes import options_of, undeclared_options

    undeclared = undeclared_options(recipe)
    # The problem has to be prepared, as it is the data that decide which options it has.
    try:
        names = options_of(prepare(recipe).problem) if undeclared else frozenset()
    except TermselError:  # a run of the problem shows this error
        names = frozenset()
    return [option for option in undeclared if option.name in names]


def _option_settings(options: Mapping[str, Any]) -> str:
    """Return options as they are typed: " --set KEY=VALUE" for each."""
    return "".join(f" --set {key}={value}" for key, value in options.items())


def _describe_model(entry: Entry) -> None:
    """Print the needs of a model, its options and its terms."""
    _print_docstring(entry)
    _print_pairs({"heights": "required" if entry.object.uses_height else "not used"})
    _print_options(entry.object.declared_options)
    try:
        terms = entry.object().terms
    except TermselError as error:  # of a plugin, whose description is still useful
        echo(f"\nTerms cannot be listed: {error}")
        return
    echo(f"\nTerms at the default options: {len(terms)}")
    echo(click.wrap_text(", ".join(terms), 78, "  ", "  "))


def _describe_solver(entry: Entry) -> None:
    """Print the abilities of a solver, its options, and how it departs from its paper."""
    _print_docstring(entry)
    from termsel.selection.solvers.budget import EVALUATIONS, SEARCH_OPTIONS

    solver = entry.object
    _print_pairs({
        "objectives": f"at most {solver.max_objectives}",
        "ends": "by itself" if solver.ends_by_itself else
                f"with the budget; by default {EVALUATIONS:,} evaluations, as for every solver",
        "most terms": "all" if solver.uses_all else
                      "two thirds of the equations, as for every solver (--set max_share=1)"})
    if solver.departures:
        echo("\nDifferences from the paper:")
        for departure in solver.departures:
            echo(click.wrap_text(departure, 88, "- ", "  "))
    _print_options(solver.declared_options)
    echo("\nOptions of every search:")
    _option_table(SEARCH_OPTIONS)


def _describe_criterion(entry: Entry) -> None:
    """Print what a criterion is, and its options."""
    _print_docstring(entry)
    _print_options(entry.object.declared_options)


def _describe_function(entry: Entry) -> None:
    """Print the description of a thing made of one function, such as a split, and how to use it.

    The description is the docstring of the function without its first line, which says what it
    returns; the summary, printed before, says what that is.
    """
    declared = entry.object
    attribute, use = _FUNCTIONS[type(declared).__name__]
    details = (inspect.getdoc(getattr(declared, attribute)) or "").partition("\n")[2].strip("\n")
    if details:
        echo(f"\n{details}")
    echo(f"\n{use.format(entry.name)}")


_FUNCTIONS = {
    "Objective": ("score", "Use it with --set objectives={}, next to the criterion."),
    "Split": ("assign", "Use it with --set roles={}."),
    "ReportSection": ("blocks", "It is in every report and summary.txt."),
    "Measure": ("compute", "Use it with termsel compare --measures {}.")}


def _describe_method(entry: Entry) -> None:
    """Print when auto chooses a method, and how to fit it alone."""
    method = entry.object
    limit = ""
    if method.max_features < float("inf"):
        limit = f"up to {method.max_features:g} features"
    _print_pairs({"chosen": _when_chosen(method), "contains": ", ".join(method.contains),
                  "needs": ", ".join(method.needs), "tried for": limit})
    echo(f"\nFit it alone with termsel run --method {entry.name}, in Python with "
         f"termsel.fit(features, {entry.name!r}).")


def _when_chosen(method: Any) -> str:
    """Return in words when auto chooses a method.

    A method may be several of these things: the first that holds decides, as in the choice itself.
    """
    if method.on_request:
        return "never: it is fitted where it is asked for"
    if method.only_shown:
        return "never: it is shown for comparison"
    if method.for_few:
        return "by the smallest leave-one-out RMSE, if points are few"
    if method.has_prior:
        return ("if it predicts left-out points better by more than the uncertainty of the "
                "difference, or instead of the methods that it contains")
    times = "twice" if method.central else "three times"
    return (f"if it predicts left-out points better by {times} the uncertainty of the difference, "
            "and has the smaller RMSE")


def _describe_dataset(entry: Entry) -> None:
    """Print whether the measurements of a data set are simulated."""
    _print_pairs({"measurements": "simulated" if entry.object.simulated else "real"})


def _describe_format(entry: Entry) -> None:
    """Print the description of a reader or writer, its needs and its options."""
    _print_docstring(entry)
    if needs := getattr(entry.object, "needs", ""):
        _print_pairs({"needs": needs})
    _print_options(getattr(entry.object, "declared_options", ()))


_DESCRIBE: dict[str, Callable[[Entry], None]] = {
    "problems": _describe_problem, "models": _describe_model, "solvers": _describe_solver,
    "criteria": _describe_criterion, "objectives": _describe_function,
    "splits": _describe_function, "sections": _describe_function, "measures": _describe_function,
    "methods": _describe_method, "datasets": _describe_dataset}


def _print_docstring(entry: Entry) -> None:
    """Print the docstring of a class without its summary and its examples, which are of Python."""
    thing = entry.object
    # Methods and criteria are objects, models and solvers classes.
    text = (thing if isinstance(thing, type) else type(thing)).__doc__
    paragraphs = _EXAMPLE_SECTION.sub("", inspect.cleandoc(text or "")).partition("\n\n")[2].strip()
    if paragraphs:
        echo("\n" + _HEADING.sub(r"\1:", paragraphs))


_HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
"""A heading of a docstring, as numpydoc underlines it."""
_EXAMPLE_SECTION = re.compile(r"^Examples\n-{3,}\n.*?(?=^\w[\w ]*\n-{3,}$|\Z)",
                              re.MULTILINE | re.DOTALL)
"""The examples of a docstring, to the next heading or the end."""


def _print_pairs(values: dict[str, Any]) -> None:
    """Print names and values in two columns, without empty values."""
    shown = {key: value for key, value in values.items() if value}
    width = max(map(len, shown))
    echo()
    for key, value in shown.items():
        echo(f"{key.capitalize() + ':':{width + 2}}{value}")


def _print_options(options: Iterable[Option]) -> None:
    """Print a table of options, or that there are none."""
    options = tuple(options)
    if not options:
        echo("\nNo options.")
        return
    echo("\nOptions:")
    _option_table(options)


def _option_table(options: Iterable[Option]) -> None:
    """Print a table of options: name, default, accepted values, meaning."""
    print_table(("key", "default", "accepts", "meaning"), [
        (option.name, "not set" if option.default in (None, "") else _value_text(option.default),
         _accepted_values(option), option.doc) for option in options])


def _accepted_values(option: Option) -> str:
    """Return the values that an option accepts, and which of them files may not give."""
    return f"{option.accepts} ({option.limits_files})" if option.limits_files else option.accepts


def _value_text(value: Any) -> str:
    """Return a value as it is typed: true and false in small letters."""
    return str(value).lower() if isinstance(value, bool) else str(value)
