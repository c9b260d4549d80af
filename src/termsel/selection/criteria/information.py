"""Criteria that weigh the residuals of the control against the number of terms."""

from __future__ import annotations

from math import comb, log
from typing import TYPE_CHECKING

import numpy as np

from termsel.adjustment.leave_out import IndependentPart
from termsel.adjustment.solve import ROUNDING
from termsel.core.errors import TermselError
from termsel.core.options import COUNT, Option
from termsel.core.remedies import Remedy
from termsel.data.features import FloatArray, IntArray
from termsel.fitting.population import Fits
from termsel.selection.criteria.base import Criterion

if TYPE_CHECKING:
    from termsel.selection.best_subsets.columns.system import SubsetSystem


class Ebic(Criterion):
    """Extended Bayesian information criterion of the control residuals; not in px.

    n ln(RSS / n) + k ln n + 2 gamma ln C(P, j), added up over line and sample if they are
    independent: n equations, k terms in use, j of them chosen from the P that may be chosen, RSS of
    the linearised, weighted residuals in the scaled image unit, at least that of rounding. Terms
    that are forced on are no choice, and those forced off are not offered. Plain BIC lacks the last
    part: the more selections of a size there are, the better one of them fits by chance. Terms of
    line and sample that are switched together are one choice and one system with a common variance.
    Above P / 2 terms ln C(P, j) is that of P / 2: the number of selections falls again there, down
    to the single one of all terms, which would make the largest selection of few terms the
    cheapest. The paper asks of at most so many terms that it grows.

    The criterion is valid for n much larger than k. As k nears n, ln(RSS / n) falls without
    bound, and a meaningless term lowers n ln(RSS / n) by about n / (n - k) instead of 1.
    Selections with less redundancy than `min_redundancy` therefore have no figure. At the
    default, a third of the equations, the gain is 3, about the penalty ln n of such a term for
    20 equations. A search finds the luckiest of many such terms: if control is plentiful, two
    thirds are better. As n must be the same, the criterion cannot select features. It needs no
    selection points.

    References
    ----------
    Chen and Chen 2008, Biometrika 95(3), eq. 2.
    """

    name = "ebic"
    needs_check = False
    is_rmse = False
    subset_score = "rss"
    declared_options = (
        Option("gamma", 1.0, "Weight of the number of possible selections; 0 is BIC.", float, 0,
               1),
        Option("min_redundancy", None, "Least number of equations minus terms, for line and for "
                                       "sample; by default a third of the equations, and at least "
                                       "1.", int, 1, COUNT),
    )

    def score(self, fits: Fits) -> FloatArray:
        """Return the criterion of each individual, (p,), added up over its independent systems.

        See the class for the equation. Raises TermselError for a selection of features: likelihoods
        of different observations cannot be compared.
        """
        if fits.used is not None:
            raise TermselError("criterion 'ebic' cannot select control features, as it compares "
                               "models of the same observations",
                               hint=f"Choose {Remedy('criterion', 'check-rmse')}, press or kfold.")
        genes = fits.gene_of_term
        genes = np.arange(fits.terms.shape[1]) if genes is None else genes
        optional = np.ones(len(genes), dtype=bool) if fits.optional is None else fits.optional
        total = np.zeros(len(fits.terms))
        for systems in _chosen_together(fits.parts, genes):
            columns = np.flatnonzero(np.any([system.columns for system in systems], axis=0))
            # Terms of one gene are one choice: the first of them stands for all.
            first = columns[np.unique(genes[columns], return_index=True)[1]]
            first = first[optional[first]]
            # Systems that share genes have a common variance: their squares are pooled.
            rss = np.sum([_residual_sums(system, fits.coefficients[:, system.columns])
                          for system in systems],
                         axis=0)
            total += self._criterion_of_system(rss,
                                               sum(len(system.equations.b) for system in systems),
                                               fits.terms[:, columns].sum(axis=1), len(first),
                                               fits.terms[:, first].sum(axis=1))
        return total

    def subset_cost(self, scores: FloatArray, system: SubsetSystem) -> FloatArray:
        """Return the criterion of the best selection of each size, (k + 1,), of one part.

        `scores` (k + 1,) are the sums of squared residuals of these selections.
        """
        m, k = system.design.shape
        axes = system.target.shape[1]
        sizes = np.arange(len(scores))
        forced = 0 if system.forced is None else int(system.forced.sum())
        never = 0 if system.forbidden is None else int(system.forbidden.sum())
        offered = k - forced - never
        # Sizes that no selection has score infinitely; their choices only have to be numbers.
        return self._criterion_of_system(scores, m * axes, sizes * axes, offered,
                                         np.clip(sizes - forced, 0, offered))

    def _criterion_of_system(self, rss: FloatArray, n: int, k: IntArray, offered: int,
                             n_chosen: IntArray) -> FloatArray:
        """Return the criterion of one system, (p,): n equations, k terms, n_chosen of `offered`.

        `rss` (p,) are the residual sums of squares of p selections.
        """
        min_redundancy = self.options["min_redundancy"]
        min_redundancy = max(1, round(n / 3)) if min_redundancy is None else min_redundancy
        choices = log_choices(offered)
        # RSS / n of what is explained to rounding counts as rounding.
        # n ln(RSS / n) + k ln n + 2 gamma ln C(P, j)
        value = (n * np.log(np.maximum(rss / n, ROUNDING**2)) + k * log(n)
                 + 2 * self.options["gamma"] * choices[n_chosen])
        return np.where(n - k >= min_redundancy, value, np.inf)


def log_choices(offered: int) -> FloatArray:
    """Return ln C(P, min(j, P / 2)), (P + 1,), for j = 0, ..., P of P terms that are offered.

    The number of selections of j terms is largest at P / 2; see `Ebic` for what is above.
    """
    return np.array([log(comb(offered, min(size, offered // 2))) for size in range(offered + 1)])


def _chosen_together(systems: tuple[IndependentPart, ...],
                     genes: IntArray) -> list[tuple[IndependentPart, ...]]:
    """Return the parts; parts with common genes are joined."""
    of_parts = [set(genes[system.columns].tolist()) for system in systems]
    if len(systems) == 2 and of_parts[0] & of_parts[1]:
        return [systems]
    return [(system,) for system in systems]


def _residual_sums(system: IndependentPart, coefficients: FloatArray) -> FloatArray:
    """Return residual sums of squares, shape (p,)."""
    return np.asarray(((system.equations.b - coefficients @ system.equations.A.T)**2).sum(axis=1))
