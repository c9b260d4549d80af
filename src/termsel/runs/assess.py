"""One road from a method and prepared data to a result."""

from __future__ import annotations

from collections.abc import Iterable

from termsel.auto.auto import Auto
from termsel.auto.memory import Memory
from termsel.fitting.method import Method
from termsel.results.result import Result
from termsel.runs.choosing import choose_for
from termsel.runs.finding import result_of
from termsel.runs.task import Task
from termsel.runs.task_method import TaskMethod
from termsel.selection.solvers.observers import Observer


def assess(method: Method, task: Task, *, seed: int = 1, observers: Iterable[Observer] = (),
           memory: Memory | None = None) -> Result:
    """Return the result of a method on prepared data.

    Blunders are looked for, the method is fitted, its errors at held-out features are found by
    repeating the whole of it, it is compared with conventional models, and independent points are
    looked at, once, at the end: the same for every method.

    Parameters
    ----------
    method : Method
        `Auto` chooses among methods; `Search` searches the task's problem, or one of its own with
        the task's features; `GivenGenes` takes what an optimiser of one's own has found; any other
        is fitted alone.
    task : Task
        As `termsel.prepare` returns it.
    seed : int
        Of the search by OWDIS, where there are points and lines.
    observers : iterable of callable
        Called with `Progress` after each method that is tried.
    memory : Memory, optional
        What was found of the same features before.

    Returns
    -------
    Result

    Raises
    ------
    TermselError
        If the features do not determine the method, or genes are of another dtype or shape, or out
        of bounds.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> genes = task.problem.genome.random(np.random.default_rng(1), 100)
    >>> order = task.problem.evaluate(genes).order()
    >>> result = termsel.assess(termsel.GivenGenes(genes[order[0]]), task)
    >>> result.solver
    'given'
    """
    memory = memory or Memory()
    if isinstance(method, TaskMethod):
        return result_of(*method.find(task, memory))
    # One method is a choice among one: held out, compared and reported alike.
    auto = method if isinstance(method, Auto) else \
        Auto(methods=(method,), memory=memory)
    return result_of(task.request, choose_for(
        task.request, task.observations, auto, seed, observers))
