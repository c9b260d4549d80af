"""The folder of a result: result.json, what it was made from, and tables for people."""

from __future__ import annotations

import csv
import io
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel.candidates.candidate import named
from termsel.errors import TermselError
from termsel.files.atomic import encoded, private_folder, put_in_place, sync, write_bytes
from termsel.files.names import JOURNAL, is_there
from termsel.fits.accuracy import Predicted, accuracy_from
from termsel.fits.diagnosis import Diagnosis, Doubts, Significance
from termsel.fits.figures import Baseline, figures, residuals_of
from termsel.fits.fit import GIVEN, Fit
from termsel.fits.least_squares import fit
from termsel.fits.rmse import Rmse
from termsel.formats.base import located, parse_json, read_text
from termsel.formats.readers.csv_tables import LinesCsv, PointsCsv, lines_text, points_text
from termsel.formats.readers.formulas import guarded
from termsel.measurements.coordinates.crs import normalise
from termsel.measurements.features import FeatureSet, no_lines, no_points
from termsel.measurements.roles import Observations, by_roles, together
from termsel.measurements.scaling import Scaling
from termsel.models.base import SensorModel
from termsel.plugins.registry import registry
from termsel.problems.base import Selection
from termsel.results.checksums import SEALS, of_attributes, of_features, of_record
from termsel.results.result import SCHEMA, Outlier, Result

RECORD, POINTS, LINES = "result.json", "points.csv", "lines.csv"
RESIDUALS, SUMMARY = "residuals.csv", "summary.txt"
_PENDING = ".termsel-pending"
"""Folder in that of a result, complete or not there: files that are newer than those next to it."""

RESIDUAL_COLUMNS = ("id", "kind", "role", "used", "residual_line", "residual_sample", "distance")


def files_of_result(folder: Path) -> list[Path]:
    """Return all files that a result in this folder may have."""
    return [place / name for place in (folder, folder / _PENDING)
            for name in (RECORD, POINTS, LINES, RESIDUALS, SUMMARY)]


def names_of(features: FeatureSet) -> tuple[str, ...]:
    """Return the names of the files that a result of these features has."""
    return (RECORD, RESIDUALS, SUMMARY, *[POINTS] * bool(len(features.points)),
            *[LINES] * bool(len(features.lines)))


