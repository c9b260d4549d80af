"""Public base of criteria: a population of fitted models in, one figure for each out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from termsel.adjustment.equations import line_normals
from termsel.adjustment.parts import IndependentPart
from termsel.criteria.losses import SQUARES, figure
from termsel.fits.fittable import Fittable
from termsel.guard.arrays import of_shape
from termsel.guard.calls import Check
from termsel.measurements.features import (
    BoolArray,
    FeatureSet,
    FloatArray,
    IntArray,
    Lines,
    Points,
    no_lines,
)
from termsel.models.poles import pole_margin
from termsel.models.quotient import RationalModel
from termsel.options import Configurable

if TYPE_CHECKING:
    from termsel.enumeration.columns.system import SubsetSystem


@dataclass(frozen=True, eq=False)
class Fits:
    """A population of fitted models, as criteria get it.

    Parameters
    ----------
    model : Fittable
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
        The systems from which the coefficients were solved. Criteria of the check points alone
        need neither these nor what follows.
    used : ndarray of bool, shape (p, n), optional
        Control features in use, points before lines; None if features are not selected.
    gene_of_term : ndarray of int, shape (k,), optional
        Terms with the same number are switched together; None if each is switched alone.
    optional : ndarray of bool, shape (k,), optional
        Terms that may be chosen: neither in all selections nor in none; None if all may be.
    """

    model: Fittable
    control: Points
    check: Points
    pixels: float
    terms: BoolArray
    coefficients: FloatArray
    lines: Lines = field(default_factory=no_lines)
    parts: tuple[IndependentPart, ...] = ()
    used: BoolArray | None = None
    gene_of_term: IntArray | None = None
    optional: BoolArray | None = None

    @cached_property
    def check_errors(self) -> FloatArray:
        """Predicted minus measured line and sample of the check points [px], (p, n, 2)."""
        control, ground = FeatureSet(self.control, self.lines), self.check.ground
        if self.used is not None and self.model.corrects:  # each by the features that it uses
            predicted = np.stack([self.model.predict(one, control.take(used), ground)
                                  for one, used in zip(self.coefficients, self.used, strict=True)])
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
        features : ndarray of int, shape (n,)
            In ascending order: points before lines.

        Returns
        -------
        ndarray, shape (p, n)
            Of a point dl^2 + ds^2, of a line the sum of the squared distances of its ground
            vertices from the image line [px^2]; infinite if a denominator is below
            `termsel.models.poles.pole_margin`.
        """
        owner, ground = self._vertices
        seen = np.isin(owner, features)
        others = FeatureSet(self.control, self.lines)
        if self.model.corrects:
            others = others.take(~np.isin(np.arange(len(others)), features))
        with np.errstate(over="ignore", invalid="ignore"):
            image = self.model.predict(coefficients, others, ground[seen])
            return self._squares(image, self.model.denominators(coefficients, ground[seen]),
                                 features)

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
        model, features = self.model, np.arange(len(coefficients))
        if not isinstance(model, RationalModel) or model.corrects:
            return np.concatenate([self.held_out(one, features[i:i + 1])
                                   for i, one in enumerate(coefficients)], axis=1)
        # Numerators and denominators are linear: those of unit vectors suffice.
        owner, ground = self._vertices
        solutions = coefficients[owner] if len(self.lines) else coefficients
        one_each = np.eye(coefficients.shape[2])
        below = model.denominators(one_each, ground)
        above = np.nan_to_num(model.project(one_each, ground))  # 0 / 0 of a denominator's term
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            image = (solutions @ above.transpose(1, 0, 2)).transpose(1, 0, 2)
            if below is not None:
                below = 1.0 + (solutions @ (below - 1.0).transpose(1, 0, 2)).transpose(1, 0, 2)
                image = image / below
            return self._squares(image, below, features)

    @cached_property
    def _vertices(self) -> tuple[IntArray, FloatArray]:
        """Points and ground vertices of lines: their features and their positions."""
        features = FeatureSet(self.control, self.lines)
        return features.vertex_feature, features.ground_vertices()

    @cached_property
    def _image_lines(self) -> tuple[FloatArray, FloatArray]:
        return line_normals(self.lines)

    def _squares(self, image: FloatArray, below: FloatArray | None,
                 features: IntArray) -> FloatArray:
        """Return squared errors, given image positions and denominators of the vertices."""
        n = len(self.control)
        points, lines = features[features < n], np.isin(n + self.lines.feature, features)
        squares = ((image[:, :len(points)] - self.control.image[points])**2).sum(axis=2)
        if lines.any():
            normal, rho = (np.repeat(part[lines], 2, axis=0) for part in self._image_lines)
            distances = rho - (image[:, len(points):] * normal).sum(axis=2)
            squares = np.concatenate([squares, distances**2], axis=1)
        if below is not None:
            squares = np.where((below >= pole_margin(self.control)).all(axis=2), squares, np.inf)
        if lines.any():  # all vertices of a feature together
            owner = np.concatenate([points, n + np.repeat(self.lines.feature[lines], 2)])
            order = np.argsort(owner, kind="stable")
            squares = np.add.reduceat(squares[:, order],
                                      np.searchsorted(owner[order], features), axis=1)
        return np.asarray(squares * self.pixels**2)

    def rmse(self, squares: FloatArray, loss: str = SQUARES,
             threshold: float = 2.0) -> FloatArray:
        """Return the RMSE of the control in use, infinite without any, shape (p,).

        As everywhere, sqrt(mean(dl^2 + ds^2)) over points and over all vertices of lines; with
        another loss the error of a line is the root mean square of those of its vertices.

        Parameters
        ----------
        squares : ndarray, shape (p, n)
            As from `held_out`, of all control features.
        loss, threshold : str and float
            As for `termsel.criteria.losses.figure`.
        """
        errors = np.bincount(self._vertices[0]).astype(np.float64)
        return figure(np.sqrt(squares / errors), self.in_use * errors, loss, threshold)


