"""Selections of features as rows of least-squares systems that can be walked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from termsel.adjustment.leave_out import IndependentPart
from termsel.data.features import BoolArray, FloatArray
from termsel.selection.best_subsets.features.walk import RowSystem
from termsel.selection.criteria.base import CheckRmse
from termsel.selection.problems.constraints import largest_term_share

if TYPE_CHECKING:
    from termsel.selection.problems.base import ProblemData


def row_systems(inputs: ProblemData, independent: tuple[IndependentPart, ...], terms: BoolArray,
                share: float, freedom: int) -> tuple[RowSystem, ...]:
    """Return the systems of rows, in px, by which a selection of features is scored.

    `independent` are the parts of the control's equations, with all k terms of the model, of which
    the mask `terms` (k,) are in use; `share` and `freedom` are those of `largest_term_share`. No
    system is returned where no rows say what a selection scores.
    """
    # A walk scores by the selection RMSE, of image positions that are linear in the terms.
    if type(inputs.criterion).score is not CheckRmse.score:
        return ()
    linear = _linearised_selection_points(inputs)
    if linear is None:
        return ()
    constant, columns = linear
    target = inputs.check.image.ravel() - constant
    systems = []
    explained = np.zeros(len(target), dtype=bool)
    # A part is adjusted by itself, and its rows of the selection points add to the squared errors.
    for system in independent:
        columns_in_use = np.flatnonzero(system.columns & terms)
        A, b = system.equations.with_prior()
        # Rows of selection points that the part's terms move: of line, of sample, or of both.
        rows = (columns[:, system.columns] != 0).any(axis=1)
        explained |= rows
        feature = np.full(len(b), -1, dtype=np.intp)  # of pseudo-observations
        feature[:len(system.equations.feature)] = system.equations.feature
        systems.append(RowSystem(A[:, terms[system.columns]], b, feature,
                                 inputs.pixels * columns[np.ix_(rows, columns_in_use)],
                                 inputs.pixels * target[rows],
                                 _fewest_rows(len(columns_in_use), len(b), share, freedom)))
    # The walk works in units of the selection points' errors: these must determine the terms.
    determined = explained.all() and all(row_system.determined for row_system in systems)
    return tuple(systems) if determined else ()


def _fewest_rows(terms: int, rows: int, share: float, freedom: int) -> int:
    """Return the fewest equations, up to `rows`, that support a number of terms; else rows + 1."""
    # The number of supported terms rises with the rows: the first that is enough.
    supported = largest_term_share(np.arange(rows + 1), share, freedom)
    return int(np.searchsorted(supported, terms))


def _linearised_selection_points(inputs: ProblemData) -> tuple[FloatArray, FloatArray] | None:
    """Return the selection points' image positions for terms of 0, and their change by each term.

    Both are raveled, of shape (2 c,) and (2 c, k). Returns None where the positions are not linear
    in the terms.
    """
    model = inputs.model
    ground = inputs.check.ground
    k = len(model.terms)
    if not len(ground) or model.denominators(np.zeros((1, k)), ground) is not None:
        return None
    # A function that is linear in a random direction is linear, unless it is made to deceive.
    trial = np.random.default_rng(0).normal(size=k)
    image = model.project(np.concatenate([np.zeros((1, k)), np.eye(k), trial[None]]), ground)
    # Row 0 has the constants, rows 1 to k one term each, the last the random trial.
    image = image.reshape(k + 2, -1)
    constant = image[0]
    columns = (image[1:-1] - image[0]).T
    size = np.abs(image).max(initial=1.0)
    linear = np.isfinite(image).all() and np.allclose(image[-1], constant + columns @ trial, rtol=0,
                                                      atol=1e-9 * size)
    return (constant, columns) if linear else None
