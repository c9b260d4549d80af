"""Criteria that predict control features from the others."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from termsel.adjustment.leave_out import leave_one_out, solve_parts
from termsel.core.options import COUNT, SEED, Option
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import FeatureSet, FloatArray, IntArray, Lines, Points, empty_lines
from termsel.data.roles import find_twins
from termsel.fitting.losses import LOSS, SQUARES, THRESHOLD
from termsel.fitting.population import Fits
from termsel.selection.criteria.base import Criterion

_SOLUTIONS = 1 << 22
"""Coefficients of leave-one-out solutions held at once: 32 MB."""


class _LeftOut(Criterion):
    """Base of criteria of the errors of control features that are held out."""

    needs_check = False
    in_px = True
    declared_options: ClassVar[tuple[Option, ...]] = (LOSS, THRESHOLD)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        if self.options["loss"] != SQUARES:  # no sum over rows, and no standard error
            self.is_rmse = False
            self.subset_score = ""

    def combined(self, fits: Fits, squares: FloatArray) -> FloatArray:
        """Return the RMSE, or the figure of another loss, of each individual, (p,) [px].

        `squares` (p, n) are the squared errors of each feature held out.
        """
        return fits.rmse(squares, self.options["loss"], self.options["threshold"])


class Press(_LeftOut):
    """RMSE of each control feature, predicted from all others [px]; needs no selection points.

    A feature is held out with all its rows (leave-one-out), and twins together. Its squared error
    is the true image error under that solution, with the denominator of that solution. A selection
    in which some feature is indispensable has no figure. If features are selected too, only those
    in use count, so that a search can drop difficult ones.

    References
    ----------
    Allen 1974, Technometrics 16(1): the prediction sum of squares, here its root mean.
    """

    name = "press"
    subset_score = "press"

    def score(self, fits: Fits) -> FloatArray:
        """Return the RMSE of all features, each held out from the fit to all others [px], (p,).

        It is that of the predicted residual sum of squares of Allen (1974), in closed form. Twins
        are held out together, as one would predict the other. The RMSE is infinite where the
        features without some one of them do not determine the terms.
        """
        p, k = fits.terms.shape
        used = fits.in_use
        n = used.shape[1]
        squares = np.empty((p, n))
        groups = _groups_of_twins(fits.control, fits.lines)
        step = max(1, _SOLUTIONS // (n * k))
        # A solution for each feature and individual: as many individuals at once as memory allows.
        for start in range(0, p, step):
            batch = slice(start, start + step)
            solutions = np.zeros((n, *fits.terms[batch].shape))
            is_determined = np.ones(len(fits.terms[batch]), dtype=bool)
            for part in fits.parts:
                solutions[..., part.columns], is_part_determined = leave_one_out(
                    part.equations, fits.terms[batch, part.columns], used[batch])
                is_determined &= is_part_determined
            squares[batch] = np.where(is_determined[:, None], fits.held_out_each(solutions),
                                      np.inf)
        # Twins would predict each other: they are held out together, by solutions of their own.
        for group in groups:
            if len(group) > 1:
                squares[:, group] = _fold_errors(fits, group)
        return self.combined(fits, squares)

    def subset_folds(self, control: Points) -> tuple[IntArray, ...]:
        """Return each point with its twins, as indices; () without twins."""
        groups = _groups_of_twins(control, empty_lines())
        return groups if len(groups) < len(control) else ()


class KFold(_LeftOut):
    """RMSE of the control features of each fold, predicted from all other folds [px].

    All available control is assigned to the folds once, whatever features are selected. Folds
    that are blocks of the scene show how a model extrapolates over gaps in the control; random
    ones, like `press`, do not. Needs no selection points.

    References
    ----------
    Stone 1974, J. R. Stat. Soc. B 36(2); blocks: Roberts et al. 2017, Ecography 40(8).
    """

    name = "kfold"
    subset_score = "kfold"
    declared_options = (
        Option("folds", 5, "Folds of control features; with more folds than features each is held "
                           "out alone.", int, 2, COUNT),
        Option("repeats", 1, "How many times features are assigned to folds: again at random, or "
                             "in blocks along axes turned by parts of 90 degrees.", int, 1, 1000),
        Option("how", "spatial", "Folds as blocks of neighbours on the ground, or at random.",
               choices=("spatial", "random")),
        Option("fold_seed", 0, "Seed of random folds.", int, 0, SEED),
        LOSS, THRESHOLD,
    )

    def score(self, fits: Fits) -> FloatArray:
        """Return the RMSE of each individual, (p,) [px], over the folds of all repeats."""
        used = fits.in_use
        squares = np.zeros(used.shape)
        for fold in self.folds(fits.control, fits.lines):
            squares[:, fold] += _fold_errors(fits, fold)
        return self.combined(fits, squares / self.options["repeats"])

    def folds(self, points: Points, lines: Lines) -> tuple[IntArray, ...]:
        """Return the indices of the features of each fold, those of all repeats one after another.

        Features are counted points first, then lines. Twins, which are at one place, are in one
        fold. The position of a line is the mean of its ground vertices.
        """
        xy = np.concatenate([points.ground[:, :2],
                             lines.by_feature(lines.ground[:, :, :2].mean(axis=1))])
        rng = np.random.default_rng(self.options["fold_seed"])
        # Groups of twins are divided, each at the place of its first member.
        groups = _groups_of_twins(points, lines)
        xy = xy[[group[0] for group in groups]]
        repeats = self.options["repeats"]
        folds = min(self.options["folds"], len(xy))
        folds_of_features: list[IntArray] = []
        # Blocks along other axes each time, evenly over a quarter turn.
        for turn in np.arange(repeats) * np.pi / 2 / repeats:
            rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            order = (rng.permutation(len(xy)) if self.options["how"] == "random"
                     else spatial_order(xy @ rotation))
            for fold in np.array_split(order, folds):
                members = [groups[i] for i in fold]
                folds_of_features.append(np.sort(np.concatenate(members)))
        return tuple(folds_of_features)

    def subset_folds(self, control: Points) -> tuple[IntArray, ...]:
        """Return the folds of control points."""
        return self.folds(control, empty_lines())


def _fold_errors(fits: Fits, fold: IntArray) -> FloatArray:
    """Return the squared errors [px^2] of a fold (f,) predicted from all others, shape (p, f)."""
    # Features that are not in use stay out, whatever the fold.
    control_in_use = fits.in_use.copy()
    control_in_use[:, fold] = False
    coefficients, undetermined = solve_parts(fits.parts, fits.terms, control_in_use)
    return np.where(undetermined[:, None] == 0, fits.held_out(coefficients, fold), np.inf)


@lru_cache(maxsize=4)  # a search asks again and again
def _groups_of_twins(points: Points, lines: Lines) -> tuple[IntArray, ...]:
    """Return the indices of each group of twins, in the order of their first members.

    A feature without a twin is a group of its own, as is each line; points come before lines.
    """
    labels = find_twins(points.ground)
    n = len(FeatureSet(points, lines))
    labels = np.concatenate([labels, np.arange(len(labels), n)])
    # Groups are runs of equal labels.
    order = np.argsort(labels, kind="stable")
    return tuple(np.split(order, np.flatnonzero(np.diff(labels[order])) + 1))
