"""How linear algebra uses the machine: threads, and memory between its arrays."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

FREED = 1 << 20
"""Numbers of an array that is freed at once, and never filled."""

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that limits BLAS to one thread during its calls.

    Matrices are small here: further threads wait for each other in busy loops, which gains nothing,
    and on a busy machine takes several times the processor time.
    """
    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function with one thread for linear algebra."""
        if not _memory_is_kept:
            _keep_freed_memory()
        with _find_libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)
    return alone


def _keep_freed_memory() -> None:
    """Let the C library keep memory that arrays free, once in a process.

    That of Linux gives back what is free beyond twice the largest piece that was ever freed, and
    asks the system for it again at the next array: 256 page faults for each of 1 MB. A run of auto
    on 74 points has 15,000 of them, and 700 with this, which saves 6 to 11 % of its processor time.
    Nothing is done before numpy is imported.
    """
    numpy = sys.modules.get("numpy")
    if numpy is not None:
        # Allocated and freed at once: from now on the library keeps up to twice as much.
        numpy.empty(FREED)
        _memory_is_kept.append(True)


_memory_is_kept: list[bool] = []
"""Whether this process has freed such an array."""


@lru_cache(1)  # searched again only when modules were imported
def _find_libraries(_modules: int) -> ThreadpoolController:
    """Return the libraries of this process, found again once modules were imported."""
    return ThreadpoolController()
