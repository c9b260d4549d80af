"""What is given to a run by its class, or as an instance, and not by its name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from termsel.errors import TermselError
from termsel.options import Configurable


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
