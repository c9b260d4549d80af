"""How often each term is selected, over many draws of control and check points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from termsel.errors import TermselError
from termsel.fits.figures import Rmses, figures, in_role, plain_rmse
from termsel.fits.least_squares import fit
from termsel.fits.rmse import Rmse
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, select
from termsel.measurements.roles import together
from termsel.measurements.scaling import scaling_of
from termsel.models.poles import guard_points, pole_violation
from termsel.runs.recommend import recommended
from termsel.runs.task import Task, prepare
from termsel.solvers.search import search
from termsel.threads import one_blas_thread


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
    """

    terms: tuple[str, ...]
    selections: BoolArray
    threshold: float
    stable: tuple[str, ...]
    determined: bool
    rmse: Rmses

    @property
    def frequency(self) -> FloatArray:
        """Share of the repetitions that selected each term, shape (k,)."""
        return np.asarray(self.selections.mean(axis=0))

    def to_dict(self) -> dict[str, Any]:
        """Return the frequencies and what came of them, for JSON."""
        return {"repeats": len(self.selections), "threshold": self.threshold,
                "frequency": dict(zip(self.terms, self.frequency.tolist(), strict=True)),
                "n_terms": self.selections.sum(axis=1).tolist(),
                "stable": list(self.stable), "determined": self.determined,
                "rmse": plain_rmse(self.rmse) if self.determined else None}


@one_blas_thread
def stability(
    problem: str,
    *,
    repeats: int = 20,
    threshold: float = 0.6,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    features: FeatureSet | None = None,
    dataset: str | None = None,
    model: str | None = None,
    solver: str | None = None,
    criterion: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> Stability:
    """Select terms again and again, each time with other control and check points.

    Each repetition draws at random which of them are control, as many as there were; independent
    points keep their role. The terms selected often are then fitted to control and check points
    together: stability selection. The papers show such frequencies over runs with other seeds on
    the same data; here the data differ too.

    Parameters
    ----------
    problem : str
        Name of a problem that selects terms from points.
    repeats : int
    threshold : float
        Frequency from which on a term is stable, above 0 to 1. Meinshausen and Bühlmann recommend
        0.6 to 0.9.
    seed : int
        Seed of the shares and of the searches.
    generations, evaluations : int, optional
    seconds : float, optional
        Budgets of each search; the solver's own by default.
    features, dataset, model, solver, criterion, options
        As for `termsel.prepare`.

    Returns
    -------
    Stability

    Raises
    ------
    TermselError
        If the problem selects features, or control and check are too few.

    References
    ----------
    Meinshausen and Bühlmann 2010, J. R. Stat. Soc. B 72(4), section 2; Akhoundi Khezrabad et al.
    2020 show the frequency of terms.

    Examples
    --------
    >>> from termsel.runs.stability import stability
    >>> found = stability("poly-terms", repeats=3, evaluations=200, options={"degree": 2})
    >>> found.selections.shape
    (3, 12)
    """
    if repeats < 2 or not 0 < threshold <= 1:
        raise TermselError(f"{repeats} repetitions with the threshold {threshold} say nothing",
                           hint="Give at least 2 repetitions and a threshold above 0, up to 1.")
    task = prepare(problem, features=features, dataset=dataset, model=model, solver=solver,
                   criterion=criterion, options=options)
    if any(segment.name == "features" for segment in task.problem.genome.segments) \
            or len(task.observations.control.lines):
        raise TermselError(f"the problem {problem} selects features or has lines as control",
                           hint="Choose a problem that selects terms from points: rfm-terms, "
                                "poly-terms.")
    rng = np.random.default_rng(seed)
    # The drawn roles are those of the features, which take the place of roles that are named.
    others = {key: value for key, value in (options or {}).items() if key not in ("off", "role")}
    rows = []
    for repetition in range(repeats):
        again = prepare(problem, features=_with_drawn_roles(task, rng), model=model,
                        solver=solver, criterion=criterion,
                        options={**others, "roles": "file"})
        found = recommended(again, search(again.problem, again.solver, seed=seed + repetition,
                                          generations=generations, evaluations=evaluations,
                                          seconds=seconds))
        rows.append(np.isin(task.model.terms, again.problem.decode(found.genes).terms))
    selections = np.array(rows)
    chosen = selections.mean(axis=0) >= threshold
    determined, rmse = _fitted(task, chosen)
    return Stability(task.model.terms, selections, threshold,
                     select(task.model.terms, chosen), determined, rmse)


def _with_drawn_roles(task: Task, rng: np.random.Generator) -> FeatureSet:
    """Return the features with other points as control and check."""
    features = task.observations.features
    roles = np.array(features.points.roles, dtype=object)
    movable = np.flatnonzero(np.isin(roles, ("control", "check")))
    roles[movable] = rng.permutation(roles[movable])
    if not len(task.observations.check):
        # Without check points the rest of a half is left out.
        roles[rng.permutation(movable)[len(movable) // 2:]] = "off"
    return features.with_(points=replace(features.points, roles=tuple(roles)))


def _fitted(task: Task, chosen: BoolArray) -> tuple[bool, dict[str, Rmse | None]]:
    """Return whether terms are a model of control and check together, and its RMSE."""
    both, axis = together(task.observations), task.model.axis
    scaling = scaling_of(both)
    if not chosen[axis == 0].any() or not chosen[axis == 1].any():
        return False, {}
    fitted = fit(task.model, both, scaling, chosen)
    guard = guard_points(scaling.features(both), scaling.points(both.points))
    if not fitted.adjustment.feasible or pole_violation(
            task.model, fitted.adjustment.coefficients[None], guard).any():
        return False, {}
    return True, figures(in_role(fitted, task.observations), task.observations)
