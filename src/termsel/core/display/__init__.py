"""Values at one glance: a few lines in a terminal, a small table in a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from termsel.core.arguments import Explained
from termsel.core.errors import cut, make_printable

_MAX_VALUE_LENGTH = 160
"""Characters of a value."""


class Glance(Explained):
    """Base of values that show themselves by a title and a few figures.

    Subclasses return both from `_glance`.
    """

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        raise NotImplementedError

    def __repr__(self) -> str:
        title, rows = self._glance()
        return "\n".join(
            [
                f"<{_short_value(title)}>",
                *(f"  {name}: {_short_value(value)}" for name, value in rows.items()),
            ]
        )

    def _repr_html_(self) -> str:
        """Return the repr as a table of HTML, for notebooks."""
        title, rows = self._glance()
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(_short_value(value))}</td></tr>"
            for name, value in rows.items())
        return f"<div><strong>{escape(_short_value(title))}</strong><table>{cells}</table></div>"


def _short_value(text: str) -> str:
    """Return a text short enough for a representation, printable as it is."""
    return make_printable(cut(text, _MAX_VALUE_LENGTH), keep="")
