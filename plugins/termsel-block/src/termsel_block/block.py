"""What a block is made of: images, their control, and the ties between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from termsel import FeatureSet, Rpc
from termsel_block.geometry.frame import FloatArray, IntArray

CORRECTIONS = ("auto", "none", "shift", "drift", "affine", "smooth")
"""What `model` of an image with an RPC may say."""


@dataclass(frozen=True, eq=False)
class Ties:
    """Measurements of tie points.

    Parameters
    ----------
    names : tuple of str
        Names of the tie points.
    tie, image : ndarray, shape (n,)
        Index of the tie point and of the image of each measurement.
    position : ndarray, shape (n, 2)
        Line and sample [px].
    """

    names: tuple[str, ...]
    tie: IntArray
    image: IntArray
    position: FloatArray


@dataclass(frozen=True, eq=False)
class BlockImage:
    """One image of a block.

    Parameters
    ----------
    name : str
    features : FeatureSet, optional
        Its own points and lines, in the CRS of the block. Points with the role independent judge
        and are not adjusted.
    rpc : Rpc, optional
        RPC of its vendor.
    rpc_file : Path, optional
    raster : Path, optional
        The image itself.
    size : tuple of int, optional
        Lines and samples [px].
    model : str
        Correction of the RPC; "auto" is chosen by evidence. Without an RPC "auto" is a polynomial,
        and any other the name of a model whose terms have priors, such as scanner.
    options : mapping
        Options of that model.
    of_dem : frozenset of str
        Points and lines whose height was taken from the DEM, of which they show nothing.
    """

    name: str
    features: FeatureSet | None = None
    rpc: Rpc | None = None
    rpc_file: Path | None = None
    raster: Path | None = None
    size: tuple[int, int] | None = None
    model: str = "auto"
    of_dem: frozenset[str] = frozenset()
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Block:
    """Images that share tie points.

    Parameters
    ----------
    crs : str
        CRS of all ground coordinates.
    images : tuple of BlockImage
    ties : Ties
    dem : Path, optional
        Raster of heights.
    notes : tuple of str
        What the reader must know of how it was read.
    files : tuple of Path
        All that was read.
    """

    crs: str
    images: tuple[BlockImage, ...]
    ties: Ties
    dem: Path | None = None
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
