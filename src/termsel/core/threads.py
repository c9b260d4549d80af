"""How many threads linear algebra uses."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that limits BLAS to one thread during its calls."""
    # Matrices are small here. More threads wait for each other in busy loops: that gains nothing,
    # and on a busy machine it takes several times the processor time.
    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with _libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)
    return alone


@lru_cache(1)
def _libraries(_modules: int) -> ThreadpoolController:
    """Return the libraries of this process, found again once modules were imported."""
    return ThreadpoolController()
