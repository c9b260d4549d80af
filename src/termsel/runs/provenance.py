"""What a result is made of: data and versions, for the record."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from termsel.core.isolation.faults import is_own
from termsel.data.coordinates.crs import height_reference
from termsel.data.coordinates.earth import place_of, swapped
from termsel.data.coordinates.mixed import note_on_mixed
from termsel.data.features import select
from termsel.data.record.record import Counts, DataRecord, IdsByRole, WhatWasRead
from termsel.data.roles import Observations
from termsel.data.two_groups import two_groups
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.registry import SESSION, registry
from termsel.results.checksums import of_features

if TYPE_CHECKING:
    from termsel.runs.request import Request


def data_of(request: Request, observations: Observations) -> DataRecord:
    """Return what a record says of the features of a request, as read and in their roles."""
    features = request.features
    control = observations.control
    counts = Counts(len(control.points), len(observations.check), len(observations.independent),
                    len(control.lines.features), len(observations.off))
    roles = IdsByRole(control.ids, observations.off, observations.check.ids,
                      observations.independent.ids)
    return DataRecord(
        source=request.source, sha256=of_features(features), crs=features.crs,
        fit_crs=control.fit_crs or features.crs,
        heights=features.heights or height_reference(features.crs) or None,
        noise=features.noise, image_size=features.image_size, counts=counts, roles=roles,
        read=_read(request, observations),
        rpc=None if features.rpc is None else features.rpc.numbers())


def _read(request: Request, observations: Observations) -> WhatWasRead:
    """Return what was read, and what of it takes no part for another reason than as a blunder."""
    read = request.read
    points = request.features.points
    difference = read.dem_difference
    # Blunders among control and check included: they may be one of the groups.
    excluded = {*observations.independent.ids, *select(
        points.ids, [role == "off" for role in points.roles])}
    # Independent points take no part, though only in a note.
    groups = two_groups(request.features.with_(
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
        without_height=len(read.without_height()), place=place_of(read), doubt=swapped(read),
        left_out={reason: tuple(ids) for reason, ids in reasons.items() if ids},
        z_unit=read.z_unit,
        height_doubt=difference.sentence() if difference is not None
        and difference.contradicts else "",
        two_groups="" if groups is None else groups.sentence(), image_origin=read.image_origin,
        lattice=None if lattice is None else (lattice.lines, lattice.columns),
        mixed=note_on_mixed(read))


def versions() -> dict[str, str]:
    """Return the versions of termsel and what it computes with."""
    return {"python": platform.python_version(), **_packages()}


@cache
def _packages() -> dict[str, str]:
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
            if (origin := _origin(component))}


def _origin(component: Any) -> dict[str, str]:
    """Return what identifies a thing; nothing for one of termsel itself."""
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
    """Yield what is needed to read a result of a model again that no plugin provides.

    The plugins are as `plugins_of` returns them.
    """
    if "class" in (model := plugins.get("model", {})):
        yield (f"No plugin provides the model: call termsel.register({model['class']}) before "
               "reading this result again.")
