"""RPCs as the text of RPB and _RPC.TXT files, and as the items of GDAL's RPC domain."""

from __future__ import annotations

from termsel.io.rpc_files import ERROR_NAMES, RPB_NAMES
from termsel.rpc import Rpc

_UNKNOWN = -1.0  # what GDAL and vendors write for an error that is not known


def rpb_text(rpc: Rpc) -> str:
    """Return the text of an RPB file.

    Numbers keep all their digits, so that reading gives the same RPC.
    """
    lines = ['satId = "";', 'bandId = "";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    for name, value in _values(rpc).items():
        rpb = (ERROR_NAMES | RPB_NAMES)[name]
        if isinstance(value, tuple):
            numbers = ",\n".join(f"\t\t\t{number!r}" for number in value)
            lines.append(f"\t{rpb} = (\n{numbers});")
        else:
            lines.append(f"\t{rpb} = {value!r};")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;", ""])


def rpc_txt_text(rpc: Rpc) -> str:
    """Return the text of a _RPC.TXT file; numbers keep all their digits."""
    lines = []
    for name, value in _values(rpc).items():
        if isinstance(value, tuple):
            lines += [f"{name}_{i}: {number!r}" for i, number in enumerate(value, 1)]
        else:
            lines.append(f"{name}: {value!r}")
    return "\n".join([*lines, ""])


def rpc_items(rpc: Rpc) -> dict[str, str]:
    """Return the items of GDAL's RPC domain, as in a VRT; numbers keep all their digits."""
    return {name: " ".join(map(repr, value)) if isinstance(value, tuple) else repr(value)
            for name, value in _values(rpc).items()}


def _values(rpc: Rpc) -> dict[str, float | tuple[float, ...]]:
    """Return numbers by GDAL's names."""
    (line, sample), (line_scale, sample_scale) = rpc.image_offset, rpc.image_scale
    (lon, lat, height), (lon_scale, lat_scale, height_scale) = rpc.ground_offset, rpc.ground_scale
    values = (line, sample, lat, lon, height, line_scale, sample_scale, lat_scale, lon_scale,
              height_scale, rpc.line_numerator, rpc.line_denominator, rpc.sample_numerator,
              rpc.sample_denominator)
    errors = (_UNKNOWN if error is None else error
              for error in (rpc.error_bias, rpc.error_random))
    return dict(zip((*ERROR_NAMES, *RPB_NAMES), (*errors, *values), strict=True))
