"""An image that is a part of another one, or reduced, and the RPC of the other one.

With (L, S) a place in the whole image, f its pixels in one pixel of the part along either axis and
(L0, S0) where the part begins, both counted from the outer corner of the first pixel,

    l + 1/2 = (L + 1/2 - L0) / f,

and samples likewise: so the offsets and scales of the RPC take the part over exactly.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.core.remedies import ReadRemedy
from termsel.data.features import FloatArray
from termsel.data.rpc import Rpc

RPC_OFFSET = Option(
    "rpc_offset", None, "Line and sample at which this image begins in the larger one that the RPC "
    "is of, such as 700,900: the image was cut out.")
RPC_SCALE = Option(
    "rpc_scale", None, "Pixels along a side of the image that the RPC is of in one pixel of this "
    "image, such as 2: the image was reduced.", float, 1e-3, 1e3)

_PAIR = re.compile(r"\s*([-+.\deE]+)\s*,\s*([-+.\deE]+)\s*")
_FAR_PX = 100.0
"""Median distance [px] from which on an RPC may be of another image: vendors' are nearer."""
_EXPLAINED_SHARE = 0.05
"""Share of the distance, or of the image, by which points may differ that a part explains."""
_MEASURED = 3.0
"""Scatter of measured points about a part [px] that needs no explanation."""
_REDUCED = 0.1
"""Least difference of a factor from 1: a drift is smaller."""
_SIMPLE = 0.02
"""Relative difference of a factor from a simple one up to which it is that."""
_FACTORS = (*range(2, 17), *(1 / n for n in range(2, 17)), 1.5, 2.5, 2 / 3, 0.75, 4 / 3)
_ROUND = 10.0  # px
_MIN_PART_POINTS = 3  # points that show a part
_MAX_PAIRED_POINTS = 60  # points whose pairs are looked at


@dataclass(frozen=True)
class ImagePart:
    """Where an image is in the one that an RPC is of.

    Parameters
    ----------
    offset : tuple of float
        Line and sample at which it begins [px of the whole image].
    scale : float
        Pixels of the whole image in one of the part, along either axis.
    """

    offset: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0

    def rpc(self, rpc: Rpc) -> Rpc:
        """Return the RPC of the part."""
        # Offsets are positions in the image, scales are lengths: only the former are shifted.
        line, sample = self.places(np.array(rpc.image_offset)).tolist()
        lines, samples = rpc.image_scale
        return replace(rpc, image_offset=(line, sample),
                       image_scale=(lines / self.scale, samples / self.scale))

    def places(self, position: FloatArray) -> FloatArray:
        """Return lines and samples (..., 2) in the part of a position in the whole image."""
        return np.asarray((position + 0.5 - self.offset) / self.scale - 0.5)

    def places_in_whole(self, position: FloatArray) -> FloatArray:
        """Return lines and samples (..., 2) in the whole image of a position in the part."""
        return np.asarray((position + 0.5) * self.scale + self.offset - 0.5)

    @property
    def settings(self) -> str:
        """The options that state it."""
        line, sample = self.offset
        options = [f"--set rpc_offset={line:g},{sample:g}"] if line or sample else []
        options += [f"--set rpc_scale={self.scale:g}"] if self.scale != 1.0 else []
        return " ".join(options)

    def sentence(self) -> str:
        """Return a sentence on which part of the RPC's image this one is."""
        line, sample = self.offset
        clauses = []
        if self.scale != 1.0:
            clauses.append(f"has {self.scale:g} times the pixels of this one along a side"
                           if self.scale > 1.0 else
                           f"is {1 / self.scale:g} times coarser than this one")
        if line or sample:
            up = "above" if line >= 0 else "below"
            side = "left" if sample >= 0 else "right"
            clauses.append(f"begins some {abs(line):.0f} lines {up} and {abs(sample):.0f} samples "
                           f"{side} of it")
        return (f"The control shows that the RPC is that of an image that "
                f"{' and '.join(clauses)}; it was used so ({self.settings}).")