def claim_folder(folder: Path, *, overwrite: bool = False) -> None:
    """Make the folder, or refuse it before a long search.

    Parameters
    ----------
    folder : path
    overwrite : bool
        Whether a result that is there may be replaced.

    Raises
    ------
    TermselError
        If it cannot be made or written to, is that of a study, or has a result that may not be
        replaced, or files that would be replaced and are not those of a result.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TermselError(f"cannot make the folder {folder}: {error.strerror}",
                           hint="Choose another --out.") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise TermselError(f"cannot write to the folder {folder}", hint="Choose another --out.")
    if is_there(folder / JOURNAL):
        raise TermselError("this is the folder of a study, which takes no further result",
                           file=folder, hint="Choose another --out.")
    for name in (POINTS, LINES, RESIDUALS, SUMMARY):
        if is_there(folder / name) and not is_there(_place(folder, RECORD)):
            raise TermselError("the result would replace this file, which is not part of a result",
                               file=folder / name, hint="Choose another --out.")
    if not overwrite and _place(folder, RECORD).exists():
        raise TermselError("there is a result in this folder already", file=folder,
                           hint="Choose another --out, or add --overwrite.")


def write_result(result: Result, folder: Path) -> None:
    """Write result.json, residuals.csv, summary.txt and the features, all of them or none.

    With points.csv and lines.csv the folder is self-contained: the files that the features came
    from are not needed any more. Wherever this is interrupted, `read_result` finds the earlier
    result or the new one: the new files are written into a folder of their own, one renaming
    makes them valid, and then they are put in place one by one.

    Parameters
    ----------
    result : Result
    folder : Path
        One that exists; files of an earlier result are replaced.
    """
    files = {name: encoded(text) for name, text in _files(result).items()}
    _put_in_place(folder)  # an earlier result, if that was interrupted
    try:
        with private_folder(folder) as new:
            for name, content in files.items():
                (new / name).write_bytes(content)
                sync(new / name)
            shutil.copymode(folder, new)
            new.rename(folder / _PENDING)
            sync(folder)
    except OSError as error:
        raise _cannot_write(folder, error) from error
    _put_in_place(folder)


def _files(result: Result) -> dict[str, str]:
    """Return the content of each file of a result."""
    points, lines, crs = result.features.points, result.features.lines, result.features.crs
    return {**({POINTS: points_text(points, crs)} if len(points) else {}),
            **({LINES: lines_text(lines, crs)} if len(lines) else {}),
            RESIDUALS: residuals_csv(result), SUMMARY: result.summary(),
            RECORD: result.to_json()}


def _put_in_place(folder: Path) -> None:
    """Replace the files of a folder by those that are pending, if any."""
    pending = folder / _PENDING
    if not pending.is_dir():
        return
    try:
        for file in sorted(pending.iterdir()):
            if (folder / file.name).is_symlink():  # what it points to may be on another disk
                write_bytes(folder / file.name, file.read_bytes())
                file.unlink()
            else:
                put_in_place(file, folder / file.name)
        sync(folder)
        pending.rmdir()
    except OSError as error:
        raise _cannot_write(folder, error) from error


def _cannot_write(folder: Path, error: OSError) -> TermselError:
    return TermselError(f"cannot write the result: {error.strerror or error}", file=folder,
                        hint="Check that the folder is writable and has free space, or choose "
                             "another --out.")


def _place(folder: Path, name: str) -> Path:
    """Return where a file of the result is: pending, if that is not yet put in place."""
    pending = folder / _PENDING / name
    return pending if is_there(pending) else folder / name


def read_result(folder: Path | str) -> Result:
    """Return the result a run has written to a folder.

    Parameters
    ----------
    folder : path-like
        As given to ``--out``.

    Returns
    -------
    Result
        As the run returned it.

    Raises
    ------
    TermselError
        If there is no result, a file of it is missing, was changed or is of another version, or
        its model is of a plugin that is not installed.
    """
    path = _place(Path(folder), RECORD)
    if not is_there(path):
        raise TermselError("there is no result here", file=path,
                           hint="Give the folder of a run, as in termsel run --out DIR.")
    try:
        record = parse_json(read_text(path), "Run the search again.")
    except TermselError as error:
        raise located(error, path) from error
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise TermselError(f"this is not a result with the schema {SCHEMA}", file=path,
                           hint="Run the search again with this version of termsel.")
    try:
        seals = record[SEALS]
        _refuse_changed(seals["record"] != of_record(record), path)
        features = _read_features(Path(folder), record)
        files = [name for name, part in ((POINTS, features.points), (LINES, features.lines))
                 if len(part)]
        _refuse_changed(seals["features"] != of_features(features)
                        or seals.get("attributes") != of_attributes(features),
                        path.with_name(" or ".join(files)))
        return result_from(record, features)
    except TermselError as error:
        raise (error if error.file is not None else located(error, path)) from error
    except (AttributeError, LookupError, RecursionError, TypeError,
            ValueError) as error:  # edited by hand
        raise TermselError(f"this result is damaged: {type(error).__name__}: {error}", file=path,
                           hint="Run the search again.") from error


def _read_features(folder: Path, record: Mapping[str, Any]) -> FeatureSet:
    """Return the features of a result; refuse features other than those it was made from."""
    data = record.get("data", {})
    size = data.get("image_size")
    normalise(data["crs"])
    # By the record: an earlier result in the same folder may have left a file that this has not.
    counts = dict(data["counts"])
    at_lines, at_points = (_place(folder, name) for name in (LINES, POINTS))
    lines = LinesCsv().read(at_lines).lines if counts.pop("lines") else no_lines()
    points = PointsCsv().read(at_points).points if any(counts.values()) else no_points()
    features = FeatureSet(points, lines, data["crs"], size and (int(size[0]), int(size[1])),
                          data.get("noise"), data.get("heights") or "",
                          record.get("scaling", {}).get("fit_crs", ""))
    observations = by_roles(features)
    roles = {"control": observations.control.ids, "check": observations.check.ids,
             "independent": observations.independent.ids, "off": observations.off}
    for role, ids in roles.items():
        if set(ids) != set(data.get("roles", {}).get(role, ())):
            raise TermselError(f"{POINTS} and {LINES} do not have the {role} features that "
                               f"{RECORD} names", file=folder,
                               hint="Leave the files of a result unchanged; run the search again.")
    return features


def _refuse_changed(changed: bool, path: Path) -> None:
    """Refuse a file that was changed after the run."""
    if changed:
        raise TermselError("this file was changed after the run wrote it", file=path,
                           hint="Leave the files of a result unchanged; run the search again.")


def residuals_csv(result: Result) -> str:
    """Return the residuals of all features [px] as CSV."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(RESIDUAL_COLUMNS)
    for r in result.residuals:
        table.writerow([guarded(r.id), r.kind, r.role, "yes" if r.used else "no", f"{r.line:.6g}",
                        f"{r.sample:.6g}", f"{r.distance:.6g}"])
    return text.getvalue()


