"""What to say where memory is short: what was too large, and what would fit."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from termsel.core.errors import TermselError

_ARRAY = re.compile(r"shape \((?P<shape>[\d, ]+)\)")
_SIZE = re.compile(r"allocate (?P<amount>[\d.]+) (?P<unit>\w+)")
_BYTES_BY_UNIT = {"bytes": 1.0, "B": 1.0, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30,
                  "TiB": 2.0**40,
                  "PiB": 2.0**50, "EiB": 2.0**60}
_SHARE = 0.8
"""Part of the free memory that may be counted on."""


def out_of_memory(error: MemoryError) -> TermselError:
    """Return the error for a computation that memory is too small for.

    NumPy says which array it could not allocate. The longest side of it mostly is the number of
    points or pixels, so that a share of these would fit.
    """
    # NumPy's message: Unable to allocate 7.45 GiB for an array with shape (31623, 31623) and ...
    message = str(error)
    size = _SIZE.search(message)
    required = float(size["amount"]) * _BYTES_BY_UNIT.get(size["unit"], 0.0) if size else 0.0
    array = _ARRAY.search(message)
    shape = [int(length) for length in array["shape"].split(",") if length.strip()] if array else []
    free = _free_bytes()
    problem = "there is not enough memory"
    if shape and required:
        lengths = " x ".join(f"{length:,}" for length in shape)
        problem += f" for an array of {lengths}: {_bytes_in_words(required)}"
    if free is not None:
        problem += f"; {_bytes_in_words(free)} are free"
    hint = ("Give fewer points, a smaller part of the image or a simpler model, or run it on a "
            "machine, or with a limit (ulimit -v, or that of the batch system), of more memory.")
    if free is not None and shape and required > free > 0:
        longest = max(shape)
        # required / free = (longest / fits)^times, with times = 2 for a matrix of all pairs.
        times = shape.count(longest)
        fits = int(longest * (_SHARE * free / required) ** (1 / times))
        hint = f"About {fits:,} in place of {longest:,} would fit. {hint}"
    return TermselError(problem, hint=hint)


def _free_bytes() -> float | None:
    """Return the bytes that this process can still have; None where that is not known."""
    limits = [value for value in (_free_memory_of_machine(), _memory_below_limit())
              if value is not None]
    return max(0.0, min(limits)) if limits else None


def _free_memory_of_machine() -> float | None:
    """Return how many bytes of memory are free for all processes; None on systems but Linux."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((float(line.split()[1]) * 1024 for line in lines
                 if line.startswith("MemAvailable:")), None)


def _memory_below_limit() -> float | None:
    """Return how many bytes of memory this process may still take; None if it has no limit."""
    if sys.platform == "win32":
        return None
    import resource

    # What this process has already counts against its limit.
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return None
    try:
        # The first number is the size of the address space, in pages.
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        return float(limit)
    return float(limit - pages * resource.getpagesize())


def _bytes_in_words(size: float) -> str:
    """Return a number of bytes in words."""
    return f"{size / 2**30:,.1f} GiB" if size >= 2**29 else f"{size / 2**20:,.0f} MiB"
