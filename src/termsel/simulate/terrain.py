"""Smooth analytic terrain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from termsel.data.coordinates.wgs84 import SEMI_MAJOR
from termsel.data.features import FloatArray

_WAVES = 16


@dataclass(frozen=True)
class Terrain:
    """Smooth heights: a sloping plane, broad hills, and waves of local relief.

    Parameters
    ----------
    lon, lat : float
        Origin of the plane coordinates u (east) and v (north) [deg].
    scale : tuple of float
        Degrees of longitude and latitude per unit of u and v.
    base, gain : float
        Height [m] = base + gain * (plane + hills) + relief.
    slope : tuple of float
        Rise of the plane per unit of u and v.
    hills : tuple of (float, float, float, float)
        Rise, u, v and radius of each Gaussian hill.
    relief : tuple of (float, float, float, float)
        Amplitude [m], wave numbers along u and v [rad] and phase [rad] of each wave.
    """

    lon: float
    lat: float
    scale: tuple[float, float]
    base: float
    gain: float
    slope: tuple[float, float]
    hills: tuple[tuple[float, float, float, float], ...]
    relief: tuple[tuple[float, float, float, float], ...]

    def __call__(self, position: FloatArray) -> FloatArray:
        """Return ellipsoidal heights [m], shape (n,), of lon, lat [deg], shape (n, 2)."""
        broad, local = self.parts(position)
        return self.base + self.gain * broad + local

    def parts(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the regional form without gain, and the local relief [m], each (n,)."""
        u = (position[:, 0] - self.lon) / self.scale[0]
        v = (position[:, 1] - self.lat) / self.scale[1]
        broad = self.slope[0] * u + self.slope[1] * v
        for rise, east, north, radius in self.hills:
            broad += rise * np.exp(-((u - east) ** 2 + (v - north) ** 2) / (2 * radius**2))
        local = np.zeros_like(u)
        for amplitude, k_east, k_north, phase in self.relief:
            local += amplitude * np.sin(k_east * u + k_north * v + phase)
        return broad, local

    def between(self, position: FloatArray, low: float, high: float) -> tuple[Terrain, int, int]:
        """Return the terrain whose heights at some places go from `low` to `high`.

        The relief keeps its size; the gain of the regional form is adapted.

        Parameters
        ----------
        position : ndarray, shape (n, 2)
            Longitude and latitude of the places [deg].
        low, high : float
            Ellipsoidal heights [m].

        Returns
        -------
        terrain : Terrain
        lowest, highest : int
            Indices of the lowest and the highest place.
        """
        broad, local = self.parts(position)
        gain = 0.0
        # The range of heights is nearly linear in the gain: Newton's method, with the slope of the
        # regional form alone.
        for _ in range(30):
            gain += (high - low - float(np.ptp(gain * broad + local))) / float(np.ptp(broad))
        form = gain * broad + local
        terrain = replace(self, gain=gain, base=low - float(form.min()))
        return terrain, int(form.argmin()), int(form.argmax())


def hilly_terrain(seed: int, lon: float, lat: float, extent: tuple[float, float], relief: float,
                  ) -> Terrain:
    """Return terrain with regional hills of unit size, to be scaled by `Terrain.between`.

    The seed draws the direction of slope and hills, and the waves. `extent` are the widths to the
    east and to the north [m] about the centre `lon`, `lat` [deg]. `relief` is the root mean square
    of the local relief [m], whose waves are a sixth to a third of the extent long, so that no
    polynomial of low degree fits it.
    """
    rng = np.random.default_rng(seed)
    scale = (float(np.degrees(extent[0] / 2 / (SEMI_MAJOR * np.cos(np.radians(lat))))),
             float(np.degrees(extent[1] / 2 / SEMI_MAJOR)))
    # Wavelengths of 0.35 to 0.7 of half the extent, directions spread evenly but for chance.
    wave_number = 2 * np.pi / rng.uniform(0.35, 0.7, _WAVES)
    direction = np.pi * (np.arange(_WAVES) + rng.random(_WAVES)) / _WAVES
    phase = rng.uniform(0, 2 * np.pi, _WAVES)
    turn = float(rng.uniform(0, 2 * np.pi))
    waves = np.column_stack([np.full(_WAVES, relief * np.sqrt(2 / _WAVES)),
                             wave_number * np.cos(direction), wave_number * np.sin(direction),
                             phase])
    # A high, a basin opposite and a lower rise between, all nearly as wide as the scene.
    hills = [(rise, 0.55 * np.cos(turn + off), 0.55 * np.sin(turn + off), radius)
             for rise, off, radius in ((1.0, 0.0, 0.9), (-0.8, 2.6, 0.8), (0.3, 4.4, 0.8))]
    return Terrain(lon, lat, scale, base=0.0, gain=1.0,
                   slope=(0.1 * float(np.cos(turn)), 0.1 * float(np.sin(turn))),
                   hills=_as_rows(hills), relief=_as_rows(waves))


def _as_rows(values: ArrayLike) -> tuple[tuple[float, float, float, float], ...]:
    """Return rows (n, 4) as tuples of floats, which can be compared and hashed."""
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in np.asarray(values))
