"""What viewers make of an annotation: its transformations, by name and as Allmaps computes them.

A viewer fits a transformation from the image to the ground in Web Mercator to the control points,
by least squares. Rows count downwards in the image and northings upwards, so that the similarity is
that of an image seen from above.

References
----------
IIIF Georeference Extension 1.0, section 3.3 (transformation types).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel import Fit
from termsel.toolkit import FloatArray

EARTH = 6378137.0
"""Radius of the sphere of Web Mercator [m]."""

# How many places along either side of the image a viewer is compared with the model at.
_N_ACROSS = 15

Forward = Callable[[FloatArray], FloatArray]
"""From line and sample (n, 2) to Web Mercator (n, 2) [m]."""


@dataclass(frozen=True)
class Kind:
    """A transformation of the extension.

    Parameters
    ----------
    label : str
        What messages call it.
    statement : dict
        As the extension states it.
    model : str
        The model of termsel that is the same from the ground to the image, or next to it.
    options : dict
        Options of that model.
    """

    label: str
    statement: dict[str, Any]
    model: str
    options: Mapping[str, Any]


def _polynomial_kind(order: int) -> Kind:
    """Return the transformation of viewers that is a polynomial of an order."""
    return Kind(f"polynomial of order {order}",
                {"type": "polynomial", "options": {"order": order}}, "poly2d", {"degree": order})


TRANSFORMATIONS: dict[str, Kind] = {
    "similarity": Kind("helmert", {"type": "helmert"}, "helmert2d", {"mirrored": False}),
    "order 1": _polynomial_kind(1),
    "projective": Kind("projective", {"type": "projective"}, "projective2d", {}),
    "order 2": _polynomial_kind(2), "order 3": _polynomial_kind(3),
    "spline": Kind("thinPlateSpline", {"type": "thinPlateSpline"}, "tps", {})}
"""The transformations of the extension, the simplest first."""


def kind_of(stated: Any) -> Kind | None:
    """Return the transformation that an annotation states; None if it is not one that is known.

    A polynomial without an order is of order 1. `stated` may be any value of JSON.
    """
    if not isinstance(stated, dict):
        return None
    options = stated.get("options")
    order = options.get("order", 1) if isinstance(options, dict) else 1
    for kind in TRANSFORMATIONS.values():
        if stated.get("type") == kind.statement["type"] and (
                kind.model != "poly2d" or order == kind.options["degree"]):
            return kind
    return None


def kind_of_fit(fitted: Fit) -> str | None:
    """Return the key in `TRANSFORMATIONS` of what a fitted model is; None if it is none of them.

    A polynomial of which terms were left out is none, nor is a mirrored similarity.
    """
    model = fitted.model
    for key, kind in TRANSFORMATIONS.items():
        if model.name == kind.model and fitted.terms.all() and all(
                model.options.get(name) == value for name, value in kind.options.items()):
            return key
    return None


def to_mercator(degrees: FloatArray) -> FloatArray:
    """Return longitude and latitude (n, 2) [degrees] in Web Mercator [m], shape (n, 2)."""
    # The northing is R artanh(sin lat), which is R ln tan(45 deg + lat / 2).
    lon, lat = np.radians(degrees).T
    return EARTH * np.column_stack([lon, np.arctanh(np.sin(lat))])


def from_mercator(metres: FloatArray) -> FloatArray:
    """Return places in Web Mercator (n, 2) [m] as longitude and latitude [degrees]."""
    x, y = metres.T / EARTH
    return np.asarray(np.degrees(np.column_stack([x, np.arctan(np.sinh(y))])))


def forward(key: str, image: FloatArray, plane: FloatArray) -> Forward | None:
    """Return a function from line and sample to Web Mercator, fitted to control points.

    None if the points do not determine it, or are too many for a spline.


    Parameters
    ----------
    key : str
        Key in `TRANSFORMATIONS`.
    image : ndarray, shape (n, 2)
        Line and sample.
    plane : ndarray, shape (n, 2)
        Web Mercator [m].
    """
    # Coordinates about the mean, in units of the extent, condition least squares well.
    middle = plane.mean(axis=0)
    # Points at one place have an extent of 0, by which nothing can be divided.
    plane_extent = float(np.abs(plane - middle).max()) or 1.0
    centre = image.mean(axis=0)
    image_extent = float(np.abs(image - centre).max()) or 1.0
    scaled_image = (image - centre) / image_extent
    scaled_plane = (plane - middle) / plane_extent
    scaled = _fit_scaled(key, scaled_image, scaled_plane)
    return None if scaled is None else lambda at: np.asarray(
        middle + plane_extent * scaled((at - centre) / image_extent))


MAX_SPLINED = 5000
"""Most points through which a spline is fitted."""


def _fit_scaled(key: str, image: FloatArray, plane: FloatArray) -> Forward | None:
    """Return a function from image (n, 2) to plane (n, 2), both scaled to about 1.

    `key` is its kind in `TRANSFORMATIONS`. None if the points do not determine it: too few, on a
    line, or for a spline at one place or more than `MAX_SPLINED`.
    """
    n = len(image)
    if key == "spline":
        # A spline through thousands of points would fill the memory, here and in a viewer.
        if (not 3 <= n <= MAX_SPLINED or np.linalg.matrix_rank(image - image.mean(axis=0)) < 2
                or len(np.unique(image, axis=0)) < n):
            return None
        from scipy.interpolate import RBFInterpolator

        spline = RBFInterpolator(image, plane, kernel="thin_plate_spline")
        return lambda at: np.asarray(spline(at))
    if key == "similarity":
        # Both axes share their unknowns: equations of x above those of y.
        design = np.concatenate([_similarity_columns(image, 0), _similarity_columns(image, 1)])
        if n < 2 or np.linalg.matrix_rank(design) < 4:
            return None
        values = np.linalg.lstsq(design, plane.T.ravel(), rcond=None)[0]
        return lambda at: np.column_stack([_similarity_columns(at, axis) @ values
                                           for axis in (0, 1)])
    if key == "projective":
        return _fit_projective(image, plane)
    design = _monomial_columns(image, int(key[-1]))
    if n < design.shape[1] or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    terms = np.linalg.lstsq(design, plane, rcond=None)[0]
    return lambda at: np.asarray(_monomial_columns(at, int(key[-1])) @ terms)


def _similarity_columns(image: FloatArray, axis: int) -> FloatArray:
    """Return the design (n, 4) of a similarity for x (axis 0) or y (axis 1).

    The unknowns are two shifts, and scale times cosine and sine of the turn.
    """
    (line, sample) = image.T
    unit = np.ones(len(image))
    none = np.zeros(len(image))
    # x = a + c * sample + s * line,  y = b + s * sample - c * line
    return np.column_stack([unit, none, sample, line] if axis == 0 else [none, unit, -line, sample])


def _monomial_columns(image: FloatArray, order: int) -> FloatArray:
    """Return the monomials of line and sample (n, 2) up to a total order, shape (n, terms)."""
    line, sample = image.T
    columns = []
    for i in range(order + 1):
        columns += [line**i * sample**j for j in range(order + 1 - i)]
    return np.column_stack(columns)


def _fit_projective(image: FloatArray, plane: FloatArray) -> Forward | None:
    """Return the projective transformation from image (n, 2) to plane (n, 2).

    It is fitted by the direct linear transformation. None if the points do not determine it.
    """
    if len(image) < 4:
        return None
    source = np.column_stack([image, np.ones(len(image))])
    # x (h3 p) = h1 p and y (h3 p) = h2 p, homogeneous in the nine numbers of H.
    rows = np.concatenate([
        np.hstack([source, 0 * source, -plane[:, :1] * source]),
        np.hstack([0 * source, source, -plane[:, 1:] * source])])
    # R has the same singular values and right vectors as the rows, and at most nine rows.
    sizes, directions = np.linalg.svd(np.linalg.qr(rows, mode="r"))[1:]
    # If a second direction leaves all equations at 0, the points do not determine H.
    if sizes[7] < 1e-10 * sizes[0]:
        return None
    matrix = directions[-1].reshape(3, 3)

    def project(at: FloatArray) -> FloatArray:
        """Return places (n, 2) of the plane for places (n, 2) of the image."""
        homogeneous = np.column_stack([at, np.ones(len(at))]) @ matrix.T
        return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])

    return project


def spread_places(fitted: Fit) -> FloatArray:
    """Return line and sample (m, 2) of a regular grid of places over the image of a fit."""
    (first_line, first_sample), (last_line, last_sample) = fitted.image_box()
    return np.stack(np.meshgrid(np.linspace(first_line, last_line, _N_ACROSS),
                                np.linspace(first_sample, last_sample, _N_ACROSS)
                                ), axis=-1).reshape(-1, 2)
