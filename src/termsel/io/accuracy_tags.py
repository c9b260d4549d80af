"""What the metadata of a map, and statements to sign, say of its accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from termsel.core.errors import count_in_words
from termsel.core.version import __version__
from termsel.data.record.cautions import limits_of_accuracy
from termsel.fitting.accuracy import pixel_on_ground
from termsel.formats.heights import HeightCaution
from termsel.results.accuracy import are_computed, expected_rmse, is_prediction_surer, lattice_of

if TYPE_CHECKING:
    from termsel.results.result import Result


@dataclass(frozen=True)
class Prediction:
    """The accuracy that a run predicts, where no independent test says it.

    Parameters
    ----------
    rmse, low, high : float
        RMSE of points, and the interval that holds it with probability `level` [px].
    level : float
    pixel : float or None
        How far a pixel is on the ground [m], where the CRS shows metres.
    method : str
        How it was found, in a clause.
    points : int
        Points that it rests on.
    """

    rmse: float
    low: float
    high: float
    level: float
    pixel: float | None
    method: str
    points: int

    @property
    def metres(self) -> tuple[float, float, float] | None:
        """RMSE and its interval on the ground [m]; None if the size of a pixel is not known."""
        # The interval is scaled as the RMSE is: the size of a pixel is the same for both.
        size = self.pixel
        return None if size is None else (size * self.rmse, size * self.low, size * self.high)

    @property
    def sentence(self) -> str:
        """The prediction in one sentence, which never calls it a test."""
        ground = ""
        if self.metres is not None:
            rmse, low, high = self.metres
            ground = f", on the ground {rmse:.3g} m ({low:.3g} to {high:.3g} m)"
        return (f"Predicted, not tested by independent check points: RMSE {self.rmse:.3g} px "
                f"({100 * self.level:g} % interval {self.low:.3g} to {self.high:.3g} px){ground}; "
                f"found {self.method}")


def prediction_of(result: Result) -> Prediction | None:
    """Return the accuracy that a result predicts; None where it predicts none.

    Returns None, too, where the points were computed, or are the lattice of a product: they do not
    show how well anybody measures in the image.
    """
    expected = expected_rmse(result)
    if expected is None or are_computed(result) or lattice_of(result) is not None:
        return None
    control = result.fit.control
    points = len(control.points)
    if result.strategy is not None:
        # The choice is by control and selection points; a fit may have fewer, or the independent
        # points, too.
        chosen_by = {*result.data.roles.control, *result.data.roles.check}
        points = sum(name in chosen_by for name in result.features.points.ids)
    lines = len(control.lines)
    noun = "control feature" if points and lines else "control line" if lines else "control point"
    features = count_in_words(points + lines, noun)
    # An image of a block shares its control with others, which its own cross-validation would not
    # take into account.
    if result.shared_sigma is not None:
        method = ("by the adjustment of the block that the image is part of, from the scatter of "
                  "its control and ties")
    elif result.strategy is not None:
        method = (f"by cross-validation: the whole choice of the model was repeated "
                  f"{count_in_words(result.strategy.folds, 'time')} without some of the "
                  f"{features}, and predicted those")
    else:
        method = f"by cross-validation of {features}"
    return Prediction(expected.rmse, expected.low, expected.high, expected.level,
                      pixel=pixel_on_ground(result.fit), method=method, points=points)


_HARMLESS = 1 / 3
"""Effect of wrong heights by the RMSE up to which the RMSE holds: it makes it 5 % larger."""


def accuracy_tags(result: Result, heights: HeightCaution | None = None) -> dict[str, str]:
    """Return the tags of a TIFF that state its accuracy, the program and the date, by name.

    The accuracy is that predicted, and that measured at independent points; the surer of the two
    comes first, as in the summary. A final fit has used the independent points too, so that theirs
    is the accuracy of the fit before. A caution on the `heights` of the map is among the tags. If
    its effect is not small against the accuracy, no figures are stated, as the map does not have
    them.
    """
    # One time for both tags, which different readers take.
    written_at = datetime.now(UTC)
    tags = {"TIFFTAG_SOFTWARE": f"termsel {__version__}", "ACCURACY_DATE": f"{written_at:%Y-%m-%d}",
            "TIFFTAG_DATETIME": f"{written_at:%Y:%m:%d %H:%M:%S}"}
    accuracy = result.accuracy
    expected = expected_rmse(result)
    cautions = limits_of_accuracy(result.notes)
    if heights is not None:
        cautions.insert(0, heights.sentence)
    if cautions:
        tags["ACCURACY_CAUTION"] = " ".join(
            f"{caution.removesuffix('.')}." for caution in cautions)
    if heights is not None:
        rmse = [] if expected is None else [expected.rmse]
        if accuracy is not None:
            rmse.append(accuracy.image.total)
        if rmse and heights.pixels > _HARMLESS * min(rmse):
            return tags | {"ACCURACY_STATED": "no: that of the model is not that of this map, see "
                                              "ACCURACY_CAUTION"}
    predicted = "" if expected is None else (
        f"predicted RMSE {expected.rmse:.3g} px "
        f"({100 * expected.level:g} % interval {expected.low:.3g} to {expected.high:.3g} px)")
    if accuracy is None:
        tags["ACCURACY_STATED"] = "no: the result has no independent check points" + (
            f"; {predicted}" if predicted else "")
        return tags | _tags_of_prediction(prediction_of(result))
    stated = "by independent check points, used in no choice" + (
        f" of this run; an earlier result showed {accuracy.spent_count} of them"
        if accuracy.spent_count else "")
    if is_prediction_surer(result):
        tags["ACCURACY_STATED"] = f"{predicted}; below {stated}"
        tags |= _tags_of_prediction(prediction_of(result))
    else:
        tags["ACCURACY_STATED"] = stated
    tags["ACCURACY_POINTS"] = str(accuracy.image.n)
    low, high = accuracy.image.interval
    tags["ACCURACY_RMSE_PX_INTERVAL"] = f"{low:.4g} to {high:.4g} (90 %)"
    # A result in a plane without a CRS has no metres.
    for unit, figures in (("PX", accuracy.image), ("M", accuracy.ground)):
        if figures is not None:
            tags[f"ACCURACY_RMSE_{unit}"] = f"{figures.total:.4g}"
            tags[f"ACCURACY_CE90_{unit}"] = f"{figures.ce90:.4g}"
    return tags


def _tags_of_prediction(prediction: Prediction | None) -> dict[str, str]:
    """Return tags of a predicted accuracy, with the way in which it was found; {} without one.

    Those in metres are left out in coordinates without a unit.
    """
    if prediction is None:
        return {}
    tags = {"ACCURACY_PREDICTED_RMSE_PX": f"{prediction.rmse:.4g}",
            "ACCURACY_PREDICTED_RMSE_PX_INTERVAL":
                f"{prediction.low:.4g} to {prediction.high:.4g} ({100 * prediction.level:g} %)",
            "ACCURACY_PREDICTED_BY":
                f"{prediction.method}; within the control; not an independent test"}
    if prediction.metres is not None:
        rmse, low, high = prediction.metres
        tags["ACCURACY_PREDICTED_RMSE_M"] = f"{rmse:.4g}"
        tags["ACCURACY_PREDICTED_RMSE_M_INTERVAL"] = (
            f"{low:.4g} to {high:.4g} ({100 * prediction.level:g} %)")
    return tags
