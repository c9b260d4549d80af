"""Certificates of the solver `exact`: the tree that `python -m termsel.check` verifies.

A search of its own finds the tree; the multipliers of each step go into the file. They are found in
floating-point numbers (`termsel_bench.multipliers`), and a step is taken only if the checker's own
function accepts it. The theorem is in docs/explanation/certificates.md.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from termsel import Problem, TermselError
from termsel.check import (
    CERTIFICATE_SCHEMA,
    UPPER,
    Axis,
    Node,
    Refused,
    check,
    checksum,
    require_together,
)
from termsel.toolkit import Remedy
from termsel_bench.multipliers import Columns, FloatArray, best_bound

Step: TypeAlias = list[Any]

log = logging.getLogger("termsel.bench")

TIE = 1e-9
"""The limit is below the best score by this share: rounding may change a score by less."""

MAX_NODES = 50_000
"""Steps of a tree at most; a larger one leaves the rest open, and says so."""

# Most refinements of limits at one node.
_REFINEMENT_STEPS = 8
# Limits that fall to less than this share are worth a step.
_MAX_LIMIT_SHARE = 0.9
# Decades, by a factor, of all limits together at which a node mostly closes.
_CLOSING_DECADES = 20.0


def certificate_maker(problem: Problem, rooms: Sequence[int],
                      ) -> Callable[[NDArray[np.bool_]], dict[str, Any] | None]:
    """Return a function that makes the certificate of a selection from its genes (g,).

    `rooms` are the most terms that a selection may have of each part of the problem. The function
    returns the content of a certificate that the checker has verified; where none can be made, it
    logs a warning and returns None. Raises TermselError for a problem that has no certificate, or
    whose numbers a certificate cannot state.
    """
    axis_parts = problem.parts()
    if not axis_parts or any(
            axis_part.score != "check" or axis_part.system.target.shape[1] != 1
            or axis_part.system.parents is not None for axis_part in axis_parts):
        raise TermselError(
            "there is no certificate of this problem: it is one of check errors, by axis and "
            "without parents", hint=f"Choose {Remedy('criterion', 'check-rmse')} and "
                                        f"{Remedy('set', 'mask=per-axis')}.")
    names = list(problem.decode(np.ones(problem.genome.size, dtype=bool)).terms)

    def axes_of(genes: NDArray[np.bool_]) -> list[dict[str, Any]]:
        """Return the axes of a selection as a certificate states them."""
        axes = []
        for axis_part, room in zip(axis_parts, rooms, strict=True):
            terms = [names[j] for j in axis_part.genes]
            name = names[axis_part.genes[0]].partition(".")[0]
            selection = np.flatnonzero(genes[axis_part.genes]).tolist()
            axes.append(axis_of(name, terms, axis_part.system, selection, room, axis_part.pixels))
        return axes

    # An empty selection shows before a long search whether a certificate can be made.
    try:
        empty_axes = axes_of(np.zeros(problem.genome.size, dtype=bool))
        require_together([Axis({**axis, "forced": [], "limit": 1.0, "nodes": []})
                          for axis in empty_axes])
    except (Refused, ValueError) as error:
        raise TermselError(
            f"no certificate can represent this problem: {error}",
            hint="Choose a lower degree or order, which has fewer terms and less small values, or "
                 "search without the option certificate.") from error

    def certificate_of(genes: NDArray[np.bool_]) -> dict[str, Any] | None:
        """Return the certificate of the selection with genes (g,), as JSON takes it.

        None, with a warning, if the checker refuses it. A certificate that leaves selections open
        is returned, with a warning.
        """
        # The search has ended by now: no error may lose its result.
        try:
            text = json.dumps(content_of(axes_of(genes), MAX_NODES))
            with TemporaryDirectory() as folder:
                file = Path(folder) / "certificate.json"
                file.write_text(text, encoding="utf-8")
                _, open_ = check(file)
        except (Refused, ValueError, OSError, TermselError) as error:
            log.warning("no certificate is written: %s. The proof of the search stands, but only "
                        "in floating-point arithmetic", str(error).rstrip("."))
            return None
        if open_:
            log.warning("the tree of the certificate is full, and %s selections are left open; it "
                        "does not prove the optimum", f"{open_:,}")
        content: dict[str, Any] = json.loads(text)
        # The result adds of which data it is, and the checksum.
        del content["sha256"]
        return content

    return certificate_of


def content_of(axes: Sequence[dict[str, Any]], max_steps: int = MAX_NODES) -> dict[str, Any]:
    """Return a certificate, given the axes without their trees (see `axis_of`).

    All trees together have about `max_steps` steps at most; nodes beyond them are left open.
    """
    content: dict[str, Any] = {"schema": CERTIFICATE_SCHEMA, "axes": [
        {**axis, "nodes": tree_of(axis, max_steps // len(axes))} for axis in axes]}
    # The checksum is of the numbers as they are read again from the file.
    return {**content, "sha256": checksum(json.loads(json.dumps(content)))}


def axis_of(name: str, terms: Sequence[str], system: Any, selection: Sequence[int],
            room: int, pixels: float) -> dict[str, Any]:
    """Return the system of one axis as a certificate states it, with its best selection and limit.

    Columns are those of allowed terms, numbered anew. `room` is the most terms of a selection, and
    `pixels` how many px an error of 1 is. The limit is the sum of squares of the selection,
    lowered by the share `TIE`: the certificate proves that no selection is below it.
    """
    if system.forbidden is not None:
        allowed = np.flatnonzero(~system.forbidden)
    else:
        allowed = np.arange(len(terms))

    def joined(design: FloatArray | None, target: FloatArray) -> list[list[float]]:
        """Return the rows of allowed columns with the target last; [] without a design."""
        return [] if design is None else np.column_stack([design[:, allowed], target]).tolist()

    checks = len(system.check_target)
    selected = list(map(int, selection))
    # Least squares by the selection, and its errors at the check points.
    x = np.linalg.lstsq(system.design[:, selected], system.target[:, 0])[0]
    errors = system.check_target[:, 0] - system.check_design[:, selected] @ x
    # Errors of a rational function are those of the linear equations over the denominator.
    if system.check_denominator is not None:
        errors /= 1.0 + system.check_denominator[:, selected] @ x
    forced = np.flatnonzero(system.forced) if system.forced is not None else allowed[:0]
    return {"axis": name, "terms": [terms[j] for j in allowed.tolist()],
            "room": min(int(room), len(allowed)),
            "selection": np.searchsorted(allowed, selected).tolist(),
            "forced": np.searchsorted(allowed, forced).tolist(),
            "limit": float(errors @ errors) * (1.0 - TIE),
            "margin": float(system.margin), "pixels": float(pixels),
            "control": joined(system.design, system.target[:, 0]),
            "errors": joined(system.check_design, system.check_target[:, 0]),
            "denominators": joined(system.check_denominator, -np.ones(checks))}


def tree_of(axis: dict[str, Any], max_steps: int,
            path: Sequence[tuple[int, bool]] = ()) -> list[Step]:
    """Return the steps of the proof for one axis, in the order in which the checker takes them.

    Nodes beyond `max_steps` steps are left open. A path has pairs of a term and whether selections
    have it: only selections of the path are decided, and all others left open, so that a tree that
    is too large can be proven in pieces.
    """
    checker = Axis({**axis, "nodes": []})
    columns = _columns_of(axis)
    node = checker.root()
    steps: list[Step] = []
    # Marks, in place of a path, a half that is left open; no term has the number -1.
    aside = ((-1, False),)
    todo = [(columns, node, tuple(path))]
    while todo:
        columns, node, way = todo.pop()
        if way == aside or len(steps) >= max_steps:
            steps.append(["open"])
            continue
        if not node.rest or len(node.used) >= checker.room:
            steps.append(["one"])
            continue
        # Nodes on the path only lead to the selections that are decided.
        if not way:
            bound_steps, columns, node, closed = _bound_steps(columns, node, checker)
            steps += bound_steps
            if closed:
                continue
        if way:
            j = way[0][0]
        else:
            j = columns.names[_branching_column(columns, checker.room - len(node.used))]
        i = columns.names.index(j)
        steps.append(["split", j])
        without, using = checker.halves(node, j)
        # Depth first: the half that uses the term is taken next, as the checker takes it.
        todo += [(columns.projected_off(i), using, way[1:] if not way or way[0][1] else aside),
                 (columns.without(i), without, way[1:] if not way or not way[0][1] else aside)]
    return steps


def _columns_of(axis: dict[str, Any]) -> Columns:
    """Return the columns at the root of the tree: all terms of the axis, with the forced ones used.
    """
    c = len(axis["errors"])
    k = len(axis["terms"])
    upper = np.ones(c + 1)
    denominators = np.array(axis["denominators"]).reshape(-1, k + 1)
    # The last entry is the limit of t, 1 / (c m) for c denominators with the margin m.
    if len(denominators):
        upper[c] /= axis["margin"] * c
    columns = Columns(np.array(axis["control"]).T.copy(),
                      # In units of the limit, so that a selection below it has a sum of squares
                      # below 1.
                      np.array(axis["errors"]).T / np.sqrt(axis["limit"]),
                      denominators.T.copy(), tuple(range(k)), upper, None)
    for j in sorted(axis["forced"]):
        columns = columns.projected_off(columns.names.index(j))
    return columns


def _bound_steps(columns: Columns, node: Node,
                 checker: Axis) -> tuple[list[Step], Columns, Node, bool]:
    """Return the steps that bounds prove of a node, its columns and node then, and if it is closed.

    The checker has accepted each step. Limits of denominators are lowered as long as that is worth
    a step, at most `_REFINEMENT_STEPS` times.
    """
    steps: list[Step] = []
    for _ in range(_REFINEMENT_STEPS):
        bound = best_bound(columns)
        if bound is None:
            break
        columns = replace(columns, alphas=bound.alphas)
        alphas = _multipliers_of_open_columns(node, columns.names, bound.alphas)
        if bound.closes:
            if checker.is_closed(node, alphas):
                return [*steps, ["closed", alphas]], columns, node, True
            break
        if not checker.rational:
            break
        # The largest values of the denominators, and of t last. A denominator that cannot be
        # positive closes the node.
        largest = bound.largest(columns)
        k = int(np.argmin(largest[:-1]))
        if largest[k] < 0.0 and checker.is_closed(node, alphas, k):
            return [*steps, ["closed", alphas, k]], columns, node, True
        if not (largest < _MAX_LIMIT_SHARE * columns.upper).any():
            break
        try:
            node = checker.limited(node, alphas)
        except Refused:
            break
        steps.append(["limits", alphas])
        columns = replace(columns, upper=np.array([u / UPPER for u in node.upper]))
    return steps, columns, node, False


def _multipliers_of_open_columns(node: Node, names: Sequence[int],
                                 alphas: FloatArray) -> list[float]:
    """Return multipliers in the order of the node's open columns, rounded to nine digits."""
    # Any multipliers are valid, but with fewer digits the form of columns that nearly depend on
    # each other is no longer positive definite.
    alpha_by_name = dict(zip(names, alphas.tolist(), strict=True))
    return [float(f"{alpha_by_name[j]:.9g}") for j in node.rest]


def _branching_column(columns: Columns, room: int) -> int:
    """Return the index of the column whose two halves leave least open, by one bound of each.

    The halves are the selections without the column and those with it; `room` is the number of
    columns that may still be used. What a half leaves open is 0 if its bound closes it, and 1 if
    there is no bound. With denominators it is the factor by which the bound lowers all their limits
    together, to the power 1 / `_CLOSING_DECADES`; without, exp(-minimum) of the bound.
    """
    best = 0
    least_open = np.inf
    for i in range(len(columns.names)):
        total = 0.0
        for half in (columns.without(i), columns.projected_off(i) if room > 1 else None):
            # Without further columns, or without room for them, the half is a single selection.
            if half is None or not half.names:
                continue
            bound = best_bound(half, tune=False)
            if bound is None:
                total += 1.0
            elif not bound.closes and columns.denominators.shape[1]:
                largest = bound.largest(half)
                if (largest > 0.0).all():
                    lower = np.minimum(half.upper, largest) / half.upper
                    total += float(np.exp(np.log(lower).sum() / _CLOSING_DECADES))
            elif not bound.closes:
                total += float(np.exp(-bound.minimum))
        if total < least_open:
            best = i
            least_open = total
    return best
