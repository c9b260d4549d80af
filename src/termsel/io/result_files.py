"""The folder of a result: result.json, residuals.csv, summary.txt."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

from termsel.errors import TermselError
from termsel.io.atomic import write_text
from termsel.report.text import summary
from termsel.result import Result

RESIDUAL_COLUMNS = ("id", "kind", "role", "used", "residual_line", "residual_sample", "distance")


def claim_folder(folder: Path) -> None:
    """Make the folder, and refuse it now rather than after a long search.

    Raises
    ------
    TermselError
        If it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TermselError(f"cannot make the folder {folder}: {error.strerror}",
                           hint="Choose another --out.") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise TermselError(f"cannot write to the folder {folder}", hint="Choose another --out.")


def write_result(result: Result, folder: Path) -> None:
    """Write result.json, residuals.csv and summary.txt, each whole or not at all.

    Parameters
    ----------
    result : Result
    folder : Path
        One that exists; files of an earlier result are replaced.
    """
    write_text(folder / "residuals.csv", residuals_csv(result))
    write_text(folder / "summary.txt", summary(result))
    write_text(folder / "result.json", result.to_json())


def residuals_csv(result: Result) -> str:
    """Return the residuals of all features [pixel] as CSV."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(RESIDUAL_COLUMNS)
    for r in result.residuals:
        table.writerow([r.id, r.kind, r.role, "yes" if r.used else "no", f"{r.line:.6g}",
                        f"{r.sample:.6g}", f"{r.distance:.6g}"])
    return text.getvalue()
