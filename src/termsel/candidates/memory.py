"""What was found of the last features, for runs in one process on the same data.

Another solver, seed or criterion changes nothing of what the features alone say.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

from termsel.candidates.portfolio import Portfolio
from termsel.measurements.control import Control

KEPT = 16
"""How much is kept, the last used: verdicts and errors, a few numbers for each feature."""

_T = TypeVar("_T")
_known: dict[Hashable, tuple[Any, Any]] = {}
_lock = Lock()


def remembered(what: Hashable, control: Control, portfolio: Portfolio,
               find: Callable[[], _T]) -> _T:
    """Return what was found of equal features and the same candidates, or find it.

    Candidates that failed then are left out of the portfolio now.
    """
    try:
        told = hashlib.sha256(pickle.dumps(control)).digest()  # features may be many
    except (pickle.PicklingError, TypeError, AttributeError):  # by what a package made of an RPC
        return find()
    key = what, told, portfolio.candidates, tuple(portfolio.faults)
    with _lock:
        known = _known.pop(key, None)
    if known is None:
        known = find(), portfolio.faults.copy()
    with _lock:
        _known[key] = known
        if len(_known) > KEPT:
            del _known[next(iter(_known))]
    portfolio.faults.update(known[1])
    return known[0]
