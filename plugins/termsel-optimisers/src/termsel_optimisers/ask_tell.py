"""Optimisers that ask and tell, as solvers: the interface of optuna, nevergrad and many others."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Protocol

import numpy as np

from termsel import Evaluation, Generation, Problem, Solver, TermselError
from termsel.toolkit import attribute_errors_to
from termsel.toolkit.runs import difference_from_shape, fault_of_method
from termsel.toolkit.searches import SEGMENTS, AnySegment, Genes

CHECK = "Check your optimiser: ask() and tell()."


class AskTell(Protocol):
    """An optimiser that is asked what to evaluate, and told what came of it."""

    def ask(self) -> Any:
        """Return genes, shape (size,), or several, shape (p, size); None ends the search."""

    def tell(self, genes: Genes, evaluation: Evaluation) -> None:
        """Take an evaluation, and the repaired genes (p, size) that it is of."""


def from_ask_tell(factory: Callable[[Problem, np.random.Generator], AskTell], *,
                  name: str | None = None, max_objectives: int = 1) -> type[Solver]:
    """Return a solver made of an optimiser of one's own, or of another library.

    Parameters
    ----------
    factory : callable
        Takes a problem and the generator that all chance comes from, and returns an optimiser, an
        object with two methods. ``ask()`` returns the genes of one selection, shape (size,), or of
        several, shape (p, size), or None where it has none left. They are repaired to what the
        genome allows, and evaluated. ``tell(genes, evaluation)`` takes these genes (p, size) and
        the `Evaluation`, whose violation is 0 where a selection is feasible. A class is a factory,
        too.
    name : str, optional
        Name of the solver; by default that of the factory.
    max_objectives : int
        Most objectives that it takes.

    Returns
    -------
    type[Solver]
        For the argument ``solver`` of `termsel.run`, `termsel.search` and `termsel.compare`.

    Raises
    ------
    TermselError
        For what is no function or class; in the search for genes of another shape.

    Examples
    --------
    >>> import termsel, termsel_optimisers
    >>> class OneFlip:
    ...     def __init__(self, problem, rng):
    ...         self.rng, self.best, self.cost = rng, problem.genome.random(rng, 1)[0], float("inf")
    ...     def ask(self):
    ...         genes = self.best.copy()
    ...         genes[self.rng.integers(len(genes))] ^= True
    ...         return genes
    ...     def tell(self, genes, evaluation):
    ...         cost = evaluation.objectives[0, 0] + 1e6 * evaluation.violation[0]
    ...         if cost <= self.cost:
    ...             self.best, self.cost = genes[0], cost
    >>> mine = termsel_optimisers.from_ask_tell(OneFlip, name="one-flip")
    >>> termsel.run("poly-terms", solver=mine, evaluations=200, options={"degree": 2}).evaluations
    200
    """
    if not callable(factory):
        raise TermselError(f"{factory!r:.100} is no function or class",
                           hint="Give what makes an optimiser from a problem and a generator.")
    factory_name = getattr(factory, "__name__", "from-ask-tell")
    # Within the class below its own names would hide the arguments.
    doc = inspect.getdoc(factory) or "An optimiser of a user's own."
    objectives_limit = max_objectives

    class FromAskTell(Solver):
        __doc__ = doc.splitlines()[0]
        max_objectives = objectives_limit
        segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS

        def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
            """Yield the evaluation of each question, until the optimiser asks for no more (None).

            A factory or an optimiser at fault raises a `PluginFault` that says what it should
            do, such as for genes of another number than those of the problem.
            """
            with attribute_errors_to(factory, factory_name, CHECK):
                optimiser = factory(problem, rng)
            for index in itertools.count():
                with attribute_errors_to(optimiser, "ask", CHECK):
                    candidates = optimiser.ask()
                    if candidates is None and index:
                        return
                    if candidates is None:
                        raise fault_of_method(optimiser, "ask",
                                              "returned None at once; expected genes, and "
                                              "None where there are no more", CHECK)
                    # One selection or several, of numbers that the genome turns into its genes.
                    candidates = np.atleast_2d(np.asarray(candidates, dtype=float))
                if fault := difference_from_shape(candidates, (-1, problem.genome.size)):
                    raise fault_of_method(optimiser, "ask", fault, CHECK)
                # The optimiser is told the repaired genes, of which the evaluation is.
                genes = problem.genome.repair(candidates, rng)
                evaluation = problem.evaluate(genes)
                with attribute_errors_to(optimiser, "tell", CHECK):
                    optimiser.tell(genes, evaluation)
                yield Generation(index, genes, evaluation)

    FromAskTell.name = name or factory_name.strip("_").replace("_", "-").lower()
    return FromAskTell
