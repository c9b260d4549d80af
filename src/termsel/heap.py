"""How much freed memory the process keeps."""

from __future__ import annotations

import sys

_TRIM, _MAPPED = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's malloc.h
_KEPT, _LARGE = 256 << 20, 64 << 20  # bytes


def keep_freed_memory() -> None:
    """Keep up to 256 MB of freed memory for the arrays to come.

    By default glibc gives arrays above 32 MB back to the system at once, which clears every page
    before it is used again: a seventh of the time of a run of 100,000 points. Other C libraries
    are left as they are.
    """
    if sys.platform != "linux":
        return
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM, _KEPT)
        mallopt(_MAPPED, _LARGE)
