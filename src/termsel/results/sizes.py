"""What a proof says of the best selection of each size, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from termsel.core.errors import percent_text
from termsel.data.record.search import Member, SelectionRecord, SizeRow

TITLE = "best of its size"
SIZE_WORDS = {"n_terms": "terms", "n_features": "control features"}

_TIE = 1e-9  # criteria that differ relatively by less are equal


def proven_in_words(row: SizeRow) -> str:
    """Return in words whether the best selection of a size is proven, or by how much it may be off.
    """
    if row.optimal:
        return "proven"
    if row.gap is None:
        return "not proven"
    # Above twice the optimum a percentage is read wrongly.
    if row.gap > 1:
        return f"at most {1 + row.gap:.3g} times the optimum"
    return f"gap at most {percent_text(row.gap)}"


def sentences_on_sizes(by_size: Sequence[SizeRow], criterion: str) -> Iterator[str]:
    """Yield sentences on sizes whose best known selection is no better than one of fewer members.

    One sentence names the sizes of which it is proven that there is no better one, and one those of
    which it is not. `criterion` is the name of the objective; `by_size` are in ascending order.
    """
    proven_sizes = []
    open_sizes = []
    best_value = float("inf")
    words = noun_of_members(by_size)
    for row in by_size:
        size = int(row.objectives[size_of(row)] or 0)
        value = row.objectives[criterion]
        # What is no better than the best of fewer members is decided by a bound above that.
        if row.better and value is not None:
            best_value = value
        elif row.bound is not None and row.bound >= best_value - _TIE * abs(best_value):
            proven_sizes.append(size)
        else:
            open_sizes.append(size)
    if proven_sizes:
        yield (f"Proven: the best selection of {_ranges_in_words(proven_sizes)} {words} is no "
               "better than that of fewer.")
    if open_sizes:
        yield (f"Not proven: a selection of {_ranges_in_words(open_sizes)} {words} may still be "
               "better than that of fewer.")


def recommended_member(members: Sequence[Member | SizeRow],
                       selection: SelectionRecord) -> int | None:
    """Return the number of the member that is the selection; None if none is."""
    # Compared by what they select, as numbers may be rounded.
    return next((i for i, member in enumerate(members)
                 if member.selection.terms == selection.terms
                 and member.selection.features == selection.features), None)


def size_of(member: Member | SizeRow) -> str:
    """Return the objective that is a member's size: "n_terms" or "n_features"."""
    return next(iter(member.objectives))


def noun_of_members(members: Sequence[Member | SizeRow]) -> str:
    """Return the plural of the things that members select, such as "terms"."""
    return SIZE_WORDS.get(size_of(members[0]), size_of(members[0]))


def _ranges_in_words(sizes: Sequence[int]) -> str:
    """Return ascending numbers as text, such as "2, 3 and 5 to 9".

    Three or more numbers without a gap are given by the first and the last of them.
    """
    # Numbers that follow each other without a gap are one run.
    runs: list[list[int]] = []
    for size in sizes:
        if runs and size == runs[-1][-1] + 1:
            runs[-1].append(size)
        else:
            runs.append([size])
    words: list[str] = []
    for run in runs:
        words += map(str, run) if len(run) < 3 else [f"{run[0]} to {run[-1]}"]
    return " and ".join([", ".join(words[:-1]), words[-1]] if words[1:] else words)
