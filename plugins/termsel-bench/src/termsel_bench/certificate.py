"""Certificates of the solver `exact`: the tree that `python -m termsel.check` verifies.

A search of its own finds the tree, with the bound of `termsel.enumeration.bounds.closed`; the
multipliers of each step go into the file. It is found in floating-point numbers: the checker alone
says whether a step holds. The theorem is in docs/explanation/certificates.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from termsel import Problem, TermselError
from termsel.check import SCHEMA, Refused, check, checksum
from termsel.toolkit import write_text

FloatArray: TypeAlias = NDArray[np.float64]
Node: TypeAlias = list[Any]

TIE = 1e-9
"""The limit is below the best score by this share: rounding may change a score by less."""

MOST_NODES = 20_000
"""Steps of a tree at most; a larger one leaves the rest open, and says so."""

_SLACK = 1e-5  # of claims, for the rounding of floating-point numbers
_STEPS = 8  # of limits at one node
_GAIN = 0.9  # limits that fall to less than this share are worth a step
_SHARE = 0.05  # weight of the fact on t
_SPHERES = (0.6, 2.0, 8.0)  # weights of the normal equations, over (tau |r|)^2


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns and target of an axis with those in use removed: one row each, the target's last."""

    control: FloatArray  # (n + 1, m)
    errors: FloatArray  # (n + 1, c)
    denominators: FloatArray  # (n + 1, c); (n + 1, 0) without any
    names: tuple[int, ...]  # (n,): the number of each column
    upper: FloatArray  # (c + 1,): limits of the denominators and of t

    def without(self, i: int) -> Columns:
        """Return them without column i."""
        return replace(self, control=np.delete(self.control, i, 0),
                       errors=np.delete(self.errors, i, 0),
                       denominators=np.delete(self.denominators, i, 0),
                       names=self.names[:i] + self.names[i + 1:])

    def using(self, i: int) -> Columns:
        """Return the others with column i removed from them."""
        a = self.control[i]
        square = float(a @ a)
        share = self.control @ a / square if square > 0 else np.zeros(len(self.control))
        return replace(self, control=self.control - np.outer(share, a),
                       errors=self.errors - np.outer(share, self.errors[i]),
                       denominators=self.denominators - np.outer(share, self.denominators[i])
                       ).without(i)


def certifier(path: Path, problem: Problem,
              rooms: Sequence[int]) -> Callable[[NDArray[np.bool_]], None]:
    """Return what writes the certificate of an optimum, given its genes.

    `rooms` are the most terms of each part of the problem. Raises TermselError at once for a
    problem that has no certificate, or a folder that is not there. What is written, the checker has
    verified; TermselError says where it refuses.
    """
    parts = problem.parts()
    if not parts or any(part.score != "check" or part.system.target.shape[1] != 1
                        or part.system.parents is not None for part in parts):
        raise TermselError(
            "there is no certificate of this problem: it is one of check errors, by axis and "
            "without parents", hint="Choose --criterion check-rmse and --set mask=per-axis.")
    if not path.absolute().parent.is_dir() or path.is_dir():
        raise TermselError(f"certificate {path}: there is no such folder, or it is one",
                           hint="Name a file in a folder that exists.")
    names = list(problem.decode(np.ones(problem.genome.size, dtype=bool)).terms)

    def write(genes: NDArray[np.bool_]) -> None:
        axes = [axis_of(names[part.genes[0]].partition(".")[0], [names[j] for j in part.genes],
                        part.system, np.flatnonzero(genes[part.genes]).tolist(), room, part.pixels)
                for part, room in zip(parts, rooms, strict=True)]
        text = json.dumps(content_of(axes)) + "\n"
        # Multipliers are found in floating-point numbers: only the checker knows that they hold.
        with TemporaryDirectory() as folder:
            made = Path(folder) / "certificate.json"
            made.write_text(text, encoding="utf-8")
            try:
                check(made)
            except Refused as refused:
                raise TermselError(f"the tree has a step that the checker refuses: {refused}",
                                   hint="No certificate is written. Fewer terms, such as a lower "
                                        "order, have one; without the option the search has its "
                                        "proof in floating-point numbers.") from refused
        write_text(path, text)

    return write


