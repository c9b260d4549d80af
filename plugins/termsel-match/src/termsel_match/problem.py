"""The selection of lines that agree, of several candidates for each piece of a vector."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel import (
    Evaluation,
    Genome,
    Inputs,
    Option,
    Problem,
    Recipe,
    Selection,
    Subset,
    TermselError,
)
from termsel_match.rasters import FloatArray

_LIMIT = 2.5  # half_at distances up to which a line agrees at first
_SIGMAS, _LEAST_LIMIT = 2.5, 0.6  # and in the end, by the spread of those that agree; px
_ROUNDS = 20
_DAMPING = 1e-9  # of the mean diagonal: so that any lines have a solution

PICKED = Option("picked", 4, "Lines that a chromosome determines the model by.", int, 2, 50)
HALF_AT = Option("half_at", 2.0, "Distance at which a piece counts half [px].", float, 0.01, 1e4)


class MatchedLines(Problem):
    """Pick m lines that determine the model, so that as many pieces as possible agree with it.

    Lines with the same attribute `piece` are candidates for one piece, of which the nearest to the
    model counts: with the rms distance e of its vertices, e^2 / (e^2 + t^2), where t is the option
    `half_at`. The objective is the mean over the pieces. The selection is of all lines that agree,
    one for a piece, with the model refitted to them.

    Parameters
    ----------
    inputs : Inputs

    Raises
    ------
    TermselError
        If there are points among the control, or too few lines.
    """

    def __init__(self, inputs: Inputs) -> None:
        lines, picked = inputs.control.lines, int(inputs.options["picked"])
        if len(inputs.control.points):
            raise TermselError("this problem selects lines, and the control has points",
                               hint="Give lines alone, or choose rpc-gcps for points.")
        if len(lines) <= picked:
            raise TermselError(f"{len(lines)} lines are too few to pick {picked} from",
                               hint="Give more candidates, or a smaller --set picked=M.")
        self.inputs = inputs
        self.objectives = ("disagreement",)
        equations = inputs.model.equations(inputs.control)
        self._columns = equations.A.reshape(len(lines), 2, -1)
        self._target = equations.b.reshape(len(lines), 2)
        pieces = lines.attributes.get("piece", np.array(lines.ids, dtype=object))
        _, piece = np.unique(pieces.astype(str), return_inverse=True)
        self._order = np.argsort(piece.ravel(), kind="stable")
        self._first = np.flatnonzero(np.diff(piece.ravel()[self._order], prepend=-1))
        self._piece = piece.ravel()
        self._half = float(inputs.options["half_at"])
        self.genome = Genome([Subset("features", inputs.control.ids, picked)])

    def evaluate(self, genes: Any) -> Evaluation:
        """Return the part of the pieces that does not agree."""
        away = self._distances(self._fitted(np.asarray(genes, dtype=np.intp)))
        nearest = np.minimum.reduceat(away[:, self._order], self._first, axis=1)
        part = nearest**2 / (nearest**2 + self._half**2)
        return Evaluation(part.mean(axis=1, keepdims=True), np.zeros(len(part)))

    def decode(self, genes: Any) -> Selection:
        """Return the lines that agree."""
        coefficients = self._fitted(np.asarray(genes, dtype=np.intp)[None])
        limit, chosen = _LIMIT * self._half, np.zeros(0, dtype=np.intp)
        for _ in range(_ROUNDS):
            away = self._distances(coefficients)[0]
            again = np.sort([int(own[away[own].argmin()]) for own in self._of_pieces()
                             if away[own].min() <= limit])
            if np.array_equal(again, chosen) or len(again) < len(self._columns[0, 0]):
                break
            chosen = again.astype(np.intp)
            coefficients = self._fitted(chosen[None])
            spread = 1.4826 * float(np.median(self._distances(coefficients)[0, chosen]))
            limit = max(_SIGMAS * spread, _LEAST_LIMIT)
        picked = chosen if len(chosen) else np.unique(genes)
        return Selection(self.inputs.model.terms,
                         tuple(self.inputs.control.ids[int(i)] for i in picked))

    def _of_pieces(self) -> list[NDArray[np.intp]]:
        return np.split(self._order, self._first[1:])

    def _fitted(self, lines: NDArray[np.intp]) -> FloatArray:
        """Return coefficients, (p, k), by least squares of lines, (p, m)."""
        columns = self._columns[lines].reshape(*lines.shape[:1], -1, self._columns.shape[2])
        target = self._target[lines].reshape(len(lines), -1)
        normal = np.einsum("pri,prj->pij", columns, columns)
        size = np.trace(normal, axis1=1, axis2=2) / normal.shape[1]
        normal += _DAMPING * size[:, None, None] * np.eye(normal.shape[1])
        right = np.einsum("pri,pr->pi", columns, target)
        return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0])

    def _distances(self, coefficients: FloatArray) -> FloatArray:
        """Return the rms distances of both vertices of all lines, (p, n) [px]."""
        errors = self._target - np.einsum("nvk,pk->pnv", self._columns, coefficients)
        return np.asarray(np.sqrt((errors**2).mean(axis=2)) * self.inputs.pixels)


RECIPE = Recipe(
    "matched-lines", "Selection of the lines that agree, of several candidates for each piece of a "
                     "vector.",
    MatchedLines, model="poly3d", model_options={"degree": 1}, dataset="ikonos-hamedan",
    criterion="press", solver="ga-steady", control="lines", options=(PICKED, HALF_AT),
    source="after Yavari et al. 2018 and Konugurthi et al. 2016")
