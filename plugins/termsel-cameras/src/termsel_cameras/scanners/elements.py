"""Texts, numbers and times in elements of XML, with messages that name the element."""

from __future__ import annotations

from datetime import datetime
from xml.etree import ElementTree

import numpy as np

from termsel import TermselError

EPOCH = datetime(2000, 1, 1)
"""Which day does not matter: times are only ever subtracted from one another."""

_LONGEST_QUOTE = 40
"""Characters of a text that a message repeats."""


def text_of(element: ElementTree.Element, name: str) -> str:
    """Return the text of a child, by its path, stripped; raises TermselError if it is missing."""
    text = element.findtext(name)
    if text is None:
        raise TermselError(f"the element {name} is missing")
    return text.strip()


def number_of(element: ElementTree.Element, name: str) -> float:
    """Return the number in a child, by its path; raises TermselError if it has none."""
    return as_number(name, text_of(element, name))


def as_number(name: str, text: str) -> float:
    """Return a text as a finite number.

    Raises TermselError with the name of its element if it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise TermselError(f"the element {name} has {text[:_LONGEST_QUOTE]!r}, which is no number")
    return value


def seconds_of(text: str) -> float:
    """Return a time such as 2021-04-01T05:26:23.794457 in seconds from `EPOCH`.

    Raises TermselError if the text is no time.
    """
    # The fraction may have more digits than the microseconds of a datetime.
    whole, _, fraction = text.removesuffix("Z").partition(".")
    try:
        return (datetime.fromisoformat(whole) - EPOCH).total_seconds() + float(
            f"0.{fraction or 0}")
    except (ValueError, TypeError) as error:
        raise TermselError(f"{text[:_LONGEST_QUOTE]!r} is no time") from error
