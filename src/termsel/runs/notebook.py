"""Progress in a notebook: one line below the cell that is renewed in place."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from termsel.selection.solvers.ledger import Progress

_RENEWAL_SECONDS = 0.2
"""Seconds between two renewals."""

_inside = ContextVar("_inside", default=False)
"""Whether a line of many runs is shown, so that a run shows none of its own."""


def notebook_observer(title: str) -> Callable[[Progress], None] | None:
    """Return an observer that shows how far a run is; None outside a notebook and in a study."""
    show = _line_renewer(title)
    if show is None:
        return None

    def observe(progress: Progress) -> None:
        """Show the share done, the best value (- if none is valid yet) and the evaluations."""
        # A search without a budget has no share that is done.
        share = "" if progress.share is None else f" {100 * progress.share:.0f} %,"
        has_best = progress.violation == 0 and math.isfinite(progress.best)
        best = f"{progress.best:.4g}" if has_best else "-"
        show(f"{progress.what or title}:{share} best {best}, {progress.evaluations} evaluations",
             progress.share is not None and progress.share >= 1)

    return observe


@contextmanager
def line_of_many(title: str) -> Iterator[Callable[[str, bool], None]]:
    """Show one line for many runs, which show none of their own.

    Yielded is a function of the text of the line, and whether it is the last one. Outside a
    notebook it shows nothing.
    """
    show = _line_renewer(title)
    token = _inside.set(True)
    try:
        yield show or (lambda _text, _last: None)
    finally:
        _inside.reset(token)


def _line_renewer(title: str) -> Callable[[str, bool], None] | None:
    """Return a function that renews a line in a notebook.

    It takes the text of the line, and whether it is the last one. Returns None outside a notebook,
    or where another line is shown already.
    """
    # Where there is a notebook, IPython is imported already.
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if shell is None or not hasattr(shell, "kernel") or _inside.get():
        return None
    from IPython.display import display

    line = display({"text/plain": f"{title}: ..."}, raw=True, display_id=True)
    shown = 0.0

    def show(text: str, last: bool) -> None:
        nonlocal shown
        # Renewing a line costs more than a generation of a small problem.
        if time.monotonic() - shown >= _RENEWAL_SECONDS or last:
            shown = time.monotonic()
            line.update({"text/plain": text}, raw=True)

    return show
