"""What a method found on the features of a run, and the result that is made of it.

This is the one place where a `Result` is made from a run.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from termsel.core.isolation.faults import is_own
from termsel.data.coordinates.crs import height_reference
from termsel.data.coordinates.earth import find_swapped_axes, place_of
from termsel.data.coordinates.plausible import note_on_wrong_coordinates
from termsel.data.features import select
from termsel.data.record.figures import Predicted
from termsel.data.record.record import (
    RESULT_SCHEMA,
    Counts,
    DataRecord,
    IdsByRole,
    Record,
    WhatWasRead,
)
from termsel.data.roles import Observations
from termsel.fitting.accuracy import accuracy_of
from termsel.fitting.figures import Baseline, Rmses, residuals_of, rmse_by_role, rmse_record
from termsel.fitting.fit import Fit
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.registry import SESSION, registry
from termsel.results.result import Result, checksum_of_features
from termsel.results.same_fit import final_fit, numbers_of
from termsel.runs.data_notes import find_two_groups
from termsel.runs.request import Request
from termsel.runs.verdict import Verdict
from termsel.selection.problems.base import Selection

if TYPE_CHECKING:
    from termsel.runs.request import Request

# What a result is made of: data and versions, for the record.

def data_record_of(request: Request, observations: Observations) -> DataRecord:
    """Return the record of the features of a request, as read and in their roles."""
    features = request.features
    control = observations.control
    counts = Counts(len(control.points), len(observations.check), len(observations.independent),
                    len(control.lines.features), len(observations.off))
    roles = IdsByRole(control.ids, observations.off, observations.check.ids,
                      observations.independent.ids)
    return DataRecord(
        source=request.source, sha256=checksum_of_features(features), crs=features.crs,
        fit_crs=control.fit_crs or features.crs,
        heights=features.heights or height_reference(features.crs) or None,
        noise=features.noise, image_size=features.image_size, counts=counts, roles=roles,
        read=_what_was_read(request, observations),
        rpc=None if features.rpc is None else features.rpc.numbers())


def _what_was_read(request: Request, observations: Observations) -> WhatWasRead:
    """Return the record of the features read, and of those out of use, except blunders.

    It is what the first screen says of the file. Doubts that were warned of while reading are
    repeated here, so that they are in the record for whoever reads the result later. Each feature
    that takes no part stands under one reason.
    """
    read = request.read
    points = request.features.points
    difference = read.dem_difference
    # Blunders among control and check included: they may be one of the groups.
    excluded = {*observations.independent.ids, *select(
        points.ids, [role == "off" for role in points.roles])}
    # Independent points take no part, though only in a note.
    groups = find_two_groups(request.features.with_(
        points=points.take([name not in excluded for name in points.ids])))
    lines_in_use = set(request.features.lines.ids)
    points_off = select(points.ids, [role == "off" for role in points.roles])
    # Lines have no role: those that are off are not among the features of the request.
    off = [name for name in (*points_off, *read.lines.features) if name not in lines_in_use]
    control = observations.control
    idle = set(observations.off).difference(off)
    reasons = {"without a height": request.blank,
               "marked off": [name for name in off if name not in request.blank],
               "points, as lines are the control": [
               name for name in points.ids if name in idle and not len(control.points)],
               "lines, as points are the control": () if len(control.lines) else
               request.features.lines.features}
    lattice = observations.lattice
    return WhatWasRead(
        points=len(read.points), lines=len(read.lines.features),
        without_height=len(read.without_height()), place=place_of(read),
        doubt=find_swapped_axes(read),
        left_out={reason: tuple(ids) for reason, ids in reasons.items() if ids},
        z_unit=read.z_unit,
        height_doubt=difference.sentence() if difference is not None
        and difference.contradicts else "",
        two_groups="" if groups is None else groups.sentence(), image_origin=read.image_origin,
        lattice=None if lattice is None else (lattice.lines, lattice.columns),
        mixed=note_on_wrong_coordinates(request.features), image=read.image_file,
        set_aside=len({*observations.independent.ids} - {*select(
            points.ids, [role == "independent" for role in points.roles])}))


def package_versions() -> dict[str, str]:
    """Return the versions of Python, termsel and the packages it computes with, by name."""
    return {"python": platform.python_version(), **_computing_packages()}


@cache  # read from files of the installation, a fiftieth of a short run
def _computing_packages() -> dict[str, str]:
    # Each is read from a file: a fiftieth of a run of few points.
    return {name: version(name) for name in ("termsel", "numpy", "scipy", "numba", "deap", "pymoo")}


def plugins_of(request: Request, **replaced: Any) -> dict[str, dict[str, str]]:
    """Return the parts of a run that plugins provide, for the record.

    They are by "problem", "model", "solver", "criterion", "then" and "method": ``name`` as
    ``distribution:name``, as a name alone does not identify them, and ``version`` of the
    distribution. Parts of termsel itself are left out. What no plugin provides has the distribution
    "session" and its ``class``, as "module.Class". `replaced` has the model and the method of the
    strategy "auto".
    """
    components = {"problem": request.recipe, "model": type(request.model),
                  "solver": type(request.solver), "criterion": type(request.criterion), **replaced}
    if request.then is not None:
        components["then"] = type(request.then)
    return {role: origin for role, component in components.items()
            if (origin := _plugin_of(component))}


def _plugin_of(component: Any) -> dict[str, str]:
    """Return name and version of the plugin that provides a component; {} for termsel's own.

    A component of this session has no version, and its class by module and name instead.
    """
    if isinstance(component, type) and is_own(component):  # without a look at all the others
        return {}
    # By its object: two plugins may give the same name.
    entry = registry().origin(component)
    if entry is not None and entry.provided_by != SESSION:
        return {} if entry.provided_by == PROJECT else {
            "name": entry.full_name, "version": registry().version(entry.provided_by)}
    made_by = component if isinstance(component, type) else getattr(
        component, "build", type(component))
    name = getattr(made_by, "__qualname__", type(made_by).__qualname__)
    return {"name": f"{SESSION}:{component.name}", "version": "",
            "class": f"{made_by.__module__}.{name}"}


def notes_on_sessions(plugins: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield a note if a result needs a model that no plugin provides, with how to register it.

    The plugins are as `plugins_of` returns them.
    """
    if "class" in (model := plugins.get("model", {})):
        yield (f"No plugin provides the model: call termsel.register({model['class']}) before "
               "reading this result again.")


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding:
    """What a method found, and by whom the result has it judged.

    Parameters
    ----------
    fit : Fit
        Its control is that of the observations.
    final : Fit, optional
        The same structure fitted to all points.
    predicted_final : Predicted, optional
        The RMSE that is predicted for it.
    observations : Observations
        The features, in the roles they played.
    compared : Observations
        Those that the baselines are compared by: with all lines, where a choice left some out.
    verdict, contradicting : Verdict
        On control and check features before the run, and on independent points after it.
    in_use : frozenset of str
        Ids of features that took part.
    check_used : bool
        Whether the model was fitted to the check points, too.
    agreeing : Observations
        The features without independent points that contradict all others.
    baselines : callable
        The fits that the figures are compared with, by observations.
    judgement : callable
        The sentence on what the selection is worth, by RMSE of roles and baselines.
    selection : Selection
    stated : mapping of str to object
        Fields of the `Record` that need no figures of a role: solver, seed, options, objectives,
        evaluations, notes and so on, by name.
    files : mapping of str to str
        Further files of the result, by name.
    """

    fit: Fit
    observations: Observations
    compared: Observations
    verdict: Verdict
    contradicting: Verdict
    agreeing: Observations
    in_use: frozenset[str]
    check_used: bool
    baselines: Callable[[Observations], tuple[Baseline, ...]]
    judgement: Callable[[Rmses, tuple[Baseline, ...]], str]
    selection: Selection
    stated: Mapping[str, Any]
    final: Fit | None = None
    predicted_final: Predicted | None = None
    files: Mapping[str, str] = field(default_factory=dict)