def content_of(axes: Sequence[dict[str, Any]], most: int = MOST_NODES) -> dict[str, Any]:
    """Return a certificate, given the axes without their trees (see `axis_of`).

    All trees together have about `most` steps at most; what is not decided by then is open.
    """
    content: dict[str, Any] = {"schema": SCHEMA, "axes": [
        {**axis, "nodes": tree_of(axis, most // len(axes))} for axis in axes]}
    # As read again: the checksum is of what the file says.
    return {**content, "sha256": checksum(json.loads(json.dumps(content)))}


def axis_of(name: str, terms: Sequence[str], system: Any, selection: Sequence[int],
            room: int, pixels: float) -> dict[str, Any]:
    """Return the system of one axis, its best selection and the limit that none is below."""
    kept = np.flatnonzero(~system.forbidden) if system.forbidden is not None else \
        np.arange(len(terms))

    def joined(design: FloatArray | None, target: FloatArray) -> list[list[float]]:
        return [] if design is None else np.column_stack([design[:, kept], target]).tolist()

    checks = len(system.check_target)
    chosen = list(map(int, selection))
    x = np.linalg.lstsq(system.design[:, chosen], system.target[:, 0])[0]
    errors = system.check_target[:, 0] - system.check_design[:, chosen] @ x
    if system.check_denominator is not None:
        errors /= 1.0 + system.check_denominator[:, chosen] @ x
    forced = np.flatnonzero(system.forced) if system.forced is not None else kept[:0]
    return {"axis": name, "terms": [terms[j] for j in kept.tolist()],
            "room": min(int(room), len(kept)), "selection": np.searchsorted(kept, chosen).tolist(),
            "forced": np.searchsorted(kept, forced).tolist(),
            "limit": float(errors @ errors) * (1.0 - TIE),
            "margin": float(system.margin), "pixels": float(pixels),
            "control": joined(system.design, system.target[:, 0]),
            "errors": joined(system.check_design, system.check_target[:, 0]),
            "denominators": joined(system.check_denominator, -np.ones(checks))}


def tree_of(axis: dict[str, Any], most: int, path: Sequence[tuple[int, bool]] = ()) -> list[Node]:
    """Return the steps of the proof for one axis, in the order in which the checker takes them.

    With a path only the selections that have a term or have it not, as each pair of it says, are
    decided, and all others left open: a piece of a tree that is too large.
    """
    c, k, limit = len(axis["errors"]), len(axis["terms"]), axis["limit"]
    upper = np.ones(c + 1)
    denominators = np.array(axis["denominators"]).reshape(-1, k + 1)
    if len(denominators):
        upper[c] /= axis["margin"] * c
    columns = Columns(np.array(axis["control"]).T.copy(), np.array(axis["errors"]).T.copy(),
                      denominators.T.copy(), tuple(range(k)), upper)
    for j in axis["forced"]:
        columns = columns.using(columns.names.index(j))
    nodes: list[Node] = []
    aside = ((-1, False),)  # of the half that a path does not take
    todo = [(columns, axis["room"] - len(axis["forced"]), tuple(path))]
    while todo:
        columns, left, way = todo.pop()
        if way == aside or len(nodes) >= most:
            nodes.append(["open"])
            continue
        if not columns.names or not left:
            nodes.append(["one"])
            continue
        if not way:
            steps, columns, closed = bounded(columns, limit)
            nodes += steps
            if closed:
                continue
        i = columns.names.index(way[0][0]) if way else 0
        nodes.append(["split", columns.names[i]])
        todo += [(columns.using(i), left - 1, way[1:] if not way or way[0][1] else aside),
                 (columns.without(i), left, way[1:] if not way or not way[0][1] else aside)]
    return nodes


def bounded(columns: Columns, limit: float) -> tuple[list[Node], Columns, bool]:
    """Return the steps that a bound proves of some columns, with lower limits, and if it closes."""
    control, errors, below = columns.control, columns.errors, columns.denominators
    c, n, rational = errors.shape[1], len(columns.names), below.shape[1] > 0
    upper = columns.upper.copy()
    found: list[Node] = []
    gram = control @ control.T
    half = gram.copy()
    half[n] /= 2
    half[:, n] /= 2
    half[n, n] = 0.0
    s = below.sum(axis=1) if rational else np.append(np.zeros(n), -1.0)
    share = _SHARE if rational else 0.0
    spheres: Sequence[float] = _SPHERES
    for _ in range(_STEPS):
        base = (errors * ((1.0 - share) / limit / upper[:c]**2)) @ errors.T
        base[n, n] += share / upper[c]**2
        best = (0.0, 0.0, np.zeros((0, 0)), np.zeros(0), np.zeros(0))
        for weight in spheres:
            sphere = weight / (upper[c]**2 * gram[n, n]) if gram[n, n] > 0 else 0.0
            least = _least(base + sphere * half, s)
            if least is not None and least[0] > best[0]:
                best = (least[0], weight, *least[1:])
        value, weight, inverse, h, lengths = best
        if not value > 0.0:
            return found, replace(columns, upper=upper), False
        spheres = (weight,)
        sphere = weight / (upper[c]**2 * gram[n, n]) if gram[n, n] > 0 else 0.0
        if value > 1.0 + _SLACK:
            return [*found, ["closed", share, float(sphere)]], columns, True
        if not rational:
            return found, columns, False
        # Maxima of each D z, and of t, on the ellipsoid (see `closed._lowered`).
        rows = np.vstack([below.T, np.append(np.zeros(n), -1.0)]) / lengths @ inverse.T
        along = rows @ h * value
        across = np.maximum(0.0, (rows**2).sum(axis=1) - along**2 / value)
        across += _SLACK * (rows**2).sum(axis=1) + 1e-300
        radius = np.sqrt((max(0.0, 1.0 - value) + _SLACK) * across)
        largest = along + radius
        if (largest[:c] < 0.0).any():
            k = int(np.argmin(largest[:c] / radius[:c]))
            return [*found, ["closed", share, float(sphere), k,
                             float(-along[k] / across[k])]], columns, True
        lower = largest * (1.0 + _SLACK) + 1e-12 * upper
        lowered = np.flatnonzero(lower < _GAIN * upper)
        if not len(lowered):
            return found, replace(columns, upper=upper), False
        # Other limits fall by less, but fall: one step proves them together.
        lowered = np.flatnonzero(lower < 0.99 * upper)
        found.append(["limits", share, float(sphere), [
            [int(k), float(lower[k]), float((lower[k] - along[k]) / across[k])] for k in lowered]])
        upper[lowered] = lower[lowered]
    return found, replace(columns, upper=upper), False


def _least(quadratic: FloatArray, s: FloatArray) -> tuple[float, FloatArray, FloatArray,
                                                          FloatArray] | None:
    """Return the least value where s'z = 1, L^-1, L^-1 s and the lengths that scale both.

    None if the quadratic form is not positive definite.
    """
    diagonal = np.diag(quadratic)
    if not (diagonal > 0.0).all():
        return None
    lengths = np.sqrt(diagonal)
    try:
        triangle = np.linalg.cholesky(quadratic / np.outer(lengths, lengths))
    except np.linalg.LinAlgError:
        return None
    if np.diag(triangle).min() < 1e-5:
        return None  # no digits are left
    inverse = np.linalg.inv(triangle)
    h = inverse @ (s / lengths)
    return float(1.0 / (h @ h)), inverse, h, lengths
