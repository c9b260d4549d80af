"""What part of an image, and of the ground, a fit is for: few points span less than an RPC does.

A model that corrects an RPC has the option "rpc".
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from termsel.data.coordinates.crs import transformation_between
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.rpc import Rpc


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
    """

    size: tuple[int, int]
    area: FloatArray


def image_extent(features: FeatureSet, options: Container[str], known: KnownImage | None = None,
                 ) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return first and last line and sample [px] of the image, of its RPC or of the features."""
    size = features.image_size or (known.size if known else None)
    if size is not None:
        lines, samples = size
        return (0.0, 0.0), (lines - 1.0, samples - 1.0)
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
