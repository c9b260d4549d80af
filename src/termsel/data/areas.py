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
        """Open the ring and check it; raises TermselError or `CornerError` as the class says."""
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
            far = ~(np.abs(values) < FARTHEST).all(axis=1)  # NaN too
            if far.any():
                corner = int(np.argmax(far))
                raise CornerError(f"corner {corner + 1} of area {self.id!r} has {space} "
                                  f"coordinates that are not finite, or of {FARTHEST:g} or more",
                                  corner, space, "Correct the values or remove the area.")
        _refuse_bad(self.id, image, "image")
        _refuse_bad(self.id, ground[:, :2], "ground")


def boundary_lines(areas: Sequence[Area]) -> Lines:
    """Return the edges of areas as lines; areas that are "off" are left out.

    The edges of one area have its id, and are pieces of one feature. An edge that neighbours share,
    with the same X and Y at its ends, is used once, by the area that has fewer edges so far: so
    each keeps some. Raises TermselError for an area in the role check or independent, which lines
    cannot have; for an area whose edges all belong to others; and for what `Lines` refuses.

    Yavari, Valadan Zoej and Salehi (2018) name areas as control features, next to points and lines;
    that an area enters by its boundary or its centroid is termsel's own formulation.
    """
    for area in areas:
        if area.role in ("check", "independent"):
            raise TermselError(
                f"the boundary of area {area.id!r} cannot have the role {area.role!r}",
                hint="Lines are always control: use control, off or blank. Centroids can have any "
                     "role (--set areas_as=centroid).", ids=[area.id])
    on = [area for area in areas if area.role != "off"]
    ids: list[str] = []
    attributes: list[Mapping[str, str]] = []
    # The empty arrays are for no areas at all.
    image = [np.empty((0, 2, 2))]
    ground = [np.empty((0, 2, 3))]
    for area, edges in zip(on, _unshared_edges(on), strict=True):
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

    Corners are in order, either way, without the first repeated; an unknown height gives NaN.
    """
    corners = np.asarray(ring, dtype=np.float64)
    # About the mean corner, so that large coordinates do not cancel.
    middle = corners.mean(axis=0)
    # From the triangles between the mean corner and each edge, in the plane of the first two
    # coordinates; the third is the mean over that area.
    edges = _edges_of_ring(corners - middle)
    twice = _cross_products(edges[:, 0], edges[:, 1])
    return np.asarray(middle + twice @ edges.sum(axis=1) / (3 * twice.sum()))


def _unshared_edges(areas: Sequence[Area]) -> list[list[int]]:
    """Return the numbers of each area's edges, without those that another area uses."""
    # By its ends: the first area on either side of an edge, and the number it has there.
    by_ends: dict[frozenset[tuple[float, ...]], dict[bool, tuple[int, int]]] = {}
    for i, area in enumerate(areas):
        # Edges of the ground ring (n, 2, 2), and whether it runs against the clock.
        ring = _edges_of_ring(area.ground[:, :2])
        around = _cross_products(*np.moveaxis(ring - ring.mean(axis=(0, 1)), 1, 0)).sum() > 0
        for j, (start, end) in enumerate(ring.tolist()):
            # Both neighbours find an edge under the same key, whichever end comes first; the area
            # is on its left where direction and sense agree.
            ends = frozenset((tuple(start), tuple(end)))
            by_ends.setdefault(ends, {}).setdefault((start < end) == around, (i, j))
    edges_of: list[list[int]] = [[] for _ in areas]
    # To the one with fewer. Every area lies on either side of some of its edges, so that the
    # rule for equal numbers leaves none without.
    for on_either in sorted(by_ends.values(), key=len):
        i, j = on_either[min(on_either, key=lambda side: (
            len(edges_of[on_either[side][0]]), not side))]
        edges_of[i].append(j)
    return [sorted(edges) for edges in edges_of]


def _edges_of_ring(ring: FloatArray) -> FloatArray:
    """Return the edges (n, 2, d) of a ring of corners (n, d); the last one ends at the first."""
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)


def _cross_products(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return x1 y2 - x2 y1 of vectors (..., 2): its sign says on which side the second is."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _refuse_bad(name: str, ring: FloatArray, space: str) -> None:
    """Raise a CornerError if a ring, shape (n, 2), bounds no area.

    Each test has its reason: fewer than three corners, a corner given twice, corners on one
    straight line, or edges that cross. Edges of very many corners are not compared with each other,
    which would take the square of their number. `space` is "image" or "ground", for the message.
    """
    n = len(ring)
    in_words = "in the image" if space == "image" else "on the ground"
    if n < 3:
        raise CornerError(f"area {name!r} has {count_in_words(n, 'corner')}", max(n - 1, 0), space,
                          "An area requires at least three.")
    # For each corner the first one with the same coordinates: itself, unless it is a repetition.
    _, first, inverse = np.unique(ring, axis=0, return_index=True, return_inverse=True)
    before = first[inverse.ravel()]
    if (before != np.arange(n)).any():
        corner = int(np.argmax(before != np.arange(n)))
        raise CornerError(f"corner {corner + 1} of area {name!r} repeats corner "
                          f"{before[corner] + 1} {in_words}", corner, space,
                          "Give every corner once; only the first may be repeated at the end, in "
                          "the image and on the ground.")
    # Twice the area by the shoelace formula, about the mean corner so that nothing cancels.
    edges = _edges_of_ring(ring - ring.mean(axis=0))
    if abs(_cross_products(edges[:, 0], edges[:, 1]).sum()) <= _FLAT * float(
            np.ptp(ring, axis=0).max())**2:
        raise CornerError(f"area {name!r} has no extent {in_words}", 0, space,
                          "Its corners lie on one straight line, or its edges cross.")
    crossed = _find_crossing_edges(edges) if n <= _MANY else None
    if crossed is not None:
        first_edge, second_edge = crossed
        raise CornerError(f"the edges from corners {first_edge + 1} and {second_edge + 1} of area "
                          f"{name!r} cross {in_words}", second_edge, space,
                          "Give the corners in order around the area.")


def _find_crossing_edges(edges: FloatArray) -> tuple[int, int] | None:
    """Return the first two edges, shape (n, 2, 2), that cross, or None."""
    directions = edges[:, 1] - edges[:, 0]
    # On which side of edge i the ends of edge j are; zero for an end the two share.
    first_ends = _cross_products(directions[:, None], edges[None, :, 0] - edges[:, None, 0])
    second_ends = _cross_products(directions[:, None], edges[None, :, 1] - edges[:, None, 0])
    # Two edges cross where each parts the ends of the other.
    is_parted = first_ends * second_ends < 0
    pairs = np.argwhere(np.triu(is_parted & is_parted.T))
    return (int(pairs[0, 0]), int(pairs[0, 1])) if len(pairs) else None
