"""The multiquadric: a plane polynomial whose residuals are interpolated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from termsel import Blocks, Option, RationalModel

FloatArray = NDArray[np.float64]


class Multiquadric(RationalModel):
    """Plane polynomial with multiquadric interpolation of its control residuals.

    With F the planimetric distances between the control points, zero on its diagonal, and v
    the residuals the polynomial leaves in line or sample, F a = v is solved for a, and a point
    at the distances f from the control points is corrected by f a. Control points are thus
    met exactly, so that their RMSE is 0 whatever the model is worth elsewhere.

    Distances are taken in termsel's scaled ground coordinates, where the control extends over
    [-1, 1] along X and along Y; degrees of longitude and latitude need no care, but in a
    narrow strip the distances are not those on the ground.

    References
    ----------
    Valadan Zoej et al. 2002, sections 2.1 and 2.3.
    """

    name = "multiquadric"
    uses_height = False
    declared_options = (
        Option("degree", 2, "Total degree of the polynomial; 2 gives 6 terms an axis.", int, 1, 8),)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        """Powers of X and Y of each column, in the order of termsel's poly2d."""
        return [(total - j, j) for total in range(self.options["degree"] + 1)
                for j in range(total + 1)]

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials of X and Y at ground points of shape (n, 3)."""
        x, y = ground[:, 0], ground[:, 1]
        columns = np.stack([x**i * y**j for i, j in self._powers], axis=1)
        return Blocks(line=columns, sample=columns)

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names: 1, X, Y, X2, XY, Y2 ..."""
        return tuple("".join(f"{letter}{power if power > 1 else ''}"
                             for letter, power in (("X", i), ("Y", j)) if power) or "1"
                     for i, j in self._powers)

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the weights of the control residuals, W = f inv(F).

        Parameters
        ----------
        control : ndarray, shape (n, 3)
            Scaled ground positions of the control points.
        ground : ndarray, shape (m, 3)
            Scaled ground positions to be corrected.

        Returns
        -------
        ndarray, shape (m, n)
            Where control points share their X and Y, the mean of their residuals is
            interpolated; a single control point corrects nothing.
        """
        # F has full rank for points apart from one another; only shared places lower it.
        inverse = np.linalg.pinv(_distances(control, control), rcond=1e-12, hermitian=True)
        return np.asarray(_distances(ground, control) @ inverse)


def _distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return planimetric distances, shape (len(a), len(b))."""
    return np.asarray(np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=2))
