"""The control that an RPC was fitted to, as its file carries it beside the coefficients.

GDAL, OTB and others skip these entries: a group of its own in an RPB, further lines of a _RPC.TXT,
items of a raster's metadata.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from termsel.data.fingerprints import KEPT
from termsel.data.rpc import Rpc

_NOTE = "TERMSEL_NOTE"
_COUNT = "TERMSEL_CONTROL_COUNT"
_DIGESTS = "TERMSEL_CONTROL_DIGESTS"

_DIGESTS_PER_LINE = 5  # GDAL reads lines of up to 100 characters of a _RPC.TXT, and 200 of them
_DIGEST = re.compile(r"\b[0-9a-f]{12}\b")
_LARGEST_COUNT = 10**9


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
    """Return the lines of a _RPC.TXT that say it."""
    items = control_items(rpc)
    if not items:
        return []
    digests = rpc.control_digests
    lines = [f"{name}: {items[name]}" for name in (_NOTE, _COUNT)]
    for start in range(0, len(digests), _DIGESTS_PER_LINE):
        lines.append(f"{_DIGESTS}_{start // _DIGESTS_PER_LINE + 1}: "
                     f"{' '.join(digests[start:start + _DIGESTS_PER_LINE])}")
    return lines


def with_control(rpc: Rpc, items: Mapping[str, str]) -> Rpc:
    """Return an RPC with the control that its file names among all its entries."""
    count = items.get(_COUNT, "").strip(' "')
    if not count.isdecimal():
        return rpc
    texts = [value for name, value in items.items() if name.startswith(_DIGESTS)]
    return replace(rpc, control_count=min(int(count[:10]), _LARGEST_COUNT),
                   control_digests=tuple(_DIGEST.findall(" ".join(texts))[:KEPT]))
