"""The library that draws charts in a browser, to be part of what shows them."""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from termsel.core.errors import TermselError, require_import
from termsel.core.files.atomic import write_bytes
from termsel.core.version import __version__
from termsel.results.pictures import drawing_bundle

EMBED = "termselEmbed"
"""The function of the library, by a name that no other script on a page has."""

_CACHE_FOLDER = Path(__file__).parent / "__pycache__"


@cache  # half a megabyte of the package, for each page
def read_library() -> str:
    """Return Vega, Vega-Lite and Vega-Embed with the interpreter of expressions.

    To put it together takes longer than all else of a page, so that it is kept next to the bytecode
    of this module, where that can be written.

    Raises
    ------
    TermselError
        If altair or vl-convert-python is not installed.
    """
    for module, package in (("altair", "altair"), ("vl_convert", "vl-convert-python")):
        # A page without charts imports neither, as that takes long.
        with require_import("pages require", package, '"termsel[report]"'):
            if find_spec(module) is None:
                raise ImportError(name=module)
    cached = _CACHE_FOLDER / f"{EMBED}-{version('vl-convert-python')}-{__version__}.js"
    with suppress(OSError):
        # The checksum refuses what a crash, or another program, has left there.
        checksum, _, data = cached.read_bytes().partition(b"\n")
        if checksum == _checksum_of_library(data):
            return data.decode()
    # The library lies within a script of the page, which "</script" would end.
    text = drawing_bundle(f"window.{EMBED} = vegaEmbed;").replace(
        "</script", "<\\/script")
    # A page does not depend on the cache.
    with suppress(OSError, TermselError):
        _CACHE_FOLDER.mkdir(exist_ok=True)
        data = text.encode()
        write_bytes(cached, _checksum_of_library(data) + b"\n" + data)
    return text


def _checksum_of_library(data: bytes) -> bytes:
    """Return the SHA-256 of the library in hex, as bytes."""
    return sha256(data).hexdigest().encode()
