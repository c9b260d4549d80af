"""Notes on the data themselves, whatever method they are used by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from termsel.core.errors import counted, first_of
from termsel.data.coordinates.crs import EARTH, body_of
from termsel.data.coordinates.earth import note_on_turned
from termsel.data.coordinates.longitudes import jumps
from termsel.data.coordinates.metres import height_unit, is_in_degrees, plan_of
from termsel.data.coordinates.mixed import note_on_mixed
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.fit_data import MEASURED, FitData, carriers, off_plane
from termsel.data.roles import Observations
from termsel.data.twins import groups, twins
from termsel.data.two_groups import datum_of, two_groups
from termsel.fitting.fit import Fit
from termsel.formats.heights import pixels_of
from termsel.runs.blank_heights import note_on_blank

SOME = 5
"""Number of points from which on heights may be told from errors."""

MAX_GROUPS_NAMED = 5
"""Groups of points that a note names."""

HIGH = 100.0
"""Height for which it is said what it may do [m]."""

NARROW = 0.02
"""Spread across the main direction of all features, by that along it, up to which they lie on a
line."""


def notes_on_data(read: FeatureSet, observations: Observations, heights: bool,
                  blank: Sequence[str] = (), fitted: FeatureSet | None = None) -> Iterator[str]:
    """Yield what the reader of a result must know of the data, as read and each in its role.

    `heights` is whether heights would be used; `blank` are features that were left out as they have
    no height; a model is fitted to `fitted`, by default control and check together.
    """
    if blank:
        yield note_on_blank(blank, read)
    if turned := note_on_turned(read):
        yield f"{turned[0].upper()}{turned[1:]}"
    if mixed := note_on_mixed(read):
        yield mixed
    if jumps(read):
        yield ("The longitudes jump by a full turn between points. They were made continuous: on "
               "one side they go on beyond 180 degrees.")
    features = observations.together
    independent = observations.independent
    # In the order in which a reader would act: datum, repeated points, geometry, heights.
    yield from _on_two_groups(features)
    yield from _on_twins(features.points, independent)
    yield from _on_one_line(features)
    if heights and len(features) > 1 and not features.without_height():
        yield from _on_carriers(features, observations.carriers)
        yield from (_on_flat(observations.joint, independent) if fitted is None else _on_flat(
            FitData.of(fitted, False), observations.check.join_unchecked(independent)))


def notes_on_dem(features: FeatureSet, fitted: Fit) -> Iterator[str]:
    """Yield that a DEM contradicts the heights of control, with what a fit makes of that."""
    difference = features.dem_difference
    if difference is not None and difference.contradicts:
        yield difference.sentence(pixels_of(difference, fitted.control, fitted.project))


def _on_two_groups(features: FeatureSet) -> Iterator[str]:
    """Yield that points lie as if in two datums, with the other one's name if PROJ knows it."""
    groups = two_groups(features)
    if groups is None:
        return
    datum = ""
    if is_in_degrees(features.crs) and body_of(features.crs) == EARTH:
        # The shift between two datums depends on the place.
        lon, lat = features.points.ground[:, :2].mean(axis=0).tolist()
        datum = datum_of(groups, features.crs, (lon, lat))
    likely = f" Coordinates in {datum} are as far off there." if datum else ""
    yield (f"{groups.sentence()}: {first_of(groups.second)}.{likely} Transform them to the CRS of "
           "the others.")


def _on_one_line(features: FeatureSet) -> Iterator[str]:
    """Yield where the features lie on one straight line, in the image or on the ground."""
    views = " and ".join(name for name, positions in (
        ("in the image", features.image_vertices()), ("on the ground", _in_plan(features)))
        if _is_narrow(positions))
    if views:
        yield (f"All {features.word} lie close to one straight line {views}. Nothing tells what "
               "the model does away from it: measure points there.")


def _in_plan(features: FeatureSet) -> FloatArray:
    """Return where features are on the ground, with one unit along all axes."""
    ground = features.ground_vertices()
    plan = plan_of(features.crs, ground)
    return ground[~np.isnan(ground[:, 2])] if plan is None else plan


