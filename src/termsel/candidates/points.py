"""Control points for candidates that take points alone."""

from __future__ import annotations

from termsel.fits.fit import Undetermined
from termsel.measurements.features import BoolArray, FeatureSet, Points


def points_alone(control: FeatureSet, used: BoolArray, what: str) -> Points:
    """Return the points in use, and refuse lines.

    Parameters
    ----------
    used : ndarray of bool, shape (len(control),)
    what : str
        What does not take lines, as the subject of a sentence.

    Raises
    ------
    Undetermined
    """
    if len(control.lines):
        raise Undetermined(f"{what} takes control points alone, and there are control lines",
                           hint="Leave the lines out, or choose another model.")
    return control.points.take(used)
