"""What every method must do."""

from __future__ import annotations

import numbers
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from termsel.auto.rule import validated
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit, HeldOut, Undetermined
from termsel.fitting.method import Method
from termsel.testing.cases import Case, Suite, check_declaration, require, through_pickle
from termsel.testing.scenes import seeded_generator

NOISE = 0.3
"""Standard deviation of the image coordinates of the points that are made up [px]."""

AGREE = 1.5
"""Ratio by which the RMSE of leave-one-out may differ from that of fits without each point: scaling
and folds may differ a little."""

HELD_OUT = 12
"""Points that are held out one by one."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A method with the features to fit it to."""

    method: Method
    features: tuple[FeatureSet, ...]

    def controls(self) -> list[FitData]:
        """Return the features that it does not decline."""
        controls = [FitData.of(features) for features in self.features]
        # None is no reason: it takes the features.
        return [control for control in controls if self.method.declines(control) is None]

    def fits(self) -> list[tuple[FitData, Fit]]:
        """Return the controls that determine the method, each with the fit to it.

        Raises AssertionError if none does.
        """
        fitted = []
        # A method may accept features, and find only in the fit that they do not determine it.
        for control in self.controls():
            try:
                fitted.append((control, self.method.fit(control)))
            except Undetermined:
                continue
        require(fitted, "it declines all features it is checked with, or is determined by none; "
                "give some that it is for: checks(candidate, features=[...])")
        return fitted


def declaration(subject: Subject) -> None:
    """It has a name, a title in words, and names what it contains."""
    candidate = subject.method
    check_declaration("methods", candidate)
    # The title is used in sentences: "It fits a cubic polynomial."
    require(candidate.title.split(" ", 1)[0] in ("a", "an", "the"),
            f"its title is {candidate.title!r}; begin it with an article, as in "
            "\"a cubic polynomial\"")
    require(isinstance(candidate.max_features, numbers.Real) and candidate.max_features > 0,
            f"max_features is {candidate.max_features!r}; expected a number of features above 0")
    # A choice fits what a method contains and needs before the method: it would wait for itself.
    require(candidate.name not in (*candidate.contains, *candidate.needs),
            "it contains or needs itself")


def declines(subject: Subject) -> None:
    """What it is not for is said in words, and quickly."""
    for features in subject.features:
        reason = subject.method.declines(FitData.of(features))
        require(reason is None or (isinstance(reason, str) and reason.strip()),
                f"declines() returned {reason!r}; expected None, or a sentence")


def nearly(subject: Subject) -> None:
    """It says whether parts of features may support it."""
    for control in subject.controls():
        answer = subject.method.nearly(control)
        require(isinstance(answer, bool | np.bool_),
                f"nearly() returned {answer!r}; expected a bool")


def fits(subject: Subject) -> None:
    """It returns a Fit to the very features it is given, which predicts finite places there."""
    for control, fitted in subject.fits():
        require(isinstance(fitted, Fit), f"fit() returned {type(fitted).__name__}, no Fit")
        require(isinstance(getattr(fitted.estimator, "name", None), str),
                "its estimator has no name, by which a stored result is read again")
        # Blunders are left out before a method is fitted: it may leave out no feature itself.
        require(fitted.control.ids == control.features.ids,
                "the fit has other control features than fit() was given")
        image = fitted.project(control.features.ground_vertices())
        require(np.isfinite(image).all(), "the fit predicts places that are not finite")


def holds_out(subject: Subject) -> None:
    """It gives the squared error of each feature under the same procedure without it.

    A choice among methods trusts these errors. They are compared with real refits without each of a
    few features, and only figures that are too good are refused.
    """
    for control, _ in subject.fits():
        # A method that has no errors of its own is refitted without each feature.
        fitted = validated(subject.method, control)
        if fitted is None:
            continue
        held_out = fitted.held_out()
        require(isinstance(held_out, HeldOut),
                f"held_out() returned {type(held_out).__name__}; expected HeldOut")
        squares = held_out.squares
        require(squares.shape == (len(control),) and (squares >= 0).all(),
                f"held_out() gives squares of shape {squares.shape}; expected "
                f"({len(control)},), none below 0")
        # Refits take long with many features, and the error of a line is not that of a point.
        if len(control.features.lines) or len(control) > 2 * HELD_OUT:
            continue
        errors = _held_out_squares(subject.method, control)
        if errors is None:
            continue
        stated = float(np.sqrt(np.mean(squares[:len(errors)])))
        repeated = float(np.sqrt(np.mean(errors)))
        # A figure that is too large makes nobody trust the method more than it deserves.
        require(stated > repeated / AGREE,
                f"held_out() says an RMSE of {stated:.3g} px, and fits without each point give "
                f"{repeated:.3g} px: what is chosen by it would be too good to be true")


