"""How a correction changes along the lines of an image: smoothly, or at one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel import FeatureSet, Fit, Points
from termsel_match.judgement.selection import SelectedCandidates
from termsel_match.judgement.structures import ModelCorrection

# Lines at which a step is looked for.
_STEP_LINES = 32
# Points on either side.
_MIN_CANDIDATES = 3
# Of the accepted error; a seam's step is about four times its RMS.
_JITTER, _SEAM = 0.125, 0.25
# Of the lines: what a step is between.
_WIDEST = 0.25


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
        return self.size > _JITTER * accept or float(np.hypot(*self.away)) > _SEAM * accept


def steady_model(selected: SelectedCandidates) -> Fit:
    """Return a model that stays near the candidates' beyond them.

    The drift, for a smooth correction.
    """
    correction = selected.correction
    if correction.model != "rpc-jitter":
        return selected.result.fit
    # Fitted again to the same candidates, with the drift alone.
    agree = selected.points.take(selected.agrees)
    return ModelCorrection("rpc-drift", {"rpc": correction.options["rpc"]}).fit(
        FeatureSet(agree, crs=selected.result.features.crs))


def drift_along(selected: SelectedCandidates, agree: Points, lines: int) -> Along:
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
    correction = selected.correction
    if correction.model != "rpc-jitter":
        return Along()
    drift = steady_model(selected).project(agree.ground)
    away = selected.result.project(agree.ground) - drift
    line = agree.image[:, 0]
    # A step is between two stretches of lines, as long as an interval of the correction at most.
    wide = lines * min(_WIDEST, 1 / correction.options["intervals"])
    largest_at = 0.0
    step = np.zeros(2)
    for at_line in np.linspace(0, lines, _STEP_LINES):
        before, after = ((line > low) & (line <= low + wide) for low in (at_line - wide, at_line))
        # On both sides there must be some candidates, of which the means are compared.
        if min(before.sum(), after.sum()) >= _MIN_CANDIDATES:
            change = away[after].mean(axis=0) - away[before].mean(axis=0)
            if np.linalg.norm(change) > np.linalg.norm(step):
                largest_at = float(at_line)
                step = change
    return Along(float(np.sqrt((away**2).sum(axis=1).mean())), largest_at,
                 (float(step[0]), float(step[1])))
