"""The record of a run: result.json and its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from termsel.features import FloatArray
from termsel.fitting import Fit, Rmse
from termsel.problems.base import Selection

SCHEMA = "termsel-result-1"
ROLES = ("control", "check", "independent")

Rmses = Mapping[str, Rmse | None]


@dataclass(frozen=True)
class Baseline:
    """A fit without any search, beside which the selection is shown.

    Parameters
    ----------
    name : str
    n_terms : int
        Terms of both axes together.
    fitted_to : tuple of str
        Roles whose features took part in the adjustment.
    determined : bool
        False if the control does not determine the terms; the figures are then those of
        the least-norm solution.
    rmse : mapping
        By role; None where there are no points.
    """

    name: str
    n_terms: int
    fitted_to: tuple[str, ...]
    determined: bool
    rmse: Rmses


@dataclass(frozen=True, eq=False)
class Result:
    """What a run found, with the accuracy it has on points no choice has seen.

    Parameters
    ----------
    problem, model, solver, criterion : str
    seed : int
    options : mapping
        Options of problem, model, solver, criterion and data.
    data : mapping
        Source, checksum, counts, and noise where it is known.
    selection : Selection
    feasible : bool
        False if no selection satisfied all conditions.
    rmse : mapping
        By role. "check" is the fitness, "independent" the accuracy.
    baselines : tuple of Baseline
    judgement : str
        A plain sentence on what the selection is worth.
    notes : tuple of str
        What else the reader must know.
    objectives : mapping
        The search's objectives at the selection.
    evaluations, lookups, generations : int
    seconds : float
    interrupted : bool
    polish : mapping, optional
        First objective as the solver found it and after the polish, and the evaluations of
        the polish, which come on top of the solver's.
    fit : Fit
        The fitted model.
    residuals : tuple of Residual
    versions : mapping
    front : tuple
        Non-dominated selections of a search with several objectives.
    certificate : mapping, optional
        What was proven.
    """

    problem: str
    model: str
    solver: str
    criterion: str
    seed: int
    options: Mapping[str, Any]
    data: Mapping[str, Any]
    selection: Selection
    feasible: bool
    rmse: Rmses
    baselines: tuple[Baseline, ...]
    judgement: str
    notes: tuple[str, ...]
    objectives: Mapping[str, float]
    evaluations: int
    lookups: int
    generations: int
    seconds: float
    interrupted: bool
    polish: Mapping[str, float] | None
    fit: Fit
    residuals: tuple[Residual, ...]
    versions: Mapping[str, str]
    front: tuple[Mapping[str, Any], ...] = ()
    certificate: Mapping[str, Any] | None = None

    @property
    def hit_rate(self) -> float:
        """Share of all evaluations, with those of the polish, that were looked up."""
        polish = self.polish or {"lookups": 0, "evaluations": 0}
        return float((self.lookups + polish["lookups"])
                     / (self.evaluations + polish["evaluations"]))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of result.json."""
        adjustment = self.fit.adjustment
        terms = self.fit.model.terms
        chosen = [i for i, on in enumerate(self.fit.terms) if on]
        return {
            "schema": SCHEMA,
            "problem": self.problem, "model": self.model, "solver": self.solver,
            "criterion": self.criterion, "seed": self.seed, "options": dict(self.options),
            "data": dict(self.data),
            "selection": {
                "terms": list(self.selection.terms), "features": list(self.selection.features),
                "n_terms": len(self.selection.terms),
                "n_features": len(self.selection.features)},
            "feasible": self.feasible,
            "objectives": {k: _number(v) for k, v in self.objectives.items()},
            "rmse": plain_rmse(self.rmse),
            "baselines": [
                {"name": b.name, "n_terms": b.n_terms, "fitted_to": list(b.fitted_to),
                 "determined": b.determined, "rmse": plain_rmse(b.rmse)} for b in self.baselines],
            "judgement": self.judgement, "notes": list(self.notes),
            "front": list(self.front), "certificate": self.certificate,
            "evaluations": self.evaluations, "lookups": self.lookups,
            "hit_rate": self.hit_rate,
            "generations": self.generations, "seconds": self.seconds,
            "interrupted": self.interrupted, "polish": self.polish,
            "coefficients": {terms[i]: float(adjustment.coefficients[i]) for i in chosen},
            "standard_deviations": {terms[i]: _number(adjustment.deviations[i]) for i in chosen},
            "adjustment": {
                "equations": adjustment.n_equations, "terms": adjustment.n_terms,
                "redundancy": adjustment.redundancy, "rank": adjustment.rank,
                "condition": _number(adjustment.condition),
                "sigma0": _number(adjustment.sigma0 * self.fit.scaling.image_scale)},
            "scaling": self.fit.scaling.to_dict(),
            "versions": dict(self.versions)}

    def to_json(self) -> str:
        """Return result.json as text."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"


@dataclass(frozen=True)
class Residual:
    """What is left at one point, or at one ground vertex of a control line.

    Parameters
    ----------
    id : str
    kind : str
        "point", or "vertex 1" and "vertex 2" of a line and of its further pieces from 3 on.
    role : str
    used : bool
        Whether the feature took part in the adjustment.
    line, sample : float
        Measured minus computed [pixel]; for a vertex, from its projection to the image line.
    distance : float
        Length of that vector [pixel].
    """

    id: str
    kind: str
    role: str
    used: bool
    line: float
    sample: float
    distance: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance", float(np.hypot(self.line, self.sample)))


def residuals_of(ids: tuple[str, ...], errors: FloatArray, role: str,
                 used: tuple[bool, ...], kind: str = "point") -> list[Residual]:
    """Return the residuals of one role.

    Parameters
    ----------
    ids : tuple of str, length n
    errors : ndarray, shape (n, 2)
    role : str
    used : tuple of bool, length n
    kind : str
    """
    return [Residual(name, kind, role, on, float(line), float(sample))
            for name, on, (line, sample) in zip(ids, used, errors, strict=True)]


def plain_rmse(rmse: Rmses) -> dict[str, Any]:
    """Return RMSE by role as result.json holds them; null where there are no points."""
    nothing = {"line": None, "sample": None, "total": None, "n": 0}
    return {role: nothing if value is None else
            {k: _number(v) if k != "n" else v for k, v in asdict(value).items()}
            for role, value in ((role, rmse.get(role)) for role in ROLES)}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
