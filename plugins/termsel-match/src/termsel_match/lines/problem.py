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

_LIMIT = 2.5
"""Largest distance at which a line agrees, in units of the option `half_at`."""

_LINE_SIGMAS, _MIN_LINE_LIMIT = 2.5, 0.6
"""Distance up to which a line agrees: in standard deviations, and at least so many px."""

_RMS_MEDIAN = 0.8326
"""Median of the RMS of two errors, in standard deviations of one: sqrt(ln 2)."""

_REFINEMENTS = 30
"""Most rounds of reweighted least squares."""

_SAME_COEFFICIENTS = 1e-9
"""Change of the coefficients, which are of scaled coordinates, below which rounds end."""

_DAMPING = 1e-9
"""Damping of the normal equations, by their mean diagonal, so that any lines have a solution."""

PICKED = Option("picked", 4, "Lines that a chromosome determines the model by.", int, 2, 50)
HALF_AT = Option("half_at", 2.0, "Distance at which a piece counts half [px].", float, 0.01, 1e4)


class MatchedLines(Problem):
    """Pick m lines that determine the model, so that as many pieces as possible agree with it.

    Lines with the same attribute `piece` are candidates for one piece of a vector. Of these only
    the nearest to the model counts, with e^2 / (e^2 + t^2): e is the RMS distance of its vertices,
    and t the option `half_at`. The objective is the weighted mean over the pieces. As a map is
    wrong by whole vectors, n pieces with the same attribute `vector` have together the weight of
    sqrt(n) pieces of different vectors. What is selected are all lines that agree with the model,
    one for a piece, after the model was refitted to them.

    References
    ----------
    Geman, McClure 1987: Statistical methods for tomographic image reconstruction. Bulletin of the
    International Statistical Institute 52, 5-21: the loss, which the last fit minimises, too.

    Parameters
    ----------
    inputs : ProblemData
        The data. Its control features are the candidate lines alone, with the attributes `piece`
        and `vector`; without these attributes, each line is a piece and a vector of its own.

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
        # Without standard deviations, distances are in px: those of wrong bands mean nothing.
        equations = inputs.model.equations(inputs.control.with_(lines=replace(lines, sigma=None)))
        self._columns = equations.A.reshape(len(lines), 2, -1)
        self._target = equations.b.reshape(len(lines), 2)
        piece_names = lines.attributes.get("piece", np.array(lines.ids, dtype=object))
        _, first_at, number = np.unique(piece_names.astype(str), return_index=True,
                                        return_inverse=True)
        # Pieces are numbered as they come, along their vectors: sorted as text, "10" is before "2".
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
        """Return the weighted mean disagreement of the pieces for genes (p, picked)."""
        distances = self._line_distances(self._fit_lines(np.asarray(genes, dtype=np.intp)))
        # Only the nearest candidate of each piece counts, as the others are wrong bands.
        nearest = np.minimum.reduceat(distances[:, self._order], self._first, axis=1)
        disagreement = nearest**2 / (nearest**2 + self._half**2)
        return Evaluation((disagreement @ self._weight)[:, None], np.zeros(len(disagreement)))

    def decode(self, genes: Any) -> Selection:
        """Return all terms, and the lines that agree with the model of the picked ones.

        The picked lines themselves come back if the agreeing ones are too few for a fit.
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

    def candidates_of_pieces(self) -> list[NDArray[np.intp]]:
        """Return the numbers of the lines that are candidates for each piece, piece by piece."""
        return np.split(self._order, self._first[1:])

    def fitted(self, lines: NDArray[np.intp], weights: FloatArray | None = None) -> FloatArray:
        """Return the coefficients, (k,), by least squares of lines (m,), given by their numbers.

        `weights` (m,) are those of the lines; all weigh alike if they are None.
        """
        return np.asarray(self._fit_lines(lines[None], weights)[0])

    def refined(self, coefficients: FloatArray, times: FloatArray | None = None) -> FloatArray:
        """Return the coefficients, (k,), of a local minimum of the loss next to given ones.

        The loss is minimised by reweighted least squares of the nearest line of each piece. `times`
        (pieces,) is how often each piece counts; once if it is None.
        """
        for _ in range(_REFINEMENTS):
            nearest, distances = self._nearest_lines(coefficients)
            # Weight of an error e under Geman and McClure's loss: proportional to the derivative
            # of the loss by e^2, (t^2 / (e^2 + t^2))^2.
            weights = self._weight * (self._half**2 / (distances**2 + self._half**2)) ** 2
            before = coefficients
            coefficients = self.fitted(nearest, weights if times is None else weights * times)
            if np.allclose(coefficients, before, rtol=0, atol=_SAME_COEFFICIENTS):
                break
        return coefficients

    def agreeing(self, coefficients: FloatArray, times: FloatArray | None = None,
                 ) -> NDArray[np.intp]:
        """Return the numbers of the lines that agree with a model, the nearest of each piece.

        `times` (pieces,) says how often each piece counts, and its line comes back, as in a
        bootstrap; once if it is None.
        """
        nearest, distances = self._nearest_lines(coefficients)
        if times is not None:
            pieces = np.repeat(np.arange(len(nearest)), times.astype(np.intp))
            nearest = nearest[pieces]
            distances = distances[pieces]
        near = distances[distances <= _LIMIT * self._half]
        spread = float(np.median(near)) / _RMS_MEDIAN if len(near) else 0.0
        limit = min(max(_LINE_SIGMAS * spread, _MIN_LINE_LIMIT), _LIMIT * self._half)
        return np.asarray(nearest[distances <= limit])

    def seen(self, coefficients: FloatArray) -> FloatArray:
        """Return where a model projects both vertices of all lines to, (2 n, 2) [px]."""
        ground = self.inputs.control.lines.ground.reshape(-1, 3)
        return np.asarray(self.inputs.model.project(coefficients, ground) * self.inputs.pixels)

    def _nearest_lines(self, coefficients: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the number of each piece's line nearest to a model, and its RMS distance [px]."""
        distances = self._line_distances(coefficients[None])[0]
        nearest = np.array([candidates[distances[candidates].argmin()]
                            for candidates in self.candidates_of_pieces()])
        return nearest, distances[nearest]

    def _fit_lines(self, lines: NDArray[np.intp], weights: FloatArray | None = None) -> FloatArray:
        """Return the coefficients, (p, k), by least squares of each row of lines (p, m).

        `weights` (m,) are those of the lines of every row; all weigh alike if they are None.
        """
        root = np.ones(lines.shape[1]) if weights is None else np.sqrt(weights)
        columns = (self._columns[lines] * root[:, None, None]).reshape(
            len(lines), -1, self._columns.shape[2])
        target = (self._target[lines] * root[:, None]).reshape(len(lines), -1)
        # Normal equations of all rows at once, damped so that parallel lines have a solution.
        normal = np.einsum("pri,prj->pij", columns, columns)
        size = np.trace(normal, axis1=1, axis2=2) / normal.shape[1]
        normal += _DAMPING * size[:, None, None] * np.eye(normal.shape[1])
        right = np.einsum("pri,pr->pi", columns, target)
        return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0])

    def _line_distances(self, coefficients: FloatArray) -> FloatArray:
        """Return the RMS distance of both vertices of each line, (p, n) [px], of models (p, k)."""
        errors = self._target - np.einsum("nvk,pk->pnv", self._columns, coefficients)
        return np.asarray(np.sqrt((errors**2).mean(axis=2)) * self.inputs.pixels)


RECIPE = Recipe(
    "matched-lines", "Selection of the lines that agree, of several candidates for each piece of a "
                     "vector.",
    MatchedLines, model="poly3d", model_options={"degree": 1}, dataset="ikonos-hamedan",
    criterion="press", solver="ga-steady", control="lines", options=(PICKED, HALF_AT),
    source="after Yavari et al. 2018 and Konugurthi et al. 2016")
