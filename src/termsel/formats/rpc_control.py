"""The control that an RPC was fitted to, as its file carries it beside the coefficients.

GDAL, OTB and others skip these entries: a group of its own in an RPB, further lines of a _RPC.TXT,
items of a raster's metadata. They do not copy them either. What they copy is numbers, so that the
two stated errors say as well that termsel fitted the RPC, in digits that mean nothing: of 15 digits
the first 6 are the error, 4 are a mark, 5 the number of control features.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from termsel.data.fingerprints import ERROR_DIGITS, KEPT
from termsel.data.rpc import Rpc

_NOTE = "TERMSEL_NOTE"
_COUNT = "TERMSEL_CONTROL_COUNT"
_DIGESTS = "TERMSEL_CONTROL_DIGESTS"

_DIGESTS_PER_LINE = 5  # GDAL reads lines of up to 100 characters of a _RPC.TXT, and 200 of them
_DIGEST = re.compile(r"\b[0-9a-f]{12}\b")
_LARGEST_COUNT = 10**9
_DIGITS = 15  # that a double keeps, and the tag of a GeoTIFF
_MARK = "2735"  # chance gives two errors this mark, and one count, once in 10^13
_COUNT_DIGITS = _DIGITS - ERROR_DIGITS - len(_MARK)


def control_items(rpc: Rpc) -> dict[str, str]:
    """Return a raster's metadata on the control of its RPC; {} for a vendor's RPC."""
    if not rpc.control_count:
        return {}
    return {_NOTE: f"This RPC was fitted by termsel to {rpc.control_count} control features.",
            _COUNT: str(rpc.control_count), _DIGESTS: " ".join(rpc.control_digests)}


def control_group(rpc: Rpc) -> list[str]:
    """Return the lines of a group of an RPB that say it."""
    items = control_items(rpc)
    if not items:
        return []
    return ["BEGIN_GROUP = TERMSEL", *(f'\t{name} = "{value}";' for name, value in items.items()),
            "END_GROUP = TERMSEL"]


def control_lines(rpc: Rpc) -> list[str]:
    """Return the lines of a _RPC.TXT that name the control an RPC was fitted to; [] without any.

    They are a note, the number of features, and digests of these.
    """
    items = control_items(rpc)
    if not items:
        return []
    digests = rpc.control_digests
    lines = [f"{name}: {items[name]}" for name in (_NOTE, _COUNT)]
    for start in range(0, len(digests), _DIGESTS_PER_LINE):
        lines.append(f"{_DIGESTS}_{start // _DIGESTS_PER_LINE + 1}: "
                     f"{' '.join(digests[start:start + _DIGESTS_PER_LINE])}")
    return lines


def mark_error(error: float, count: int) -> float:
    """Return a stated error with digits that say how many control features an RPC was fitted to.

    The mark and the count come after the digits of the error itself. The error is returned as it is
    for a count of 0, that of a vendor's RPC.
    """
    if not count:
        return error
    significand, _, exponent = f"{error:.{ERROR_DIGITS - 1}e}".partition("e")
    largest = 10**_COUNT_DIGITS - 1
    return float(f"{significand}{_MARK}{min(count, largest):0{_COUNT_DIGITS}d}e{exponent}")


def read_errors(bias: float | None, random: float | None,
                ) -> tuple[float | None, float | None, int]:
    """Return stated errors without the mark of `mark_error`, and the count that it had.

    The count is 0, and the errors are as they are, where not both have the mark and one count.
    """
    if bias is None or random is None:
        return bias, random, 0
    bias_without, count = _error_and_count(bias)
    random_without, count_of_random = _error_and_count(random)
    if not count or count != count_of_random:
        return bias, random, 0
    return bias_without, random_without, count


def _error_and_count(error: float) -> tuple[float, int]:
    """Return an error without its mark and the count behind the mark; 0 without a mark."""
    significand, _, exponent = f"{error:.{_DIGITS - 1}e}".partition("e")
    count = significand[-_COUNT_DIGITS:]
    stated = significand[:-_COUNT_DIGITS]
    if not stated.endswith(_MARK):
        return error, 0
    return float(f"{stated.removesuffix(_MARK)}e{exponent}"), int(count)


def with_control(rpc: Rpc, items: Mapping[str, str]) -> Rpc:
    """Return an RPC with the control that its file names among all its entries.

    The RPC is returned as it is if the file names none.
    """
    count = items.get(_COUNT, "").strip(' "')
    if not count.isdecimal():
        return rpc
    texts = [value for name, value in items.items() if name.startswith(_DIGESTS)]
    return replace(rpc, control_count=min(int(count[:10]), _LARGEST_COUNT),
                   control_digests=tuple(_DIGEST.findall(" ".join(texts))[:KEPT]))
