"""Polynomial models: line and sample as sums of monomials."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from termsel.adjustment.equations import Equations, image_equations
from termsel.core.options import Option
from termsel.data.coordinates.crs import is_geographic
from termsel.data.features import FeatureSet, FloatArray, IntArray
from termsel.data.monomials import Exponents, double_sum_exponents, graded_exponents
from termsel.models.base import BOTH, LINE, SAMPLE, SensorModel
from termsel.models.quotient import MonomialModel


class Polynomial(MonomialModel):
    """A polynomial with all monomials up to a degree, the same for both axes."""

    variables: ClassVar[int] = 3
    """Ground coordinates that it is a polynomial of: X, Y and, if 3, Z."""

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of X, Y, Z of each column."""
        return graded_exponents(int(self.options["degree"]), self.variables)

    @property
    def polynomial_degree(self) -> int | None:
        """Greatest total power; None for a model that goes on from a polynomial."""
        # A model that also corrects by the control is more than its polynomial.
        return None if self.corrects else max(map(sum, self.exponents))


class Polynomial2D(Polynomial):
    """2-D polynomial: line and sample as polynomials of X and Y.

    References
    ----------
    Valadan Zoej et al. 2002, eqs. 1 and 2; Zakaryaie Nejad et al. 2015, eqs. 1 and 2. Both print
    double sums over all i, j up to n (`powers=each`). Zakaryaie Nejad et al. count 15 and 21 terms,
    those of total degree 4 and 5 (`powers=total`).

    Examples
    --------
    >>> import termsel
    >>> len(termsel.Polynomial2D(degree=3).terms)
    20
    """

    name = "poly2d"
    variables = 2
    uses_height = False
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("degree", 4, "Degree; a total degree of 4 gives 15 terms per axis, 5 gives 21.",
               int, 1, 8),
        Option("powers", "total", "Whether the degree limits the powers of X and Y together, or "
               "each of them, as in the papers' double sums; then 3 gives 16 terms per axis.",
               choices=("total", "each")))

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of X, Y, Z of each column."""
        if self.options.get("powers") == "each":
            return double_sum_exponents(int(self.options["degree"]))
        return super().exponents


class Polynomial3D(Polynomial):
    """3-D polynomial: line and sample as polynomials of X, Y and Z.

    Examples
    --------
    >>> import termsel
    >>> len(termsel.Polynomial3D(degree=2).terms)
    20
    """

    name = "poly3d"
    declared_options = (
        Option("degree", 2, "Total degree; 2 gives 10 terms per axis, 3 gives 20.", int, 1, 5),)


class Affine(Polynomial):
    """3D affine model: line and sample linear in X, Y and Z, 8 terms.

    Examples
    --------
    >>> import termsel
    >>> termsel.Affine().terms[:4]
    ('line.num:1', 'line.num:X', 'line.num:Y', 'line.num:Z')
    """

    name = "affine"

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y, Z."""
        return graded_exponents(1, 3)


# The plane similarity: shift, turn and one scale, with parameters that both image axes share.

class Helmert2D(SensorModel):
    """Plane similarity (Helmert transformation): a shift, a turn and one scale; 4 terms.

    With X and Y in one unit on the ground,

        sample = s + cos X - sin Y
        line   = l - sin X - cos Y.

    Lines count downwards and Y upwards, so that for turns of any angle this is the image of a map
    seen from above, not its mirror image: cos is the scale times the cosine of the angle by which
    the map is turned counter-clockwise. An image that is mirrored, or whose Y counts downwards as
    the lines do, takes `mirrored`. Two points determine the model, and do not show whether the
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
        """Image axis of each term, (4,): the scale and the turn act on both."""
        return np.array([LINE, SAMPLE, BOTH, BOTH], dtype=np.intp)

    @property
    def polynomial_degree(self) -> int:
        """1: a similarity is an affine map of which two coefficients follow from the others."""
        return 1

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and of lines, which are exact."""
        return image_equations(features, self._design_rows(features.points.ground),
                               self._design_rows(features.lines.ground.reshape(-1, 3)),
                               heights=False)

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points (see `SensorModel.project`)."""
        return np.asarray(np.einsum("nak,...k->...na", self._design_rows(ground), coefficients))

    def _design_rows(self, ground: FloatArray) -> FloatArray:
        """Return the rows of line and sample over all terms, shape (n, 2, 4)."""
        x, y = (ground[:, :2] * plane_units(self)).T
        # Y of a mirrored map counts downwards, as lines do.
        y = -y if self.options["mirrored"] else y
        # Columns: shift of lines, shift of samples, cos, sin, as in the equations above.
        ones = np.ones_like(x)
        zeros = np.zeros_like(x)
        return np.stack([np.stack([ones, zeros, -y, -x], axis=1),
                         np.stack([zeros, ones, x, -y], axis=1)], axis=1)


def plane_units(model: SensorModel) -> tuple[float, float]:
    """Return factors of scaled X and Y by which both have one unit; the larger is 1.

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
