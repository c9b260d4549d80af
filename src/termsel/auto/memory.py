"""What was found of the last features, for runs in one process on the same data.

Another solver, seed or criterion changes nothing of what the features alone say.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from termsel.auto.portfolio import Portfolio
from termsel.data.control import Control

KEPT = 16
"""How much is kept, the last used: verdicts and errors, a few numbers for each feature."""

_T = TypeVar("_T")
_known: dict[Hashable, tuple[Any]] = {}

_UNTOLD = (pickle.PicklingError, TypeError, AttributeError, ValueError, RecursionError,
           NotImplementedError)
"""What pickling raises of what cannot be."""


def remembered(what: Hashable, control: Control, portfolio: Portfolio,
               find: Callable[[], _T]) -> _T:
    """Return what was found of equal features and the same candidates, or find it.

    Nothing is kept where a candidate failed, as it may not the next time.
    """
    try:
        told = hashlib.sha256(pickle.dumps(control)).digest()  # features may be many
    except _UNTOLD:  # by what a package made of an RPC
        return find()
    key = what, told, portfolio.candidates, tuple(portfolio.faults)
    found = _known.pop(key, None)  # put to the end; each step is one for all threads
    if found is None:
        before = len(portfolio.faults)
        found = (find(),)
        if len(portfolio.faults) > before:
            return found[0]
    _known[key] = found
    while len(_known) > KEPT:
        _known.pop(list(_known)[0], None)  # noqa: RUF015 (threads may add meanwhile)
    return found[0]
