"""The pointwise transformation: a separate polynomial for every point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from termsel import Option, Polynomial2D

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Of the reach: keeps the weight at a control point finite.
_AT_ONCE = 1e-4

WEIGHTS = {
    "uniform": lambda u: np.ones_like(u),
    "inverse-distance": lambda u: 1 / (u + _AT_ONCE),
    "inverse-square": lambda u: 1 / (u + _AT_ONCE)**2,
    "gaussian": lambda u: np.exp(-4 * u**2),
}
"""Weights of control points by their distance, relative to that of the farthest neighbour."""


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
        """Return the weight of each residual in the local constant (see `SensorModel`)."""
        # From each place to each control point, in X and Y.
        offset = control[None, :, :2] - ground[:, None, :2]
        distance = np.linalg.norm(offset, axis=2)
        near = self._neighbours_of(offset, distance)
        reach = np.where(near, distance, 0.0).max(axis=1, keepdims=True)
        reach[reach == 0.0] = 1.0
        root = np.sqrt(np.where(near, WEIGHTS[self.options["weight"]](distance / reach), 0.0))
        columns = self._columns_around(offset / reach[..., None], near.sum(axis=1))
        # The first row of the pseudoinverse gives the constant of the local polynomial, at its
        # middle.
        return np.asarray(
            np.linalg.pinv(root[..., None] * columns, rcond=1e-8)[:, 0] * root)

    def _neighbours_of(self, offset: FloatArray, distance: FloatArray) -> BoolArray:
        """Return which control points are used at each place, shape (m, n).

        The nearest, or by quadrant.
        """
        if self.options["neighbours"] == "nearest":
            return _are_nearest(distance, self.options["count"] or 8)
        # Four quadrants around each place, numbered by the signs of both offsets.
        quadrant = 2 * (offset[..., 0] < 0) + (offset[..., 1] < 0)
        count = self.options["count"] or 2
        return np.asarray(np.any([_are_nearest(np.where(quadrant == i, distance, np.inf), count)
                                  for i in range(4)], axis=0))

    def _columns_around(self, offset: FloatArray, count: NDArray[np.intp]) -> FloatArray:
        """Return the local monomials, 0 where a place has too few neighbours, (m, n, terms)."""
        x = offset[..., 0]
        y = offset[..., 1]
        columns = []
        for degree in range(self.options["local_degree"] + 1):
            # A polynomial of a degree has (d + 1) (d + 2) / 2 terms.
            has_enough = count >= (degree + 1) * (degree + 2) // 2
            columns += [has_enough[:, None] * x**(degree - j) * y**j for j in range(degree + 1)]
        return np.stack(columns, axis=-1)


def _are_nearest(distance: FloatArray, count: int) -> BoolArray:
    """Return which control points are the `count` nearest of finite distance, shape (m, n)."""
    # Stable, so that of points at one distance the first ones are taken, on every machine.
    near = np.zeros(distance.shape, dtype=bool)
    order = np.argsort(distance, axis=1, kind="stable")[:, :count]
    np.put_along_axis(near, order, True, axis=1)
    return near & np.isfinite(distance)
