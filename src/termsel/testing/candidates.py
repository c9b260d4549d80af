"""What every candidate of the strategy auto must do."""

from __future__ import annotations

import numbers
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from termsel.auto.base import Candidate, Judged
from termsel.data.control import Control
from termsel.data.features import FeatureSet, Points
from termsel.fitting.fit import Fit, Undetermined
from termsel.testing.cases import Case, Suite, check_declaration, pickled, require
from termsel.testing.scenes import seeded

NOISE = 0.3
"""Standard deviation of the image coordinates of the points that are made up [px]."""

AGREE = 1.5
"""Ratio by which the RMSE of leave-one-out may differ from that of fits without each point: scaling
and folds may differ a little."""

HELD_OUT = 12
"""Points that are held out one by one."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A candidate with the features to fit it to."""

    candidate: Candidate
    features: tuple[FeatureSet, ...]

    def controls(self) -> list[Control]:
        """Return the features that it does not decline."""
        controls = [Control.of(features) for features in self.features]
        return [control for control in controls if self.candidate.declines(control) is None]

    def fits(self) -> list[tuple[Control, Fit]]:
        """Return the fits to all features that determine it."""
        made = []
        for control in self.controls():
            try:
                made.append((control, self.candidate.fit_control(control)))
            except Undetermined:
                continue
        require(made, "it declines all features it is checked with, or is determined by none; "
                      "give some that it is for: checks(candidate, features=[...])")
        return made


def declaration(subject: Subject) -> None:
    """It has a name, a title in words, and names what it contains."""
    one = subject.candidate
    check_declaration("candidates", one)
    require(one.title.split(" ", 1)[0] in ("a", "an", "the"),
            f"its title is {one.title!r}; begin it with an article, as in \"a cubic polynomial\"")
    require(isinstance(one.most, numbers.Real) and one.most > 0,
            f"most is {one.most!r}; expected a number of features above 0")
    require(one.name not in (*one.contains, *one.needs), "it contains or needs itself")


def declines(subject: Subject) -> None:
    """What it is not for is said in words, and quickly."""
    for features in subject.features:
        reason = subject.candidate.declines(Control.of(features))
        require(reason is None or (isinstance(reason, str) and reason.strip()),
                f"declines() returned {reason!r}; expected None, or a sentence")


def nearly(subject: Subject) -> None:
    """It says whether parts of features may call for it."""
    for control in subject.controls():
        said = subject.candidate.nearly(control)
        require(isinstance(said, bool | np.bool_), f"nearly() returned {said!r}; expected a bool")


def fits(subject: Subject) -> None:
    """It is fitted to the very features it is given, and predicts finite places there."""
    for control, fitted in subject.fits():
        require(isinstance(fitted, Fit), f"fit_control() returned {type(fitted).__name__}, no Fit")
        require(isinstance(getattr(fitted.estimator, "name", None), str),
                "its estimator has no name, by which a stored result is read again")
        require(fitted.control.ids == control.features.ids,
                "the fit has other control features than fit_control() was given")
        image = fitted.project(control.features.ground_vertices())
        require(np.isfinite(image).all(), "the fit predicts places that are not finite")


def judges(subject: Subject) -> None:
    """It gives the squared error of each feature under the same procedure without it."""
    for control, _ in subject.fits():
        judged = subject.candidate.judge(control)
        if judged is None:
            continue
        require(isinstance(judged, Judged),
                f"judge() returned {type(judged).__name__}; expected Judged, or None")
        require(judged.squares.shape == (len(control),) and (judged.squares >= 0).all(),
                f"judge() gives squares of shape {judged.squares.shape}; expected "
                f"({len(control)},), none below 0")
        if len(control.features.lines) or len(control) > 2 * HELD_OUT:
            continue
        errors = _held_out(subject.candidate, control)
        if errors is None:
            continue
        said = float(np.sqrt(np.mean(judged.squares[:len(errors)])))
        repeated = float(np.sqrt(np.mean(errors)))
        require(said > repeated / AGREE,
                f"judge() says an RMSE of {said:.3g} px, and fits without each point give "
                f"{repeated:.3g} px: what is chosen by it would be too good to be true")


def repeats(subject: Subject) -> None:
    """The same features give the same fit again, in another process too."""
    for control, fitted in subject.fits():
        for other in (subject.candidate, pickled(subject.candidate)):
            again = other.fit_control(control)
            require(np.array_equal(again.adjustment.coefficients, fitted.adjustment.coefficients),
                    "fit_control() of the same features differs from one call or process to the "
                    "next")


def describes(subject: Subject) -> None:
    """It says in one sentence why it is called for, or nothing."""
    for _, fitted in subject.fits():
        said = subject.candidate.describe(fitted)
        require(isinstance(said, str) and "\n" not in said and (not said or said.endswith(".")),
                f"describe() returned {said!r}; expected one sentence with a full stop, or \"\"")


def refits(subject: Subject) -> None:
    """The final fit takes all features it is given."""
    for control, fitted in subject.fits():
        final = subject.candidate.refit(fitted, control)
        require(final.control.ids == control.features.ids,
                "the final fit has other control features than refit() was given")


def cases(candidate: Candidate, features: Iterable[FeatureSet] | None = None) -> list[Case]:
    """Return a candidate with features: those given, or points of several kinds."""
    some = tuple(_features() if features is None else features)
    return [Case(candidate.name, lambda: Subject(candidate, some))]


SUITE = Suite((declaration, declines, nearly, fits, judges, repeats, describes, refits), cases)


def _held_out(candidate: Candidate, control: Control) -> np.ndarray | None:
    """Return squared errors of the first points under fits without them; None without a fit."""
    points = control.features.points
    squares = []
    for out in range(min(HELD_OUT, len(points))):
        others = np.arange(len(points)) != out
        part = replace(control, features=control.features.take(others))
        try:
            fitted = candidate.fit_control(part)
        except Undetermined:
            return None
        squares.append(float((fitted.errors(points.take(~others)) ** 2).sum()))
    return np.array(squares)


def _features() -> list[FeatureSet]:
    """Return points with and without heights: few, some, many, and many with local deformation."""
    rng = seeded()
    sets = []
    for n, heights, bend in ((2, False, 0.0), (6, False, 0.0), (6, True, 0.0), (20, False, 0.0),
                             (20, True, 0.0), (80, True, 0.0), (80, False, 0.0), (80, False, 1.0),
                             (80, True, 1.0)):
        x, y, z = ground = rng.uniform(-1.0, 1.0, (3, n))
        wave = bend * 20.0 * np.array([np.sin(6 * x) * np.cos(5 * y), np.cos(7 * x + 3 * y)])
        image = np.array([-2000 * y + 30 * x * y + 90 * heights * z,
                          2000 * x + 20 * x * x - 60 * heights * z]) + wave
        places = ground * [[10_000.0], [10_000.0], [300.0 if heights else np.nan]]
        sets.append(FeatureSet(Points(tuple(f"P{i + 1}" for i in range(n)),
                                      image.T + rng.normal(0.0, NOISE, (n, 2)), places.T)))
    return sets
