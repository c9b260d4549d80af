"""XML as nested calls."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree import ElementTree

Element = ElementTree.Element

_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that no XML document holds."""


class Writing:
    """Makes elements of a vocabulary of namespaces, by prefix.

    Parameters
    ----------
    namespaces : mapping
        URI of each prefix; none for a vocabulary without namespaces.
    """

    def __init__(self, namespaces: Mapping[str, str] | None = None) -> None:
        self.namespaces = dict(namespaces or {})

    def __call__(self, name: str, *content: Element | str | None,
                 attributes: Mapping[str, str] | None = None) -> Element:
        """Return an element of the name "prefix:name"; content of None is left out."""
        made = Element(self._known(name), {self._known(key): value
                                           for key, value in (attributes or {}).items()})
        for part in content:
            if isinstance(part, str):
                made.text = _FORBIDDEN.sub("\ufffd", part)
            elif part is not None:
                made.append(part)
        return made

    def _known(self, name: str) -> str:
        prefix, colon, local = name.partition(":")
        return f"{{{self.namespaces[prefix]}}}{local}" if colon else name

    def text(self, root: Element) -> str:
        """Return a document as text."""
        for prefix, uri in self.namespaces.items():
            ElementTree.register_namespace(prefix, uri)
        ElementTree.indent(root)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n' \
               f'{ElementTree.tostring(root, encoding="unicode")}\n'