def result_of(request: Request, finding: Finding) -> Result:
    """Return the result of a method's finding.

    Here independent points are looked at, for the first and only time: their figures, and those
    without the ones that contradict all others.
    """
    fitted = finding.fit
    observations = finding.observations
    agreeing = finding.agreeing
    contradicting = finding.contradicting.outliers
    # Of control and selection points those found before, of independent points afterwards.
    outliers = (*finding.verdict.without(finding.in_use), *contradicting)
    # The one place where figures of independent points are computed.
    rmse = rmse_by_role(fitted, observations)
    baselines = finding.baselines(finding.compared)
    # The sentence on what the selection is worth leaves out points that contradict all others.
    if contradicting:
        judgement = finding.judgement(rmse_by_role(fitted, agreeing), finding.baselines(agreeing))
    else:
        judgement = finding.judgement(rmse, baselines)
    record = Record(
        schema=RESULT_SCHEMA, problem=request.recipe.name, model=fitted.model.name,
        data=data_record_of(request, observations), selection=finding.selection.record(),
        rmse=rmse_record(rmse), baselines=tuple(row.row() for row in baselines),
        judgement=judgement, outliers=outliers, blunder_test=finding.verdict.test,
        accuracy=accuracy_of(fitted, observations.independent),
        accuracy_without=accuracy_of(fitted, agreeing.independent) if contradicting else None,
        final_fit=final_fit(finding.final, finding.predicted_final),
        exports="selection" if finding.final is None else "final", versions=package_versions(),
        **numbers_of(fitted), **finding.stated)
    residuals = residuals_of(fitted, observations, outliers, check_used=finding.check_used)
    return Result.of(record, fit=fitted, final=finding.final, features=observations.features,
                     residuals=residuals, files=finding.files)
