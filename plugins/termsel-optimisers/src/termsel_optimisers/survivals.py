"""Further solvers for several objectives, with the algorithms of pymoo."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymoo.algorithms.moo.age2 import AGEMOEA2, AGEMOEA2Survival
from pymoo.algorithms.moo.nsga3 import HyperplaneNormalization
from pymoo.algorithms.moo.rvea import APDSurvival
from pymoo.algorithms.moo.sms import SMSEMOA
from pymoo.algorithms.moo.spea2 import SPEA2, SPEA2Survival
from pymoo.core.algorithm import Algorithm
from pymoo.core.problem import Problem as PymooProblem

from termsel.toolkit.searches import Nsga2

FloatArray = NDArray[np.float64]


class _AgeSurvival(AGEMOEA2Survival):
    """pymoo's, which divides by zero if a member is best in every objective."""

    def _do(self, problem: PymooProblem, *args: Any, **arguments: Any) -> Any:
        # A member of a later front may be at the distance 0 from the ideal point, and has an
        # infinite crowding then.
        with np.errstate(divide="ignore"):
            return super()._do(problem, *args, **arguments)

    @staticmethod
    def pairwise_distances(front: FloatArray, p: float) -> FloatArray:
        """Return the distances (m, m) of members along the front with the norm `p`.

        A front with `p` near 1 is straight; otherwise the distance is that of two chords, which
        meet in the middle of the arc.
        """
        on_front = _scale_to_unit_norm(front, p)
        if 0.95 < p < 1.05:
            return np.asarray(np.linalg.norm(on_front[:, None] - on_front, axis=-1))
        middle = _scale_to_unit_norm((on_front[:, None] + on_front) / 2, p)
        chords = np.linalg.norm(on_front[:, None] - middle, axis=-1)
        return np.asarray(chords + chords.T)


def _scale_to_unit_norm(points: FloatArray, p: float) -> FloatArray:
    """Return points (..., m) scaled to a p-norm of 1; the origin stays."""
    length = np.maximum(points, 0.0)
    length = (length**p).sum(axis=-1, keepdims=True) ** (1 / p)
    return np.asarray(points / np.where(length > 0, length, 1.0))


class _Spea2Survival(SPEA2Survival):
    """pymoo's, which divides by zero if all members are equal in an objective."""

    norm: Any

    def __init__(self) -> None:
        super().__init__(normalize=True)

    def _do(self, problem: PymooProblem, *args: Any, **arguments: Any) -> Any:
        self.norm = self.norm or _Ranges(problem.n_obj)
        return super()._do(problem, *args, **arguments)


class _Ranges(HyperplaneNormalization):
    """Ranges of the objectives, 1 where there is none."""

    nadir_point: Any

    def update(self, F: FloatArray, nds: Any = None) -> None:
        """Update the ranges by a population's objectives (p, m); one without extent counts as 1."""
        super().update(F, nds)
        self.nadir_point = np.where(self.nadir_point > self.ideal_point, self.nadir_point,
                                    self.ideal_point + 1.0)


class RveaSurvival(APDSurvival):
    """pymoo's, whose angles are undefined by rounding, and if all are equal in an objective."""

    V: FloatArray
    nadir: Any

    def __init__(self, directions: FloatArray) -> None:
        super().__init__(directions)
        self.V = self.V * _MAX_LENGTH

    def adapt(self) -> None:
        """Scale the directions by the ranges of the objectives, 1 where there is none."""
        if self.nadir is not None:
            self.nadir = np.where(self.nadir > self.ideal, self.nadir, self.ideal + 1.0)
        super().adapt()
        self.V = self.V * _MAX_LENGTH


_MAX_LENGTH = 1 - 1e-14
"""Length of a direction with which no cosine is above 1."""

_SURVIVALS = {AGEMOEA2: _AgeSurvival, SPEA2: _Spea2Survival}


def with_safe_survival(algorithm_class: type[Algorithm], **arguments: Any) -> Algorithm:
    """Return a pymoo algorithm, its survival replaced by one that does not divide by zero."""
    algorithm = algorithm_class(**arguments)
    if algorithm_class in _SURVIVALS:
        algorithm.survival = _SURVIVALS[algorithm_class]()
    return algorithm


class AgeMoea2(Nsga2):
    """AGE-MOEA-II: survival by proximity and diversity on an estimated front (Panichella 2022)."""

    name = "age-moea2"

    def algorithm(self, **arguments: Any) -> Algorithm:
        """Return pymoo's algorithm with a survival that does not divide by zero."""
        return with_safe_survival(AGEMOEA2, **arguments)


class SmsEmoa(Nsga2):
    """SMS-EMOA: survival by contribution to the dominated hypervolume (Beume et al. 2007)."""

    name = "sms-emoa"

    def algorithm(self, **arguments: Any) -> Algorithm:
        """Return pymoo's algorithm with a survival that does not divide by zero."""
        return with_safe_survival(SMSEMOA, **arguments)


class Spea2(Nsga2):
    """SPEA2: survival by strength and nearest neighbours (Zitzler et al. 2001).

    It replaces MOEA/D, whose pymoo version evaluates one selection at a time and has no
    constraints: that would mean no batches and no feasibility.
    """

    name = "spea2"

    def algorithm(self, **arguments: Any) -> Algorithm:
        """Return pymoo's algorithm with a survival that does not divide by zero."""
        return with_safe_survival(SPEA2, **arguments)
