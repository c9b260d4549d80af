"""What every split must do."""

from __future__ import annotations

import numpy as np

from termsel.data.roles import Split
from termsel.testing.cases import (
    Case,
    Suite,
    declaration_check,
    require,
    require_unchanged,
    through_pickle,
)
from termsel.testing.scenes import numbered_names

COUNTS = (1, 3, 12, 60)
SHARES = ((1 / 3, 1 / 3, 1 / 3), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5))


def roles(split: Split) -> None:
    """It gives each point a role, of any number of points and with any shares."""
    for n in COUNTS:
        for shares in SHARES:
            _assign_roles(split, n, shares)


def same_again(split: Split) -> None:
    """The same points, shares and seed get the same roles, here and in another process."""
    for n in COUNTS:
        first = _assign_roles(split, n, SHARES[0])
        require(_assign_roles(split, n, SHARES[0]) == first
                == _assign_roles(through_pickle(split), n, SHARES[0]),
                "assign() of the same points and seed differs; take all chance from rng")


def inputs_unchanged(split: Split) -> None:
    """It does not change the coordinates and shares it is given."""
    ids, ground = _split_points(12)
    shares = np.array(SHARES[0])
    require_unchanged({"ground": ground, "shares": shares}, "assign()", lambda: split.assign(
        ids, ground, shares, np.random.default_rng(1)))


def cases(split: Split) -> list[Case]:
    """Return a split."""
    return [Case(split.name, lambda: split)]


SUITE = Suite((declaration_check("splits"), roles, same_again, inputs_unchanged), cases)


def _split_points(n: int) -> tuple[tuple[str, ...], np.ndarray]:
    """Return ids and ground places (n, 3) of n points."""
    return numbered_names("P", n), np.random.default_rng(5).uniform(0.0, 1000.0, (n, 3))


def _assign_roles(split: Split, n: int, shares: tuple[float, ...]) -> tuple[str, ...]:
    """Return the roles that a split gives n points."""
    ids, ground = _split_points(n)
    return split.roles(ids, ground, np.array(shares), np.random.default_rng(1))
