"""Genomes: named segments of genes, checked in one place.

A population is one array, shape (p, size): of bool if all segments are `Bits`, of float64 if one
is `Reals`, and of whole numbers otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from termsel.core.errors import TermselError, unknown_name_error
from termsel.data.features import BoolArray
from termsel.selection.problems.segments import AnySegment, Bits, Genes, Subset


class Genome:
    """The genes of a problem: segments, forced genes and cardinality.

    Parameters
    ----------
    segments : iterable of Bits, Integers, Reals, Categories, Permutation, Subset or CustomSegment
        With names that differ.
    on, off : iterable of str
        Labels of `Bits` or a `Subset` that are always on, or always off.

    Raises
    ------
    TermselError
        For a label that no such segment has, one both on and off, or a cardinality out of reach.

    Examples
    --------
    >>> import termsel
    >>> genome = termsel.Genome([termsel.Bits("terms", ("1", "X", "Y"))], on=["1"])
    >>> genome.size
    3
    """

    def __init__(self, segments: Iterable[AnySegment], *, on: Iterable[str] = (),
                 off: Iterable[str] = ()) -> None:
        """Lay out the segments and check what is forced; raises TermselError as the class says."""
        self.segments = tuple(segments)
        self._slices = _segment_slices([(s.name, s.size) for s in self.segments])
        if len(self._slices) < len(self.segments):
            raise TermselError("two segments of a genome have the same name: "
                               + ", ".join(s.name for s in self.segments))
        labels: list[str] = []
        for segment in self.segments:
            labels += segment.labels
        self.labels = tuple(labels)
        self._of_labels = _segment_slices([(s.name, len(s.labels)) for s in self.segments])
        self.size = sum(s.size for s in self.segments)
        self.dtype = _common_dtype(self.segments)
        self.on = self._mask_of_labels(on)
        self.off = self._mask_of_labels(off)
        # What is forced belongs to labels, not to genes: a `Subset` has fewer genes than labels.
        self.free = ~(self.on | self.off)
        on_and_off = self.on & self.off
        if on_and_off.any():
            label = self.labels[int(np.argmax(on_and_off))]
            raise TermselError(f"gene {label!r} is forced both on and off",
                               hint="Remove it from force_on or from force_off.")
        self._refuse_unreachable()

    def _refuse_unreachable(self) -> None:
        """Raise TermselError for cardinalities that forced genes leave no selection for."""
        # As many as the minimum must be allowed on, and what is forced on must be allowed by the
        # maximum.
        for segment, labels in self._segments_switched():
            n_forced_on = int(self.on[labels].sum())
            n_not_off = int((~self.off[labels]).sum())
            if segment.minimum > min(segment.most, n_not_off) or n_forced_on > segment.most:
                raise TermselError(
                    f"{segment.minimum} to {segment.most} of the {len(segment.labels)} genes "
                    f"{segment.name!r} must be on; forced genes or their number do not allow it",
                    hint="Lower the minimum, raise the maximum (of terms: max_share) or force "
                         "fewer genes.")

    def _segments_switched(self) -> list[tuple[Bits | Subset, slice]]:
        """Return the segments whose labels are on or off, and where their labels are."""
        return [(s, self._of_labels[s.name]) for s in self.segments
                if isinstance(s, Bits | Subset)]

    def _mask_of_labels(self, labels: Iterable[str]) -> BoolArray:
        """Return which labels are named, shape (number of labels,); refuse names that none has."""
        marked = np.zeros(len(self.labels), dtype=bool)
        labels = list(labels)
        label_index: dict[str, int] = {}
        if labels:
            # Of segments that share a label the first one is meant.
            for segment, columns in reversed(self._segments_switched()):
                numbers = range(columns.start, columns.stop)
                label_index.update(zip(segment.labels, numbers, strict=True))
        for label in labels:
            if label not in label_index:
                raise unknown_name_error("gene", label, label_index)
            marked[label_index[label]] = True
        return marked

    def slices(self) -> dict[str, slice]:
        """Return where each segment lies among the genes."""
        return dict(self._slices)

    def label_slices(self) -> dict[str, slice]:
        """Return where each segment lies among the labels, to which `on`, `off` and `free` belong.

        A `Subset` has fewer genes than labels; other segments have as many.
        """
        return dict(self._of_labels)

    def chosen(self, genes: Genes) -> BoolArray:
        """Return which labels are on, shape (p, number of labels), from genes (p, size).

        Labels of `Bits` and a `Subset` may be on; labels of other segments are not.
        """
        # Of bits alone the genes are what is chosen.
        if self.dtype == np.bool_:
            return genes
        mask = np.zeros((len(genes), len(self.labels)), dtype=bool)
        for segment, labels in self._segments_switched():
            segment_genes = genes[:, self._slices[segment.name]]
            mask[:, labels] = segment.mask(segment_genes)
        return mask

    def keeps(self, genes: Genes) -> BoolArray:
        """Return which individuals keep forced genes and cardinality, shape (p,)."""
        mask = self.chosen(genes)
        valid = mask[:, self.on].all(axis=1) & ~mask[:, self.off].any(axis=1)
        for segment, labels in self._segments_switched():
            count = mask[:, labels].sum(axis=1)
            valid &= (count >= segment.minimum) & (count <= segment.most)
        return np.asarray(valid)

    def part(self, genes: Genes, name: str) -> Genes:
        """Return the genes of one segment in its own dtype, shape (p, segment's size)."""
        segment = next(s for s in self.segments if s.name == name)
        return np.asarray(genes[:, self._slices[name]].astype(segment.dtype))

    def values(self, genes: Genes) -> dict[str, Any]:
        """Return the values of one chromosome, shape (size,), by the name of the segment.

        Of `Bits` and a `Subset` the labels that are on; of a `Permutation` the labels in their
        order; of other segments the value of each gene by its label.
        """
        return {s.name: s.value(genes[self._slices[s.name]]) for s in self.segments}

    def random(self, rng: np.random.Generator, n: int) -> Genes:
        """Return n random individuals, shape (n, size).

        Bits have their own random share on in every individual, other genes are uniform.
        """
        # One share for all segments: line and sample get about as many terms.
        if self.dtype == np.bool_:
            return self.repair(Bits("", self.labels).random(rng, n), rng)
        return self.repair(np.concatenate(
            [s.random(rng, n) for s in self.segments], axis=1, dtype=self.dtype), rng)

    def repair(self, genes: Genes, rng: np.random.Generator) -> Genes:
        """Return valid genes next to given ones: types, bounds, forced genes and cardinality.

        Parameters
        ----------
        genes : ndarray, shape (p, size)
            Finite numbers or bool. Genes that are valid stay as they are.
        rng : numpy.random.Generator
            Draws which genes are switched where too many or too few are on.
        """
        if self.dtype == np.bool_:
            fixed = (Bits("", self.labels).repaired(genes) | self.on) & ~self.off
            # Forced genes stay as they are: only free ones are switched to keep the counts.
            for bits, columns in self._segments_switched():
                _keep_count(fixed[:, columns], bits, self.free[columns], rng)
            return fixed
        fixed = np.empty((len(genes), self.size), dtype=self.dtype)
        for segment, columns in zip(self.segments, self._slices.values(), strict=True):
            segment_genes = segment.repaired(genes[:, columns])
            if isinstance(segment, Bits | Subset):
                segment_genes = self._force_genes(segment, segment_genes, rng)
            fixed[:, columns] = segment_genes
        return fixed

    def _force_genes(self, segment: Bits | Subset, genes: Genes, rng: np.random.Generator) -> Genes:
        """Return the genes of a segment with its forced labels and cardinality."""
        labels = self._of_labels[segment.name]
        mask = (segment.mask(genes) | self.on[labels]) & ~self.off[labels]
        _keep_count(mask, segment, self.free[labels], rng)
        return segment.members(mask)

    def population(self, genes: object) -> Genes:
        """Return genes that somebody gives, (n, size), in the dtype of the genome.

        Parameters
        ----------
        genes : object
            Array or rows of valid genes of any type of number, such as 0 and 1 for bits.

        Raises
        ------
        TermselError
            For all else: a number that is none of these, taken as a bool, would be on.
        """
        fault = self.fault(genes)
        if fault is None:
            return np.asarray(genes)
        try:
            given = np.asarray(genes)
            with np.errstate(invalid="ignore"):  # NaN and infinite numbers differ, as they should
                population = given.astype(self.dtype)
        except (TypeError, ValueError):  # rows of several lengths, text, objects
            given = population = np.empty(0)
        if np.array_equal(population, given):
            fault = self.fault(population)
            if fault is None:
                return population
        raise TermselError(f"the problem got {fault}",
                           hint="Give one row for each selection; problem.genome.repair makes "
                                "valid genes of any finite numbers.")

    def fault(self, genes: object) -> str | None:
        """Return how genes are at fault, and what was expected; None if they are not.

        It is a phrase that begins with "genes". Dtype, shape and bounds are looked at; of `Bits`
        neither what is forced nor how many are on.

        Parameters
        ----------
        genes : object
            Meant to be a population.
        """
        # The type must be that of the genome: solvers write into arrays of it.
        if (not isinstance(genes, np.ndarray) or genes.dtype != self.dtype or genes.ndim != 2
                or genes.shape[1] != self.size):
            got = (f"the type {genes.dtype} and the shape {genes.shape}"
                   if isinstance(genes, np.ndarray) else f"the type {type(genes).__name__}")
            return f"genes of {got}; expected {self.dtype} and (n, {self.size})"
        if self.dtype == np.bool_:
            return None
        for segment, columns in zip(self.segments, self._slices.values(), strict=True):
            if fault := segment.fault(genes[:, columns]):
                return f"genes that are not valid: those of {segment.name!r} {fault}"
        return None


def _keep_count(genes: BoolArray, segment: Bits | Subset, free: BoolArray,
                rng: np.random.Generator) -> None:
    """Switch free genes of a segment in place, until as many are on as its limits allow.

    `genes` (p, size) are bool, `free` (size,) marks those that may be switched; `rng` draws which.
    """
    count = genes.sum(axis=1)
    for i in np.flatnonzero((count < segment.minimum) | (count > segment.most)):
        individual = genes[i]
        short = count[i] < segment.minimum
        # Those that are off where too few are on, those that are on where too many are.
        movable = np.flatnonzero((individual != short) & free)
        n_switched = segment.minimum - count[i] if short else count[i] - segment.most
        individual[rng.permutation(movable)[:n_switched]] = short


def _segment_slices(sizes: Iterable[tuple[str, int]]) -> dict[str, slice]:
    """Return where each segment is, one after the other."""
    slices = {}
    start = 0
    for name, size in sizes:
        slices[name] = slice(start, start + size)
        start += size
    return slices


def _common_dtype(segments: Iterable[AnySegment]) -> np.dtype[Any]:
    """Return the dtype that holds all segments: bool, whole or real numbers."""
    dtypes = {segment.dtype for segment in segments}
    # From the widest, which holds the others, to the narrowest.
    if np.float64 in dtypes:
        return np.dtype(np.float64)
    return np.dtype(np.intp if np.intp in dtypes else np.bool_)
