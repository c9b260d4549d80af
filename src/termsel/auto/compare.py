"""Fits without any search, with which every selection is compared."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from termsel.auto.base import Candidate, refusal
from termsel.auto.portfolio import Choice, Portfolio, choose
from termsel.auto.structures import ROBUST
from termsel.data.control import Control
from termsel.data.roles import Observations
from termsel.fitting.figures import BOTH, Baseline, baseline, finite_or_none
from termsel.fitting.fit import Fit
from termsel.models.quotient import RationalModel

WITHOUT_BLUNDERS = "without-blunders"
"""Name of the baseline that is chosen once blunders are left out."""


@dataclass(frozen=True, eq=False)
class Yardsticks:
    """What a selection is compared with."""

    # Name, fit and RMSE by leave-one-out [px] of each, fitted to control and check together; where
    # these do not determine it the number of its terms for the fit.
    fits: tuple[tuple[str, Fit | int, float | None], ...]
    # Name of the one that `choose` takes for control and check, without a look at the independent
    # points; empty if none is determined.
    reference: str
    choice: Choice | None  # that choice
    blunders: int = 0  # features that it does without
    refused: Mapping[str, str] = field(default_factory=dict)  # why, of fits that are determined

    @property
    def candidate(self) -> Candidate | None:
        """The candidate that is chosen."""
        return self.choice.chosen.candidate if self.choice else None

    def baselines(self, observations: Observations) -> tuple[Baseline, ...]:
        """Return the figures of all fits for some observations."""
        return tuple(
            Baseline(name, fitted, BOTH, False, dict.fromkeys(("control", "check", "independent")))
            if isinstance(fitted, int) else baseline(
                name, fitted, predicted, observations, refused=self.refused.get(name, ""))
            for name, fitted, predicted in self.fits)


def compare(observations: Observations, choice: Choice | None = None,
            portfolio: Portfolio | None = None) -> Yardsticks:
    """Return the candidates fitted to control and check together.

    No search is made with the check points there, so they are free to serve as control. A
    rational model that was refused, as it has a pole, is shown too, with the reason.

    `choice` is that of `choose` for control and check, twins merged, or of `choose_features`: all
    are then fitted to the features that it chooses. By default it is that of `choose`, from the
    built-in candidates.
    """
    portfolio = portfolio or Portfolio()
    both = observations.pool
    choice = choice or choose(both, portfolio)
    if choice and choice.chosen.fit.control is not both.features:
        both = Control.of(choice.chosen.fit.control, both.heights)
    fits: dict[str, tuple[Fit, float | None]] = {}
    if choice:
        fits = {one.name: (one.fit, finite_or_none(one.predicted)) for one in choice.judged}
    rows: list[tuple[str, Fit | int, float | None]] = []
    refused: dict[str, str] = {}
    for one in portfolio.candidates:
        if one in ROBUST or (one.name not in fits
                             and portfolio.ask(one, "declines", both) is not None):
            continue
        if one.name not in fits and not one.for_few and isinstance(
                portfolio.ask(one, "model", both.heights), RationalModel):
            fitted = portfolio.ask(one, "fit_control", both)
            if fitted is not None and (not fitted.estimator.least_squares
                                       or fitted.adjustment.redundancy > 0):
                fits[one.name] = fitted, None
                refused[one.name] = refusal(fitted)
        if one.name in fits:
            rows.append((one.name, *fits[one.name]))
        elif np.isfinite(size := portfolio.ask(one, "size", both.heights) or np.inf) \
                and not one.for_few:
            rows.append((one.name, int(size), None))
    return Yardsticks(tuple(rows), choice.chosen.name if choice else "", choice,
                      refused={name: why for name, why in refused.items() if why})


def compare_robustly(observations: Observations, blunders: Collection[str]) -> Yardsticks:
    """Return the built-in candidates, as `compare` does, and fits that blunders do not spoil.

    These are M-estimators, and the candidate that is chosen without the blunders. Where there are
    some, it is the reference.
    """
    both = observations.pool
    portfolio = Portfolio()
    yardsticks = compare(observations, portfolio=portfolio)
    fits = ((one.name, portfolio.ask(one, "fit_control", both)) for one in ROBUST
            if one.model(both.heights))
    rows = (*yardsticks.fits, *(
        (name, fitted, None) for name, fitted in fits
        if fitted is not None and fitted.adjustment.redundancy >= 1))
    out = np.isin(both.features.ids, list(blunders))
    choice = choose(both.take(~out), portfolio) if out.any() else None
    if choice is None:
        return replace(yardsticks, fits=rows)
    chosen = choice.chosen
    return Yardsticks((*rows, (WITHOUT_BLUNDERS, chosen.fit, chosen.predicted)),
                      WITHOUT_BLUNDERS, choice, int(out.sum()), yardsticks.refused)
