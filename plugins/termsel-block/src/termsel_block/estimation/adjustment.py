"""The adjustment of a block: steps, robust weights, variances by evidence, and what is dropped."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from termsel import TermselError
from termsel_block.estimation import common
from termsel_block.estimation.equations import Seen, Shared, Solved, pairs, solve
from termsel_block.estimation.unknowns import Adjusted, Measured, State
from termsel_block.evidence.factors import log_bayes_factor
from termsel_block.evidence.growing import CHANCE, chance_of
from termsel_block.evidence.variances import estimated
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.control import OwnControl
from termsel_block.geometry.frame import FloatArray
from termsel_block.geometry.heights import Heights

WRONG = 4.0
"""A measurement is a blunder if it is so many standard deviations off, in line or in sample."""

AGAINST = -1.0
"""Logarithm of a Bayes factor below which a group is dropped; above, it stays and is shrunk."""

_PRIOR_COUNT = 4.0
"""Weight of the ties' precision in that of control, as so many points."""

MEDIAN = 2 / 3
"""What a distribution chi-square of n degrees of freedom has its median below n, about."""

_CONVERGED = 1e-3  # px
_SETTLED = 0.02  # relative change of a standard deviation
_STEPS = 15  # of one stage at most
_BENT = 3  # first steps of a stage, in which derivatives are renewed
_WIDE = (8.0, 4.0, 2.0)  # what weights are wider by in the first steps, while much is bent
_HALVINGS = 6  # of a step at most, less one
_TRUST = len(_WIDE)  # first steps, in which control keeps its weight
_ROBUST = 2.5  # standard deviations at which a weight is a half
_UNSEEN = 1e4  # m, the most that a step moves a tie which no image in use sees
_SLOW = 2500  # parameters of images from which variances are estimated once in a stage
_LEAST_SIGMA = 0.01  # px; without it data without noise would have infinite weights


def adjust_block(state: State, measured: Sequence[Measured], control: Sequence[OwnControl],
                 heights: Heights, *, progress: Callable[[float], None] | None = None,
                 fixed: Sequence[bool] = ()) -> Adjusted:
    """Adjust a block from its start.

    Parameters
    ----------
    state : State
        The start; it is changed.
    measured, control : sequence
        Of each image.
    heights : Heights
    progress : callable, optional
        Called with the share that is done.
    fixed : sequence of bool, optional
        Images whose correction is asked for, and not to be chosen.

    Notes
    -----
    Gauss-Newton steps with weights 1 / (1 + (r / 2.5 s)^2)^2 until blunders are told, then by plain
    least squares without them. Standard deviations of ties and control, and the variance of each
    image's groups of columns (`evidence.variances`), are estimated on the way. A group whose Bayes
    factor, by the ratio of Savage and Dickey over the whole block's posterior, is below one is
    dropped. Columns for jitter are tried where residuals call for them (`evidence.growing`).
    """
    shared = pairs([*(part.tie for part in measured), np.arange(len(state.ties))], len(state.ties))
    run = _Run(state, measured, control, heights, shared)
    report = progress or _nothing
    state.in_use = state.in_use or [np.ones(len(part.tie), bool) for part in measured]
    state.control_in_use = state.control_in_use or [np.ones(len(part), bool) for part in control]
    steps = run.iterate(robust=True, limit=_STEPS, report=lambda s: report(0.4 * s))
    if run.grow(fixed):
        steps += run.iterate(robust=True, limit=_STEPS, report=_nothing)
    evidence: list[dict[str, float]] = [{} for _ in state.cameras]
    for _ in range(2):
        if not run.drop(evidence, fixed):
            break
        steps += run.iterate(robust=True, limit=_STEPS, report=lambda s: report(0.4 + 0.2 * s))
    for _ in range(3):
        if not run.leave_out():
            break
        steps += run.iterate(robust=False, limit=_STEPS,
                             report=lambda s: report(0.6 + 0.4 * s))
    steps += run.iterate(robust=False, limit=_STEPS, report=report)
    residuals, of_control = run.residuals()
    return Adjusted(state, run.solved, residuals, of_control, evidence, steps, run.converged,
                    heights.offset, heights.sigma, run.freedom, run.moved())


