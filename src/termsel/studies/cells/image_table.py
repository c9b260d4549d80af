"""The images of a batch as people read them: a table of five columns, and the reasons."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Sequence

from termsel.core.errors import count_in_words, first_names_in_words, rounded_size_text
from termsel.results.blocks import TableBlock
from termsel.studies.cells.table import Row, usual_notes
from termsel.studies.cells.verdicts import USABLE, VERDICTS


def image_table(rows: Sequence[Row]) -> TableBlock:
    """Return one row an image: its verdict, its RMSE in px and metres, and its blunders."""
    lines = [(image_name(row), row["verdict"] or row["state"], predicted_rmse_text(row),
              ground_rmse_text(row),
              ", ".join(row["blunders"] or ())) for row in rows]
    return TableBlock(count_of_verdicts(rows),
                      ("image", "verdict", "RMSE [px], 90 %", "RMSE [m]", "blunders"), lines,
                      keys=[row["cell"] for row in rows])


def image_reasons(rows: Sequence[Row], most_names: int | None = None) -> list[str]:
    """Return why images are doubtful or unfit, the worst first, and a common reason once.

    `most_names` is how many of the images with a reason are named, by default all.
    """
    usual = usual_notes(rows)
    images_by_reason: dict[str, list[str]] = {}
    for row in rows:
        reason = row["why"] or notes_on_image(row, usual)
        if row["verdict"] not in USABLE and reason:
            images_by_reason.setdefault(reason, []).append(image_name(row))
    # A reader's reason names its file itself.
    return [reason if reason.startswith(images[0])
            else f"{first_names_in_words(images, most_names or len(images))}: {reason}"
            for reason, images in images_by_reason.items()]


def image_name(row: Row) -> str:
    """Return the name of an image, with its draw of points if that is not the first."""
    return str(row["data"]) + (f", split {row['split']}" if row["split"] else "")


def predicted_rmse_text(row: Row) -> str:
    """Return the predicted RMSE with its interval [px]; "" where it is not known."""
    if row["predicted"] is None:
        return ""
    low, high = (rounded_size_text(row[name]) for name in ("predicted_low", "predicted_high"))
    return f"{rounded_size_text(row['predicted'])} ({low} to {high})"


def independent_rmse(row: Row) -> str:
    """Return the RMSE at independent check points [px]; "" without any."""
    return "" if row["independent"] is None else rounded_size_text(row["independent"])


def ground_rmse_text(row: Row) -> str:
    """Return the RMSE on the ground [m], predicted, else of check points; "" if not known."""
    size = row["independent_m"] if row["predicted_m"] is None else row["predicted_m"]
    return "" if size is None else rounded_size_text(size)


def count_of_verdicts(rows: Sequence[Row]) -> str:
    """Return a clause on how many images there are, and how many have each verdict."""
    verdicts = Counter(row["verdict"] for row in rows if row["verdict"])
    counts = ", ".join(f"{verdicts[verdict]} {verdict}" for verdict in VERDICTS
                       if verdicts[verdict])
    return f"{count_in_words(len(rows), 'image')}, worst first" + (f": {counts}" if counts else "")


def notes_on_image(row: Row, usual: Container[str]) -> str:
    """Return why an image has no result, or the doubts about it and notes that few images have."""
    notes = [note for note in row["notes"] or () if note not in usual]
    text = "" if row["reason"] and row["why"] else row["reason"] or " ".join(notes)
    # A note repeats a doubt with what to do about it: the longer one is enough.
    if row["doubt"] and row["doubt"] in (row["why"] or ""):
        return text
    doubts = re.split(r"(?<=[.?]) (?=[A-Z])", row["doubt"] or "")
    return " ".join([*(doubt for doubt in doubts if doubt and doubt not in text), text]).strip()