def result_from(record: Mapping[str, Any], features: FeatureSet) -> Result:
    """Return the result of a record and its features.

    Parameters
    ----------
    record : mapping
        The content of result.json.
    features : FeatureSet
        Each point has its role.

    Raises
    ------
    TermselError
        If the model or one of its options is unknown.
    KeyError, TypeError, ValueError
        If the record is not one that `Result.to_dict` has made.
    """
    fitted, chosen = _fit(record, features), record["selection"]
    _refuse_other_model(record, fitted, by_roles(features))
    final = record.get("final")
    residuals = residuals_of(fitted, by_roles(features), check_used=record["strategy"] is not None)
    return Result(
        **{name: record[name] for name in (
            "problem", "model", "solver", "criterion", "seed", "options", "data", "feasible",
            "judgement", "objectives", "evaluations", "lookups", "generations", "seconds",
            "interrupted", "polish", "versions", "certificate", "strategy")},
        plugins=record.get("plugins", {}),
        selection=Selection(tuple(chosen["terms"]), tuple(chosen["features"]),
                            chosen.get("parameters", {})),
        rmse=_rmse(record["rmse"]),
        baselines=tuple(Baseline(b["name"], b["n_terms"], tuple(b["fitted_to"]), b["determined"],
                                 _rmse(b["rmse"]), b["predicted"]) for b in record["baselines"]),
        notes=tuple(record["notes"]), fit=fitted, residuals=residuals,
        diagnosis=_diagnosis(record), features=features,
        outliers=tuple(Outlier(**one) for one in record.get("outliers", ())),
        predicted=Predicted(**found) if (found := record.get("predicted")) else None,
        accuracy=accuracy_from(given) if (given := record.get("accuracy")) else None,
        front=tuple(record["front"]), history=tuple(record.get("history", ())),
        budget=record.get("budget", {}), stability=record.get("stability"),
        by_size=tuple(record.get("by_size", ())),
        final=_final(record, final, fitted, features) if final else None)


def _fit(record: Mapping[str, Any], features: FeatureSet) -> Fit:
    model_type = _model_type(record.get("plugins", {}).get("model"), record["model"])
    asked: SensorModel = model_type(**record["options"]["model"])
    model = asked.with_parameters(record["selection"].get("parameters", {}))
    scaling = Scaling.from_dict(record["scaling"])
    coefficients, deviations = np.zeros(len(model.terms)), np.zeros(len(model.terms))
    if unknown := [name for name in record["coefficients"] if name not in model.terms]:
        raise TermselError(f"the installed model has no term {unknown[0]!r}, which is in the "
                           "record: the model is not the one of the run", hint=_made_by(record))
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
    fitted = replace(fitted, adjustment=replace(
        fitted.adjustment, coefficients=coefficients, deviations=deviations,
        n_terms=said["terms"], n_equations=said["equations"], rank=said["rank"],
        condition=float("inf") if said["condition"] is None else said["condition"],
        sigma0=_float(said["sigma0"]) / scaling.image_scale))
    chosen = record["strategy"] and named(record["strategy"]["chosen"])
    if not chosen:
        return fitted
    both = together(by_roles(features))
    used = ~np.isin(both.ids, list(set(control.ids) - set(record["selection"]["features"])))
    return replace(fitted, made=replace(fitted, control=both, estimator=chosen.estimator,
                                        used=used))


