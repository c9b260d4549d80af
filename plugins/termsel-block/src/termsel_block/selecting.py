"""Which control and which ties of a block are enough: `owdis-block`, a problem for all solvers.

References
----------
Yavari, Valadan Zoej, Salehi 2018: An automatic optimum number of well-distributed ground control
lines selection procedure based on genetic algorithm. ISPRS J. 139, 46-56: OWDIS of one image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from termsel import (
    Bits,
    Evaluation,
    Genome,
    Problem,
    SearchResult,
    Selection,
    Solver,
    TermselError,
    get,
    search,
)
from termsel.toolkit import count_in_words, csv_table
from termsel.toolkit.searches import RowSystem
from termsel_block.accuracy import independent_points, rms_length
from termsel_block.block import Block, BlockImage
from termsel_block.geometry.control import control_equations
from termsel_block.geometry.frame import BoolArray, FloatArray, IntArray
from termsel_block.joint import BlockResult, adjust

PROBLEM_NAME = "owdis-block"

# Most numbers in the normal matrices of a batch of selections.
_BATCH = 4_000_000
# Ratio to the RMSE with all candidates beyond which a selection is too small.
_MAX_RMSE_RATIO = 2.0
# Most numbers in the rows of all candidates.
_MAX_ROW_NUMBERS = 30_000_000


@dataclass(frozen=True, eq=False)
class SelectedControl:
    """What a search selected of a block.

    Parameters
    ----------
    control : tuple of (str, str)
        Image and id of each point or line.
    ties : tuple of str
    search : SearchResult
    check, check_of_all : float
        RMSE at selection points with the selection and with all candidates [px], linearised.
    result : BlockResult
        The block adjusted with the selection alone.
    independent, independent_of_all : float or None
        RMSE of the independent points of all images [px], after full adjustments.
    """

    control: tuple[tuple[str, str], ...]
    ties: tuple[str, ...]
    search: SearchResult
    check: float
    check_of_all: float
    result: BlockResult
    independent: float | None
    independent_of_all: float | None

    def record(self, solver: str, seed: int) -> dict[str, Any]:
        """Return all figures of the selection as a dict for JSON."""
        return {"problem": PROBLEM_NAME, "solver": solver, "seed": seed, "control": self.control,
                "ties": self.ties, "evaluations": self.search.evaluations,
                "certificate": self.search.certificate, "rmse": {
                    "check": self.check, "check_of_all": self.check_of_all,
                    "independent": self.independent,
                    "independent_of_all": self.independent_of_all}}


class OwdisBlock(Problem):
    """Select control and ties of a block, so that the selection points of all images are best met.

    The block is adjusted with all candidates and linearised there. Control adds its rows, a tie
    those that are left when its place is eliminated; priors are in every selection. What is a
    blunder in the adjustment of all is no candidate.

    Parameters
    ----------
    block : Block
        Points with the role check judge; those with the role independent take no part.
    tie_candidates : int
        Most ties that are candidates; if there are more, they are well distributed ones.
    least, most : int, optional
        Number of control features and ties together.

    Raises
    ------
    TermselError
        If the block cannot be adjusted, has no check points, or offers nothing to select from, or
        if `least` is below 1, or above `most` or the number of candidates.
    """

    objectives = ("check-rmse",)

    def __init__(self, block: Block, *, tie_candidates: int = 100, least: int = 1,
                 most: int | None = None) -> None:
        self.whole = adjust(_without_check(block))
        self._check_design, self._check_target = _rows_of_check_points(
            block, self.whole)
        ties = _spread_ties(self.whole, tie_candidates)
        rows = [*_control_rows(self.whole), *_tie_rows(self.whole, ties)]
        if not rows:
            raise TermselError("the block has no control and no ties to select from")
        labels = tuple(label for label, _, _ in rows)
        if not 1 <= least <= (len(labels) if most is None else most):
            raise TermselError(f"{least} to {most} of {len(labels)} candidates cannot be selected",
                               hint="Give a smaller least number, or a larger most.")
        # A candidate is a bit, which stands for all rows of a point, a line or a tie.
        self.genome = Genome([Bits("features", labels, least,
                                   None if most is None else min(most, len(labels)))])
        design, target = _prior_rows(self.whole)
        designs = [design_rows for _, design_rows, _ in rows]
        targets = [aim for _, _, aim in rows]
        # The number of the candidate that each row belongs to; -1 for priors, which always count.
        owners = [np.full(len(target), -1)]
        owners += [np.full(len(aim), i) for i, aim in enumerate(targets)]
        self._system = RowSystem(
            np.concatenate([design, *designs]), np.concatenate([target, *targets]),
            np.concatenate(owners).astype(np.intp), self._check_design, self._check_target,
            min_equations=1)
        # Normal equations of a selection are the sums of those of its candidates.
        self._normal = np.stack([design_rows.T @ design_rows for design_rows in designs])
        self._right = np.stack([design_rows.T @ aim
                                for design_rows, aim in zip(designs, targets, strict=True)])
        self._prior = design.T @ design, design.T @ target

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the RMSE at selection points [px] after adjustments with some candidates.

        `genes` (n, candidates) say which candidates each of n adjustments has.
        """
        genes = np.asarray(genes, bool)
        k = len(self._prior[1])
        rmse_of_batches = []
        # The normal matrices of a batch of selections are held at once.
        batch_size = max(_BATCH // k**2, 1)
        for first in range(0, len(genes), batch_size):
            selections = genes[first:first + batch_size].astype(float)
            # (sum of A^T A + P) x = sum of A^T b + P x0, over the candidates of each selection.
            normal = self._prior[0] + np.tensordot(selections, self._normal, 1)
            right = self._prior[1] + selections @ self._right
            steps = np.linalg.solve(normal, right[..., None])[..., 0]
            errors = self._check_target - steps @ self._check_design.T
            # A point has two rows, so that the mean square of distances is twice that of rows.
            rmse_of_batches.append(np.sqrt(2 * (errors**2).mean(axis=1)))
        return Evaluation(np.concatenate(rmse_of_batches)[:, None], np.zeros(len(genes)))

    def decode(self, genes: BoolArray) -> Selection:
        """Return the names of what is selected: control:image:id of features, tie:id of ties."""
        return Selection((), tuple(label for label, is_selected in zip(
            self.genome.labels, genes, strict=True) if is_selected))

    def row_systems(self) -> tuple[RowSystem, ...]:
        """Return the rows, which `exact` enumerates."""
        return (self._system,)


def select(block: Block, *, solver: str | Solver = "ga", seed: int = 1,
           evaluations: int | None = None, least: int = 1, most: int | None = None,
           tie_candidates: int = 100, refined: bool = True) -> SelectedControl:
    """Select the control and the ties of a block that are enough, and adjust it with these.

    Parameters
    ----------
    block : Block
        Images, control and ties, as `read_block` returns them.
    solver : str or Solver
        Any solver of one objective, such as ga, ica, swap, or exact for few candidates.
    seed, evaluations : int
        As for a search.
    refined : bool
        Whether a local refinement follows a solver that does not end by itself.
    least, most, tie_candidates : int
        As for `OwdisBlock`.

    Raises
    ------
    TermselError
        If there are no check points, or the solver cannot search the problem.
    """
    problem = OwdisBlock(block, tie_candidates=tie_candidates, least=least, most=most)
    searcher = get("solvers", solver)() if isinstance(solver, str) else solver
    outcome = search(problem, searcher, seed=seed, evaluations=evaluations,
                   polish=refined and not searcher.ends_by_itself)
    names = problem.decode(outcome.genes).features
    control = tuple((image, name) for kind, image, name in map(_parts_of_label, names)
                    if kind == "control")
    ties = tuple(name for kind, _, name in map(_parts_of_label, names) if kind == "tie")
    # The search is by equations that are linearised about all candidates, so that the block is
    # adjusted again with the selection alone.
    result = adjust(_with_selection(_without_check(block), set(control), set(ties)))
    everything = np.ones((1, problem.genome.size), bool)
    check_of_all = float(problem.evaluate(everything).objectives[0, 0])
    return SelectedControl(
        control=control, ties=ties, search=outcome, check=float(outcome.objectives[0]),
        check_of_all=check_of_all, result=result, independent=_independent_rmse(result),
        independent_of_all=_independent_rmse(problem.whole))


def _parts_of_label(label: str) -> tuple[str, str, str]:
    """Return kind, image and id of a candidate by its label; the image of a tie is ""."""
    kind, _, rest_of_label = label.partition(":")
    image, _, name = rest_of_label.partition(":")
    # The name of a tie may have a colon.
    return (kind, image, name) if kind == "control" else (kind, "", rest_of_label)


def _without_check(block: Block) -> Block:
    """Return the block whose check points take no part."""
    return replace(block, images=tuple(_with_off(image, _is_check) for image in block.images))


def _is_check(_: str, role: str) -> bool:
    """Return whether a point, of any id, has the role check."""
    return role == "check"


def _with_off(image: BlockImage, is_off: Callable[[str, str], bool]) -> BlockImage:
    """Return an image with the role off for points of whose id and role `is_off` is true."""
    if image.features is None:
        return image
    points = image.features.points
    roles = tuple("off" if is_off(name, role) else role
                  for name, role in zip(points.ids, points.roles, strict=True))
    return replace(image, features=replace(image.features, points=replace(points, roles=roles)))


def _with_selection(block: Block, control: set[tuple[str, str]], ties: set[str]) -> Block:
    """Return a block with the selected control and ties, and all independent points.

    `control` are pairs of image and id. Points that are not selected get the role off; other lines
    and ties are left out.
    """
    images = []
    for image in block.images:
        selected_image = _with_off(image, partial(_is_unselected, image.name, control))
        features = selected_image.features
        if features is not None:
            is_selected = [(image.name, name) in control for name in features.lines.ids]
            selected_image = replace(selected_image, features=replace(
                features, lines=features.lines.take(is_selected)))
        images.append(selected_image)
    # The remaining ties are numbered anew.
    keep = np.array([name in ties for name in block.ties.names])
    is_kept = keep[block.ties.tie]
    new_number = np.cumsum(keep) - 1
    kept_ties = replace(block.ties, names=tuple(n for n in block.ties.names if n in ties),
                        tie=new_number[block.ties.tie[is_kept]],
                        image=block.ties.image[is_kept],
                        position=block.ties.position[is_kept])
    return replace(block, images=tuple(images), ties=kept_ties)


def _is_unselected(image: str, control: set[tuple[str, str]], name: str, role: str) -> bool:
    """Return whether a point of an image is neither among `control`, nor independent.

    `control` are pairs of image and id.
    """
    return role != "independent" and (image, name) not in control


def _independent_rmse(result: BlockResult) -> float | None:
    """Return the RMSE [px] of the independent points of all images; None if there are none."""
    errors = [points.image - result.project(i, points.ground)
              for i in range(len(result.block.images))
              if (points := independent_points(result, i)) is not None]
    return rms_length(np.concatenate(errors)) if errors else None


def _rows_among_all(result: BlockResult, i: int, rows: FloatArray) -> FloatArray:
    """Return rows (n, p) by one image's parameters as rows (n, all) by those of all images."""
    slices = result.adjusted.solved.reduced.slices
    all_columns = np.zeros((len(rows), _count_parameters(result)))
    all_columns[:, slices[i]] = rows
    return all_columns


def _count_parameters(result: BlockResult) -> int:
    """Return the number of all images' parameters; columns of shared heights follow them."""
    return result.adjusted.solved.reduced.slices[len(result.block.images) - 1].stop


def _rows_of_check_points(block: Block, result: BlockResult) -> tuple[FloatArray, FloatArray]:
    """Return the rows (n, p) of the selection points of all images, and their errors (n,) [px].

    A row has the derivatives of line or sample by the parameters of all images; the errors are
    those in the block of all candidates. Raises TermselError if there are no selection points.
    """
    # About the block of all candidates, the errors of a selection are target - design x.
    design = []
    target = []
    for i, image in enumerate(block.images):
        if image.features is None:
            continue
        points = image.features.points
        points = points.take([role == "check" for role in points.roles])
        if not len(points):
            continue
        rows = result.rows(i, result.frame.local(points.ground))
        design.append(_rows_among_all(result, i, rows.reshape(2 * len(points), -1)))
        target.append((points.image - result.project(i, points.ground)).ravel())
    if not design:
        raise TermselError("no point of the block has the role check, which judges a selection",
                           hint="Give some points the role check, in the column role of the "
                                "tables of points that the block names.")
    return np.concatenate(design), np.concatenate(target)


def _prior_rows(result: BlockResult) -> tuple[FloatArray, FloatArray]:
    """Return rows (p, p) and targets (p,) of the priors of all parameters.

    They are divided by the standard deviations, and are for changes of the parameters.
    """
    state = result.adjusted.state
    sigma = np.sqrt(np.concatenate(state.variances))
    at = np.concatenate(state.parameters)
    return np.diag(1 / sigma), -at / sigma


def _control_rows(result: BlockResult) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return label, rows and targets of each point and line in use.

    Rows (n, p) and targets (n,) are divided by the standard deviations.
    """
    rows_of_features = []
    state = result.adjusted.state
    for i, image in enumerate(result.block.images):
        control = control_equations(image.features, result.frame)
        if not len(control):
            continue
        # Derivatives of the distance in the direction that is measured.
        rows = _rows_among_all(result, i, np.einsum(
            "na,nap->np", control.normal, result.rows(i, control.local)))
        sigma = state.sigma_control * control.sigma
        names = np.array(control.feature)
        for name in dict.fromkeys(control.feature):
            at = np.flatnonzero((names == name) & state.control_in_use[i])
            if len(at):
                rows_of_features.append((
                    f"control:{image.name}:{name}", rows[at] / sigma[at, None],
                    result.adjusted.of_control[i][at] / sigma[at]))
    return rows_of_features


def _tie_rows(result: BlockResult, ties: IntArray) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return label, rows and targets of each tie, with its position eliminated.

    Rows (n, p) and targets (n,) are divided by the standard deviation. Raises TermselError if the
    rows would take too much memory.
    """
    solved = result.adjusted.solved
    state = result.adjusted.state
    total = _count_parameters(result)
    if len(ties) * total**2 > _MAX_ROW_NUMBERS:
        raise TermselError(f"{len(ties)} ties of {len(state.cameras)} images are too many to "
                           "select from",
                           hint="Give fewer candidates of ties, or part of the block.")
    # The images that see each candidate, and its row in them.
    rows_by_tie: dict[int, list[tuple[int, int]]] = {int(tie): [] for tie in ties}
    for i, (tie_rows, used) in enumerate(zip(solved.tie_rows[:-1], state.in_use, strict=True)):
        for n in np.flatnonzero(used):
            if int(tie_rows.tie[n]) in rows_by_tie:
                rows_by_tie[int(tie_rows.tie[n])].append((i, int(n)))
    rows_of_ties = []
    for tie, measured in rows_by_tie.items():
        rows = []
        slopes = []
        aim = []
        for image, row in measured:
            tie_rows = solved.tie_rows[image]
            rows.append(_rows_among_all(result, image, tie_rows.rows[row]))
            slopes.append(tie_rows.slopes[row])
            aim.append(result.adjusted.residuals[image][row])
        # The left null space of the derivatives by the position: combinations of the measurements
        # that do not depend on it.
        null_space = np.linalg.svd(np.concatenate(slopes))[0][:, 3:].T / state.sigma_ties
        rows_of_ties.append((f"tie:{result.block.ties.names[tie]}",
                             null_space @ np.concatenate(rows),
                             null_space @ np.concatenate(aim)))
    return rows_of_ties


def _spread_ties(result: BlockResult, count: int) -> IntArray:
    """Return the sorted numbers of the ties that are candidates, at most `count`.

    They are those in use in two images or more. Of more than `count` those are taken that are
    spread over the ground, and in many images.
    """
    state = result.adjusted.state
    n_images = np.zeros(len(state.ties))
    for tie_rows, used in zip(result.adjusted.solved.tie_rows[:-1], state.in_use, strict=True):
        np.add.at(n_images, tie_rows.tie, used)
    usable = np.flatnonzero(n_images > 1)
    if len(usable) <= count:
        return usable
    ground = state.ties[usable, :2]
    # Farthest-point sampling, weighted by the number of images. The first is the one nearest to the
    # middle among those in most images.
    from_middle = np.hypot(*(ground - ground.mean(axis=0)).T)
    picked = [int(np.lexsort((from_middle, -n_images[usable]))[0])]
    distances = np.hypot(*(ground - ground[picked[0]]).T)
    while len(picked) < count:
        # The next has the largest distance to the nearest picked one, times its number of images.
        picked.append(int(np.argmax(distances * n_images[usable])))
        distances = np.minimum(distances, np.hypot(*(ground - ground[picked[-1]]).T))
    return np.sort(usable[picked])


def table_of(selected: SelectedControl) -> str:
    """Return the selected control features and ties as CSV with the columns kind, image and id."""
    return csv_table([("kind", "image", "id"),
                      *(("control", image, name) for image, name in selected.control),
                      *(("tie", "", name) for name in selected.ties)])


def text_of(selected: SelectedControl) -> str:
    """Return the summary of a selection as lines of text: its size, RMSEs and whether it is proven.
    """
    lines = [f"Selected: {count_in_words(len(selected.control), 'control feature')} and "
             f"{count_in_words(len(selected.ties), 'tie')}, by {selected.search.evaluations:,} "
             "evaluations.",
             f"Selection points: RMSE {selected.check:.2f} px; {selected.check_of_all:.2f} px with "
             "all candidates. They chose, so that this is no accuracy."]
    if selected.independent is not None and selected.independent_of_all is not None:
        lines.append(f"Independent check points: RMSE {selected.independent:.2f} px; "
                     f"{selected.independent_of_all:.2f} px with all control and ties.")
    if selected.check > _MAX_RMSE_RATIO * selected.check_of_all:
        lines.append("These are too few: allow more (--most), or use all.")
    if selected.search.certificate and selected.search.certificate.get("optimal"):
        lines.append("The selection is proven to be the best of all for the selection points.")
    return "\n".join(lines) + "\n"
