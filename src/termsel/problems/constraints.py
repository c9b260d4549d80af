"""What a user wants of any selection: some always or never, few terms, with their parents."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from termsel.adjustment.parts import Part
from termsel.errors import TermselError, unknown_name
from termsel.measurements.features import BoolArray, FloatArray, IntArray
from termsel.models.monomials import monomial_name
from termsel.options import Option
from termsel.problems.base import Segment

FORCED = (
    Option("force_on", None, "Terms and features that every selection has, with commas between: "
           "ids of features; `line.num:X`, `num:X` for both axes, or `X` wherever it stands."),
    Option("force_off", None, "Terms and features that no selection has, in the same way."),
)
"""Options of problems that select anything."""

WISHES = (
    *FORCED,
    Option("hierarchy", False, "A monomial only together with those it contains, of one power "
           "less, such as X2Y with XY and X2.", bool),
    Option("max_share", None, "Most terms of line and of sample, as a share of their equations, "
           "0 to 1; both together where lines or a denominator couple them. One degree of freedom "
           "is left in any case. By default two thirds; 1, which is no cap, for methods of papers "
           "and yardsticks where the solver is asked for by name.", float, 0.0, 1.0),
    Option("shrink", False, "Shrink the coefficients of the selection by ridge regression, the "
           "more the higher the order of a term.", bool),
)
"""Options of problems that select terms."""

_MONOMIAL = re.compile(r"(?:([XYZ])(\d?))(?:([XYZ])(\d?))?(?:([XYZ])(\d?))?")


def listed(wish: str | None) -> list[str]:
    """Return the names that an option lists with commas between."""
    return [name for name in (part.strip() for part in (wish or "").split(",")) if name]


def forced(wish: str | None, labels: tuple[str, ...], ids: tuple[str, ...]) -> list[str]:
    """Return the labels of the genes that an option names.

    Parameters
    ----------
    wish : str or None
        Value of the option.
    labels : tuple of str
        Of all genes of terms, such as "line.num:X", or "num:X" for both axes.
    ids : tuple of str
        Of all features that are selected.

    Raises
    ------
    TermselError
        For a name that no term or feature has.
    """
    found: list[str] = []
    for name in listed(wish):
        named = [label for label in labels
                 if label == name or label.endswith((f".{name}", f":{name}"))]
        named += [one for one in ids if one == name]
        if not named:
            what = " or ".join(["term"] * bool(labels) + ["feature"] * bool(ids))
            raise unknown_name(what, name, (*labels, *ids))
        found += named
    return found


def parents(terms: tuple[str, ...]) -> tuple[IntArray, IntArray]:
    """Return pairs of terms, the second a monomial of one power less in the first's block.

    Parameters
    ----------
    terms : tuple of str
        Such as "line.num:X2Y"; others have no parents.
    """
    index = {name: i for i, name in enumerate(terms)}
    child, parent = [], []
    for name, i in index.items():
        prefix, colon, monomial = name.rpartition(":")
        match = _MONOMIAL.fullmatch(monomial)
        if not match:
            continue
        powers = {letter: int(power or 1) for letter, power in
                  zip(match.groups()[::2], match.groups()[1::2], strict=True) if letter}
        for letter in powers:
            less = {**powers, letter: powers[letter] - 1}
            x, y, z = (less.get(variable, 0) for variable in "XYZ")
            above = index.get(f"{prefix}{colon}{monomial_name((x, y, z))}")
            if above is not None:
                child.append(i)
                parent.append(above)
    return np.array(child, dtype=np.intp), np.array(parent, dtype=np.intp)


def orphans(terms: BoolArray, pairs: tuple[IntArray, IntArray]) -> FloatArray:
    """Return how many terms in use lack a parent, each counted for every one, shape (p,)."""
    child, parent = pairs
    return np.asarray((terms[:, child] & ~terms[:, parent]).sum(axis=1), dtype=np.float64)


MAX_SHARE = 2 / 3
"""Terms of a selection by their equations, at most, where nothing else is said: a third of the
equations is redundant then. docs/explanation/selection.md has what that does."""


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
