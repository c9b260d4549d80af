"""Notes of a run that say where its stated accuracy does not hold, known by their words."""

from __future__ import annotations

import re
from collections.abc import Iterable

EXTRAPOLATION = "Extrapolation: "
"""How notes begin on places outside the control."""

ON_ONE_LINE = " lie close to one straight line "
"""What a note on control along one line has in it."""

BETWEEN_POINTS = "Between "
"""How a note begins on a model that is less certain between its points than at them."""

TWO_DATUMS = ", as if they were in another datum"
"""What a note on two groups of points has in it."""

CONTRADICT = " contradict one another: "
"""What a note has in it on points of which too few agree."""

EXCHANGED = "no view of a plane reverses some triangles"
"""What a note has in it on points that are exchanged, or of which one is wrong."""

UNLIKE_CONTROL = " control and check. Either "
"""What a note has in it on independent points that the model does not meet."""

BESIDE_CONTROL = " close beside control points"
"""What a note has in it on independent points that show errors next to control alone."""

BEYOND_RPC = ", are outside those of the RPC, "
"""What a note has in it on control whose heights the RPC does not have."""

ROUNDED = ", as if rounded: "
"""What a note has in it on coordinates with too few decimals."""

SLIP = " would fit to "
"""What a note has in it on an outlier that is a slip of the pen."""

MIRRORED = ", so that a map would be mirrored: "
"""What a note has in it on an image whose lines or samples seem to run the other way."""

SWAPPED_GROUND = "x and y look swapped"
SWAPPED_IMAGE = "line and sample look swapped"
"""How a doubt begins on axes of the ground, or of the image."""

_OPENINGS = (EXTRAPOLATION, BETWEEN_POINTS)
_WORDS = (ON_ONE_LINE, TWO_DATUMS, CONTRADICT, EXCHANGED, UNLIKE_CONTROL, BESIDE_CONTROL,
          BEYOND_RPC)

_SIZE = re.compile(r" (?:off by|up to) ([0-9.,]*[0-9]) px")
"""The size of errors where the stated accuracy does not hold, as notes word it."""


def limits_of_accuracy(notes: Iterable[str]) -> list[str]:
    """Return the notes that say where, or that, the stated accuracy does not hold.

    Examples
    --------
    >>> from termsel.data.record.cautions import limits_of_accuracy
    >>> limits_of_accuracy(["All points lie close to one straight line on the ground. Measure "
    ...                     "points away from it.", "All heights are 7, so they were not used."])
    ['All points lie close to one straight line on the ground. Measure points away from it.']
    """
    return [note for note in notes
            if note.startswith(_OPENINGS) or any(words in note for words in _WORDS)]


def size_in_caution(note: str) -> float | None:
    """Return how large errors may be where the stated accuracy does not hold [px], as a note says.

    Returns None for a note that says no size.

    Examples
    --------
    >>> from termsel.data.record.cautions import size_in_caution
    >>> size_in_caution("Between the points the map may be off by 1,041 px: the RMSE holds near "
    ...                 "them only.")
    1041.0
    """
    size = _SIZE.search(note)
    return None if size is None else float(size[1].replace(",", ""))