def _is_narrow(positions: FloatArray) -> bool:
    """Return whether three or more places lie on a line, and not all at one place."""
    # Two points are always on a line, which says nothing.
    if len(positions) <= 2:
        return False
    # Singular values of centred places: the extents along and across the line.
    length, width, *_ = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return bool(length > 0.0 and width <= NARROW * length)


def _on_carriers(features: FeatureSet, carrying: tuple[str, ...]) -> Iterator[str]:
    """Yield which features heights rest on, where they are one or two."""
    if len(carrying) == 1 and len(features) < SOME:
        yield (f"With {len(features)} {features.word} nothing tells what a height does from an "
               "error, so the model is plane.")
    elif carrying:
        yield (f"All heights but that of {' and that of '.join(carrying)} lie on a plane. What a "
               "height does cannot be told from an error there, so the model is plane.")


def _on_flat(control: FitData, points: Points) -> Iterator[str]:
    """Yield that heights tell nothing, and what they may do at other points."""
    vertices = control.features.ground_vertices()
    carrying = carriers(control)
    # Heights without those of the one or two features that make all the relief.
    z = vertices[~np.isin(np.array(control.features.ids)[control.features.vertex_feature],
                          carrying if len(carrying) < len(control) else ()), 2]
    if len(carrying) < len(control):
        pass
    elif (z == z[0]).all():
        yield (f"All heights are {z[0]:g}, so they were not used. If they are not known, leave "
               "them blank or take them from a raster (--dem FILE).")
    else:
        yield (f"The heights of the {control.features.word} differ too little from a plane to "
               "tell what a height does, so they were not used.")
    unit = height_unit(control.features.crs)
    above, does = off_plane(control, vertices[:1] + np.array([0.0, 0.0, HIGH / unit]))
    # How far an error of height moves the image, by the obliqueness of usual views.
    if does[0] > 0.0:
        low, high = (f"{round(float(height) * unit, 1) + 0.0:g}" for height in (z.min(), z.max()))
        covered = f"the height {low} m alone" if low == high else \
            f"heights from {low} to {high} m on one plane"
        error = _rounded(HIGH / unit * does[0] / above[0])
        yield (f"The control covers {covered}. Expect about {error} px error per "
               f"{HIGH:g} m outside it.")
    # Other points off the plane of the control are seen elsewhere than a plane model says.
    off, effect = off_plane(control, points.ground)
    far = effect > MEASURED
    if far.any():
        yield (f"{counted(int(far.sum()), 'other point')} {'is' if far.sum() == 1 else 'are'} up "
               f"to {_rounded(off.max() * unit)} m above or below their plane. What this does in "
               f"the image is not known: some {_rounded(effect.max())} px, as views usually are.")


def _rounded(size: float) -> str:
    return f"{size:.2g}" if size < 99.5 else f"{float(f'{size:.2g}'):,.0f}"


def _on_twins(points: Points, independent: Points) -> Iterator[str]:
    """Yield what is to be said of points that repeat each other."""
    # Too close to tell anything apart: they are held out together.
    close_points = groups(points.ids, twins(points.ground))
    if close_points:
        yield (f"Points too close to each other to tell anything apart share a role and a fold: "
               f"{_listed(close_points)}.")
    all_points = points.join_unchecked(independent)
    independent_ids = set(independent.ids)
    # Twins of independent points among control make these test what was fitted to them.
    shared = [group for group in groups(all_points.ids, twins(all_points.ground, points.ground))
              if 0 < len(independent_ids.intersection(group)) < len(group)]
    if shared:
        yield ("Independent check points at the places of control or selection points do not test "
               f"the model: {_listed(shared)}.")


def _listed(id_groups: list[tuple[str, ...]]) -> str:
    texts = ", ".join(" and ".join(group) for group in id_groups[:MAX_GROUPS_NAMED])
    if len(id_groups) <= MAX_GROUPS_NAMED:
        return texts
    return f"{texts} and {len(id_groups) - MAX_GROUPS_NAMED} more groups"
