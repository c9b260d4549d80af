"""The final fit: the structure that was chosen, fitted to all points, independent ones included."""

from __future__ import annotations

from collections.abc import Collection

from termsel.candidates.base import Judged, has_pole
from termsel.candidates.portfolio import Portfolio
from termsel.fits.fit import Fit
from termsel.measurements.control import Control
from termsel.measurements.features import Points
from termsel.measurements.roles import ASSIGNABLE
from termsel.measurements.twins import merged


def final_fit(chosen: Judged, points: Points, heights: bool, portfolio: Portfolio,
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
        Whether models with heights are fitted.
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
    final = portfolio.ask(chosen.candidate, "refit", chosen.fit, Control.of(every, heights))
    return final if final is not None and final.determined and not has_pole(final) else None
