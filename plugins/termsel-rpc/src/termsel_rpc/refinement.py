"""Base of refinements: a known geometry, and terms that correct it."""

from __future__ import annotations

from abc import abstractmethod
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from termsel import Equations, FeatureSet, Scaling, SensorModel, TermselError, image_equations

FloatArray = NDArray[np.float64]

_MAX_CACHED = 8


class Refinement(SensorModel):
    """A known geometry with terms that correct it, at least to first order.

    The terms are 0 if the geometry is correct.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._known: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    @property
    @abstractmethod
    def source(self) -> str:
        """Kind and source of the geometry, in words."""

    @abstractmethod
    def footprint(self) -> FloatArray:
        """Return least and greatest longitude and latitude [deg] seen, shape (2, 2)."""

    @abstractmethod
    def first_order(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return image positions and the effect of each term with the coefficient 1.

        Parameters
        ----------
        ground : ndarray, shape (n, 3)
            Scaled.

        Returns
        -------
        image : ndarray, shape (n, 2)
            Scaled.
        columns : ndarray, shape (n, 2, k)
        """

    def prepared(self, scaling: Scaling, crs: str) -> Self:
        """Return the model prepared for features with this scaling and CRS.

        Raises
        ------
        TermselError
            If they are far from the area of the image, or if their coordinates cannot be
            transformed to WGS84.
        """
        ready = super().prepared(scaling, crs)
        if ready is not self:
            # The copy has the cache of this model, whose scaling differs.
            ready._known = {}
            ready._require_control_in_area()
        return ready

    def _require_control_in_area(self) -> None:
        """Raise TermselError if the control is beyond half the area of the image on a side of it.

        If it would be within that with x and y exchanged, the error says so.
        """
        corners = np.array(list(product((-1.0, 1.0), repeat=3)))
        geographic = self.geographic(corners)[:, :2]
        low, high = self.footprint()
        # Longitudes are brought to within half a turn of the image.
        geographic[:, 0] += 360 * np.round(((low + high)[0] / 2 - geographic[:, 0].mean()) / 360)
        # Control may be beyond the image, but not in another country.
        margin = (high - low) / 2
        lowest = geographic.min(axis=0)
        greatest = geographic.max(axis=0)
        if not _is_far(lowest, greatest, low, high, margin):
            return
        if not _is_far(lowest[::-1], greatest[::-1], low, high, margin):
            raise TermselError(
                f"x and y are swapped: exchanged, the control lies in the area of {self.source}, "
                "as it stands it does not",
                hint="Exchange them: --set swapped=xy.")
        image = _middle_in_words(low, high)
        control = _middle_in_words(lowest, greatest)
        if image != control:
            reason = f"is of another place ({image}) than the control ({control})"
        else:
            reason = (f"covers {_ranges_in_words(low, high)}, but the control is in "
                      f"{_ranges_in_words(lowest, greatest)}")
        raise TermselError(f"{self.source} {reason}",
                           hint="Give the geometry of this image, or leave it out; x must be "
                                "longitude or easting.")

    def known(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `first_order` of scaled ground positions (n, 3), from a cache if it has them."""
        # A search asks for the same few arrays again and again, which are not the same objects.
        key = ground.tobytes()
        if key not in self._known:
            if len(self._known) >= _MAX_CACHED:
                self._known.clear()
            self._known[key] = self.first_order(ground)
        return self._known[key]

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and lines, linear about the known geometry."""
        image, columns = self.known(features.points.ground)
        vertex_image, vertex_columns = self.known(features.lines.ground.reshape(-1, 3))
        return image_equations(features, columns, vertex_columns, image, vertex_image)


def _is_far(lowest: FloatArray, greatest: FloatArray, low: FloatArray, high: FloatArray,
            margin: FloatArray) -> bool:
    """Return whether control from `lowest` to `greatest` is outside `low` to `high` and a margin.

    All are longitude and latitude, (2,) [deg].
    """
    return bool(((greatest < low - margin) | (lowest > high + margin)).any())


def _middle_in_words(low: FloatArray, high: FloatArray) -> str:
    """Return the middle between two corners [deg] in words, such as "34.8 N, 48.5 E"."""
    lon, lat = ((low + high) / 2).tolist()
    return f"{abs(lat):.1f} {'N' if lat >= 0 else 'S'}, {abs(lon):.1f} {'E' if lon >= 0 else 'W'}"


def _ranges_in_words(low: FloatArray, high: FloatArray) -> str:
    """Return the ranges of longitude and latitude between two corners [deg] in words."""
    return (f"longitude {low[0]:.4g} to {high[0]:.4g} and latitude {low[1]:.4g} to "
            f"{high[1]:.4g}")
