"""What of an image has ground: all of it, or what is below the horizon and about as far as control.

A file that holds a model alone, such as an RPC or an affine map, gives each place of the image a
place on the ground, the sky included, and puts places behind the camera into the sky, mirrored.
"""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FloatArray
from termsel.data.locate import Surface
from termsel.fitting.fit import Fit

SKY = "above the horizon"
FAR_OR_SKY = f"{SKY} or much farther away than any control"
NEAR_OR_FAR = "much nearer or farther away than any control"

_SKY_NODES_ACROSS = 41  # places along either side of the image by which parts of it are told


def image_places(fitted: Fit, across: int = _SKY_NODES_ACROSS) -> FloatArray:
    """Return lines and samples of a grid over the image, its corners included, (across^2, 2)."""
    (first_line, first_sample), (last_line, last_sample) = fitted.image_box()
    lines = np.linspace(first_line, last_line, across)
    samples = np.linspace(first_sample, last_sample, across)
    return np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)


def middle_height(fitted: Fit) -> float:
    """Return the middle height of the control, in the unit of z; 0 where it is not known."""
    middle, *_ = fitted.ground_box()
    return float(np.nan_to_num(middle[2]))


def ground_where_held(fitted: Fit, image: FloatArray, heights: FloatArray | float | Surface,
                      ) -> FloatArray:
    """Return the ground seen at image places (n, 2), shape (n, 3); NaN where the model has none.

    The model has no ground, either, where it does not hold (see `Fit.holds`): close to the horizon
    a pixel is kilometres long, and shows nothing of them.
    """
    ground = fitted.locate(image, heights)
    ground[~fitted.holds(ground)] = np.nan
    return ground


def sky_of(fitted: Fit, image: FloatArray) -> BoolArray:
    """Return which image places (n, 2) are above the horizon, and have no ground by the model."""
    above = fitted.above_horizon(image)
    above[above] = np.isnan(fitted.locate(image[above], middle_height(fitted))).any(axis=1)
    return above


def refuse_sky(fitted: Fit, product: str) -> None:
    """Refuse to write a product that gives all of the image a place on the ground.

    Parameters
    ----------
    fitted : Fit
        What would be written.
    product : str
        What it would be written as, with its article, such as "an RPC".

    Raises
    ------
    TermselError
        If the sky is in the image.
    """
    sky = sky_said(fitted)
    if sky:
        raise TermselError(
            f"{sky}, and {product} would give it ground",
            hint="Rectify the image, or export it as geolocation-vrt: both leave the sky empty. "
                 "Or crop the image below the horizon, and measure it there.")


def why_not_shown(fitted: Fit) -> str:
    """Return why a part of the image of a view has no ground; "" where control supports none."""
    if fitted.view is None:
        return ""
    return FAR_OR_SKY if fitted.above_horizon(image_places(fitted, 2)).any() else NEAR_OR_FAR


def sky_said(fitted: Fit) -> str:
    """Return a clause on how much of the image is above the horizon; "" if nothing is."""
    share = float(sky_of(fitted, image_places(fitted)).mean())
    return f"{_percent_text(share)} of the image is {SKY}" if share else ""


def part_said(fitted: Fit) -> str:
    """Return a clause on how much of the image the model does not hold for; "" if for all."""
    if fitted.view is None:
        return ""
    ground = ground_where_held(fitted, image_places(fitted), middle_height(fitted))
    share = float(np.isnan(ground[:, :2]).any(axis=1).mean())
    return f"{_percent_text(share)} of the image is {why_not_shown(fitted)}" if share else ""


def _percent_text(share: float) -> str:
    """Return a share as a whole number of per cent, at least 1."""
    return f"about {max(100 * share, 1):.0f} %"
