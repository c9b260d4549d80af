"""Criteria: how good a population of fitted models is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from termsel.features import BoolArray, FloatArray, Points
from termsel.models.base import SensorModel
from termsel.options import Configurable


def predict(model: SensorModel, coefficients: FloatArray, control: Points,
            ground: FloatArray) -> FloatArray:
    """Return image positions, with the correction an interpolating model adds.

    Parameters
    ----------
    model : SensorModel
    coefficients : ndarray, shape (..., k)
    control : Points
        Control points in scaled coordinates, whose residuals an interpolating model spreads.
    ground : ndarray, shape (n, 3)
        Scaled.

    Returns
    -------
    ndarray, shape (..., n, 2)
        Scaled line and sample.
    """
    image = model.project(coefficients, ground)
    weights = model.residual_weights(control.ground, ground) if len(control) else None
    if weights is not None:
        image = image + weights @ (control.image - model.project(coefficients, control.ground))
    return image


@dataclass(frozen=True, eq=False)
class Fits:
    """A population of fitted models, as a criterion sees it.

    Parameters
    ----------
    model : SensorModel
    control, check : Points
        In scaled coordinates.
    pixels : float
        Pixels per scaled image unit.
    terms : ndarray of bool, shape (p, k)
        Terms in use.
    coefficients : ndarray, shape (p, k)
    """

    model: SensorModel
    control: Points
    check: Points
    pixels: float
    terms: BoolArray
    coefficients: FloatArray

    @cached_property
    def check_errors(self) -> FloatArray:
        """Predicted minus measured line and sample of the check points [pixel], (p, n, 2)."""
        predicted = predict(self.model, self.coefficients, self.control, self.check.ground)
        return np.asarray((predicted - self.check.image) * self.pixels)


class Criterion(Configurable, ABC):
    """A figure of merit of fitted models; smaller is better."""

    subset_score: ClassVar[str] = ""
    """Score of `termsel.adjustment.subsets.search` from which the figure follows, if any."""

    @abstractmethod
    def score(self, fits: Fits) -> FloatArray:
        """Return one figure for each of the p fitted models, shape (p,)."""

    def subset_cost(self, scores: FloatArray) -> FloatArray:
        """Return what adds up over line and sample, from the best score of each size.

        Parameters
        ----------
        scores : ndarray, shape (k + 1,)
            Of the best selections of 0 to k terms of one part.
        """
        return scores


class CheckRmse(Criterion):
    """RMSE over the check points [pixel]: the fitness of all five papers.

    sqrt(mean(dl^2 + ds^2)) over points. A search drives it below what the model achieves
    elsewhere, so it is never an accuracy.
    """

    name = "check-rmse"
    subset_score = "check"

    def score(self, fits: Fits) -> FloatArray:
        """Return the RMSE [pixel]."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(np.sqrt((fits.check_errors**2).sum(axis=2).mean(axis=1)))
