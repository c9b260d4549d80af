"""Piecewise polynomials: an affine transformation in each triangle of control points."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from termsel import Option, Polynomial2D

if TYPE_CHECKING:
    from scipy.spatial import Delaunay

FloatArray = NDArray[np.float64]


class Piecewise(Polynomial2D):
    """2-D polynomial whose residuals are interpolated within triangles of control points.

    The control points are triangulated (Delaunay) in scaled X and Y. In a triangle, the residuals
    of its three points are interpolated linearly, so that with `degree=1` each triangle has the
    affine transformation of its points. The model is continuous and fits control points exactly:
    their RMSE is 0 whatever its errors elsewhere. A point outside of the triangles is corrected as
    the nearest point of their hull. Control points that have no triangle, as they lie on a line,
    correct nothing.

    The paper names piecewise polynomials next to pointwise ones, and gives no equations.

    References
    ----------
    Valadan Zoej et al. 2002, section 1; Goshtasby 1986, Piecewise linear mapping functions for
    image registration, Pattern Recognition 19(6).
    """

    name = "piecewise"
    declared_options = (
        Option("degree", 1, "Degree of the polynomial; 1 has an affine transformation in each "
                            "triangle.", int, 1, 8),)

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the weight of each residual at each place (see `SensorModel.residual_weights`).

        The weights have the shape (places, control points). If control points have the same X and
        Y, the mean of their residuals is interpolated.
        """
        positions, group = np.unique(control[:, :2], axis=0, return_inverse=True)
        is_member = np.equal.outer(np.arange(len(positions)), group.reshape(-1))
        share_of_members = is_member / is_member.sum(axis=1, keepdims=True)
        return np.asarray(_barycentric_coordinates(positions, ground[:, :2]) @ share_of_members)


def _barycentric_coordinates(positions: FloatArray, places: FloatArray) -> FloatArray:
    """Return barycentric coordinates (m, n) of places (m, 2) by the positions (n, 2).

    At a place, those of the three corners of its triangle are not zero; outside of all triangles,
    those of the ends of the nearest edge of the hull. All are zero if there are no triangles.
    """
    shares = np.zeros((len(places), len(positions)))
    triangles = _cached_triangles(np.ascontiguousarray(positions).tobytes())
    if triangles is None:
        return shares
    inside = triangles.find_simplex(places)
    for i in np.flatnonzero(inside < 0).tolist():
        a, b, along = _nearest_on_hull(positions, triangles.convex_hull, places[i])
        shares[i, a] += 1.0 - along
        shares[i, b] += along
    rows = np.flatnonzero(inside >= 0)
    # scipy's affine map of a triangle gives two of the coordinates; all three add up to 1.
    transform = triangles.transform[inside[rows]]
    first_two = np.einsum("mij,mj->mi", transform[:, :2], places[rows] - transform[:, 2])
    corners = triangles.simplices[inside[rows]]
    three = np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])
    np.add.at(shares, (rows[:, None], corners), three)
    return shares


@lru_cache(maxsize=8)  # Each fit of a comparison asks for the same positions.
def _cached_triangles(positions: bytes) -> Delaunay | None:
    """Return the Delaunay triangles of positions (n, 2); a cache takes bytes, and no arrays.

    None if there are fewer than three, or all lie on a line.
    """
    from scipy.spatial import Delaunay, QhullError

    points = np.frombuffer(positions).reshape(-1, 2)
    if len(points) < 3:
        return None
    try:
        return Delaunay(points)
    except QhullError:
        return None


def _nearest_on_hull(positions: FloatArray, edges: NDArray[np.int32],
                     place: FloatArray) -> tuple[int, int, float]:
    """Return the edge of the hull that is nearest to a place.

    `edges` (m, 2) are the edges by the numbers of their ends in `positions`. Returned are both of
    these numbers, and where on the edge the nearest point is: 0 at the first end, 1 at the second.
    """
    start = positions[edges[:, 0]]
    step = positions[edges[:, 1]] - start
    along = np.clip(((place - start) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0)
    distance = np.linalg.norm(start + along[:, None] * step - place, axis=1)
    best = int(distance.argmin())
    return int(edges[best, 0]), int(edges[best, 1]), float(along[best])
