"""A DEM held against the heights of control: by how much it is off as a whole.

With d the DEM's height less that of control, the median of d shows a shift, of which

    s^2 = (n scatter^2 + PRIOR_COUNT USUAL_SIGMA^2) / (n + PRIOR_COUNT)

is the variance of one difference: the robust scatter of n differences, and what errors of DEMs
usually are, as if PRIOR_COUNT more differences had shown that. So two heights that agree by chance
claim no precision. The median of n has the standard deviation EFFICIENCY s / sqrt(n); next to it
DEMs are off as a whole by some ROUGHLY, by their making and by epochs of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from shlex import quote

import numpy as np

from termsel.core.errors import count_in_words
from termsel.data.coordinates.height_units import FOOT, UNITS
from termsel.data.coordinates.wgs84 import FloatArray

USUAL_SIGMA, PRIOR_COUNT = 5.0, 2.0
"""Usual standard deviation of a DEM's errors [m], and the differences that it counts as."""

ROUGHLY = 0.5
"""Standard deviation of what DEMs are off as a whole [m] where all is as it should be."""

BEYOND = 3.0
"""Standard deviations beyond which a DEM contradicts the control."""

TAKEN = 1e-5
"""Difference [m] up to which a height was taken from the DEM itself, and shows nothing."""

GEOID = "geoid and ellipsoid?"
"""The usual cause, up to what geoids are from ellipsoids."""

NO_DEM = "is it a DEM, in metres? If not, what is made with it is wrong"
"""The cause of larger differences."""

_MAX_GEOID_HEIGHT = 150.0
"""Metres by which no geoid is from an ellipsoid, with room for a DEM's own errors."""

_MAD = 1.4826  # from the median absolute deviation to the standard deviation of normal errors
_EFFICIENCY = float(np.sqrt(np.pi / 2))  # standard deviation of a median by that of a mean
_KILOMETRE = 1000.0
_A_THIRD = 1 / 3
_EXACT = 3.0  # what is left where heights are read in another unit: a share, and metres
_VISIBLE = 0.1  # px


@dataclass(frozen=True)
class DemDifference:
    """How far a DEM is above the heights of control as a whole.

    Parameters
    ----------
    above : float
        Median of the DEM's heights less those of control [m].
    sigma : float
        Standard deviation of this median where DEM and control refer to the same [m].
    count : int
        Heights of control that show it.
    in_feet : bool
        Whether one of both looks as if it were in feet: the DEM if it has the larger numbers.
    in_kilometres : bool
        Whether one of both looks as if it were in kilometres.
    dem : str
        Name of the DEM's file.
    """

    above: float
    sigma: float
    count: int
    in_feet: bool = False
    in_kilometres: bool = False
    dem: str = ""

    @property
    def contradicts(self) -> bool:
        """Whether the median is beyond three times its standard deviation."""
        return abs(self.above) > BEYOND * self.sigma

    @property
    def evidence(self) -> str:
        """Of how many heights the difference is the median, and how sure it is, in words."""
        return (f"median of {count_in_words(self.count, 'height')}, standard deviation "
                f"{_rounded_metres_in_words(self.sigma)} m")

    def sentence(self, pixels: float | None = None) -> str:
        """Return the difference as one sentence, with its effect on a map [px] if that is known."""
        if pixels is None:
            effect = ""
        elif pixels >= _VISIBLE:
            effect = f": {_rounded_metres_in_words(pixels)} px on a map"
        else:
            effect = ", of which this model makes no use"
        cause = ""
        if self.in_feet and self.above > 0:
            file = quote(self.dem) if self.dem else "DEM"
            cause = ("is the DEM in feet? gdal_translate -ot Float32 -scale 0 1 0 0.3048 "
                     f"{file} metres.tif makes one in metres")
        elif self.in_feet:
            cause = "are the points in feet? Run again with --set z_unit=ft"
        elif self.in_kilometres:
            cause = "is one of them in kilometres?"
        return sentence_on_common_offset(
            self.above, "the control", self.evidence, effect, self.dem, cause)


def sentence_on_common_offset(above: float, reference: str, evidence: str, effect: str = "",
                              dem: str = "",
                              cause: str = "") -> str:
    """Return a sentence that a DEM lies `above` a reference [m], or below it if negative, and why.

    Without a `cause` the sentence names the usual one of a difference of this size.
    """
    cause = cause or (GEOID if abs(above) <= _MAX_GEOID_HEIGHT else NO_DEM)
    direction = "above" if above > 0 else "below"
    name = f" {dem}" if dem else ""
    return (f"The DEM{name} is {_rounded_metres_in_words(abs(above))} m {direction} {reference} "
            f"({evidence}){effect}; {cause}")


def dem_difference(control: FloatArray, dem: FloatArray, name: str = "") -> DemDifference | None:
    """Return how far a DEM is above the heights of control as a whole.

    Parameters
    ----------
    control, dem : ndarray, shape (n,)
        Heights of control, and of the DEM at the same places [m]; NaN where not known. Control
        whose height was taken from the DEM shows nothing, and is left out.
    name : str
        The name of the DEM's file, for sentences on the difference.

    Returns
    -------
    DemDifference or None
        None if no place has two independent heights.
    """
    differences = dem - control
    informative = np.isfinite(differences) & (np.abs(differences) > TAKEN)
    differences = differences[informative]
    control = control[informative]
    dem = dem[informative]
    n = len(differences)
    if not n:
        return None
    median = float(np.median(differences))
    # The median absolute deviation, so that trees and blunders among the heights count little.
    scatter = _MAD * float(np.median(np.abs(differences - median)))
    # This is s^2 of the module's docstring: the usual variance counts as PRIOR_COUNT more heights.
    variance = (n * scatter**2 + PRIOR_COUNT * USUAL_SIGMA**2) / (n + PRIOR_COUNT)
    sigma = float(np.sqrt(_EFFICIENCY**2 * variance / n + ROUGHLY**2))
    in_kilometres = _is_in_unit(_KILOMETRE, control, dem, scatter)
    # If one side is in kilometres, nearly 0 m, any smaller unit of the other seems to fit better:
    # that shows no feet.
    in_feet = not in_kilometres and _is_in_unit(UNITS[FOOT], control, dem, scatter)
    return DemDifference(median, sigma, n, in_feet, in_kilometres, name)


def _is_in_unit(unit: float, control: FloatArray, dem: FloatArray, scatter: float) -> bool:
    """Return whether heights agree better where one side is in a unit [m] than by any shift."""
    # What is left in the unit must be a third of what is left in metres at most, and within what
    # shifts leave: two sets of heights that agree by nothing are in no unit.
    remaining = min(_median_distance(control * unit, dem), _median_distance(control, dem * unit))
    return remaining < min(_A_THIRD * _median_distance(control, dem), max(scatter, _EXACT))


def _median_distance(control: FloatArray, dem: FloatArray) -> float:
    """Return the median distance of heights [m]."""
    return float(np.median(np.abs(dem - control)))


def _rounded_metres_in_words(size: float) -> str:
    """Return a size [m] to three digits, whole from 1000 on."""
    return f"{size:.3g}" if size < 999.5 else f"{size:,.0f}"
