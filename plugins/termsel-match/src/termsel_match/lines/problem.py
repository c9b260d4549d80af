"""The selection of lines that agree, of several candidates for each piece of a vector."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel import (
    Evaluation,
    Genome,
    Option,
    Problem,
    ProblemData,
    Recipe,
    Selection,
    Subset,
    TermselError,
)
from termsel_match.images.rasters import FloatArray

# half_at distances up to which a line may agree.
_LIMIT = 2.5
# By the spread of those, and at least; px.
_LINE_SIGMAS, _MIN_LINE_LIMIT = 2.5, 0.6
# Of the rms of two errors, in standard deviations of one.
_RMS_MEDIAN = 0.8326
_REFINEMENTS = 30
# Of coefficients, which are of scaled coordinates.
_SAME_COEFFICIENTS = 1e-9
# Of the mean diagonal: so that any lines have a solution.
_DAMPING = 1e-9

PICKED = Option("picked", 4, "Lines that a chromosome determines the model by.", int, 2, 50)
HALF_AT = Option("half_at", 2.0, "Distance at which a piece counts half [px].", float, 0.01, 1e4)


class MatchedLines(Problem):
    """Pick m lines that determine the model, so that as many pieces as possible agree with it.

    Lines with the same attribute `piece` are candidates for one piece, of which the nearest to the
    model counts: with the rms distance e of its vertices, e^2 / (e^2 + t^2), where t is the option
    `half_at`. A map that is wrong is so by whole vectors. So n pieces with the same attribute
    `vector` weigh as much as sqrt(n) vectors of one piece. The objective is the weighted mean. The
    selection is of all lines that agree, one for a piece, with the model refitted to them.

    References
    ----------
    Geman, McClure 1987: Statistical methods for tomographic image reconstruction. Bulletin of the
    International Statistical Institute 52, 5-21: the loss, which the last fit minimises, too.

    Parameters
    ----------
    inputs : ProblemData
        Its control is lines alone, the candidates, with the attributes `piece` and `vector`.

    Raises
    ------
    TermselError
        If there are points among the control, or too few lines.
    """

    def __init__(self, inputs: ProblemData) -> None:
        lines = inputs.control.lines
        picked = int(inputs.options["picked"])
        if len(inputs.control.points):
            raise TermselError("this problem selects lines, and the control has points",
                               hint="Give lines alone, or choose rpc-gcps for points.")
        if len(lines) <= picked:
            raise TermselError(f"{len(lines)} lines are too few to pick {picked} from",
                               hint="Give more candidates, or a smaller --set picked=M.")
        self.inputs = inputs
        self.objectives = ("disagreement",)
        # Without standard deviations: distances are in px, and those of wrong bands mean nothing.
        equations = inputs.model.equations(inputs.control.with_(lines=replace(lines, sigma=None)))
        self._columns = equations.A.reshape(len(lines), 2, -1)
        self._target = equations.b.reshape(len(lines), 2)
        piece_names = lines.attributes.get("piece", np.array(lines.ids, dtype=object))
        # Numbers of pieces in the order in which they come.
        _, first_at, number = np.unique(piece_names.astype(str), return_index=True,
                                        return_inverse=True)
        # As they come, which is along their vectors: as text, "10" is before "2".
        number = np.argsort(np.argsort(first_at))[number.ravel()]
        # Candidates of a piece are put next to one another, so that `reduceat` finds its nearest.
        self._order = np.argsort(number, kind="stable")
        self._first = np.flatnonzero(np.diff(number[self._order], prepend=-1))
        vectors = lines.attributes.get("vector", piece_names).astype(str)[self._order][self._first]
        _, vector, count = np.unique(vectors, return_inverse=True, return_counts=True)
        self._vector = vector.ravel()
        # n pieces of a vector weigh 1 / sqrt(n) each, sqrt(n) together.
        weight = 1 / np.sqrt(count[self._vector])
        self._weight = weight / weight.sum()
        self._half = float(inputs.options["half_at"])
        self.genome = Genome([Subset("features", inputs.control.ids, picked)])

    def evaluate(self, genes: Any) -> Evaluation:
        """Return the weighted share of pieces that do not agree, of genes (p, picked)."""
        away = self._line_distances(self._fit_lines(np.asarray(genes, dtype=np.intp)))
        # Of each piece the nearest candidate alone counts.
        nearest = np.minimum.reduceat(away[:, self._order], self._first, axis=1)
        disagreement = nearest**2 / (nearest**2 + self._half**2)
        return Evaluation((disagreement @ self._weight)[:, None], np.zeros(len(disagreement)))

    def decode(self, genes: Any) -> Selection:
        """Return all terms, and the lines that agree with the picked ones' model.

        If these are too few for a fit, the picked lines themselves.
        """
        coefficients = self.refined(self.fitted(np.asarray(genes, dtype=np.intp)))
        agreeing = self.agreeing(coefficients)
        picked = (
            np.sort(agreeing) if len(agreeing) >= len(self._columns[0, 0]) else np.unique(genes)
        )
        return Selection(self.inputs.model.terms,
                         tuple(self.inputs.control.ids[int(i)] for i in picked))

    @property
    def vector(self) -> NDArray[np.intp]:
        """Number of the vector of each piece, in the order of the lines."""
        return self._vector

    def fitted(self, lines: NDArray[np.intp], weights: FloatArray | None = None) -> FloatArray:
        """Return coefficients, (k,), by least squares of lines, (m,), with weights, (m,)."""
        return np.asarray(self._fit_lines(lines[None], weights)[0])

    def refined(self, coefficients: FloatArray, times: FloatArray | None = None) -> FloatArray:
        """Return the coefficients, (k,), near others that minimise the loss.

        `times` is how many times each piece counts.
        """
        for _ in range(_REFINEMENTS):
            nearest, away = self._nearest_lines(coefficients)
            # Weights of Geman and McClure's loss: its derivative by e^2, (t^2 / (e^2 + t^2))^2.
            loss = self._weight * (self._half**2 / (away**2 + self._half**2)) ** 2
            before = coefficients
            coefficients = self.fitted(nearest, loss if times is None else loss * times)
            if np.allclose(coefficients, before, rtol=0, atol=_SAME_COEFFICIENTS):
                break
        return coefficients

    def agreeing(self, coefficients: FloatArray, times: FloatArray | None = None,
                 ) -> NDArray[np.intp]:
        """Return the numbers of the lines that agree with a model, the nearest of each piece.

        `times` (pieces,) says how often each piece counts, such as in a bootstrap; once if it is
        None.
        """
        nearest, away = self._nearest_lines(coefficients)
        # A piece that counts twice is there twice.
        if times is not None:
            pieces = np.repeat(np.arange(len(nearest)), times.astype(np.intp))
            nearest = nearest[pieces]
            away = away[pieces]
        near = away[away <= _LIMIT * self._half]
        spread = float(np.median(near)) / _RMS_MEDIAN if len(near) else 0.0
        return np.asarray(
            nearest[away <= min(max(_LINE_SIGMAS * spread, _MIN_LINE_LIMIT), _LIMIT * self._half)])

    def seen(self, coefficients: FloatArray) -> FloatArray:
        """Return where a model sees the vertices of all lines, (2 n, 2) [px]."""
        ground = self.inputs.control.lines.ground.reshape(-1, 3)
        return np.asarray(self.inputs.model.project(coefficients, ground) * self.inputs.pixels)

    def _nearest_lines(self, coefficients: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the number of each piece's line that is nearest to a model, and its distance [px].
        """
        away = self._line_distances(coefficients[None])[0]
        nearest = np.array([candidates[away[candidates].argmin()]
                            for candidates in self._equations_of_pieces()])
        return nearest, away[nearest]

    def _equations_of_pieces(self) -> list[NDArray[np.intp]]:
        return np.split(self._order, self._first[1:])

    def _fit_lines(self, lines: NDArray[np.intp], weights: FloatArray | None = None) -> FloatArray:
        """Return coefficients, (p, k), by least squares of lines, (p, m), with weights, (m,)."""
        root = np.ones(lines.shape[1]) if weights is None else np.sqrt(weights)
        columns = (self._columns[lines] * root[:, None, None]).reshape(
            len(lines), -1, self._columns.shape[2])
        target = (self._target[lines] * root[:, None]).reshape(len(lines), -1)
        # Normal equations of all chromosomes at once, damped so that parallel lines have a
        # solution.
        normal = np.einsum("pri,prj->pij", columns, columns)
        size = np.trace(normal, axis1=1, axis2=2) / normal.shape[1]
        normal += _DAMPING * size[:, None, None] * np.eye(normal.shape[1])
        right = np.einsum("pri,pr->pi", columns, target)
        return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0])

    def _line_distances(self, coefficients: FloatArray) -> FloatArray:
        """Return the rms distances of both vertices of all lines, (p, n) [px]."""
        errors = self._target - np.einsum("nvk,pk->pnv", self._columns, coefficients)
        return np.asarray(np.sqrt((errors**2).mean(axis=2)) * self.inputs.pixels)


RECIPE = Recipe(
    "matched-lines", "Selection of the lines that agree, of several candidates for each piece of a "
                     "vector.",
    MatchedLines, model="poly3d", model_options={"degree": 1}, dataset="ikonos-hamedan",
    criterion="press", solver="ga-steady", control="lines", options=(PICKED, HALF_AT),
    source="after Yavari et al. 2018 and Konugurthi et al. 2016")
