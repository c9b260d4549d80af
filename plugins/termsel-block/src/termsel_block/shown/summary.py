"""What the command prints of a block, and writes as summary.txt."""

from __future__ import annotations

from termsel_block.estimation.adjustment import WRONG
from termsel_block.shown.record import BlockRecord, WrongControl, WrongTie

_SHOWN = 10


def text_of(record: BlockRecord, *, verbose: bool = True) -> str:
    """Return the summary; without `verbose` long lists end after ten rows."""
    return "\n".join([opening(record), "", *_table(record, verbose),
                      *_wrong(record, verbose)]) + "\n"


def opening(record: BlockRecord) -> str:
    """Return what was read, how accurate it is, and what to do next."""
    points = sum(image.control for image in record.images)
    measured = (f"{len(record.images)} images, {record.ties} ties with {record.measurements} "
                f"observations, {points} GCP observations, CRS {record.crs}.")
    worst = max(record.images, key=lambda image: image.uncertainty)
    with_accuracy = [image for image in record.images if image.independent is not None]
    lines = ["Read: " + measured, "Datum: " + record.datum,
             f"Sigma of image measurements: ties {record.sigma_ties:.2f} px, control points "
             f"{record.sigma_control:.2f} px."]
    if with_accuracy:
        # The mean over all measurements, not over images.
        squares = sum(image.n_independent * (image.independent or 0.0)**2
                      for image in with_accuracy)
        n = sum(image.n_independent for image in with_accuracy)
        lines.append(f"Accuracy: RMSE {(squares / n) ** 0.5:.2f} px on {n} observations of "
                     f"independent check points in {len(with_accuracy)} images.")
    if record.independent is not None:
        space = record.independent
        lines.append(f"In space: east {space.east:.2f} m, north {space.north:.2f} m, up "
                     f"{space.up:.2f} m, RMSE of {space.n} independent check points by "
                     "intersection.")
    lines.append("Outliers: " + _blunders(record))
    lines.append(f"Next: {worst.name} is the least certain image, {worst.uncertainty:.2f} px over "
                 "its ties. More control points or ties in it help most.")
    if not record.converged:
        lines.append("The adjustment did not converge: do not rely on the figures.")
    lines += [f"Note: {note}" for note in record.notes]
    if len(record.parts) > 1:
        joined_images = []
        for names in record.parts[:_SHOWN]:
            joined_images.append(", ".join(names[:4]) + (", ..." if len(names) > 4 else ""))
        lines.append(f"Note: no tie joins {len(record.parts)} parts of this block, so that each "
                     f"is adjusted by itself: {' | '.join(joined_images)}.")
    return "\n".join(lines)


def _blunders(record: BlockRecord) -> str:
    """Return how many measurements were left out, in a sentence."""
    ties = len(record.wrong_ties)
    control = len(record.wrong_control)
    if not ties and not control:
        return "none detected."
    named = ", ".join(f"{wrong.id} in {wrong.image} ({wrong.error:.1f} px)"
                      for wrong in record.wrong_control[:3])
    if not control:
        return f"{ties} tie and {control} GCP observations rejected."
    further = ", ..." if control > 3 else ""
    return f"{ties} tie and {control} GCP observations rejected: {named}{further}."


def _table(record: BlockRecord, verbose: bool) -> list[str]:
    """Return a row for each image."""
    rows = [("image", "model", "GCPs", "ties", "ties px", "predicted px", "90 %",
             "ICPs px")]
    # The least certain first where not all are listed.
    listed = record.images if verbose else sorted(
        record.images, key=lambda image: -image.uncertainty)[:_SHOWN]
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
        lines.append(f"{n_others} more certain images: summary.txt has all.")
    return lines


def _wrong(record: BlockRecord, verbose: bool) -> list[str]:
    """Return the ties that were left out."""
    wrong = record.wrong_ties if verbose else record.wrong_ties[:_SHOWN]
    if not wrong:
        return []
    lines = ["", "Tie observations rejected:"]
    for tie in wrong:
        reason = reason_of(tie, record)
        lines.append(f"  {tie.id} in {tie.image}: {tie.error:.1f} px"
                     + (f" ({reason})" if reason else ""))
    if len(wrong) < len(record.wrong_ties):
        lines.append(f"  {len(record.wrong_ties) - len(wrong)} more: summary.txt has all.")
    return lines


def reason_of(wrong: WrongTie | WrongControl, record: BlockRecord) -> str:
    """Return why what is near the model was left out; empty where it is far off."""
    if isinstance(wrong, WrongTie) and wrong.error <= WRONG * record.sigma_ties:
        return "now in one image only"
    return ""
