"""What a TIFF says of itself in GDAL's tag, looked at without GDAL.

There a TIFF may name further files, such as its overviews, which GDAL opens when it needs them. A
mosaic may have thousands of TIFFs, which GDAL takes milliseconds each to open.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

_METADATA = 42112
"""Tag of GDAL's metadata, which are XML."""

_MOST_ENTRIES = 4096
_MAX_METADATA = 1 << 24  # bytes of metadata


@dataclass(frozen=True)
class _Layout:
    """How a kind of TIFF writes numbers: as `struct` names them, with their sizes in bytes."""

    first: int  # where the place of the first directory is written
    offset: str
    entries: str
    entry: str  # tag, type, count, value or its place


_CLASSIC = _Layout(4, "I", "H", "HHII")
_BIG = _Layout(8, "Q", "Q", "HHQQ")


def metadata_of_tiff(file: BinaryIO) -> bytes | None:
    """Return GDAL's metadata of the first image of a TIFF, as bytes of XML; empty without any.

    Returns None where that cannot be told: for other files, and where the TIFF is cut off or has
    too many entries.

    Parameters
    ----------
    file : binary file
        Open at any place.
    """
    file.seek(0)
    head = file.read(4)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 4:
        return None
    layout = {42: _CLASSIC, 43: _BIG}.get(struct.unpack(f"{order}H", head[2:])[0])
    if layout is None:
        return None
    try:
        start = _read_number(file, layout.first, order + layout.offset)
        count = _read_number(file, start, order + layout.entries)
        size = struct.calcsize(order + layout.entry)
        if count > _MOST_ENTRIES:
            return None
        table = file.read(count * size)
        for tag, _, length, value in struct.iter_unpack(order + layout.entry, table):
            if tag == _METADATA:
                # A text of a few bytes stands in place of its offset; no metadata is so short.
                is_in_entry = length <= struct.calcsize(layout.offset)
                return b"" if is_in_entry else _read_bytes(file, value, length)
    except (struct.error, OverflowError):  # cut off
        return None
    return b"" if len(table) == count * size else None


def _read_number(file: BinaryIO, offset: int, form: str) -> int:
    """Return the number of struct's format `form` at an offset of a file."""
    return int(struct.unpack(form, _read_bytes(file, offset, struct.calcsize(form)))[0])


def _read_bytes(file: BinaryIO, offset: int, length: int) -> bytes:
    """Return bytes at an offset, no more than metadata may have."""
    file.seek(offset)
    return file.read(min(length, _MAX_METADATA))
