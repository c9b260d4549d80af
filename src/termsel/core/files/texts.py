"""Tables, XML and Markdown for other programs, whatever the names in them hold.

Every table and every XML that termsel writes goes through here. A spreadsheet would run a cell that
begins like a formula, a terminal obeys control characters, and no XML may hold them.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from xml.etree import ElementTree

from termsel.core.errors import make_printable

_FORMULA = re.compile(r"'*\s*[=+\-@\uff1d\uff0b\uff0d\uff20\ufe62\ufe63\ufe66\ufe6b]")
"""How a formula begins, in characters of full width and small ones as well."""

_QUOTED = re.compile(r'[,;\t"\r\n#]')
"""What a cell holds only between quotation marks."""

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that no XML document holds."""

_MARKDOWN = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "|": r"\|", "`": r"\`",
                           "[": r"\[", "]": r"\]"})


def guard_cell(text: str) -> str:
    """Return a cell that no spreadsheet takes for a formula, as `unguard_cell` takes it back."""
    # A spreadsheet runs text that begins with = + - or @, unless an apostrophe is in front of it.
    return f"'{text}" if _FORMULA.match(text) and not is_number(text) else text


def unguard_cell(text: str) -> str:
    """Return a cell without the apostrophe that guards it."""
    return text[1:] if text[:1] == "'" and _FORMULA.match(text) else text


def is_number(text: str) -> bool:
    """Return True for text that Python reads as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def csv_table(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV: text guarded and printable, numbers as they are, None as a blank cell."""
    page = io.StringIO()
    writer = csv.writer(page, lineterminator="\n")
    for row in rows:
        writer.writerow([guard_cell(make_printable(cell)) if isinstance(cell, str) else cell
                         for cell in row])
    return page.getvalue()


def cell_text(text: str) -> str:
    """Return text as a cell of a table whose cells commas, semicolons or tabs separate: guarded."""
    text = guard_cell(make_printable(text))
    # Unquoted, a line that begins with # would be a comment; csv.writer does not quote it.
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text


def xml_document(root: ElementTree.Element) -> str:
    """Return the text of an XML document, indented, without characters that no XML holds."""
    for element in root.iter():
        element.attrib = {key: xml_characters(value) for key, value in element.items()}
        element.text = None if element.text is None else xml_characters(element.text)
    ElementTree.indent(root)
    return ('<?xml version="1.0" encoding="UTF-8"?>\n'
            f'{ElementTree.tostring(root, encoding="unicode")}\n')


def xml_text(text: str) -> str:
    """Return text as XML holds it; a character that no XML holds is replaced."""
    from xml.sax.saxutils import escape  # with it come parts that open addresses, in 40 ms

    return escape(_NO_XML.sub("\ufffd", text))


def xml_attribute(text: str) -> str:
    """Return text as an attribute of XML, in quotation marks; U+FFFD for characters XML lacks."""
    from xml.sax.saxutils import quoteattr  # likewise

    return quoteattr(_NO_XML.sub("\ufffd", text))


def xml_characters(text: str) -> str:
    """Return text without characters that no XML holds, for libraries that write XML."""
    return _NO_XML.sub("\ufffd", text)


def is_xml_text(text: str) -> bool:
    """Return whether XML can hold a text without a change, such as the name of a file."""
    return _NO_XML.search(text) is None


def markdown_text(text: str) -> str:
    """Return text on one line of Markdown that shows it: no HTML, link or control character."""
    return " ".join(make_printable(" ".join(text.split())).translate(_MARKDOWN).split())