def _score_fault(_criterion: Criterion, value: Any, fits: Fits) -> str | None:
    """Return what is wrong with figures of merit, if anything."""
    return of_shape(value, (len(fits.terms),), finite=False)


class Criterion(Configurable, ABC):
    """A figure of merit of fitted models; smaller is better."""

    kind = "criterion"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "score": _score_fault, "subset_cost": None, "subset_folds": None}

    needs_check: ClassVar[bool] = True
    """Whether the figure requires check points."""

    is_rmse: bool = True
    """Whether the figure is an RMSE [px], for which a standard error can be given."""

    in_px: bool = False
    """Whether the figure is a size of errors [px], as every RMSE is. Of selections that leave
    rounding alone, the one with fewest terms is then the best."""

    subset_score: str = ""
    """Score of `termsel.enumeration.subsets.search` from which the figure follows, if any."""

    @abstractmethod
    def score(self, fits: Fits) -> FloatArray:
        """Return one figure for each of the p fitted models, shape (p,).

        A model without a finite figure counts as unusable.
        """

    def subset_cost(self, scores: FloatArray, system: SubsetSystem) -> FloatArray:
        """Return the part of the figure that adds up over the parts, from the best score per size.

        Parameters
        ----------
        scores : ndarray, shape (k + 1,)
            Of the best selections of 0 to k terms of one part.
        system : SubsetSystem
            The part: m rows, k columns, and a right-hand side for each axis it is of.
        """
        return scores

    def subset_folds(self, control: Points) -> tuple[IntArray, ...]:
        """Return the control points held out together; any make the subset score "kfold"."""
        return ()


class CheckRmse(Criterion):
    """RMSE over the check points [px]: the fitness of all five papers.

    sqrt(mean(dl^2 + ds^2)) over points. A search minimises it below what the model achieves
    elsewhere, so it is not an estimate of the accuracy.
    """

    name = "check-rmse"
    subset_score = "check"

    def score(self, fits: Fits) -> FloatArray:
        """Return the RMSE [px]."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(np.sqrt((fits.check_errors**2).sum(axis=2).mean(axis=1)))
