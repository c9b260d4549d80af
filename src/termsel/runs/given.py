"""What a run is given: parts by their class or as an instance, objectives by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from termsel.auto.auto import Auto
from termsel.auto.function import FunctionMethod
from termsel.auto.memory import Memory
from termsel.core.errors import TermselError
from termsel.core.options import Configurable
from termsel.data.features import FeatureSet
from termsel.fitting.method import Method
from termsel.plugins.registry import registry
from termsel.selection.criteria import Criterion
from termsel.selection.problems.constraints import listed
from termsel.selection.problems.objectives import Objective
from termsel.selection.problems.recipes import Recipe, undeclared_options


def auto_of(method: str | Method | Callable[[FeatureSet], Any] | None,
            memory: Memory | None = None) -> Auto:
    """Return the choice by a method: its name, itself or a function; by default among all."""
    if method is None or method == "auto":
        return auto_of_all(memory)
    if isinstance(method, Auto):
        return method
    # A plain function gets its own name in tables.
    if callable(method) and not isinstance(method, Method | type):
        name = getattr(method, "__name__", "function")
        method = FunctionMethod(name, f"the function {name}", function=method)
    if not isinstance(method, str | Method):
        raise TermselError(f"{method!r:.60} is no method",
                           hint="Give the name of one (termsel list methods), or a termsel.Method.")
    methods = (registry().get("methods", method) if isinstance(method, str) else method,)
    return Auto(methods=methods, memory=memory or Memory())


def auto_of_all(memory: Memory | None = None) -> Auto:
    """Return the choice among all methods but those on request.

    Of two with one name it takes termsel's own, or the first.
    """
    methods = tuple(entry.object for entry in registry().entries("methods")
                    if entry.name == entry.object.name and not entry.object.on_request)
    return Auto(methods=methods, memory=memory or Memory())


def class_of(component: type[Configurable] | Configurable) -> type[Configurable]:
    """Return a class, or that of an instance."""
    return component if isinstance(component, type) else type(component)


def with_options(role: str, component: type[Configurable] | Configurable,
                 options: Mapping[str, Any]) -> Any:
    """Return an instance of a class, or the instance that is given, which takes no options.

    `role` is what it is, such as "model".
    """
    # A class gets the options; an instance has been made with its own.
    if isinstance(component, type):
        try:
            return component(**options)
        except TermselError as error:
            error.name = error.name or str(component.name)
            raise
    if options:
        raise TermselError(f"option {next(iter(options))!r} is for the {role} {component.name!r}, "
                           "which has its options already",
                           hint=f"Give them with the name or the class of the {role}.",
                           name=next(iter(options)))
    return component


def second_solver(recipe: Recipe, settings: Mapping[str, Any]) -> Any:
    """Return the solver of the second of two steps as asked for, or the problem's; or None.

    Given are the options of all parts. Refuses a solver, or options of one, where there is no
    second step, or no solver of its own.
    """
    options = {option.name: option.default
               for option in (*recipe.options, *undeclared_options(recipe))}
    of_second_solver = [key for key in settings if key.startswith("then.")]
    stated = next((settings[key] for key in ("then", "problem.then") if key in settings), None)
    if "then" not in options:
        if stated is not None or of_second_solver:
            raise TermselError(
                f"problem {recipe.name!r} has no steps, so no second step has a solver (--then)",
                hint="Leave it out, or choose a problem of terms and features, such as "
                     "owdis-lines-terms.")
        return None
    # Either plain, or with the part it is of: steps, problem.steps.
    steps = next((settings[key] for key in ("steps", "problem.steps") if key in settings),
                 options.get("steps"))
    if steps == "joint" and (stated is not None or of_second_solver):
        raise TermselError(
            f"{of_second_solver[0] if stated is None else '--then'} is for the solver of the "
            "second of two steps, and steps=joint has one",
            hint="Add --set steps=features-first or steps=terms-first.")
    solver = None if steps == "joint" else options["then"] if stated is None else stated
    if of_second_solver and solver is None:
        raise TermselError(f"{of_second_solver[0]} is for the solver of the second step, and "
                           "--then names none",
                           hint="Add --then NAME, such as --then pso.")
    return solver


def objectives_of(names_listed: str | None, criterion: Criterion) -> tuple[Objective, ...]:
    """Return the objectives that an option names, each once, without the criterion.

    The names are separated by commas; one that no objective has is refused.
    """
    # The criterion is the first objective already.
    names = [name for name in dict.fromkeys(listed(names_listed)) if name != criterion.name]
    return tuple(registry().get("objectives", name) for name in names)
