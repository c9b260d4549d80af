"""How often each term is selected, over many draws of control and selection points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from termsel import Bits, FeatureSet, LeastSquares, Task, TermselError, search
from termsel.toolkit import (
    BoolArray,
    FloatArray,
    Progress,
    as_plain_data,
    make_scaling,
    one_blas_thread,
)
from termsel.toolkit.models import (
    Rmse,
    Rmses,
    find_twins,
    guard_points,
    pole_margin,
    pole_violation,
    restrict_to_control,
    rmse_by_role,
    rmse_record,
    select,
)
from termsel.toolkit.runs import (
    notebook_observer,
    request_of,
    take_pending_interrupt,
    task_of,
    with_recommended_member,
)
from termsel.toolkit.searches import Observer


@dataclass(frozen=True, eq=False)
class Stability:
    """Frequencies of terms over repeated selections.

    Parameters
    ----------
    terms : tuple of str
        All k terms of the model.
    selections : ndarray of bool, shape (repeats, k)
        Terms each repetition selected.
    threshold : float
    stable : tuple of str
        Terms whose frequency reaches the threshold.
    determined : bool
        Whether the stable terms are a model: determined, with terms for both axes and without a
        pole.
    rmse : mapping
        Of the stable terms, fitted to control and check together, by role; empty if they are not
        a model.
    interrupted : bool
        Whether Ctrl-C came before all repetitions were made.
    """

    terms: tuple[str, ...]
    selections: BoolArray
    threshold: float
    stable: tuple[str, ...]
    determined: bool
    rmse: Rmses
    interrupted: bool = False

    @property
    def frequency(self) -> FloatArray:
        """Share of the repetitions that selected each term, shape (k,)."""
        return np.asarray(self.selections.mean(axis=0))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of stability.json: the frequencies, and the fit of the stable terms.

    "rmse" is None where the stable terms are not a model.
    """
        return {"repeats": len(self.selections), "threshold": self.threshold,
                "frequency": dict(zip(self.terms, self.frequency.tolist(), strict=True)),
                "n_terms": self.selections.sum(axis=1).tolist(),
                "stable": list(self.stable), "determined": self.determined,
                "rmse": as_plain_data(rmse_record(self.rmse)) if self.determined else None}


@one_blas_thread
def selection_frequencies(
    problem: str,
    *,
    repeats: int = 20,
    threshold: float = 0.6,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    patience: int | None = None,
    features: FeatureSet | None = None,
    dataset: str | None = None,
    model: str | None = None,
    solver: str | None = None,
    criterion: str | None = None,
    options: Mapping[str, Any] | None = None,
    observers: Iterable[Observer] = (),
) -> Stability:
    """Select terms again and again, each time with other control and selection points.

    Each repetition draws at random which of them are control, as many as there were; independent
    points keep their role, and twins share one. Where no point can change its role, as with lines,
    a random half of the control is left out, as in the paper. The terms selected often are then
    fitted to control and selection points together: stability selection. The papers show such
    frequencies over runs with other seeds on the same data; here the data differ too.

    Parameters
    ----------
    problem : str
        Name of a problem that selects terms from points.
    repeats : int
        How many searches there are, each with other control and selection points.
    threshold : float
        Frequency from which on a term is stable, above 0 to 1. Meinshausen and Bühlmann recommend
        0.6 to 0.9.
    seed : int
        Seed of the shares and of the searches.
    generations, evaluations : int, optional
        Budgets of each search.
    seconds : float, optional
        Budgets of each search; see `termsel.search`.
    patience : int, optional
        End each search after so many generations without a gain.
    features, dataset, model, solver, criterion, options
        As for `termsel.prepare`.
    observers : iterable of callable
        Called with `Progress` as in `termsel.search`; its share is that of all repetitions. In a
        notebook one more shows the progress.

    Returns
    -------
    Stability
        Also when interrupted with Ctrl-C, if two repetitions are complete.

    Raises
    ------
    TermselError
        If repetitions or threshold say nothing, if the problem selects features or values of
        options, or if control and selection points are too few.
    KeyboardInterrupt
        When interrupted before two repetitions are complete.

    References
    ----------
    Meinshausen and Bühlmann 2010, J. R. Stat. Soc. B 72(4), section 2; Zakaryaie Nejad et al. 2015,
    figure 6, show how often a search selected each term in 120 runs.

    Examples
    --------
    >>> from termsel_studies import selection_frequencies
    >>> found = selection_frequencies("poly-terms", repeats=3, evaluations=200,
    ...                               options={"degree": 2})
    >>> found.selections.shape
    (3, 12)
    """
    if repeats < 2 or not 0 < threshold <= 1:
        raise TermselError(f"{repeats} repetitions with the threshold {threshold} say nothing",
                           hint="Give at least 2 repetitions and a threshold above 0, up to 1.")
    parts = {"model": model, "solver": solver, "criterion": criterion}
    request = request_of(problem, features=features, dataset=dataset, options=options, **parts)
    _require_points(request.features)
    task = task_of(request)
    other_segments = {"features" if segment.name == "features" else "other values than terms"
                      for segment in task.problem.genome.segments
                      if segment.name == "features" or not isinstance(segment, Bits)}
    if other_segments:
        raise TermselError(f"the problem {problem} selects {min(other_segments)}",
                           hint="Choose a problem that selects terms alone: rfm-terms, "
                                "poly-terms.")
    notebook = notebook_observer(f"stability of {task.recipe.name}")
    if notebook is not None:
        observers = (*observers, notebook)
    # One generator draws all shares; each search has a seed of its own.
    rng = np.random.default_rng(seed)
    # The roles drawn are in the features, so options that name roles or points to leave out go.
    fixed_options = {key: value for key, value in (options or {}).items()
                     if key not in ("off", "role")}
    rows: list[BoolArray] = []
    interrupted = False
    for repetition in range(repeats):
        try:
            redrawn = task_of(request_of(
                problem, features=_with_drawn_roles(task, rng), dataset=dataset,
                options={**fixed_options, "roles": "file"}, **parts))
            outcome = search(redrawn.problem, redrawn.solver, seed=seed + repetition,
                             generations=generations, evaluations=evaluations, seconds=seconds,
                             patience=patience, **redrawn.options["search"],
                             observers=[_observer_of_all(observe, repetition, repeats)
                                        for observe in observers])
            # A search that was interrupted ended early, so its selection does not count.
            interrupted = outcome.interrupted
            if not interrupted:
                genes = with_recommended_member(redrawn, outcome).genes
                rows.append(np.isin(task.model.terms, redrawn.problem.decode(genes).terms))
        except KeyboardInterrupt:
            interrupted = True
        if interrupted:
            # A single selection has no frequencies, so the interrupt ends the whole call.
            if len(rows) < 2:
                raise KeyboardInterrupt
            take_pending_interrupt()
            break
    selections = np.array(rows)
    is_stable = selections.mean(axis=0) >= threshold
    determined, rmse = _fit_stable_terms(task, is_stable)
    return Stability(
        terms=task.model.terms, selections=selections, threshold=threshold,
        stable=select(task.model.terms, is_stable), determined=determined, rmse=rmse,
        interrupted=interrupted)


