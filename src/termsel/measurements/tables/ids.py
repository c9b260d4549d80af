"""Ids of features: the one rule that every reader, plugin and program keeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from termsel.errors import TermselError, cut, is_printable

LONGEST = 200
"""Characters of an id."""


def refused(name: str) -> str:
    """Return what is wrong with an id, "" if nothing.

    An id is printable, without line breaks, and not blank, so that tables keep it and a terminal
    shows it.
    """
    if not name:
        return "is blank"
    if len(name) > LONGEST:
        return f"has {len(name):,} characters, more than {LONGEST}"
    return "" if is_printable(name) else "has a line break or a character that cannot be printed"


def check_ids(ids: Sequence[str], kind: str, *, unique: bool) -> None:
    """Refuse ids that break the rule, or are not `unique`; the TermselError has the id.

    `kind` is that of the features: "point" or "line".
    """
    for name in ids:
        if wrong := refused(name):
            raise TermselError(f"the id {cut(name, 40)!r} of a {kind} {wrong}", ids=[name],
                               hint="Give every feature a short id of letters, digits and signs.")
    twice = [name for name, count in Counter(ids).items() if count > 1] if unique else []
    if twice:
        raise TermselError(f"{kind} id {twice[0]!r} is used {Counter(ids)[twice[0]]} times",
                           hint="Give every feature an id of its own.", ids=twice[:1])
