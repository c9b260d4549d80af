"""Notes on the data themselves, whatever method they are used by."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from termsel.core.errors import count_in_words, first_names_in_words, rounded_size_text
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import (
    EARTH,
    LOCAL,
    body_of,
    geodetic_of,
    normalise,
    to_wgs84,
)
from termsel.data.coordinates.earth import note_on_turned
from termsel.data.coordinates.longitudes import has_longitude_jump
from termsel.data.coordinates.metres import (
    has_compass_axes,
    height_unit,
    is_in_degrees,
    offsets_in_metres,
    plan_of,
)
from termsel.data.coordinates.places import distance_beyond_hull, feature_centres
from termsel.data.coordinates.plausible import note_on_wrong_coordinates
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import (
    MEASURED,
    FitData,
    distance_off_plane,
    errors_hide_heights,
    relief_carriers,
)
from termsel.data.record.cautions import EXTRAPOLATION, ON_ONE_LINE, ROUNDED, TWO_DATUMS
from termsel.data.roles import Observations, find_twins, twin_groups
from termsel.data.rpc import CHECK_HEIGHTS, Rpc
from termsel.fitting.extrapolation import corners_of
from termsel.fitting.fit import Fit
from termsel.formats.heights import note_on_ellipsoid, pixels_of
from termsel.runs.between_points import checked_next_to_control
from termsel.runs.request import note_on_blank

# Points of two surveys in different datums: two groups that a constant shift on the ground parts.
#
# An affine transformation of plan coordinates u (n, 2) in metres, and of heights where all are
# known, predicts the image; g is 1 for points of the second group, else 0:
#
#     image = A [1, u - g d, z] + noise,
#
# which is linear in A and A d. Points are assigned in turn with that, beginning along the direction
# in which the residuals without d scatter most. A split of normal errors in two takes them down to
# 0.6; so it takes a far smaller rest, in both groups, before anything is said.

LEAST, LEAST_OF_GROUP = 12, 4
"""Points that can show it, and those of the smaller group."""
_REST = 0.25
"""Largest part of the RMSE that is left with two groups."""
_APART = 6.0
"""Least distance of the groups [standard deviations within them]."""
_GROUPING_ROUNDS = 50
_UNCERTAIN = 3.0  # standard deviation by the RMSE from which on a corner is told
_NEXT_TO_HULL = 0.05
"""Distance from the hull of the control, by its longer side, that is no extrapolation yet."""
_LARGEST_CONDITION = 1e6
"""Condition of the matrix from the ground to the image up to which it has an inverse."""
_FARTHEST = 2000.0
"""Longest shift [m]: datums of the Earth are less apart. Longer ones are of what an affine
transformation does not follow, such as an area of many degrees or an oblique view."""


_MODERN = re.compile(r"\(|ITRF|IGS|IGb|WGS 84|GTRF")
"""Names of realisations that are centimetres apart."""
_LIKE, _ABOUT = 0.25, 15.0
"""Part of a shift, and metres, by which that of a datum may differ: its grid may not be there."""
_HALF_SIDE = 0.01
"""Half the side of the area in which a datum must be in use [deg]: about a kilometre, as PROJ is
asked about areas and not about places."""


@dataclass(frozen=True)
class TwoGroups:
    """Two groups of points that are a constant shift on the ground apart.

    Parameters
    ----------
    first, second : tuple of str
        Ids; the first is the larger group.
    shift : tuple of float
        From the first to the second group, along x and y [m], to the east and north of degrees.
    heights : bool
        Whether heights are known: unknown ones may part points of two levels.
    is_compass : bool
        Whether x points to the east and y to the north.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    shift: tuple[float, float]
    heights: bool
    is_compass: bool

    def sentence(self) -> str:
        """Return in a sentence how many points lie off the others, how far and in which direction.
        """
        if self.is_compass:
            axes = (("east", "west"), ("north", "south"))
        else:
            axes = (("along +x", "along -x"), ("along +y", "along -y"))
        # Less than a metre along an axis is not worth a word.
        directions = [f"{abs(size):.0f} m {ahead if size > 0 else back}"
                      for size, (ahead, back) in zip(self.shift, axes, strict=True)
                      if abs(size) >= 1]
        of = "of" if self.is_compass else "from"
        levels = "" if self.heights else ", or on two levels whose heights are not known"
        return (f"{len(self.second)} of {len(self.first) + len(self.second)} points lie "
                f"{' and '.join(directions)} {of} the positions that the others predict"
                f"{TWO_DATUMS}{levels}")


