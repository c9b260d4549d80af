"""Points as the key of what is kept of them: equal measurements are one, whatever their names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.data.features import FloatArray, Points, no_points
from termsel.data.tables.tabular import unchecked


@dataclass(frozen=True)
class Measurements:
    """Image and ground coordinates of points and their standard deviations, as bytes."""

    image: bytes
    ground: bytes
    sigma: bytes | None

    @classmethod
    def of(cls, points: Points) -> Measurements:
        """Return what was measured of points."""
        return cls(points.image.tobytes(), points.ground.tobytes(),
                   None if points.sigma is None else points.sigma.tobytes())

    @property
    def points(self) -> Points:
        """The points, numbered and without roles; they were checked when they were made first."""
        image = _rows(self.image, 2)
        return unchecked(no_points(), ids=tuple(map(str, range(len(image)))), image=image,
                         ground=_rows(self.ground, 3), roles=("",) * len(image),
                         sigma=None if self.sigma is None else _rows(self.sigma, 2))


def _rows(numbers: bytes, columns: int) -> FloatArray:
    return np.frombuffer(numbers).reshape(-1, columns)
