"""Term selections as columns of least-squares systems whose subsets can be enumerated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.rounding import ROUNDING, by_size
from termsel.enumeration.columns.system import SubsetSystem
from termsel.errors import TermselError
from termsel.measurements.features import (
    BoolArray,
    FeatureSet,
    FloatArray,
    IntArray,
    Points,
    no_lines,
)
from termsel.models.base import LINE, SAMPLE
from termsel.models.quotient import RationalModel
from termsel.problems.base import EnumerablePart
from termsel.problems.genome import Genome

if TYPE_CHECKING:
    from termsel.problems.base import Inputs


def enumerable_parts(inputs: Inputs, equations: Equations, genome: Genome,
                     gene_of_term: IntArray, guard: FloatArray, margin: float,
                     pairs: tuple[IntArray, IntArray] | None,
                     ) -> tuple[EnumerablePart, ...]:
    """Return the parts of a term selection from control points, by the equations of the control.

    The genome is of terms alone.
    Denominators must reach the margin at the scaled ground points of the guard (g, 3). Pairs are of
    terms, and for each a parent that must be selected with it. Raises TermselError if the axes are
    coupled, or criterion or model do not allow an enumeration.
    """
    model, criterion = inputs.model, inputs.criterion
    if not isinstance(model, RationalModel):
        raise _not_enumerable(f"model {model.name!r} is not a RationalModel")
    if model.weighted:
        raise _not_enumerable("weighted=true gives each selection equations of its own")
    if not criterion.subset_score:
        raise _not_enumerable(f"criterion {criterion.name!r} is no sum over check or control rows")
    axis = model.axis
    if (row_axes(equations.A, axis) == 2).any() or (axis == 2).any():
        raise _not_enumerable("lines or a shared denominator couple the axes")
    if equations.prior is not None:
        raise _not_enumerable(f"model {model.name!r} has pseudo-observations, which are no rows "
                              "of the control (--set ridge=0 removes them)")
    _refuse_other_errors(inputs)
    parents = np.zeros((len(axis), len(axis)), dtype=bool)
    if pairs is not None:
        parents[pairs] = True
    sides = [_side(model, inputs, equations, side, guard, margin, parents if pairs else None)
             for side in (LINE, SAMPLE)]
    genes = [gene_of_term[axis == side] for side in (LINE, SAMPLE)]
    # A shared mask is one system with two right-hand sides, if their columns are the same.
    if len(genome.segments) == 1:
        sides, genes = [_merge(sides, genes)], genes[:1]
    # One row a point and axis, so that the rows of a fold are its points.
    folds = criterion.subset_folds(inputs.control.points)
    # Leave-one-out of points some of which are held out together is of folds too.
    score = "kfold" if folds else criterion.subset_score
    parts = []
    for side, where in zip(sides, genes, strict=True):
        order = np.argsort(where)  # columns in the order of the genes
        system = _ordered(side, order, genome, where[order])
        cost = partial(criterion.subset_cost, system=system)
        if criterion.is_rmse:
            judged = (sum(map(len, folds)) if score == "kfold" else
                      len(inputs.check) if score == "check" else len(system.design))
            cost = partial(_cost_by_size, cost=cost, rounding=judged * ROUNDING**2 / len(sides),
                           share=len(sides) / genome.size)
        parts.append(EnumerablePart(where[order], system, score, cost, folds, inputs.pixels))
    return tuple(parts)


def _cost_by_size(scores: FloatArray, cost: Callable[[FloatArray], FloatArray], rounding: float,
                  share: float) -> FloatArray:
    """Return the cost of the best score of each size, shape (k + 1,).

    Scores up to `rounding` count by their size, each term as a share, as where `SelectionProblem`
    evaluates them: there roots of sums over the parts are judged.
    """
    return cost(by_size(scores, rounding, share * np.arange(len(scores), dtype=np.float64)))


def _refuse_other_errors(inputs: Inputs) -> None:
    """Refuse scores of control rows where a row's error is not that of its point [px]."""
    name, points = inputs.criterion.name, inputs.control.points
    if inputs.criterion.subset_score not in ("press", "kfold"):
        return
    if points.sigma is not None and np.ptp(points.sigma) > 0:
        raise _not_enumerable(f"standard deviations weight the rows, but {name!r} is in px")
    if inputs.model.corrects:
        raise _not_enumerable(f"model {inputs.model.name!r} corrects its predictions by the "
                              f"control; {name!r} would need a correction for every fold")


