"""What the metadata of a map say of its accuracy."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from termsel.version import __version__

if TYPE_CHECKING:
    from termsel.results.result import Result


def accuracy_tags(result: Result) -> dict[str, str]:
    """Return tags of a TIFF: accuracy of the run on independent points, or as predicted; date.

    A final fit has used the independent points too, so theirs is the accuracy of the fit before.
    """
    now = datetime.now(UTC)
    tags = {"TIFFTAG_SOFTWARE": f"termsel {__version__}", "ACCURACY_DATE": f"{now:%Y-%m-%d}",
            "TIFFTAG_DATETIME": f"{now:%Y:%m:%d %H:%M:%S}"}
    if result.accuracy is None:
        expected = result.predicted
        tags["ACCURACY_STATED"] = "no: the result has no independent points" + (
            "" if expected is None else f"; predicted RMSE {expected.rmse:.3g} px "
            f"({100 * expected.level:g} % interval {expected.low:.3g} to {expected.high:.3g} px)")
        return tags
    image, ground = result.accuracy.image, result.accuracy.ground
    tags["ACCURACY_STATED"] = "by independent points, which took no part in any choice"
    tags["ACCURACY_POINTS"] = str(image.n)
    for unit, known in (("PX", image), ("M", ground)):
        if known is not None:
            tags[f"ACCURACY_RMSE_{unit}"] = f"{known.total:.4g}"
            tags[f"ACCURACY_CE90_{unit}"] = f"{known.ce90:.4g}"
    return tags