MIN_POINTS = 6
"""Points from which on half of them may be left out: 3 remain, which a model needs."""


def _require_points(features: FeatureSet) -> None:
    """Raise TermselError if there are no lines, and fewer points than `MIN_POINTS`."""
    if len(features.points) < MIN_POINTS and not len(features.lines):
        raise TermselError(
            f"{len(features.points)} points are too few for stability, which leaves out some of "
            f"them again and again: at least {MIN_POINTS} are needed",
            hint="Measure more, or fit all of them: termsel run --points FILE.")


def _observer_of_all(observe: Observer, repetition: int, repeats: int) -> Observer:
    """Return an observer of the search of one repetition, counted from 0.

    It calls `observe` with the progress of all repetitions: the share is of all, not of the one.
    """
    def observe_repetition(progress: Progress) -> None:
        """Call `observe` with the share of all repetitions; one without a share counts as 0."""
        observe(replace(progress, share=(repetition + (progress.share or 0.0)) / repeats,
                        what=f"repetition {repetition + 1} of {repeats}"))

    return observe_repetition


def _with_drawn_roles(task: Task, rng: np.random.Generator) -> FeatureSet:
    """Return the features of a task with other points or lines as control.

    Where there is control of points, the roles control and check are drawn again among the points
    that have one of them, as many of each as before; points of one place get one role. Without
    selection points, half of the control gets the role "off" instead. Where lines alone are
    control, half of the lines are left out, rounded up to keep.
    """
    features = task.observations.features
    observations = task.observations
    points = features.points
    lines = features.lines
    roles = np.array(points.roles, dtype=object)
    n_control = len(observations.control.points)
    n_check = len(observations.check)
    if n_control:
        movable = np.flatnonzero(np.isin(roles, ("control", "check")))
        # Points of one place move together: a selection point at the place of a control point
        # would be predicted too well.
        group = find_twins(points.ground[movable])
        order = np.argsort(rng.permutation(group.max() + 1)[group], kind="stable")
        # Without selection points there is no role to exchange with.
        n_kept = n_control if n_check else n_control // 2
        other_role = "check" if n_check else "off"
        drawn = np.where(np.arange(len(order)) < n_kept, "control", other_role)
        # Twins follow each other in this order; all of them take the role of the first.
        _, first, group_of = np.unique(group[order], return_index=True, return_inverse=True)
        roles[movable[order]] = drawn[first[group_of]]
    elif len(lines):
        # Lines cannot be selection lines, so those not drawn are left out.
        names = np.unique(lines.ids)
        lines = lines.take(np.isin(lines.ids, rng.permutation(names)[:(len(names) + 1) // 2]))
    return features.with_(points=replace(points, roles=tuple(roles)), lines=lines)


def _fit_stable_terms(task: Task, is_stable: BoolArray) -> tuple[bool, dict[str, Rmse | None]]:
    """Return whether the stable terms are a model, and its RMSE [px] by role.

    `is_stable` has a flag for each term, shape (k,). The terms are fitted to control and check
    together. They are no model, and the RMSE is {}, if line or sample has none, if the features do
    not determine their coefficients, or if there is a pole within the area of the points.
    """
    control_and_check = task.observations.together
    axis = task.model.axis
    scaling = make_scaling(control_and_check)
    # A model needs terms for line and for sample.
    if not is_stable[axis == 0].any() or not is_stable[axis == 1].any():
        return False, {}
    # Regularised estimators would hide that terms are not determined; plain least squares do not.
    fitted = LeastSquares().fit(task.model, control_and_check, scaling, is_stable,
                                np.ones(len(control_and_check), dtype=bool))
    # Near a pole between the points the prediction would be wrong though the residuals are small.
    guard = guard_points(scaling.features(control_and_check),
                         scaling.points(control_and_check.points))
    if not fitted.adjustment.feasible or pole_violation(
            task.model, fitted.adjustment.coefficients[None], guard,
            pole_margin(scaling.features(control_and_check))).any():
        return False, {}
    return True, rmse_by_role(restrict_to_control(fitted, task.observations), task.observations)
