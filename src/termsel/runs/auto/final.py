"""The final fit: the structure that was chosen, fitted to all points, independent ones included."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from termsel.candidates.portfolio import Judged, has_pole
from termsel.fits.fit import Fit, Undetermined
from termsel.fits.least_squares import LEAST_SQUARES
from termsel.measurements.features import Points
from termsel.measurements.roles import ASSIGNABLE
from termsel.measurements.scaling import scaling_of
from termsel.measurements.twins import merged


def final_fit(chosen: Judged, points: Points, heights: bool,
              blunders: Collection[str]) -> Fit | None:
    """Return the chosen structure fitted to all points.

    Selected terms stay those that were selected; what is shrunken is averaged again.

    Parameters
    ----------
    chosen : Judged
        The choice, fitted to control and check.
    points : Points
        All points, each with its role.
    heights : bool
    blunders : collection of str
        Ids of independent points that contradict all others; they stay out.

    Returns
    -------
    Fit or None
        None where there is no further point, and where the fit has a pole or is not determined.
    """
    control = chosen.fit.control
    more = points.take([role in ASSIGNABLE and name not in blunders
                        for name, role in zip(points.ids, points.roles, strict=True)])
    every = merged(control.with_(points=more))
    if len(every) == len(control):
        return None
    scaling = scaling_of(every)
    try:
        if chosen.candidate.kind == "selected":
            used = np.ones(len(every), dtype=bool)
            found = LEAST_SQUARES.fit(chosen.fit.model, every, scaling, chosen.fit.terms, used)
        else:
            found = chosen.candidate.fit_control(every, heights, scaling)
    except Undetermined:
        return None
    return found if found.determined and not has_pole(found) else None
