"""Residuals as a small drawing, for lists of many images."""

from __future__ import annotations

import math
from html import escape
from typing import Any

import numpy as np

from termsel.toolkit import count_in_words
from termsel.toolkit.charts import BLUNDER, EDGE, INK, ROLE_COLOURS, View, nice_number

THUMBNAIL_SIZE = 120
"""Width and largest height of the drawing [px of the screen]."""
MAX_ARROWS = 150
"""Arrows drawn, the longest: more are not distinguished at this size."""
_MEDIAN_LENGTH = 0.12
"""Length of the arrow of the median residual, by the size of the drawing."""
_ARROW_HEAD = 3.0
"""Length of both strokes of an arrow's head [px of the screen]."""
_SCALE_BAR_HEIGHT = 16
"""Height of the scale bar below the drawing [px of the screen]."""
_MIN_RELATIVE_RESIDUAL = 1e-9
"""Median residual, by the size of the image, below which residuals are rounding: a model with as
many terms as there are coordinates has no others."""


def draw_residual_thumbnail(view: View) -> str:
    """Return a small drawing of residuals as SVG: arrows over the outline of the image.

    The scale is such that the median residual can be seen; a bar below shows it. Residuals of
    rounding alone have neither arrows of a length nor a bar. Probable blunders have rings.
    """
    first_line, first_sample, bottom, right = view.image_box
    n_samples = max(right - first_sample, 1.0)
    n_lines = max(bottom - first_line, 1.0)
    pixel = THUMBNAIL_SIZE / max(n_samples, n_lines)
    width = n_samples * pixel
    height = n_lines * pixel
    rows = sorted(view.in_image, key=lambda row: -row["distance"])
    lengths = [row["distance"] for row in rows]
    median = float(np.median(lengths)) if lengths else 0.0
    is_drawn = median > _MIN_RELATIVE_RESIDUAL * max(n_samples, n_lines)
    enlargement = _MEDIAN_LENGTH * THUMBNAIL_SIZE / median if is_drawn else 0.0
    arrows: dict[str, list[str]] = {role: [] for role in ROLE_COLOURS}
    rings = []
    for row in rows[:MAX_ARROWS]:
        x = (row["sample"] - first_sample) * pixel
        y = (row["line"] - first_line) * pixel
        arrows[row["role"]].append(_arrow_path(x, y, row, enlargement))
        if row["blunder"]:
            rings.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="none" '
                         f'stroke="{BLUNDER}" stroke-width="1.4"/>')
    drawn = "".join(f'<path d="{"".join(paths)}" fill="none" stroke="{ROLE_COLOURS[role]}"/>'
                    for role, paths in arrows.items() if paths)
    description = (f"{count_in_words(view.count, 'residual')}, the largest "
                   f"{max(lengths, default=0.0):.3g} px")
    return ('<svg xmlns="http://www.w3.org/2000/svg" '
            f'width="{width + 2:.0f}" height="{height + _SCALE_BAR_HEIGHT:.0f}" '
            f'viewBox="-1 -1 {width + 2:.0f} {height + _SCALE_BAR_HEIGHT:.0f}" role="img" '
            f'aria-label="{escape(description)}"><rect width="{width:.1f}" height="{height:.1f}" '
            # The inner SVG clips arrows that leave the outline of the image.
            f'fill="none" stroke="{EDGE}"/><svg width="{width:.1f}" height="{height:.1f}">'
            f'{drawn}{"".join(rings)}</svg>'
            f"{_scale_bar(height, enlargement, width)}</svg>")


def _arrow_path(x: float, y: float, row: dict[str, Any], enlargement: float) -> str:
    """Return the path in SVG of an arrow from x, y that shows the residual of a row.

    It is `enlargement` times as long as the residual, but at most twice the size of the drawing:
    viewers draw paths of huge numbers wrongly.
    """
    # The least distance keeps a residual of 0 from a division by 0.
    enlargement = min(enlargement, 2.0 * THUMBNAIL_SIZE / max(row["distance"], 1e-300))
    dx = row["ds"] * enlargement
    dy = row["dl"] * enlargement
    direction = math.atan2(dy, dx)
    head = "".join(f"M{x + dx:.1f} {y + dy:.1f}l{-_ARROW_HEAD * math.cos(direction + angle):.1f} "
                   f"{-_ARROW_HEAD * math.sin(direction + angle):.1f}" for angle in (-0.5, 0.5))
    return f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}{head}"


def _scale_bar(height: float, enlargement: float, width: float) -> str:
    """Return the scale bar of the residuals as SVG; "" for an enlargement of 0: no arrow is drawn.
    """
    if not enlargement:
        return ""
    length = nice_number(0.4 * width / enlargement)
    return (f'<path d="M0 {height + 9:.1f}h{length * enlargement:.1f}" stroke="{INK}" '
            f'stroke-width="2"/><text x="{length * enlargement + 4:.1f}" y="{height + 12.5:.1f}" '
            f'font-size="10" fill="{INK}">{length:g} px</text>')
