"""XML as nested calls."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

from termsel.toolkit import xml_document

Element = ElementTree.Element


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
        element = Element(self._qualify_name(name), {self._qualify_name(key): value
                                                     for key, value in (attributes or {}).items()})
        for child in content:
            if isinstance(child, str):
                element.text = child
            elif child is not None:
                element.append(child)
        return element

    def _qualify_name(self, name: str) -> str:
        """Return a name with the address of its prefix, as ElementTree has it."""
        prefix, colon, local = name.partition(":")
        # ElementTree writes {uri}name for a prefix of its own.
        return f"{{{self.namespaces[prefix]}}}{local}" if colon else name

    def text(self, root: Element) -> str:
        """Return a document as text."""
        for prefix, uri in self.namespaces.items():
            ElementTree.register_namespace(prefix, uri)
        return xml_document(root)