def datum_of(groups: TwoGroups, crs: str, position: tuple[float, float]) -> str:
    """Return the name of the datum whose coordinates are off those of a CRS as two groups are.

    `position` is the longitude and latitude [deg] at which the datums are compared. Returns ""
    where no datum that PROJ knows to be in use there is as far off, and without pyproj.
    """
    try:
        from pyproj import Transformer
    except ImportError:
        return ""
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType
    from pyproj.exceptions import ProjError

    lon, lat = position
    area = AreaOfInterest(lon - _HALF_SIDE, lat - _HALF_SIDE, lon + _HALF_SIDE, lat + _HALF_SIDE)
    offset = np.array(groups.shift)
    # Name of the best datum so far and its distance from the shift [m]; only nearer ones count.
    nearest = ("", max(_LIKE * float(np.linalg.norm(offset)), _ABOUT))
    for datum in query_crs_info("EPSG", PJType.GEOGRAPHIC_2D_CRS, area, contains=True):
        if _MODERN.search(datum.name):
            continue
        try:
            # The move of one place between the datums, to be compared with the shift of the groups.
            transformer = Transformer.from_crs(geodetic_of(crs), f"EPSG:{datum.code}",
                                               always_xy=True, area_of_interest=area)
        except ProjError:
            continue
        datum_lon, datum_lat, *_ = transformer.transform(lon, lat, 0.0)
        datum_shift = offsets_in_metres(
            "EPSG:4326", np.array([[lon, lat]]), np.array([[datum_lon - lon, datum_lat - lat]]))
        if datum_shift is not None and np.isfinite(datum_shift).all():
            distance = float(np.linalg.norm(datum_shift[0] - offset))
            nearest = min(nearest, (datum.name, distance), key=lambda candidate: candidate[1])
    return nearest[0]


def find_two_groups(features: FeatureSet) -> TwoGroups | None:
    """Return the groups of points that lie as if in two datums; None where they do not.

    The affine image of all points, with a constant of its own for a second group, is fitted by
    turns with the division into both groups, as k-means does. The groups count where they leave far
    smaller residuals than one group, and lie far apart against their scatter. The constant, taken
    back through the affine image, is the shift on the ground.
    """
    points = features.points
    plan = plan_of(features.crs, points.ground) if len(points) >= LEAST else None
    if plan is None or not np.isfinite(plan).all():
        return None
    # [1, u, z] of the equation above; z only where all heights are known.
    design = np.column_stack([np.ones(len(plan)), plan])
    if np.isfinite(points.ground[:, 2]).all():
        design = np.column_stack([design, points.ground[:, 2] - points.ground[:, 2].mean()])
    _, joint_residuals = _fit_residuals(design, points.image)
    in_second = _are_beyond_largest_gap(joint_residuals)
    # Like k-means with two centres: fit with this split, then each point to the nearer group.
    for _ in range(_GROUPING_ROUNDS):
        if not LEAST_OF_GROUP <= in_second.sum() <= len(plan) - LEAST_OF_GROUP:
            return None
        coefficients, residuals = _fit_residuals(np.column_stack([design, in_second]), points.image)
        move = coefficients[-1]  # of the second group in the image [px]: the last column's
        from_first = residuals + np.outer(in_second, move)  # as if all were of the first group
        are_nearer_second = (np.linalg.norm(from_first - move, axis=1)
                             < np.linalg.norm(from_first, axis=1))
        if (are_nearer_second == in_second).all():
            break
        in_second = are_nearer_second
    # Two groups must leave far less than one, and lie far apart within their scatter.
    redundancy = 2 * (len(plan) - len(coefficients))
    sigma = float(np.sqrt((residuals**2).sum() / redundancy))
    if (np.sqrt((residuals**2).sum()) > _REST * np.sqrt((joint_residuals**2).sum())
            or np.linalg.norm(move) < _APART * sigma):
        return None
    # Points on one line do not show in which direction the others are.
    if np.linalg.cond(coefficients[1:3]) > _LARGEST_CONDITION:
        return None
    # Ground coordinates that are d too far to the east have the image of what is d to the west.
    shift = -np.linalg.solve(coefficients[1:3].T, move)
    if np.linalg.norm(shift) > _FARTHEST:
        return None
    # The first group is the larger one.
    if in_second.sum() > len(plan) / 2:
        in_second = ~in_second
        shift = -shift
    names = np.array(points.ids, dtype=object)
    return TwoGroups(tuple(names[~in_second]), tuple(names[in_second]),
                     (float(shift[0]), float(shift[1])), heights=design.shape[1] > 3,
                     is_compass=has_compass_axes(features.crs, points.ground))


