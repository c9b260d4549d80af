"""This result among the fits without a search, and what they are called."""

from __future__ import annotations

from collections.abc import Iterator

from termsel.auto.compare import WITHOUT_BLUNDERS
from termsel.auto.methods import BY_NAME
from termsel.data.record.figures import RmseByRole
from termsel.data.record.record import Record

THIS = "this result"

ROLE_WORDS = {"control": "control", "check": "selection", "independent": "independent check",
              "off": "not used"}
"""What tables and charts call the points of a role of files and options."""


ALIKE_RATIO = 1.05
"""Two RMSE whose ratio is below this are called alike: with a few dozen independent points
an RMSE is itself uncertain by more."""

CHANCE = 1.15
"""Ratio up to which a model that was not chosen may be better by chance."""


def are_alike(first: float, second: float) -> bool:
    """Return whether the difference of two RMSE is of no practical use."""
    return first <= ALIKE_RATIO * second and second <= ALIKE_RATIO * first


def verdict_on_choice(own_rmse: float, rival_rmse: float, rival: str, among: int) -> str:
    """Return in a few words how the model that was chosen `among` several compares with a rival.

    The first screen and the summary say it with the same figures and in the same words.
    """
    if are_alike(own_rmse, rival_rmse):
        return "no practical difference"
    if rival_rmse > own_rmse:
        return f"{times(rival_rmse / own_rmse)} as large"
    # The choice has kept to the simpler model, or averages, where the difference is small.
    return "may be chance" if among > 1 and own_rmse <= CHANCE * rival_rmse else \
        f"{label_of(rival)} is better by {100 * (1 - rival_rmse / own_rmse):.0f} %"


def times(ratio: float) -> str:
    """Return a ratio in words, such as "1.1 times"."""
    return f"{ratio:.1f} times" if ratio < 10 else f"{ratio:,.0f} times"


def label_of(name: str) -> str:
    """Return what tables and charts call a fit without a search: a baseline or a candidate of auto.
    """
    # What no method is called: the fits that stand for comparison only.
    method = BY_NAME.get(name)
    if method is not None:
        return method.label
    words = {"all-terms": "all terms", WITHOUT_BLUNDERS: "without blunders"}
    return words.get(name, name.replace("-", " ").replace("rpc", "RPC"))


def fits_of(record: Record) -> Iterator[tuple[str, bool, int, RmseByRole]]:
    """Yield this result, then all fits without a search.

    Of each the label, whether it was fitted to the check points too, its number of terms, and its
    RMSE.
    """
    yield THIS, bool(record.strategy), record.selection.n_terms, record.rmse
    for baseline in record.baselines:
        fitted_to_check = "check" in baseline.fitted_to
        yield label_of(baseline.name), fitted_to_check, baseline.n_terms, baseline.rmse
