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
    """Take no cell for the role of a point that one of the options off and role names.

    That holds for tables read during the block. Raises TermselError as `asked_roles`.
    """
    before = _stated.set(asked_roles(off, role))
    try:
        yield
    finally:
        _stated.reset(before)


def ids_with_stated_roles() -> frozenset[str]:
    """Return the ids of the points whose roles the command states."""
    return frozenset(_stated.get())


def without_stated_off(features: FeatureSet) -> FeatureSet:
    """Return features without the points that the command says are off."""
    off = {name for name, role in _stated.get().items() if role == "off"}
    points = features.points
    if not off.intersection(points.ids):
        return features
    return features.with_(points=points.take(np.array([name not in off for name in points.ids])))
