"""A population of fitted models: many selections of terms and features of one model at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from termsel.adjustment.equations import line_normals
from termsel.adjustment.leave_out import IndependentPart
from termsel.data.features import (
    BoolArray,
    FeatureSet,
    FloatArray,
    IntArray,
    Lines,
    Points,
    empty_lines,
)
from termsel.fitting.losses import SQUARES, rmse_like_figure
from termsel.models.base import SensorModel
from termsel.models.quotient import RationalModel, pole_margin


@dataclass(frozen=True, eq=False)
class Fits:
    """A population of fitted models, as criteria get it.

    Parameters
    ----------
    model : SensorModel
    control, check : Points
        In scaled coordinates.
    pixels : float
        px per scaled image unit.
    terms : ndarray of bool, shape (p, k)
        Terms in use.
    coefficients : ndarray, shape (p, k)
    lines : Lines
        Control lines in scaled coordinates.
    parts : tuple of IndependentPart
        The systems from which the coefficients were solved. Criteria of the selection points alone
        need neither these nor what follows.
    used : ndarray of bool, shape (p, n), optional
        Control features in use, points before lines; None if features are not selected.
    gene_of_term : ndarray of int, shape (k,), optional
        Terms with the same number are switched together; None if each is switched alone.
    optional : ndarray of bool, shape (k,), optional
        Terms that may be chosen: neither in all selections nor in none; None if all may be.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> class LargestError(termsel.Criterion):
    ...     "Largest error at selection points."
    ...     name = "largest-error"
    ...
    ...     def score(self, fits):  # `fits` is a Fits of p models
    ...         return np.linalg.norm(fits.check_errors, axis=2).max(axis=1)
    >>> task = termsel.prepare("poly-terms", criterion=LargestError, options={"degree": 2})
    >>> genes = task.problem.genome.random(np.random.default_rng(1), 3)
    >>> task.problem.evaluate(genes).objectives.round().T  # of three random selections [px]
    array([[4084., 1084., 5003.]])
    """

    model: SensorModel
    control: Points
    check: Points
    pixels: float
    terms: BoolArray
    coefficients: FloatArray
    lines: Lines = field(default_factory=empty_lines)
    parts: tuple[IndependentPart, ...] = ()
    used: BoolArray | None = None
    gene_of_term: IntArray | None = None
    optional: BoolArray | None = None

    @cached_property
    def check_errors(self) -> FloatArray:
        """Predicted minus measured line and sample of the selection points [px], (p, n, 2)."""
        control = FeatureSet(self.control, self.lines)
        ground = self.check.ground
        if self.used is not None and self.model.corrects:  # each by the features that it uses
            predictions = [self.model.predict(solution, control.take(used), ground)
                           for solution, used in zip(self.coefficients, self.used, strict=True)]
            predicted = np.stack(predictions)
        else:
            predicted = self.model.predict(self.coefficients, control, ground)
        return np.asarray((predicted - self.check.image) * self.pixels)

    @property
    def in_use(self) -> BoolArray:
        """Control features in use, points before lines, shape (p, n)."""
        if self.used is not None:
            return self.used
        return np.ones((len(self.terms), len(FeatureSet(self.control, self.lines))), dtype=bool)

    def held_out(self, coefficients: FloatArray, features: IntArray) -> FloatArray:
        """Return squared errors of control features held out from the solutions.

        Parameters
        ----------
        coefficients : ndarray, shape (p, k)
            Of each of the p models.
        features : ndarray of int, shape (n,)
            In ascending order: points before lines.

        Returns
        -------
        ndarray, shape (p, n)
            Of a point dl^2 + ds^2, of a line the sum of the squared distances of its ground
            vertices from the image line [px^2]; infinite if a denominator is below
            `termsel.models.quotient.pole_margin`.
        """
        feature_of_vertex, ground = self._vertices
        ground_held_out = ground[np.isin(feature_of_vertex, features)]
        control = FeatureSet(self.control, self.lines)
        # A model that corrects its predictions by the control must not see what is held out.
        if self.model.corrects:
            control = control.take(~np.isin(np.arange(len(control)), features))
        with np.errstate(over="ignore", invalid="ignore"):
            image = self.model.predict(coefficients, control, ground_held_out)
            denominators = self.model.denominators(coefficients, ground_held_out)
            return self._squared_errors(image, denominators, features)

    def held_out_each(self, coefficients: FloatArray) -> FloatArray:
        """Return squared errors of all control features, each held out from its solution.

        Parameters
        ----------
        coefficients : ndarray, shape (n, p, k)
            Solutions that hold out feature 0 to n - 1.

        Returns
        -------
        ndarray, shape (p, n)
            As `held_out`.
        """
        model = self.model
        features = np.arange(len(coefficients))
        if not isinstance(model, RationalModel) or model.corrects:
            return np.concatenate([self.held_out(solution, features[i:i + 1])
                                   for i, solution in enumerate(coefficients)], axis=1)
        # Numerators and denominators are linear in the coefficients: those of unit vectors suffice.
        feature_of_vertex, ground = self._vertices
        solutions = coefficients[feature_of_vertex] if len(self.lines) else coefficients
        unit_vectors = np.eye(coefficients.shape[2])
        denominators = model.denominators(unit_vectors, ground)
        # A term of the denominator alone has 0 / 0, and no part in the numerator.
        numerators = np.nan_to_num(model.project(unit_vectors, ground))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            # (n, p, k) times (n, k, 2) is (n, p, 2): individuals come first then, (p, n, 2).
            image = (solutions @ numerators.transpose(1, 0, 2)).transpose(1, 0, 2)
            if denominators is not None:
                # 1 + d x, where those of unit vectors are 1 + d.
                linear = solutions @ (denominators - 1.0).transpose(1, 0, 2)
                denominators = 1.0 + linear.transpose(1, 0, 2)
                image = image / denominators
            return self._squared_errors(image, denominators, features)

    @cached_property
    def _vertices(self) -> tuple[IntArray, FloatArray]:
        """The feature of each point and each line vertex, (v,), and their ground positions, (v, 3).
        """
        features = FeatureSet(self.control, self.lines)
        return features.vertex_feature, features.ground_vertices()

    @cached_property
    def _image_lines(self) -> tuple[FloatArray, FloatArray]:
        return line_normals(self.lines)

    def _squared_errors(self, image: FloatArray, denominators: FloatArray | None,
                        features: IntArray) -> FloatArray:
        """Return squared errors [px^2] of features, (p, f), by the positions of their vertices.

        `image` (p, v, 2) and `denominators` (p, v, 2) are those of the points, then of both
        vertices of each line, among the `features` (f,), which are in ascending order. A point has
        the square of its distance, a line the sum of the squared distances of its vertices from the
        image line. Beyond a pole the error is infinite.
        """
        n = len(self.control)
        point_rows = features[features < n]
        line_rows = np.isin(n + self.lines.feature, features)
        squares = ((image[:, :len(point_rows)] - self.control.image[point_rows])**2).sum(axis=2)
        if line_rows.any():
            # Each of the two vertices has its distance rho - n'(l, s) from the image line.
            normals, rhos = self._image_lines
            normal = np.repeat(normals[line_rows], 2, axis=0)
            rho = np.repeat(rhos[line_rows], 2, axis=0)
            distances = rho - (image[:, len(point_rows):] * normal).sum(axis=2)
            squares = np.concatenate([squares, distances**2], axis=1)
        # An image beyond a pole may be near by chance: it counts as infinitely far.
        if denominators is not None:
            least = pole_margin(FeatureSet(self.control))
            squares = np.where((denominators >= least).all(axis=2), squares, np.inf)
        if line_rows.any():  # the squares of all vertices of a feature are added up
            feature_of_vertex = np.concatenate(
                [point_rows, n + np.repeat(self.lines.feature[line_rows], 2)])
            order = np.argsort(feature_of_vertex, kind="stable")
            starts = np.searchsorted(feature_of_vertex[order], features)
            squares = np.add.reduceat(squares[:, order], starts, axis=1)
        return np.asarray(squares * self.pixels**2)

    def rmse(self, squares: FloatArray, loss: str = SQUARES,
             threshold: float = 2.0) -> FloatArray:
        """Return the RMSE of the control in use, shape (p,); infinite where none is in use.

        As everywhere, it is sqrt(mean(dl^2 + ds^2)) over points and over all vertices of lines.
        Under another loss the error of a line is the root mean square over its vertices.

        Parameters
        ----------
        squares : ndarray, shape (p, n)
            As from `held_out`, of all control features.
        loss, threshold : str and float
            As for `termsel.fitting.losses.rmse_like_figure`.
        """
        # A point counts once, a line as often as it has vertices.
        errors = np.bincount(self._vertices[0]).astype(np.float64)
        return rmse_like_figure(np.sqrt(squares / errors), self.in_use * errors, loss, threshold)
