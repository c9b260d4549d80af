"""Progress on stderr: a bar where it is a terminal, lines of JSON where a program asks for them."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import click

from termsel.cli.messages import echo
from termsel.cli.options.shared import PROGRESS
from termsel.core.errors import count_in_words, make_printable, percent_text

if TYPE_CHECKING:
    from termsel.selection.solvers.ledger import Progress
    from termsel.studies.execution.progress import StudyProgress

_BETWEEN = 0.2  # seconds between two lines


@contextmanager
def search_bar(title: str, quiet: bool) -> Iterator[Callable[[Progress], None] | None]:
    """Yield an observer that shows the progress of a run; None where nobody would see it."""
    with _show_bar(title, quiet) as renew:
        def observe(progress: Progress) -> None:
            """Show the share that is done, the best value and the number of evaluations."""
            # A population without a feasible member has a best value that means nothing.
            feasible = progress.violation == 0 and math.isfinite(progress.best)
            best = f"{progress.best:.4g}" if feasible else "-"
            assert renew is not None
            renew(completed=progress.share or 0, description=progress.what or make_printable(title),
                  total=None if progress.share is None else 1.0,
                  state=f"best {best}, {_bound_or_count(progress)}")

        yield observe if renew else None


def _bound_or_count(progress: Progress) -> str:
    """Return the lower bound and the gap of a proof, or the number of evaluations without a bound.
    """
    certificate = progress.generation.details.get("certificate") or {}
    if "bound" not in certificate:
        return count_in_words(progress.evaluations, "evaluation")
    gap = certificate.get("gap")
    return (f"bound {certificate['bound']:.4g}, gap "
            + ("unknown" if gap is None else percent_text(gap)))


@contextmanager
def share_bar(title: str, quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function that shows the fraction done, or None where nobody would see it."""
    with _show_bar(title, quiet, total=1.0) as renew:
        # None where there is no bar, so that callers ask nothing but whether there is an observer.
        yield renew and (lambda share: renew(completed=share))


@contextmanager
def study_bar(quiet: bool) -> Iterator[Callable[[StudyProgress], None] | None]:
    """Yield an observer that shows the progress of a study; None where nobody would see it."""
    with _show_bar("runs", quiet, remaining=False) as renew:
        def observe(progress: StudyProgress) -> None:
            worst = f"; worst {make_printable(progress.worst)}" if progress.worst else ""
            assert renew is not None
            renew(completed=progress.finished, total=progress.total,
                  state=f"{progress.time_left()}; {progress.text()}{worst}")

        yield observe if renew else None


@contextmanager
def _show_bar(title: str, quiet: bool, *, total: float | None = None, remaining: bool = True,
              ) -> Iterator[Callable[..., None] | None]:
    """Yield a function that renews a bar, which disappears at the end; None if none is shown.

    It prints lines of JSON instead where the user asked for these, and takes `completed`, `total`,
    `description` and `state`, as ``rich.progress.Progress.update`` does. No bar is shown if
    `quiet`, or if stderr is no terminal. Text printed meanwhile appears above the bar.
    """
    context = click.get_current_context(silent=True)
    if context is not None and context.meta.get(PROGRESS) == "json" and not quiet:
        yield _json_printer(title, total)
        return
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    # A name may look like markup of rich, such as [red].
    columns = (TextColumn("{task.description}", markup=False), BarColumn(bar_width=20),
               TaskProgressColumn(), TextColumn("{task.fields[state]}", markup=False),
               TimeElapsedColumn(), *([TimeRemainingColumn()] if remaining else []))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(make_printable(title), total=total, state="")
        yield partial(bar.update, task)


def _json_printer(title: str, total: float | None) -> Callable[..., None]:
    """Return a function that prints progress as lines of JSON, each `_BETWEEN` s after the last.

    Only the line that reports the end is printed at any time: a reader waits for it.
    """
    printed = -math.inf

    def renew(*, completed: float, total: float | None = total, description: str = title,
              state: str = "") -> None:
        """Print the progress as a line of JSON, unless the last one is too recent."""
        nonlocal printed
        # None says that the end is not known, and null is what a reader gets.
        share = completed / total if total else None
        if time.monotonic() - printed < _BETWEEN and share != 1.0:
            return
        printed = time.monotonic()
        echo(json.dumps({"progress": share, "what": description, "state": state}), err=True)

    return renew
