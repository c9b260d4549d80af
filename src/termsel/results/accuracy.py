"""The accuracy of a result in words: which figure is the surer one, and what the points show."""

from __future__ import annotations

from termsel.core.errors import count_in_words, interval_text, rounded_size_text
from termsel.data.record.figures import (
    MANY_INDEPENDENT,
    RARE,
    Accuracy,
    Predicted,
    is_determined_exactly,
)
from termsel.data.record.record import Record
from termsel.results.verdict import outliers_in_words

_ROUNDING_PX = 1e-9
"""Predicted RMSE [px] below which points without errors leave only rounding."""
_MEASURABLE = 0.01
"""RMSE [px] below which points were computed: nobody measures so well."""

PREDICTED_BY = "predicted by cross-validation"


def expected_rmse(record: Record) -> Predicted | None:
    """Return the RMSE predicted for the fit that is exported; None if none is predicted."""
    return (record.final_fit and record.final_fit.predicted) or record.predicted


def is_prediction_surer(record: Record) -> bool:
    """Return whether the predicted RMSE is surer than that of the independent check points."""
    return expected_rmse(record) is not None and (
        record.accuracy is None or record.accuracy.image.n < MANY_INDEPENDENT)


def accuracy_of(record: Record) -> str:
    """Return the accuracy in one sentence: the surer figure first."""
    return "; ".join(accuracy_lines(record))


def accuracy_lines(record: Record) -> list[str]:
    """Return what is known of the accuracy in one to four short lines.

    There are up to two figures: the RMSE measured at independent check points, which may be few,
    and the RMSE that cross-validation predicts. The surer one comes first, the second line says
    whether they agree, and further lines say why either may mislead. Where points were computed, or
    are the lattice of a product, an RMSE is no accuracy, and the lines say so.
    """
    accuracy = record.accuracy
    if lattice_of(record) is not None and accuracy is None:
        return _interpolation_lines(record)
    if are_computed(record):
        return [agreement_of_computed(record)]
    # The prediction must be of the fit that the points measured; that of the exported one has seen
    # them.
    if accuracy and not is_prediction_surer(record):
        predicted = record.predicted
    else:
        predicted = expected_rmse(record)
    if accuracy is None:
        return _accuracy_without_check_points(record, predicted)
    if are_places_wrong(record):
        return ["not known: points whose coordinates are wrong are among the independent check "
                "points, which contradict the model"]
    if predicted is None:
        return [_rmse_at_check_points(accuracy), *_doubt_clauses(record, accuracy)]
    if is_prediction_surer(record):
        # Points without errors leave a prediction of rounding, whose ratio to anything means
        # nothing.
        if predicted.high < _ROUNDING_PX:
            return ["the points fit exactly", _rmse_at_check_points(accuracy),
                    *_doubt_clauses(record, accuracy)]
        # The line above says that this is an RMSE, and the level of the interval.
        measured = _rmse_at_check_points(accuracy).replace("RMSE at", "at")
        level = f"[{100 * predicted.level:.0f} %: "
        return [_prediction_sentence(predicted),
                f"{measured.replace(level, '[')}{_agreement_text(accuracy, predicted)}",
                *_doubt_clauses(record, accuracy)]
    return [_rmse_at_check_points(accuracy),
            f"{_predicted_by(predicted)} {rounded_size_text(predicted.rmse)} px"
            f"{_agreement_text(accuracy, predicted)}", *_doubt_clauses(record, accuracy)]


def lattice_of(record: Record) -> tuple[int, int] | None:
    """Return how many lines and columns the lattice of the points has; None without a lattice."""
    return record.data.read.lattice if record.data.read else None


def are_computed(record: Record) -> bool:
    """Return whether the model predicts held-out points more closely than anyone measures."""
    # Of simulated data the noise is known, and may be none.
    if record.data.noise is not None or lattice_of(record) is not None:
        return False
    expected = expected_rmse(record)
    if record.accuracy is not None:
        # Both figures must be too small to be measured: one of them may be small by luck.
        return max(record.accuracy.image.total, expected.high if expected else 0.0) < _MEASURABLE
    return expected is not None and _ROUNDING_PX <= expected.high < _MEASURABLE


def agreement_of_computed(record: Record) -> str:
    """Return that a model meets points that were computed, and that this is no accuracy."""
    expected = expected_rmse(record)
    if record.accuracy:
        rmse = record.accuracy.image.total
    elif expected:
        rmse = expected.rmse
    else:
        rmse = 0.0
    agreement = f"within {rounded_size_text(rmse)} px" if rmse >= _ROUNDING_PX else "to rounding"
    return (f"the model predicts held-out points {agreement}, closer than anyone "
            "measures. They were computed, or one column is a copy of another: the accuracy "
            "cannot be estimated")


