"""Segments of genomes: named genes of one type, and what is valid for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FloatArray, select
from termsel.selection.problems.custom_segment import CustomSegment as CustomSegment
from termsel.selection.problems.custom_segment import Genes as Genes
from termsel.selection.problems.custom_segment import Named


@dataclass(frozen=True)
class _Bounded(Named):
    """A segment whose genes are numbers between bounds of their own."""

    low: Any
    high: Any

    def __post_init__(self) -> None:
        """Make the bounds one for each gene; refuse those that are in disorder."""
        n = len(self.labels)
        kind = float if self.dtype is np.float64 else int
        object.__setattr__(self, "labels", tuple(self.labels))
        for bound in ("low", "high"):
            bounds = getattr(self, bound)
            # One bound for all genes stands for as many.
            of_genes = tuple(bounds) if isinstance(bounds, Sequence | np.ndarray) else (bounds,) * n
            object.__setattr__(self, bound, tuple(kind(value) for value in of_genes))
        low = np.array(self.low)
        high = np.array(self.high)
        if low.shape != (n,) or high.shape != (n,) or not (
                np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
            raise TermselError(f"the bounds of segment {self.name!r} are not {n} pairs of finite "
                               "numbers, the lower one first")

    @property
    def limits(self) -> tuple[Any, Any]:
        """Least and greatest value of each gene."""
        return self.low, self.high

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes"; "" if not."""
        outside = ~((genes >= np.array(self.low)) & (genes <= np.array(self.high)))
        if not outside.any():
            return ""
        row, column = (int(i) for i in np.argwhere(outside)[0])
        return (f"have {genes[row, column]:g} for {self.labels[column]!r}, which is from "
                f"{self.low[column]:g} to {self.high[column]:g}")

    def value(self, genes: Genes) -> dict[str, Any]:
        """Return the value of each gene by its label."""
        return dict(zip(self.labels, genes.astype(self.dtype).tolist(), strict=True))


@dataclass(frozen=True)
class Bits(Named):
    """Genes that are on or off.

    Parameters
    ----------
    name : str
        Such as "terms.line" or "features".
    labels : tuple of str
        What each gene switches.
    minimum, maximum : int
        How many genes may be on; all of them where maximum is None.

    Examples
    --------
    >>> import termsel
    >>> termsel.Bits("terms", ("1", "X", "Y"), minimum=1).labels
    ('1', 'X', 'Y')
    """

    minimum: int = 0
    maximum: int | None = None

    dtype: ClassVar[type] = np.bool_

    @property
    def most(self) -> int:
        """How many genes may be on."""
        return len(self.labels) if self.maximum is None else self.maximum

    @property
    def limits(self) -> tuple[int, int]:
        """Off and on."""
        return 0, 1

    def random(self, rng: np.random.Generator, n: int) -> BoolArray:
        """Return the genes of n individuals, (n, size), each with its own random share of genes on.

        The share is uniform between 0 and 1, so that small and large selections are equally
        frequent. With one half for all, a genome of 78 would hardly ever have 20 on.
        """
        # The number that is on is then nearly uniform, too, and not near the half.
        share = rng.uniform(0.0, 1.0, (n, 1))
        return np.asarray(rng.uniform(size=(n, self.size)) < share)

    def repaired(self, genes: Genes) -> BoolArray:
        """Return genes (p, size) as bool; numbers above one half are on."""
        return genes if genes.dtype == np.bool_ else np.asarray(genes > 0.5)

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes"; "" if not."""
        return "" if ((genes == 0) | (genes == 1)).all() else "are not all 0 or 1"

    def value(self, genes: Genes) -> tuple[str, ...]:
        """Return the labels of the genes that are on."""
        return select(self.labels, genes.astype(bool))

    def mask(self, genes: Genes) -> Genes:
        """Return the genes (p, size): each is its own mask."""
        return genes

    def members(self, mask: BoolArray) -> Genes:
        """Return a mask (p, size) as genes, which it is."""
        return mask


@dataclass(frozen=True)
class Integers(_Bounded):
    """Genes that are whole numbers.

    Parameters
    ----------
    name : str
    labels : tuple of str
        What each gene is.
    low, high : int or sequence of int
        Least and greatest value of each gene, both included; one for all or one for each.

    Raises
    ------
    TermselError
        For bounds that are not in order, or not one for each gene.

    Examples
    --------
    >>> import termsel
    >>> termsel.Integers("degree", ("line", "sample"), low=1, high=4).labels
    ('line', 'sample')
    """

    def random(self, rng: np.random.Generator, n: int) -> Genes:
        """Return uniform values, shape (n, size)."""
        return rng.integers(self.low, self.high, (n, self.size), endpoint=True)

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes"; "" if not."""
        return super().fault(genes) or _fault_of_fractions(genes)


@dataclass(frozen=True)
class Reals(_Bounded):
    """Genes that are real numbers.

    Parameters
    ----------
    name : str
    labels : tuple of str
        What each gene is.
    low, high : float or sequence of float
        Least and greatest value of each gene, both included; one for all or one for each.

    Raises
    ------
    TermselError
        For bounds that are not finite, not in order, or not one for each gene.

    Examples
    --------
    >>> import termsel
    >>> termsel.Reals("ridge", ("line", "sample"), low=0.0, high=1.0).labels
    ('line', 'sample')
    """

    dtype: ClassVar[type] = np.float64

    def random(self, rng: np.random.Generator, n: int) -> FloatArray:
        """Return uniform values, shape (n, size)."""
        return rng.uniform(self.low, self.high, (n, self.size))

    def repaired(self, genes: Genes) -> FloatArray:
        """Return the nearest valid genes."""
        return np.asarray(np.clip(genes, self.low, self.high), dtype=np.float64)


