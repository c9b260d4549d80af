"""Public base of problems: genes in, objectives and violations out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from termsel.criteria import Criterion
from termsel.errors import TermselError, unknown_name
from termsel.guard.arrays import of_shape, of_type
from termsel.guard.calls import Check, Guarded
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, IntArray, Points
from termsel.models.base import SensorModel

if TYPE_CHECKING:
    from termsel.adjustment.subset_system import SubsetSystem

WORST = 1e9
"""Objective of an individual without a figure; finite, so that it can be compared."""


@dataclass(frozen=True)
class Segment:
    """A named run of genes.

    Parameters
    ----------
    name : str
        Such as "terms.line" or "features".
    labels : tuple of str
        What each gene switches.
    minimum, maximum : int
        How many genes may be on; all of them where maximum is None.
    """

    name: str
    labels: tuple[str, ...]
    minimum: int = 0
    maximum: int | None = None


class Genome:
    """The genes of a problem: segments, forced genes and cardinality.

    Parameters
    ----------
    segments : iterable of Segment
    on, off : iterable of str
        Labels of genes that are always on, or always off.

    Raises
    ------
    TermselError
        For a label that no segment has, a gene both on and off, or a cardinality out of reach.
    """

    def __init__(self, segments: Iterable[Segment], *, on: Iterable[str] = (),
                 off: Iterable[str] = ()) -> None:
        self.segments = tuple(segments)
        self.labels = tuple(label for s in self.segments for label in s.labels)
        self.size = len(self.labels)
        self.on = self._mark(on)
        self.off = self._mark(off)
        self.free = ~(self.on | self.off)
        both = self.on & self.off
        if both.any():
            raise TermselError(f"gene {self.labels[int(np.argmax(both))]!r} is forced both on and "
                               "off", hint="Remove it from force_on or from force_off.")
        self._refuse_unreachable()

    def _refuse_unreachable(self) -> None:
        for segment, where in zip(self.segments, self.slices().values(), strict=True):
            most = len(segment.labels) if segment.maximum is None else segment.maximum
            least_on, most_on = int(self.on[where].sum()), int((~self.off[where]).sum())
            if segment.minimum > min(most, most_on) or least_on > most:
                raise TermselError(
                    f"{segment.minimum} to {most} of the {len(segment.labels)} genes "
                    f"{segment.name!r} must be on; forced genes or their number do not allow it",
                    hint="Lower the minimum, raise the maximum (of terms: max_share) or force "
                         "fewer genes.")

    def _mark(self, labels: Iterable[str]) -> BoolArray:
        marked = np.zeros(self.size, dtype=bool)
        for label in labels:
            if label not in self.labels:
                raise unknown_name("gene", label, self.labels)
            marked[self.labels.index(label)] = True
        return marked

    def slices(self) -> dict[str, slice]:
        """Return where each segment lies among the genes."""
        ends = np.cumsum([len(s.labels) for s in self.segments])
        return {s.name: slice(int(end) - len(s.labels), int(end))
                for s, end in zip(self.segments, ends, strict=True)}

    def random(self, rng: np.random.Generator, n: int) -> BoolArray:
        """Return n individuals, each with its own random share of genes on.

        The share is uniform between 0 and 1, so that small and large selections are equally
        frequent. With one half for all, a genome of 78 would hardly ever have 20 on.
        """
        share = rng.uniform(0.0, 1.0, (n, 1))
        return self.repair(rng.uniform(size=(n, self.size)) < share, rng)

    def repair(self, genes: BoolArray, rng: np.random.Generator) -> BoolArray:
        """Return genes that satisfy the forced genes and each segment's cardinality.

        Parameters
        ----------
        genes : ndarray of bool, shape (p, size)
        rng : numpy.random.Generator
            Draws which genes are switched where too many or too few are on.
        """
        genes = (genes | self.on) & ~self.off
        for segment, where in zip(self.segments, self.slices().values(), strict=True):
            most = len(segment.labels) if segment.maximum is None else segment.maximum
            count = genes[:, where].sum(axis=1)
            for i in np.flatnonzero((count < segment.minimum) | (count > most)):
                part = genes[i, where]
                short = count[i] < segment.minimum
                movable = np.flatnonzero((part != short) & self.free[where])
                wanted = segment.minimum - count[i] if short else count[i] - most
                part[rng.permutation(movable)[:wanted]] = short
        return genes


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Objectives and violations of a population; always finite, smaller is better.

    Parameters
    ----------
    objectives : ndarray, shape (p, m)
    violation : ndarray, shape (p,)
        0 for a feasible individual, else by how much it violates the constraints.
    """

    objectives: FloatArray
    violation: FloatArray

    def take(self, index: IntArray) -> Evaluation:
        """Return the evaluation of some individuals."""
        return Evaluation(self.objectives[index], self.violation[index])

    def order(self) -> IntArray:
        """Return the individuals from best to worst by first objective, feasible ones first."""
        return np.lexsort((self.objectives[:, 0], self.violation))


