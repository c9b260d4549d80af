"""Distortion of a lens with known constants, as calibrations state it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_DISTORTION_STEPS, _CLOSE = 50, 1e-12
_SHARES = (0.25, 0.5, 0.75, 1.0)


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
        """Return where ideal places (..., 2), x and y, are seen; NaN where the lens folds back."""
        x = ideal[..., 0]
        y = ideal[..., 1]
        # Brown (1971), as OpenCV has it: r^2 = x^2 + y^2, x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2
        # p1 x y + p2 (r^2 + 2 x^2), and y' with x and y exchanged.
        r2 = x**2 + y**2
        radial_factor = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        distorted_x = x * radial_factor + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x**2)
        distorted_y = y * radial_factor + self.p1 * (r2 + 2 * y**2) + 2 * self.p2 * x * y
        return np.where(self._radius_grows(r2)[..., None],
                        np.stack([distorted_x, distorted_y], axis=-1),
                        np.nan)

    def _radius_grows(self, r2: FloatArray) -> BoolArray:
        """Return whether the distorted radius grows with the ideal one up to these squares r2."""
        holds = np.ones(r2.shape, dtype=bool)
        with np.errstate(all="ignore"):
            for share in _SHARES:
                s2 = share * r2
                # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6).
                holds &= 1.0 + s2 * (3 * self.k1 + s2 * (5 * self.k2 + s2 * 7 * self.k3)) > 0.0
        return holds

    def ideal(self, measured: FloatArray) -> FloatArray:
        """Return the ideal places (..., 2), x and y, of places that are seen.

        NaN where the lens has none.
        """
        if self.is_ideal:
            return measured
        ideal = np.array(measured, dtype=np.float64)
        with np.errstate(all="ignore"):
            for _ in range(_DISTORTION_STEPS):
                # m(ideal) = seen: what is left is taken off, as the distortion is small.
                residual = measured - self.distorted(ideal)
                ideal = ideal + residual
                if not (np.abs(residual) > _CLOSE).any():
                    break
        return np.where(np.abs(residual) < 1e-6, ideal, np.nan)
