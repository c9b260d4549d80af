"""What the command prints of a block, and writes as summary.txt."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from shlex import quote

from termsel.toolkit import count_in_words
from termsel.toolkit.charts import Fact
from termsel.toolkit.coordinates import short_crs_name, z_unit_in_words
from termsel_block.shown.record import BlockRecord, ImageRecord, WrongControl, WrongTie

LINES = 12
"""Lines of the first screen, that of the folder included."""
_MIN_ROWS = 2
"""Images that the first screen lists whatever else it says."""
_MAX_PARTS = 10
"""Parts of a block that a caution lists."""
_MAX_REJECTED_NAMED = 3
"""Rejected observations that are named."""
_LABEL, _WIDTH = 10, 88
"""Characters of the column of labels, and of a line."""


def text_of(record: BlockRecord) -> str:
    """Return the whole summary, as summary.txt has it."""
    return "\n".join([read_in(record), "", *_image_rows(record, len(record.images)), "",
                      *_labelled_lines(block_facts(record)), *_rejected_tie_lines(record)]) + "\n"


def first_screen(record: BlockRecord, folder: str) -> str:
    """Return data, images, accuracy and outliers, with where they were written, as lines of text.

    They are `LINES` lines unless cautions require more. Of many images the least certain are
    listed.
    """
    control = sum(image.control for image in record.images)
    shown = [fact for fact in block_facts(record) if fact.label not in ("Precision", "Next")
             and not (control and fact.label == "Datum")]
    next_image = _least_certain_images(record)[0].name
    lines = [*_labelled_lines(shown), f"Saved     {folder}/    Next: termsel plan "
             f"{quote(f'{folder}/{next_image}')}   (the least certain image)"]
    # Four lines are what was read, the header and two empty ones.
    rows = LINES - len(lines) - 4
    if rows < len(record.images):
        rows = max(rows - 1, _MIN_ROWS)  # one line counts those that are not listed
    return "\n".join([read_in(record), "", *_image_rows(record, rows), "", *lines]) + "\n"


def _labelled_lines(shown: Iterable[Fact]) -> list[str]:
    """Return facts as lines of text, wrapped, with their labels in a column on the left."""
    lines = []
    for fact in shown:
        lines += textwrap.wrap(fact.text, _WIDTH, initial_indent=fact.label.ljust(_LABEL),
                               subsequent_indent=" " * _LABEL, break_on_hyphens=False)
    return lines


def read_in(record: BlockRecord) -> str:
    """Return a line on what was read: images, control, ties and the CRS."""
    points = sum(image.control for image in record.images)
    with_control = sum(image.control > 0 for image in record.images)
    where = f" in {with_control} of them" if points else ""
    unit = z_unit_in_words(record.crs)
    return (f"{len(record.images)} images, {points} GCP observations{where}, {record.ties} ties "
            f"({record.measurements} observations), {short_crs_name(record.crs)}"
            + (f"; z in {unit}" if unit else ""))


def block_facts(record: BlockRecord) -> list[Fact]:
    """Return the accuracy, the outliers, the datum, cautions and the next step."""
    return [*_with_label("Accuracy", _accuracy_lines(record)),
            Fact(_blunder_line(record), "Outliers"),
            Fact(record.datum, "Datum"),
            Fact(f"ties {record.sigma_ties:.2f} px, control points {record.sigma_control:.2f} px "
                 "(sigma of image measurements)", "Precision"),
            *_with_label("Caution", _caution_lines(record)),
            Fact(f"more control points or ties in {_least_certain_images(record)[0].name}, the "
                 "least certain image", "Next")]


def _least_certain_images(record: BlockRecord) -> list[ImageRecord]:
    """Return the images, the least certain first."""
    return sorted(record.images, key=lambda image: -image.uncertainty)


def _with_label(label: str, lines: Iterable[str]) -> Iterator[Fact]:
    """Yield lines as facts, the first with the label, the others below it without one."""
    for i, line in enumerate(lines):
        yield Fact(line, label if i == 0 else " ")


def _accuracy_lines(record: BlockRecord) -> Iterator[str]:
    """Yield lines on the RMSE at independent check points: in the images [px], and in space [m].

    Without such points, a line says that the accuracy is not verified.
    """
    with_accuracy = [image for image in record.images if image.independent is not None]
    if not with_accuracy:
        yield "not verified: no independent check points"
    else:
        # The mean over all measurements, not over images.
        squares = sum(image.n_independent * (image.independent or 0.0)**2
                      for image in with_accuracy)
        n = sum(image.n_independent for image in with_accuracy)
        yield (f"{(squares / n) ** 0.5:.2f} px   RMSE of {n} observations of independent check "
               "points")
    if record.independent is not None:
        space = record.independent
        yield (f"{space.east:.2f} m east, {space.north:.2f} m north, {space.up:.2f} m up: "
               f"{space.n} points by intersection")


def _caution_lines(record: BlockRecord) -> Iterator[str]:
    """Yield what a user must know before relying on the figures; nothing if all is well."""
    if not record.converged:
        yield "The adjustment did not converge: do not rely on the figures."
    yield from record.notes
    if len(record.parts) > 1:
        joined_images = []
        for names in record.parts[:_MAX_PARTS]:
            joined_images.append(", ".join(names[:4]) + (", ..." if len(names) > 4 else ""))
        yield (f"No tie joins {len(record.parts)} parts of this block, so each is adjusted "
               f"separately: {' | '.join(joined_images)}.")


def _blunder_line(record: BlockRecord) -> str:
    """Return a line on rejected observations, or on how many were tested if none was rejected.

    The first `_MAX_REJECTED_NAMED` features are named with their errors, control before ties.
    """
    ties = len(record.wrong_ties)
    control = len(record.wrong_control)
    if not ties and not control:
        return (f"none detected among {record.measurements} tie and "
                f"{sum(image.control for image in record.images)} GCP observations")
    first = _observations_of_features(record)[:_MAX_REJECTED_NAMED]
    names = ", ".join(map(_rejected_in_words, first))
    others = ties + control - sum(map(len, first))
    further = f", {others} more" if others else ""
    kinds = " and ".join(f"{number} {kind}" for number, kind in (
        (ties, "tie"), (control, "GCP")) if number)
    noun = "observation" if ties + control == 1 else "observations"
    return f"{kinds} {noun} rejected: {names}{further}"


def _observations_of_features(record: BlockRecord) -> list[list[WrongControl | WrongTie]]:
    """Return rejected observations in their order, those of a tie that no image uses together."""
    of_control: list[list[WrongControl | WrongTie]] = [[wrong] for wrong in record.wrong_control]
    of_ties: dict[tuple[str, str], list[WrongControl | WrongTie]] = {}
    for tie in record.wrong_ties:
        of_ties.setdefault((tie.id, "" if tie.any_ray else tie.image), []).append(tie)
    return [*of_control, *of_ties.values()]


def _rejected_in_words(observations: Sequence[WrongControl | WrongTie]) -> str:
    """Return where an observation was rejected and how far off it is.

    If no image uses a tie, it is not known which of them is wrong, and that one is off by more.
    """
    worst = observations[0]
    if not reason_of(worst):
        return f"{worst.id} in {worst.image} {worst.error:.1f} px"
    images = " or ".join(sorted(wrong.image for wrong in observations))
    return f"{worst.id} in {images} {worst.error:.1f} px or more"


def _image_rows(record: BlockRecord, most: int) -> list[str]:
    """Return a header and a row for each image.

    Of more than `most` images, rows are those of the least certain, and a line has the number of
    the others.
    """
    rows = [("image", "model", "GCPs", "ties", "ties px", "predicted px", "90 %",
             "ICPs px")]
    listed = _least_certain_images(record)[:most] if most < len(record.images) else record.images
    rows += [(image.name, image.model, str(image.control), str(image.ties),
              f"{image.rmse_ties:.2f}", f"{image.predicted:.2f}",
              f"{image.low:.2f}-{image.high:.2f}", "" if image.independent is None else
              f"{image.independent:.2f} ({image.n_independent})") for image in listed]
    widths = [0] * len(rows[0])
    for row in rows:
        widths = [max(width, len(cell)) for width, cell in zip(widths, row, strict=True)]
    lines = []
    for row in rows:
        # Names and models to the left, figures to the right.
        cells = [cell.ljust(width) if k < 2 else cell.rjust(width)
                 for k, (cell, width) in enumerate(zip(row, widths, strict=True))]
        lines.append("  ".join(cells).rstrip())
    if len(listed) < len(record.images):
        n_others = len(record.images) - len(listed)
        lines.append(f"{count_in_words(n_others, 'image')} more, with less uncertainty: "
                     "summary.txt has all.")
    return lines


def _rejected_tie_lines(record: BlockRecord) -> list[str]:
    """Return a line for each tie observation that was rejected, after a heading; [] if none was."""
    if not record.wrong_ties:
        return []
    lines = ["", "Tie observations rejected:"]
    for tie in record.wrong_ties:
        reason = reason_of(tie)
        lines.append(f"  {tie.id} in {tie.image}: {tie.error:.1f} px"
                     + (f" ({reason})" if reason else ""))
    return lines


def reason_of(wrong: WrongTie | WrongControl) -> str:
    """Return what the distance of a rejected observation does not say; "" where it says all."""
    if isinstance(wrong, WrongTie) and wrong.any_ray:
        return "its images contradict one another: one of them is off by more"
    return ""
