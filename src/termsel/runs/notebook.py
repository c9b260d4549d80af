"""Progress in a notebook: one line below the cell that is renewed in place."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any

from termsel.solvers.ledger import Progress

_EVERY = 0.2
"""Seconds between two renewals."""


def notebook_observer(title: str) -> Callable[[Progress], None] | None:
    """Return an observer that shows how far a run is, or None outside a notebook.

    Parameters
    ----------
    title : str
    """
    # Where there is a notebook, IPython is imported already.
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display

    line = display({"text/plain": f"{title}: ..."}, raw=True, display_id=True)
    shown = 0.0

    def observe(progress: Progress) -> None:
        nonlocal shown
        done = progress.share is not None and progress.share >= 1
        if time.monotonic() - shown < _EVERY and not done:
            return
        shown = time.monotonic()
        share = "" if progress.share is None else f" {100 * progress.share:.0f} %,"
        found = progress.violation == 0 and math.isfinite(progress.best)
        best = f"{progress.best:.4g}" if found else "-"
        line.update({"text/plain": f"{progress.what or title}:{share} best {best}, "
                                   f"{progress.evaluations} evaluations"}, raw=True)

    return observe
