"""What each image of a batch is fit for: a verdict with its reason.

Where an accuracy is asked for, the interval of the RMSE decides: an image is fit for use where all
of the interval meets it, unfit where none does, and doubtful between. Where none is asked for, no
image is fit for anything: it is unfit where it has no result or where its axes or signs look wrong,
doubtful where something contradicts its figures, or where they are known only to a factor of
`WIDE`, and else plausible. Either way an
image is doubtful where a caution says what the accuracy does not vouch for, as away from points on
one line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.core.errors import TermselError, count_in_words, rounded_size_text
from termsel.data.record.cautions import limits_of_accuracy, size_in_caution
from termsel.data.record.figures import EXACTLY, MANY_INDEPENDENT, rmse_interval
from termsel.data.record.search import clauses_on_unused_data
from termsel.studies.cells.neighbours import ELSEWHERE

FIT, PLAUSIBLE, DOUBTFUL, UNFIT = VERDICTS = "fit for use", "plausible", "doubtful", "unfit"

USABLE = (FIT, PLAUSIBLE)
"""Verdicts with which an image gets a map."""

MEANING_OF_PLAUSIBLE = ("plausible: nothing contradicts the figures. Whether they suffice for a "
                        "purpose, --accept decides, such as --accept 5m.")

MANY_BLUNDERS = 0.2
"""Share of the points that are blunders, from which on the rest is doubted, too."""

WIDE = 4.0
"""Upper end of the 90 % interval of an RMSE by its lower end, beyond which the RMSE is not known
within a factor of two either way: too little to say what an image is fit for."""

UNLIKE = 4.0
"""RMSE by the median of the batch from which on an image stands out."""

FEW_IMAGES = 4
"""Images below which none stands out."""

_ACCEPT = re.compile(r"\s*([0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*(px|m)\s*")


@dataclass(frozen=True)
class Accept:
    """The largest RMSE that is accepted."""

    size: float
    unit: str

    @classmethod
    def of(cls, text: str) -> Accept:
        """Return the accuracy that a text such as "5m" or "2px" asks for.

        Raises
        ------
        TermselError
            If it is no number with the unit m or px.
        """
        match = _ACCEPT.fullmatch(text)
        if match is None or not 0.0 < float(match[1]) < math.inf:
            raise TermselError(f"--accept is {text!r:.40}, expected a length with its unit",
                               hint="Give the largest RMSE that is accepted: 5m or 2px.")
        return cls(float(match[1]), match[2])

    def __str__(self) -> str:
        return f"{self.size!r}{self.unit}"

    def pixels(self, metres_per_pixel: float | None) -> float:
        """Return the size in px, or 0.0 if it is in metres and the size of a pixel is not known."""
        if self.unit == "px":
            return self.size
        return self.size / metres_per_pixel if metres_per_pixel else 0.0


def verdicts_of(rows: Sequence[Mapping[str, Any]], accept: Accept | None) -> list[tuple[str, str]]:
    """Return the verdict on each image of a batch, and why; "" for cells that are not finished.

    Rows are those of the table of a study, with their figures.
    """
    usual = _median_rmse(rows)
    return [_verdict_on_image(row, accept, usual) for row in rows]


def _median_rmse(rows: Sequence[Mapping[str, Any]]) -> float:
    """Return the median RMSE of the images [px]; infinite where fewer than FEW_IMAGES have one."""
    rmses = []
    for row in rows:
        interval = _rmse_interval(row, "px")
        if interval is not None:
            rmses.append(interval[1])
    return float(np.median(rmses)) if len(rmses) >= FEW_IMAGES else math.inf


def _verdict_on_image(
        row: Mapping[str, Any], accept: Accept | None, usual: float) -> tuple[str, str]:
    """Return the verdict on an image of a batch, such as `FIT` or `DOUBTFUL`, and its reason.

    `row` is the image's row in the table, `accept` is the RMSE that the user asks for, and `usual`
    is the median RMSE of the batch [px]. An image is doubtful where the interval of its RMSE spans
    the accepted size and, without one, where anything contradicts its figures; where auto has
    failed it is unfit. Rows that wait, and those of searches, have no verdict: both texts are "".
    """
    if row["strategy"] != "auto" or row["state"] == "waiting":
        return "", ""
    if row["state"] != "done":
        return UNFIT, str(row["reason"] or "no result")
    doubt = str(row["doubt"] or "")
    # A mirror image may be one on purpose, and an image far from the others of somewhere else;
    # exchanged axes and signs are wrong.
    if doubt and "mirror" not in doubt and ELSEWHERE not in doubt:
        return UNFIT, doubt
    against = _contradiction_clauses(row, usual, accept)
    if accept is None:
        if _rmse_interval(row, "px") is None:
            return DOUBTFUL, f"its accuracy cannot be estimated{_why_unknown(row)}"
        against += _too_uncertain_clause(row)
        if against:
            return DOUBTFUL, "; ".join(against)
        return PLAUSIBLE, f"nothing contradicts its figures{_how_verified(row)}"
    interval = _rmse_interval(row, accept.unit)
    if interval is None:
        return DOUBTFUL, f"its RMSE is not known in {accept.unit}"
    low, rmse, high = interval
    asked = f"{accept.size:g} {accept.unit}"
    figure = (f"RMSE {rounded_size_text(rmse)} {accept.unit} ({rounded_size_text(low)} to "
              f"{rounded_size_text(high)})")
    if low > accept.size:
        return UNFIT, f"{figure}, and {asked} is asked for"
    if high > accept.size:
        return DOUBTFUL, "; ".join([f"{figure}, so {asked} is not certain", *against])
    if against:
        return DOUBTFUL, "; ".join(against)
    return FIT, f"{figure} meets {asked}{_how_verified(row)}"


def _too_uncertain_clause(row: Mapping[str, Any]) -> list[str]:
    """Return a clause on an RMSE whose interval is wider than the factor WIDE, in a list, or [].
    """
    interval = _rmse_interval(row, "px")
    if interval is None or interval[2] <= WIDE * interval[0]:
        return []
    low, _, high = interval
    points = count_in_words((row["n_control"] or 0) + (row["n_check"] or 0), "point")
    return [f"{points} leave its RMSE between {rounded_size_text(low)} and "
            f"{rounded_size_text(high)} px"]


def _why_unknown(row: Mapping[str, Any]) -> str:
    """Return why the accuracy of an image is not known, as the end of a clause; "" if unclear."""
    points = count_in_words(row["n_control"] or 0, "control point")
    if any(EXACTLY in note for note in row["notes"] or ()):
        return f": {points} determine the model exactly; measure at least one more"
    if (row["n_control"] or 0) < MANY_INDEPENDENT:
        return f": {points} are too few to be left out in turn; measure more"
    return ""


def _how_verified(row: Mapping[str, Any]) -> str:
    """Return how an RMSE is known: by independent check points, or not verified by any."""
    number = row["n_independent"] or 0
    if number:
        return f"; {count_in_words(number, 'independent check point')}"
    return "; not verified, as there are no independent check points"


def _rmse_interval(row: Mapping[str, Any], unit: str) -> tuple[float, float, float] | None:
    """Return the RMSE of an image between the ends of its 90 % interval: low, RMSE, high.

    It is the RMSE that independent points show, where there are many or none is predicted, else the
    predicted one. `unit` is "px" or "m". Returns None where there is no RMSE, or no pixel size for
    metres.
    """
    n_independent = row["n_independent"] or 0
    measured = row["independent"]
    predicted = row["predicted"]
    if measured is not None and (n_independent >= MANY_INDEPENDENT or predicted is None):
        # Each point has two coordinates.
        low, high = rmse_interval(measured, 2.0 * n_independent)
        interval = low, measured, high
    elif predicted is not None and row["predicted_high"] is not None:
        interval = row["predicted_low"], predicted, row["predicted_high"]
    else:
        return None
    if unit == "px":
        return interval
    metres_per_pixel = row["pixel"]
    if metres_per_pixel is None:
        return None
    low, rmse, high = interval
    return metres_per_pixel * low, metres_per_pixel * rmse, metres_per_pixel * high


def _clauses_on_limits(notes: Sequence[str], accepted: float) -> list[str]:
    """Return the first sentences of notes on what the stated accuracy does not vouch for.

    Notes on errors of at most `accepted` [px] are left out.
    """
    sentences = [note.partition(". ")[0].removesuffix(".") for note in limits_of_accuracy(notes)
                 if (size_in_caution(note) or np.inf) > accepted]
    return [f"{sentence[0].lower()}{sentence[1:]}" for sentence in sentences]


def _contradiction_clauses(row: Mapping[str, Any], usual: float,
                           accept: Accept | None) -> list[str]:
    """Return clauses on why the figures of an image are doubtful; [] if they are not.

    `row` is of the table of a study; `usual` is the RMSE of the usual image of the study [px].
    Notes on errors up to the size that the user accepts, if any, are no reason.
    """
    clauses = []
    if row["doubt"]:
        clauses.append(str(row["doubt"]).rstrip("."))
    clauses += clauses_on_unused_data(row["notes"] or ())
    clauses += _clauses_on_limits(row["notes"] or (),
                                  accept.pixels(row["pixel"]) if accept else 0.0)
    blunders = len(row["blunders"] or ())
    points = (row["n_control"] or 0) + (row["excluded"] or 0)
    if blunders > MANY_BLUNDERS * max(points, 1):
        clauses.append(f"{count_in_words(blunders, 'blunder')} among "
                       f"{count_in_words(points, 'point')}")
    high, measured = row["predicted_high"], row["independent"]
    if high is not None and measured is not None and measured > high:
        clauses.append(f"independent check points miss it by {rounded_size_text(measured)} px, "
                       "more than predicted")
    interval = _rmse_interval(row, "px")
    if interval is not None and interval[1] > UNLIKE * usual:
        clauses.append(f"its RMSE is {interval[1] / usual:.0f} times that of the usual image")
    return clauses
