"""Residuals as a small drawing, for lists of many images."""

from __future__ import annotations

import math
from html import escape
from typing import Any

import numpy as np

from termsel.toolkit import count_in_words
from termsel.toolkit.charts import BLUNDER, EDGE, INK, ROLE_COLOURS, View, nice_number

WIDE = 120
"""Width and largest height of the drawing [px of the screen]."""
MAX_ARROWS = 150
"""Arrows drawn, the longest: more are not distinguished at this size."""
_LENGTH, _ARROW_HEAD, _BELOW = 0.12, 3.0, 16
_ROUNDING = 1e-9
"""Residual by the size of the image below which it is rounding, as where a model has as many terms
as there are coordinates."""


def small_map(view: View) -> str:
    """Return residuals as arrows over the outline of the image, as SVG without title and axes.

    Each drawing has a scale of its own, which a bar shows.
    """
    first_line, first_sample, bottom, right = view.image_box
    across = max(right - first_sample, 1.0)
    down = max(bottom - first_line, 1.0)
    pixel = WIDE / max(across, down)
    wide = across * pixel
    high = down * pixel
    rows = sorted(view.in_image, key=lambda row: -row["distance"])
    lengths = [row["distance"] for row in rows]
    median = float(np.median(lengths)) if lengths else 0.0
    # The median residual has a length that can be seen; a scale of its own for each image.
    is_drawn = median > _ROUNDING * max(across, down)
    longer = _LENGTH * WIDE / median if is_drawn else 0.0
    arrows: dict[str, list[str]] = {role: [] for role in ROLE_COLOURS}
    rings = []
    for row in rows[:MAX_ARROWS]:
        x = (row["sample"] - first_sample) * pixel
        y = (row["line"] - first_line) * pixel
        arrows[row["role"]].append(_arrow_path(x, y, row, longer))
        if row["blunder"]:
            rings.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="none" '
                         f'stroke="{BLUNDER}" stroke-width="1.4"/>')
    drawn = "".join(f'<path d="{"".join(paths)}" fill="none" stroke="{ROLE_COLOURS[role]}"/>'
                    for role, paths in arrows.items() if paths)
    description = (f"{count_in_words(view.count, 'residual')}, the largest "
                   f"{max(lengths, default=0.0):.3g} px")
    return ('<svg xmlns="http://www.w3.org/2000/svg" '
            f'width="{wide + 2:.0f}" height="{high + _BELOW:.0f}" '
            f'viewBox="-1 -1 {wide + 2:.0f} {high + _BELOW:.0f}" role="img" '
            f'aria-label="{escape(description)}"><rect width="{wide:.1f}" height="{high:.1f}" '
            # A drawing within a drawing clips what is longer.
            f'fill="none" stroke="{EDGE}"/><svg width="{wide:.1f}" height="{high:.1f}">'
            f'{drawn}{"".join(rings)}</svg>'
            f"{_scale_bar(high, longer, wide)}</svg>")


def _arrow_path(x: float, y: float, row: dict[str, Any], longer: float) -> str:
    """Return the path of an arrow from x, y that shows a residual `longer` times, clipped if huge.
    """
    longer = min(longer, 2.0 * WIDE / max(row["distance"], 1e-300))
    dx = row["ds"] * longer
    dy = row["dl"] * longer
    turn = math.atan2(dy, dx)
    head = "".join(f"M{x + dx:.1f} {y + dy:.1f}l{-_ARROW_HEAD * math.cos(turn + angle):.1f} "
                   f"{-_ARROW_HEAD * math.sin(turn + angle):.1f}" for angle in (-0.5, 0.5))
    return f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}{head}"


def _scale_bar(high: float, longer: float, wide: float) -> str:
    """Return the scale bar of the residuals as SVG; "" if they are not drawn."""
    if not longer:
        return ""
    length = nice_number(0.4 * wide / longer)
    return (f'<path d="M0 {high + 9:.1f}h{length * longer:.1f}" stroke="{INK}" '
            f'stroke-width="2"/><text x="{length * longer + 4:.1f}" y="{high + 12.5:.1f}" '
            f'font-size="10" fill="{INK}">{length:g} px</text>')
