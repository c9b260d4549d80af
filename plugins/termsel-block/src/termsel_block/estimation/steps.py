"""The steps of Gauss and Newton of a block, and what they make less."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from termsel import TermselError
from termsel_block.estimation import common
from termsel_block.estimation.equations import Seen, Shared, Solved, solve
from termsel_block.estimation.unknowns import Measured, State
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.control import OwnControl
from termsel_block.geometry.frame import FloatArray
from termsel_block.geometry.heights import Heights

CONVERGED = 1e-3  # px
_HALVINGS = 6  # of a step at most, less one
_ROBUST = 2.5  # standard deviations at which a weight is a half
_BLUNDERS, _AWAY = 0.05, 100.0  # share of blunders, and px over which they are anywhere
_LEAST_LEFT = 0.1  # share of an error that a residual of control shows, at least
_MOST_OWN = 0.99
"""Share of a feature's error that its own image follows, beyond which the others do not judge it.
"""
_QUANTILES = (np.arange(200) + 0.5) / 200
_UNSEEN = 1e4  # m, the most that a step moves a tie which no image in use sees


class Steps:
    """The measurements of a block, and the last step."""

    solved: Solved
    share = 1.0
    """Of the last step, that was taken."""

    def __init__(self, state: State, measured: Sequence[Measured], control: Sequence[OwnControl],
                 heights: Heights, shared: Sequence[Shared]) -> None:
        self.state = state
        self.measured = measured
        self.control = control
        self.heights = heights
        self.shared = shared
        self.slopes: dict[int, FloatArray] = {}
        self.kept: dict[int, tuple[Camera, FloatArray, FloatArray, FloatArray]] = {}
        self.design: dict[int, FloatArray] = {}
        """Rows of each image's control in the last equations."""
        self.weights: dict[int, FloatArray] = {}
        """And their weights, 1 where they count in full."""
        self.noise: dict[int, FloatArray] = {}
        """And their standard deviations [px], which each step then estimates again."""

    def step(self, robust: bool, wide: float = 1.0) -> None:
        """Make a step of Gauss and Newton, by weights that fall `wide` times as slowly as told.

        Where that is more than 1, control keeps its weight.
        """
        self.solved = self.linearised(self.state.variances, robust, wide)
        self._take(robust, wide)

    def linearised(self, variances: Sequence[FloatArray], robust: bool = False,
                   wide: float = 1.0) -> Solved:
        """Return the normal equations of a step, by variances of the parameters, and its solution.
        """
        state = self.state
        seen = []
        own = []
        right = []
        for i, (camera, mine, known) in enumerate(
                zip(state.cameras, self.measured, self.control, strict=True)):
            parameters = state.parameters[i]
            place = state.ties[mine.tie]
            computed, columns = self._computed(i)
            residual = mine.place - computed
            weight = np.where(state.in_use[i], state.sigma_ties**-2, 0.0)
            if robust:
                weight = weight * soft(np.hypot(*residual.T) / (wide * state.sigma_ties))
            if i not in self.slopes:
                self.slopes[i] = camera.slopes(parameters, place, computed)
            seen.append(Seen(mine.tie, camera.rows(parameters, place, columns), self.slopes[i],
                             residual, weight))
            block, rest = self._of_control(i, camera, known, robust and wide == 1.0)
            precision = np.diag(np.tile(1 / variances[i], 2))
            own.append(block + precision)
            right.append(rest - precision @ parameters.T.ravel())
        of_heights, normal, aim, of_ties, right_of_ties = common.of_heights(
            self.heights, state.ties)
        of_ties = of_ties + np.eye(3) * _UNSEEN**-2
        try:
            return solve([*seen, of_heights], [*own, normal], [*right, aim], of_ties,
                         right_of_ties, self.shared)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            raise TermselError("the block is not determined by its control and ties",
                               hint="Give control to an image, or RPCs, or more ties.") from error

    def _take(self, robust: bool, wide: float) -> None:
        """Take the step, or the part of it that does not make things worse."""
        state = self.state
        solved = self.solved
        heights = self.heights
        parameters = state.parameters
        ties = state.ties
        before = self._cost(robust, wide)
        offset = heights.offset
        start = [self._computed(i)[0] for i in range(len(parameters))]
        for halvings in range(_HALVINGS):
            self.share = 0.5**halvings
            state.ties = ties + self.share * solved.ties
            state.parameters = [
                camera.followed(old, self.share * step, at + self.share * moved,
                                state.ties[part.tie])
                for camera, old, step, at, moved, part in zip(
                    state.cameras, parameters, solved.steps[:-1], start, self._moves(),
                    solved.seen[:-1], strict=True)]
            heights.offset = offset + self.share * float(solved.steps[-1][0])
            with np.errstate(over="ignore", invalid="ignore"):
                after = self._cost(robust, wide)
            if after <= before * (1 + CONVERGED):
                return
        if not np.isfinite(after):  # no camera is there
            state.parameters = parameters
            state.ties = ties
            heights.offset = offset

    def _cost(self, robust: bool, wide: float) -> float:
        """Return what a step makes less: twice the negative logarithm of the posterior."""
        state = self.state
        of_ties, of_control = self.residuals()
        total = self.heights.cost(state.ties)
        for i, known in enumerate(self.control):
            total += float((state.parameters[i]**2 / state.variances[i][:, None]).sum())
            square = (of_ties[i]**2).sum(axis=1) / state.sigma_ties**2
            total += float((square / (1 + square / (wide * _ROBUST)**2 * robust))
                           @ state.in_use[i])
            square = (of_control[i] / (state.sigma_control * known.sigma))**2
            far = square / _ROBUST**2 * (robust and wide == 1.0)
            total += float((square / (1 + far)) @ state.control_in_use[i])
        return total

    def expected(self, i: int) -> FloatArray:
        """Return the standard deviations of the residuals of an image's control (n,) [px].

        A row that counts draws the image to itself, so that its residual is less than its error.
        One that is left out has the image's error in its residual, too.
        """
        known = self.control[i]
        if not len(known):
            return np.empty(0)
        rows = self.design[i]
        covariance = self.solved.own[i]
        square = self.noise[i]**2
        own = np.einsum("np,pq,nq->n", rows, covariance, rows) / square
        held = np.maximum(1 - self.weights[i] * own, _LEAST_LEFT)
        return np.asarray(np.sqrt(square * held * (held + own)))

    def score_of_control(self) -> dict[tuple[int, str], float]:
        """Return the logarithm of the density of each feature of control, by all the others.

        By image and feature. By the equations of the last step: leaving a feature out divides its
        residuals, and their variances, by what of them the others do not explain. Where that is
        next to nothing, they say nothing of it, and there is no entry. A feature is a blunder with
        a small probability, so that those which an adjustment has to leave out speak against it.
        """
        found: dict[tuple[int, str], float] = {}
        of_control = self.residuals()[1]
        for i, known in enumerate(self.control):
            names = np.array(known.feature)
            for name in dict.fromkeys(known.feature):
                at = np.flatnonzero(names == name)
                rows = self.design[i][at]
                sigma = self.noise[i][at]
                away = of_control[i][at]
                noise = np.diag(sigma**2)
                own = rows @ self.solved.own[i] @ rows.T
                spread = noise + own
                if self.state.control_in_use[i][at[0]]:
                    if np.linalg.eigvalsh(own / np.outer(sigma, sigma))[-1] > _MOST_OWN:
                        continue
                    gain = noise @ np.linalg.inv(noise - own)
                    spread = gain @ noise
                    away = gain @ away
                good = np.exp(-away @ np.linalg.solve(spread, away) / 2) / np.sqrt(
                    np.linalg.det(2 * np.pi * spread))
                found[i, name] = float(np.log(
                    (1 - _BLUNDERS) * good + _BLUNDERS / _AWAY**len(at)))
        return found

    def _computed(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Return places and columns of an image's ties; known parts are computed once for a state.
        """
        camera = self.state.cameras[i]
        ties = self.state.ties
        parameters = self.state.parameters[i]
        kept = self.kept.get(i)
        if kept is None or kept[0] is not camera or kept[1] is not ties:
            kept = camera, ties, *camera.first_order(ties[self.measured[i].tie])
            self.kept[i] = kept
        _, _, image, columns = kept
        return (image + columns @ parameters
                + camera.perspective(parameters, ties[self.measured[i].tie])), columns

    def _of_control(self, i: int, camera: Camera, known: OwnControl, robust: bool,
                    ) -> tuple[FloatArray, FloatArray]:
        """Return what an image's control adds to its normal equations."""
        m = len(camera.groups)
        if not len(known):
            return np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
        rows, residual = self._rows(i, camera, known)
        self.design[i] = rows
        self.noise[i] = sigma = self.state.sigma_control * known.sigma
        share = self.state.control_in_use[i].astype(float)
        if robust:
            share = share * soft(residual / sigma)
        self.weights[i] = share
        weight = share / sigma**2
        return (rows * weight[:, None]).T @ rows, (rows * weight[:, None]).T @ residual

    def _rows(self, i: int, camera: Camera, known: OwnControl) -> tuple[FloatArray, FloatArray]:
        """Return the rows (n, 2m) of an image's control, and the residuals [px]."""
        parameters = self.state.parameters[i]
        rows = np.einsum("na,nap->np", known.normal, camera.rows(
            parameters, known.local, camera.first_order(known.local)[1]))
        computed = camera.project(parameters, known.local)
        return rows, known.value - (known.normal * computed).sum(axis=1)

    def moved(self) -> FloatArray:
        """Return how far the last step moved any tie or control in each image, at most [px]."""
        return np.array([
            float(np.abs(moved[part.weight > 0] if len(part.tie) else step).max(initial=0.0))
            for part, step, moved in zip(self.solved.seen[:-1], self.solved.steps[:-1],
                                         self._moves(), strict=True)])

    def _moves(self) -> list[FloatArray]:
        """Return how far the last step moves the ties in each image, to first order [px]."""
        return [part.rows @ step + np.einsum("nai,ni->na", part.slopes, self.solved.ties[part.tie])
                for part, step in zip(self.solved.seen[:-1], self.solved.steps[:-1], strict=True)]

    def residuals(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the residuals of ties and of control in each image [px]."""
        state = self.state
        of_ties = []
        for i, mine in enumerate(self.measured):
            of_ties.append(mine.place - self._computed(i)[0])
        return of_ties, [self._rows(i, camera, known)[1] if len(known) else np.empty(0)
                         for i, (camera, known) in enumerate(
                             zip(state.cameras, self.control, strict=True))]


def soft(ratio: FloatArray) -> FloatArray:
    """Return weights that fall with the ratio of residual and standard deviation."""
    return np.asarray(1 / (1 + (ratio / _ROBUST) ** 2) ** 2)


def shrunk(share: float, axes: int) -> float:
    """Return what such weights make of the mean square of residuals that are no blunders.

    Parameters
    ----------
    share : float
        Variance of a residual over that of an error.
    axes : int
        Axes whose residuals have one weight.
    """
    square = chdtri(axes, _QUANTILES)
    weight = soft(np.sqrt(share * square))
    return float((weight @ square) / (axes * weight.sum()))
