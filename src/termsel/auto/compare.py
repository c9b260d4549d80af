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
        The automatic choice for control and check.
    blunders : int
        How many features the choice leaves out as blunders.
    refused : mapping of str to str
        Why fits that are determined are not judged, by the name of the method.
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
        """Return the figures of all rows for these observations, in the order of the rows.

        A method that the features do not determine has its number of terms and no figures.
        """
        result = []
        for name, fitted, predicted in self.rows:
            # A number of terms stands for a fit that the features do not determine.
            if isinstance(fitted, int):
                no_figures = dict.fromkeys(("control", "check", "independent"))
                baseline = Baseline(name, fitted, BOTH, False, no_figures)
            else:
                baseline = baseline_figures(name, fitted, predicted, observations,
                                            refused=self.refused.get(name, ""))
            result.append(baseline)
        return tuple(result)


def compare(observations: Observations, auto: Auto, choice: Choice | None = None) -> Comparison:
    """Return the comparison of methods, each fitted to control and check points together.

    Methods without a search need no check points, so that these serve as control.

    Parameters
    ----------
    observations : Observations
        The features by role.
    auto : Auto
        The methods.
    choice : Choice, optional
        The choice of `auto` for control and check; by default it is made here. All methods are
        fitted to the same features as its fit, such as the points alone.

    Returns
    -------
    Comparison
        Its rows are in the order of the methods. Rational models that were refused for a pole are
        among them, with the reason.
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
        # A method that is not tried on so many points has no errors to be shown.
        if name not in fits and len(data) > method.max_features:
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
        # A size in place of a fit says that there are too few points for the method.
        elif np.isfinite(size) and not method.for_few:
            rows.append((name, int(size), None))
    return Comparison(tuple(rows), choice.method.name if choice else "", choice,
                      refused={name: reason for name, reason in refused.items() if reason})


def compare_robustly(observations: Observations, auto: Auto,
                     blunders: Collection[str]) -> Comparison:
    """Return the comparison of `compare` with fits added that blunders do not spoil.

    These are M-estimators, and the method that is chosen without the blunders, whose ids are given.
    That method is the reference where it can be chosen.
    """
    data = observations.pool
    comparison = compare(observations, auto)
    rows = list(comparison.rows)
    for method in ROBUST:
        fitted = auto.ask(method, "fit", data) if method.model(data.heights) else None
        if fitted is not None and fitted.adjustment.redundancy >= 1:
            rows.append((method.name, fitted, None))
    # By id: the pool is in another order than the control.
    is_blunder = np.isin(data.features.ids, list(blunders))
    choice = auto.choose(data.take(~is_blunder)) if is_blunder.any() else None
    if choice is None:
        return replace(comparison, rows=tuple(rows))
    chosen = choice.chosen
    return Comparison((*rows, (WITHOUT_BLUNDERS, chosen, chosen.held_out_rmse)),
                      WITHOUT_BLUNDERS, choice, int(is_blunder.sum()), comparison.refused)
