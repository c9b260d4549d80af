"""What a run is given: parts by their class or as an instance, objectives by their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from termsel.criteria import Criterion
from termsel.errors import TermselError
from termsel.options import Configurable
from termsel.plugins.registry import registry
from termsel.problems.constraints import listed
from termsel.problems.objectives import Objective


def class_of(part: type[Configurable] | Configurable) -> type[Configurable]:
    """Return a class, or that of an instance."""
    return part if isinstance(part, type) else type(part)


def with_options(word: str, part: type[Configurable] | Configurable,
                 options: Mapping[str, Any]) -> Any:
    """Return an instance of a class, or the instance that is given.

    Parameters
    ----------
    word : str
        What it is, such as "model".
    part : class or instance
    options : mapping

    Raises
    ------
    TermselError
        If there are options for an instance.
    """
    if isinstance(part, type):
        return part(**options)
    if options:
        raise TermselError(f"option {next(iter(options))!r} is for the {word} {part.name!r}, which "
                           "has its options already",
                           hint=f"Give them with the name or the class of the {word}.")
    return part


def objectives_of(asked: str | None, criterion: Criterion) -> tuple[Objective, ...]:
    """Return the objectives that an option names, each once, without the criterion.

    Parameters
    ----------
    asked : str or None
        Names, separated by commas.
    criterion : Criterion

    Raises
    ------
    TermselError
        For a name that no objective has.
    """
    names = [name for name in dict.fromkeys(listed(asked)) if name != criterion.name]
    return tuple(registry().get("objectives", name) for name in names)
