"""The plane similarity: shift, turn and one scale, with parameters that both image axes share."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.lines import image_equations
from termsel.core.options import Option
from termsel.data.coordinates.crs import is_geographic
from termsel.data.features import FeatureSet, FloatArray, IntArray
from termsel.models.base import BOTH, LINE, SAMPLE, SensorModel


class Helmert2D(SensorModel):
    """Plane similarity (Helmert transformation): a shift, a turn and one scale; 4 terms.

    With X and Y in one unit on the ground,

        sample = s + cos X - sin Y
        line   = l - sin X - cos Y.

    Lines count downwards and Y upwards, so that for turns of any angle this is the image of a map
    seen from above, not its mirror image: cos is the scale times the cosine of the angle by which
    the map is turned counter-clockwise. An image that is mirrored, or whose Y counts downwards as
    the lines do, takes `mirrored`. Two points determine the model, and do not tell whether the
    image is mirrored.

    Longitude and latitude are brought to one unit at the middle of the control: X is multiplied
    by the cosine of the latitude. Over more than a few degrees, fit in a projected CRS.

    References
    ----------
    Helmert 1880, Die mathematischen und physikalischen Theorieen der höheren Geodäsie I.

    Examples
    --------
    >>> import termsel
    >>> len(termsel.Helmert2D().terms)
    4
    """

    name = "helmert2d"
    uses_height = False
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("mirrored", False, "Whether the image is the mirror image of the ground seen from "
                                  "above, or Y counts downwards.", bool),)

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return "line.num:1", "sample.num:1", "cos", "sin"

    @property
    def axis(self) -> IntArray:
        """Image axis of each term: the scale and the turn act on both."""
        return np.array([LINE, SAMPLE, BOTH, BOTH], dtype=np.intp)

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and of lines, which are exact."""
        return image_equations(features, self._rows(features.points.ground),
                               self._rows(features.lines.ground.reshape(-1, 3)), heights=False)

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points (see `SensorModel.project`)."""
        return np.asarray(np.einsum("nak,...k->...na", self._rows(ground), coefficients))

    def _rows(self, ground: FloatArray) -> FloatArray:
        """Return the rows of line and sample over all terms, shape (n, 2, 4)."""
        x, y = (ground[:, :2] * plane_units(self)).T
        # Where Y already counts downwards its sign is that of the lines.
        y = -y if self.options["mirrored"] else y
        # Columns: shift of lines, shift of samples, cos, sin, as in the equations above.
        ones = np.ones_like(x)
        zeros = np.zeros_like(x)
        return np.stack([np.stack([ones, zeros, -y, -x], axis=1),
                         np.stack([zeros, ones, x, -y], axis=1)], axis=1)


def plane_units(model: SensorModel) -> tuple[float, float]:
    """Return by what scaled X and Y are to be multiplied to have one unit; the larger is 1.

    Longitudes are brought to the unit of latitudes in the middle of the control. Both are 1 for a
    model that is not prepared.
    """
    if model.scaling is None:
        return 1.0, 1.0
    x, y = model.scaling.ground_scale[:2]
    crs = model.scaling.fit_crs or model.crs
    if crs and is_geographic(crs):
        # A degree of longitude is cos(latitude) times as long as one of latitude.
        x *= np.cos(np.radians(model.scaling.ground_offset[1]))
    return float(x / max(x, y)), float(y / max(x, y))
