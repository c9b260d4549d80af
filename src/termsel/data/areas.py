"""Areas as control features: a polygon's edges as conjugate lines, or its centroid as a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from termsel.core.errors import TermselError, count_in_words
from termsel.data.features import FloatArray, Lines, Points
from termsel.data.tables.tabular import FARTHEST, columns_of

FORMS = ("boundary", "centroid")

_FLAT = 1e-9  # area over the square of the extent; rounding of metres in a UTM zone is below
_MANY = 1000  # most corners for which crossing edges, at quadratic cost, are looked for


class CornerError(TermselError):
    """An invalid area, and the corner, counted from 0, that shows it in the image or on the ground.
    """

    def __init__(self, problem: str, corner: int, where: str, hint: str) -> None:
        super().__init__(problem, hint=hint)
        self.corner = corner
        self.where = where


@dataclass(frozen=True, eq=False)
class Area:
    """A polygon given by its corners, in the image and on the ground.

    At least three corners in order around the area, line and sample [px] (n, 2) and X, Y, Z (n, 3)
    with NaN for heights that are not known; the first may be repeated at the end. Role and
    attributes are those of features. Raises TermselError if image and ground have different numbers
    of corners; a `CornerError` for fewer than three, for a repeated one, for corners on one
    straight line and for edges that cross.
    """

    id: str
    image: FloatArray
    ground: FloatArray
    role: str = ""
    attributes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Drop a repeated last corner and check the rings.

        Raises TermselError for arrays of other shapes, and `CornerError` for a bad corner.
        """
        image, ground = (np.array(ring, dtype=np.float64) for ring in (self.image, self.ground))
        n = len(image)
        if image.shape != (n, 2) or ground.shape != (n, 3):
            raise TermselError(
                f"area {self.id!r} has corners of the shapes {image.shape} in the image and "
                f"{ground.shape} on the ground, expected (n, 2) and (n, 3)", ids=[self.id],
                hint="Measure each corner in the image and on the ground.")
        # A closed ring: many formats repeat the first corner, and it would be an edge of no length.
        if n > 1 and (image[0] == image[-1]).all() and (ground[0, :2] == ground[-1, :2]).all():
            image = image[:-1]
            ground = ground[:-1]
        object.__setattr__(self, "image", image)
        object.__setattr__(self, "ground", ground)
        for values, space in ((image, "image"), (ground[:, :2], "ground")):
            # "not less than" is true of NaN, too.
            is_bad = ~(np.abs(values) < FARTHEST).all(axis=1)
            if is_bad.any():
                corner = int(np.argmax(is_bad))
                raise CornerError(f"corner {corner + 1} of area {self.id!r} has {space} "
                                  f"coordinates that are not finite, or of {FARTHEST:g} or more",
                                  corner, space, "Correct the values or remove the area.")
        _require_ring(self.id, image, "image")
        _require_ring(self.id, ground[:, :2], "ground")


def boundary_lines(areas: Sequence[Area]) -> Lines:
    """Return the edges of areas as lines; areas that are "off" are left out.

    The edges of one area have its id, and are pieces of one feature. An edge that neighbours share,
    with the same X and Y at its ends, is used once, by the area that has fewer edges so far. So
    neighbours that do not overlap keep some edges each. Raises TermselError for an area in the role
    check or independent, which lines cannot have; for an area whose edges all belong to others,
    such as one that is given twice; and for what `Lines` refuses.

    Yavari, Valadan Zoej and Salehi (2018) name areas as control features, next to points and lines;
    that an area enters by its boundary or its centroid is termsel's own formulation.
    """
    for area in areas:
        if area.role in ("check", "independent"):
            raise TermselError(
                f"the boundary of area {area.id!r} cannot have the role {area.role!r}",
                hint="Lines are always control: use control, off or blank. Centroids can have any "
                     "role (--set areas_as=centroid).", ids=[area.id])
    areas_in_use = [area for area in areas if area.role != "off"]
    ids: list[str] = []
    attributes: list[Mapping[str, str]] = []
    # The empty arrays are for no areas at all.
    image = [np.empty((0, 2, 2))]
    ground = [np.empty((0, 2, 3))]
    for area, edges in zip(areas_in_use, _unshared_edges(areas_in_use), strict=True):
        if not edges:
            raise TermselError(f"all edges of area {area.id!r} belong to other areas on the same "
                               "side", ids=[area.id], hint="Remove one of these areas.")
        ids += [area.id] * len(edges)
        attributes += [area.attributes] * len(edges)
        image.append(_edges_of_ring(area.image)[edges])
        ground.append(_edges_of_ring(area.ground)[edges])
    return Lines(tuple(ids), np.concatenate(image), np.concatenate(ground),
                 attributes=columns_of(attributes))


def centroid_points(areas: Sequence[Area]) -> Points:
    """Return the centroids of areas as points; without a role they become control."""
    # That in the image is the image of that on the ground where the area is plane, and so small
    # that the projection is affine across it.
    return Points(tuple(area.id for area in areas),
                  np.reshape([centroid_of_ring(area.image) for area in areas], (-1, 2)),
                  np.reshape([centroid_of_ring(area.ground) for area in areas], (-1, 3)),
                  roles=tuple(area.role or "control" for area in areas),
                  attributes=columns_of([area.attributes for area in areas]))


