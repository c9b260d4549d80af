"""Ridge regression, the baseline that shrinks coefficients and keeps all terms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from termsel.adjustment.solve import TOLERANCE, Spectrum, choose_penalty
from termsel.core.options import Option
from termsel.data.features import BoolArray, FloatArray
from termsel.selection.problems.base import Problem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.regression.base import (
    Regression,
    generation_of,
    regressions_of_problem,
)


class Ridge(Solver):
    """Ridge regression: all terms stay, their coefficients are shrunk.

    Hoerl, Kennard 1970; for RPCs Tao, Hu 2001, PE&RS 67(12), p. 1347, with the L-curve Zhou
    et al. 2018, ISPRS Archives XLII-3. Minimises |y - A x|^2 + penalty^2 |x|^2 for line and
    sample each with its own penalty, chosen on the control rows alone: the least generalised
    cross-validation (Golub, Heath, Wahba 1979), or the corner of the L-curve, its point of
    largest curvature (Hansen, O'Leary 1993). termsel's own choices: columns have unit length
    once the constant is taken out, and the constant is not penalised; the equations are the
    linearised ones, not reweighted.

    Genes do not express how much a coefficient is shrunk, so the details of the generation hold
    the coefficients, in the order of the model's terms and for scaled coordinates. The
    generation's evaluation is that of all terms without a penalty. With fewer equations than
    terms GCV tends to no penalty at all, and the L-curve has no true corner, since nothing
    bounds the residuals from below.
    """

    name = "ridge"
    uses_chance = False
    ends_by_itself = True
    uses_all = True
    declared_options = (
        Option("choice", "gcv", "Choice of the penalty: generalised cross-validation, or the "
                                "corner of the L-curve.", choices=("gcv", "l-curve")),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield all terms, with their coefficients (see `Solver.generations`)."""
        of_axes = regressions_of_problem(problem)
        all_terms = [regression.free | regression.kept for regression in of_axes]
        generation = generation_of(problem, of_axes, all_terms, rng)
        coefficients = np.zeros((of_axes[0].target.shape[1], problem.genome.size))
        penalties = []
        for regression in of_axes:
            genes = regression.genes
            coefficients[:, genes], penalty = shrink(regression, generation.genes[0, genes],
                                                     self.options["choice"])
            penalties.append(penalty)
        # With one mask for both axes, the line's coefficients come before the sample's.
        yield replace(generation, details={"coefficients": coefficients.ravel(),
                                           "penalties": tuple(penalties)})


def shrink(regression: Regression, on: BoolArray, choice: str) -> tuple[FloatArray, float]:
    """Return ridge coefficients (r, k) of the columns that are on, and their penalty.

    The penalty, chosen by "gcv" or "l-curve", is for columns of unit length.
    """
    penalised = on & ~regression.constant
    constant = on & regression.constant
    unpenalised = regression.columns[:, constant]
    standard = regression.standardised(penalised, constant)
    u, s, vt = np.linalg.svd(standard.columns, full_matrices=False)
    # Directions that are rounding error would be divided by next to nothing.
    live = s > TOLERANCE * s.max(initial=0.0)
    u = u[:, live]
    s = s[live]
    vt = vt[live]
    inner = u.T @ standard.target
    x = np.zeros((len(on), regression.target.shape[1]))
    penalty = 0.0
    if len(s):
        # A target that is explained leaves rounding, which must not choose the penalty.
        outside = float(((standard.target - u @ inner) ** 2).sum())
        spectrum = Spectrum(s, np.linalg.norm(inner, axis=1),
                            0.0 if regression.explained(outside) else outside,
                            len(standard.target) - unpenalised.shape[1])
        penalty = choose_penalty(spectrum, choice)
        # x = V diag(s / (s^2 + penalty^2)) U'y, then for columns of their own length.
        x[penalised] = (vt.T @ ((s / (s**2 + penalty**2))[:, None] * inner)
                        / standard.lengths[:, None])
    # The constant fits what the penalised columns leave.
    x[constant] = np.linalg.lstsq(unpenalised, regression.target - regression.columns @ x)[0]
    return x.T, penalty
