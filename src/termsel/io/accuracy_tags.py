"""What the metadata of a map say of its accuracy."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from termsel.core.version import __version__
from termsel.report.accuracy import expected_of, predicted_first

if TYPE_CHECKING:
    from termsel.results.result import Result


def accuracy_tags(result: Result) -> dict[str, str]:
    """Return tags of a TIFF: accuracy as predicted or of the run on independent points; date.

    The first figure is the surer one, as in the summary. A final fit has used the independent
    points too, so theirs is the accuracy of the fit before.
    """
    written_at = datetime.now(UTC)
    tags = {"TIFFTAG_SOFTWARE": f"termsel {__version__}", "ACCURACY_DATE": f"{written_at:%Y-%m-%d}",
            "TIFFTAG_DATETIME": f"{written_at:%Y:%m:%d %H:%M:%S}"}
    record = result.record
    accuracy = result.accuracy
    expected = expected_of(record)
    predicted = "" if expected is None else (
        f"predicted RMSE {expected.rmse:.3g} px "
        f"({100 * expected.level:g} % interval {expected.low:.3g} to {expected.high:.3g} px)")
    if accuracy is None:
        tags["ACCURACY_STATED"] = "no: the result has no independent check points" + (
            f"; {predicted}" if predicted else "")
        return tags
    stated = "by independent check points, used in no choice" + (
        f" of this run; an earlier result showed {accuracy.spent_count} of them"
        if accuracy.spent_count else "")
    # As in the summary, the surer of both figures is said first.
    tags["ACCURACY_STATED"] = f"{predicted}; below {stated}" if predicted_first(record) else stated
    tags["ACCURACY_POINTS"] = str(accuracy.image.n)
    low, high = accuracy.image.interval
    tags["ACCURACY_RMSE_PX_INTERVAL"] = f"{low:.4g} to {high:.4g} (90 %)"
    for unit, figures in (("PX", accuracy.image), ("M", accuracy.ground)):
        if figures is not None:
            tags[f"ACCURACY_RMSE_{unit}"] = f"{figures.total:.4g}"
            tags[f"ACCURACY_CE90_{unit}"] = f"{figures.ce90:.4g}"
    return tags
