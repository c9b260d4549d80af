"""Constraints of selections: forced genes, hierarchy of monomials, most terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from termsel.adjustment.leave_out import IndependentPart
from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.options import Option
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.models.terms import Term
from termsel.selection.problems.segments import Bits

FORCE_OPTIONS = (
    Option("force_on", None, "Terms and features that every selection has, separated by commas. "
           "Give ids of features; `line.num:X`, `num:X` for both axes, or `X` in all parts."),
    Option("force_off", None, "Terms and features that no selection has, given in the same way."),
)
"""Options of problems that select anything."""

TERM_OPTIONS = (
    *FORCE_OPTIONS,
    Option("hierarchy", False, "Select a monomial only together with those of one power less, "
           "such as X2Y with XY and X2. With weighted=true of rfm no origin of coordinates "
           "then changes the optimum.", bool),
    Option("max_share", None, "Most terms per axis, as a share of its equations, 0 to 1; of both "
           "axes together where lines or a denominator couple them. At least one degree of freedom "
           "is kept. By default two thirds; 1, which is no limit, for a solver that uses all "
           "terms.", float, 0.0, 1.0),
    Option("shrink", False, "Shrink the coefficients of the selection by ridge regression; terms "
           "of higher order more.", bool),
)
"""Options of problems that select terms."""


def split_names(value: str | None) -> list[str]:
    """Return the names in the value of an option, which are separated by commas."""
    names = map(str.strip, (value or "").split(","))
    return [name for name in names if name]


def without_heights(names: tuple[str, ...], options: Mapping[str, Any]) -> dict[str, str]:
    """Return the options by which a problem uses no term with Z, except those that are asked for.

    The options are for control that does not show what a height does. `names` are the model's
    terms, `options` the values that the problem's options have. Returns {} where the problem has
    none for this.
    """
    height_terms = {name: term for name in names if (term := Term.parse(name)).has_height
                    and not isinstance(term.exponents, str)}
    # A problem without term genes takes the terms in use as a list; others force genes off.
    if "terms" in options:
        return {"terms": options["terms"] or ",".join(name for name in names
                                                      if name not in height_terms)}
    if "force_off" not in options:
        return {}
    forced_on = set(split_names(options["force_on"]))
    # A term may be asked for by its own name, by that of both axes, or by its monomial.
    remaining = {term.shared for name, term in height_terms.items()
                 if forced_on & {name, str(term.shared), term.column}}
    off = [str(term.shared) for term in height_terms.values() if term.shared not in remaining]
    return {"force_off": ",".join(dict.fromkeys([*split_names(options["force_off"]), *off]))}


def forced_labels(value: str | None, labels: tuple[str, ...], ids: tuple[str, ...]) -> list[str]:
    """Return the labels of the genes that the value of an option names, in its order.

    `labels` are those of all genes of terms, such as "line.num:X", or "num:X" for both axes; `ids`
    those of all features that may be selected. Raises TermselError for a name that no gene has.
    """
    forced: list[str] = []
    for name in split_names(value):
        # A name without an axis, or a column such as X alone, stands for all genes that have it.
        matches = [label for label, term in zip(labels, map(Term.parse, labels), strict=True)
                   if name in (label, str(term.shared), term.column)]
        matches += [feature_id for feature_id in ids if feature_id == name]
        if not matches:
            kinds = []
            if labels:
                kinds.append("term")
            if ids:
                kinds.append("feature")
            raise unknown_name_error(" or ".join(kinds), name, (*labels, *ids))
        forced += matches
    return forced


def parent_pairs(names: tuple[str, ...]) -> tuple[IntArray, IntArray]:
    """Return the indices of children and of their parents, (n,) both, a pair for each parent.

    A parent is the same monomial with one power less, in the same part of the model (see
    `termsel.Term.parents`). `names` are those of all terms.
    """
    terms = [Term.parse(name) for name in names]
    index = {term: i for i, term in enumerate(terms)}
    pairs: list[tuple[int, int]] = []
    for i, term in enumerate(terms):
        # The model may lack a parent: then nothing is asked of that term.
        pairs += [(i, index[parent]) for parent in term.parents if parent in index]
    children, parents_of_children = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return children, parents_of_children


def count_orphans(terms: BoolArray, pairs: tuple[IntArray, IntArray]) -> FloatArray:
    """Return how many parents are missing of the terms in use (p, k), shape (p,).

    `pairs` are those of `parent_pairs`; a term that lacks two parents counts twice.
    """
    child, parent = pairs
    return np.asarray((terms[:, child] & ~terms[:, parent]).sum(axis=1), dtype=np.float64)


MAX_SHARE = 2 / 3
"""Default of the most terms as a share of their equations: a third of the equations is
redundant."""


_SHARE_ROUNDING = 1e-9
"""What is added to a share of equations before it is rounded down."""


def largest_term_share(equations: IntArray, share: float, freedom: int = 1) -> IntArray:
    """Return the most terms that each number of equations (s,) supports, (s,).

    That is a share of the equations, but at least `freedom` degrees of freedom remain.
    """
    # 0.29 of 100 is 29, which rounding makes 28.999...
    supported = np.floor(share * equations + _SHARE_ROUNDING).astype(np.intp)
    return np.asarray(np.minimum(supported, equations - freedom))


def count_excess_terms(parts: tuple[IndependentPart, ...], terms: BoolArray,
                       features: BoolArray | None, share: float, freedom: int = 1) -> FloatArray:
    """Return how many terms are in use beyond those that the equations support, shape (p,).

    Each independent part supports its own terms. `terms` are (p, k), or (1, k) if all individuals
    have the same; `features` (p, f) are None where all are in use. `share` and `freedom` are as for
    `largest_term_share`.
    """
    total: FloatArray = np.zeros(len(terms))
    for part in parts:
        # Only rows of features in use count: a feature may have several in a part, or none.
        if features is None:
            rows = np.asarray(len(part.equations.feature), dtype=np.intp)
        else:
            rows_of_feature = np.bincount(part.equations.feature, minlength=features.shape[1])
            # As floats, which are exact here: BLAS has no whole numbers.
            rows = np.asarray(features @ rows_of_feature.astype(np.float64), dtype=np.intp)
        n_terms = terms[:, part.columns].sum(axis=1)
        total = total + np.maximum(n_terms - largest_term_share(rows, share, freedom), 0)
    return total


def cap_segments(segments: Iterable[Bits], gene_of_term: IntArray,
                 parts: tuple[IndependentPart, ...], share: float) -> list[Bits]:
    """Return the segments of terms, each with a maximum that only selections with excess exceed.

    `segments` are all those of terms, in the order of the genes; `gene_of_term` (k,) is the gene
    that switches each term. Raises TermselError for a segment that may not have any term.
    """
    # This keeps a search from most of what `count_excess_terms` would count, which is more where
    # several segments share equations, or features are selected too.
    limited = []
    start = 0
    for segment in segments:
        genes = np.arange(start, start + len(segment.labels))
        start += len(genes)
        maximum = len(genes)
        for part in parts:
            # How many columns of the part each gene switches: with a shared mask one in each axis.
            columns = np.bincount(gene_of_term[part.columns], minlength=start)[genes]
            if columns.any():
                equations = len(part.equations.b)
                supported = int(largest_term_share(np.array(equations), share))
                # Genes without a column here are free; any other switches as many as the gene
                # with the fewest, or more.
                maximum = min(maximum, int((columns == 0).sum())
                              + supported // columns[columns > 0].min())
        if maximum < 1:
            segment_name = segment.name.replace(".", " of ")
            raise TermselError(f"max_share={share:.2g} allows no {segment_name}: the control gives "
                               f"{equations} equations",
                               hint="Raise max_share or give more control.")
        limited.append(replace(segment, maximum=maximum))
    return limited