@dataclass(frozen=True)
class Categories(Named):
    """Genes that each take one of several values without an order.

    Parameters
    ----------
    name : str
    labels : tuple of str
        What each gene is.
    choices : tuple
        The values; a gene is the index of one.

    Examples
    --------
    >>> import termsel
    >>> termsel.Categories("estimator", ("kind",), choices=("ols", "ridge")).choices
    ('ols', 'ridge')
    """

    choices: tuple[Any, ...]

    def __post_init__(self) -> None:
        """Make tuples of labels and choices; TermselError where there are no choices."""
        # Segments are keys of caches: what lists were given becomes tuples.
        object.__setattr__(self, "labels", tuple(self.labels))
        object.__setattr__(self, "choices", tuple(self.choices))
        if not self.choices:
            raise TermselError(f"segment {self.name!r} has no choices",
                               hint="Give at least one choice.")

    def random(self, rng: np.random.Generator, n: int) -> Genes:
        """Return uniform choices, shape (n, size)."""
        return rng.integers(0, len(self.choices), (n, self.size))

    @property
    def limits(self) -> tuple[int, int]:
        """First and last number of a choice."""
        return 0, len(self.choices) - 1

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes"; "" if not."""
        inside = (genes >= 0) & (genes < len(self.choices))
        return _fault_of_fractions(genes) if inside.all() else (
            f"are not all from 0 to {len(self.choices) - 1}, numbers of choices")

    def value(self, genes: Genes) -> dict[str, Any]:
        """Return the choice of each gene by its label."""
        return {label: self.choices[int(i)] for label, i in zip(self.labels, genes, strict=True)}


@dataclass(frozen=True)
class Permutation(Named):
    """An order of things: every number from 0 to n - 1 once.

    Parameters
    ----------
    name : str
    labels : tuple of str
        The n things.

    Examples
    --------
    >>> import termsel
    >>> termsel.Permutation("order", ("a", "b", "c")).labels
    ('a', 'b', 'c')
    """

    def random(self, rng: np.random.Generator, n: int) -> Genes:
        """Return random orders, shape (n, size)."""
        return rng.random((n, self.size)).argsort(axis=1)

    def repaired(self, genes: Genes) -> Genes:
        """Return the ranks of the genes; those of a permutation are itself."""
        # The order of an order are ranks; of equal genes the earlier one ranks first.
        return genes.argsort(axis=1, kind="stable").argsort(axis=1)

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes"; "" if not."""
        valid = (np.sort(genes, axis=1) == np.arange(self.size)).all()
        return "" if valid else f"are no permutation of 0 to {self.size - 1}"


@dataclass(frozen=True)
class Subset(Named):
    """m of n things: m different numbers below n, ascending.

    `Genome.repair` replaces numbers that occur twice.

    Parameters
    ----------
    name : str
    labels : tuple of str
        The n things.
    m : int
        How many are chosen.

    Raises
    ------
    TermselError
        If m is not from 0 to n.

    Examples
    --------
    >>> import termsel
    >>> termsel.Subset("points", ("P1", "P2", "P3", "P4"), m=2).m
    2
    """

    m: int

    def __post_init__(self) -> None:
        """Raise TermselError for an m that is not from 0 to the number of labels."""
        if not 0 <= self.m <= len(self.labels):
            raise TermselError(f"segment {self.name!r} cannot choose {self.m} of "
                               f"{len(self.labels)}",
                               hint=f"m is from 0 to the {len(self.labels)} labels.")

    @property
    def size(self) -> int:
        """Number of genes, m."""
        return self.m

    @property
    def minimum(self) -> int:
        """How many are chosen at least."""
        return self.m

    @property
    def most(self) -> int:
        """How many are chosen at most."""
        return self.m

    def random(self, rng: np.random.Generator, n: int) -> Genes:
        """Return random subsets, shape (n, m)."""
        return random_subsets(n, len(self.labels), self.m, rng)

    def fault(self, genes: Genes) -> str:
        """Return how genes of any dtype are at fault, as a clause to follow "genes"; "" if not."""
        in_range = (genes >= 0) & (genes < len(self.labels))
        if not in_range.all() or _fault_of_fractions(genes) or (np.diff(genes, axis=1) <= 0).any():
            return (f"are not {self.m} different whole numbers from 0 to {len(self.labels) - 1}, "
                    "ascending")
        return ""

    def mask(self, genes: Genes) -> BoolArray:
        """Return the mask of the chosen labels, (p, n), from genes (p, m)."""
        on = np.zeros((len(genes), len(self.labels)), dtype=bool)
        np.put_along_axis(on, genes.astype(np.intp), True, axis=1)
        return on

    def members(self, mask: BoolArray) -> Genes:
        """Return genes (p, m) from a mask of the chosen labels, (p, n)."""
        return np.nonzero(mask)[1].reshape(len(mask), self.m)


Segment = Bits
"""Earlier name of `Bits`."""

AnySegment = Bits | Integers | Reals | Categories | Permutation | Subset | CustomSegment

SEGMENTS: tuple[type[AnySegment], ...] = (Bits, Integers, Reals, Categories, Permutation, Subset,
                                          CustomSegment)
"""All types of segments."""


def random_subsets(count: int, n: int, m: int, rng: np.random.Generator) -> Genes:
    """Return sets (count, m) of m different numbers below n, each row ascending."""
    # The first m of a random order are a random subset.
    return np.sort(rng.random((count, n)).argsort(axis=1)[:, :m], axis=1)


def _fault_of_fractions(genes: Genes) -> str:
    """Return why genes are no whole numbers, as a clause to follow "genes"; "" if they are."""
    return "" if (genes == np.rint(genes)).all() else "are not all whole numbers"
