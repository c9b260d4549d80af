"""A result from the record a run has written of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from termsel.features import FeatureSet
from termsel.fitting import Fit, Rmse, fit
from termsel.models.base import SensorModel
from termsel.plugins.manager import registry
from termsel.problems.base import Selection
from termsel.residuals import residuals_of
from termsel.result import Baseline, Result
from termsel.roles import by_roles
from termsel.scaling import Scaling


def result_from(record: Mapping[str, Any], features: FeatureSet) -> Result:
    """Return the result of a record and the features it speaks of.

    Parameters
    ----------
    record : mapping
        The content of result.json.
    features : FeatureSet
        Each point has the role it played.

    Raises
    ------
    TermselError
        If the model is not known here or its options are not.
    KeyError, TypeError, ValueError
        If the record is not one that `Result.to_dict` has made.
    """
    fitted, chosen = _fit(record, features), record["selection"]
    residuals = residuals_of(fitted, by_roles(features), check_used=record["strategy"] is not None)
    return Result(
        **{name: record[name] for name in (
            "problem", "model", "solver", "criterion", "seed", "options", "data", "feasible",
            "judgement", "objectives", "evaluations", "lookups", "generations", "seconds",
            "interrupted", "polish", "versions", "certificate", "strategy")},
        selection=Selection(tuple(chosen["terms"]), tuple(chosen["features"])),
        rmse=_rmse(record["rmse"]),
        baselines=tuple(Baseline(b["name"], b["n_terms"], tuple(b["fitted_to"]), b["determined"],
                                 _rmse(b["rmse"]), b["predicted"]) for b in record["baselines"]),
        notes=tuple(record["notes"]), fit=fitted, residuals=residuals, features=features,
        front=tuple(record["front"]))


def _fit(record: Mapping[str, Any], features: FeatureSet) -> Fit:
    model_type = registry().get("models", record["model"])
    model: SensorModel = model_type(**record["options"]["model"])
    scaling = Scaling.from_dict(record["scaling"])
    coefficients, deviations = np.zeros(len(model.terms)), np.zeros(len(model.terms))
    for name, value in record["coefficients"].items():
        term = model.terms.index(name)
        coefficients[term] = value
        deviations[term] = _float(record["standard_deviations"][name])
    sizes = (*scaling.ground_offset, *scaling.ground_scale, *scaling.image_offset,
             scaling.image_scale)
    if not np.isfinite([*sizes, *coefficients]).all():
        raise ValueError("a coefficient or the scaling is not a finite number")
    control = by_roles(features).control
    terms = np.array([name in record["coefficients"] for name in model.terms])
    used = np.isin(control.ids, record["selection"]["features"])
    fitted, said = fit(model, control, scaling, terms, used), record["adjustment"]
    if not np.allclose(fitted.adjustment.coefficients, coefficients):
        fitted = fitted.with_coefficients(coefficients)  # a solver's own, such as those of ridge
    # The figures of the record, whatever the rounding of this machine.
    return replace(fitted, adjustment=replace(
        fitted.adjustment, coefficients=coefficients, deviations=deviations,
        n_terms=said["terms"], n_equations=said["equations"], rank=said["rank"],
        condition=float("inf") if said["condition"] is None else said["condition"],
        sigma0=_float(said["sigma0"]) / scaling.image_scale))


def _rmse(plain: Mapping[str, Any]) -> dict[str, Rmse | None]:
    return {role: Rmse(_float(one["line"]), _float(one["sample"]), _float(one["total"]), one["n"])
            if one["n"] else None for role, one in plain.items()}


def _float(value: float | None) -> float:
    return float("nan") if value is None else value
