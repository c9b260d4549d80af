"""The pointwise transformation: a separate polynomial for every point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from termsel import Option, Polynomial2D

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Added to the distance relative to the farthest neighbour: the weight at a control point is finite.
_MIN_RELATIVE_DISTANCE = 1e-4

WEIGHTS = {
    "uniform": lambda u: np.ones_like(u),
    "inverse-distance": lambda u: 1 / (u + _MIN_RELATIVE_DISTANCE),
    "inverse-square": lambda u: 1 / (u + _MIN_RELATIVE_DISTANCE)**2,
    "gaussian": lambda u: np.exp(-4 * u**2),
}
"""Functions from the distance of control points, relative to that of the farthest neighbour (0 to
1), to their weight."""


class Pointwise(Polynomial2D):
    """2-D polynomial, corrected at each point by a polynomial of the residuals around it.

    A global polynomial is fitted to all control. Each point then has its own transformation: a
    local polynomial of the offsets in X and Y, fitted by weighted least squares to the residuals
    of the control points around it. That is linear in the residuals. A local
    polynomial absorbs any global one of its own or a lower degree, so that with `degree=1` and
    `local_degree=1` a direct fit of the image coordinates gives the same.

    The paper leaves neighbourhood, weights and degrees open; the defaults are termsel's own.
    If there are fewer neighbours than terms, the local degree is lowered. Distances are in
    termsel's scaled ground coordinates, as in `multiquadric`.

    References
    ----------
    Valadan Zoej et al. 2002, section 2.2, after Leberl 1990.
    """

    name = "pointwise"
    declared_options = (
        Option("degree", 2, "Total degree of the global polynomial; 2 gives 6 terms per axis.",
               int, 1, 8),
        Option("local_degree", 1, "Total degree of the local polynomials; 0 is a weighted mean.",
               int, 0, 3),
        Option("neighbours", "nearest", "Control points around a point: the nearest, or the "
               "nearest in each of the four quadrants.", choices=("nearest", "quadrants")),
        Option("count", None, "Number of neighbours, in all or in each quadrant; by default 8 or "
                              "2.", int, 1, 1000),
        Option("weight", "inverse-square", "Weight by the distance, relative to that of the "
                                           "farthest neighbour; with inverse distance the model "
                                           "fits control points exactly.",
               choices=tuple(WEIGHTS)))

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the weight of each residual at each place (see `SensorModel.residual_weights`).

        The weights have the shape (places, control points). The correction at a place is the
        constant of its local polynomial, whose origin is the place.
        """
        offset = control[None, :, :2] - ground[:, None, :2]
        distance = np.linalg.norm(offset, axis=2)
        near = self._neighbours_of(offset, distance)
        reach = np.where(near, distance, 0.0).max(axis=1, keepdims=True)
        # Neighbours that are all at the place itself have no distance to divide by.
        reach[reach == 0.0] = 1.0
        weight = WEIGHTS[self.options["weight"]](distance / reach)
        root_of_weight = np.sqrt(np.where(near, weight, 0.0))
        columns = self._columns_around(offset / reach[..., None], near.sum(axis=1))
        # The first row of the pseudoinverse gives the constant of the local polynomial.
        return np.asarray(
            np.linalg.pinv(root_of_weight[..., None] * columns, rcond=1e-8)[:, 0] * root_of_weight)

    def _neighbours_of(self, offset: FloatArray, distance: FloatArray) -> BoolArray:
        """Return which control points are used at each of m places, shape (m, n).

        They are the nearest of all, or the nearest in each quadrant, by the option `neighbours`.
        `offset` (m, n, 2) and `distance` (m, n) are those of the control points from the places.
        """
        if self.options["neighbours"] == "nearest":
            return _are_nearest(distance, self.options["count"] or 8)
        # Four quadrants around each place, numbered by the signs of both offsets.
        quadrant = 2 * (offset[..., 0] < 0) + (offset[..., 1] < 0)
        count = self.options["count"] or 2
        return np.asarray(np.any([_are_nearest(np.where(quadrant == i, distance, np.inf), count)
                                  for i in range(4)], axis=0))

    def _columns_around(self, offset: FloatArray, count: NDArray[np.intp]) -> FloatArray:
        """Return the monomials of the local polynomials, shape (m, n, terms).

        `offset` (m, n, 2) are the positions of control points from the places, and `count` (m,) the
        number of neighbours of each. Monomials of a degree are 0 at places with fewer neighbours
        than a polynomial of this degree has terms.
        """
        x = offset[..., 0]
        y = offset[..., 1]
        columns = []
        for degree in range(self.options["local_degree"] + 1):
            # A polynomial of degree d has (d + 1) (d + 2) / 2 terms.
            has_enough = count >= (degree + 1) * (degree + 2) // 2
            columns += [has_enough[:, None] * x**(degree - j) * y**j for j in range(degree + 1)]
        return np.stack(columns, axis=-1)


def _are_nearest(distance: FloatArray, count: int) -> BoolArray:
    """Return which control points are among the `count` nearest to each place, shape (m, n).

    Points of infinite distance are none of them, so there may be fewer.
    """
    # The order is stable, so that every machine takes the same ones of points at one distance.
    near = np.zeros(distance.shape, dtype=bool)
    order = np.argsort(distance, axis=1, kind="stable")[:, :count]
    np.put_along_axis(near, order, True, axis=1)
    return near & np.isfinite(distance)
