"""Public base of problems: genes in, objectives and violations out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.isolation.arrays import difference_from_shape, difference_from_type
from termsel.core.isolation.calls import Check, Guarded
from termsel.core.remedies import Remedy
from termsel.data.features import FeatureSet, FloatArray, IntArray, Points
from termsel.data.record.search import SelectionRecord
from termsel.models.base import SensorModel
from termsel.selection.criteria import Criterion
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Genes

if TYPE_CHECKING:
    from termsel.selection.best_subsets.columns.system import SubsetSystem
    from termsel.selection.best_subsets.features.walk import RowSystem
    from termsel.selection.problems.objectives import Objective

WORST = 1e9
"""Objective of an individual without a figure; finite, so that it can be compared."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Objectives and violations of a population; always finite, smaller is better.

    Parameters
    ----------
    objectives : ndarray, shape (p, m)
        Of p individuals; the lower the better, always finite.
    violation : ndarray, shape (p,)
        0 for a feasible individual, else by how much it violates the constraints.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> best = termsel.Evaluation(np.array([[0.8], [0.6]]), np.zeros(2)).objectives.min()
    >>> float(best)
    0.6
    """

    objectives: FloatArray
    violation: FloatArray

    def take(self, index: IntArray) -> Evaluation:
        """Return the evaluation of some individuals."""
        return Evaluation(self.objectives[index], self.violation[index])

    def order(self) -> IntArray:
        """Return the individuals, (p,), from best to worst by first objective, feasible ones first.
        """
        # The last key counts first: violations, then objectives; equal ones stay in their order.
        return np.lexsort((self.objectives[:, 0], self.violation))


@dataclass(frozen=True)
class Selection:
    """What a chromosome selects.

    Parameters
    ----------
    terms, features : tuple of str
        Names of the model terms and ids of the control features in use.
    parameters : mapping
        Values by name: numbers, text or bool. Those that the model has an option for are the values
        of these options; `terms` are those of that model. Others are recorded.

    Examples
    --------
    >>> import termsel
    >>> termsel.Selection(("line:1", "sample:1"), ("P1", "P2")).features
    ('P1', 'P2')
    """

    terms: tuple[str, ...]
    features: tuple[str, ...]
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def record(self) -> SelectionRecord:
        """Return the selection as the record of a run holds it."""
        return SelectionRecord(self.terms, self.features, len(self.terms), len(self.features),
                               self.parameters)


@dataclass(frozen=True, eq=False)
class EnumerablePart:
    """Genes whose part of the objective depends on no others, and can be enumerated.

    Parameters
    ----------
    genes : ndarray of int, shape (k,)
        Numbers of the genes that switch the system's columns.
    system : SubsetSystem
    score : {"check", "rss", "press", "kfold"}
        What a subset is judged by: squared errors at check rows, or of the control rows, as they
        are, each left out, or fold by fold.
    cost : callable
        Turns the best score of every size, shape (k + 1,), into what adds up over the parts.
    folds : tuple of ndarray of int
        Control rows of each fold, for the score "kfold".
    pixels : float
        px per unit of the system's target.

    Examples
    --------
    >>> import termsel
    >>> parts = termsel.prepare("poly-terms", options={"degree": 2}).problem.parts()
    >>> [len(part.genes) for part in parts]  # line and sample, six terms each
    [6, 6]
    """

    genes: IntArray
    system: SubsetSystem
    score: str
    cost: Callable[[FloatArray], FloatArray]
    folds: tuple[IntArray, ...] = ()
    pixels: float = 1.0


def evaluation_fault(problem: Problem, value: Any, genes: Genes, *_near: Any,
                     **_named: Any) -> str | None:
    """Return what is wrong with the evaluation of a population; None if nothing is.

    It is a clause to follow the name of a method, such as "returned as objectives ...". Further
    arguments are those of `Problem.evaluate_near`, whose evaluation is checked in the same way.
    """
    n = len(genes)
    names = problem.objectives
    return (difference_from_type(value, Evaluation)
            or difference_from_shape(
                value.objectives, (n, len(names)), verb="returned as objectives")
            or difference_from_shape(value.violation, (n,), verb="returned as violation"))


def _is_number(value: Any) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


def _selection_fault(_problem: Problem, value: Any, *_args: Any) -> str | None:
    """Return how a decoded selection is at fault; None if it is not.

    It is a clause that follows the name of the method.
    """
    # A record of the run takes names, and values that JSON has.
    fault = difference_from_type(value, Selection)
    if fault is None:
        for attribute, names in (("terms", value.terms), ("features", value.features)):
            if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
                return f"returned as {attribute} {names!r:.200}; expected a tuple of names"
        if not isinstance(value.parameters, Mapping) or not all(
                isinstance(name, str) and (isinstance(parameter, str) or _is_number(parameter))
                for name, parameter in value.parameters.items()):
            return (f"returned as parameters {value.parameters!r:.200}; expected finite numbers, "
                    "text or bool by name")
    return fault


def _parts_fault(_problem: Problem, value: Any) -> str | None:
    """Return how a value is at fault that should be a tuple of enumerable parts; or None.

    It is a clause that follows the name of the method.
    """
    if isinstance(value, tuple) and all(isinstance(part, EnumerablePart) for part in value):
        return None
    return f"returned {value!r:.200}; expected a tuple of EnumerablePart"


def _moves_fault(problem: Problem, value: Any, *_args: Any) -> str | None:
    """Return how the genes of moves are at fault; None if they are not.

    It is a clause that follows the name of the method.
    """
    if fault := problem.genome.fault(value):
        return f"yields {fault}"
    return None if problem.genome.keeps(value).all() else (
        "yields genes in which forced ones are switched, or too few or too many are on")


def _design_fault(problem: Problem, value: Any) -> str | None:
    """Return how a value is at fault that should have one column for each gene; or None.

    It is a clause that follows the name of the method.
    """
    return difference_from_shape(value, (-1, problem.genome.size))


class Problem(Guarded, ABC):
    """What a solver sees: a genome, names of objectives, and an evaluation of genes.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> class OneMax(termsel.Problem):
    ...     "As many ones as possible."
    ...     genome = termsel.Genome([termsel.Bits("bits", tuple("abcd"))])
    ...     objectives = ("zeros",)
    ...
    ...     def evaluate(self, genes):
    ...         zeros = (np.asarray(genes) == 0).sum(axis=1, keepdims=True)
    ...         return termsel.Evaluation(zeros.astype(float), np.zeros(len(genes)))
    ...
    ...     def decode(self, genes):
    ...         return termsel.Selection(terms=(), features=())
    >>> OneMax().evaluate(np.array([[1, 0, 1, 1]])).objectives
    array([[1.]])
    """

    kind = "problem"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "evaluate": evaluation_fault, "evaluate_near": evaluation_fault,
        "decode": _selection_fault, "parts": _parts_fault, "design": _design_fault,
        "moves": _moves_fault}

    genome: Genome
    """The genes, which `Genome.random` draws and `Genome.repair` corrects."""

    objectives: tuple[str, ...]
    """Names of the objectives, all to be minimised."""

    budget: int | None = None
    """Evaluations that the search has which the problem is given to; None where nothing limits
    them."""

    @abstractmethod
    def evaluate(self, genes: Genes) -> Evaluation:
        """Return objectives and violations.

        Parameters
        ----------
        genes : ndarray, shape (p, genome.size)
            Of the dtype of the genome, bool for a selection.

        Returns
        -------
        Evaluation
            Finite for whatever genes.
        """

    def evaluate_near(self, genes: Genes, near: Genes) -> Evaluation:
        """Return objectives and violations of neighbours of one chromosome.

        A problem that has a faster way for them overrides this.

        Parameters
        ----------
        genes : ndarray, shape (p, genome.size)
            The individuals to evaluate.
        near : ndarray, shape (genome.size,)
            What most of them differ from by a gene or two.

        Returns
        -------
        Evaluation
            That of `evaluate`, but for rounding.
        """
        return self.evaluate(genes)

    @abstractmethod
    def decode(self, genes: Genes) -> Selection:
        """Return the selection of one chromosome, shape (genome.size,)."""

    def moves(self, _genes: Genes) -> Iterator[Genes]:
        """Yield individuals that a local refinement tries before the neighbours of each segment.

        Parameters
        ----------
        genes : ndarray, shape (genome.size,)
            What is to be improved.

        Yields
        ------
        ndarray, shape (n, genome.size)
            Valid ones (see `Genome.repair`), of any number. By default there are none.
        """
        return iter(())

    def parts(self) -> tuple[EnumerablePart, ...]:
        """Return independent parts whose costs add up to a monotone function of the objective.

        Raises
        ------
        TermselError
            If the subsets of this problem cannot be enumerated.
        """
        raise TermselError("this solver needs a problem whose terms are columns of a linear "
                           "system, or one that selects features alone",
                           hint=f"Choose another solver, such as {Remedy('solver', 'ga')} or swap.")

    def row_systems(self) -> tuple[RowSystem, ...] | None:
        """Return the systems whose rows the selected features are.

        Returns
        -------
        tuple of RowSystem or None
            Independent parts whose squared errors of the selection points add up, and order the
            selections as the objective does; none where only an evaluation shows it. None if the
            genes are not a selection of features alone.
        """
        return None

    def design(self) -> FloatArray:
        """Return the columns of the full design matrix, one a gene, shape (m, genome.size).

        Raises
        ------
        TermselError
            If the genes of this problem do not switch columns of an adjustment.
        """
        raise TermselError("this problem has no design matrix with a column for every gene",
                           hint="Choose a solver that needs none, such as "
                                f"{Remedy('solver', 'ga')}.")


class ProblemAround(Problem):
    """Base of a problem that evaluates another one in its own way, and else answers as that."""

    def __init__(self, inner: Problem) -> None:
        self.inner = inner
        # Solvers read both of them often.
        self.genome = inner.genome
        self.objectives = inner.objectives

    def decode(self, genes: Genes) -> Selection:
        """Return the selection of the inner problem."""
        return self.inner.decode(genes)

    def moves(self, genes: Genes) -> Iterator[Genes]:
        """Return the moves of the inner problem."""
        return self.inner.moves(genes)

    def parts(self) -> tuple[EnumerablePart, ...]:
        """Return the parts of the inner problem."""
        return self.inner.parts()

    def row_systems(self) -> tuple[RowSystem, ...] | None:
        """Return the row systems of the inner problem."""
        return self.inner.row_systems()

    def design(self) -> FloatArray:
        """Return the design matrix of the inner problem."""
        return self.inner.design()


@dataclass(frozen=True, eq=False)
class ProblemData:
    """What a problem is built from.

    Parameters
    ----------
    model : SensorModel
    control : FeatureSet
        Control features in scaled coordinates.
    check : Points
        Check points in scaled coordinates.
    pixels : float
        px per scaled image unit.
    criterion : Criterion
    options : dict
        Values of the recipe's options.
    objectives : tuple of Objective
        Objectives next to the criterion.

    Examples
    --------
    >>> import termsel
    >>> termsel.prepare("poly-terms").problem.inputs.model.name
    'poly2d'
    """

    model: SensorModel
    control: FeatureSet
    check: Points
    pixels: float
    criterion: Criterion
    options: dict[str, Any] = field(default_factory=dict)
    objectives: tuple[Objective, ...] = ()
