"""What the journal of a study holds of a finished cell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from termsel.record.base import RecordPart

State = Literal["done", "infeasible", "failed"]


class CellRecord(RecordPart, frozen=True):
    """A finished cell."""

    cell: str
    """Key of the cell."""
    state: State
    """How it ended."""
    reason: str
    """Why it has no result; empty if it has one."""
    figures: Mapping[str, Any]
    """Its columns in the table of the study, by name; empty if it failed."""
    trace: list[list[float]]
    """Evaluations, best value and CPU seconds at every improvement."""
    front: list[list[float]]
    """Objectives of each member of its front."""