def _interpolation_lines(record: Record) -> list[str]:
    """Return how well a model interpolates between the points of a lattice, or meets them.

    In one or two lines, the last of which says that the accuracy of the product is not known.
    """
    expected = expected_rmse(record)
    # A lattice says how its own geometry is, not where the ground is.
    unknown = "the points were computed, so the accuracy of the product is not known"
    if expected is not None:
        return [f"{rounded_size_text(expected.rmse)} px   RMSE {PREDICTED_BY} between the points "
                "of the lattice "
                f"{interval_text(expected.low, expected.high, 100 * expected.level)}",
                unknown]
    control = record.rmse.control
    return [unknown] if control.total is None else [
        f"the model meets the points of the lattice to {rounded_size_text(control.total)} px",
        unknown]


def _accuracy_without_check_points(record: Record, predicted: Predicted | None) -> list[str]:
    """Return the clauses on accuracy for a record without independent check points."""
    counts = record.data.counts
    if is_exact(record):
        exactly = is_determined_exactly(counts.control + counts.check, "point")
        return [f"not known: {exactly}; measure at least one more"]
    if predicted is None:
        return ["not known: no independent check points"]
    # Errors of the size of rounding are those of computed points, and predict nothing.
    if predicted.high < _ROUNDING_PX:
        return ["the points fit exactly; not verified: no independent check points"]
    return [_prediction_sentence(predicted), "not verified: no independent check points"]


def is_exact(record: Record) -> bool:
    """Return whether the accuracy is not known since points determine the model exactly."""
    return (record.accuracy is None and expected_rmse(record) is None
            and lattice_of(record) is None and bool(record.strategy)
            and record.adjustment.redundancy == 0 and record.data.counts.word == "points")


def _prediction_sentence(predicted: Predicted) -> str:
    """Return the predicted RMSE in px, and in metres where the size of a pixel is known."""
    if predicted.pixel:
        ground = f" / {rounded_size_text(predicted.rmse * predicted.pixel)} m"
    else:
        ground = ""
    return (f"{rounded_size_text(predicted.rmse)} px{ground}   RMSE {_predicted_by(predicted)} "
            f"{interval_text(predicted.low, predicted.high, 100 * predicted.level)}")


def _predicted_by(predicted: Predicted) -> str:
    """Return how an RMSE was found, and that points counted by what they state of themselves."""
    return f"{PREDICTED_BY}, by the stated sigmas," if predicted.weighted is True else PREDICTED_BY


def _rmse_at_check_points(accuracy: Accuracy) -> str:
    """Return the RMSE at the independent check points, with its interval."""
    image = accuracy.image
    ground = f" / {rounded_size_text(accuracy.ground.total)} m" if accuracy.ground else ""
    return (f"{rounded_size_text(image.total)} px{ground}   RMSE at "
            f"{count_in_words(image.n, 'independent check point')} "
            f"{interval_text(*image.interval)}")


def are_places_wrong(record: Record) -> bool:
    """Return whether the RMSE at independent check points is one of wrong coordinates.

    So it is where the points read have coordinates that cannot all be places (zeros, another zone,
    minutes for degrees), and the RMSE is beyond what chance allows for the predicted one.
    """
    read = record.data.read
    predicted = expected_rmse(record)
    if read is None or not read.mixed or record.accuracy is None or predicted is None:
        return False
    measured = record.accuracy.image.total
    return measured > predicted.high and predicted.chance_beyond(measured) < RARE


def _agreement_text(accuracy: Accuracy, predicted: Predicted) -> str:
    """Return how a line on the measured RMSE ends, from its colon on.

    It says that the measured RMSE lies in the interval of the predicted one (consistent), is
    outside by chance, or that the prediction was too small or too large. A prediction by stated
    standard deviations is of points as good as the best ones, and "" is returned.
    """
    if predicted.weighted is True:
        return ""
    measured = accuracy.image.total
    if predicted.low <= measured <= predicted.high:
        return ": consistent"
    is_above = measured > predicted.high
    chance = predicted.chance_beyond(measured)
    if chance < RARE:
        return f": the prediction was too {'small' if is_above else 'large'}"
    # One measured value in ten lies outside its interval; how far outside shows more.
    return f": such a gap has a chance of {100 * chance:.0f} %"


def _doubt_clauses(record: Record, accuracy: Accuracy) -> list[str]:
    """Return clauses on blunders among the points and on earlier use, if any: both weaken the RMSE.
    """
    lines = []
    if without := record.accuracy_without:
        lines.append(f"{rounded_size_text(without.image.total)} px without "
                     f"{outliers_in_words(record)}")
    if reused := reused_points_in_words(accuracy):
        lines.append(f"{reused} already assessed another fit; new ones would tell more surely")
    return lines


def reused_points_in_words(accuracy: Accuracy) -> str:
    """Return which of the independent check points have assessed an earlier fit, in words.

    Returns "" if none of them has.

    An RMSE that somebody has seen and then acted on is no longer independent. Where fewer than half
    of the points were seen, it is not spoiled by much, and the first screen is silent.
    """
    reused = accuracy.spent_count
    n = accuracy.image.n
    if not reused or 2 * reused < n:
        return ""
    return "these points" if reused == n else f"{reused} of these points"
