"""Parts of a record that show how the selection was made: search, proof, choice."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from termsel.data.record.figures import (
    Count,
    Name,
    Names,
    Objectives,
    Positive,
    RecordPart,
    RmseByRole,
    Roles,
    Scale,
    Share,
    Size,
)


class SelectionRecord(RecordPart, frozen=True):
    """Terms and control features in use."""

    terms: Names
    """Names of the terms in use."""
    features: Names
    """Ids of the control features in use."""
    n_terms: Count
    """Their number."""
    n_features: Count
    """Their number."""
    parameters: Mapping[str, float | int | str | bool]
    """Values found for options of the model, and others of the problem, by name."""


class Member(RecordPart, frozen=True):
    """A selection that no other one found beats in every objective."""

    objectives: Objectives
    """Objectives by name; of a size, the number of terms or features and the criterion."""
    selection: SelectionRecord
    """Terms and control features."""
    rmse: RmseByRole
    """RMSE by role [px]."""
    iterated: bool | UnsetType = UNSET
    """Whether its fit goes on from equations of lines that hold to first order to the least squares
    of distances."""


class SizeRow(Member, frozen=True, kw_only=True):
    """The best selection of one size, with its own proof."""

    better: bool
    """True if the criterion is better than that of all smaller selections here. Those are the
    front, once all is proven."""
    optimal: bool
    """True if it is proven that no selection of this size is better."""
    bound: float | None
    """Proven lower bound of the criterion of all selections of this size; null if none is known."""
    gap: float | None
    """How far the criterion is above the best of this size at most, as a share of it; null if
    unknown."""


class Certificate(RecordPart, frozen=True):
    """What was proven about the optimum."""

    optimal: bool
    """True if the selection is the proven optimum."""
    subsets: Count
    """Subsets that were decided."""
    of: Count
    """Subsets of the whole space."""
    space: str
    """The space in words."""
    feasible: Literal[False] | UnsetType = UNSET
    """False if it is proven that no selection is feasible; absent otherwise."""
    bounded: Count | UnsetType = UNSET
    """Those among the decided that a lower bound ruled out."""
    bound: float | UnsetType = UNSET
    """Proven lower bound of the criterion of all selections of the space."""
    optimum: float | UnsetType = UNSET
    """The optimum, where the selection is another one."""
    gap: float | UnsetType | None = UNSET
    """How far the selection is above the optimum, as a share of it; how far at most, where only a
    bound is known."""
    claimed_by: str | UnsetType = UNSET
    """The plugin whose solver says so, as distribution:name; termsel has not proven it."""


class CandidateRow(RecordPart, frozen=True):
    """A candidate of the strategy auto."""

    name: Name
    """Name of the candidate."""
    model: Name
    """Name of its model."""
    n_terms: Count
    """Number of terms."""
    effective: Size
    """Effective parameters."""
    predicted: float | None
    """RMSE by leave-one-out [px]."""
    gain: float | None = None
    """How much better than the chosen one it predicts left-out points: the mean difference of the
    logarithms of their squared errors, by its standard error; null if unknown."""


NAMED_BY_USER = "You named this method."
"""How the reason begins of the choice of a method, or a model, that the user named."""

ALL_TERMS_IN_USE = "All of its terms are in use."
"""How that reason ends where a model consists of terms, and nothing selects or shrinks them."""

FITTED_IN = "The model is fitted in "
"""How a note on the projection of the fit begins, where nobody asked for it."""

RPC_UNUSED = "The RPC is not used"
"""How a strategy's sentence on an RPC begins that is given and not used."""


_UNUSED = re.compile(r"The [^:.]* is not used: ")


def clauses_on_unused_data(notes: Iterable[str]) -> list[str]:
    """Return the first sentences of notes that a stated camera or orbit is not used, as clauses."""
    sentences = [note.partition(". ")[0] for note in notes
                 if _UNUSED.match(note) and not note.startswith(RPC_UNUSED)]
    return [f"{sentence[0].lower()}{sentence[1:].removesuffix('.')}" for sentence in sentences]


class Strategy(RecordPart, frozen=True):
    """The choice by the strategy auto."""

    name: Literal["auto"]
    """Name of the strategy."""
    chosen: Name
    """Name of the candidate that was chosen."""
    reason: str
    """Why it was chosen, with the figures that decided."""
    predicted: float | None
    """RMSE of points held out from the whole choice, in folds [px], or null."""
    folds: Count
    """Folds in which the choice was repeated."""
    fitted_to: Roles
    """Roles of the points it was fitted to."""
    candidates: Annotated[tuple[CandidateRow, ...], Meta(min_length=1)]
    """All candidates."""
    rpc: str = ""
    """Why the RPC that is given is not used, or that it is of a larger or a finer image."""


class HistoryRow(RecordPart, frozen=True):
    """One generation in the history of a search."""

    evaluations: Count
    """Individuals evaluated so far."""
    best: float | None
    """Least first objective so far of a feasible individual, or null."""
    median: float | None
    """Median first objective of the feasible individuals of the generation, or null."""
    feasible: Share
    """Their share of the generation."""
    empires: tuple[Count, ...] = ()
    """Of the ICA alone: countries of each empire, in the order in which they began; 0 for one that
    has vanished."""


class Polish(RecordPart, frozen=True):
    """What the local refinement after a solver added."""

    found: float | None
    """First objective before it."""
    polished: float | None
    """First objective after it."""
    evaluations: Count
    """How many of the evaluations are its own."""
    lookups: Count
    """How many of them were looked up."""


class SearchLimits(RecordPart, frozen=True):
    """Limits of each search; those that there were."""

    generations: Positive | None = None
    """Most generations beyond the first population."""
    evaluations: Positive | None = None
    """Most evaluations."""
    seconds: Scale | None = None
    """Longest duration [s]."""
    patience: Positive | None = None
    """Most generations without a gain."""


class TermFrequencies(RecordPart, frozen=True):
    """How often `termsel stability` selected each term."""

    repeats: Annotated[int, Meta(ge=2)]
    """Selections that were made."""
    threshold: Annotated[float, Meta(gt=0, le=1)]
    """Frequency from which on a term is stable."""
    frequency: Mapping[str, Share]
    """Share of the selections that have a term, by term; all terms of the model."""
