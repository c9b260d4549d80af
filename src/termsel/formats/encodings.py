"""Text in any usual encoding: how its bytes are read, and what is said of that."""

from __future__ import annotations

import codecs
import logging
import re
from collections.abc import Iterator
from pathlib import Path

from termsel.core.errors import TermselError
from termsel.data.tables.columns import (
    CENTRAL_EUROPEAN,
    CHINESE,
    GREEK,
    JAPANESE,
    KOREAN,
    RUSSIAN,
    TAIWANESE,
    TURKISH,
)

log = logging.getLogger(__name__)

_LOOKED_AT = 400  # bytes that show whether a text is UTF-16
_NAMED_WITHIN = 65_536  # bytes in which columns are named, below comments
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_CONTROL = re.compile("[\x01-\x08\x0e-\x1f]")
"""Characters that numbers of 16 bits, such as pixels, give where they are read as UTF-16."""

_DECLARED = re.compile(rb"""\s*<\?xml[^>]*\bencoding\s*=\s*["']([\w.:-]+)""")
"""How XML declares an encoding whose letters have one byte: no other needs it to be known."""

_TOLD_BY_NAMES = {"cp1251": RUSSIAN, "koi8-r": RUSSIAN, "cp866": RUSSIAN, "cp932": JAPANESE,
                  "cp949": KOREAN, "big5": TAIWANESE, "gb18030": CHINESE,
                  "cp1250": CENTRAL_EUROPEAN, "iso8859-2": CENTRAL_EUROPEAN, "cp1253": GREEK,
                  "cp1254": TURKISH}
"""Encodings that most bytes fit, by the names of columns of which they must give one.

Chinese names may be one character, which text of other countries may give by chance.
"""

_said = set[tuple[Path, str]]()
"""Files and their encodings that a note has told: readers open a file several times."""


class BadText(TermselError):
    """What is surely text, but cannot be read as a table or in any other format."""


def decode(data: bytes, path: Path, *, final: bool = True) -> tuple[str, str]:
    """Return the text of bytes, and its encoding: UTF-8, UTF-16, Windows-1252 or another one.

    Other encodings are taken if their names of columns are at its beginning. If not `final`, `data`
    are the first bytes of more, which may end within a character. Raises TermselError for bytes
    that are no text, and `BadText`, with the line, for text of no such encoding.
    """
    has_mark = data[:2] in _UTF16_MARKS
    first_error: UnicodeDecodeError | None = None
    for encoding in _possible_encodings(data):
        try:
            text = codecs.getincrementaldecoder(encoding)().decode(data, final)
        except UnicodeDecodeError as error:
            first_error = first_error or error
            continue
        if "\0" in text or (encoding.startswith("utf-16-") and _CONTROL.search(text)):
            break
        return text, encoding
    # A zero byte is in no text of these encodings but UTF-16.
    if first_error is None or (b"\0" in data and not has_mark):
        raise TermselError("this file is binary, expected text or a spreadsheet", file=path,
                           hint="Save it as text, a table as CSV or as .xlsx.")
    raise BadText(f"the text of this file is not {'UTF-16' if has_mark else 'UTF-8'}", file=path,
                  line=data[:first_error.start].count(b"\n") + 1,
                  hint="Save it with the encoding UTF-8.")


def decode_file(data: bytes, path: Path) -> str:
    """Return the text of a whole file, and note an encoding that is none of Unicode.

    Raises TermselError as `decode` does.
    """
    text, encoding = decode(data, path)
    if not encoding.startswith("utf") and (path, encoding) not in _said:
        _said.add((path, encoding))
        log.info("Note: the text of %s is not UTF-8; it is read as %s.", path, encoding)
    return text


def decode_xml(data: bytes, path: Path) -> str:
    """Return the text of XML in the encoding that it declares; without one, as `decode_file` does.

    Raises TermselError where its bytes are not in that encoding, or nobody knows it.
    """
    declared = _DECLARED.match(data)
    # What is not UTF-8 although it says so is treated as any other text.
    if declared is None or declared[1].lower() in (b"utf-8", b"utf8"):
        return decode_file(data, path)
    try:
        return data.decode(declared[1].decode("ascii"))
    except (LookupError, UnicodeError) as error:
        raise TermselError(f"the encoding of this XML cannot be read: {error}", file=path, line=1,
                           hint="Save it with the encoding UTF-8.") from error


def head_in_utf8(head: bytes) -> bytes:
    """Return the first bytes of a file, those of a text in UTF-8 without a byte order mark.

    Bytes that are no text come back as they are.
    """
    try:
        text, encoding = decode(head, Path(), final=False)
    except TermselError:
        return head
    in_utf8 = head if encoding.startswith("utf-8") else text.encode()
    return in_utf8.removeprefix(codecs.BOM_UTF8)


def _possible_encodings(data: bytes) -> Iterator[str]:
    """Yield the encodings that a text may have by its first bytes, in the order to try them."""
    # In UTF-16 every other byte is mostly zero: the first of each pair, if the high byte comes
    # first. A fifth is enough, as letters of other scripts have no zero byte.
    head = data[:_LOOKED_AT]
    has_zeros = [head[start::2].count(0) * 5 > len(head) // 2 for start in (0, 1)]
    if data[:2] in _UTF16_MARKS:
        yield "utf-16"
    elif has_zeros == [True, False]:
        yield "utf-16-be"
    elif has_zeros == [False, True]:
        yield "utf-16-le"
    else:
        yield "utf-8-sig"
        yield from (encoding for encoding in _TOLD_BY_NAMES if _names_columns(data, encoding))
        yield "cp1252"


def _names_columns(data: bytes, encoding: str) -> bool:
    """Return whether the beginning of a text has names of columns that tell this encoding."""
    beginning = data[:_NAMED_WITHIN].decode(encoding, "ignore").casefold()
    return any(name in beginning for name in _TOLD_BY_NAMES[encoding])
