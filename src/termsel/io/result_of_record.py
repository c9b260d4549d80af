"""The result that a record and its features are of: the same fits again, no search."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import ValidationError, convert

from termsel.auto.function import OfFunction, OfPlaneFunction
from termsel.core.errors import TermselError, make_printable
from termsel.core.files.mismatches import KINDS_OF_JSON, mismatch_in_words
from termsel.core.version import __version__
from termsel.data.features import FeatureSet
from termsel.data.record.figures import as_plain_data
from termsel.data.record.record import RESULT_SCHEMA, PluginRecord, Record
from termsel.data.roles import ASSIGNABLE, Observations, observations_by_role, with_merged_twins
from termsel.data.scaling import Scaling
from termsel.fitting.figures import number, residuals_of, restrict_to_control, rmse_by_role
from termsel.fitting.fit import Estimator, Fit
from termsel.fitting.method import Method
from termsel.models.base import SensorModel
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.results.same_fit import fit_of_record

AGAIN = "Copy the whole folder again, or repeat the run."
"""What to do with a record that cannot be read."""


def record_from(content: Any) -> Record:
    """Return the record in the content of result.json.

    Raises TermselError if it is damaged, or of another version.
    """
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != RESULT_SCHEMA:
        has = f"its schema is {schema!r:.60}" if schema is not None else "it states no schema"
        raise TermselError(f"this is not a result that this version of termsel reads: {has}, "
                           f"expected {RESULT_SCHEMA!r}",
                           hint="Repeat the run with this version, or read the result with the one "
                                "that wrote it.")
    try:
        return convert(as_plain_data(content), Record)  # 1e999 is a number to JSON, not to us
    except RecursionError:
        raise TermselError("this result is damaged: it is nested too deeply", hint=AGAIN) from None
    except (ValidationError, UnicodeEncodeError) as error:  # keys may be no text at all
        mismatch = mismatch_in_words(str(error), KINDS_OF_JSON, lambda key: key or "the file")
        raise TermselError(f"this result is damaged{_clause_on_other_version(content)}: {mismatch}",
                           hint=AGAIN) from error


def _clause_on_other_version(content: dict[str, Any]) -> str:
    """Return a clause that a record may be of development code, whose keys changed; else ""."""
    versions = content.get("versions")
    written = str(versions.get("termsel")) if isinstance(versions, dict) else ""
    return f", or of development code ({make_printable(written[:40])})" if (
        "dev" in written and written != __version__) else ""


@np.errstate(over="ignore", invalid="ignore")  # of coefficients or places such as 1e300
def result_from(record: Record, features: FeatureSet) -> Result:
    """Return the result of a record and its features, each point with its role.

    Raises TermselError where the record does not fit the features, or the installed model is
    another one than that of the run.
    """
    observations = observations_by_role(features)
    model = _model_of_selection(record)
    fitted = _fit_of_selection(record, model, observations)
    _refuse_other_model(record, fitted, observations)
    residuals = residuals_of(fitted, observations, record.outliers,
                             check_used=record.strategy is not None)
    return Result.of(record, fit=fitted, final=_final_fit(record, model, observations),
                     features=features, residuals=residuals)


def _model_of_selection(record: Record) -> SensorModel:
    """Return the model of the selection.

    Raises TermselError where the model that is installed lacks a term of the record.
    """
    model_type = _model_type(record.plugins.get("model"), record.model)
    # Raises an error of its own where a plugin has changed its options since.
    declared: SensorModel = model_type(**record.options.model)
    model = declared.with_parameters(record.selection.parameters)
    if unknown := [name for name in record.coefficients if name not in model.terms]:
        raise TermselError(f"the installed model has no term {unknown[0]!r}, which is in the "
                           "record: the model is not the one of the run",
                           hint=_sentence_on_model_class(record))
    return model


def _fit_of_selection(record: Record, model: SensorModel, observations: Observations) -> Fit:
    """Return the fit of the selection, whose coefficients and figures are those of the record.

    A search selects among the control. auto fits to control and check points with twins merged,
    which the record then lists.
    """
    control = observations.control
    how = record.estimation
    if how.features is None:
        used = np.isin(control.ids, record.selection.features)
    else:
        joint = observations.together
        control = _merge_listed_points(joint, set(joint.ids), how.features)
        used = np.ones(len(control), dtype=bool)
    scaling = Scaling.from_numbers(record.scaling)
    fitted = fit_of_record(
        model, control, scaling, used, coefficients=record.coefficients,
        deviations=record.standard_deviations, figures=record.adjustment, how=how,
        by_plugin=_estimator_of_method(record))
    return restrict_to_control(fitted, observations)


def _merge_listed_points(features: FeatureSet, points: set[str],
                         ids: tuple[str, ...]) -> FeatureSet:
    """Return the features that a fit used: `points`, with twins merged, and the lines among `ids`.

    `ids` are the features of the fit as the record lists them. Raises TermselError where a merged
    point is not among them.
    """
    lines = features.lines
    fit_features = with_merged_twins(features.with_(
        points=features.points.take([name in points for name in features.points.ids]),
        lines=lines.take([name in ids for name in lines.ids])))
    if not set(fit_features.ids) <= set(ids):
        raise TermselError("this result is damaged at fit.features: they are not those of the "
                           "roles", hint=AGAIN)
    return fit_features


def _final_fit(record: Record, model: SensorModel, observations: Observations) -> Fit | None:
    """Return the final fit that a record has; None for a record without one.

    Its control are the lines and all points that were control, check or independent points, but for
    independent ones that are outliers. Coefficients and figures are taken from the record: nothing
    is fitted again.
    """
    final = record.final_fit
    if final is None:
        return None
    points = observations.features.points
    outliers = {outlier.id for outlier in record.outliers if outlier.role == "independent"}
    in_use = {name for name, role in zip(points.ids, points.roles, strict=True)
              if role in ASSIGNABLE} - outliers
    # In the final fit every point in use is control.
    roles = tuple("control" if name in in_use else role
                  for name, role in zip(points.ids, points.roles, strict=True))
    features = observations.features.with_(points=replace(points, roles=roles))
    control = _merge_listed_points(features, in_use, final.features)
    scaling = Scaling.from_numbers(final.scaling)
    used = np.ones(len(control), dtype=bool)
    return fit_of_record(
        model, control, scaling, used, coefficients=final.coefficients,
        deviations=final.standard_deviations, figures=final.adjustment, how=final.fit,
        by_plugin=_estimator_of_method(record))


def _estimator_of_method(record: Record) -> Estimator | None:
    """Return the estimator of the method that auto chose, None unless a plugin provides it."""
    plugin = record.plugins.get("method")
    if plugin is None:
        return None
    method: Method = registry().get("methods", plugin.name)
    return method.estimator


def _model_type(plugin: PluginRecord | None, name: str) -> type[SensorModel]:
    """Return the class of a model, as a plugin or this session provides it.

    Raises TermselError for a function of Python, which no file holds, and for a class or name that
    nothing provides.
    """
    names = registry()
    if name in (OfFunction.name, OfPlaneFunction.name):
        raise TermselError("this result is that of a function in Python, which no file holds",
                           hint="Call termsel.run again with the same features and function.")
    # Classes of a session are known by their address alone.
    if plugin and plugin.class_ and not any(
            entry.answers_to(plugin.name) for entry in names.entries("models")):
        raise TermselError(
            f"the model {name!r} of this result is the class {plugin.class_}, which no plugin "
            "provides", hint="In Python, call termsel.register with this class before reading the "
                             "result. To use it on the command line, put it into a plugin.")
    model: type[SensorModel] = names.get("models", plugin.name if plugin else name)
    return model


def _refuse_other_model(record: Record, fitted: Fit, observations: Observations) -> None:
    """Raise TermselError for a model that has changed since the run, as a plugin's may have.

    Each RMSE of the record must be that of the fit, computed again. One that is computed in another
    way, such as leave-one-out, is not compared.
    """
    current_rmse = rmse_by_role(fitted, observations)
    for role, rmse in record.rmse.by_role.items():
        current = current_rmse.get(role)
        total = number(rmse.total)
        # Coordinates in the tables are rounded, which changes an RMSE by far less than 1e-3.
        if rmse.n and current is not None and not np.isclose(
                total, current.total, rtol=1e-3, atol=1e-6, equal_nan=True):
            raise TermselError(
                f"the {role} RMSE is {current.total:.4g} px by the installed model and "
                f"{total:.4g} px in the record: the model is not the one of the run",
                hint=_sentence_on_model_class(record))


def _sentence_on_model_class(record: Record) -> str:
    """Return a sentence on the class or version of the model that a run used."""
    plugin = record.plugins.get("model")
    if plugin is not None and plugin.class_:
        return (f"The run used the class {plugin.class_} as it was then. Register that one, or "
                "repeat the run.")
    made_by = (f"{plugin.name} of version {plugin.version}" if plugin else
               f"{record.model} of termsel {record.versions['termsel']}")
    return f"The run used {made_by}. Install that version, or repeat the run."