@dataclass(frozen=True)
class Selection:
    """What a chromosome selects.

    Parameters
    ----------
    terms, features : tuple of str
        Names of the model terms and ids of the control features in use.
    """

    terms: tuple[str, ...]
    features: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class EnumerablePart:
    """Genes whose part of the objective depends on no others, and can be enumerated.

    Parameters
    ----------
    genes : ndarray of int, shape (k,)
        Which genes of the genome switch the system's columns.
    system : SubsetSystem
    score : str
        As for `termsel.adjustment.subsets.search`.
    cost : callable
        Turns the best score of every size, shape (k + 1,), into what adds up over the parts.
    folds : tuple of ndarray of int
        For the score "kfold": the control rows of each fold.
    pixels : float
        px per unit of the system's target.
    """

    genes: IntArray
    system: SubsetSystem
    score: str
    cost: Callable[[FloatArray], FloatArray]
    folds: tuple[IntArray, ...] = ()
    pixels: float = 1.0


def evaluation_fault(problem: Problem, value: Any, genes: BoolArray) -> str | None:
    """Return what is wrong with the evaluation of a population, if anything."""
    n, names = len(genes), problem.objectives
    return (of_type(value, Evaluation)
            or of_shape(value.objectives, (n, len(names)), what="returned as objectives")
            or of_shape(value.violation, (n,), what="returned as violation"))


def _selection_fault(_problem: Problem, value: Any, *_args: Any) -> str | None:
    """Return what is wrong with a decoded selection, if anything."""
    what = of_type(value, Selection)
    if what is None:
        for part, names in (("terms", value.terms), ("features", value.features)):
            if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
                return f"returned as {part} {names!r:.200}; expected a tuple of names"
    return what


class Problem(Guarded, ABC):
    """What a solver sees: a genome, names of objectives, and an evaluation of genes."""

    kind = "problem"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "evaluate": evaluation_fault, "decode": _selection_fault, "parts": None, "design": None}

    genome: Genome
    objectives: tuple[str, ...]

    @abstractmethod
    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return objectives and violations.

        Parameters
        ----------
        genes : ndarray of bool, shape (p, genome.size)

        Returns
        -------
        Evaluation
            Finite for whatever genes.
        """

    @abstractmethod
    def decode(self, genes: BoolArray) -> Selection:
        """Return what one chromosome, shape (genome.size,), selects."""

    def parts(self) -> tuple[EnumerablePart, ...]:
        """Return independent parts whose costs add up to a monotone function of the objective.

        Raises
        ------
        TermselError
            If the subsets of this problem cannot be enumerated.
        """
        raise TermselError("this solver needs a problem whose terms are columns of a linear system",
                           hint="Choose another solver, such as --solver ga or --solver swap.")

    def design(self) -> FloatArray:
        """Return the columns of the full design matrix, one a gene, shape (m, genome.size).

        Raises
        ------
        TermselError
            If the genes of this problem do not switch columns of an adjustment.
        """
        raise TermselError("this problem has no design matrix with a column for every gene",
                           hint="Choose a solver that needs none, such as --solver ga.")


@dataclass(frozen=True, eq=False)
class Inputs:
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
    """

    model: SensorModel
    control: FeatureSet
    check: Points
    pixels: float
    criterion: Criterion
    options: dict[str, Any] = field(default_factory=dict)
