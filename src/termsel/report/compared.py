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
