"""The library that draws charts in a browser, to be part of what shows them."""

from __future__ import annotations

from functools import cache

from termsel.errors import requires
from termsel.report.theme import require_altair

EMBED = "termselEmbed"
"""The function of the library, by a name that no other script on a page has."""


@cache
def library() -> str:
    """Return Vega, Vega-Lite and Vega-Embed with the interpreter of expressions.

    Raises
    ------
    TermselError
        If altair or vl-convert-python is not installed.
    """
    require_altair()
    with requires("pages require", "vl-convert-python", '"termsel[report]"'):
        from vl_convert import javascript_bundle
    return javascript_bundle(f"window.{EMBED} = vegaEmbed;").replace("</script", "<\\/script")
