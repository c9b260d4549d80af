"""What part of an image, and of the ground, a fit is for: few points span less than an RPC does.

A model that corrects an RPC has the option "rpc".
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from termsel.data.coordinates.crs import transformation_between
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.rpc import Rpc

_TO_EDGE = 0.5 + 1e-6
"""From the middle of an outermost pixel to its outer edge, but for rounding."""


@dataclass(frozen=True, eq=False)
class KnownImage:
    """What a model knows of its image before it is fitted, as by the metadata of a product.

    Parameters
    ----------
    size : tuple of int
        Lines and samples.
    area : ndarray, shape (2, 3)
        Least and largest WGS84 longitude, latitude [deg] and ellipsoidal height [m] of what it
        shows.
    lines : tuple of int, optional
        First and last line that the model is of, where these are not all, as of a burst.
    """

    size: tuple[int, int]
    area: FloatArray
    lines: tuple[int, int] | None = None

    def is_beyond(self, image: FloatArray) -> BoolArray:
        """Return whether positions (n, 2) [px] are in lines that the model is not of, (n,)."""
        if self.lines is None:
            return np.zeros(len(image), dtype=bool)
        first, last = self.lines
        # What has no position is in none of them.
        return np.asarray((image[:, 0] < first - _TO_EDGE) | (image[:, 0] > last + _TO_EDGE))

    def sentence(self) -> str:
        """Return a sentence on the lines that the model is of; "" where it is of all."""
        if self.lines is None:
            return ""
        return (f"The model is of the lines {self.lines[0]} to {self.lines[1]} of the image alone, "
                "as of a burst")


def image_extent(features: FeatureSet, options: Container[str], known: KnownImage | None = None,
                 ) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return first and last line and sample [px] of the image, of its RPC or of the features.

    Of an image of which the model is of some lines alone they are those of these lines.
    """
    size = features.image_size or (known.size if known else None)
    if size is not None:
        lines, samples = size
        first, last = known.lines if known and known.lines else (0, lines - 1)
        return (float(first), 0.0), (float(last), samples - 1.0)
    image = features.image_vertices()
    if (rpc := features.rpc) is not None and "rpc" in options:
        image = np.concatenate([_image_box_of_rpc(rpc), image])
    (top, left) = image.min(axis=0).tolist()
    (bottom, right) = image.max(axis=0).tolist()
    return (top, left), (bottom, right)


def _image_box_of_rpc(rpc: Rpc) -> FloatArray:
    """Return first and last line and sample of an RPC, shape (2, 2): no image begins below 0.

    RPCs are in the middle of their images, and scaled by no less than half of these; so the margin
    before the first pixel is beyond the last one, too.
    """
    middle = np.array(rpc.image_offset)
    half = np.abs(rpc.image_scale)
    half = np.where(middle > 0.0, np.minimum(half, middle), half)
    return np.stack([middle - half, middle + half])


def reach(features: FeatureSet, options: Container[str], known: KnownImage | None = None,
          ) -> FloatArray:
    """Return half the size of the area of the RPC that is corrected, or that is known, shape (3,);
    else 0.
    """
    if known is not None:
        box = known.area
    elif (rpc := features.rpc) is not None and "rpc" in options:
        box = np.array(rpc.ground_offset) + np.outer([-1.0, 1.0], rpc.ground_scale)
    else:
        return np.zeros(3)
    # Two opposite corners of the box, in the CRS of the features.
    corners = transformation_between("EPSG:4979", features.crs, strict=False)(box)
    return np.asarray(np.abs(corners[1] - corners[0]) / 2)
