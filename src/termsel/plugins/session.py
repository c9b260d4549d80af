"""What is registered in one process, for a notebook or a script."""

from __future__ import annotations

from typing import Any, TypeVar

from termsel.core.arguments import explains_arguments
from termsel.core.errors import unknown_name_error
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import registry

T = TypeVar("T")


def register(thing: T) -> T:
    """Make a model, solver, criterion, problem or anything else known by its name.

    For a notebook or a script: what is registered has its name until the process ends, as if a
    plugin provided it. If something else has the name, ``session:name`` selects this one.

    Parameters
    ----------
    thing : type, Recipe, DatasetSpec or Objective
        What a hook may return: a class of models, criteria, solvers, readers or writers; or a
        description. It replaces what was registered by its name.

    Returns
    -------
    object
        The same thing, so that it serves as a decorator.

    Raises
    ------
    TermselError
        If it is no such thing.

    Examples
    --------
    >>> import termsel
    >>> @termsel.register
    ... class Shift(termsel.Polynomial2D):
    ...     "A polynomial of degree 1 by default."
    ...     name = "poly-1"
    ...     declared_options = (termsel.Option("degree", 1, "Total degree.", int, 1, 8),)
    >>> termsel.run("poly-terms", model="poly-1", solver="all-terms").selection.terms[:3]
    ('line.num:1', 'line.num:X', 'line.num:Y')
    """
    registered: T = registry().register(thing)
    return registered


@explains_arguments()
def get(kind: str, name: Any) -> Any:
    """Return the thing that has a name, whoever provides it.

    Parameters
    ----------
    kind : str
        Such as "models", "solvers" or "problems", as for ``termsel list``, or "model" for one.
    name : str, type or object
        A name, perhaps as ``distribution:name``; or a thing of that kind, which is returned.

    Returns
    -------
    type or object
        The class of a model, criterion, solver, reader or writer; or a description.

    Raises
    ------
    TermselError
        If nothing has the name, it is no thing of that kind, or there is no such kind.

    Examples
    --------
    >>> import termsel
    >>> termsel.get("models", "poly2d").__name__
    'Polynomial2D'
    """
    plurals = {each.word: plural for plural, each in KINDS.items()}
    plural = plurals.get(kind, kind)
    if plural not in KINDS:
        raise unknown_name_error("kind", kind, KINDS)
    return registry().resolve(plural, name)
