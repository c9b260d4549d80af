"""How far what another program makes of an exported file is from the fitted model."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from termsel.fits.fit import Fit
from termsel.measurements.coordinates.metres import in_metres
from termsel.measurements.features import FloatArray

log = logging.getLogger(__name__)

CLOSE = 1.0
"""Deviation from the model [px] above which an export warns."""

_ACROSS = 15  # places along either side of the image at which files are compared


def places_of(fitted: Fit) -> FloatArray:
    """Return ground places over the image, at the lowest, middle and highest control.

    Returns
    -------
    ndarray, shape (n, 3)
        Those that the model can locate.
    """
    middle, half = fitted.ground_box()
    levels: set[float] = {float(middle[2] + share * half[2]) for share in (-1.0, 0.0, 1.0)} \
        if fitted.model.uses_height else {0.0}
    (top, left), (bottom, right) = fitted.image_box()
    image = np.stack(np.meshgrid(np.linspace(top, bottom, _ACROSS),
                                 np.linspace(left, right, _ACROSS)), axis=-1).reshape(-1, 2)
    ground = np.concatenate([fitted.locate(image, level) for level in sorted(levels)])
    return np.asarray(ground[np.isfinite(ground[:, :2]).all(axis=1)])


def by_splines(xy: FloatArray, image: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the thin plate spline from ground to image through GCPs, as GDAL computes it.

    Parameters
    ----------
    xy, image : ndarray, shape (n, 2)
    """
    from scipy.interpolate import RBFInterpolator

    middle, unit = xy.mean(axis=0), float(np.ptp(xy, axis=0).max())
    spline = RBFInterpolator((xy - middle) / unit, image, kernel="thin_plate_spline")
    return lambda ground: np.asarray(spline((ground[:, :2] - middle) / unit))


def say_deviation(name: str, fitted: Fit, ground: FloatArray, image: FloatArray,
                  where: str = "") -> None:
    """Log the largest deviation of a file from the model, as a warning above CLOSE.

    Parameters
    ----------
    name : str
        The format.
    fitted : Fit
    ground : ndarray, shape (n, 3)
    image : ndarray, shape (n, 2)
        Where the file puts these places.
    where : str
        A further part of the sentence.
    """
    apart = image - fitted.project(ground)
    known = np.isfinite(apart).all(axis=1)
    if not known.any():
        return
    distance = np.hypot(*apart[known].T)
    worst = int(np.argmax(distance))
    place = ground[known][worst:worst + 1]
    moved = fitted.locate(image[known][worst:worst + 1], place[:, 2])
    metres = in_metres(fitted.control.crs, place, (moved - place)[:, :2])
    length = "" if metres is None or not np.isfinite(metres).all() \
        else f" ({_size(float(np.hypot(*metres[0])))} m on the ground)"
    close = distance[worst] <= CLOSE
    log.log(logging.INFO if close else logging.WARNING,
            "%s%s: at most %s px%s from the model%s.", "" if close else "Warning: ", name,
            _size(float(distance[worst])), length, where)


def _size(length: float) -> str:
    return f"{length:.2g}" if length < 100 else f"{length:,.0f}"


def say_measured(name: str) -> None:
    """Log that a format holds measurements and no model, so that nothing deviates."""
    log.info("%s holds the measurements and their residuals, not the model.", name)


def say_splines(name: str, fitted: Fit, xy: FloatArray, image: FloatArray) -> None:
    """Log how far the spline through measured GCPs is from the model, as their heights are ignored.

    Parameters
    ----------
    name : str
    fitted : Fit
    xy, image : ndarray, shape (n, 2)
        Of the GCPs.
    """
    if len(xy) < 3:
        return
    ground = places_of(fitted)
    ignored = ", and ignores heights" * fitted.model.uses_height
    if len(np.unique(xy, axis=0)) < len(xy):
        log.warning("Warning: %s: no thin plate spline goes through these GCPs, as some are above "
                    "each other.", name)
        return
    say_deviation(name, fitted, ground, by_splines(xy, image)(ground),
                  f", where a program fits a thin plate spline (gdalwarp -tps){ignored}")
