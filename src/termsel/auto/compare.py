"""What a selection is compared with: methods that need no search, over the same features."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from termsel.auto.auto import Auto
from termsel.auto.methods import ROBUST
from termsel.auto.rule import Choice, method_of, refusal
from termsel.data.fit_data import FitData
from termsel.data.roles import Observations
from termsel.fitting.figures import BOTH, Baseline, baseline_figures, finite_or_none
from termsel.fitting.fit import Fit
from termsel.fitting.method import Method
from termsel.models.quotient import RationalModel

WITHOUT_BLUNDERS = "without-blunders"
"""Name of the baseline that is chosen once blunders are left out."""

Row = tuple[str, Fit | int, float | None]
"""Name, fit and RMSE by leave-one-out [px] of a method, fitted to control and check together; where
these do not determine it the number of its terms for the fit."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a selection is compared with.

    Parameters
    ----------
    rows : tuple of Row
    reference : str
        Name of the method that auto chooses for control and check, without a look at the
        independent points; empty if none is determined.
    choice : Choice or None
        That choice.
    blunders : int
        Features that it does without.
    refused : mapping of str to str
        Why, of fits that are determined.
    """

    rows: tuple[Row, ...]
    reference: str
    choice: Choice | None
    blunders: int = 0
    refused: Mapping[str, str] = field(default_factory=dict)

    @property
    def method(self) -> Method | None:
        """The method that is chosen; None without a choice."""
        return self.choice.method if self.choice else None

    def baselines(self, observations: Observations) -> tuple[Baseline, ...]:
        """Return the figures of all fits for some observations."""
        return tuple(
            Baseline(name, fitted, BOTH, False, dict.fromkeys(("control", "check", "independent")))
            if isinstance(fitted, int) else baseline_figures(
                name, fitted, predicted, observations, refused=self.refused.get(name, ""))
            for name, fitted, predicted in self.rows)


def compare(observations: Observations, auto: Auto, choice: Choice | None = None) -> Comparison:
    """Return the methods of a choice, each fitted to control and check points together.

    Methods without a search need no check points, so that these serve as control.

    Parameters
    ----------
    observations : Observations
        The features by role.
    auto : Auto
        The methods.
    choice : Choice, optional
        That of `auto` for control and check; all methods are fitted to the features that it is
        for, such as the points alone. It is made here by default.

    Returns
    -------
    Comparison
        With rational models that were refused for a pole, and the reason.
    """
    data = observations.pool
    choice = choice or auto.choose(data)
    # A choice may be over fewer features, such as the points alone: all are compared over those.
    if choice and choice.chosen.control is not data.features:
        data = FitData.of(choice.chosen.control, data.heights)
    fits: dict[str, tuple[Fit, float | None]] = {}
    if choice:
        fits = {method_of(fitted).name: (fitted, finite_or_none(fitted.held_out_rmse))
                for fitted in choice.compared}
    rows: list[Row] = []
    refused: dict[str, str] = {}
    for method in auto.methods:
        name = method.name
        # Robust fits are compared only where blunders are looked for.
        if method in ROBUST or (
                name not in fits and auto.ask(method, "declines", data) is not None):
            continue
        # A prior that so many points are not asked about has no errors to be shown.
        if method.has_prior and len(data) > method.max_features:
            continue
        model = auto.ask(method, "model", data.heights)
        # RFM are what the literature compares with: they are shown though the choice refused them.
        if name not in fits and not method.for_few and isinstance(model, RationalModel):
            fitted = auto.fit_of(method, data)
            if fitted is not None and (not fitted.estimator.least_squares
                                       or fitted.adjustment.redundancy > 0):
                fits[name] = fitted, None
                refused[name] = refusal(fitted)
        size = auto.ask(method, "size", data.heights) or np.inf
        if name in fits:
            rows.append((name, *fits[name]))
        # A row with its size says that there are too few points for it.
        elif np.isfinite(size) and not method.for_few:
            rows.append((name, int(size), None))
    return Comparison(tuple(rows), choice.method.name if choice else "", choice,
                      refused={name: reason for name, reason in refused.items() if reason})


def compare_robustly(observations: Observations, auto: Auto,
                     blunders: Collection[str]) -> Comparison:
    """Return the methods of a choice, as `compare` does, and fits that blunders do not spoil.

    These are M-estimators, and the method that is chosen without the blunders. Where there are
    some, it is the reference.
    """
    data = observations.pool
    comparison = compare(observations, auto)
    robust = ((method.name, auto.ask(method, "fit", data)) for method in ROBUST
              if method.model(data.heights))
    rows = (*comparison.rows, *(
        (name, fitted, None) for name, fitted in robust
        if fitted is not None and fitted.adjustment.redundancy >= 1))
    # By id: the pool is in another order than the control.
    is_blunder = np.isin(data.features.ids, list(blunders))
    choice = auto.choose(data.take(~is_blunder)) if is_blunder.any() else None
    if choice is None:
        return replace(comparison, rows=rows)
    chosen = choice.chosen
    return Comparison((*rows, (WITHOUT_BLUNDERS, chosen, chosen.held_out_rmse)),
                      WITHOUT_BLUNDERS, choice, int(is_blunder.sum()), comparison.refused)
