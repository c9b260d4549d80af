"""Roles of points: control fits the model, check judges a choice, independent the result."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property, lru_cache

import numpy as np

from termsel.core.errors import TermselError, first_names_in_words, unknown_name_error
from termsel.core.isolation.faults import attribute_errors_to, fault_of_method
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import LOCAL
from termsel.data.coordinates.longitudes import to_globe, without_jump
from termsel.data.coordinates.places import Lattice, lattice_of, spatial_order
from termsel.data.features import (
    ROLES,
    FeatureSet,
    FloatArray,
    IntArray,
    Lines,
    Points,
    empty_lines,
    empty_points,
)
from termsel.data.fit_data import FitData, relief_carriers
from termsel.data.record.chances import quantile_of
from termsel.data.tables.columns import fold_name
from termsel.data.tables.tabular import replace_unchecked, rows_at

RANGE = re.compile(r"\.\.|[*:]")
"""What people write for a range of ids, or for a pattern of them."""

# Points that lie closer to each other than anything can differ between them: twins.
#
# Twins repeat one measurement. If one is control and the other independent, the second confirms
# whatever was fitted to the first; if one is held out, the other predicts it.

TWIN_DISTANCE = 0.01
"""Distance of twins, by the side of the square that each point has for itself; of their heights,
by the spread of all heights."""

MAX_PAIRWISE_PLACES = 300
"""Most places that are compared each with each: a tree takes longer to import than to search."""

MAX_COMPARED_PAIRS = 1_000_000
"""Most pairs of more places, neighbours along X, that are compared without a tree."""


def find_twins(ground: FloatArray, typical: FloatArray | None = None) -> IntArray:
    """Return the number of each point's group of twins, (n,), by places on the ground (n, 3).

    Twins are points so near to each other, compared with the spread of the points `typical` (m, 3),
    by default all, that they repeat one measurement. Groups are counted from 0 in the order of
    their first points; a point without a twin is a group of its own. Unknown heights, NaN, count
    as 0.
    """
    n = len(ground)
    typical = ground if typical is None else typical
    if n < 2 or len(typical) < 2:
        return np.arange(n, dtype=np.intp)
    positions = np.nan_to_num(ground)
    typical = np.nan_to_num(typical)
    # Quartiles are used, as half of the points span half of an even spread, whatever wild ones do.
    low, high = (quantile_of(typical.T, share) for share in (0.25, 0.75))
    # Twins are up to 1 apart in these units. In X and Y they shrink as the distance of neighbours
    # does with the number of points.
    unit = TWIN_DISTANCE * 2 * (high - low) * np.array([len(typical) ** -0.5] * 2 + [1.0])
    rounding = np.finfo(float).eps * np.abs(positions).max(axis=0)
    pairs = _pairs_nearby(positions / np.maximum(unit, np.maximum(rounding, np.finfo(float).tiny)))
    if not len(pairs):
        return np.arange(n, dtype=np.intp)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Twins of twins are twins: the groups are the connected parts of the graph of near pairs.
    edges = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.intp)


def _pairs_nearby(positions: FloatArray) -> IntArray:
    """Return the pairs of positions (n, 3) that are at most 1 apart, shape (p, 2)."""
    if len(positions) <= MAX_PAIRWISE_PLACES:
        # Squared distances of all pairs, each pair once above the diagonal.
        square = sum((axis[:, None] - axis) ** 2 for axis in positions.T)
        return np.argwhere(np.triu(square <= 1.0, 1))
    pairs = _pairs_along_line(positions)
    if pairs is not None:
        return pairs
    from scipy.spatial import KDTree  # only here, as it takes 0.3 s to import

    return np.asarray(KDTree(positions).query_pairs(1.0, output_type="ndarray"))


def _pairs_along_line(positions: FloatArray) -> IntArray | None:
    """Return the pairs of positions (n, 3) that are at most 1 apart, (p, 2), by an order along X.

    Returns None where too many are within 1 of each other along X, as those of one column may be.
    """
    order = np.argsort(positions[:, 0], kind="stable")
    ordered = positions[order]
    # The neighbours of a position are the next ones in this order, up to 1 away.
    n = len(positions)
    following = (np.searchsorted(ordered[:, 0], ordered[:, 0] + 1.0, side="right")
                 - np.arange(1, n + 1))
    if following.sum() > MAX_COMPARED_PAIRS:
        return None
    first = np.repeat(np.arange(n), following)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(following) - following,
                                                           following)
    is_near = ((ordered[second] - ordered[first]) ** 2).sum(axis=1) <= 1.0
    return np.asarray(np.sort(order[np.column_stack([first, second])[is_near]], axis=1))


def with_merged_twins(features: FeatureSet) -> FeatureSet:
    """Return features in which twins are one point, at their mean; lines stay as they are.

    Each point has the id, the role and the attributes of the first of its twins. Its sigma is the
    mean of theirs, not less, as twins repeat one measurement. Without twins the same object comes
    back.
    """
    points = features.points
    # Points of one label are twins; labels are numbered from 0 in the order of their first points.
    labels = find_twins(points.ground)
    first_of_group = np.unique(labels, return_index=True)[1]
    if len(first_of_group) == len(points):
        return features
    count = np.bincount(labels)[:, None]

    def mean_of_group(values: FloatArray) -> FloatArray:
        total = np.zeros((len(first_of_group), values.shape[1]))
        np.add.at(total, labels, values)
        return total / count

    return features.with_(points=Points(
        tuple(points.ids[i] for i in first_of_group), mean_of_group(points.image),
        mean_of_group(points.ground),
        None if points.sigma is None else mean_of_group(points.sigma),
        tuple(points.roles[i] for i in first_of_group), rows_at(points.attributes, first_of_group)))


def with_twins(points: Points, ids: Iterable[str]) -> frozenset[str]:
    """Return ids of points together with those of their twins."""
    labels = find_twins(points.ground)
    named = frozenset(ids)
    twin_labels = {label for name, label in zip(points.ids, labels, strict=True) if name in named}
    return frozenset(name for name, label in zip(points.ids, labels, strict=True)
                     if label in twin_labels)


def twin_groups(ids: Sequence[str], labels: IntArray) -> list[tuple[str, ...]]:
    """Return the ids of each group of two and more."""
    by_label: dict[int, list[str]] = {}
    for name, label in zip(ids, labels.tolist(), strict=True):
        by_label.setdefault(label, []).append(name)
    return [tuple(names) for names in by_label.values() if len(names) > 1]


# Splits: how points that are assigned a role get it.

ASSIGNABLE = ("control", "check", "independent")
"""Roles in the order of their shares."""


@dataclass(frozen=True)
class Split:
    """A named way to assign the roles control, check and independent.

    Parameters
    ----------
    name, summary : str
        The name is the value of ``--set roles=NAME``.
    assign : callable
        Takes the ids of n points, their ground coordinates (n, 3) in the CRS of the points, the
        shares of the three roles (3,), which sum to 1, and a numpy.random.Generator; returns n
        roles. It sees no image, so that no role depends on how well a point fits. With lines as
        control the share of control is 0. Points at one place are one.
    on_globe : bool
        Whether the ground coordinates are longitude and latitude [deg], rounded, and height,
        whatever the CRS of the points, so that no role depends on it. Those of a CRS that nothing
        is known of stay as they are.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> split = termsel.Split("all", "All points are control.",
    ...                       lambda ids, ground, shares, rng: ["control"] * len(ids))
    >>> split.roles(("A", "B"), np.zeros((2, 3)), np.array([1.0, 0.0, 0.0]),
    ...             np.random.default_rng(0))
    ('control', 'control')
    """

    name: str
    summary: str
    assign: Callable[[tuple[str, ...], FloatArray, FloatArray, np.random.Generator], Sequence[str]]
    on_globe: bool = False

    def roles(self, ids: tuple[str, ...], ground: FloatArray, shares: FloatArray,
              rng: np.random.Generator) -> tuple[str, ...]:
        """Return a role for each of n points, which the split assigns.

        `ground` (n, 3) are their places. `shares` (3,), whose sum is 1, are those of control, check
        and independent points. Raises PluginFault, naming the plugin, if it assigns other than one
        role each.
        """
        # Copies, as a plugin may change what it is given.
        with attribute_errors_to(self.assign, "assign"):
            assigned = self.assign(ids, ground.copy(), shares.copy(), rng)
        if (isinstance(assigned, str) or not isinstance(assigned, Sequence | np.ndarray)
                or len(assigned) != len(ids) or not set(map(str, assigned)) <= set(ASSIGNABLE)):
            raise fault_of_method(self.assign, "assign",
                                  f"returned {assigned!r:.200}; expected a role for "
                                  f"each of {len(ids)} points: {', '.join(ASSIGNABLE)}")
        return tuple(map(str, assigned))


def stratified_roles(_ids: tuple[str, ...], ground: FloatArray, shares: FloatArray,
                     rng: np.random.Generator) -> list[str]:
    """Give neighbouring points different roles, so that each role covers the scene."""
    return _roles_in_turn(spatial_order(ground[:, :2]), shares, rng)


def random_roles(ids: tuple[str, ...], _ground: FloatArray, shares: FloatArray,
                 rng: np.random.Generator) -> list[str]:
    """Draw roles without regard to place."""
    return _roles_in_turn(rng.permutation(len(ids)), shares, rng)


def _roles_in_turn(order: Sequence[int] | np.ndarray, shares: FloatArray,
                   rng: np.random.Generator) -> list[str]:
    """Return the role of each point, so that every stretch of an order has all roles by share.

    `order` has the numbers of the points. `shares` (3,) are those of the roles in the order of
    ASSIGNABLE, with the sum 1; a role with the share 0 is not given.
    """
    # Each point in the order gets the role that lags most behind its share. Among roles that lag
    # nearly alike the draw decides, so that different seeds give different splits.
    names = ASSIGNABLE
    # Without control among the points, its draws go to the first role that there is: check.
    if not shares[0]:
        names = (*names[1:], names[0])
        shares = np.roll(shares, -1)
    counts = np.zeros(3)
    roles = [""] * len(order)
    for n_before, i in enumerate(order):
        # The points that each role should have by now, less those it has.
        lag = shares * (n_before + 1) - counts
        lag = np.where(shares > 0, lag + rng.uniform(0.0, 0.5, 3), -np.inf)
        role = int(np.argmax(lag))
        counts[role] += 1
        roles[i] = names[role]
    return roles


STRATIFIED = Split("stratified", "Neighbouring points get different roles, so that each role "
                                 "covers"
                   " the scene.", stratified_roles, on_globe=True)
SPLITS = (STRATIFIED, Split("random", "Roles are drawn at random, not by position.", random_roles))
"""Built-in splits."""


_CONTROL = "Write control for a ground control point (GCP, CoP)."
_INDEPENDENT = "Write independent for a check point that tests the result (ICP, checkpoint)."
_SELECTION = "Write check for a point that chooses the model (GACP, selection point)."
FIELD_ROLES = {
    **dict.fromkeys(("gcp", "gcps", "cop", "cops", "controlpoint", "groundcontrol",
                     "groundcontrolpoint", "full", "fullcontrol"), _CONTROL),
    **dict.fromkeys(("icp", "icps", "checkpoint", "chkpt", "test", "testpoint", "validation",
                     "validate", "verification"), _INDEPENDENT),
    **dict.fromkeys(("gacp", "gacps", "selection", "selectionpoint"), _SELECTION),
    "cp": "CP is written for a control point and for a check point: write control if the point "
          "fits the model, independent if it tests the result.",
    "tie": "A tie point has no ground coordinates: write off, or remove it.",
    "tiepoint": "A tie point has no ground coordinates: write off, or remove it."}
"""What to write for words of the field and of papers, without signs and capitals."""

THIRDS = (1 / 3, 1 / 3, 1 / 3)
_NUMBER = re.compile(r"([0-9]+)")


@dataclass(frozen=True, eq=False)
class Observations:
    """Measured features, each point in the one role it plays in a run.

    `features` are all points and the control lines; `control` control points and lines, which are
    always control. Check points judge the fitness of a choice, independent points the result: no
    choice ever sees them. What follows from features and roles is derived once and kept here.
    """

    features: FeatureSet
    control: FeatureSet
    check: Points
    independent: Points

    @property
    def off(self) -> tuple[str, ...]:
        """Ids of points that take no part."""
        points = self.features.points
        return tuple(name for name, role in zip(points.ids, points.roles, strict=True)
                     if role == "off")

    @cached_property
    def together(self) -> FeatureSet:
        """Control and selection points as control, and the control lines."""
        return self.control.with_(points=self.control.points.join_unchecked(self.check))

    @cached_property
    def carriers(self) -> tuple[str, ...]:
        """One or two features of `together` without which all heights lie on a plane; else ()."""
        return relief_carriers(self.joint) if self.joint.heights else ()

    @cached_property
    def heights(self) -> bool:
        """Whether all features have heights, and these differ without any one or two of them."""
        # Of independent points nothing else is looked at.
        return (not np.isnan(self.independent.ground[:, 2]).any()
                and self.joint.heights and not self.carriers)

    @cached_property
    def pool(self) -> FitData:
        """The features among which a choice is made: those of `together`, twins merged."""
        features = with_merged_twins(self.together)
        return (replace(self.joint, heights=self.heights) if features is self.together
                else FitData.of(features, self.heights))

    @cached_property
    def lattice(self) -> Lattice | None:
        """The lattice that all points form, with its rows for the points of the pool.

        Returns None if all points form no lattice.
        """
        points = self.features.points
        all_points = lattice_of(self.features)
        if all_points is None:
            return None
        row_of = {name: index for index, name in enumerate(points.ids)}
        rows = [row_of[name] for name in self.pool.features.ids]
        return all_points.take(np.array(rows, dtype=np.intp))

    @cached_property
    def joint(self) -> FitData:
        """Those of `together` with their scaling, heights where these differ."""
        return FitData.of(self.together)

    def fitted_in(self, crs: str) -> Observations:
        """Return the observations with the CRS a model is to be fitted in."""
        return replace(self, features=replace(self.features, fit_crs=crs),
                       control=replace(self.control, fit_crs=crs))


def assign_roles(
    points: Points,
    *,
    split: Split = STRATIFIED,
    fractions: Sequence[float] = THIRDS,
    lines: bool = False,
    crs: str = LOCAL,
    rng: np.random.Generator,
) -> tuple[str, ...]:
    """Return a role for each point, control, check or independent, by its place on the ground.

    `fractions` are the shares of control, selection and independent check points, of any sum.
    `lines` says whether lines are the control: the share of control points is 0 then. `crs` is
    that of the points. Raises TermselError for negative shares, or if control (with lines: check)
    has none.
    """
    # Control needs a share, or check if lines are the control, as points then are none.
    first_role = 1 if lines else 0
    shares = np.array((0.0, *fractions[1:]) if lines else fractions, dtype=np.float64)
    if (shares.shape != (3,) or not np.isfinite(shares).all() or (shares < 0).any()
            or not shares[first_role]):
        raise TermselError(f"fractions {list(fractions)} do not assign the points",
                           hint="Give three numbers: control (above 0), check, independent.")
    shares = shares / shares.max()  # the sum of huge ones is infinite
    # Roles depend on the ground alone: image coordinates of independent points must not matter.
    ground = to_globe(points.ground, crs) if split.on_globe else points.ground
    return split.roles(points.ids, ground, shares / shares.sum(), rng)


def asked_roles(off: str | None, role: str | None) -> dict[str, str]:
    """Return the role of each feature that the options `off` and `role` name.

    `off` has ids, and `role` has pairs ID=ROLE, both with commas between. Raises TermselError for
    a pair of another form, for a role that does not exist, and for an id with two different roles.
    """
    role_of: dict[str, str] = {}
    # The option `off` is short for ID=off.
    pairs = [(name, "off") for name in (off or "").split(",")]
    for pair in (role or "").split(","):
        name, equals, value = pair.rpartition("=")
        if pair.strip() and not equals:
            raise TermselError(f"--role {pair.strip()!r} is not of the form ID=ROLE",
                               hint=f"For example P07=check. Roles are {', '.join(ROLES)}.")
        if equals and value.strip() not in ROLES:
            meant = FIELD_ROLES.get(fold_name(value), "")
            raise unknown_name_error("role", value.strip(), ROLES,
                                     f"It stands in --role {pair.strip()}. {meant}".rstrip())
        pairs.append((name, value.strip()))
    for name, value in pairs:
        name = name.strip()
        if name and role_of.setdefault(name, value) != value:
            raise TermselError(f"{name!r} is given the roles {role_of[name]} and {value}",
                               hint="Give it one role.")
    return role_of


def with_roles(features: FeatureSet, role_of: Mapping[str, str]) -> FeatureSet:
    """Return the features with some roles changed, without the lines that become off.

    `role_of` has the new role of each id, as the options --off and --role state it. Raises
    TermselError for ids that no feature has, and for lines in a role that lines cannot have.
    """
    if not role_of:
        return features
    points = features.points
    lines = features.lines
    for name, role in role_of.items():
        if name not in features.ids:
            raise _unknown_id_error(name, role, features.ids)
        if name in lines.features and role not in ("control", "off"):
            raise TermselError(f"{name!r} is a line and cannot have the role {role}",
                               hint="Lines are control, or off.", ids=[name])
    roles = tuple(role_of.get(name, role)
                  for name, role in zip(points.ids, points.roles, strict=True))
    is_kept = [role_of.get(name) != "off" for name in lines.ids]
    return features.with_(points=replace(points, roles=roles), lines=lines.take(is_kept))


def _unknown_id_error(name: str, role: str, ids: Sequence[str]) -> TermselError:
    """Return the error for an id of --off or --role that no feature has, with near ids."""
    near_ids = get_close_matches(name, ids, n=3)
    # P1-P9 may be meant as a range, but may be an id as well: it is never expanded.
    if RANGE.search(name) or set(name.split("-")) <= set(ids):
        hint = "Write each id, with commas between: ranges and patterns are not read."
    elif near_ids:
        hint = f"Did you mean {' or '.join(map(repr, near_ids))}?"
    else:
        hint = f"Their ids are {first_names_in_words(ids)}."
    option = "--off" if role == "off" else "--role"
    return TermselError(f"{option} names {name!r}, an id that the files do not have", hint=hint,
                        name=name)


def observe(
    features: FeatureSet,
    *,
    control: str = "points",
    split: Split | None = None,
    fractions: Sequence[float] = THIRDS,
    rng: np.random.Generator,
) -> Observations:
    """Give every measured feature its role.

    The observations are in the order of ids, with longitudes that do not jump. `control`, "points",
    "lines" or "both", says which features are control; where lines alone are, control points are
    off. Without a `split` the roles of the file stay, and blank ones are stratified; a split
    disregards the file's roles, except "off". Twins that are assigned share a role, and so do the
    points on a line of a lattice, which show each other. `fractions` are the shares of control,
    selection and independent check points among those that are assigned; with control from lines
    alone, all become selection and independent check points.

    Raises TermselError if there are no features that could be the control.
    """
    features, labels = _order_and_labels(features)
    points = features.points
    if control == "points" and not len(points):
        raise TermselError("the problem needs control points and there are none",
                           hint=f"Give them with {Remedy('points', 'FILE')}, or choose a problem "
                                "over lines, such as owdis-lines.")
    if control in ("lines", "both") and not len(features.lines):
        remedy = "without mixed=true" if control == "both" else "such as rfm-terms"
        raise TermselError(
            "the problem needs control lines and there are none",
            hint=f"Give them with --lines FILE, or choose a problem over points, {remedy}.")
    roles = np.array(points.roles, dtype=object)
    if split is not None:
        # A point that is off stays off, whatever the split.
        roles[roles != "off"] = ""
    # A blank twin of a point with a role takes this role: they repeat one measurement.
    role_of_group = {label: role for label, role in zip(labels, roles, strict=True)
                     if role not in ("", "off")}
    for i in np.flatnonzero(roles == ""):
        roles[i] = role_of_group.get(labels[i], "")
    blank = np.flatnonzero(roles == "")
    if blank.size:
        # One representative of each group of twins is assigned, and the others follow.
        _, first_of_group, group = np.unique(labels[blank], return_index=True,
                                             return_inverse=True)
        assigned = assign_roles(points.take(blank[first_of_group]), split=split or STRATIFIED,
                                fractions=fractions, lines=control == "lines",
                                crs=features.crs, rng=rng)
        roles[blank] = np.array(assigned, dtype=object)[group]
    if control == "lines":
        # With lines as the control, control points would be neither fitted nor judged.
        roles[roles == "control"] = "off"
    return observations_by_role(features.with_(
        points=replace_unchecked(points, roles=tuple(roles)),
        lines=empty_lines() if control == "points" else features.lines))


@lru_cache(maxsize=2)  # roles and folds ask about the same features
def _order_and_labels(features: FeatureSet) -> tuple[FeatureSet, IntArray]:
    """Return features in the order of ids, without jumps of longitude, and a label of each point.

    Points of one label share a role: they are twins, or on one line of a lattice.
    """
    features = without_jump(sorted_by_id(features))
    lattice = lattice_of(features)
    return features, find_twins(features.points.ground) if lattice is None else lattice.line


def sorted_by_id(features: FeatureSet) -> FeatureSet:
    """Return features in the order of their ids, in which P2 comes before P10."""
    # What chance or ties decide is then the same, however the rows of a file are ordered.
    points = features.points
    lines = features.lines
    return features.with_(points=points.take(_natural_order(points.ids)),
                          lines=lines.take(_natural_order(lines.ids)))


def _natural_order(names: Sequence[str]) -> list[int]:
    """Return the indices of names in natural order, in which P2 comes before P10.

    Equal names, as of the pieces of one line, stay in their order.
    """
    keys = []
    for name in names:
        # Each odd piece is a number and counts by its value: without leading zeros the longer of
        # two is larger.
        pieces = [piece.lstrip("0") if i % 2 else piece
                  for i, piece in enumerate(_NUMBER.split(name))]
        # The name itself, at the end, parts names whose pieces are equal, such as P1 and P01.
        keys.append(([(len(piece) if i % 2 else 0, piece) for i, piece in enumerate(pieces)], name))
    return sorted(range(len(keys)), key=keys.__getitem__)


def observations_by_role(features: FeatureSet) -> Observations:
    """Return the observations of features whose points all have a role; lines are control."""
    points = features.points
    roles = np.array(points.roles, dtype=object)
    control, check, independent = (points.take(roles == role) if (roles == role).any()
                                   else empty_points() for role in ASSIGNABLE)
    return Observations(features, features.with_(points=control), check, independent)


def leave_out(observations: Observations, ids: Iterable[str]) -> Observations:
    """Return the observations with some points in the role off, and without some lines."""
    off = dict.fromkeys(ids, "off")
    return observations_by_role(with_roles(observations.features, off)) if off else observations


def with_lines(observations: Observations, lines: Lines) -> Observations:
    """Return the observations with other control lines."""
    return observations_by_role(observations.features.with_(lines=lines))


def check_as_control(observations: Observations) -> Observations:
    """Return the observations with all selection points as further control."""
    points = observations.features.points
    roles = tuple("control" if role == "check" else role for role in points.roles)
    return Observations(observations.features.with_(points=replace(points, roles=roles)),
                        observations.together, empty_points(), observations.independent)


def parse_shares(text: str, needs_check: bool) -> tuple[float, ...]:
    """Return the shares of control, selection and independent check points, from "1:1:1".

    Raises TermselError for other than three finite numbers of at least 0, and for a share 0 of
    check points where the criterion needs them.
    """
    try:
        shares = tuple(float(number) for number in text.replace(",", ":").split(":"))
    except ValueError:
        shares = ()
    if (len(shares) != 3 or not np.isfinite(shares).all() or min(shares) < 0
            or (needs_check and not shares[1])):
        raise TermselError(f"option 'fractions' cannot be {text!r}",
                           hint="It takes three numbers for control, check and independent, "
                                "such as 1:1:1 or 0.4:0.3:0.3; check must be above 0 "
                                "for a criterion that needs selection points.")
    return shares
