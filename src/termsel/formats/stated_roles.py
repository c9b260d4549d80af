"""Roles that a command states, whatever the cells of a file say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType

import numpy as np

from termsel.data.features import FeatureSet
from termsel.data.roles import asked_roles

_stated: ContextVar[Mapping[str, str]] = ContextVar("stated", default=MappingProxyType({}))


@contextmanager
def stating_roles(off: str | None, role: str | None) -> Iterator[None]:
    """Let the options off and role decide the roles of the points they name, whatever files say.

    That holds for tables read during the block. Raises TermselError as `asked_roles` does.
    """
    token = _stated.set(asked_roles(off, role))
    try:
        yield
    finally:
        _stated.reset(token)


def ids_with_stated_roles() -> frozenset[str]:
    """Return the ids of the points whose roles the command states."""
    return frozenset(_stated.get())


def ids_stated_off() -> frozenset[str]:
    """Return the ids of the points that the command switches off."""
    return frozenset(name for name, role in _stated.get().items() if role == "off")


def without_off(features: FeatureSet) -> FeatureSet:
    """Return the features that are not off, by what the command states, else by the file."""
    points = features.points
    role_of = {**dict(zip(points.ids, points.roles, strict=True)), **_stated.get()}
    off_ids = {name for name, role in role_of.items() if role == "off"}
    if not off_ids.intersection(features.ids):
        return features
    return features.take(np.array([name not in off_ids for name in features.ids]))
