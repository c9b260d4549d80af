"""Genes of a type of one's own, and what all segments have in common."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel.core.isolation.arrays import difference_from_shape
from termsel.core.isolation.calls import Check, Guarded
from termsel.data.features import FloatArray

Genes = NDArray[Any]
"""Chromosomes, one a row, in the dtype of their genome."""


@dataclass(frozen=True)
class Named:
    """A segment with a gene for each label; by default the number of one of the labels."""

    name: str
    labels: tuple[str, ...]

    dtype: ClassVar[type] = np.intp

    @property
    def size(self) -> int:
        """Number of genes."""
        return len(self.labels)

    @property
    def limits(self) -> tuple[Any, Any]:
        """Least and greatest number that a gene may be, of all or of each."""
        return 0, len(self.labels) - 1

    def repaired(self, genes: Genes) -> Genes:
        """Return the nearest valid genes."""
        return np.asarray(np.clip(np.rint(genes), *self.limits).astype(np.intp))

    def value(self, genes: Genes) -> Any:
        """Return the labels that the genes number, in the order of the genes."""
        return tuple(self.labels[int(i)] for i in genes)


def _genes_fault(segment: CustomSegment, value: Any, *_args: Any) -> str | None:
    """Return how genes that a method of a segment returned are at fault; None if they are not.

    It is a clause that follows the name of the method.
    """
    fault = difference_from_shape(value, (-1, segment.size))
    if fault is None and (genes_fault := segment.fault(value)):
        return f"returned genes that {genes_fault}"
    return fault


def _pair_fault(segment: CustomSegment, value: Any, *_args: Any) -> str | None:
    """Return how a pair of arrays of genes is at fault; None if it is not.

    It is a clause that follows the name of the method.
    """
    if not isinstance(value, tuple) or len(value) != 2:
        return f"returned an object of type {type(value).__name__}; expected two arrays of genes"
    return _genes_fault(segment, value[0]) or _genes_fault(segment, value[1])


@dataclass(frozen=True)
class CustomSegment(Named, Guarded):
    """Base of genes of a type of one's own: a subclass says which numbers are valid.

    `repaired` alone is required, with `limits` where the genes are not numbers of labels, and
    `dtype` (`numpy.float64`) where they are not whole. All else follows from these, and a subclass
    does better what it knows better. Built-in solvers that handle all segments handle it.

    Parameters
    ----------
    name : str
    labels : tuple of str
        What each gene is.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> class Even(termsel.CustomSegment):
    ...     "Genes that are even numbers."
    ...
    ...     def repaired(self, genes):
    ...         return 2 * (np.asarray(genes) // 2)
    >>> Even("steps", ("line", "sample")).labels
    ('line', 'sample')
    """

    kind: ClassVar[str] = "segment"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "random": _genes_fault, "mutated": _genes_fault, "steps": _genes_fault,
        "unlocked": _genes_fault, "crossed": _pair_fault, "value": None, "fault": None,
        "repaired": lambda segment, value, *_: difference_from_shape(value, (-1, segment.size))}

    @property
    def keys(self) -> int:
        """How many random keys stand for the genes."""
        return self.size

    def unlocked(self, keys: FloatArray) -> Genes:
        """Return the genes that keys from 0 to 1, shape (p, keys), stand for, shape (p, size)."""
        low, high = map(np.asarray, self.limits)
        return self.repaired(low + keys * (high - low))

    def random(self, rng: np.random.Generator, n: int) -> Genes:
        """Return random genes, shape (n, size)."""
        return self.unlocked(rng.random((n, self.keys)))

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes".

        It is "" if `repaired` leaves them as they are.
        """
        return "" if np.array_equal(self.repaired(genes), genes) else "are not valid as they are"

    def crossed(self, parents_1: Genes, parents_2: Genes,
                rng: np.random.Generator) -> tuple[Genes, Genes]:
        """Return two children of each pair of parents, (p, size) each."""
        # Uniform crossover; what it breaks is repaired, as it is after every operator.
        swap = rng.random(parents_1.shape) < 0.5
        return (self.repaired(np.where(swap, parents_2, parents_1)),
                self.repaired(np.where(swap, parents_1, parents_2)))

    def mutated(self, genes: Genes, probability: float, rng: np.random.Generator) -> Genes:
        """Return genes (p, size), each changed with the given chance."""
        return self.repaired(np.where(rng.random(genes.shape) < probability,
                                      self.random(rng, len(genes)), genes))

    def steps(self, _genes: Genes) -> Iterator[Genes]:
        """Yield the neighbours of one chromosome's genes (size,), arrays (n, size) of any length.

        The local refinement and `swap` step to them; by default there are none.
        """
        return iter(())
