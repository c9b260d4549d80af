"""Files in which two coordinates were exchanged: x and y, or line and sample."""

from __future__ import annotations

from dataclasses import replace

from termsel.core.options import Option
from termsel.data.features import FeatureSet

XY, LINE_SAMPLE = "xy", "line-sample"

SWAPPED = Option(
    "swapped", None, "Coordinates that the file has exchanged: x and y on the ground, or line and "
    "sample. They are exchanged back, whatever the format.", choices=(XY, LINE_SAMPLE))

_SWAPPED_GROUND_ORDER = [1, 0, 2]  # y, x, z
_IMAGE = [1, 0]  # sample, line


def exchange_back(features: FeatureSet, choice: str | None) -> FeatureSet:
    """Return features with the coordinates exchanged that their file has the other way round.

    Parameters
    ----------
    features : FeatureSet
        As they were read, before an origin of the image is applied to them.
    choice : {"xy", "line-sample"}, optional
        By default nothing is exchanged.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> points = termsel.Points(["A"], image=[[10.0, 20.0]], ground=[[5.8e6, 4.4e5, 0.0]])
    >>> features = termsel.FeatureSet(points=points, crs="EPSG:32633")
    >>> exchange_back(features, "xy").points.ground.tolist()
    [[440000.0, 5800000.0, 0.0]]
    """
    if choice is None:
        return features
    points = features.points
    lines = features.lines
    if SWAPPED.parse(choice) == XY:
        return features.with_(points=replace(points,
                                             ground=points.ground[:, _SWAPPED_GROUND_ORDER]),
                              lines=replace(lines, ground=lines.ground[..., _SWAPPED_GROUND_ORDER]))
    # Standard deviations are of line and sample, and go with them.
    sigma = None if points.sigma is None else points.sigma[:, _IMAGE]
    return features.with_(points=replace(points, image=points.image[:, _IMAGE], sigma=sigma),
                          lines=replace(lines, image=lines.image[..., _IMAGE]))
