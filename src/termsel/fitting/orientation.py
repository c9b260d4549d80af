"""Where a camera was and how it looked: the exterior orientation as photogrammetry states it.

The angles are omega, phi and kappa of the rotation M = R3(kappa) R2(phi) R1(omega) from the axes of
the ground (x, y and upwards at the middle of the control) to those of the image: x along samples,
y against lines, z against the view (Kraus 2007, Photogrammetry).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from termsel.data.coordinates.crs import is_geographic, metres_per_unit
from termsel.data.coordinates.height_units import METRE, unit_of_size
from termsel.data.coordinates.metres import height_unit
from termsel.data.features import FloatArray
from termsel.data.record.figures import SensorFigure
from termsel.data.scaling import Scaling

_ORIENTATION_STEPS, _STEP = 20, 1e-4
"""Steps to the projection centre in ground coordinates, and that of a derivative, scaled."""


def exterior_orientation(rotation: FloatArray, centre: FloatArray,
                         local: Callable[[FloatArray], FloatArray], scaling: Scaling,
                         crs: str) -> tuple[SensorFigure, ...]:
    """Return the projection centre in the CRS of the control, and omega, phi and kappa.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Directions of lines, samples and the view as rows, in local axes.
    centre : ndarray, shape (3,)
        The projection centre, local.
    local : callable
        Takes scaled ground coordinates (n, 3), returns local ones: a plane frame that is nearly a
        linear function of them.
    scaling : Scaling
    crs : str
        In which the projection centre is stated, in its units.
    """
    jacobian = _local_jacobian(local)
    ground = np.zeros(3)
    # Newton steps: local coordinates bend with the Earth, by little over one image.
    for _ in range(_ORIENTATION_STEPS):
        ground = ground + np.linalg.solve(jacobian, centre - local(ground[None])[0])
    x, y, z = scaling.unscaled(ground[None])[0].tolist()
    up = jacobian[:, 2] / np.linalg.norm(jacobian[:, 2])
    along_y = np.cross(up, jacobian[:, 0])
    along_y /= np.linalg.norm(along_y)
    axes = np.stack([np.cross(along_y, up), along_y, up])
    line, sample, view = rotation @ axes.T
    # Lines, samples and the view are left-handed; on the scan of a negative, which is a mirror
    # image, samples run the other way.
    sample = sample if np.linalg.det(rotation) < 0.0 else -sample
    omega, phi, kappa = angles_of(np.stack([sample, -line, -view])).tolist()
    if crs and is_geographic(crs):
        unit = "deg"
    elif crs:
        unit = _unit_of(metres_per_unit(crs))
    else:
        unit = _unit_of(None)
    return (SensorFigure("projection centre x", x, unit),
            SensorFigure("projection centre y", y, unit),
            SensorFigure("projection centre z", z, _unit_of(height_unit(crs))),
            SensorFigure("omega", omega, "deg"),
            SensorFigure("phi", phi, "deg"), SensorFigure("kappa", kappa, "deg"))


def _unit_of(metres: float | None) -> str:
    """Return the name of a unit of a length [m]; metres where nobody knows it."""
    if metres is None:
        return "m"
    unit = unit_of_size(metres)
    if unit is None:  # old chains and links have no name here
        return f"{metres:g} m"
    return "m" if unit == METRE else unit


def camera_figures(orientation: tuple[SensorFigure, ...], focal: float,
                   principal: FloatArray) -> tuple[SensorFigure, ...]:
    """Return an exterior orientation, then focal length and principal point.

    Parameters
    ----------
    orientation : tuple of SensorFigure
        Of `exterior_orientation`.
    focal : float
        Focal length [px].
    principal : ndarray, shape (2,)
        Line and sample of the principal point [px].
    """
    line, sample = principal.tolist()
    return (*orientation, SensorFigure("focal length", focal, "px"),
            SensorFigure("principal point, line", line, "px"),
            SensorFigure("principal point, sample", sample, "px"))


def angles_of(matrix: FloatArray) -> FloatArray:
    """Return omega, phi and kappa [deg] of a rotation from ground axes to image axes, (3, 3)."""
    # m31 = sin(phi), m32 = -sin(omega) cos(phi), m33 = cos(omega) cos(phi),
    # m11 = cos(phi) cos(kappa), m21 = -cos(phi) sin(kappa).
    phi = np.arcsin(np.clip(matrix[2, 0], -1.0, 1.0))
    omega = np.arctan2(-matrix[2, 1], matrix[2, 2])
    kappa = np.arctan2(-matrix[1, 0], matrix[0, 0])
    return np.asarray(np.degrees(np.array([omega, phi, kappa])))


def _local_jacobian(local: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the derivatives (3, 3) of local coordinates at the middle by the scaled ones."""
    steps = _STEP * np.eye(3)
    return np.asarray((local(steps) - local(-steps)).T / (2.0 * _STEP))
