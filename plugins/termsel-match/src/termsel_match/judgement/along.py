"""How a correction changes along the lines of an image: smoothly, or at one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel import FeatureSet, Fit, Points
from termsel_match.judgement.selection import SelectedCandidates
from termsel_match.judgement.structures import ModelCorrection

_STEP_LINES = 32
"""Number of lines, evenly spaced over the image, at which a step is looked for."""

_MIN_CANDIDATES = 3
"""Fewest candidates on either side of a line between which a step is measured."""

_JITTER = 0.125
"""RMS change along the lines, divided by the accepted error, that is worth a remark."""

_SEAM = 0.25
"""Step at one line, divided by the accepted error, that is worth a remark. The step of a seam is
about four times the RMS change that it makes."""

_WIDEST = 0.25
"""Largest stretch of lines on either side of a step, as a share of the image's lines."""


@dataclass(frozen=True)
class Along:
    """How much a correction that is smooth along the lines differs from a drift.

    Parameters
    ----------
    size : float
        RMS difference at the candidates that agree [px].
    line : float
        Line of the image at which the difference changes most [px].
    away : tuple of float
        Change of the difference at that line, in line and sample [px].
    """

    size: float = 0.0
    line: float = 0.0
    away: tuple[float, float] = (0.0, 0.0)

    def matters(self, accept: float) -> bool:
        """Return whether the change is worth a remark where an error [px] is accepted."""
        return self.size > _JITTER * accept or float(np.hypot(*self.away)) > _SEAM * accept


def steady_model(selected: SelectedCandidates) -> Fit:
    """Return a model that stays close to the candidates' beyond them, fitted to those that agree.

    It is a drift of the RPC if the selected model is smooth along the lines, as such a correction
    may take any value beyond the candidates; else it is the selected model itself.
    """
    correction = selected.correction
    if correction.model != "rpc-jitter":
        return selected.result.fit
    agree = selected.points.take(selected.agrees)
    return ModelCorrection("rpc-drift", {"rpc": correction.options["rpc"]}).fit(
        FeatureSet(agree, crs=selected.result.features.crs))


def drift_along(selected: SelectedCandidates, agree: Points, lines: int) -> Along:
    """Return how the correction of a model differs from a drift, and where it changes most.

    A correction that is smooth along the lines follows a seam of the reference as it follows
    jitter, and leaves no residuals there. So the correction itself is examined.

    Parameters
    ----------
    selected : SelectedCandidates
        The model; of one that is not smooth along the lines all figures are 0.
    agree : Points
        Candidates that agree with it.
    lines : int
        Number of lines of the image.
    """
    correction = selected.correction
    if correction.model != "rpc-jitter":
        return Along()
    drift = steady_model(selected).project(agree.ground)
    away = selected.result.project(agree.ground) - drift
    line = agree.image[:, 0]
    # A step is the difference of the means over two stretches of lines, before and after it. They
    # are at most as long as an interval of the correction.
    wide = lines * min(_WIDEST, 1 / correction.options["intervals"])
    largest_at = 0.0
    step = np.zeros(2)
    for at_line in np.linspace(0, lines, _STEP_LINES):
        before, after = ((line > low) & (line <= low + wide) for low in (at_line - wide, at_line))
        if min(before.sum(), after.sum()) >= _MIN_CANDIDATES:
            change = away[after].mean(axis=0) - away[before].mean(axis=0)
            if np.linalg.norm(change) > np.linalg.norm(step):
                largest_at = float(at_line)
                step = change
    return Along(float(np.sqrt((away**2).sum(axis=1).mean())), largest_at,
                 (float(step[0]), float(step[1])))
