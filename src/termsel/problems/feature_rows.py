"""Selections of features as rows of least-squares systems that can be walked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from termsel.adjustment.parts import IndependentPart
from termsel.criteria.base import CheckRmse
from termsel.enumeration.features.walk import RowSystem
from termsel.measurements.features import BoolArray, FloatArray
from termsel.problems.constraints import most_terms

if TYPE_CHECKING:
    from termsel.problems.base import Inputs


def row_systems(inputs: Inputs, parts: tuple[IndependentPart, ...], terms: BoolArray, share: float,
                freedom: int) -> tuple[RowSystem, ...]:
    """Return the systems of a selection of features, in px; none where no selection can be scored.

    The parts are of the control, with all terms of the model, of which some are in use (k,); share
    and freedom are share and least of `most_terms`.
    """
    # A walk scores by the check RMSE, of image positions that are linear in the terms.
    if type(inputs.criterion).score is not CheckRmse.score:
        return ()
    linear = _linear(inputs)
    if linear is None:
        return ()
    constant, columns = linear
    target = inputs.check.image.ravel() - constant
    systems, explained = [], np.zeros(len(target), dtype=bool)
    for part in parts:
        chosen = np.flatnonzero(part.columns & terms)
        A, b = part.equations.held()
        rows = (columns[:, part.columns] != 0).any(axis=1)
        explained |= rows
        feature = np.full(len(b), -1, dtype=np.intp)  # of pseudo-observations
        feature[:len(part.equations.feature)] = part.equations.feature
        systems.append(RowSystem(A[:, terms[part.columns]], b, feature,
                                 inputs.pixels * columns[np.ix_(rows, chosen)],
                                 inputs.pixels * target[rows],
                                 _fewest_rows(len(chosen), len(b), share, freedom)))
    # The walk works in units of the check points' errors: these must determine the terms.
    good = explained.all() and all(one.determined for one in systems)
    return tuple(systems) if good else ()


def _fewest_rows(terms: int, rows: int, share: float, freedom: int) -> int:
    """Return how few equations support so many terms."""
    supported = most_terms(np.arange(rows + 1), share, freedom)
    return int(np.searchsorted(supported, terms))


def _linear(inputs: Inputs) -> tuple[FloatArray, FloatArray] | None:
    """Return the check points' image positions for terms of 0, and their change by each term.

    They are raveled, of shape (2 c,) and (2 c, k). None where they are not linear.
    """
    model, ground = inputs.model, inputs.check.ground
    k = len(model.terms)
    if not len(ground) or model.denominators(np.zeros((1, k)), ground) is not None:
        return None
    # A function that is linear in a random direction is linear, unless it is made to deceive.
    trial = np.random.default_rng(0).normal(size=k)
    image = model.project(np.concatenate([np.zeros((1, k)), np.eye(k), trial[None]]), ground)
    image = image.reshape(k + 2, -1)
    constant, columns = image[0], (image[1:-1] - image[0]).T
    size = np.abs(image).max(initial=1.0)
    linear = np.isfinite(image).all() and np.allclose(image[-1], constant + columns @ trial, rtol=0,
                                                      atol=1e-9 * size)
    return (constant, columns) if linear else None
