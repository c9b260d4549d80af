"""Distortion of a lens with known constants, as calibrations state it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_MAX_FIXED_POINT_STEPS, _CONVERGED = 50, 1e-12
_TESTED_SHARES = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Lens:
    """Radial and decentring distortion (Brown 1971), in the form of OpenCV and OpenDroneMap.

    With x to the right and y downwards from the principal point, both by the focal length, and
    r^2 = x^2 + y^2, a place is seen at

        x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def is_ideal(self) -> bool:
        """Whether there is no distortion."""
        return not any((self.k1, self.k2, self.p1, self.p2, self.k3))

    def distorted(self, ideal: FloatArray) -> FloatArray:
        """Return the image positions (..., 2) to which the lens moves ideal ones.

        Both are x and y divided by the focal length. NaN where the lens was found to fold back
        (see `_radius_grows`).
        """
        x = ideal[..., 0]
        y = ideal[..., 1]
        # The equations of the class.
        r2 = x**2 + y**2
        radial_factor = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        distorted_x = x * radial_factor + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x**2)
        distorted_y = y * radial_factor + self.p1 * (r2 + 2 * y**2) + 2 * self.p2 * x * y
        return np.where(self._radius_grows(r2)[..., None],
                        np.stack([distorted_x, distorted_y], axis=-1),
                        np.nan)

    def _radius_grows(self, r2: FloatArray) -> BoolArray:
        """Return whether the distorted radius grows with the ideal one up to squared radii `r2`.

        It is tested at the squares r2 / 4, r2 / 2, 3 r2 / 4 and r2. What comes back has the shape
        of `r2`. Beyond a radius where the distorted one shrinks, two ideal positions have one
        image.
        """
        grows = np.ones(r2.shape, dtype=bool)
        with np.errstate(all="ignore"):
            for share_of_r2 in _TESTED_SHARES:
                s2 = share_of_r2 * r2
                # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6).
                grows &= 1.0 + s2 * (3 * self.k1 + s2 * (5 * self.k2 + s2 * 7 * self.k3)) > 0.0
        return grows

    def ideal(self, measured: FloatArray) -> FloatArray:
        """Return the ideal positions (..., 2) of measured ones, the inverse of `distorted`.

        Both are x and y (..., 2) divided by the focal length. NaN where the iteration does not come
        within 1e-6 of the measured position, as beyond the radius where the lens folds back.
        """
        if self.is_ideal:
            return measured
        ideal = np.array(measured, dtype=np.float64)
        with np.errstate(all="ignore"):
            for _ in range(_MAX_FIXED_POINT_STEPS):
                # A fixed-point iteration for distorted(ideal) = measured. It converges since the
                # distortion changes little with the position.
                residual = measured - self.distorted(ideal)
                ideal = ideal + residual
                if not (np.abs(residual) > _CONVERGED).any():
                    break
        return np.where(np.abs(residual) < 1e-6, ideal, np.nan)
