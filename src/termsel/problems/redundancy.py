"""How many terms the equations bear: so much of them at most that some redundancy is left."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from termsel.adjustment.parts import Part
from termsel.errors import TermselError
from termsel.features import BoolArray, FloatArray, IntArray
from termsel.problems.base import Segment

MAX_SHARE = 2 / 3
"""Terms of a selection by their equations, at most, where nothing else is said: a third of the
equations is redundant then. docs/method.md has what that does."""


def most_terms(equations: IntArray, share: float, least: int = 1) -> IntArray:
    """Return how many terms so many equations bear.

    Parameters
    ----------
    equations : ndarray of int
    share : float
        Most terms, as a share of the equations.
    least : int
        Fewest degrees of freedom.
    """
    rounding = 1e-9
    borne = np.floor(share * equations + rounding).astype(np.intp)
    return np.asarray(np.minimum(borne, equations - least))


def excess(parts: tuple[Part, ...], terms: BoolArray, features: BoolArray | None, share: float,
           least: int = 1) -> FloatArray:
    """Return how many terms are in use beyond those the equations in use bear, shape (p,).

    Parameters
    ----------
    parts : tuple of Part
        Each bears its own terms.
    terms : ndarray of bool, shape (p, k)
    features : ndarray of bool, shape (p, f), optional
        Features in use; all by default.
    share, least
        As for `most_terms`.
    """
    total = np.zeros(len(terms))
    for part in parts:
        each = np.bincount(part.equations.feature,
                           minlength=0 if features is None else features.shape[1])
        rows = np.array(each.sum()) if features is None else features @ each
        chosen = terms[:, part.columns].sum(axis=1)
        total += np.maximum(chosen - most_terms(rows, share, least), 0)
    return total


def capped(segments: Iterable[Segment], gene_of_term: IntArray, parts: tuple[Part, ...],
           share: float) -> list[Segment]:
    """Return the segments of terms with a maximum that no selection with less excess passes.

    It keeps a search from what `excess` would count; where several segments share equations, or
    features are selected too, there is more to count.

    Parameters
    ----------
    segments : iterable of Segment
        All those of terms, in the order of the genes.
    gene_of_term : ndarray of int, shape (k,)
    parts : tuple of Part
    share : float

    Raises
    ------
    TermselError
        If a segment may have no term at all.
    """
    found, start = [], 0
    for segment in segments:
        genes = np.arange(start, start + len(segment.labels))
        start += len(genes)
        most = len(genes)
        for part in parts:
            columns = np.bincount(gene_of_term[part.columns], minlength=start)[genes]
            if columns.any():
                equations = len(part.equations.b)
                bears = int(most_terms(np.array(equations), share))
                # Genes of no column here are free; the others switch as many as the fewest do.
                most = min(most, int((columns == 0).sum()) + bears // columns[columns > 0].min())
        if most < 1:
            of = segment.name.replace(".", " of ")
            raise TermselError(f"max_share={share:.2g} allows no {of}: the control gives "
                               f"{equations} equations",
                               hint="Raise max_share or give more control.")
        found.append(replace(segment, maximum=most))
    return found
