"""What a decoder says of a file that has not the keys and kinds of values it must have."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

KINDS_OF_JSON = {"int": "a whole number", "float": "a number", "str": "text",
                 "bool": "true or false", "array": "a list", "object": "a table", "null": "null"}
"""Kinds of values of JSON, in words."""


def mismatch_in_words(message: str, kinds: Mapping[str, str],
                      key_in_words: Callable[[str], str]) -> str:
    """Return what msgspec says of a key, such as "seed is text, expected a whole number".

    Parameters
    ----------
    message : str
        The message of a msgspec.ValidationError.
    kinds : mapping
        Words for kinds of values: "int", "str" and so on. A kind without words is not listed among
        those that are expected.
    key_in_words : callable
        Takes the place of the key in the file, such as "image[3].rpc" or "" for the file itself,
        and returns what the user calls it.

    Examples
    --------
    >>> mismatch_in_words("Expected `int | null`, got `str` - at `$.seed`", KINDS_OF_JSON, str)
    'seed is text, expected a whole number or null'
    """
    # "Expected `int`, got `str` - at `$.seed`", "Object missing required field `x` - at `$.y`".
    problem, _, path = message.partition(" - at ")
    key = key_in_words(path.strip("`").removeprefix("$").removeprefix("."))
    wrong_kind = re.fullmatch(r"Expected `([^`]+)`, got `([^`]+)`", problem)
    if wrong_kind:
        expected = [kinds[kind] for kind in wrong_kind[1].split(" | ") if kind in kinds]
        given = kinds.get(wrong_kind[2], wrong_kind[2])
        return f"{key} is {given}, expected {' or '.join(expected) or wrong_kind[1]}"
    missing_key = re.fullmatch(r"Object missing required field `([^`]+)`", problem)
    if missing_key:
        return f"{key} lacks {missing_key[1]!r}"
    unknown = re.fullmatch(r"Object contains unknown field `([^`]+)`", problem)
    if unknown:
        return f"{key} has {unknown[1]!r}, which is not known"
    limit = re.fullmatch(r"Expected `([^`]+)`(.*)", problem)
    if limit:
        return f"{key} is not {kinds.get(limit[1], limit[1])}{limit[2]}"
    return f"{key}: {problem[0].lower()}{problem[1:]}"
