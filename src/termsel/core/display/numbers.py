"""How figures are rounded wherever people read them."""

from __future__ import annotations

_TENTHS, _HUNDREDTHS, _DIGITS = 99.95, 9.995, 0.0995
"""From these sizes on a figure has no decimals, one, and two; a smaller one has two digits."""


def rounded(value: float) -> str:
    """Return a size in px or metres with the same number of decimals on every screen and page.

    Examples
    --------
    >>> [rounded(size) for size in (0.0123, 0.2483, 8.149, 14.31, 1041.2)]
    ['0.012', '0.25', '8.15', '14.3', '1,041']
    """
    size = abs(value)
    if size >= _TENTHS:
        return f"{value:,.0f}"
    if size >= _HUNDREDTHS:
        return f"{value:.1f}"
    return f"{value:.2f}" if size >= _DIGITS else f"{value:.2g}"


def interval(low: float, high: float, percent: float = 90.0) -> str:
    """Return an interval as the screens show it, such as ``[90 %: 0.22-0.29 px]``."""
    return f"[{percent:.0f} %: {rounded(low)}-{rounded(high)} px]"
