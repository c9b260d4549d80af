"""Roles that a command states, whatever the cells of a file say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from termsel.data.roles import asked_roles

_stated: ContextVar[frozenset[str]] = ContextVar("stated", default=frozenset())


@contextmanager
def stating_roles(off: str | None, role: str | None) -> Iterator[None]:
    """Take no cell for the role of a point that one of the options off and role names.

    That holds for tables read during the block. Raises TermselError as `asked_roles`.
    """
    before = _stated.set(frozenset(asked_roles(off, role)))
    try:
        yield
    finally:
        _stated.reset(before)


def ids_with_stated_roles() -> frozenset[str]:
    """Return the ids of the points whose roles the command states."""
    return _stated.get()
