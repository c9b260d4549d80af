"""Public base of criteria: a population of fitted models in, one figure for each out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from termsel.core.isolation.arrays import difference_from_shape
from termsel.core.isolation.calls import Check
from termsel.core.options import Configurable
from termsel.data.features import (
    FloatArray,
    IntArray,
    Points,
)
from termsel.fitting.population import Fits

if TYPE_CHECKING:
    from termsel.selection.best_subsets.columns.system import SubsetSystem


def _score_fault(_criterion: Criterion, value: Any, fits: Fits) -> str | None:
    """Return how figures of merit are at fault, such as a wrong shape; None if they are not."""
    return difference_from_shape(value, (len(fits.terms),), finite=False)


class Criterion(Configurable, ABC):
    """A figure of merit of fitted models; smaller is better.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> class LargestError(termsel.Criterion):
    ...     "Largest error at selection points."
    ...     name = "largest-error"
    ...     needs_check = True
    ...
    ...     def score(self, fits):  # a population of p models
    ...         return np.linalg.norm(fits.check_errors, axis=2).max(axis=1)
    >>> LargestError().name
    'largest-error'
    """

    kind = "criterion"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "score": _score_fault, "subset_cost": None, "subset_folds": None}

    needs_check: ClassVar[bool] = True
    """Whether the figure requires selection points."""

    is_rmse: bool = True
    """Whether the figure is an RMSE [px], for which a standard error can be given."""

    in_px: bool = False
    """Whether the figure is a size of errors [px], as every RMSE is. Of selections that leave
    rounding alone, the one with fewest terms is then the best."""

    subset_score: str = ""
    """Score of `termsel.selection.best_subsets.subsets.search` from which the figure follows, if
    any."""

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
        """Return the control points held out together, an array of indices each; () by default.

        If there are any, the subset score is "kfold".
        """
        return ()


class CheckRmse(Criterion):
    """RMSE over the selection points [px]: what a search minimises by default.

    sqrt(mean(dl^2 + ds^2)) over points. A search minimises it below what the model achieves
    elsewhere, so it is not an estimate of the accuracy.
    """

    name = "check-rmse"
    subset_score = "check"

    def score(self, fits: Fits) -> FloatArray:
        """Return the RMSE at the check features of each individual, (p,) [px]."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(np.sqrt((fits.check_errors**2).sum(axis=2).mean(axis=1)))
