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


def without_off(features: FeatureSet) -> FeatureSet:
    """Return features without those that are off, as the command says or else the file."""
    stated = _stated.get()
    points = features.points
    off = {name for name, role in {**dict(zip(points.ids, points.roles, strict=True)),
                                   **stated}.items() if role == "off"}
    if not off.intersection(features.ids):
        return features
    return features.take(np.array([name not in off for name in features.ids]))
