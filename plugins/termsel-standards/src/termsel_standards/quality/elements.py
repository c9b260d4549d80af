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
        URI of each prefix; by default there are no namespaces.
    """

    def __init__(self, namespaces: Mapping[str, str] | None = None) -> None:
        self.namespaces = dict(namespaces or {})

    def __call__(self, name: str, *content: Element | str | None,
                 attributes: Mapping[str, str] | None = None) -> Element:
        """Return an element with text or child elements as content; None is left out.

        `name` and the names of attributes are "prefix:name", or a name alone without a namespace.
        """
        element = Element(self._qualify_name(name), {self._qualify_name(key): value
                                                     for key, value in (attributes or {}).items()})
        for child in content:
            if isinstance(child, str):
                element.text = child
            elif child is not None:
                element.append(child)
        return element

    def _qualify_name(self, name: str) -> str:
        """Return the name "prefix:name" as ElementTree takes it, "{uri}name"; others unchanged."""
        prefix, colon, local = name.partition(":")
        return f"{{{self.namespaces[prefix]}}}{local}" if colon else name

    def text(self, root: Element) -> str:
        """Return the XML document of a root element as text, with the prefixes of the vocabulary.
        """
        for prefix, uri in self.namespaces.items():
            ElementTree.register_namespace(prefix, uri)
        return xml_document(root)
