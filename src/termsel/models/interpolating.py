"""Models that predict from the control points themselves: splines and random fields."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from termsel.adjustment.bayesian.field import SPLINE_SURE_POINTS, fit_gaussian_process
from termsel.adjustment.bayesian.plane_average import fit_plane_average
from termsel.adjustment.bayesian.thin_plate import thin_plates
from termsel.adjustment.interpolation import Interpolation
from termsel.core.errors import TermselError, amount_in_words
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.monomials import Exponents, graded_exponents
from termsel.models.polynomial import Polynomial, plane_units

MAX_EXACT_SPLINE = 3000
"""Most points that a spline meets exactly: it has a kernel around each, and a matrix of all, whose
time grows with the third power of their number."""


class Interpolating(Polynomial):
    """Base of models that predict from the control points, with an affine model as their terms.

    Where the points suffice for the interpolation, it takes up any affine function, and the
    terms have no influence. Lines determine the affine terms alone.
    """

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of an affine function."""
        return graded_exponents(1, self.variables)

    def predict(self, coefficients: FloatArray, control: FeatureSet,
                ground: FloatArray) -> FloatArray:
        """Return image positions (..., m, 2) of ground positions (m, 3) by the control points.

        They are the same for all of the coefficients (..., k), which count only where the points
        determine no interpolation: there positions are those of the terms.
        """
        interpolation = self.interpolation(control)
        if interpolation is None:
            return self.project(coefficients, ground)
        # The same for every set of coefficients, which have no influence on the interpolation.
        image = interpolation.predict(ground)
        return np.broadcast_to(image, (*coefficients.shape[:-1], *image.shape)).copy()


class ThinPlate(Interpolating):
    """Thin-plate spline of line and sample over X and Y.

    An affine function and kernels r^2 log r around the control points, as `gdalwarp -tps` and
    QGIS have it, and smoothed. By default REML chooses the smoothing of line and of sample. With
    smoothing 0 control points are met exactly, blunders with them. Distances are those on the
    ground, the larger half-range of the control being 1; longitudes are brought to the unit of
    latitudes. Of more than 1,000 control points, kernels are around 1,000 that are far apart.

    The spline takes up any affine function, so that its terms make no difference.

    References
    ----------
    Duchon 1977; Wahba 1990, Spline Models for Observational Data; Wood 2011, J. R. Stat. Soc. B
    73(1), for REML; Wood 2003, J. R. Stat. Soc. B 65(1), for few kernels of many.

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "tps", smoothing=0)
    >>> round(fitted.rmse(fitted.control.points).total, 6)  # px: control points are met exactly
    0.0
    """

    name = "tps"
    variables = 2
    uses_height = False
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("smoothing", None, "Value added to the diagonal of the kernels' matrix; 0 "
                                  "interpolates the control points. By default it is estimated.",
               float, 0.0, 1e9),
        Option("chosen_by", "reml", "How the smoothing is chosen: by restricted maximum likelihood "
                                    "or generalised cross-validation.", choices=("reml", "gcv")))

    def interpolation(self, control: FeatureSet) -> Interpolation | None:
        """Return the spline (see `SensorModel.interpolation`).

        Raises
        ------
        TermselError
            If an exact spline is asked for, and the points are too many for one.
        """
        if self.options["smoothing"] == 0 and len(control.points) > MAX_EXACT_SPLINE:
            raise TermselError(
                f"a spline that meets {amount_in_words(len(control.points), 'point')} exactly "
                "takes too long", hint="Leave smoothing out, or give one above 0.")
        return thin_plates(control.points, plane_units(self), self.options["smoothing"],
                           self.options["chosen_by"])


class Field(Interpolating):
    """2-D polynomial with local deformation: collocation, averaged over its scales.

    A regularised cubic polynomial of X and Y, a stationary random field with Matern covariance, for
    what is local, and noise. The lengths, size and noise of the field are not set: solutions on
    a grid are averaged with their probabilities, those without a field among them (see
    `termsel.adjustment.bayesian.field`). For old maps, sheets and scanners that shake.

    Up to 12 points show no local deformation. They are averaged over a similarity, which paper
    stretches and shears by about one per cent, over polynomials and over a spline (see
    `termsel.adjustment.bayesian.plane_average`).

    The field takes up any affine function, so that its terms make no difference.

    References
    ----------
    Moritz 1980, Advanced Physical Geodesy; Stein 1999, Interpolation of Spatial Data.

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "field")
    >>> fitted.model.uses_height
    False
    """

    name = "field"
    variables = 2
    uses_height = False

    def interpolation(self, control: FeatureSet) -> Interpolation | None:
        """Return the collocation, or the average of few points in a plane.

        See `SensorModel.interpolation`.
        """
        if not self.uses_height and len(control.points) <= SPLINE_SURE_POINTS:
            return fit_plane_average(control.points, plane_units(self))
        return fit_gaussian_process(control.points, self.variables)


class Field3D(Field):
    """3-D polynomial with local deformation: `field` with a polynomial of X, Y and Z.

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "field3d")
    >>> round(fitted.rmse(fitted.control.points).total, 1)  # px
    0.3
    """

    name = "field3d"
    variables = 3
    uses_height = True