def _fit_residuals(design: FloatArray, image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients (k, 2) and the residuals (n, 2) of a least-squares fit."""
    coefficients = np.asarray(np.linalg.lstsq(design, image, rcond=None)[0], dtype=np.float64)
    return coefficients, image - design @ coefficients


def _are_beyond_largest_gap(residuals: FloatArray) -> BoolArray:
    """Return which residuals (n, 2) are beyond the largest gap of their main direction, (n,).

    Only gaps with LEAST_OF_GROUP residuals or more on either side count.
    """
    # The first right singular vector is the direction in which residuals scatter most.
    main_direction = np.linalg.svd(residuals, full_matrices=False)[2][0]
    projected = residuals @ main_direction
    ascending = np.sort(projected)
    gaps = np.diff(ascending)[LEAST_OF_GROUP - 1:len(ascending) - LEAST_OF_GROUP]
    below_gap = LEAST_OF_GROUP - 1 + int(np.argmax(gaps))
    return np.asarray(projected > (ascending[below_gap] + ascending[below_gap + 1]) / 2)


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
                  blank: Sequence[str] = (), fitted: FeatureSet | None = None,
                  clean: Observations | None = None) -> Iterator[str]:
    """Yield notes on the data, as read and each in its role, for the reader of a result.

    `heights` is whether heights would be used; `blank` are features that were left out as they have
    no height; a model is fitted to `fitted`, by default control and check together; `clean` are
    the observations without outliers.
    """
    if blank:
        yield note_on_blank(blank, read)
    if coordinate_doubt := note_on_wrong_coordinates(read):
        yield coordinate_doubt
    elif turned_note := note_on_turned(read):
        yield f"{turned_note[0].upper()}{turned_note[1:]}"
    if has_longitude_jump(read):
        yield ("The longitudes jump by a full turn between points. They were made continuous: on "
               "one side they go on beyond 180 degrees.")
    features = observations.together
    independent = observations.independent
    # In the order in which a reader would act: datum, repeated points, geometry, heights.
    yield from _note_on_two_groups(features)
    yield from _note_on_twins(features.points, independent)
    # One blunder far away draws all others together.
    without_blunders = clean or observations
    yield from checked_next_to_control(without_blunders.together, without_blunders.independent)
    yield from _note_on_one_line(without_blunders.together)
    if features.rpc is not None:
        yield from _note_on_rpc_heights(features, features.rpc)
    missing = features.without_height()
    if heights and not blank and 0 < len(missing) < len(features):
        yield (f"{len(missing)} of {len(features)} {features.word} have no height, so the heights "
               f"of the others were not used: {first_names_in_words(missing)}. Take those that "
               f"are missing from a raster ({Remedy('dem', 'FILE')}).")
    if heights and len(features) > 1 and not missing:
        # Heights may rest on one or two features.
        carrying = observations.carriers
        if len(carrying) == 1 and len(features) < SOME:
            yield (f"With {len(features)} {features.word} nothing distinguishes what a height does "
                   "from an error, so the model is plane.")
        elif carrying:
            yield (f"All heights but that of {' and that of '.join(carrying)} lie on a plane. What "
                   "a height does cannot be distinguished from an error there, so the model is "
                   "plane.")
        if fitted is None:
            yield from _note_on_flat(observations.joint, independent)
        else:
            # A model that is fitted to control alone is used at check points, too.
            not_fitted = observations.check.join_unchecked(independent)
            yield from _note_on_flat(FitData.of(fitted, heights=False), not_fitted)


def uncertain_corners(fitted: Fit, rmse: float) -> Iterator[str]:
    """Yield a sentence if the model is far more uncertain at a corner of the image than its RMSE.

    The RMSE [px] is that of places like the control's. Corners next to the control's hull do not
    count, and no corner does where the size of the image is not known.
    """
    if fitted.control.image_size is None:
        return
    corners = corners_of(fitted.control.image_size)
    # A model is as certain next to the hull of its control as at the hull.
    corners = corners[
        distance_beyond_hull(feature_centres(fitted.control), corners) > _NEXT_TO_HULL]
    if not len(corners):
        return
    # At the middle height, as the height of the ground there is not known.
    ground = fitted.locate(corners, float(fitted.ground_box()[0][2]))
    ground = ground[np.isfinite(ground).all(axis=1)]
    if not len(ground):
        return
    with np.errstate(all="ignore"):
        sigma = np.hypot(*fitted.sigma(ground).T)
    largest = float(np.max(sigma, initial=0.0, where=np.isfinite(sigma)))
    if largest > _UNCERTAIN * rmse:
        yield (f"{EXTRAPOLATION}the standard deviation of the model is up to "
               f"{rounded_size_text(largest)} px "
               f"at the corners of the image, {largest / rmse:.0f} times the RMSE, which holds "
               "within the control. Measure points near the corners, or see termsel sigma.")


def notes_on_dem(features: FeatureSet, fitted: Fit) -> Iterator[str]:
    """Yield a note if a DEM contradicts the heights of control, with its effect on the fit [px]."""
    difference = features.dem_difference
    if difference is not None and difference.contradicts:
        yield difference.sentence(pixels_of(difference, fitted.control, fitted.project))


def _note_on_two_groups(features: FeatureSet) -> Iterator[str]:
    """Yield a note if points lie as if in two datums, with the other one's name if PROJ has it."""
    groups = find_two_groups(features)
    if groups is None:
        return
    datum = ""
    if is_in_degrees(features.crs) and body_of(features.crs) == EARTH:
        # The shift between two datums depends on the place.
        lon, lat = features.points.ground[:, :2].mean(axis=0).tolist()
        datum = datum_of(groups, features.crs, (lon, lat))
    likely = f" Coordinates in {datum} are as far off there." if datum else ""
    yield (f"{groups.sentence()}: {first_names_in_words(groups.second)}.{likely} Transform them "
           "to the CRS of the others.")


def _note_on_rpc_heights(features: FeatureSet, rpc: Rpc) -> Iterator[str]:
    """Yield notes on heights that do not suit the RPC of the features; none without a CRS.

    They are heights of a raster that count from another ellipsoid (see `note_on_ellipsoid`), and
    heights far outside the range of the RPC.
    """
    if normalise(features.crs) == LOCAL:
        return
    ground = features.ground_vertices()
    outside = rpc.heights_outside(
        to_wgs84(features.crs)(ground[np.isfinite(ground).all(axis=1)])[:, 2])
    if note := note_on_ellipsoid(features, lambda ground: rpc.project(
            to_wgs84(features.crs)(ground))):
        yield f"{note[0].upper()}{note[1:]}"
    if outside:
        if features.heights:
            remedy = "is the raster of heights the right one?"
        else:
            remedy = f"{CHECK_HEIGHTS}."
        yield f"{outside[0].upper()}{outside[1:]}: {remedy}"


def _note_on_one_line(features: FeatureSet) -> Iterator[str]:
    """Yield where the features lie on one straight line, in the image or on the ground."""
    ground = features.ground_vertices()
    plan = plan_of(features.crs, ground)
    if plan is None:  # geocentric: X, Y and Z
        plan = ground[~np.isnan(ground[:, 2])]
    views = " and ".join(name for name, positions in (
        ("in the image", features.image_vertices()), ("on the ground", plan))
        if _is_narrow(positions))
    if views:
        yield (f"All {features.word}{ON_ONE_LINE}{views}. Nothing shows what "
               "the model does away from it: measure points there.")


def _is_narrow(positions: FloatArray) -> bool:
    """Return whether three or more places (n, 2) lie on a line, and not all at one place."""
    # Two points are always on a line, which says nothing.
    if len(positions) <= 2:
        return False
    # Singular values of centred places: the extents along and across the line.
    length, width, *_ = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return bool(length > 0.0 and width <= NARROW * length)


def _note_on_flat(control: FitData, points: Points) -> Iterator[str]:
    """Yield notes where the control hardly shows what a height does in the image.

    That is where it lies on a plane, is too few, or has errors as large as the effect. Other points
    off that plane are then seen elsewhere than the model says, by as much as usual views lean: the
    notes give both figures. `points` are those to which the model is not fitted.
    """
    vertices = control.features.ground_vertices()
    carrying = relief_carriers(control)
    # Where all features carry the relief, none of them alone decides that heights are not used.
    none_carries = len(carrying) == len(control)
    # Heights without those of the one or two features that make all the relief.
    vertex_ids = np.array(control.features.ids)[control.features.vertex_feature]
    z = vertices[~np.isin(vertex_ids, () if none_carries else carrying), 2]
    hidden = none_carries and errors_hide_heights(control)
    # Of one or two features that make all the relief there is a note already.
    if none_carries:
        yield _why_heights_unused(control, z, hidden)
    unit = height_unit(control.features.crs)
    above, does = distance_off_plane(control, vertices[:1] + np.array([0.0, 0.0, HIGH / unit]))
    # How far an error of height moves the image, by the obliqueness of usual views.
    if does[0] > 0.0:
        low, high = (f"{round(float(height) * unit, 1) + 0.0:g}" for height in (z.min(), z.max()))
        if low == high:
            covered, beyond = f"the height {low} m alone", "above or below it"
        elif hidden:
            covered, beyond = f"heights from {low} to {high} m", "outside it"
        else:
            covered, beyond = f"heights from {low} to {high} m on one plane", "off that plane"
        error = _rounded_text(HIGH / unit * does[0] / above[0])
        yield (f"The control covers {covered}. Expect about {error} px error per "
               f"{HIGH:g} m {beyond}.")
    if hidden:
        return
    # Other points off the plane of the control are seen elsewhere than a plane model says.
    off, effect = distance_off_plane(control, points.ground)
    far = effect > MEASURED
    if far.any():
        yield (f"{count_in_words(int(far.sum()), 'other point')} "
               f"{'is' if far.sum() == 1 else 'are'} up "
               f"to {_rounded_text(off.max() * unit)} m above or below their plane. What this "
               f"does in the image is not known: some {_rounded_text(effect.max())} px, as views "
               "usually are.")


FEWEST_OF_ROUNDING = 6
"""Points from which on it is no chance that all their coordinates are round."""

COARSEST, FINEST = 5, -7
"""Powers of ten between which steps of coordinates are looked for: 100 km, and far below a metre in
degrees."""

FAR_FINER = 0.11
"""Share of the coarser step, below which the other coordinate is not the one to correct."""

NOTICEABLE_ROUNDING = 1.0
"""Error [px] by rounding from which on it matters."""

AS_LARGE_AS_ROUNDING = 0.25, 3.0
"""Errors at held-out points, by the error of rounding, between which this may be why: lines of a
graticule are round, too, and have far smaller errors."""


def note_on_rounding(features: FeatureSet, errors: FloatArray) -> str:
    """Return a note that x and y have too few decimals, which would explain the errors; or "".

    `errors` (n, 2) are those of held-out points [px]. A coordinate rounded to a step is off by up
    to half of it: its standard deviation is step / sqrt(12).
    """
    points = features.points
    if len(features.lines) or len(points) < FEWEST_OF_ROUNDING:
        return ""
    plan = points.ground[:, :2]
    steps = np.array([_step_of(values) for values in plan.T])
    # How many px a unit of x and of y is: the linear part of an affine fit of the image.
    columns = np.column_stack([np.ones(len(plan)), plan - plan.mean(axis=0)])
    to_image = np.linalg.lstsq(columns, points.image, rcond=None)[0][1:]
    rounding = float(np.linalg.norm(steps[:, None] * to_image)) / np.sqrt(12.0)
    rmse = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    least, most = AS_LARGE_AS_ROUNDING
    if rounding < NOTICEABLE_ROUNDING or not least <= rmse / rounding <= most:
        return ""
    unit = " degrees" if is_in_degrees(features.crs) else ""
    coarse = steps >= FAR_FINER * steps.max()
    names = "x and y are multiples" if coarse.all() else f"{'xy'[coarse.argmax()]} is a multiple"
    them = "them" if coarse.all() else "it"
    return (f"{names} of {steps.max():g}{unit}{ROUNDED}that alone is an error of some "
            f"{rounded_size_text(rounding)} px. Take {them} from the source with more decimals.")


def _step_of(values: FloatArray) -> float:
    """Return the largest power of ten of which all values (n,) are multiples; 0 if none is.

    It is 0, too, for lines of a lattice, which are further multiples apart: by chance rounded
    values would not be.
    """
    tolerance = 1e-9 * float(np.abs(values).max(initial=1.0))
    for power in range(COARSEST, FINEST, -1):
        step = 10.0**power
        counts = np.round(values / step)
        if (np.abs(values - step * counts) <= tolerance).all():
            apart = np.gcd.reduce((counts - counts[0]).astype(np.int64))
            return 0.0 if apart > 1 else step
    return 0.0


def _why_heights_unused(control: FitData, z: FloatArray, hidden: bool) -> str:
    """Return the sentence on why the heights z (n,) of control were not used.

    `hidden` says whether the errors of the control are as large as the effect of its heights.
    """
    features = control.features
    if len(control) < FEWEST_FOR_HEIGHTS:
        return (f"The heights were not used: {len(control)} {features.word} cannot show "
                "what a height does.")
    if (z == z[0]).all():
        if features.heights:
            remedy = "Is the raster of heights the right one?"
        else:
            remedy = ("If they are not known, leave them blank or take them from a raster "
                      f"({Remedy('dem', 'FILE')}).")
        return f"All heights are {z[0]:g}, so they were not used. {remedy}"
    if hidden:
        return (f"The errors of the {features.word} are too large to show what a height "
                "does, so the heights were not used.")
    return _question_on_unit(features, z) or (
        f"The heights of the {features.word} differ too little from a plane to "
        "show what a height does, so they were not used.")


def _question_on_unit(features: FeatureSet, z: FloatArray) -> str:
    """Return a note that asks whether the heights z (n,) are kilometres, or "".

    It is asked where the heights hardly differ over an area that is wide.
    """
    plan = plan_of(features.crs, features.ground_vertices())
    spread = float(np.ptp(z)) * height_unit(features.crs)
    # Whole metres are no kilometres.
    if plan is None or spread >= LEAST_SPREAD or (z == np.round(z)).all():
        return ""
    extent = float(np.ptp(plan, axis=0).max()) / 1000
    if extent < LEAST_EXTENT:
        return ""
    return (f"The heights span only {spread:.2g} m over {extent:.2g} km, so they were not used; "
            "are they in kilometres? Then convert them to metres.")


FEWEST_FOR_HEIGHTS = 4
"""Features below which heights are always on one plane, which then says nothing."""

LEAST_SPREAD, LEAST_EXTENT = 3.0, 1.0
"""Spread of heights [m] below which, over so many kilometres, they may be kilometres."""


def _rounded_text(size: float) -> str:
    """Return a size to two digits, with commas from 100 on."""
    return f"{size:.2g}" if size < 99.5 else f"{float(f'{size:.2g}'):,.0f}"


def _note_on_twins(points: Points, independent: Points) -> Iterator[str]:
    """Yield notes on points too close to each other; nothing without any."""
    # Too close for anything to differ between them: they are held out together.
    close_points = twin_groups(points.ids, find_twins(points.ground))
    if close_points:
        yield (f"Points too close to each other to be independent share a role and a fold: "
               f"{_list_in_words(close_points)}.")
    all_points = points.join_unchecked(independent)
    independent_ids = set(independent.ids)
    # Twins of independent points among control make these test what was fitted to them.
    shared = [group
              for group in twin_groups(all_points.ids, find_twins(all_points.ground, points.ground))
              if 0 < len(independent_ids.intersection(group)) < len(group)]
    if shared:
        yield ("Independent check points at the places of control or selection points do not test "
               f"the model: {_list_in_words(shared)}.")


def _list_in_words(id_groups: list[tuple[str, ...]]) -> str:
    """Return groups of ids in words, up to MAX_GROUPS_NAMED of them."""
    texts = ", ".join(" and ".join(group) for group in id_groups[:MAX_GROUPS_NAMED])
    if len(id_groups) <= MAX_GROUPS_NAMED:
        return texts
    return f"{texts} and {len(id_groups) - MAX_GROUPS_NAMED} more groups"