def _not_enumerable(why: str) -> TermselError:
    return TermselError(f"this solver needs one linear system per axis: {why}",
                        hint="Choose another solver, such as --solver ga or --solver swap.")


def _side(model: RationalModel, inputs: Inputs, equations: Equations, side: int,
          guard: FloatArray, margin: float, parents: BoolArray | None) -> SubsetSystem:
    """Return the system of one axis with the errors at the check points."""
    points, axis = inputs.control.points, model.axis
    control = equations.take(row_axes(equations.A, axis) == side, axis == side)
    system = SubsetSystem(
        control.A, control.b[:, None], denominator=_below(model, points.ground, side),
        guard_denominator=_below(model, guard, side), margin=margin,
        some_of=np.ones(control.A.shape[1], dtype=bool),
        parents=None if parents is None else parents[np.ix_(axis == side, axis == side)])
    return _with_check(system, model, inputs, side) if inputs.criterion.needs_check else system


def _with_check(system: SubsetSystem, model: RationalModel, inputs: Inputs,
                side: int) -> SubsetSystem:
    """Return the system with the rows of the check points."""
    check, points = inputs.check, inputs.control.points
    judged = _axis_of_points(model, check, side)
    weights = model.residual_weights(points.ground, check.ground)
    A, b = judged.A, judged.b
    if weights is None and model.corrects:
        raise _not_enumerable(f"the second step of model {model.name!r} is not linear in its terms")
    if weights is not None:
        # The correction is linear in the residuals of the control, hence in the unknowns.
        of_control = _axis_of_points(model, points, side)
        A, b = A - weights @ of_control.A, b - weights @ of_control.b
    return replace(system, check_design=A, check_target=b[:, None],
                   check_denominator=_below(model, check.ground, side))


def _axis_of_points(model: RationalModel, points: Points, side: int) -> Equations:
    """Return the unweighted equations of points for one axis."""
    bare = FeatureSet(Points(points.ids, points.image, points.ground), no_lines())
    rows = model.equations(bare)
    return rows.take(np.arange(len(rows.b)) % 2 == side, model.axis == side)


def _below(model: RationalModel, ground: FloatArray, side: int) -> FloatArray | None:
    """Return the linear form of one axis' denominator at ground points, shape (n, columns)."""
    one_each = np.eye(len(model.terms))[model.axis == side]
    below = model.denominators(one_each, ground)
    return None if below is None else np.ascontiguousarray(below[..., side].T - 1.0)


def _merge(sides: list[SubsetSystem], genes: list[IntArray]) -> SubsetSystem:
    """Return line and sample as two right-hand sides of one system."""
    line, sample = sides
    alike = (np.array_equal(genes[0], genes[1]) and line.denominator is None
             and np.array_equal(line.design, sample.design))
    if not alike:
        raise _not_enumerable("with a shared mask, line and sample must have the same "
                              "columns and no denominators; use --set mask=per-axis")
    check_target = (None if line.check_target is None or sample.check_target is None
                    else np.concatenate([line.check_target, sample.check_target], axis=1))
    return SubsetSystem(
        line.design, np.concatenate([line.target, sample.target], axis=1), line.check_design,
        check_target, some_of=line.some_of, parents=line.parents)


def _ordered(system: SubsetSystem, order: IntArray, genome: Genome,
             genes: IntArray) -> SubsetSystem:
    """Return the system with its columns in order, and with the genome's forced genes."""
    by_column = ("design", "check_design", "denominator", "check_denominator", "guard_denominator")
    columns: dict[str, Any] = {name: np.ascontiguousarray(array[:, order]) for name in by_column
                               if (array := getattr(system, name)) is not None}
    return replace(system, **columns, forced=genome.on[genes], forbidden=genome.off[genes],
                   parents=None if system.parents is None else system.parents[np.ix_(order, order)])
