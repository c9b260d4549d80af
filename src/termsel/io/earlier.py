"""Records of termsel 0.1 and 0.2, completed by what this version stores."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from termsel.candidates.structures import named
from termsel.fits.fit import Fit
from termsel.fits.least_squares import LEAST_SQUARES
from termsel.measurements.features import BoolArray, FeatureSet, Points
from termsel.measurements.scaling import Scaling
from termsel.models.base import SensorModel
from termsel.record.record import FitRecord, Record
from termsel.results.same_fit import least_squares_of

_SINCE_0_1: dict[str, Any] = {
    "predicted": None, "accuracy": None, "final": None, "exported": "selection",
    "history": [], "budget": {}, "plugins": {}}
"""Keys that version 0.1 did not have, with what says nothing."""


def completed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of result.json with all keys of this version; of no record as it is."""
    if "fit" in content:
        return content
    try:
        # Up to 0.2 a record did not say how its coefficients were found. It follows from the
        # candidate that auto chose, and from the objectives, which only least squares has.
        content = {key: value for key, value in content.items() if key != "doubts"}
        outliers = [{"certainty": "probable", **one} for one in content.get("outliers", ())]
        strategy = content["strategy"] and {"reason": "", **content["strategy"]}
        return {**_SINCE_0_1, "offered": _offered(content), **content,
                "options": {"search": {}, **content["options"]}, "strategy": strategy,
                "outliers": outliers,
                "fit": {"options": {}, "effective": None, "held_out": None, **_how(content)}}
    except (AttributeError, LookupError, TypeError, ValueError):  # decoding says what is damaged
        return content


def _how(content: dict[str, Any]) -> dict[str, Any]:
    """Return the estimator, and what it was fitted to if that is not the control."""
    if content["strategy"]:
        candidate = named(content["strategy"]["chosen"])
        return {"estimator": candidate.estimator.name if candidate else "given",
                "features": [*content["selection"]["features"], *content["data"]["roles"]["check"]]}
    if content["objectives"]:
        return {"estimator": "least-squares", "features": None}
    shrunk = content["options"]["problem"].get("shrink")
    return {"estimator": "ridge-by-order" if shrunk else "given", "features": None}


def _offered(content: dict[str, Any]) -> dict[str, Any]:
    """Return what there was to select from, by the conventional fit and the counts of features."""
    terms = [content["selection"]["n_terms"], *(
        one["n_terms"] for one in content["baselines"] if one["name"] == "all-terms")]
    counts = content["data"]["counts"]
    return {"n_terms": max(terms), "n_features": counts["control"] + counts["lines"]}


def iteration_known(how: FitRecord, model: SensorModel, control: FeatureSet, scaling: Scaling,
                    terms: BoolArray, used: BoolArray, check: Points) -> FitRecord:
    """Return how a fit was found, with whether the iteration for lines was run."""
    if how.estimator != LEAST_SQUARES.name or how.options:
        return how
    # Up to 0.2 that follows from the rule of the run alone, which is applied again.
    chosen = least_squares_of(model, control, scaling, terms, used, check)
    return msgspec.structs.replace(how, options=chosen.estimator.options)


def final_of_0_2(record: Record, model: SensorModel, control: FeatureSet, scaling: Scaling,
                 used: BoolArray) -> Fit:
    """Return the final fit of a record of 0.2, which has nothing but its coefficients."""
    assert record.final is not None
    assert record.strategy is not None
    candidate, values = named(record.strategy.chosen), record.final.coefficients
    terms = np.array([name in values for name in model.terms], dtype=bool)
    # The terms that a forward selection chose stayed those of the choice.
    estimator = LEAST_SQUARES if candidate is None or candidate.estimator.least_squares \
        else candidate.estimator
    fitted = estimator.fit(model, control, scaling, terms, used)
    coefficients = np.array([values.get(name, 0.0) for name in model.terms])
    return replace(fitted, adjustment=replace(fitted.adjustment, coefficients=coefficients))