class _Run:
    """The measurements of a block, and the last step."""

    solved: Solved
    converged = False
    freedom = np.nan
    share = 1.0
    """Of the last step, that was taken."""

    def __init__(self, state: State, measured: Sequence[Measured], control: Sequence[OwnControl],
                 heights: Heights, shared: Sequence[Shared]) -> None:
        self.state, self.measured, self.control = state, measured, control
        self.heights, self.shared = heights, shared
        self.slopes: dict[int, FloatArray] = {}
        self.kept: dict[int, tuple[Camera, FloatArray, FloatArray, FloatArray]] = {}
        self.design: dict[int, FloatArray] = {}
        """Rows of each image's control in the last equations."""
        self.large = sum(2 * len(camera.groups) for camera in state.cameras) > _SLOW

    def iterate(self, *, robust: bool, limit: int, report: Callable[[float], None]) -> int:
        """Make steps until nothing moves; return how many."""
        self.converged = False
        for step in range(limit):
            report(step / limit)
            # From weights that fall at once a lone control point would never return.
            if step < _BENT:
                self.slopes = {}
            self.step(robust, _WIDE[step] if robust and step < _TRUST else 1.0)
            moved = float(self.moved().max(initial=0.0))
            settled = True
            if step >= _TRUST and (not self.large or step == _TRUST):
                settled = self.estimate(robust)
            if step > _TRUST and moved < _CONVERGED and settled:
                self.converged = True
                return step + 1
        return limit

    def step(self, robust: bool, wide: float = 1.0) -> None:
        """Make a step of Gauss and Newton, by weights that fall `wide` times as slowly as told.

        Where that is more than 1, control keeps its weight.
        """
        state, seen, own, right = self.state, [], [], []
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
            precision = np.diag(np.repeat(1 / state.variances[i][None], 2, axis=0).ravel())
            own.append(block + precision)
            right.append(rest - precision @ parameters.T.ravel())
        of_heights, normal, aim, of_ties, right_of_ties = common.of_heights(
            self.heights, state.ties)
        of_ties = of_ties + np.eye(3) * _UNSEEN**-2
        try:
            self.solved = solve([*seen, of_heights], [*own, normal], [*right, aim], of_ties,
                                right_of_ties, self.shared)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            raise TermselError("the block is not determined by its control and ties",
                               hint="Give control to an image, or RPCs, or more ties.") from error
        self._take(robust, wide)

    def _take(self, robust: bool, wide: float) -> None:
        """Take the step, or the part of it that does not make things worse."""
        state, solved, heights = self.state, self.solved, self.heights
        parameters, ties, before = state.parameters, state.ties, self._cost(robust, wide)
        offset, start = heights.offset, [self._computed(i)[0] for i in range(len(parameters))]
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
            if after <= before * (1 + _CONVERGED):
                return
        if not np.isfinite(after):  # no camera is there
            state.parameters, state.ties, heights.offset = parameters, ties, offset

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

    def _computed(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Return places and columns of an image's ties; known parts are computed once for a state.
        """
        camera, ties, parameters = self.state.cameras[i], self.state.ties, self.state.parameters[i]
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
        sigma = self.state.sigma_control * known.sigma
        weight = np.where(self.state.control_in_use[i], sigma**-2, 0.0)
        if robust:
            weight = weight * soft(residual / sigma)
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

    def estimate(self, robust: bool) -> bool:
        """Estimate the standard deviations and variances; return whether they settled."""
        state = self.state
        covariances = self.solved.own[:-1]
        before = np.array([state.sigma_ties, state.sigma_control, self.heights.sigma])
        of_ties, of_control = self.residuals()
        determined = spent = rows = 0.0
        squares = 0.0
        for i, (known, covariance) in enumerate(zip(self.control, covariances, strict=True)):
            variances = np.tile(state.variances[i], 2)
            determined += float((1 - np.diag(covariance) / variances).sum())
            if len(known):
                used = state.control_in_use[i]
                sigma = state.sigma_control * known.sigma
                weight = soft(of_control[i] / sigma) if robust else np.ones(len(known))
                weight = weight * used
                # Of the equations that the covariance is of: rows elsewhere do not cancel in it.
                design = self.design[i]
                hat = np.einsum("ni,ij,nj->n", design, covariance, design) / sigma**2
                spent += float((weight * hat).sum())
                rows += float(weight.sum())
                squares += float((weight * (of_control[i] / known.sigma) ** 2).sum())
        total, weights, each = 0.0, 0.0, np.zeros(len(state.ties))
        for mine, residual, used in zip(self.measured, of_ties, state.in_use, strict=True):
            weight = used * (soft(np.hypot(*residual.T) / state.sigma_ties) if robust
                             else np.ones(len(used)))
            total += float((weight * (residual**2).sum(axis=1)).sum())
            weights += 2 * float(weight.sum())
            np.add.at(each, mine.tie, weight)
        # The place of a tie takes three measurements, or as many as it has.
        freedom = float(
            weights - np.minimum(2 * each, 3).sum() - max(determined - spent, 0.0))
        self.freedom = freedom + rows - spent
        if freedom > 1:
            state.sigma_ties = max(float(np.sqrt(total / freedom)), _LEAST_SIGMA)
        # Few points say little of their own precision: the ties' counts as four of them. This is
        # about the median of the posterior, whose mean is far above it where points are few.
        expected = max(rows - spent, 0.0)
        state.sigma_control = float(np.sqrt((squares + _PRIOR_COUNT * state.sigma_ties**2)
                                            / (expected + _PRIOR_COUNT - MEDIAN)))
        state.freedom_control = expected + _PRIOR_COUNT
        state.variances = estimated(
            state.cameras, state.parameters, covariances, state.variances)
        self.heights.estimate(state.ties, self.solved.of_ties, each > 1.0)
        after = np.array([state.sigma_ties, state.sigma_control, self.heights.sigma])
        return bool(np.abs(after / before - 1).max() < _SETTLED)

    def grow(self, fixed: Sequence[bool]) -> bool:
        """Add columns to the images whose residuals call for them; return whether any do."""
        state, grown = self.state, False
        for i, (camera, mine, residual) in enumerate(zip(
                state.cameras, self.measured, self.residuals()[0], strict=True)):
            more = None if len(fixed) and fixed[i] else camera.grown()
            if more is None or not len(mine.tie):
                continue
            had = len(camera.groups)
            weight = soft(np.hypot(*residual.T) / state.sigma_ties) / state.sigma_ties**2
            columns = more.first_order(state.ties[mine.tie])[1][:, had:]
            if chance_of(columns, residual, weight) < CHANCE:
                grown, state.cameras[i] = True, more
                state.parameters[i] = np.concatenate(
                    [state.parameters[i], np.zeros((len(more.groups) - had, 2))])
                state.variances[i] = np.concatenate(
                    [state.variances[i], np.square(more.spread[had:])])
        return grown

    def drop(self, evidence: list[dict[str, float]], fixed: Sequence[bool]) -> bool:
        """Drop the groups that the evidence is against; return whether there were any."""
        state, dropped = self.state, False
        for i, (camera, covariance) in enumerate(
                zip(state.cameras, self.solved.own[:-1], strict=True)):
            if len(fixed) and fixed[i]:
                continue
            names = np.tile(camera.groups, 2)
            groups = [name for name in dict.fromkeys(camera.groups) if name not in camera.kept]
            out: set[str] = set()
            for name in reversed(groups):
                at = np.flatnonzero(names == name)
                evidence[i][name] = log_bayes_factor(
                    state.parameters[i].T.ravel()[at], covariance[np.ix_(at, at)],
                    np.tile(state.variances[i], 2)[at])
                if evidence[i][name] < AGAINST:
                    out.add(name)
                elif camera.nested:  # one can go only after all that follow it
                    break
            if out:
                dropped = True
                keep = np.array([name not in out for name in camera.groups])
                state.cameras[i] = camera.only(keep)
                state.parameters[i] = state.parameters[i][keep]
                state.variances[i] = state.variances[i][keep]
        return dropped

    def leave_out(self) -> bool:
        """Mark measurements as blunders, and take back what agrees; return whether any changed."""
        state = self.state
        of_ties, of_control = self.residuals()
        changed = False
        away, rays = np.zeros(len(state.ties)), np.zeros(len(state.ties))
        for mine, residual in zip(self.measured, of_ties, strict=True):
            np.add.at(away, mine.tie, np.abs(residual).max(axis=1, initial=0.0))
            np.add.at(rays, mine.tie, 1)
        for i, (mine, residual) in enumerate(zip(self.measured, of_ties, strict=True)):
            good = np.abs(residual).max(axis=1, initial=0.0) <= WRONG * state.sigma_ties
            # Weights that fall give what two rays differ by to one of them, whichever that is.
            good |= (rays[mine.tie] == 2) & (
                away[mine.tie] <= WRONG * np.sqrt(2) * state.sigma_ties)
            changed |= bool((good != state.in_use[i]).any())
            state.in_use[i] = good
        count = np.zeros(len(state.ties))
        for mine, used in zip(self.measured, state.in_use, strict=True):
            np.add.at(count, mine.tie, used)
        for i, mine in enumerate(self.measured):  # one ray alone says nothing
            state.in_use[i] = state.in_use[i] & (count[mine.tie] > 1)
        for i, (residual, known) in enumerate(zip(of_control, self.control, strict=True)):
            wrong = np.abs(residual) > WRONG * state.sigma_control * known.sigma
            names = {name for name, bad in zip(known.feature, wrong, strict=True) if bad}
            good = np.array([name not in names for name in known.feature], bool)
            changed |= bool((good != state.control_in_use[i]).any())
            state.control_in_use[i] = good
        self.heights.keep(state.control_in_use)
        return changed


def _nothing(share: float) -> None:
    """Show no progress."""


def soft(ratio: FloatArray) -> FloatArray:
    """Return weights that fall with the ratio of residual and standard deviation."""
    return np.asarray(1 / (1 + (ratio / _ROBUST) ** 2) ** 2)
