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
    """Return the first line and sample and the last ones [px].

    They are those of the image if its size is known. Else they are those of the box around all
    features, and around the RPC if the model has the option "rpc".
    If the model is of some lines of the image alone, they are those of these lines.
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
    """Return first and last line and sample of the image of an RPC, shape (2, 2).

    An RPC's offset is in the middle of its image, and its scale is at least half the size. As no
    image begins below 0, a scale larger than the offset has a margin before the first pixel; the
    same margin is taken off beyond the last one.
    """
    middle = np.array(rpc.image_offset)
    half_size = np.abs(rpc.image_scale)
    half_size = np.where(middle > 0.0, np.minimum(half_size, middle), half_size)
    return np.stack([middle - half_size, middle + half_size])


def reach(features: FeatureSet, options: Container[str], known: KnownImage | None = None,
          ) -> FloatArray:
    """Return half the size (3,) of the area for which an RPC is valid, in units of the ground.

    It is that of the known image, or of the features' RPC if the model has the option "rpc". All
    three are 0 if there is neither.
    """
    if known is not None:
        box = known.area
    elif (rpc := features.rpc) is not None and "rpc" in options:
        box = np.array(rpc.ground_offset) + np.outer([-1.0, 1.0], rpc.ground_scale)
    else:
        return np.zeros(3)
    # The box is that of its two opposite corners in the CRS of the features.
    corners = transformation_between("EPSG:4979", features.crs, strict=False)(box)
    return np.asarray(np.abs(corners[1] - corners[0]) / 2)