def repeats(subject: Subject) -> None:
    """The same features give the same fit again, in another process too."""
    for control, fitted in subject.fits():
        for copy in (subject.method, through_pickle(subject.method)):
            # To the last bit, as the same operations are done in the same order.
            refit = copy.fit(control)
            require(np.array_equal(refit.adjustment.coefficients, fitted.adjustment.coefficients),
                    "fit() of the same features differs from one call or process to the "
                    "next")


def describes(subject: Subject) -> None:
    """It says in one sentence why it is supported, and what it leaves out, or nothing."""
    for _, fitted in subject.fits():
        for hook in ("describe", "doubt"):
            text = getattr(subject.method, hook)(fitted)
            require(isinstance(text, str) and "\n" not in text and (not text or text.endswith(".")),
                    f"{hook}() returned {text!r}; expected one sentence with a full stop, or \"\"")


def refits(subject: Subject) -> None:
    """The final fit takes all features it is given."""
    for control, fitted in subject.fits():
        final = subject.method.refit(fitted, control)
        require(final.control.ids == control.features.ids,
                "the final fit has other control features than refit() was given")


def cases(method: Method, features: Iterable[FeatureSet] | None = None) -> list[Case]:
    """Return a method with features: those given, or points of several kinds."""
    feature_sets = tuple(_feature_kinds() if features is None else features)
    return [Case(method.name, lambda: Subject(method, feature_sets))]


SUITE = Suite((declaration, declines, nearly, fits, holds_out, repeats, describes, refits), cases)


def _held_out_squares(method: Method, control: FitData) -> np.ndarray | None:
    """Return the squared errors of the first points, each under the fit without it.

    These are HELD_OUT points, or all of fewer. Returns None if the method is not determined without
    one of them.
    """
    points = control.features.points
    squares = []
    for left_out in range(min(HELD_OUT, len(points))):
        is_used = np.arange(len(points)) != left_out
        remaining = replace(control, features=control.features.take(is_used))
        try:
            fitted = method.fit(remaining)
        except Undetermined:
            return None
        squares.append(float((fitted.errors(points.take(~is_used)) ** 2).sum()))
    return np.array(squares)


def _feature_kinds() -> list[FeatureSet]:
    """Return points with and without heights: few, some, many, and many with local deformation."""
    rng = seeded_generator()
    sets = []
    for n, heights, bend in ((2, False, 0.0), (6, False, 0.0), (6, True, 0.0), (20, False, 0.0),
                             (20, True, 0.0), (80, True, 0.0), (80, False, 0.0), (80, False, 1.0),
                             (80, True, 1.0)):
        x, y, z = ground = rng.uniform(-1.0, 1.0, (3, n))
        # Local deformation [px], which no polynomial of low degree follows.
        wave = bend * 20.0 * np.array([np.sin(6 * x) * np.cos(5 * y), np.cos(7 * x + 3 * y)])
        # A slightly curved view with relief, seen from above: lines count downwards.
        image = np.array([-2000 * y + 30 * x * y + 90 * heights * z,
                          2000 * x + 20 * x * x - 60 * heights * z]) + wave
        # Metres, with relief of 300 m, or no heights at all.
        positions = ground * [[10_000.0], [10_000.0], [300.0 if heights else np.nan]]
        sets.append(FeatureSet(Points(tuple(f"P{i + 1}" for i in range(n)),
                                      image.T + rng.normal(0.0, NOISE, (n, 2)), positions.T)))
    return sets
