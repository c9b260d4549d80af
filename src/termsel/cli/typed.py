"""The words of a command as they were typed, and the same command with other options."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

import click

from termsel.core.errors import is_printable

_WORDS = "termsel.words"
"""Key of the words in the context of the group of all commands."""
_SET = "--set"
"""The option that may stand several times, each time for an option of its own."""


def keep_words(ctx: click.Context, words: Sequence[str]) -> None:
    """Keep the words of a command in the context of the group, from the command's name on."""
    ctx.meta[_WORDS] = [*words]


def command_with(options: Mapping[str, str], flags: Sequence[str] = (),
                 words: Sequence[str] | None = None) -> str:
    """Return a command with some options in place of those it has, as a shell takes it.

    Parameters
    ----------
    options : mapping of str
        Value by option, such as ``{"--crs": "EPSG:4979"}``.
    flags : sequence of str
        Options without a value.
    words : sequence of str, optional
        The words of the command; by default those that were typed.

    Returns
    -------
    str
        "" where the words are not known, or one of them cannot be printed as it must be typed.
    """
    if words is None:
        ctx = click.get_current_context(silent=True)
        words = ctx.meta.get(_WORDS, ()) if ctx is not None else ()
    if not words:
        return ""
    kept = [word for word in _words_without(words, options) if word not in flags]
    typed = shlex.join([*kept, *chain.from_iterable(options.items()), *flags])
    return f"termsel {typed}" if is_printable(typed) else ""


def _words_without(words: Sequence[str], options: Mapping[str, str]) -> Iterator[str]:
    """Yield the words of a command without some options, written as "--crs X" or "--crs=X".

    --set is left out where it is about the same option of a model or of data, and stays elsewhere.
    """
    remaining = iter(words)
    for word in remaining:
        name, _, value = word.partition("=")
        if name == _SET and _SET in options:
            value = value or next(remaining, "")
            if value.partition("=")[0] != options[_SET].partition("=")[0]:
                yield from (_SET, value)
        # Without "=" the value is the next word, and goes with the option.
        elif word in options:
            next(remaining, None)
        elif name not in options:
            yield word
