"""How functions are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile on first call and keep the machine code on disk."""
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
