"""Bright and dark bands of an image along a direction: where a road may be."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from termsel_match.images.rasters import FloatArray, GreyRaster

_PROFILE_STEP = 0.5
"""Distance of the columns of a strip, across the line [px]."""

_WIDTHS = (4.0, 6.0, 8.0, 10.0, 13.0)
"""Widths of bands that are tried [px]."""

_FLANK = 4.0
"""Width on either side of a band with which it is compared [px]."""

_BLOCK_LENGTH = 12.0
"""Length of a block along the band in which its position across is measured [px]."""

_BAND_DISTANCE = 5.0
"""Least distance of two bands from each other [px]."""

_EDGE_WIDTH = 2.5
"""Distance from the expected edge of a band within which the slope of the brightness counts [px].
"""

_BAND_REACH = 3.0
"""Distance from the expected middle of a band within which the blocks look for it [px]."""

_COMPARED = 40.0
"""Least width on either side of the line whose responses are compared [px]."""

_MIN_RESPONSE = 3.0
"""Least response of a band, divided by the median response of the strip."""

_LEAST_BLOCKS = 3
"""Fewest blocks that must show a band."""

_SEEN = 0.6
"""Least share of a column of the strip that must be known."""

_MIN_BAND_SIGMA = 0.1
"""Least standard deviation that is stated for the position of a band [px]."""


@dataclass(frozen=True, eq=False)
class Band:
    """A straight band of an image.

    Parameters
    ----------
    image : ndarray, shape (2, 2)
        Two positions on its middle line, line and sample [px].
    sigma : float
        Standard deviation of its position across [px].
    offset : float
        Signed distance, across, from the line next to which it was looked for [px].
    score : float
        Its response, divided by the median response of the strip.
    """

    image: FloatArray
    sigma: float
    offset: float
    score: float


def clearest_bands(picture: GreyRaster, ends: FloatArray, search: float, limit: int) -> list[Band]:
    """Return the clearest bands of an image that are nearly parallel to a line.

    Parameters
    ----------
    picture : GreyRaster
        The image.
    ends : ndarray, shape (2, 2)
        Both ends of the line, line and sample [px].
    search : float
        Largest distance of a band from the line [px].
    limit : int
        Largest number of bands.

    Returns
    -------
    list of Band
        The clearest first.
    """
    run = ends[1] - ends[0]
    length = float(np.linalg.norm(run))
    # Unit vectors along the line and across it.
    direction = run / length
    across = np.array([-run[1], run[0]]) / length
    compared = max(search, _COMPARED)
    reach = compared + max(_WIDTHS) / 2 + _FLANK + 2
    offset = np.arange(-reach, reach + _PROFILE_STEP / 2, _PROFILE_STEP)
    distance = np.arange(0.0, length + 0.5)
    at = ends[0] + distance[:, None, None] * direction + offset[:, None] * across
    low = np.floor(at.reshape(-1, 2).min(axis=0)).astype(int) - 1
    extent = np.ceil(at.reshape(-1, 2).max(axis=0)).astype(int) + 2 - low
    grey, grey_known = picture.read(int(low[0]), int(low[1]), int(extent[0]), int(extent[1]))
    # OpenCV takes columns before rows. The strip has a row for each px along the line.
    maps = [(at[..., axis] - low[axis]).astype(np.float32) for axis in (1, 0)]
    strip = cv2.remap(grey, *maps, cv2.INTER_LINEAR).astype(np.float64)
    is_known = cv2.remap(grey_known.astype(np.float32), *maps, cv2.INTER_LINEAR) > 0.999
    strip[~is_known] = np.nan
    count = is_known.sum(axis=0)
    # A band is clearer in the mean along the line than in any row.
    profile = np.where(is_known, strip, 0.0).sum(axis=0) / np.maximum(count, 1)
    profile[count < _SEEN * len(strip)] = np.nan
    responses = np.stack([_band_response(profile[None], width)[0] for width in _WIDTHS])
    # The largest response of all widths at each offset, to be compared with the rest of the strip.
    best = np.abs(np.nan_to_num(responses)).max(axis=0) * (np.abs(offset) <= compared)
    if not best.any():
        return []
    spread = float(np.median(best[best > 0]))
    best[np.abs(offset) > search] = 0.0
    clearest: list[Band] = []
    for i in np.argsort(-best):
        if len(clearest) == limit or best[i] < _MIN_RESPONSE * spread:
            break
        if all(abs(offset[i] - taken_band.offset) >= _BAND_DISTANCE for taken_band in clearest):
            clearest_width = int(np.nanargmax(np.abs(responses[:, i])))
            sign = float(np.sign(responses[clearest_width, i]))
            band = _place_of_band(strip, offset, float(offset[i]), _WIDTHS[clearest_width], sign)
            if band is not None:
                (first, last), sigma = band
                clearest.append(Band(np.stack([ends[0] + first * across, ends[1] + last * across]),
                                     sigma, (first + last) / 2, float(best[i] / spread)))
    return clearest


def _band_response(profiles: FloatArray, width: float) -> FloatArray:
    """Return how much each position of profiles (rows, n) is the middle of a band, (rows, n).

    It is the difference of the brightness to that of the flanks: the smaller of both, if they have
    the same sign, else 0, so that it is small at an edge. It is negative for dark bands, and NaN
    near the ends and near unknown positions.
    """
    half = round(width / 2 / _PROFILE_STEP)
    flank = round(_FLANK / _PROFILE_STEP)
    unknown = ~np.isfinite(profiles)
    # Sums up to each column: the mean of any stretch is a difference of two of them.
    total, gaps = (np.pad(np.cumsum(values, axis=1), ((0, 0), (1, 0)))
                   for values in (np.where(unknown, 0.0, profiles), unknown))
    n = profiles.shape[1]
    response = np.full(profiles.shape, np.nan)
    middle = np.arange(half + flank + 1, n - half - flank - 1)

    def mean(first: int, last: int) -> FloatArray:
        """Return the mean of the columns from `first` to `last`, counted from each middle."""
        return np.asarray((total[:, middle + last + 1] - total[:, middle + first])
                          / (last - first + 1))

    core = mean(-half + 1, half - 1)
    left_step = core - mean(-half - flank, -half - 1)
    right_step = core - mean(half + 1, half + flank)
    is_band = np.sign(left_step) == np.sign(right_step)
    value = np.where(is_band, np.sign(left_step)
                     * np.minimum(np.abs(left_step), np.abs(right_step)), 0.0)
    reach = half + flank
    gap = gaps[:, middle + reach + 1] > gaps[:, middle - reach]
    response[:, middle] = np.where(gap, np.nan, value)
    return response


def _middles_between_edges(
        profiles: FloatArray, offset: FloatArray, at: FloatArray, width: float) -> FloatArray:
    """Return the middles between the two edges of bright bands, (rows,).

    The response of a band is biased towards the flank that differs less from it, but its edges are
    not. An edge is the centroid of the squared slope of the brightness near its expected position;
    that position itself if there is no slope of the right sign.

    `profiles` (rows, n) are the brightness at offsets (n,), `at` (rows,) the expected middles of
    bands of the given width.
    """
    slope = np.nan_to_num(np.gradient(profiles, axis=1))
    edges = []
    for sign in (-1, 1):
        # The brightness rises at the left edge of a bright band, and falls at its right edge.
        near = np.abs(offset - (at + sign * width / 2)[:, None]) <= _EDGE_WIDTH
        weight = np.where(near, np.clip(-sign * slope, 0, None) ** 2, 0.0)
        total = weight.sum(axis=1)
        edges.append(np.where(total > 0, (weight * offset).sum(axis=1)
                              / np.where(total > 0, total, 1.0), at + sign * width / 2))
    return np.asarray(np.mean(edges, axis=0))


def _place_of_band(strip: FloatArray, offset: FloatArray, about: float, width: float, sign: float,
                   ) -> tuple[tuple[float, float], float] | None:
    """Return the offsets of a band in the first and last row of a strip, and their deviation [px].

    `strip` (rows, n) is the image along the band at offsets (n,) across; the band is expected at
    the offset `about`, and `sign` is 1 for a bright and -1 for a dark one. None if it is not clear
    in half of the blocks.
    """
    # The offset is measured in blocks along the band, to which a straight line is fitted.
    count = max(_LEAST_BLOCKS, round(len(strip) / _BLOCK_LENGTH))
    blocks = np.array_split(np.arange(len(strip)), count)
    means = np.stack([strip[block].mean(axis=0) for block in blocks])
    middles = np.array([block.mean() for block in blocks])
    near = np.flatnonzero(np.abs(offset - about) <= _BAND_REACH)
    value = sign * _band_response(means, width)[:, near]
    clear = np.flatnonzero(np.isfinite(value).all(axis=1) & (value.max(axis=1) > 0))
    if len(clear) < _LEAST_BLOCKS:
        return None
    # A first offset: the centroid of the responses above half of the largest.
    weight = np.clip(value[clear] - 0.5 * value[clear].max(axis=1, keepdims=True), 0, None)
    at = (weight * offset[near]).sum(axis=1) / weight.sum(axis=1)
    s = middles[clear]
    at = _middles_between_edges(sign * means[clear], offset, at, width)
    used = np.ones(len(s), dtype=bool)
    for _ in range(4):
        line = np.polynomial.Polynomial.fit(s[used], at[used], 1).convert()
        distances = np.abs(at - line(s))
        # The median of absolute normal errors is their standard deviation divided by 1.4826.
        spread = 1.4826 * float(np.median(distances[used]))
        near_line = distances <= max(3 * spread, 0.3)
        if near_line.sum() < _LEAST_BLOCKS:
            return None
        if np.array_equal(near_line, used):
            break
        used = near_line
    if used.sum() < 0.5 * count:
        return None
    # Standard deviation of the mean of the blocks; the line has taken two of their freedoms.
    rms = float(np.sqrt((distances[used] ** 2).sum() / max(1, used.sum() - 2)))
    return ((float(line(0.0)), float(line(len(strip) - 1.0))),
            max(rms / float(np.sqrt(used.sum())), _MIN_BAND_SIGMA))
