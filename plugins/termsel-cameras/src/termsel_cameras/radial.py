"""Polynomials of the ground with the radial distortion of a lens."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel import (
    Equations,
    FeatureSet,
    Option,
    Polynomial2D,
    Polynomial3D,
    SensorModel,
    Term,
    TermselError,
    image_equations,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

RADIAL_POWERS = (2, 4, 6)
"""Powers of the distance from the centre of distortion that are terms."""

_MAX_NEWTON_STEPS, _CONVERGED = 30, 1e-12
_TESTED_SHARES = (0.25, 0.5, 0.75, 0.9, 1.0)

_CENTRE = ("Centre of distortion, {} coordinate: in half extents of the control in the image from "
           "its middle.")


class Radial(SensorModel):
    """A polynomial of the ground whose image a lens distorts radially about a centre.

    With m the measured place, c the centre and r = |m - c|,

        m + (m - c) (k1 r^2 + k2 r^4 + k3 r^6) = P(X, Y, Z)

    The corrections k act on measured places, as in the calibration of cameras (Brown 1971: Close-
    range camera calibration, Photogrammetric Engineering 37(8)). The equations are therefore
    linear in the polynomials and in k, terms ``radial:2``, ``radial:4`` and ``radial:6``; the
    centre is no term but an option. That each polynomial has its own terms is termsel's choice: it
    takes the place of the collinearity equations, whose rotations and heights it approximates.
    """

    polynomial: ClassVar[type[Polynomial2D | Polynomial3D]]
    """What the image would be without distortion."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._plain = self.polynomial(degree=self.options["degree"])
        self._centre = np.array([self.options["centre_line"], self.options["centre_sample"]])

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms: monomials of line and sample, then the radial ones."""
        radial = (str(Term("both", "radial", str(power))) for power in RADIAL_POWERS)
        return (*self._plain.terms, *radial)

    @property
    def axis(self) -> IntArray:
        """Image axis of each term: the distortion acts on both."""
        on_both = np.full(len(RADIAL_POWERS), 2, dtype=np.intp)
        return np.concatenate([self._plain.axis, on_both])

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of scaled points, which are linear in the terms.

        Raises TermselError for lines, as distortion bends them.
        """
        if len(features.lines):
            raise TermselError(f"model {self.name!r} takes no lines: distortion bends them",
                               hint="Give points alone, or choose another model.")
        points = features.points
        offsets = points.image - self._centre
        squared = (offsets**2).sum(axis=1)[:, None, None]
        # The unknown k are on the side of the polynomials: P - (m - c) (k1 r^2 + ...) = m.
        radial = -offsets[:, :, None] * squared ** (np.array(RADIAL_POWERS) // 2)
        columns = self._plain.blocks(points.ground).line
        undistorted = np.einsum("ab,ne->nabe", np.eye(2), columns).reshape(len(columns), 2, -1)
        rows = np.concatenate([undistorted, radial], axis=2)
        return image_equations(features, rows, np.zeros((0, 2, rows.shape[2])),
                               heights=self.uses_height)

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions (..., n, 2) of scaled ground points `ground` (n, 3).

        `coefficients` (..., k) are those of the terms. The positions are those which the radial
        corrections move to the undistorted ones of the polynomials; NaN where there is none, or
        where the distortion is found to fold the image over.
        """
        n = len(self._plain.terms)
        ideal = self._plain.project(coefficients[..., :n], ground)
        offsets = ideal - self._centre
        squared = (offsets**2).sum(axis=-1)
        # With m - c = s (P - c), Newton's method solves s (1 + k1 (s r)^2 + ...) = 1 for s.
        k = [coefficients[..., n + i, None] * squared ** (power // 2)
             for i, power in enumerate(RADIAL_POWERS)]
        s = np.ones(squared.shape)
        # Far from the control the powers may overflow, or the equation may have no solution.
        with np.errstate(all="ignore"):
            pairs = tuple(zip(k, RADIAL_POWERS, strict=True))
            for _ in range(_MAX_NEWTON_STEPS):
                value = s - 1.0 + sum(kp * s ** (p + 1) for kp, p in pairs)
                slope = 1.0 + sum((p + 1) * kp * s**p for kp, p in pairs)
                step = value / slope
                s = s - step
                if not (np.abs(step) > _CONVERGED).any():
                    break
            # A solution s <= 0 is on the other side of the centre.
            is_imaged = (np.abs(step) <= 1e-9) & (s > 0)
            # The solution is the only one if the corrected radius grows up to it, which is tested
            # at some shares of it.
            for share in _TESTED_SHARES:
                is_imaged &= 1.0 + sum((p + 1) * kp * (share * s) ** p
                                       for kp, p in zip(k, RADIAL_POWERS, strict=True)) > 0
        return np.asarray(self._centre + np.where(is_imaged, s, np.nan)[..., None] * offsets)


def _radial_options(degree: int, largest: int) -> tuple[Option, ...]:
    """Return the options of a model: its degree, `degree` by default and at most `largest`, and
    the centre of distortion.
    """
    return (Option("degree", degree, "Total degree of the polynomials.", int, 1, largest),
            Option("centre_line", 0.0, _CENTRE.format("line"), float, -1.0, 1.0),
            Option("centre_sample", 0.0, _CENTRE.format("sample"), float, -1.0, 1.0))


class Radial2D(Radial):
    """2-D polynomial with radial distortion: a scanned photo of flat ground, or of a map.

    See `radial3d`.
    """

    name = "radial2d"
    uses_height = False
    polynomial = Polynomial2D
    declared_options = _radial_options(2, 8)


class Radial3D(Radial):
    """3-D polynomial with radial distortion: a frame camera over terrain.

    With m the measured place, c the centre of distortion and r = abs(m - c), m + (m - c) (k1 r^2 +
    k2 r^4 + k3 r^6) is a polynomial of X, Y and Z (Brown 1971, for the distortion). The radial
    terms are called radial:2, radial:4 and radial:6.
    """

    name = "radial3d"
    polynomial = Polynomial3D
    declared_options = _radial_options(2, 5)
