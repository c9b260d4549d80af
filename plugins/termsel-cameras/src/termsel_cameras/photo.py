"""A simulated aerial photo: a frame camera over hills, its film distorted and scanned.

A wide-angle camera looks almost straight down. Its lens distorts the image radially about a
principal point that is not the middle of the scan. All measurements are simulated; the sizes are
those of a photo of 23 cm that is scanned with 60 micrometres.
"""

from __future__ import annotations

import numpy as np

from termsel import DatasetSpec, FeatureSet, Points
from termsel_cameras.radial import FloatArray

ROLES = ("control", "check", "independent")

PHOTO_NAME = "aerial-photo"
PHOTO_CRS = "EPSG:32633"

SIZE = (3800, 3800)
"""Lines and samples of the scan [px]."""

PHOTO_FOCAL = 2500.0
"""Focal length of the camera [px]."""

HEIGHT = 3000.0
"""Height of the camera above the plane of heights 0 [m]."""

RELIEF = 60.0
"""How far the hills rise above and fall below their mean height [m]."""

CENTRE = (1990.0, 1800.0)
"""Principal point, centre of the distortion [px]."""

DISTORTION = (7.0e-9, -6.0e-16)
"""k1 [px^-2] and k2 [px^-4] of the correction of measured places (Brown 1971)."""

TURNS = (0.02, -0.015, 0.7)
"""Omega, phi and kappa of the camera [rad]."""

NOISE = 0.5

ORIGIN = (400000.0, 4000000.0)

DIGITS = 6
"""Decimals of measured places [px]."""

_PHOTO_POINTS, _PHOTO_SEED, _ADJUSTING_STEPS = 120, 1971, 50


def read_photo_points() -> FeatureSet:
    """Return the simulated measurements of the photo, with roles in thirds.

    Ground coordinates are easting and northing in UTM zone 33 and height [m].
    """
    rng = np.random.default_rng(_PHOTO_SEED)
    # Points are drawn beyond the image on all sides, so that its corners have some, too.
    reach = 0.62 * SIZE[0] / PHOTO_FOCAL * HEIGHT
    ground = rng.uniform(-reach, reach, (20 * _PHOTO_POINTS, 3))
    ground[:, 2] = RELIEF * (np.sin(ground[:, 0] / 700.0) + np.cos(ground[:, 1] / 900.0)) / 2
    image = project_into_scan(ground)
    inside = ((image > 40) & (image < np.array(SIZE) - 40)).all(axis=1)
    ground = ground[inside][:_PHOTO_POINTS]
    image = image[inside][:_PHOTO_POINTS]
    # Processors differ in the last bits, which rounding removes.
    image = (image + NOISE * rng.standard_normal(image.shape)).round(DIGITS)
    roles = tuple(ROLES[i % 3] for i in range(len(image)))
    points = Points(tuple(f"A{i + 1:03d}" for i in range(len(image))), image,
                    ground + np.array([*ORIGIN, 0.0]), None, roles)
    return FeatureSet(points, crs=PHOTO_CRS, image_size=SIZE, noise=NOISE)


def project_into_scan(ground: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) [px] of ground points in the scan, without noise.

    `ground` (n, 3) [m] counts from the point on the plane of heights 0 below the camera.
    """
    sin_omega, sin_phi, sin_kappa = np.sin(TURNS)
    cos_omega, cos_phi, cos_kappa = np.cos(TURNS)
    # R = R_x(omega) R_y(phi) R_z(kappa).
    rotation = (np.array([[1, 0, 0], [0, cos_omega, -sin_omega], [0, sin_omega, cos_omega]])
              @ np.array([[cos_phi, 0, sin_phi], [0, 1, 0], [-sin_phi, 0, cos_phi]])
              @ np.array([[cos_kappa, -sin_kappa, 0], [sin_kappa, cos_kappa, 0], [0, 0, 1]]))
    x, y, z = ((ground - [0.0, 0.0, HEIGHT]) @ rotation).T
    # The camera looks along -z, and lines count downwards: (line, sample) = f (y, -x) / z.
    ideal = PHOTO_FOCAL * np.column_stack([y / z, -x / z])
    distorted = ideal.copy()
    # Brown's corrections are of measured positions m: m + m (k1 r^2 + k2 r^4) = ideal, with r of
    # m, is solved by a fixed-point iteration.
    k1, k2 = DISTORTION
    for _ in range(_ADJUSTING_STEPS):
        squared = (distorted**2).sum(axis=1, keepdims=True)
        distorted = ideal / (1.0 + k1 * squared + k2 * squared**2)
    return distorted + CENTRE


PHOTO = DatasetSpec(
    PHOTO_NAME, "simulated aerial photo of hills, 1.2 m: 120 points, with radial distortion",
    read_photo_points,
    simulated=True)
"""The embedded photo."""
