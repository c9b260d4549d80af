"""Pictures of charts, drawn in a process of their own: a fault of the library ends that alone."""

from __future__ import annotations

import atexit
import re
from functools import cache
from typing import Any

from termsel.core.errors import TermselError, require_import
from termsel.core.isolation.helper import Helper, ProcessEndedError

SCALE = 2.0
"""Pixels of a PNG for each pixel of the screen."""

LEFT, RIGHT = 18, 46
"""Px that a drawing is wider on the left and on the right."""

_SIZE = re.compile(r'(?P<head><svg [^>]*)width="(?P<width>[\d.]+)" height="(?P<height>[\d.]+)" '
                   r'viewBox="0 0 [\d. ]+"><rect width="[\d.]+" ')

_DRAWING = """
import os, pickle, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # a trace of compiled code tells a user nothing
os.dup2(2, 1)
import vl_convert
while True:
    try:
        suffix, spec, more = pickle.load(questions)
    except EOFError:
        break
    try:
        name = "javascript_bundle" if suffix == "js" else f"vegalite_to_{suffix}"
        drawn = getattr(vl_convert, name)(spec, **more)
        answer = drawn.encode() if isinstance(drawn, str) else drawn
    except ValueError as error:
        answer = str(error)
    pickle.dump(answer, answers)
    answers.flush()
"""

_OF_OBJECTS = re.compile(
    r'(?<!\\)"(constructor|hasOwnProperty|isPrototypeOf|propertyIsEnumerable|toLocaleString|'
    r'toString|valueOf|__(?:proto|defineGetter|defineSetter|lookupGetter|lookupSetter)__)"(?! *:)')


def make_drawable(spec: str) -> str:
    """Return a chart, or other data of a page, as JSON that Vega can draw whatever its names are.

    Vega keeps names in objects of JavaScript, in which some names have a meaning already, such as
    that of a point "constructor". A character that is not seen makes them others.
    """
    return _OF_OBJECTS.sub(r'"\1\\u2060"', spec)


def draw_picture(chart: Any, suffix: str) -> bytes:
    """Return a chart as a picture.

    Parameters
    ----------
    chart : altair.Chart
        The chart to draw.
    suffix : {".svg", ".png", ".pdf"}
        Format of the picture.

    Raises
    ------
    TermselError
        If vl-convert-python is not installed, or cannot draw the chart.
    """
    with require_import("pictures require", "vl-convert-python", '"termsel[report]"'):
        import vl_convert  # noqa: F401 (what the other process imports)
    try:
        # The specification goes to the process as text, the answer comes back as bytes, or as text
        # that says what went wrong.
        drawn = _drawing_helper().ask((suffix[1:], make_drawable(chart.to_json(indent=None)),
                                       {"scale": SCALE} if suffix == ".png" else {}))
    except ProcessEndedError as error:
        raise _undrawn_error("a fault of compiled code, or out of memory") from error
    if isinstance(drawn, str):
        # The first line of what the library says; the others are a trace of its own code.
        raise _undrawn_error(
            next((line for line in map(str.strip, drawn.splitlines()) if line), drawn))
    return with_margins(drawn.decode()).encode() if suffix == ".svg" else bytes(drawn)


def with_margins(svg: str) -> str:
    """Return a drawing with a margin for letters wider than those that it was measured with.

    A browser without Helvetica takes another font, in which long labels reach beyond the drawing.
    """
    def widen(size: re.Match[str]) -> str:
        width = float(size["width"]) + LEFT + RIGHT
        height = size["height"]
        return (f'{size["head"]}width="{width:g}" height="{height}" '
                f'viewBox="{-LEFT} 0 {width:g} {height}"><rect x="{-LEFT}" width="{width:g}" ')

    return _SIZE.sub(widen, svg, count=1)


def drawing_bundle(snippet: str) -> str:
    """Return the library that draws charts in a browser, with a line of its own at the end.

    Raises
    ------
    TermselError
        If the library vl-convert fails or ends, as for lack of memory.
    """
    try:
        bundle = _drawing_helper().ask(("js", snippet, {}))
    except ProcessEndedError:
        bundle = "a fault of compiled code, or out of memory"
    if isinstance(bundle, str):
        raise TermselError(f"the library vl-convert cannot make what draws charts: {bundle[:200]}",
                           hint="Tables and records are complete without it.")
    return bytes(bundle).decode()


def _undrawn_error(why: str) -> TermselError:
    """Return the error for a chart that could not be drawn, and what to do without it."""
    return TermselError(f"the library vl-convert cannot draw this chart: {why[:200]}",
                        hint="Tables and records are complete without it. "
                             "`termsel report` draws it in a browser.")


@cache  # one process, held by who asks until this one ends
def _drawing_helper() -> Helper:
    """Return the process that draws charts, which ends with this one."""
    helper = Helper(_DRAWING)
    # The process ends with this one, whatever it is doing.
    atexit.register(helper.end)
    return helper
