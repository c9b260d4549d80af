"""A picture of the candidates on the image: which agree, and by how much each is off."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from termsel import TermselError
from termsel.toolkit import write_bytes
from termsel_match.images.rasters import open_picture, stretch_to_bytes
from termsel_match.judgement.selection import SelectedCandidates

# Longest side of the picture [px].
_PICTURE_SIDE = 1200
# Px of the picture: the arrow of a residual that nine in ten do not exceed.
_ARROW = 40.0
_NICE = (1, 2, 5)
# Px of the legend.
_BAR = 34
# Blue, green, red, of Okabe and Ito's colours, which differ for colour-blind eyes too.
_BLUE = (233, 180, 86)
_VERMILION = (0, 94, 213)


def draw(image: Path | str, selected: SelectedCandidates, path: Path) -> None:
    """Draw the candidates over a reduced image, with their residuals, and write it as a PNG.

    Arrows are the residuals of the candidates that agree, and crosses are the others.

    Parameters
    ----------
    image : path-like
        The image that was matched.
    selected : SelectedCandidates
        The model, and which candidates agree with it.
    path : pathlib.Path
        File of the picture, which is written whole or not at all.

    Raises
    ------
    TermselError
        If a file cannot be read or written.
    """
    with open_picture(image) as picture:
        step = max(1, -(-max(picture.size) // _PICTURE_SIDE))
        grey = stretch_to_bytes(*picture.read(0, 0, *picture.size, step))
    if grey is None:
        raise TermselError("all pixels of the image are alike or without data, so it cannot be "
                           "drawn", file=image, hint="Give the image that was matched.")
    drawn = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    points = selected.points
    agrees = selected.agrees
    residuals = (points.image - selected.result.project(points.ground))[agrees]
    times = scale_of(residuals, step)
    # OpenCV takes whole numbers, here of 1/16 px (shift=4): a radius of 4 px is 4 << 4.
    for position, away in zip(points.image[agrees], residuals, strict=True):
        start, end = arrow_ends(position, away, times, step)
        cv2.arrowedLine(drawn, start, end, color=_BLUE, thickness=2, line_type=cv2.LINE_AA,
                        shift=4, tipLength=0.25)
        cv2.circle(drawn, start, 4 << 4, color=_BLUE, thickness=1, lineType=cv2.LINE_AA, shift=4)
    for position in points.image[~agrees]:
        at = [value >> 4 for value in _to_fixed_point(position, step)]
        cv2.drawMarker(drawn, at, _VERMILION, cv2.MARKER_TILTED_CROSS, markerSize=12, thickness=2,
                       line_type=cv2.LINE_AA)
    legend = np.full((_BAR, drawn.shape[1], 3), 255, dtype=np.uint8)
    text = (f"{int(agrees.sum())} agree (arrows: residuals x {times:g})   {int((~agrees).sum())} "
            "do not")
    cv2.putText(legend, text, (8, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.5, color=(0, 0, 0), thickness=1,
                lineType=cv2.LINE_AA)
    encoded, data = cv2.imencode(".png", np.concatenate([drawn, legend]))
    assert encoded
    write_bytes(path, data.tobytes())


def arrow_ends(position: np.ndarray, away: np.ndarray, times: float, step: int,
               ) -> tuple[list[int], list[int]]:
    """Return both ends of the arrow of a residual, as OpenCV draws them.

    It is larger by `times` in the scale of the image, which the picture reduces.
    """
    return _to_fixed_point(position, step), _to_fixed_point(position + times * away, step)


def scale_of(residuals: np.ndarray, step: int) -> float:
    """Return the factor by which the arrows of residuals (n, 2) [px] are enlarged: 1, 2, 5, 10, ...

    With it, nine in ten arrows are at most as long as `_ARROW`. `step` is how many px of the image
    a pixel of the picture spans.
    """
    length = np.linalg.norm(residuals, axis=1)
    usual = float(np.quantile(length, 0.9)) / step if len(length) else 0.0
    largest_scale = _ARROW / max(usual, 1e-6)
    power = 10.0 ** np.floor(np.log10(largest_scale))
    # The largest of 1, 2, 5, 10, 20, ... that is not above it.
    return float(max(factor * power for factor in _NICE if factor * power <= largest_scale))


def _to_fixed_point(position: np.ndarray, step: int) -> list[int]:
    """Return a place (line, sample) as OpenCV draws it: x and y in sixteenths of a reduced pixel.
    """
    return [int(value) for value in np.round(((position[::-1] + 0.5) / step - 0.5) * 16)]
