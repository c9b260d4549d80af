"""a b + c, rounded once, in kernels: on every machine, whether or not it has an instruction for it.

Compiled kernels are kept on disk until their own file changes; numba does not see changes here.
"""

from __future__ import annotations

from typing import Any

from termsel.adjustment.compiled import LazyKernel
from termsel.adjustment.numba_settings import import_numba


def _fused_intrinsic() -> Any:
    """Return an intrinsic of numba: compiled code calls it as fused(a, b, c), for a b + c."""
    import_numba()
    import numba
    from numba.extending import intrinsic

    number = numba.types.float64

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    # numba asks this function for the types alone; `generate` writes the code.
    def fused(_context: Any, a: Any, b: Any, c: Any) -> Any:
        del a, b, c
        return number(number, number, number), generate

    return intrinsic(fused)


fused = LazyKernel(_fused_intrinsic)
