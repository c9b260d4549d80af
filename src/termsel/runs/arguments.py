"""What is meant by arguments that `run` and `prepare` do not take: by name, place or kind."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import signature
from pathlib import Path

from termsel.plugins.registry import registry
from termsel.runs.request import DATA_OPTIONS, owners_of_options
from termsel.selection.solvers.budget import SEARCH_OPTIONS

_OF_RESULT = {
    "report": "result.report('report.html') writes it.",
    "export": "termsel.export(result, FORMAT, PATH) writes it.",
    "verbose": "result.summary(verbose=True) returns all of the summary.",
    "json": "result.to_json() returns it.",
    "image_size": "It is a property of the features: termsel.read(..., image=FILE).",
    "set": "Options are options={NAME: VALUE}.",
    "output": "The folder of the result is out=."}
"""What options of the command line, and of other functions, are after a run in Python."""

_FEATURES = ("points", "gcps", "file", "files", "data", "path")
"""What the features are called elsewhere."""


_BUDGETS = frozenset((
    "budget", "iterations", "n_iter", "max_iter", "maxiter", "niter", "n_trials", "trials",
    "max_evals", "n_evals", "max_evaluations", "n_gen", "max_generations", "timeout", "max_time",
    "time_limit", "epochs"))
"""What bounds a search elsewhere."""


def argument_meant(name: str, value: object, given: Mapping[str, object]) -> str:
    """Return a sentence on what an argument of `run` should be; "" if nothing is known of it.

    `given` has the arguments that `run` takes: files that are named among them are named again.
    """
    shown = repr(value) if isinstance(value, str | Path | int | float) else "..."
    if name in _FEATURES:
        return f"Points and lines are features={shown}."
    features = given.get("features")
    table = repr(str(features)) if isinstance(features, str | Path) else "FILE"
    if name == "lines":
        return f"Points and lines are read together: features=termsel.read({table}, {shown})."
    if name in _BUDGETS:
        return "A search is bounded by evaluations=, generations= or seconds=."
    if name in _OF_RESULT:
        return _OF_RESULT[name]
    if name in _names_of_options():
        return f"It is an option: options={{{name!r}: {shown}}}."
    if name in _names_of_reading():
        return f"termsel.read has it: features=termsel.read({table}, {name}={shown})."
    return ""


def files_by_name(values: tuple[object, ...]) -> str:
    """Return how the files are to be given that were given to `run` by position.

    `values` are all arguments by position, of which the first may be the name of a problem.
    """
    first, second = (repr(str(value)) if isinstance(value, str | Path) else "..."
                     for value in values[:2])
    is_problem = isinstance(values[0], str) and registry().known("problems", values[0]) is not None
    if is_problem:
        return f"Points and lines are features={second}."
    return (f"Points and lines are features={first}, an RPC is rpc={second}. A table of lines is "
            f"read together with that of points: features=termsel.read({first}, {second}).")


def _names_of_options() -> set[str]:
    """Return the names of all options of data, searches, problems, models, solvers and criteria."""
    of_problems = [option for entry in registry().entries("problems")
                   for option in entry.object.options]
    return {*owners_of_options(), *(option.name for option in (
        *DATA_OPTIONS, *SEARCH_OPTIONS, *of_problems))}


def _names_of_reading() -> set[str]:
    """Return the names of all arguments of `termsel.read`, those of readers and packages too."""
    from termsel.io.read import read, read_options  # readers, for this message alone

    of_readers = [option for entry in registry().entries("readers")
                  for option in entry.object.declared_options]
    return {*signature(read).parameters,
            *(option.name for option in (*read_options(), *of_readers))}