def centroid_of_ring(ring: ArrayLike) -> FloatArray:
    """Return the centroid of the area that a ring of corners, (n, 2) or (n, 3), bounds.

    Corners are in order, clockwise or not, and the first is not repeated at the end. One unknown
    height makes that of the centroid NaN.
    """
    corners = np.asarray(ring, dtype=np.float64)
    # Coordinates are counted from the mean corner, so that large ones do not cancel.
    middle = corners.mean(axis=0)
    # Each edge makes a triangle with the mean corner. The centroid is the mean of theirs, each a
    # third of the sum of its two other corners, weighted by their areas in the first two
    # coordinates.
    edges = _edges_of_ring(corners - middle)
    double_areas = _cross_products(edges[:, 0], edges[:, 1])
    return np.asarray(middle + double_areas @ edges.sum(axis=1) / (3 * double_areas.sum()))


def _unshared_edges(areas: Sequence[Area]) -> list[list[int]]:
    """Return the numbers of each area's edges, without those that another area uses.

    Of areas on the same side of an edge the first has it, so that an area may be left with none.
    """
    # For the ends of an edge, and for each side: the first area there and the edge's number in it.
    by_ends: dict[frozenset[tuple[float, ...]], dict[bool, tuple[int, int]]] = {}
    for i, area in enumerate(areas):
        edges = _edges_of_ring(area.ground[:, :2])  # (n, 2, 2)
        centred = edges - edges.mean(axis=(0, 1))
        is_anticlockwise = _cross_products(centred[:, 0], centred[:, 1]).sum() > 0
        for j, (start, end) in enumerate(edges.tolist()):
            # Both neighbours find an edge under the same key, whichever end comes first. An area is
            # on the left of an edge that is followed anticlockwise; seen from the lesser end it is
            # so, too, if a clockwise ring follows the edge from the greater end.
            ends = frozenset((tuple(start), tuple(end)))
            is_on_left = (start < end) == is_anticlockwise
            by_ends.setdefault(ends, {}).setdefault(is_on_left, (i, j))
    edges_of: list[list[int]] = [[] for _ in areas]
    # Edges of one area alone come first. Each shared one goes to the area with fewer edges, and
    # between equals to the one on the same side: every ring has edges of both sides, so that this
    # leaves none without.
    for areas_by_side in sorted(by_ends.values(), key=len):
        side = min(areas_by_side, key=lambda side: (
            len(edges_of[areas_by_side[side][0]]), not side))
        i, j = areas_by_side[side]
        edges_of[i].append(j)
    return [sorted(edges) for edges in edges_of]


def _edges_of_ring(ring: FloatArray) -> FloatArray:
    """Return the edges (n, 2, d) of a ring of corners (n, d); the last one ends at the first."""
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)


def _cross_products(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return x1 y2 - x2 y1 of vectors (..., 2): its sign says on which side the second is."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _require_ring(name: str, ring: FloatArray, space: str) -> None:
    """Raise a CornerError if a ring, shape (n, 2), bounds no area.

    It bounds none with fewer than three corners, with a corner given twice, with all corners on one
    straight line, or with edges that cross. Crossings are not looked for in rings of more than
    `_MANY` corners, as the time grows with the square of their number. `space` is "image" or
    "ground", for the message.
    """
    n = len(ring)
    in_words = "in the image" if space == "image" else "on the ground"
    if n < 3:
        raise CornerError(f"area {name!r} has {count_in_words(n, 'corner')}", max(n - 1, 0), space,
                          "An area requires at least three.")
    # For each corner the first one with the same coordinates: itself, unless it is a repetition.
    _, first, inverse = np.unique(ring, axis=0, return_index=True, return_inverse=True)
    first_alike = first[inverse.ravel()]
    is_repeated = first_alike != np.arange(n)
    if is_repeated.any():
        corner = int(np.argmax(is_repeated))
        raise CornerError(f"corner {corner + 1} of area {name!r} repeats corner "
                          f"{first_alike[corner] + 1} {in_words}", corner, space,
                          "Give every corner once; only the first may be repeated at the end, in "
                          "the image and on the ground.")
    # The shoelace formula gives twice the area; about the mean corner no large numbers cancel.
    edges = _edges_of_ring(ring - ring.mean(axis=0))
    double_area = abs(_cross_products(edges[:, 0], edges[:, 1]).sum())
    if double_area <= _FLAT * float(np.ptp(ring, axis=0).max())**2:
        raise CornerError(f"area {name!r} has no extent {in_words}", 0, space,
                          "Its corners lie on one straight line, or its edges cross.")
    crossed = _find_crossing_edges(edges) if n <= _MANY else None
    if crossed is not None:
        first_edge, second_edge = crossed
        raise CornerError(f"the edges from corners {first_edge + 1} and {second_edge + 1} of area "
                          f"{name!r} cross {in_words}", second_edge, space,
                          "Give the corners in order around the area.")


def _find_crossing_edges(edges: FloatArray) -> tuple[int, int] | None:
    """Return the numbers of the first two edges (n, 2, 2) that cross, or None if none do."""
    directions = edges[:, 1] - edges[:, 0]
    # Entry i, j: the sign says on which side of edge i an end of edge j is; 0 for a shared end.
    first_ends = _cross_products(directions[:, None], edges[None, :, 0] - edges[:, None, 0])
    second_ends = _cross_products(directions[:, None], edges[None, :, 1] - edges[:, None, 0])
    # Two edges cross if the ends of each are on different sides of the other.
    is_parted = first_ends * second_ends < 0
    pairs = np.argwhere(np.triu(is_parted & is_parted.T))
    return (int(pairs[0, 0]), int(pairs[0, 1])) if len(pairs) else None
