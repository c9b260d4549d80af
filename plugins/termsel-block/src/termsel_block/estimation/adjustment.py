"""The adjustment of a block: robust weights, variances by evidence, and what is dropped."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import stdtrit

from termsel_block.estimation.equations import Shared, image_pairs
from termsel_block.estimation.starts import intersect
from termsel_block.estimation.steps import CONVERGED, Steps, shrinkage_of_mean_square, soft_weights
from termsel_block.estimation.unknowns import Adjusted, BlockUnknowns, Measured
from termsel_block.evidence.factors import log_bayes_factor
from termsel_block.evidence.growing import MAX_P_VALUE, p_value_of_columns
from termsel_block.evidence.integrating import MAX_INTEGRATED, count_unknown_variances, integrate
from termsel_block.evidence.variances import estimate_variances, loosening_factors
from termsel_block.geometry.control import OwnControl
from termsel_block.geometry.frame import BoolArray, FloatArray
from termsel_block.geometry.heights import Heights

BLUNDER_SIGMAS = 4.0
"""A tie is a blunder if it is so many standard deviations off, in line or in sample.

Control is so by as many at least, and by more where few measurements show its precision.
"""

_BLUNDER_CHANCE = 0.05
"""Probability that good control of a block has a row so far off, by which few points are judged."""

MIN_EVIDENCE = -1.0
"""Logarithm of a Bayes factor below which a group is dropped; above, it stays and is shrunk."""

_PRIOR_COUNT = 4.0
"""Weight of the ties' precision in that of control, as so many points."""

CHI2_MEDIAN_OFFSET = 2 / 3
"""What a distribution chi-square of n degrees of freedom has its median below n, about."""

# Relative change of standard deviations below which they have settled.
_SETTLED_CHANGE = 0.02
# Most steps of one stage.
_STAGE_STEPS = 15
# First steps of a stage, before each of which derivatives are computed anew.
_RENEWED_STEPS = 3
# Factors by which ties' weights fall more slowly in the first steps, while residuals are large.
_WIDENING = (8.0, 4.0, 2.0)
# Number of these steps, in which control keeps its weight.
_WIDENED_STEPS = len(_WIDENING)
# Most rounds of loosening priors, of which two or three are usual.
_MAX_LOOSENINGS = 20
# Relative change of a stated standard deviation below which it stays.
_MIN_LOOSENING = 0.1
# Number of parameters of all images beyond which variances are estimated once in a stage.
_MANY_PARAMETERS = 2500
# Least standard deviation of ties [px]: data without noise would have infinite weights.
_MIN_SIGMA = 0.01


def adjust_block(state: BlockUnknowns, measured: Sequence[Measured], control: Sequence[OwnControl],
                 heights: Heights, *, progress: Callable[[float], None] | None = None,
                 fixed: Sequence[bool] = ()) -> Adjusted:
    """Adjust a block from its start, and return its unknowns with what they show.

    Parameters
    ----------
    state : BlockUnknowns
        The start; it is changed.
    measured, control : sequence
        Measurements of ties, and control, of each image.
    heights : Heights
        What is known of the heights of ties; its offset and standard deviation are changed.
    progress : callable, optional
        Called with the share that is done.
    fixed : sequence of bool, optional
        Images whose correction is asked for, and not to be chosen.

    Raises
    ------
    TermselError
        If the block is not determined by its control and ties.

    Notes
    -----
    Gauss-Newton steps with weights 1 / (1 + (r / 2.5 s)^2)^2 until blunders are told, then by plain
    least squares without them. Standard deviations of ties and control, and the variance of each
    image's groups of columns (`evidence.variances`), are estimated on the way. A group whose Bayes
    factor, by the ratio of Savage and Dickey over the whole block's posterior, is below one is
    dropped. Columns for jitter are tried where residuals support them (`evidence.growing`).
    """
    # The heights count as one more image, which sees all ties.
    shared = image_pairs(
        [*(of_image.tie for of_image in measured), np.arange(len(state.ties))], len(state.ties))
    run = _Run(state, measured, control, heights, shared)
    report = progress or _show_nothing
    state.in_use = state.in_use or [np.ones(len(of_image.tie), bool) for of_image in measured]
    state.control_in_use = state.control_in_use or [np.ones(len(of_image), bool)
                                                    for of_image in control]
    # Weights are robust until the images are about where they belong and blunders can be told.
    steps = run.iterate(robust=True, limit=_STAGE_STEPS, report=lambda s: report(0.4 * s))
    # Jitter is tried before groups are dropped, as other columns would follow what it explains.
    if run.grow(fixed):
        steps += run.iterate(robust=True, limit=_STAGE_STEPS, report=_show_nothing)
    # Dropping a group changes the evidence of the others, so that a second look may drop more.
    evidence: list[dict[str, float]] = [{} for _ in state.cameras]
    for _ in range(2):
        if not run.drop(evidence, fixed):
            break
        steps += run.iterate(robust=True, limit=_STAGE_STEPS,
                             report=lambda s: report(0.4 + 0.2 * s))
    # Then blunders are left out; each time measurements that agree again are taken back.
    for _ in range(3):
        if not run.judge_measurements():
            break
        steps += run.iterate(robust=False, limit=_STAGE_STEPS,
                             report=lambda s: report(0.6 + 0.4 * s))
    steps += run.iterate(robust=False, limit=_STAGE_STEPS, report=report)
    # Contradictions are judged by the priors as models state them, before these are loosened.
    by_priors = [(parameters.copy(), covariance) for parameters, covariance in zip(
        state.parameters, run.solved.image_covariances[:-1], strict=True)]
    score = run.score_of_control() if any(camera.stated_terms for camera in state.cameras) else {}
    # Loosened priors let parameters move, which then show again how far they scatter.
    for _ in range(_MAX_LOOSENINGS):
        if not run.loosen():
            break
        steps += run.iterate(robust=False, limit=_STAGE_STEPS, report=_show_nothing)
    # The next step moves images on purpose, and is not to count as the last one.
    moved = run.moved()
    draws = run.move_to_posterior_mean()
    # Ties that no image uses have been moved by the heights alone.
    run.place_unused_ties()
    residuals, of_control = run.residuals()
    return Adjusted(
        state=state, solved=run.solved, residuals=residuals, of_control=of_control,
        evidence=evidence, steps=steps, converged=run.converged, offset=heights.offset,
        roughness=heights.sigma, freedom=run.freedom, moved=moved, by_priors=by_priors,
        score=score, draws=draws)


