"""The record of a run: result.json and its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from termsel.diagnosis import correlations, doubts, orientation_spread, significance
from termsel.errors import TermselError
from termsel.features import FeatureSet, FloatArray
from termsel.fitting import Fit, Rmse
from termsel.inverse import Surface
from termsel.problems.base import Selection
from termsel.residuals import Residuals
from termsel.sealing import sealed

if TYPE_CHECKING:
    from termsel.rpc import Rpc

SCHEMA = "termsel-result-1"
ROLES = ("control", "check", "independent")
LEAVE_ONE_OUT = "leave-one-out"
"""Key of a further RMSE of the control, under models that correct predictions by it."""

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
        By role; None where there are no points, or where the model is not determined.
    predicted : float, optional
        RMSE by leave-one-out over the features it was fitted to [pixel].
    """

    name: str
    n_terms: int
    fitted_to: tuple[str, ...]
    determined: bool
    rmse: Rmses
    predicted: float | None = None


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
    residuals : Residuals
        Of all features, as a table.
    features : FeatureSet
        What was measured; each point has the role it played.
    versions : mapping
    front : tuple
        Non-dominated selections of a search with several objectives.
    certificate : mapping, optional
        What was proven.
    strategy : mapping, optional
        Of a choice by the strategy "auto": what was chosen, the accuracy it predicts, and all
        candidates with theirs.
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
    residuals: Residuals
    features: FeatureSet
    versions: Mapping[str, str]
    front: tuple[Mapping[str, Any], ...] = ()
    certificate: Mapping[str, Any] | None = None
    strategy: Mapping[str, Any] | None = None

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
        used = self.fit.control.take(self.fit.used)
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
                 "determined": b.determined, "predicted": b.predicted, "rmse": plain_rmse(b.rmse)}
                for b in self.baselines],
            "judgement": self.judgement, "notes": list(self.notes),
            "front": list(self.front), "certificate": self.certificate, "strategy": self.strategy,
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
                "sigma0": _number(adjustment.sigma0 * self.fit.scaling.image_scale),
                "orientation_spread": orientation_spread(used.lines) if len(used.lines) else None},
            "significance": {name: asdict(one) for name, one in significance(self.fit).items()},
            "correlations": [{"terms": [one, other], "correlation": value}
                             for one, other, value in correlations(self.fit)],
            "doubts": asdict(found) if (found := doubts(self.fit)) else None,
            "scaling": self.fit.scaling.to_dict(),
            "versions": dict(self.versions)}

    def of_image(self, size: tuple[int, int]) -> Result:
        """Return the result with the size of its image, which files of points do not state.

        Parameters
        ----------
        size : tuple of int
            Lines and samples [pixel].
        """
        control = replace(self.fit.control, image_size=size)
        return replace(self, features=replace(self.features, image_size=size),
                       fit=replace(self.fit, control=control))

    def project(self, ground: ArrayLike) -> FloatArray:
        """Return where the fitted model sees ground points.

        Parameters
        ----------
        ground : array_like, shape (n, 3)
            In the CRS of the control; NaN for heights a plane model does without.

        Returns
        -------
        ndarray, shape (n, 2)
            Line and sample [pixel]; NaN where a coordinate that the model uses is not finite.

        Raises
        ------
        TermselError
            If the array has another shape.
        """
        places = np.asarray(ground, dtype=np.float64)
        if places.ndim != 2 or places.shape[1] != 3:
            raise TermselError(f"ground points have shape {places.shape}, expected (n, 3)")
        image = self.fit.project(places)
        needed = places if self.fit.model.uses_height else places[:, :2]
        image[~np.isfinite(needed).all(axis=1)] = np.nan
        return image

    def locate(self, image: ArrayLike, height: ArrayLike | Surface) -> FloatArray:
        """Return the ground points seen at image points, by the fitted model.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [pixel].
        height : array_like, shape (n,), a number, or callable
            Heights, or what gives them for x and y, shape (n, 2), such as a DEM.

        Returns
        -------
        ndarray, shape (n, 3)
            In the CRS of the control; NaN where there is none.
        """
        return self.fit.locate(image, height)

    def to_rpc(self) -> Rpc:
        """Return the fitted model as RPC.

        Rational functions and polynomials to the third degree of WGS84 longitude, latitude and
        ellipsoidal height are RPCs as they are. Any other fit is replaced by the RPC next to
        it, and what that costs is logged; `termsel.rpc_fitting.rpc_of` returns it.

        Raises
        ------
        TermselError
            If the ground coordinates cannot be turned into longitude and latitude, or no RPC
            comes near the fit.
        """
        from termsel.rpc_fitting import rpc_of

        return rpc_of(self.fit).rpc

    def export(self, to: str, path: Path | str, *, overwrite: bool = False, **options: Any) -> None:
        """Write the result in a format known by name (see `termsel.io.exporting.export`)."""
        from termsel.io.exporting import export

        export(self, to, path, overwrite=overwrite, **options)

    def to_json(self) -> str:
        """Return result.json as text: `to_dict` and its checksums."""
        record = sealed(self.to_dict(), self.features)
        return json.dumps(record, indent=1, allow_nan=False) + "\n"

    def _repr_html_(self) -> str:
        """Return the summary for a notebook."""
        from termsel.report.text import summary

        return f"<pre>{escape(summary(self))}</pre>"


def plain_rmse(rmse: Rmses) -> dict[str, Any]:
    """Return RMSE by role as result.json holds them; null where there are no points.

    That by leave-one-out stands beside them, if there is one.
    """
    nothing = {"line": None, "sample": None, "total": None, "n": 0}
    return {role: nothing if value is None else
            {k: _number(v) if k != "n" else v for k, v in asdict(value).items()}
            for role, value in ((role, rmse.get(role)) for role in dict.fromkeys((*ROLES, *rmse)))}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
