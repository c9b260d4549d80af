"""Fits without any search, with which every selection is compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from termsel.candidates.blunders import find_blunders, suspicious
from termsel.candidates.candidate import CANDIDATES, Candidate
from termsel.candidates.portfolio import Choice, choose
from termsel.candidates.relief import heights_hold
from termsel.fits.figures import BOTH, Baseline, baseline, finite_or_none
from termsel.fits.fit import Fit, Undetermined
from termsel.measurements.features import select
from termsel.measurements.roles import Observations, together
from termsel.measurements.scaling import scaling_of
from termsel.measurements.twins import merged
from termsel.models.rational import RationalFunctions

WITHOUT_BLUNDERS = "without-blunders"
"""Name of the baseline that is chosen once blunders are left out."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a selection is compared with.

    Parameters
    ----------
    baselines : tuple of Baseline
        Each fitted to control and check together.
    reference : str
        Name of the one that `choose` takes for control and check, without a look at
        the independent points; empty if none is determined.
    choice : Choice or None
        That choice.
    blunders : tuple of str
        Ids of features that it does without.
    """

    baselines: tuple[Baseline, ...]
    reference: str
    choice: Choice | None
    blunders: tuple[str, ...] = ()

    @property
    def candidate(self) -> Candidate | None:
        """The candidate that is chosen."""
        return self.choice.chosen.candidate if self.choice else None


def compare(observations: Observations, choice: Choice | None = None) -> Comparison:
    """Return the candidates fitted to control and check together.

    No search is made with the check points there, so they are free to serve as control. A
    rational model with a pole, which is not for the choice, is shown too, as its figures are
    worth seeing.

    Parameters
    ----------
    observations : Observations
    choice : Choice, optional
        That of `choose` for control and check, twins merged, or of `choose_features`: all are then
        fitted to the features that it chooses. By default that of `choose`.
    """
    both, heights = merged(together(observations)), has_heights(observations)
    choice = choice or choose(both, heights)
    both = choice.chosen.fit.control if choice else both
    scaling = scaling_of(both)
    found: dict[str, tuple[Fit, float | None]] = {}
    if choice:
        found = {one.name: (one.fit, finite_or_none(one.predicted)) for one in choice.judged}
    baselines = []
    for one in CANDIDATES:
        model = one.model(heights)
        if model is None or one.kind == "robust":
            continue
        if one.name not in found and isinstance(model, RationalFunctions):
            try:
                fitted = one.fit_control(both, heights, scaling)
            except Undetermined:
                pass
            else:
                if not fitted.estimator.least_squares or fitted.adjustment.redundancy > 0:
                    found[one.name] = fitted, None
        if one.name in found:
            baselines.append(baseline(one.name, *found[one.name], observations))
        elif one.kind not in ("selected", "shrunken", "local", "few"):
            baselines.append(Baseline(one.name, len(model.terms), BOTH, False, dict.fromkeys(
                ("control", "check", "independent"))))
    return Comparison(tuple(baselines), choice.chosen.name if choice else "", choice)


def compare_robustly(observations: Observations) -> Comparison:
    """Return the candidates of `compare`, and fits that blunders do not spoil.

    These are M-estimators, and the candidate that is chosen once blunders are left out. Where there
    are blunders, it is the reference.

    Parameters
    ----------
    observations : Observations
    """
    comparison = compare(observations)
    both, heights = merged(together(observations)), has_heights(observations)
    robust = []
    for one in CANDIDATES:
        if one.kind == "robust" and one.model(heights):
            try:
                fitted = one.fit_control(both, heights, scaling_of(both))
            except Undetermined:
                continue
            if fitted.adjustment.redundancy >= 1:
                robust.append(baseline(one.name, fitted, None, observations))
    comparison = replace(comparison, baselines=(*comparison.baselines, *robust))
    found = find_blunders(both, heights) if suspicious(both, heights) else None
    if found is None or not found.blunders.any():
        return comparison
    choice = choose(both.take(~found.blunders), heights)
    if choice is None:
        return comparison
    chosen = choice.chosen
    return Comparison((*comparison.baselines, baseline(
        WITHOUT_BLUNDERS, chosen.fit, chosen.predicted, observations)), WITHOUT_BLUNDERS, choice,
        select(both.ids, found.blunders))


def has_heights(observations: Observations) -> bool:
    """Return whether all features have heights that hold (see `heights_hold`).

    Of independent points only whether they have heights is looked at.
    """
    return not np.isnan(observations.independent.ground[:, 2]).any() \
        and heights_hold(together(observations))