class _Run(Steps):
    """A block while it is adjusted."""

    converged = False
    freedom = np.nan

    def __init__(self, state: BlockUnknowns, measured: Sequence[Measured],
                 control: Sequence[OwnControl], heights: Heights, shared: Sequence[Shared]) -> None:
        super().__init__(state, measured, control, heights, shared)
        self.large = sum(len(camera.groups) for camera in state.cameras) > _MANY_PARAMETERS

    def iterate(self, *, robust: bool, limit: int, report: Callable[[float], None]) -> int:
        """Make up to `limit` steps until the block has settled; return their number.

        It has if no tie moves by `CONVERGED` px and standard deviations, which are estimated on the
        way, do not change; `converged` becomes whether it has. With `robust` weights fall with the
        residuals. `report` is called with the share of `limit` that is done.
        """
        self.converged = False
        for step in range(limit):
            report(step / limit)
            # A step that had to be shortened has shown that its derivatives do not hold.
            if step < _RENEWED_STEPS or self.share < 1.0:
                self.slopes = {}
            # If weights fell at once, a lone control point far off would never count again.
            self.step(robust, _WIDENING[step] if robust and step < _WIDENED_STEPS else 1.0)
            moved = float(self.moved().max(initial=0.0))
            settled = True
            if step >= _WIDENED_STEPS and (not self.large or step == _WIDENED_STEPS):
                settled = self.estimate_deviations(robust)
            if step > _WIDENED_STEPS and moved < CONVERGED and settled:
                self.converged = True
                return step + 1
        return limit

    def loosen(self) -> bool:
        """Widen or narrow the priors that models state to what the images show, in the state.

        Returns False, and changes nothing, if no standard deviation would change by more than the
        part `_MIN_LOOSENING`.
        """
        state = self.state
        factors = loosening_factors(state.cameras, state.parameters,
                                    self.solved.image_covariances[:-1])
        change = 0.0
        for camera in state.cameras:
            for name, index in camera.stated_terms.items():
                change = max(change, abs(factors[name] / camera.sigma_factors[index] - 1))
        if change < _MIN_LOOSENING:
            return False
        cameras = []
        parameters = []
        # Parameters are in standard deviations of their priors, so that both change together.
        for camera, old in zip(state.cameras, state.parameters, strict=True):
            loosened, converted = camera.with_priors(factors, old)
            cameras.append(loosened)
            parameters.append(converted)
        state.cameras = cameras
        state.parameters = parameters
        return True

    def move_to_posterior_mean(self) -> list[FloatArray]:
        """Move to the posterior mean over all variances; return draws (d, p) of images' errors.

        It changes `solved`, the ties, parameters and variances of the state, and the offset of
        heights. If no variances are unknown, or too many, nothing changes, and [] is returned.
        """
        state = self.state
        if not 0 < count_unknown_variances(state.cameras) <= MAX_INTEGRATED:
            return []
        # `integrate` expects priors with the first guesses, which it takes off again.
        loose = self.linearised([np.square(camera.prior_sigma) for camera in state.cameras])
        integrated = integrate(loose.reduced.whole(), np.concatenate(loose.steps), state.cameras,
                               state.parameters, loose.reduced.slices,
                               self.heights.guessed_offset_weight())
        # The step to the posterior mean, with the covariance over all variances.
        self.solved = loose.at(integrated.mean, integrated.covariance)
        tie_positions = [self._positions_of_ties(i) for i in range(len(state.cameras))]
        tie_moves = self._tie_moves()
        state.ties = state.ties + self.solved.ties
        state.parameters = [
            camera.parameters_after_step(old, step, tie_position + tie_move,
                                         state.ties[tie_rows.tie])
            for camera, old, step, tie_position, tie_move, tie_rows in zip(
                state.cameras, state.parameters, self.solved.steps[:-1], tie_positions, tie_moves,
                self.solved.tie_rows[:-1], strict=True)]
        self.heights.offset += float(self.solved.steps[-1][0])
        for i, columns in enumerate(loose.reduced.slices[:-1]):
            precision = integrated.precision[columns]
            is_known = np.isnan(precision)
            state.variances[i] = np.where(is_known, state.variances[i], 1 / precision)
        return [integrated.draws[:, columns] for columns in loose.reduced.slices[:-1]]

    def estimate_deviations(self, robust: bool) -> bool:
        """Estimate the variances of ties, control, heights and parameters from the last solution.

        Each is a sum of weighted squares over its redundancy, with corrections for robust weights
        and few measurements. Sets `freedom`, the redundancy, too. Returns whether the standard
        deviations of ties, control and heights changed by less than the part `_SETTLED_CHANGE`.
        """
        state = self.state
        covariances = self.solved.image_covariances[:-1]
        before = np.array([state.sigma_ties, state.sigma_control, self.heights.sigma])
        of_ties, of_control = self.residuals()
        # The data determine trace(I - C V^-1) parameters, of which control determines the trace of
        # its hat matrix.
        determined = 0.0
        for covariance, variances in zip(covariances, state.variances, strict=True):
            determined += float((1 - np.diag(covariance) / variances).sum())
        squares, rows, by_control = self._sums_of_control(of_control, robust)
        total, weights, rays_of_tie = self._sums_of_ties(of_ties, robust)
        # The position of a tie takes three measurements, or as many as it has.
        freedom = float(
            weights - np.minimum(2 * rays_of_tie, 3).sum() - max(determined - by_control, 0.0))
        # Redundancy: equations of ties and control less the unknowns that they determine.
        self.freedom = freedom + rows - by_control
        # Robust weights are below 1 for good measurements, too, which makes squares too small.
        if robust:
            total /= shrinkage_of_mean_square(max(freedom, 0.0) / max(weights, 1.0), 2)
            squares /= shrinkage_of_mean_square(max(rows - by_control, 0.0) / max(rows, 1.0), 1)
        # With a redundancy of 1 or less the variance stays, as residuals say next to nothing.
        if freedom > 1:
            state.sigma_ties = max(float(np.sqrt(total / freedom)), _MIN_SIGMA)
        # Few points say little of their own precision, so that the ties' counts as four of them.
        # The median of the posterior is taken: with few points its mean is far above it.
        expected = max(rows - by_control, 0.0)
        state.sigma_control = float(np.sqrt((squares + _PRIOR_COUNT * state.sigma_ties**2)
                                            / (expected + _PRIOR_COUNT - CHI2_MEDIAN_OFFSET)))
        state.freedom_control = expected + _PRIOR_COUNT
        state.variances = estimate_variances(
            state.cameras, state.parameters, covariances, state.variances)
        self.heights.estimate(state.ties, self.solved.of_ties, rays_of_tie > 1.0)
        after = np.array([state.sigma_ties, state.sigma_control, self.heights.sigma])
        return bool(np.abs(after / before - 1).max() < _SETTLED_CHANGE)

    def _sums_of_control(self, of_control: Sequence[FloatArray],
                         robust: bool) -> tuple[float, float, float]:
        """Return the weighted squares, the weights and the leverages of control in use, summed up.

        `of_control` has the residuals (r,) of each image; their squares are divided by the relative
        variances of the rows. The leverages add up to the parameters that control determines.
        """
        state = self.state
        squares = rows = by_control = 0.0
        for i, (control, covariance) in enumerate(
                zip(self.control, self.solved.image_covariances[:-1], strict=True)):
            if not len(control):
                continue
            sigma = state.sigma_control * control.sigma
            weight = soft_weights(of_control[i] / sigma) if robust else np.ones(len(control))
            weight = weight * state.control_in_use[i]
            # h_n = a_n C a_n^T / s^2 of each row a_n, with the covariance C of the image's
            # parameters. The rows must be those of the equations that have this covariance.
            design = self.design[i]
            hat = np.einsum("ni,ij,nj->n", design, covariance, design) / sigma**2
            by_control += float((weight * hat).sum())
            rows += float(weight.sum())
            squares += float((weight * (of_control[i] / control.sigma) ** 2).sum())
        return squares, rows, by_control

    def _sums_of_ties(self, of_ties: Sequence[FloatArray],
                      robust: bool) -> tuple[float, float, FloatArray]:
        """Return the weighted squares [px2] and the weights of ties, and the rays of each tie (t,).

        `of_ties` has the residuals (m, 2) of each image, of which each counts for two. The rays of
        a tie are the sum of the weights of its measurements.
        """
        state = self.state
        total = 0.0
        weights = 0.0
        rays_of_tie = np.zeros(len(state.ties))
        for measured, residual, used in zip(self.measured, of_ties, state.in_use, strict=True):
            weight = used * (soft_weights(np.hypot(*residual.T) / state.sigma_ties) if robust
                             else np.ones(len(used)))
            total += float((weight * (residual**2).sum(axis=1)).sum())
            weights += 2 * float(weight.sum())
            np.add.at(rays_of_tie, measured.tie, weight)
        return total, weights, rays_of_tie

    def grow(self, fixed: Sequence[bool]) -> bool:
        """Add columns to images whose residuals support them; return whether any got some.

        `fixed` says of each image whether its correction is the user's, to which nothing is added;
        if it is empty, none is.
        """
        state = self.state
        grown = False
        for i, (camera, measured, residual) in enumerate(zip(
                state.cameras, self.measured, self.residuals()[0], strict=True)):
            growth = None if len(fixed) and fixed[i] else camera.grown()
            if growth is None or not len(measured.tie):
                continue
            larger, is_new = growth
            weight = soft_weights(np.hypot(*residual.T) / state.sigma_ties) / state.sigma_ties**2
            columns = larger.first_order(state.ties[measured.tie])[1]
            columns = columns[:, is_new[:columns.shape[1]]]
            if p_value_of_columns(columns, residual, weight) < MAX_P_VALUE:
                grown = True
                state.cameras[i] = larger
                # New columns begin with zeros and with the variance that is a first guess.
                parameters = np.zeros(len(is_new))
                parameters[~is_new] = state.parameters[i]
                variances = np.square(larger.prior_sigma)
                variances[~is_new] = state.variances[i]
                state.parameters[i] = parameters
                state.variances[i] = variances
        return grown

    def drop(self, evidence: list[dict[str, float]], fixed: Sequence[bool]) -> bool:
        """Drop groups of columns that the evidence is against; return whether any was dropped.

        The logarithm of the Bayes factor of each group that was weighed is put into `evidence`,
        which has a dict for each image. Permanent groups are not weighed, nor those of a nested
        camera before the last one that is kept. `fixed` is as in `grow`.
        """
        state = self.state
        dropped = False
        for i, (camera, covariance) in enumerate(
                zip(state.cameras, self.solved.image_covariances[:-1], strict=True)):
            if len(fixed) and fixed[i]:
                continue
            names = np.array(camera.groups)
            groups = [name for name in dict.fromkeys(camera.groups) if name not in camera.permanent]
            dropped_groups: set[str] = set()
            # The last groups are weighed first: a nested group is of use only with those before it.
            for name in reversed(groups):
                at = np.flatnonzero(names == name)
                # Line and sample are weighed together: a group is dropped in both or in none.
                evidence[i][name] = log_bayes_factor(
                    state.parameters[i][at], covariance[np.ix_(at, at)], state.variances[i][at])
                if evidence[i][name] < MIN_EVIDENCE:
                    dropped_groups.add(name)
                elif camera.nested:
                    break
            if dropped_groups:
                dropped = True
                keep = np.array([name not in dropped_groups for name in camera.groups])
                state.cameras[i] = camera.with_parameters(keep)
                state.parameters[i] = state.parameters[i][keep]
                state.variances[i] = state.variances[i][keep]
        return dropped

    def place_unused_ties(self) -> None:
        """Put each tie that no image uses where all its rays meet, if it has two.

        No equation of an image moves such a tie, so that it would be judged at an old position.
        """
        state = self.state
        count = np.zeros(len(state.ties))
        count_of_rays = np.zeros(len(state.ties))
        for measured, used in zip(self.measured, state.in_use, strict=True):
            np.add.at(count, measured.tie, used)
            np.add.at(count_of_rays, measured.tie, 1)
        unused = np.flatnonzero((count == 0) & (count_of_rays > 1))
        # `intersect` takes ties that are numbered from 0 on.
        new_number = np.full(len(state.ties), -1)
        new_number[unused] = np.arange(len(unused))
        rays = []
        for camera, parameters, measured in zip(state.cameras, state.parameters, self.measured,
                                                strict=True):
            numbers = new_number[measured.tie]
            is_unused = numbers >= 0
            rays.append((camera, parameters, numbers[is_unused], measured.position[is_unused]))
        if len(unused):
            state.ties[unused] = intersect(state.ties[unused], rays)

    def judge_measurements(self) -> bool:
        """Judge by its residual whether each measurement is used; return whether any changed.

        One that was left out may come back. Of a tie at least two images are used, or none; of a
        point or line of control both rows, or neither. Before, ties that no image uses are placed
        where their rays meet. At last, the heights are told which control is left.
        """
        self.place_unused_ties()
        of_ties, of_control = self.residuals()
        in_use = self._ties_that_agree(of_ties)
        control_in_use = self._control_that_agrees(of_control)
        state = self.state
        changed = any(not np.array_equal(new, old) for new, old in zip(
            [*in_use, *control_in_use], [*state.in_use, *state.control_in_use], strict=True))
        state.in_use = in_use
        state.control_in_use = control_in_use
        # Control that is left out does not show the offset of heights, either.
        self.heights.keep(control_in_use)
        return changed

    def _ties_that_agree(self, of_ties: Sequence[FloatArray]) -> list[BoolArray]:
        """Return by image which measurements of ties agree, (m,), at least two of a tie.

        `of_ties` has the residuals (m, 2) of each image.
        """
        state = self.state
        # Of each tie over all images: the sum of the larger residuals of line and sample, and the
        # number of its rays.
        residual_sum = np.zeros(len(state.ties))
        rays = np.zeros(len(state.ties))
        for measured, residual in zip(self.measured, of_ties, strict=True):
            np.add.at(residual_sum, measured.tie, np.abs(residual).max(axis=1, initial=0.0))
            np.add.at(rays, measured.tie, 1)
        agreeing: list[BoolArray] = []
        count = np.zeros(len(state.ties))
        for measured, residual in zip(self.measured, of_ties, strict=True):
            agrees = np.abs(residual).max(axis=1, initial=0.0) <= BLUNDER_SIGMAS * state.sigma_ties
            # Robust weights give the whole difference of two rays to either of them, so that the
            # sum is judged, which has the standard deviation of a difference.
            agrees |= (rays[measured.tie] == 2) & (
                residual_sum[measured.tie] <= BLUNDER_SIGMAS * np.sqrt(2) * state.sigma_ties)
            agreeing.append(agrees)
            np.add.at(count, measured.tie, agrees)
        return [agrees & (count[measured.tie] > 1)
                for agrees, measured in zip(agreeing, self.measured, strict=True)]

    def _control_that_agrees(self, of_control: Sequence[FloatArray]) -> list[BoolArray]:
        """Return by image which rows of control agree, (r,): of a feature both or neither.

        `of_control` has the residuals (r,) of each image.
        """
        # If few measurements show the standard deviation of control, BLUNDER_SIGMAS of them are no
        # rare distance: Student's quantile for as many rows counts.
        rows = sum(map(len, of_control))
        chance = _BLUNDER_CHANCE / (2 * max(rows, 1))
        limit = max(BLUNDER_SIGMAS, -float(stdtrit(self.state.freedom_control, chance)))
        agreeing: list[BoolArray] = []
        for i, (residual, control) in enumerate(zip(of_control, self.control, strict=True)):
            is_blunder = np.abs(residual) > limit * self.residual_deviations(i)
            names = {name for name, is_wrong in zip(control.feature, is_blunder, strict=True)
                     if is_wrong}
            agreeing.append(np.array([name not in names for name in control.feature], bool))
        return agreeing


def _show_nothing(share: float) -> None:
    """Show no progress."""
