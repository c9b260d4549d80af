"""A rough start where none is known: image and reference as a whole, reduced."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np

from termsel import FeatureSet, Points, TermselError
from termsel_match.images.rasters import FloatArray, Grey, GreyRaster, crs_of, open_picture
from termsel_match.images.starts import Start, start_by_points
from termsel_match.matchers.sift import describe_keypoints, mutual_nearest

log = logging.getLogger("termsel.match")

_MANY_PIXELS = 4e8
"""Number of pixels of all bands above which a note is logged: reading them takes some 3 s."""

_REDUCED_SIDE = 1000
"""Longest side of the reduced images that are compared [px]."""

_RATIO = 0.8
"""Largest distance of a descriptor from the nearest, divided by that from the second nearest."""

_MIN_PAIRS, _MIN_SHARE = 12, 0.1
"""Fewest pairs of keypoints that must agree, and their least share of all pairs."""

_TOLERANCE = 12.0
"""Distance up to which pairs agree with an affine transformation [px of the reduced image]. It is
wide, as relief and perspective are not affine."""


def start_by_overview(picture: GreyRaster, reference: Path | str, band: int | None) -> Start:
    """Return an affine start by keypoints of the whole image and the whole reference.

    It is rough, and only says where in the reference to look for matches: pairs of keypoints need
    to agree with it to `_TOLERANCE` px of the reduced image.

    Parameters
    ----------
    picture : GreyRaster
        The image.
    reference : path-like
        Raster with a CRS and a geotransform that shows the same ground.
    band : int, optional
        Band of the reference, as for `open_picture`.

    Raises
    ------
    TermselError
        If too few pairs agree, or the reference has no CRS.
    """
    with open_picture(reference, band) as reference_picture:
        crs = crs_of(reference_picture)
        transform = reference_picture.raster.transform
        for opened in (picture, reference_picture):
            _say_if_long(opened)
        at_image, image_vectors = _describe_whole(picture)
        at_reference, reference_vectors = _describe_whole(reference_picture)
    image_number, reference_number = mutual_nearest(image_vectors, reference_vectors, _RATIO)
    agree = np.zeros(len(image_number), dtype=bool)
    if len(image_number) >= _MIN_PAIRS:
        # From the reference to the image: the tolerance is in px of the image.
        _, inliers = cv2.estimateAffine2D(
            at_reference[reference_number], at_image[image_number], method=cv2.USAC_MAGSAC,
            maxIters=20000, ransacReprojThreshold=_TOLERANCE * _reduction_step(picture.size))
        if inliers is not None:
            agree = np.asarray(inliers).ravel().astype(bool)
    if agree.sum() < max(_MIN_PAIRS, _MIN_SHARE * len(image_number)):
        raise TermselError(
            "the image is not found in the reference: only "
            f"{int(agree.sum())} of {len(image_number)} places that look alike agree with each "
            "other", file=picture.path,
            hint="If the reference shows the same place, say where the image is: --start with "
                 "an RPC, a result or a file of some points.")
    # The geotransform counts from the corner of the first pixel, positions from its centre.
    x, y = transform @ (at_reference[reference_number[agree], 1] + 0.5,
                        at_reference[reference_number[agree], 0] + 0.5)
    # SIFT gives a keypoint with two directions twice.
    _, unique = np.unique(np.column_stack([x, y]), axis=0, return_index=True)
    ground = np.column_stack([x, y, np.full(len(x), np.nan)])[unique]
    points = Points(tuple(map(str, range(len(unique)))), at_image[image_number[agree]][unique],
                    ground)
    return start_by_points(FeatureSet(points, crs=crs),
                           f"an affine transformation by {len(points)} places that are alike")


def _say_if_long(picture: GreyRaster) -> None:
    """Log a note if all pixels of a large image have to be read, which may take minutes."""
    pixels = picture.size[0] * picture.size[1] * len(picture.bands)
    if pixels > _MANY_PIXELS and not picture.raster.overviews(picture.bands[0]):
        log.info("Note: all %d x %d px of %s are read to find the image in the reference, which "
                 "may take minutes: it has no overviews (gdaladdo makes them). A --start "
                 "saves it.", *picture.size, picture.path)


def _reduction_step(size: tuple[int, int]) -> int:
    """Return how many pixels along a side become one, so that neither side is above 1000 px."""
    return max(1, -(-max(size) // _REDUCED_SIDE))


def _describe_whole(picture: GreyRaster) -> tuple[FloatArray, Grey]:
    """Return keypoints of a whole picture, (n, 2) [px], and their descriptors, (n, 128).

    They are found in the picture reduced to 1000 px; their lines and samples are those of the
    picture itself.
    """
    step = _reduction_step(picture.size)
    keypoints, vectors = describe_keypoints(*picture.read(0, 0, *picture.size, step))
    # A reduced pixel is `step` pixels: its centre is the middle of these.
    return (keypoints + 0.5) * step - 0.5, vectors
