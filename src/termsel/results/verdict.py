"""The outlier test as a table: which features, how certain, and what to type."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from termsel.core.display.numbers import rounded
from termsel.data.record.figures import BlunderTest
from termsel.data.record.record import Record
from termsel.results.blocks import Block, TableBlock
from termsel.results.compared import ROLE_WORDS

CERTAINTY = {"certain": "blunder", "probable": "probable blunder", "possible": "possible blunder"}
"""What a feature is called that contradicts all others."""

TESTABLE_RATIO = 10.0
"""Least error that a test of enough features finds, by the size of their errors, at most."""


def off_option(record: Record) -> str:
    """Return the option that leaves out blunders in use, independent ones too; "" for none."""
    # A possible blunder is no reason to leave a point out; it is shown, and stays.
    wrong = [outlier.id for outlier in record.outliers
             if not outlier.excluded and outlier.certainty != "possible"]
    return f"--off {shlex.quote(','.join(wrong))}" if wrong else ""


def contradicting(record: Record) -> str:
    """Return which independent points contradict all others, of which there are some."""
    wrong = [outlier.id for outlier in record.outliers if outlier.role == "independent"]
    return wrong[0] if len(wrong) == 1 else f"{len(wrong)} outliers among them"


def size_of_errors(record: Record) -> float:
    """Return the RMSE that features which took no part have, or are predicted to have [px]."""
    sizes = []
    if record.predicted:
        sizes.append(record.predicted.rmse)
    if record.accuracy:
        sizes.append(record.accuracy.image.total)
    return min(sizes, default=0.0)


def too_few_to_test(test: BlunderTest, errors: float) -> bool:
    """Return whether features are too few for a test, given the size of their errors [px].

    Then an error that could be found is larger than the image, and not because all errors are
    large.
    """
    return test.limit is None or test.limit > max(test.extent, TESTABLE_RATIO * errors)


def _none_detected(test: BlunderTest | None, errors: float) -> str:
    """Return that no outlier was detected, and how large one may be, given the size of errors."""
    if test is None:
        return "Outliers were not tested."
    if test.limit is None or too_few_to_test(test, errors):
        return f"No outlier can be detected: {test.features} features are too few."
    if test.limit > test.extent:
        return ("No outlier can be detected: no model fits these features. Several are wrong, or "
                "no model is suitable.")
    return (f"No outliers detected. At half of the {test.features} features, an error must exceed "
            f"{rounded(test.limit)} px to be detected.")


def verdict_table(record: Record) -> Iterator[Block]:
    """Yield all features that contradict the others, and those that were not needed."""
    outliers = record.outliers
    if outliers:
        yield TableBlock(
            "Outliers and their prediction errors", (
                "feature", "kind", "role", "error [px]", "outlier test", "use"), [
                (outlier.id, outlier.kind, ROLE_WORDS[outlier.role], rounded(outlier.error),
                 CERTAINTY[outlier.certainty],
                 "rejected" if outlier.excluded else
                 "in the figures" if outlier.role == "independent" else "in use")
                for outlier in outliers])
        if off := off_option(record):
            yield f"Leave out those in use with {off} and run again."
    else:
        yield "Outliers were tested in an earlier run, not here." \
            if record.options.data.get("tested") else \
            _none_detected(record.blunder_test, size_of_errors(record))
    certainties = {outlier.certainty for outlier in outliers}
    if "probable" in certainties:
        yield "A probable blunder is more likely wrong than right: look at it in the image."
    if "possible" in certainties:
        yield ("For a possible blunder the other features are too few or too far away to decide: "
               "look at it in the image.")
    # Control that fits and was not selected is no outlier: the search did without it.
    spare = set(record.data.roles.control).difference(
        record.selection.features, (outlier.id for outlier in outliers))
    if spare and not record.strategy:
        yield f"{len(spare)} more {record.data.counts.word} fit but were not selected."
