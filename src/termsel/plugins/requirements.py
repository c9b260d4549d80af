"""Whether a version satisfies a requirement, as the metadata of packages state it."""

from __future__ import annotations

import operator
import re


def version_fits(requirement: str, version: str) -> bool:
    """Return whether a version satisfies a requirement, such as ``>=0.3,<0.4``.

    By the numbers alone: a development version counts as its release. What is no requirement of
    versions, such as an address, is satisfied.
    """
    return all(_is_satisfied(clause.strip(), version) for clause in requirement.split(","))


_CLAUSE = re.compile(r"(>=|<=|==|!=|~=|>|<)\s*v?(\d+(?:\.\d+)*)(\.\*)?")

_COMPARED = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt,
             "==": operator.eq, "!=": operator.ne}


def _is_satisfied(clause: str, version: str) -> bool:
    """Return whether a version meets a clause such as >=0.3; an unknown clause is met."""
    found = _CLAUSE.match(clause)
    if found is None:
        return True
    sign, text, any_later = found.groups()
    required = _version_numbers(text)
    present = _version_numbers(version)
    if sign == "~=":
        return present >= required and present[:len(required) - 1] == required[:-1]
    if any_later:
        return bool(_COMPARED[sign](present[:len(required)], required))
    # 0.3 is 0.3.0.
    length = max(len(present), len(required))
    padded = [numbers + (0,) * (length - len(numbers)) for numbers in (present, required)]
    return bool(_COMPARED[sign](*padded))


def _version_numbers(version: str) -> tuple[int, ...]:
    """Return the numbers of a version's release; () of a text that has none."""
    release = re.match(r"\d+(?:\.\d+)*", version)
    return tuple(map(int, release[0].split("."))) if release else ()
