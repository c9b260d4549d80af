"""2-D polynomials whose residuals are interpolated by multiquadrics."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from termsel import Option, Polynomial2D

FloatArray = NDArray[np.float64]

POWERS = next(option for option in Polynomial2D.declared_options if option.name == "powers")


class Multiquadric(Polynomial2D):
    """2-D polynomial with multiquadric interpolation of its control residuals.

    F are the distances between the control points in scaled X and Y, zero on its diagonal, and v
    the residuals of the polynomial in line or sample. F a = v is solved for a, and a point at the
    distances f from the control points is corrected by f a. The model thus fits control points
    exactly: their RMSE is 0 whatever its errors elsewhere.

    The paper takes planimetric distances. Here X and Y are scaled separately, so that the control
    extends over [-1, 1] along each. Distances are thus compressed along the longer side of a
    scene; longitude and latitude in degrees need no projection.

    References
    ----------
    Valadan Zoej et al. 2002, sections 2.1 and 2.3.
    """

    name = "multiquadric"
    declared_options = (
        Option("degree", 2, "Degree of the polynomial; a total degree of 2 gives 6 terms per "
                            "axis.", int, 1, 8),
        POWERS)

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray:
        """Return W = f inv(F) (see `SensorModel.residual_weights`).

        The weights have the shape (places, control points). If control points have the same X and
        Y, the mean of their residuals is interpolated. A single control point corrects nothing.
        """
        positions = np.ascontiguousarray(control[:, :2])
        return np.asarray(_plane_distances(ground, control)
                          @ _inverse_of_distances(positions.tobytes()))


class Hybrid3(Multiquadric):
    """Selected terms of a 2-D polynomial, with multiquadric interpolation of the residuals.

    The equations are those of `multiquadric`; a search selects from the terms of a higher degree,
    judged by the prediction with the interpolated residuals: W is the same for all selections,
    and the correction is linear in the residuals. (The paper selects by the polynomial alone and
    interpolates afterwards: `hybrid-2`, and then its terms under this model.)

    References
    ----------
    Valadan Zoej et al. 2002, section 3.3.
    """

    name = "hybrid-3"
    declared_options = (
        Option("degree", 4, "Degree of the available polynomial; a total degree of 4 gives 15 "
                            "terms per axis.", int, 1, 8),
        POWERS)


@lru_cache(maxsize=8)  # Each fit of a comparison asks for the same positions.
def _inverse_of_distances(positions: bytes) -> FloatArray:
    """Return the inverse (n, n) of the matrix of distances between control points.

    `positions` are the bytes of their X and Y, as a cache takes no arrays. It is a pseudoinverse:
    points at one place make the matrix singular.
    """
    control = np.frombuffer(positions).reshape(-1, 2)
    return np.asarray(
        np.linalg.pinv(_plane_distances(control, control), rcond=1e-12, hermitian=True))


def _plane_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distances in X and Y of all places `a` from all places `b`, shape (a, b)."""
    return np.asarray(np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=2))
