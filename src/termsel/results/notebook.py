"""Charts in notebooks, where Altair would load its scripts from a server.

The output of a chart is its picture, and a script that puts the live chart in its place. The
library of that script comes with the first chart of a session; where a notebook is opened again
without that output, the pictures stay.
"""

from __future__ import annotations

import base64
import json
from functools import cache
from html import escape
from importlib.util import find_spec
from typing import Any
from uuid import uuid4

from termsel.results.library import EMBED, read_library
from termsel.results.pictures import draw_picture, make_drawable
from termsel.results.theme import require_altair

_sent = False


def offline_chart(chart: Any) -> Any:
    """Return a chart that shows itself in a notebook without a connection.

    It remains an Altair chart, and so do the charts that its methods make of it, such as
    ``properties``. Where the user has enabled a renderer of Altair, that one shows it.
    """
    # A shallow copy, whose class alone differs: the chart of the user stays as it is.
    copied = chart.copy(deep=False)
    kind: Any = type(chart)
    object.__setattr__(copied, "__class__", _offline_class(kind))
    return copied


@cache  # a class is made once for each kind of chart
def _offline_class(kind: Any) -> type:
    """Return the class of a chart that notebooks show without a connection."""
    def bundle(self: Any, *args: Any, **kwds: Any) -> Any:
        """Return the chart as HTML and text by MIME type, or as Altair shows it.

        Altair shows it where the user has chosen one of its renderers, and where vl-convert is not
        installed.
        """
        if require_altair().renderers.active != "default" or find_spec("vl_convert") is None:
            return kind._repr_mimebundle_(self, *args, **kwds)
        return {"text/html": html_of(self), "text/plain": repr(self)}

    return type(kind.__name__, (kind,), {"_repr_mimebundle_": bundle, "__module__": __name__,
                                         "__doc__": kind.__doc__})


def html_of(chart: Any) -> str:
    """Return a chart as HTML for the output of a cell of a notebook.

    The first one in a process also has the library that draws it, megabytes long, which a notebook
    needs once.
    """
    global _sent
    spec = chart.to_dict()
    # The picture stands for the chart where scripts do not run, as on a page of a repository.
    encoded = base64.b64encode(draw_picture(chart, ".svg")).decode()
    title = spec.get("title", "")
    description = title.get("text", "") if isinstance(title, dict) else title
    element = f"termsel-{uuid4().hex}"
    # Nothing in the data may end the script.
    content = make_drawable(json.dumps(spec, allow_nan=False)).replace("<", "\\u003c")
    scripts = "" if _sent else f"<script>{read_library()}</script>"
    _sent = True
    return (f'<div id="{element}"><img alt="{escape(str(description))}" '
            f'src="data:image/svg+xml;base64,{encoded}"></div>{scripts}<script>(() => {{\n'
            f"const place = document.getElementById({json.dumps(element)});\n"
            f"if (!place || !window.{EMBED}) return;\nplace.replaceChildren();\n"
            f'window.{EMBED}(place, {content}, {{ actions: false, renderer: "svg", '
            'mode: "vega-lite" });\n})();</script>')
