"""How a correction changes along the lines of an image: smoothly, or at one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel import FeatureSet, Fit, Points
from termsel_match.judgement.selection import Selected
from termsel_match.judgement.structures import Correction

_PLACES = 32  # lines at which a step is looked for
_FEWEST = 3  # points on either side
_SMOOTH, _STEP = 0.125, 0.25  # of the accepted error; a seam's step is about four times its RMS
_WIDEST = 0.25  # of the lines: what a step is between


@dataclass(frozen=True)
class Along:
    """By how much a smooth correction along the lines differs from a drift.

    Parameters
    ----------
    size : float
        RMS at the candidates that agree [px].
    line : float
        Where it changes most, in the image [px].
    away : tuple of float
        By how much it changes there, line and sample [px].
    """

    size: float = 0.0
    line: float = 0.0
    away: tuple[float, float] = (0.0, 0.0)

    def matters(self, accept: float) -> bool:
        """Return whether the change is worth a remark where an error [px] is accepted."""
        return self.size > _SMOOTH * accept or float(np.hypot(*self.away)) > _STEP * accept


def steady(selected: Selected) -> Fit:
    """Return a model that goes nowhere beyond the candidates: of a smooth correction, the drift."""
    chosen = selected.correction
    if chosen.model != "rpc-jitter":
        return selected.result.fit
    agree = selected.points.take(selected.agrees)
    return Correction("rpc-drift", {"rpc": chosen.options["rpc"]}).fit(
        FeatureSet(agree, crs=selected.result.features.crs))


def along(selected: Selected, agree: Points, lines: int) -> Along:
    """Return how the correction of a model differs from a drift, and where it changes most.

    A seam of the reference along the lines looks like jitter to a smooth correction, which
    follows it and leaves no residuals. So the correction itself is looked at.

    Parameters
    ----------
    selected : Selected
    agree : Points
        Candidates that agree.
    lines : int
        Of the image.
    """
    chosen = selected.correction
    if chosen.model != "rpc-jitter":
        return Along()
    drift = steady(selected).project(agree.ground)
    away = selected.result.project(agree.ground) - drift
    line = agree.image[:, 0]
    wide = lines * min(_WIDEST, 1 / chosen.options["intervals"])
    where = 0.0
    step = np.zeros(2)
    for place in np.linspace(0, lines, _PLACES):
        before, after = ((line > low) & (line <= low + wide) for low in (place - wide, place))
        if min(before.sum(), after.sum()) >= _FEWEST:
            change = away[after].mean(axis=0) - away[before].mean(axis=0)
            if np.linalg.norm(change) > np.linalg.norm(step):
                where = float(place)
                step = change
    return Along(float(np.sqrt((away**2).sum(axis=1).mean())), where,
                 (float(step[0]), float(step[1])))
