"""Remedies of messages as a caller in Python writes them: arguments in place of options."""

from __future__ import annotations

import re
from collections.abc import Collection

_COMMAND = re.compile(r"(?:\btermsel [a-z]|\bgdal|\bogr2ogr |\bpip ).*?(?=[.;:,)](?:\s|$)|   |$)")
"""A command for a shell, which stays as it is in a message: up to the end of the clause."""

_BOTH = re.compile(r", in Python [\w=' ]+?(?=[.:;,)]|$)")
"""The argument that a message names beside an option."""

_NAMED = re.compile(r"--(?P<name>solver|method|model|criterion|strategy|resampling|format|to|then)"
                    r"[ =]"
                    r"(?!(?:or|and|out|to|is|in|with|as|for|has|of|names|says|takes|chooses)\b)"
                    r"(?P<value>[a-z][\w-]*)")
"""An option with the name of something, which is a plain word."""

_OPTION = re.compile(
    r"--(?P<name>[a-z][a-z-]*)"
    r"(?:[ =](?P<value>'[^']*'|\"[^\"]*\"|[A-Z][A-Z0-9]*(?:[:=,][^\s.;)]+)?(?![a-z])"
    r"|[a-z_]\w*=[^\s.;)]*[^\s.,;)]|[\w/~.+-]*[\d/](?:[\w/.,+:-]*\w)?|auto\b|local\b))?")
"""An option, with its value where one follows: in quotation marks, a placeholder, a name with a
digit or of a file, or one of few words."""

_PLACEHOLDER = re.compile(r"[A-Z][A-Z0-9]*")
_ARGUMENTS = {"res": ("resolution",), "points": ("points", "features", "result"),
              "output": ("output", "path", "out"), "out": ("out", "folder")}
"""Arguments that options are called otherwise in Python, the likeliest first."""
_FLAGS = {"overwrite": "overwrite=True", "no-final": "final=False", "final": "final=True",
          "verbose": "verbose=True", "quiet": "quiet=True"}


def in_python(text: str, arguments: Collection[str]) -> str:
    """Return a message with the arguments of a function in place of options of the command line.

    `arguments` are the names that the function takes. Whole commands stay, as they are typed in a
    shell whoever reads them.
    """
    text = _BOTH.sub("", text)
    pieces = []
    end = 0
    for command in _COMMAND.finditer(text):
        pieces += [_with_arguments(text[end:command.start()], arguments), command[0]]
        end = command.end()
    return "".join([*pieces, _with_arguments(text[end:], arguments)])


def _with_arguments(text: str, arguments: Collection[str]) -> str:
    """Return a text that has no command with arguments in place of options."""
    def written(option: re.Match[str]) -> str:
        name, value = option["name"], option["value"]
        if name in _FLAGS and not value:
            return _FLAGS[name]
        if name == "set":
            return _set_in_words(value)
        own = next((known for known in _ARGUMENTS.get(name, ()) if known in arguments),
                   name.replace("-", "_"))
        return own if value is None else f"{own}={_literal(value)}"

    text = _NAMED.sub(lambda option: f"{option['name']}={option['value']!r}", text)
    return _OPTION.sub(written, text)


def _set_in_words(pair: str | None) -> str:
    """Return an option of data, of a file or of a model by its name.

    Whether a function takes it so, among its options, or not at all, the function says itself.
    """
    name, _, value = (pair or "options").strip("'").partition("=")
    return f"{name}={_literal(value)}" if value else name


def _literal(value: str) -> str:
    """Return a value as Python writes it; a placeholder and a number stay as they are."""
    bare = value[1:-1] if value[0] in "'\"" else value
    if _PLACEHOLDER.fullmatch(bare) or re.fullmatch(r"-?\d+(\.\d+)?", bare):
        return bare
    return repr(bare)
