"""The accuracy of a result in words: which figure is the surer one, and what the points tell."""

from __future__ import annotations

from termsel.core.display.numbers import interval, rounded
from termsel.core.errors import counted
from termsel.data.record.figures import MANY_INDEPENDENT, Accuracy, Predicted
from termsel.data.record.record import Record
from termsel.report.verdict import contradicting

_ROUNDING = 1e-9
"""Predicted RMSE [px] below which points without errors leave only rounding."""

PREDICTED_BY = "predicted by cross-validation"


def expected_of(record: Record) -> Predicted | None:
    """Return the RMSE predicted for the fit that is exported, if one is."""
    return (record.final and record.final.predicted) or record.predicted


def predicted_first(record: Record) -> bool:
    """Return whether the predicted RMSE is surer than that of the independent check points."""
    return expected_of(record) is not None and (
        record.accuracy is None or record.accuracy.image.n < MANY_INDEPENDENT)


def accuracy_of(record: Record) -> str:
    """Return the accuracy in one sentence: the surer figure first."""
    return "; ".join(accuracy_lines(record))


def accuracy_lines(record: Record) -> list[str]:
    """Return the accuracy in one to four short lines: the surer figure first."""
    accuracy = record.accuracy
    predicted = record.predicted if accuracy and not predicted_first(record) else \
        expected_of(record)
    if accuracy is None:
        return _unverified(predicted)
    if predicted is None:
        return [_measured(accuracy), *_doubts(record, accuracy)]
    if predicted_first(record):
        if predicted.high < _ROUNDING:
            return ["the points fit exactly", _measured(accuracy), *_doubts(record, accuracy)]
        return [_prediction(predicted), f"{_measured(accuracy)}{_agreement(accuracy, predicted)}",
                *_doubts(record, accuracy)]
    return [_measured(accuracy), f"{PREDICTED_BY} {rounded(predicted.rmse)} px"
            f"{_agreement(accuracy, predicted)}", *_doubts(record, accuracy)]


def _unverified(predicted: Predicted | None) -> list[str]:
    """Return what is known without independent check points."""
    if predicted is None:
        return ["not known: no independent check points"]
    if predicted.high < _ROUNDING:
        return ["the points fit exactly; not verified: no independent check points"]
    return [_prediction(predicted), "not verified: no independent check points"]


def _prediction(predicted: Predicted) -> str:
    return (f"{rounded(predicted.rmse)} px   RMSE {PREDICTED_BY} "
            f"{interval(predicted.low, predicted.high, 100 * predicted.level)}")


def _measured(accuracy: Accuracy) -> str:
    """Return the RMSE at the independent check points, with its interval."""
    image = accuracy.image
    ground = f" / {rounded(accuracy.ground.total)} m" if accuracy.ground else ""
    return (f"{rounded(image.total)} px{ground}   RMSE at "
            f"{counted(image.n, 'independent check point')} {interval(*image.interval)}")


def _agreement(accuracy: Accuracy, predicted: Predicted) -> str:
    """Return whether the measured RMSE lies in the interval of the predicted one."""
    measured = accuracy.image.total
    if measured > predicted.high:
        return ", larger than predicted"
    return ", smaller than predicted" if measured < predicted.low else ", as predicted"


def _doubts(record: Record, accuracy: Accuracy) -> list[str]:
    """Return what makes the measured RMSE doubtful: blunders among the points, earlier use."""
    lines = []
    if without := record.accuracy_without:
        lines.append(f"{rounded(without.image.total)} px without {contradicting(record)}")
    if reused := reused_points(accuracy):
        lines.append(f"{reused} already assessed another fit: perhaps optimistic")
    return lines


def reused_points(accuracy: Accuracy) -> str:
    """Return which of the independent check points have assessed an earlier fit; "" for none.

    An RMSE that somebody has seen and then acted on is no longer independent. Where fewer than half
    of the points were seen, it is not spoiled by much, and the first screen is silent.
    """
    reused = accuracy.spent_count
    n = accuracy.image.n
    if not reused or 2 * reused < n:
        return ""
    return "these points" if reused == n else f"{reused} of these points"
