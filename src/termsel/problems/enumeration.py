"""Term selections as columns of least-squares systems that can be walked subset by subset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.subset_system import SubsetSystem
from termsel.errors import TermselError
from termsel.features import FeatureSet, FloatArray, IntArray, Points, no_lines
from termsel.models.base import LINE, SAMPLE, RationalModel
from termsel.problems.base import EnumerablePart, Genome

if TYPE_CHECKING:
    from termsel.problems.selection import Inputs


def enumerable_parts(inputs: Inputs, equations: Equations, genome: Genome,
                     gene_of_term: IntArray, guard: FloatArray, margin: float,
                     ) -> tuple[EnumerablePart, ...]:
    """Return the parts of a term selection from control points.

    With a mask for each axis the line's terms and the sample's are two systems; with one mask
    they are one system with two right-hand sides, if their columns are the same.

    Parameters
    ----------
    inputs : Inputs
    equations : Equations
        Of the control.
    genome : Genome
        Of terms alone.
    gene_of_term : ndarray of int, shape (k,)
    guard : ndarray, shape (g, 3)
        Scaled ground points at which denominators must reach `margin`.
    margin : float

    Raises
    ------
    TermselError
        If the axes are coupled, or criterion or model cannot be walked.
    """
    model, criterion = inputs.model, inputs.criterion
    if not isinstance(model, RationalModel):
        raise _unwalkable(f"model {model.name!r} is not a RationalModel")
    if not criterion.subset_score:
        raise _unwalkable(f"criterion {criterion.name!r} is not a sum over check or control rows")
    axis = model.axis
    if (row_axes(equations.A, axis) == 2).any() or (axis == 2).any():
        raise _unwalkable("lines or a shared denominator couple the axes")
    sides = [_side(model, inputs, equations, side, guard, margin) for side in (LINE, SAMPLE)]
    genes = [gene_of_term[axis == side] for side in (LINE, SAMPLE)]
    if len(genome.segments) == 1:
        sides, genes = [_merge(sides, genes)], genes[:1]
    parts = []
    for system, where in zip(sides, genes, strict=True):
        order = np.argsort(where)  # columns in the order of the genes
        parts.append(EnumerablePart(
            where[order], _ordered(system, order, genome, where[order]), criterion.subset_score,
            criterion.subset_cost))
    return tuple(parts)


def _unwalkable(why: str) -> TermselError:
    return TermselError(f"the selections of this problem cannot be enumerated: {why}",
                        hint="Choose a heuristic such as --solver ga or --solver swap.")


def _side(model: RationalModel, inputs: Inputs, equations: Equations, side: int,
          guard: FloatArray, margin: float) -> SubsetSystem:
    """Return the system of one axis with the errors at the check points."""
    check, points = inputs.check, inputs.control.points
    axis = model.axis
    control = equations.take(row_axes(equations.A, axis) == side, axis == side)
    judged = _axis_of_points(model, check, side)
    weights = model.residual_weights(points.ground, check.ground)
    A, b = judged.A, judged.b
    if weights is not None:
        # The correction is linear in the residuals of the control, hence in the unknowns.
        plain = _axis_of_points(model, points, side)
        A, b = A - weights @ plain.A, b - weights @ plain.b
    return SubsetSystem(
        control.A, control.b[:, None], A, b[:, None],
        _below(model, points.ground, side), _below(model, check.ground, side),
        _below(model, guard, side), margin, some_of=np.ones(A.shape[1], dtype=bool))


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
    if not alike or line.check_target is None or sample.check_target is None:
        raise _unwalkable("with one mask for both axes, line and sample must have the same "
                          "columns and no denominators; --set mask=per-axis can be walked")
    return SubsetSystem(
        line.design, np.concatenate([line.target, sample.target], axis=1), line.check_design,
        np.concatenate([line.check_target, sample.check_target], axis=1), some_of=line.some_of)


def _ordered(system: SubsetSystem, order: IntArray, genome: Genome,
             genes: IntArray) -> SubsetSystem:
    """Return the system with its columns in order, and with the genome's forced genes."""
    def columns(array: FloatArray | None) -> FloatArray | None:
        return None if array is None else np.ascontiguousarray(array[:, order])

    return SubsetSystem(
        np.ascontiguousarray(system.design[:, order]), system.target,
        columns(system.check_design), system.check_target, columns(system.denominator),
        columns(system.check_denominator), columns(system.guard_denominator), system.margin,
        genome.on[genes], genome.off[genes], system.some_of)
