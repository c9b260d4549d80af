"""Cells that a spreadsheet would take for a formula."""

from __future__ import annotations

import re

_FORMULA = re.compile(r"'*[=+\-@]")


def guarded(text: str) -> str:
    """Return a cell that no spreadsheet takes for a formula, as `unguarded` takes it back.

    A spreadsheet runs text that begins with = + - or @, unless an apostrophe is in front of it.
    Numbers stay as they are.
    """
    return f"'{text}" if _FORMULA.match(text) and not is_number(text) else text


def unguarded(text: str) -> str:
    """Return a cell without the apostrophe that guards it."""
    return text[1:] if text[:1] == "'" and _FORMULA.match(text) else text


def is_number(text: str) -> bool:
    """Return True for text that Python reads as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
