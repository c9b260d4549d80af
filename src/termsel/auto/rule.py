"""The rule by which one of several methods is chosen, from their errors at held-out features.

Errors are compared by logarithms of their squares, lest a few great ones make everything uncertain:
see `termsel.auto.validated.gain_of`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import erf, sqrt

import numpy as np

from termsel.auto.validated import gain_of
from termsel.data.record.chances import t_quantile
from termsel.fitting.fit import Fit
from termsel.fitting.method import Method

BETTER = 1.0
"""Standard errors by which a method with a prior must be better than the one before it (the rule of
Breiman et al. 1984)."""

EXPECTED = 2.0
"""Standard errors by which a central projection must be better."""

CLEARLY = 3.0
"""Standard errors by which any other method that no prior contains must be better, since the best
of several is so partly by luck."""

LEAST = "It has the smallest leave-one-out RMSE."
"""Why a method is chosen where none has a prior."""

DEEP = 0.8
"""Distance of the nearest point by that of the middle, along the view, below which a view is
oblique: a map has none, and points of a photo from above are at about the same distance."""

Describe = Callable[[Fit], str | None]
"""Returns one sentence on why the features call for the method of a fit, if there is one."""


@dataclass(frozen=True, eq=False)
class Choice:
    """A method chosen from several: its fit, the fits it was compared with, and the reason.

    Parameters
    ----------
    chosen : Fit
        Its `method` is the one that is chosen.
    compared : tuple of Fit
        Of all methods that the features determine with redundancy.
    reason : str
        Why this one, in sentences with the figures that decided.
    """

    chosen: Fit
    compared: tuple[Fit, ...]
    reason: str

    @property
    def method(self) -> Method:
        """The method that is chosen."""
        return method_of(self.chosen)


def method_of(fitted: Fit) -> Method:
    """Return the method of a fit that was compared with others."""
    assert isinstance(fitted.method, Method)
    return fitted.method


def contained(method: Method, fits: Iterable[Fit]) -> bool:
    """Return whether the method of some fit has a prior, and this method as a limit."""
    return any(method_of(fitted).has_prior and method.name in method_of(fitted).contains
               for fitted in fits)


def best_of(fits: Iterable[Fit], describe: Describe = lambda _: None) -> Choice | None:
    """Return the choice among methods; None if there is none.

    Of methods with a prior, the first is to be beaten by the others by BETTER standard errors; what
    none of them contains by CLEARLY, a central projection by EXPECTED, or by BETTER where the
    points call for an oblique view. Of those that are so much better, and of the one to be beaten,
    the one with the smallest RMSE is chosen. Where none has a prior, the smallest RMSE decides.
    """
    compared = tuple(fits)
    priors = [fitted for fitted in compared if method_of(fitted).has_prior]
    if not priors:
        return Choice(min(compared, key=beyond_rounding), compared, LEAST) if compared else None
    base, reasons = base_of(priors)
    others = [fitted for fitted in compared if not (
        method_of(fitted).has_prior or contained(method_of(fitted), priors))]
    rivals = [base, *(other for other in others if gain(other, base) > required(other, base))]
    chosen = min(rivals, key=beyond_rounding)
    descriptions = [description for fitted in dict.fromkeys((chosen, base))
                    if (description := describe(fitted))]
    return Choice(chosen, compared,
                  _reason(chosen, base, [*descriptions, *reasons], others, compared))


def base_of(priors: Sequence[Fit]) -> tuple[Fit, list[str]]:
    """Return which fit with a prior is to be beaten, and what decided among them."""
    base = priors[0]
    reasons: list[str] = []
    for fitted in priors[1:]:
        method, held = method_of(fitted), method_of(base)
        if base_is_limit(held, method):
            base = fitted
            reasons = []
        elif not base_is_limit(method, held):
            # Leave-one-out says little of places beyond the points, where what is known holds, too.
            needed = _sure(base) if held.from_one > method.from_one else BETTER
            if needed < np.inf:
                reasons.append(
                    f"{_compared(fitted, base)}; it must be better by more than {needed:.2g}.")
            base = fitted if gain(fitted, base) > needed else base
    return base, reasons


def base_is_limit(method: Method, other: Method) -> bool:
    """Return whether another method has a method as one of its limits."""
    return method.name in other.contains


def required(fitted: Fit, base: Fit) -> float:
    """Return by how many standard errors a method that no prior contains must be better."""
    if method_of(base).from_one > method_of(fitted).from_one:
        return _sure(base)
    if not method_of(fitted).central:
        return CLEARLY
    # Few points measured roughly, as in a drawn bird's-eye view, hardly tell standard errors apart;
    # that they call for an oblique view, is evidence of its own.
    view = fitted.view
    return BETTER if view is not None and view.depth < DEEP else EXPECTED


def _sure(base: Fit) -> float:
    """Return by how many standard errors others must be better than one that knows more.

    It is CLEARLY where features are many. Few of them hardly tell the standard error, so that more
    of it is as sure (Student 1908). Two say nothing of it.
    """
    freedom = len(base.held_out().squares) - 1
    # The probability that a normal number stays within CLEARLY standard errors.
    probability = (1.0 + erf(CLEARLY / sqrt(2.0))) / 2.0
    return t_quantile(probability, freedom) if freedom > 1 else np.inf


def _reason(chosen: Fit, base: Fit, reasons: Sequence[str], others: Sequence[Fit],
            compared: Iterable[Fit]) -> str:
    """Return why a method is chosen, after what is said of those with a prior."""
    sentences = list(reasons)
    if others:
        nearest = chosen if chosen is not base else max(
            others, key=lambda fitted: gain(fitted, base))
        needed = required(nearest, base)
        smaller = (" and have a smaller RMSE"
                   if nearest is not chosen and gain(nearest, base) > needed else "")
        sentences.append(f"{_compared(nearest, base)}; it must be better by more than "
                         f"{needed:.2g}{smaller}.")
    if any("standard error" in sentence for sentence in sentences):
        sentences.append("Standard errors are those of logarithms of squared leave-one-out "
                         "errors.")
    best = method_of(min(compared, key=beyond_rounding))
    whole = next((method for fitted in compared if (method := method_of(fitted)).has_prior
                  and best.name in method.contains and not best.has_prior), None)
    if whole is not None:
        family = whole.family or f"{whole.title} and its like"
        sentences.append(f"{best.label} is a limit of {family}, which find it if the points "
                         "support it.")
    return " ".join(sentences) or LEAST


def _compared(fitted: Fit, other: Fit) -> str:
    """Return by how many standard errors a method is better or worse than another."""
    advantage = gain(fitted, other)
    return (f"{method_of(fitted).label} is {'better' if advantage > 0 else 'worse'} than "
            f"{method_of(other).label} by {standard_errors(advantage)}")


def standard_errors(gain_in_errors: float) -> str:
    """Return a number of standard errors in words."""
    number = f"{abs(gain_in_errors):.2g}"
    return f"{number} standard error" if number == "1" else f"{number} standard errors"


def beyond_rounding(fitted: Fit) -> float:
    """Return the RMSE of held-out features [px]; all that are rounding are equal.

    Then the first is taken.
    """
    return max(fitted.held_out_rmse, fitted.rounding)


def gain(fitted: Fit, other: Fit) -> float:
    """Return by how many standard errors the squared errors of a fit are smaller."""
    return gain_of(fitted.held_out().squares, other.held_out().squares, fitted.rounding)
