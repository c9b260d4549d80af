"""The verdict on blunders as a table: which, how certain, and what to type."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from termsel.data.record.record import Record
from termsel.report.blocks import Block, TableBlock

CERTAINTY = {"certain": "blunder", "probable": "probable blunder", "possible": "possible blunder"}
"""What a feature is called that contradicts all others."""


def off_option(record: Record) -> str:
    """Return the option that leaves out blunders in use, independent ones too; "" for none."""
    wrong = [one.id for one in record.outliers
             if not one.excluded and one.certainty != "possible"]
    return f"--off {shlex.quote(','.join(wrong))}" if wrong else ""


def contradicting(record: Record) -> str:
    """Return which independent points contradict all others, of which there are some."""
    wrong = [one.id for one in record.outliers if one.role == "independent"]
    return wrong[0] if len(wrong) == 1 else f"the {len(wrong)} that contradict all others"


def verdict_table(record: Record) -> Iterator[Block]:
    """Yield all features that contradict the others, and those that were not needed."""
    outliers = record.outliers
    if outliers:
        yield TableBlock(
            "Features that contradict all others: how far off these predict them", (
                "feature", "kind", "role", "error [px]", "verdict", "use"), [
                (one.id, one.kind, one.role, f"{one.error:.3g}", CERTAINTY[one.certainty],
                 "left out" if one.excluded else
                 "in the figures" if one.role == "independent" else "in use")
                for one in outliers])
        if off := off_option(record):
            yield f"Leave out those in use by {off} and run again."
    else:
        yield "Blunders were looked for before, not here." if record.options.data.get("tested") \
            else "No feature is a blunder, as far as the others tell."
    found = {one.certainty for one in outliers}
    if "probable" in found:
        yield ("A probable blunder is more likely wrong than right, but not for certain: look at "
               "it in the image.")
    if "possible" in found:
        yield ("A possible blunder lies where the others are too few or too far to tell: look at "
               "it in the image.")
    spare = set(record.data.roles.control).difference(
        record.selection.features, (one.id for one in outliers))
    if spare and not record.strategy:
        yield f"Left out though they fit: {len(spare)}; they were not needed."
