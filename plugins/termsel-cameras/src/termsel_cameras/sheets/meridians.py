"""Prime meridians that maps count longitudes from."""

from __future__ import annotations

from difflib import get_close_matches

from termsel import TermselError

MERIDIANS: dict[str, float] = {
    "greenwich": 0.0,
    "paris": 2.33722917,
    "ferro": -17.66666667,
    "pulkovo": 30.32777778,
    "rome": 12.45233333,
    "madrid": -3.687375,
    "lisbon": -9.13190611,
    "oslo": 10.72291667,
    "stockholm": 18.05827778,
    "brussels": 4.36797500,
    "bern": 7.43958333,
    "athens": 23.7163375,
    "jakarta": 106.80771944,
    "bogota": -74.08091667,
    "washington": -77.05,
}
"""Longitudes from Greenwich [deg]: EPSG's prime meridians 8901 to 8913, 1026. Ferro is by
convention 17 deg 40 min west of Greenwich, 20 deg west of Paris; Washington the old observatory's.
"""


def meridian_of(text: str) -> float:
    """Return the longitude from Greenwich [deg] of a meridian, given by its name or in degrees.

    Raises
    ------
    TermselError
        If the text is neither a name in `MERIDIANS` nor a number from -180 to 180.
    """
    name = text.strip().lower()
    if name in MERIDIANS:
        return MERIDIANS[name]
    try:
        degrees = float(name)
    except ValueError:
        degrees = float("nan")
    # NaN is in no range, so that it gets the same error.
    if not -180.0 <= degrees <= 180.0:
        near = get_close_matches(name, MERIDIANS, n=1, cutoff=0.6)
        guess = f"Did you mean {near[0]}? " if near else ""
        raise TermselError(f"there is no prime meridian {text!r:.40}",
                           hint=f"{guess}Give degrees from Greenwich, or one of "
                                f"{', '.join(MERIDIANS)}.")
    return degrees