def part_of(offset: str | None, scale: float | str | None) -> ImagePart | None:
    """Return the part by the options `RPC_OFFSET` and `RPC_SCALE`; None if neither is given.

    Raises TermselError if one of them cannot be read.
    """
    if offset is None and scale is None:
        return None
    # Either option alone says that the other is as in the whole image.
    start = (0.0, 0.0)
    if offset is not None:
        pair = _PAIR.fullmatch(str(offset))
        try:
            start = (float(pair[1]), float(pair[2])) if pair else (np.nan, np.nan)
        except ValueError:
            start = (np.nan, np.nan)
        if not np.isfinite(start).all():
            raise TermselError(f"option 'rpc_offset' does not take {offset!r}",
                               hint="Give line and sample in one text, such as "
                                    f"{ReadRemedy('rpc_offset', '700,900')}.")
    try:
        factor = 1.0 if scale is None else float(scale)
    except ValueError:
        factor = np.nan
    if not 1e-3 <= factor <= 1e3:
        raise TermselError(f"option 'rpc_scale' does not take {scale!r}",
                           hint="Give a number from 0.001 to 1000, such as rpc_scale=2.")
    return ImagePart(start, factor)


def recognise_part(predicted: FloatArray, measured: FloatArray) -> ImagePart | None:
    """Return the part of an RPC's image that this image is, if points show that it is one.

    `predicted` are the positions of points by the RPC, `measured` those in the image, both (n, 2)
    [px]. Returns None where they are near each other, where the points are too few, or where no
    part explains most of them. A shift of the RPC itself looks like another place where the part
    begins. So the place is rounded, and the correction of the RPC finds the remaining pixels, with
    their uncertainty. Medians let less than half of the points be blunders.
    """
    is_seen = np.isfinite(predicted).all(axis=1)
    predicted = predicted[is_seen]
    measured = measured[is_seen]
    if (len(predicted) < _MIN_PART_POINTS
            or np.median(np.linalg.norm(predicted - measured, axis=1)) < _FAR_PX):
        return None
    # Ratios of distances do not depend on where the part begins, so the factor comes first.
    factor = _ratio_of_distances(predicted, measured)
    scale = _nearest_simple_factor(factor) if abs(factor - 1.0) > _REDUCED else 1.0
    start = np.median(predicted + 0.5 - scale * (measured + 0.5), axis=0)
    # Less than what vendors' RPCs are off is a shift of the RPC; more is where the part begins.
    if np.abs(start).max() > _FAR_PX or scale == 1.0:
        start = _ROUND * np.round(start / _ROUND)
    else:
        start = np.zeros(2)
    image_part = ImagePart((float(start[0]), float(start[1])), scale)
    # Offsets count about their median: a shift is left to the correction, and only scatter speaks
    # against the part.
    offsets = image_part.places(predicted) - measured
    scatter = float(np.median(np.linalg.norm(offsets - np.median(offsets, axis=0), axis=1)))
    diagonal = float(np.linalg.norm(np.ptp(measured, axis=0)))
    is_explained = scatter < max(_MEASURED, _EXPLAINED_SHARE * diagonal / 2)
    return image_part if is_explained and diagonal > _FAR_PX else None


def _ratio_of_distances(predicted: FloatArray, measured: FloatArray) -> float:
    """Return the median ratio of distances between points (n, 2), predicted by measured.

    Of many points _MAX_PAIRED_POINTS are paired. It is 1 where all were measured at one place.
    """
    sample = np.linspace(0, len(predicted) - 1, min(len(predicted), _MAX_PAIRED_POINTS)).astype(int)
    pairs = np.array(list(combinations(sample.tolist(), 2)))
    first = pairs[:, 0]
    second = pairs[:, 1]
    predicted_distances = np.linalg.norm(predicted[first] - predicted[second], axis=1)
    measured_distances = np.linalg.norm(measured[first] - measured[second], axis=1)
    # Points at one place have no ratio.
    differs = measured_distances > 0
    if not differs.any():
        return 1.0
    return float(np.median(predicted_distances[differs] / measured_distances[differs]))


def _nearest_simple_factor(factor: float) -> float:
    """Return the simple factor next to a measured one, or the measured one if none is close."""
    nearest = min(_FACTORS, key=lambda simple: abs(factor / simple - 1.0))
    return float(nearest) if abs(factor / nearest - 1.0) < _SIMPLE else factor
