"""Points measured more than once: several rows with the same ground coordinates."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from termsel.core.errors import TermselError, count_in_words
from termsel.core.options import Option
from termsel.data.features import FloatArray, IntArray
from termsel.data.tables.tabular import places_in_words, repeated_places

log = logging.getLogger(__name__)

MAX_GROUPS_NAMED = 5
"""Groups of repeated points that a note names."""

REFUSE, AVERAGE = "refuse", "average"

REPEATED = Option(
    "repeated", REFUSE, "Treatment of points of a table with the same ground coordinates: refuse "
                        "them, or average their image coordinates to one point.",
    choices=(REFUSE, AVERAGE))

_averaging: ContextVar[bool] = ContextVar("averaging", default=False)


@contextmanager
def average_while_reading(choice: str | None) -> Iterator[None]:
    """Average the repeated points of tables read during the block, if that is the choice."""
    token = _averaging.set(REPEATED.parse(choice) == AVERAGE if choice else False)
    try:
        yield
    finally:
        _averaging.reset(token)


def is_averaging() -> bool:
    """Return whether repeated points are to be averaged."""
    return _averaging.get()


def average_repeated(ids: Sequence[str], image: FloatArray, ground: FloatArray,
                     sigma: FloatArray | None,
                     roles: Sequence[str]) -> tuple[IntArray, FloatArray, FloatArray | None]:
    """Return the first row, mean position and deviations of each of m places on the ground.

    Places are in the order of their first rows that are in use, (m,). The others are the mean image
    position (m, 2) of the rows there, and its standard deviations (m, 2), None without `sigma`.
    Rows with the role "off" take no part, and each is a place of its own. Which were averaged is
    logged. Raises TermselError for different roles at one place: one of them would be lost.
    """
    is_off = np.array([role == "off" for role in roles])
    first_rows: list[int] = []
    means = np.array(image)
    deviations = None if sigma is None else np.array(sigma)
    repeated = []
    # Each place: the rows that take no part stay by themselves, and the others become one.
    for rows in repeated_places(ground, with_single=True):
        used = [row for row in rows if not is_off[row]]
        first_rows += [row for row in rows if is_off[row]]
        if not used:
            continue
        if len({roles[row] for row in used}) > 1:
            raise TermselError(
                f"{places_in_words(ids, [used])} and different roles, so they have no mean",
                hint="Give them one role, or remove all but one.", ids=[ids[used[1]]])
        first_rows.append(used[0])
        means[used[0]] = image[used].mean(axis=0)
        if sigma is not None and deviations is not None:
            # The mean of n independent measurements has sqrt(sum sigma^2) / n.
            deviations[used[0]] = np.sqrt((sigma[used] ** 2).sum(axis=0)) / len(used)
        if len(used) > 1:
            repeated.append(used)
    if repeated:
        _log_averaged_rows(ids, image, means, repeated)
    in_order = np.array(sorted(first_rows), dtype=np.intp)
    return in_order, means[in_order], None if deviations is None else deviations[in_order]


def _log_averaged_rows(ids: Sequence[str], image: FloatArray, means: FloatArray,
                       repeated: Sequence[Sequence[int]]) -> None:
    """Log which rows were averaged, and their largest distance from their means [px].

    `image` and `means` (n, 2) are the measured and the averaged position of each row. Each of
    `repeated` lists the indices of the rows of one point.
    """
    distances = [float(np.linalg.norm(image[rows] - means[rows[0]], axis=1).max())
                 for rows in repeated]
    groups = [", ".join(ids[row] for row in rows) for rows in repeated[:MAX_GROUPS_NAMED]]
    remainder = ""
    if len(repeated) > MAX_GROUPS_NAMED:
        remainder = f" and {len(repeated) - MAX_GROUPS_NAMED} more"
    verb = "is" if len(repeated) == 1 else "are"
    log.warning("Note: %s measured more than once %s averaged: %s%s. They are up to %.3g px "
                "from their means.", count_in_words(
                    len(repeated), "point"), verb, "; ".join(groups),
                remainder, max(distances))
