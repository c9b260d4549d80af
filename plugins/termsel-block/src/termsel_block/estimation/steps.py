"""The steps of Gauss and Newton of a block, and the cost that they lessen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from termsel import TermselError
from termsel_block.estimation import common
from termsel_block.estimation.equations import Shared, Solved, TieRows, solve
from termsel_block.estimation.unknowns import BlockUnknowns, Measured
from termsel_block.geometry.cameras import Camera, Fixed
from termsel_block.geometry.control import OwnControl
from termsel_block.geometry.frame import FloatArray
from termsel_block.geometry.heights import Heights

CONVERGED = 1e-3
"""Largest move of a tie in an image [px], below which the steps end."""

_HALVINGS = 6
"""Most lengths of a step that are tried, each half of the one before."""

_HALF_WEIGHT = 2.5
"""Standard deviations at which a weight is a half."""

_BLUNDERS, _BLUNDER_RANGE = 0.05, 100.0
"""Share of features that are blunders, and the range of their errors [px]."""

_MIN_REMAINING = 0.1
"""Share of an error that a residual of control shows, at least."""

_MAX_OWN_SHARE = 0.99
"""Share of a feature's error that its own image follows, beyond which the others do not judge it.
"""
_QUANTILES = (np.arange(200) + 0.5) / 200
# In m, the most that a step moves a tie which no image in use sees.
_UNSEEN_MOVE = 1e4


class Steps:
    """A block that is being adjusted: its unknowns, its measurements and the last step."""

    solved: Solved
    share = 1.0
    """How much of the last step was taken."""

    def __init__(self, state: BlockUnknowns, measured: Sequence[Measured],
                 control: Sequence[OwnControl], heights: Heights, shared: Sequence[Shared]) -> None:
        self.state = state
        self.measured = measured
        self.control = control
        self.heights = heights
        self.shared = shared
        self.slopes: dict[int, FloatArray] = {}
        self.fixed_parts: dict[int, tuple[Camera, FloatArray, Fixed]] = {}
        """For each image, its camera and ties, and what no parameter changes at these ties."""
        self.design: dict[int, FloatArray] = {}
        """Rows of each image's control in the last equations."""
        self.weights: dict[int, FloatArray] = {}
        """Weights of these rows, 1 where they count in full."""
        self.noise: dict[int, FloatArray] = {}
        """Standard deviations of these rows [px], which each step then estimates again."""

    def step(self, robust: bool, wide: float = 1.0) -> None:
        """Make a Gauss-Newton step, shortened until the cost does not rise.

        If `robust`, ties and control with large residuals have less weight. With `wide` above 1 the
        weights of ties fall more slowly by that factor, and control keeps its weight.
        """
        self.solved = self.linearised(self.state.variances, robust, wide)
        self._take_step(robust, wide)

    def linearised(self, variances: Sequence[FloatArray], robust: bool = False,
                   wide: float = 1.0) -> Solved:
        """Return the solution of the normal equations of a step; the state does not change.

        `variances` are those of the priors of each image's parameters, V, (p,) for each image. The
        equations of an image are (A'PA + V^-1) dx = A'Pr - V^-1 x, with the derivatives A of its
        measurements, their weights P and residuals r. `robust` and `wide` are as in `step`. Raises
        TermselError if the block is not determined.
        """
        state = self.state
        tie_rows = []
        of_images = []
        right = []
        for i, (camera, measured, control) in enumerate(
                zip(state.cameras, self.measured, self.control, strict=True)):
            parameters = state.parameters[i]
            local = state.ties[measured.tie]
            computed = self._positions_of_ties(i)
            residual = measured.position - computed
            weight = np.where(state.in_use[i], state.sigma_ties**-2, 0.0)
            if robust:
                weight = weight * soft_weights(np.hypot(*residual.T) / (wide * state.sigma_ties))
            # Derivatives by the tie's position change little, and are kept until `slopes` is
            # emptied.
            if i not in self.slopes:
                self.slopes[i] = camera.slopes(parameters, local, computed)
            tie_rows.append(TieRows(measured.tie,
                                    camera.jacobian(parameters, local, self._fixed_at_ties(i)),
                                    self.slopes[i],
                                    residual, weight))
            block, of_control = self._equations_of_control(
                i, camera, control, robust and wide == 1.0
            )
            precision = np.diag(1 / variances[i])
            # Priors of zero mean add V^-1 to the matrix and -V^-1 x to the right side.
            of_images.append(block + precision)
            right.append(of_control - precision @ parameters)
        of_heights, normal, aim, of_ties, right_of_ties = common.height_equations(
            self.heights, state.ties)
        # A tie that no image in use sees would leave its equations singular.
        of_ties = of_ties + np.eye(3) * _UNSEEN_MOVE**-2
        try:
            return solve([*tie_rows, of_heights], [*of_images, normal], [*right, aim], of_ties,
                         right_of_ties, self.shared)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            raise TermselError("the block is not determined by its control and ties",
                               hint="Give control to an image, or RPCs, or more ties.") from error

    def _take_step(self, robust: bool, wide: float) -> None:
        """Take the step of `solved`, halved until the cost does not rise.

        `_HALVINGS` lengths are tried. The shortest step is taken even if the cost rises, unless the
        cost is not finite: then the state stays as it was.
        """
        state = self.state
        solved = self.solved
        heights = self.heights
        parameters = state.parameters
        ties = state.ties
        before = self._cost(robust, wide)
        offset = heights.offset
        start = [self._positions_of_ties(i) for i in range(len(parameters))]
        for halvings in range(_HALVINGS):
            self.share = 0.5**halvings
            state.ties = ties + self.share * solved.ties
            state.parameters = [
                camera.parameters_after_step(old, self.share * step, at + self.share * moved,
                                             state.ties[rows.tie])
                for camera, old, step, at, moved, rows in zip(
                    state.cameras, parameters, solved.steps[:-1], start, self._tie_moves(),
                    solved.tie_rows[:-1], strict=True)]
            heights.offset = offset + self.share * float(solved.steps[-1][0])
            # After a step too far no camera may see a tie: the cost is NaN then, and not accepted.
            with np.errstate(over="ignore", invalid="ignore"):
                after = self._cost(robust, wide)
            if after <= before * (1 + CONVERGED):
                return
        if not np.isfinite(after):
            state.parameters = parameters
            state.ties = ties
            heights.offset = offset

    def _cost(self, robust: bool, wide: float) -> float:
        """Return the cost that steps lower: -2 log of the posterior density, up to a constant.

        It is the sum of squares over variances of heights, priors, ties and control. `robust` and
        `wide` are as in `step`.
        """
        state = self.state
        of_ties, of_control = self.residuals()
        total = self.heights.cost(state.ties)
        for i, control in enumerate(self.control):
            total += float((state.parameters[i]**2 / state.variances[i]).sum())
            # The robust cost s / (1 + s / c^2) of a square s has the weights of `soft_weights`, and
            # is c^2 at most, whatever a blunder is.
            square = (of_ties[i]**2).sum(axis=1) / state.sigma_ties**2
            total += float((square / (1 + square / (wide * _HALF_WEIGHT)**2 * robust))
                           @ state.in_use[i])
            square = (of_control[i] / (state.sigma_control * control.sigma))**2
            far = square / _HALF_WEIGHT**2 * (robust and wide == 1.0)
            total += float((square / (1 + far)) @ state.control_in_use[i])
        return total

    def residual_deviations(self, i: int) -> FloatArray:
        """Return the standard deviations (n,) of the residuals of an image's control [px].

        A row that counts draws the image to itself, so that its residual is smaller than its error.
        The residual of one that is left out has the error of the image, too.
        """
        control = self.control[i]
        if not len(control):
            return np.empty(0)
        rows = self.design[i]
        covariance = self.solved.image_covariances[i]
        square = self.noise[i]**2
        # a C a^T / s^2 of each row a: the variance of the predicted position over that of the
        # measurement. A row of weight w keeps 1 - w a C a^T / s^2 of its error as residual.
        ratio = np.einsum("np,pq,nq->n", rows, covariance, rows) / square
        remaining = np.maximum(1 - self.weights[i] * ratio, _MIN_REMAINING)
        return np.asarray(np.sqrt(square * remaining * (remaining + ratio)))

    def score_of_control(self) -> dict[tuple[int, str], float]:
        """Return the logarithm of the density of each feature of control as the others predict it.

        Keys are the number of the image and the name of the feature. Predictions are by the
        equations of the last step. A feature that the others do not predict has no entry. With a
        small probability a feature is a blunder, so that one which was left out lowers the score.
        """
        score: dict[tuple[int, str], float] = {}
        of_control = self.residuals()[1]
        for i, control in enumerate(self.control):
            names = np.array(control.feature)
            for name in dict.fromkeys(control.feature):
                at = np.flatnonzero(names == name)
                rows = self.design[i][at]
                sigma = self.noise[i][at]
                residual = of_control[i][at]
                noise = np.diag(sigma**2)
                by_image = rows @ self.solved.image_covariances[i] @ rows.T
                spread = noise + by_image
                # Left out, the feature has residuals (I - H)^-1 r, with H = a C a^T / s^2.
                if self.state.control_in_use[i][at[0]]:
                    if np.linalg.eigvalsh(by_image / np.outer(sigma, sigma))[-1] > _MAX_OWN_SHARE:
                        continue
                    gain = noise @ np.linalg.inv(noise - by_image)
                    spread = gain @ noise
                    residual = gain @ residual
                # The density is a mixture: normal for good control, uniform for a blunder.
                density = np.exp(-residual @ np.linalg.solve(spread, residual) / 2) / np.sqrt(
                    np.linalg.det(2 * np.pi * spread))
                score[i, name] = float(np.log(
                    (1 - _BLUNDERS) * density + _BLUNDERS / _BLUNDER_RANGE**len(at)))
        return score

    def _fixed_at_ties(self, i: int) -> Fixed:
        """Return the part of an image's model at its ties that does not depend on parameters.

        It is kept until the camera or the ties are replaced.
        """
        camera = self.state.cameras[i]
        ties = self.state.ties
        # Camera and ties are replaced, never changed: identity shows whether they are the same.
        if i not in self.fixed_parts or not (
                self.fixed_parts[i][0] is camera and self.fixed_parts[i][1] is ties):
            self.fixed_parts[i] = camera, ties, camera.fixed(ties[self.measured[i].tie])
        return self.fixed_parts[i][2]

    def _positions_of_ties(self, i: int) -> FloatArray:
        """Return line and sample (n, 2) [px] of an image's ties by its model."""
        local = self.state.ties[self.measured[i].tie]
        return self.state.cameras[i].project(self.state.parameters[i], local,
                                             self._fixed_at_ties(i))

    def _equations_of_control(self, i: int, camera: Camera, control: OwnControl, robust: bool,
                              ) -> tuple[FloatArray, FloatArray]:
        """Return what an image's control adds to its normal matrix (p, p) and right side (p,).

        Both are zeros without control. Rows, weights and deviations of the equations are kept in
        `design`, `weights` and `noise`.
        """
        p = len(camera.groups)
        if not len(control):
            return np.zeros((p, p)), np.zeros(p)
        rows = self._control_rows(i, camera, control)
        residual = self._control_residuals(i, camera, control)
        self.design[i] = rows
        self.noise[i] = sigma = self.state.sigma_control * control.sigma
        # A share is the weight of a row by its residual: 0 for control that is not in use.
        share = self.state.control_in_use[i].astype(float)
        if robust:
            share = share * soft_weights(residual / sigma)
        self.weights[i] = share
        weight = share / sigma**2
        return (rows * weight[:, None]).T @ rows, (rows * weight[:, None]).T @ residual

    def _control_rows(self, i: int, camera: Camera, control: OwnControl) -> FloatArray:
        """Return the rows (n, p) of an image's control."""
        # Derivatives of the distance in the direction that is measured, n . (line, sample).
        slopes = camera.jacobian(self.state.parameters[i], control.local,
                                 camera.fixed(control.local))
        return np.asarray(np.einsum("na,nap->np", control.normal, slopes))

    def _control_residuals(self, i: int, camera: Camera, control: OwnControl) -> FloatArray:
        """Return the residuals (n,) of an image's control [px]."""
        computed = camera.project(self.state.parameters[i], control.local,
                                  camera.fixed(control.local))
        return np.asarray(control.value - (control.normal * computed).sum(axis=1))

    def moved(self) -> FloatArray:
        """Return the largest move of a tie in each image by the last step, (images,) [px].

        For an image without ties it is the largest step of a parameter, which is in px, too.
        """
        return np.array([
            float(np.abs(moved[rows.weight > 0] if len(rows.tie) else step).max(initial=0.0))
            for rows, step, moved in zip(self.solved.tie_rows[:-1], self.solved.steps[:-1],
                                         self._tie_moves(), strict=True)])

    def _tie_moves(self) -> list[FloatArray]:
        """Return the moves (n, 2) [px] of each image's ties by the last step, to first order."""
        # dx of the parameters and dX of the ties move a position by A dx + B dX.
        return [rows.rows @ step + np.einsum("nai,ni->na", rows.slopes, self.solved.ties[rows.tie])
                for rows, step in zip(self.solved.tie_rows[:-1], self.solved.steps[:-1],
                                      strict=True)]

    def residuals(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the residuals of each image's ties (n, 2) and of its rows of control (k,) [px].

        They are measured minus computed, by the parameters and ties as they are now.
        """
        state = self.state
        of_ties = []
        of_control = []
        for i, (camera, measured, control) in enumerate(
                zip(state.cameras, self.measured, self.control, strict=True)):
            of_ties.append(measured.position - self._positions_of_ties(i))
            of_control.append(self._control_residuals(i, camera, control) if len(control)
                              else np.empty(0))
        return of_ties, of_control


def soft_weights(ratio: FloatArray) -> FloatArray:
    """Return weights 1 / (1 + (r / c)^2)^2 of residuals r in standard deviations, 1 at r = 0."""
    return np.asarray(1 / (1 + (ratio / _HALF_WEIGHT) ** 2) ** 2)


def shrinkage_of_mean_square(share: float, axes: int) -> float:
    """Return the factor by which `soft_weights` lower the mean square of normal residuals.

    Parameters
    ----------
    share : float
        Variance of a residual over that of an error.
    axes : int
        Axes whose residuals have one weight.
    """
    square = chdtri(axes, _QUANTILES)
    weight = soft_weights(np.sqrt(share * square))
    return float((weight @ square) / (axes * weight.sum()))
