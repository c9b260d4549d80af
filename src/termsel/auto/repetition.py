"""The choice among candidates, repeated in folds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from termsel.auto.base import Judged
from termsel.auto.memory import remembered
from termsel.auto.portfolio import Choice, Portfolio, Watch, choose, choose_features
from termsel.data.control import Control, carriers
from termsel.data.coordinates.places import ground_centres, spatial_order
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.lattices import FEWEST as FEWEST_LINES
from termsel.data.lattices import Lattice, lattice_of
from termsel.fitting.adjustment.lines import row_weights
from termsel.fitting.fit import Fit

FOLDS_WITH_LINES = 10
"""Folds in which the whole choice is repeated where there are lines, which take longer."""

FOLDS = ((40, 20), (5000, 10), (50_000, 5), (np.inf, 2))
"""Folds for fewer points than a number: of many, nine tenths or four fifths predict all but as well
as all, and of very many a half."""

FOLDS_OF_LATTICE = 8
"""Folds of the lines of a lattice, and of its columns: of a radar image with ten, one each."""

MANY = 20
"""Points from which on folds do not try what all points together come nowhere near to choosing."""


def folds_of(control: FeatureSet) -> int:
    """Return in how many folds the whole choice is repeated."""
    if len(control.lines):
        return min(FOLDS_WITH_LINES, len(control))
    lattice = lattice_of(control.points)
    if lattice is not None:
        return _folds_along(lattice.lines) + _folds_along(lattice.columns)
    return next(min(folds, len(control)) for below, folds in FOLDS if len(control) < below)


def repeated(control: Control, portfolio: Portfolio | None = None,
             watch: Watch | None = None, choice: Choice | None = None) -> FloatArray | None:
    """Return the errors of features under choices made without them, (n_points + n_lines, 2) [px].

    In each fold, spread over the scene, the choice is made again, so that its errors are not those
    that it was made by. They are measured minus predicted: of a point its line and sample; of a
    line the distances of its two vertices, weighted by how well the image line is known there, so
    that they compare with two coordinates of a point. None if some fold leaves too little to choose
    by, or lines alone that are too few to shrink. `choice` is that from all features, if it is
    known.
    """
    portfolio = portfolio or Portfolio()
    seen = list[None]()
    folds = folds_of(control.features)

    def see(one: Judged | None) -> None:
        seen.append(None)
        if watch:
            watch(one)

    errors, judged = remembered(("repeated", folds), control, portfolio, lambda: (
        _errors(control, portfolio, see, folds, choice), len(seen)))
    for _ in range(judged - len(seen)):  # what was found before is told, too
        see(None)
    return errors


def _errors(control: Control, portfolio: Portfolio, watch: Watch, folds: int,
            choice: Choice | None) -> FloatArray | None:
    features = control.features
    order = spatial_order(ground_centres(features))
    count = len(features.points)
    owner = features.feature
    errors = np.empty((len(owner), 2))
    choose_without = _choosing_without(control, portfolio, watch, choice)
    for fold in range(folds):
        out = np.zeros(len(control), dtype=bool)
        out[order[fold::folds]] = True
        held = features.take(out)
        fitted = choose_without(out)
        if fitted is None:
            return None
        errors[:count][out[:count]] = fitted.errors(held.points)
        errors[count:][out[owner[count:]]] = np.linalg.norm(fitted.line_errors(held.lines), axis=2)
    if count < len(owner):
        errors[count:] *= row_weights(control.scaled, heights=control.heights)[
            2 * count:].reshape(-1, 2)
    errors.setflags(write=False)  # whoever asks again gets the same
    return errors


def _choosing_without(control: Control, portfolio: Portfolio, watch: Watch,
                      choice: Choice | None) -> Callable[[BoolArray], Fit | None]:
    """Return what makes the choice again without some features, and returns its fit if any."""
    features = control.features
    whole = cache(lambda: choose(control, portfolio, whole=False))
    many = len(features.points) >= MANY and not len(features.lines)
    parts = portfolio.for_parts_of(control, (choice or whole()) if many else None)
    least = portfolio.least(control)

    def chosen_without(out: BoolArray) -> Fit | None:
        rest = control.take(~out)
        # Relief that rests on one feature of the others tells nothing of those held out.
        flat = replace(rest, heights=rest.heights and not carriers(rest, limit=1))
        found = None if len(rest) < least else choose_features(flat, parts, watch, whole=False)
        fitted = found.chosen.fit if found else None
        if not found or not any(one.candidate.has_prior for one in found.judged):
            if not len(features.points):
                return None
            # Few features choose by luck: what all of them choose is fitted to these.
            if usual := whole():
                fitted = portfolio.ask(usual.chosen.candidate, "refit", usual.chosen.fit,
                                       rest) or fitted
        return fitted

    return chosen_without


def _held_out(count: int) -> tuple[int, int]:
    """Return the first and the last of so many lines that are left out."""
    edge = 2 if count > 2 * FEWEST_LINES else 1
    return edge, count - 1 - edge


def _folds_along(count: int) -> int:
    """Return in how many folds so many lines are left out."""
    first, last = _held_out(count)
    return min(FOLDS_OF_LATTICE, last - first + 1)


def between_lines(control: Control, lattice: Lattice, portfolio: Portfolio, watch: Watch,
                  choice: Choice) -> tuple[FloatArray, IntArray] | None:
    """Return errors of points of a lattice without their line, (m, 2) [px], and the lines, (m,).

    Or without their column, where that makes greater ones. The choice is made again without some
    lines, whose neighbours stay. The outermost ones always stay, as nothing is asked for beyond
    them, and so do those next to them where there are others: one line on a side is not enough to
    go on from. None if some part of the lattice leaves too little to choose by.
    """
    choose_without = _choosing_without(control, portfolio, watch, choice)
    found = []
    for number in (lattice.line, lattice.column):
        errors = np.full((len(control), 2), np.nan)
        first, last = _held_out(int(number.max()) + 1)
        inside = (number >= first) & (number <= last)
        for fold in range(_folds_along(int(number.max()) + 1)):
            out = inside & ((number - first) % FOLDS_OF_LATTICE == fold)
            fitted = choose_without(out)
            if fitted is None:
                return None
            errors[out] = fitted.errors(control.features.take(out).points)
        found.append((errors[inside], number[inside]))
    return max(found, key=lambda one: float((one[0]**2).sum(axis=1).mean()))