def _model_type(plugin: Mapping[str, str] | None, name: str) -> type[SensorModel]:
    """Return the class of a model, as a plugin or this session provides it."""
    known = registry()
    if plugin and "class" in plugin and not any(
            entry.answers_to(plugin["name"]) for entry in known.entries("models")):
        raise TermselError(
            f"the model {name!r} of this result is the class {plugin['class']}, which no plugin "
            "provides", hint="In Python, call termsel.register with this class before reading the "
                             "result. To use it on the command line, put it into a plugin.")
    found: type[SensorModel] = known.get("models", plugin["name"] if plugin else name)
    return found


def _refuse_other_model(record: Mapping[str, Any], fitted: Fit,
                        observations: Observations) -> None:
    """Refuse a model that has changed since the run, as another version of a plugin may have."""
    said = {role: _float(one["total"]) for role, one in record["rmse"].items()}
    now = {role: rmse.total for role, rmse in figures(fitted, observations).items() if rmse}
    # Leave-one-out of what auto chose is told by what it predicts, not here.
    other = [role for role, value in now.items() if role in said and
             not np.isclose(said[role], value, rtol=1e-3, atol=1e-6, equal_nan=True)]
    if not other:
        return
    raise TermselError(
        f"the {other[0]} RMSE is {now[other[0]]:.4g} px by the installed model and "
        f"{said[other[0]]:.4g} px in the record: the model is not the one of the run",
        hint=_made_by(record))


def _made_by(record: Mapping[str, Any]) -> str:
    plugin = record.get("plugins", {}).get("model", {})
    if "class" in plugin:
        return (f"The run used the class {plugin['class']} as it was then. Register that one, or "
                "run the search again.")
    made_by = (f"{plugin['name']} of version {plugin['version']}" if plugin else
               f"{record['model']} of termsel {record['versions']['termsel']}")
    return f"The run used {made_by}. Install that version, or run the search again."


def _final(record: Mapping[str, Any], final: Mapping[str, Any], fitted: Fit,
           features: FeatureSet) -> Fit:
    names = set(final["features"])
    control = features.take(np.array([name in names for name in features.ids]))
    scaling, model = Scaling.from_dict(final["scaling"]), fitted.model
    coefficients = np.array([final["coefficients"].get(name, 0.0) for name in model.terms])
    found = fit(model, control, scaling, fitted.terms)
    chosen = named(record["strategy"]["chosen"])
    return found if np.allclose(found.adjustment.coefficients, coefficients) else \
        found.with_coefficients(coefficients, chosen.estimator if chosen else GIVEN)


def _diagnosis(record: Mapping[str, Any]) -> Diagnosis:
    doubts = record["doubts"]
    return Diagnosis(
        {name: Significance(**one) for name, one in record["significance"].items()},
        tuple((*pair["terms"], pair["correlation"]) for pair in record["correlations"]),
        None if doubts is None else Doubts(doubts["sigma"], doubts["wrong"],
                                           tuple(doubts["in_use"]), tuple(doubts["spare"])),
        record["adjustment"]["orientation_spread"])


def _rmse(plain: Mapping[str, Any]) -> dict[str, Rmse | None]:
    return {role: Rmse(_float(one["line"]), _float(one["sample"]), _float(one["total"]), one["n"])
            if one["n"] else None for role, one in plain.items()}


def _float(value: float | None) -> float:
    return float("nan") if value is None else value
