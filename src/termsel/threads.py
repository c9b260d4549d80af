"""How many threads linear algebra uses."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function during whose calls BLAS keeps to one thread.

    Matrices are small here. Further threads wait for each other in busy loops, which gains
    nothing and takes several times the processor's time on a machine that is busy.

    Parameters
    ----------
    function : callable
    """
    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)
    return alone
