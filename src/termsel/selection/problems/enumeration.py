"""Term selections as columns of least-squares systems whose subsets can be enumerated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.solve import ROUNDING, replace_rounding_by_size
from termsel.core.errors import TermselError
from termsel.core.remedies import Remedy
from termsel.data.features import (
    BoolArray,
    FeatureSet,
    FloatArray,
    IntArray,
    Points,
    empty_lines,
)
from termsel.models.base import LINE, SAMPLE
from termsel.models.quotient import RationalModel
from termsel.selection.best_subsets.columns.system import SubsetSystem
from termsel.selection.problems.base import EnumerablePart
from termsel.selection.problems.genome import Genome

if TYPE_CHECKING:
    from termsel.selection.problems.base import ProblemData


def enumerable_parts(inputs: ProblemData, equations: Equations, genome: Genome,
                     gene_of_term: IntArray, guard: FloatArray, margin: float,
                     pairs: tuple[IntArray, IntArray] | None) -> tuple[EnumerablePart, ...]:
    """Return the parts of a term selection from control points, by the equations of the control.

    The genome is of terms alone. Denominators must reach the margin at the scaled ground points of
    the guard (g, 3). Pairs are of terms, and for each a parent that must be selected with it.
    Raises TermselError if the axes are coupled, or criterion or model do not allow an enumeration.
    """
    model = inputs.model
    criterion = inputs.criterion
    if not isinstance(model, RationalModel):
        raise _not_enumerable_error(f"model {model.name!r} is not a RationalModel")
    if model.weighted:
        raise _not_enumerable_error("weighted=true gives each selection equations of its own")
    if not criterion.subset_score:
        raise _not_enumerable_error(f"criterion {criterion.name!r} is no sum over check or "
                                    "control rows")
    axis = model.axis
    if (row_axes(equations.A, axis) == 2).any() or (axis == 2).any():
        raise _not_enumerable_error("lines or a shared denominator couple the axes")
    if equations.prior is not None:
        raise _not_enumerable_error(f"model {model.name!r} has pseudo-observations, which are no "
                                    "rows of the control (--set ridge=0 removes them)")
    _refuse_other_errors(inputs)
    # parents[i, j]: term i is selected only with term j.
    parents = np.zeros((len(axis), len(axis)), dtype=bool)
    if pairs is not None:
        parents[pairs] = True
    axis_systems = [_axis_system(model, inputs, equations, image_axis=image_axis, guard=guard,
                                 margin=margin, parents=parents if pairs else None)
                    for image_axis in (LINE, SAMPLE)]
    genes = [gene_of_term[axis == image_axis] for image_axis in (LINE, SAMPLE)]
    # A shared mask is one system with two right-hand sides, if their columns are the same.
    if len(genome.segments) == 1:
        axis_systems = [_join_axes(axis_systems, genes)]
        genes = genes[:1]
    # One row a point and axis, so that the rows of a fold are its points.
    folds = criterion.subset_folds(inputs.control.points)
    # Leave-one-out of points some of which are held out together is of folds too.
    score = "kfold" if folds else criterion.subset_score
    subproblems = []
    for axis_system, axis_genes in zip(axis_systems, genes, strict=True):
        order = np.argsort(axis_genes)  # columns in the order of the genes
        system = _order_columns(axis_system, order, genome, axis_genes[order])
        cost = partial(criterion.subset_cost, system=system)
        if criterion.is_rmse:
            if score == "kfold":
                n_errors = sum(map(len, folds))
            else:
                n_errors = len(inputs.check) if score == "check" else len(system.design)
            # An RMSE of all parts up to ROUNDING is a sum of squares of each up to its share.
            rounding = n_errors * ROUNDING**2 / len(axis_systems)
            cost = partial(_cost_by_size, cost=cost, rounding=rounding,
                           share=len(axis_systems) / genome.size)
        subproblems.append(EnumerablePart(axis_genes[order], system, score, cost, folds,
                                          inputs.pixels))
    return tuple(subproblems)


def _cost_by_size(scores: FloatArray, cost: Callable[[FloatArray], FloatArray], rounding: float,
                  share: float) -> FloatArray:
    """Return the cost (k + 1,) of the best scores (k + 1,) of selections of 0 to k terms.

    A score up to `rounding` is mere rounding: it is replaced by `rounding` times `share` for each
    term, so that the smaller selection is the better one, as `SelectionProblem` ranks it.
    """
    return cost(replace_rounding_by_size(scores, rounding,
                                         share * np.arange(len(scores), dtype=np.float64)))


def _refuse_other_errors(inputs: ProblemData) -> None:
    """Raise TermselError where a score of held-out rows is not that of the held-out points [px].

    That is so of "press" and "kfold" where standard deviations weight the rows, and where the model
    corrects its predictions by the control.
    """
    name = inputs.criterion.name
    points = inputs.control.points
    if inputs.criterion.subset_score not in ("press", "kfold"):
        return
    if points.sigma is not None and np.ptp(points.sigma) > 0:
        raise _not_enumerable_error(f"standard deviations weight the rows, but {name!r} is in px")
    if inputs.model.corrects:
        raise _not_enumerable_error(f"model {inputs.model.name!r} corrects its predictions by the "
                                    f"control; {name!r} would need a correction for every fold")


def _not_enumerable_error(why: str) -> TermselError:
    """Return the error for a problem that has no linear system per axis, with the reason."""
    return TermselError(f"this solver needs one linear system per axis: {why}",
                        hint=f"Choose another solver, such as {Remedy('solver', 'ga')} or swap.")


def _axis_system(model: RationalModel, inputs: ProblemData, equations: Equations, image_axis: int,
                 guard: FloatArray, margin: float, parents: BoolArray | None) -> SubsetSystem:
    """Return the equations of line or of sample, `image_axis`, as a system to enumerate.

    They are those of the control points; where the criterion needs selection points, the system has
    their errors, too. Denominators are at least `margin` at the places `guard` (g, 3). `parents`
    (k, k) says which of all k terms require which others, None if none do.
    """
    points = inputs.control.points
    term_axes = model.axis
    control = equations.take(row_axes(equations.A, term_axes) == image_axis,
                             term_axes == image_axis)
    axis_parents = None
    if parents is not None:
        axis_parents = parents[np.ix_(term_axes == image_axis, term_axes == image_axis)]
    system = SubsetSystem(control.A, control.b[:, None],
                          denominator=_denominator_columns(model, points.ground, image_axis),
                          guard_denominator=_denominator_columns(model, guard, image_axis),
                          margin=margin,
                          # An axis without any term is no model of the image.
                          some_of=np.ones(control.A.shape[1], dtype=bool), parents=axis_parents)
    if inputs.criterion.needs_check:
        return _with_check(system, model, inputs, image_axis)
    return system


def _with_check(system: SubsetSystem, model: RationalModel, inputs: ProblemData,
                image_axis: int) -> SubsetSystem:
    """Return the system with the rows of the selection points.

    Raises TermselError for a model whose second step is not linear in its terms.
    """
    check = inputs.check
    points = inputs.control.points
    check_equations = _axis_of_points(model, check, image_axis)
    weights = model.residual_weights(points.ground, check.ground)
    A = check_equations.A
    b = check_equations.b
    if weights is None and model.corrects:
        raise _not_enumerable_error(f"the second step of model {model.name!r} is not linear in "
                                    "its terms")
    if weights is not None:
        # The correction is linear in the residuals of the control, hence in the unknowns.
        control_equations = _axis_of_points(model, points, image_axis)
        A = A - weights @ control_equations.A
        b = b - weights @ control_equations.b
    return replace(system, check_design=A, check_target=b[:, None],
                   check_denominator=_denominator_columns(model, check.ground, image_axis))


def _axis_of_points(model: RationalModel, points: Points, image_axis: int) -> Equations:
    """Return the unweighted equations of points for one axis."""
    # Without standard deviations, hence without weights: errors are in px.
    bare = FeatureSet(Points(points.ids, points.image, points.ground), empty_lines())
    rows = model.equations(bare)
    return rows.take(np.arange(len(rows.b)) % 2 == image_axis, model.axis == image_axis)


def _denominator_columns(model: RationalModel, ground: FloatArray,
                         image_axis: int) -> FloatArray | None:
    """Return the linear form of one axis' denominator at ground points, shape (n, columns).

    Returns None for a model without denominators.
    """
    # 1 + d x is linear in the coefficients x: those of unit vectors, less 1, are its columns d.
    unit_vectors = np.eye(len(model.terms))[model.axis == image_axis]
    below = model.denominators(unit_vectors, ground)
    return None if below is None else np.ascontiguousarray(below[..., image_axis].T - 1.0)


def _join_axes(axis_systems: list[SubsetSystem], genes: list[IntArray]) -> SubsetSystem:
    """Return the systems of line and sample as one system with two right-hand sides.

    `genes` are the numbers of the genes of the columns of each. Raises TermselError where the two
    do not have the same columns, and where they have denominators.
    """
    line, sample = axis_systems
    same_columns = (np.array_equal(genes[0], genes[1]) and line.denominator is None
                    and np.array_equal(line.design, sample.design))
    if not same_columns:
        raise _not_enumerable_error("with a shared mask, line and sample must have the same "
                                    "columns and no denominators; use --set mask=per-axis")
    # Both have the same columns: two targets, whose squares add up.
    check_target = (None if line.check_target is None or sample.check_target is None
                    else np.concatenate([line.check_target, sample.check_target], axis=1))
    return SubsetSystem(
        line.design, np.concatenate([line.target, sample.target], axis=1), line.check_design,
        check_target, some_of=line.some_of, parents=line.parents)


def _order_columns(system: SubsetSystem, order: IntArray, genome: Genome,
                   genes: IntArray) -> SubsetSystem:
    """Return the system with its columns in the order `order` (k,), and the genome's forced genes.

    `genes` (k,) are the genes of the columns in that order.
    """
    # What is of rows alone, such as targets, stays as it is.
    by_column = ("design", "check_design", "denominator", "check_denominator", "guard_denominator")
    columns: dict[str, Any] = {name: np.ascontiguousarray(array[:, order]) for name in by_column
                               if (array := getattr(system, name)) is not None}
    return replace(system, **columns, forced=genome.on[genes], forbidden=genome.off[genes],
                   parents=None if system.parents is None else system.parents[np.ix_(order, order)])
