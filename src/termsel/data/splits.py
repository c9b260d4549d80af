"""Splits: how points that are assigned a role get it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from termsel.core.isolation.faults import blamed, wrong
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import FloatArray

ASSIGNABLE = ("control", "check", "independent")
"""Roles in the order of their shares."""


@dataclass(frozen=True)
class Split:
    """A named way to assign the roles control, check and independent.

    Parameters
    ----------
    name, summary : str
        The name is the value of ``--set roles=NAME``.
    assign : callable
        Takes the ids of n points, their ground coordinates (n, 3) in the CRS of the points, the
        shares of the three roles (3,), which sum to 1, and a numpy.random.Generator; returns n
        roles. It sees no image, so that no role depends on how well a point fits. With lines as
        control the share of control is 0. Points at one place are one.
    on_globe : bool
        Whether the ground coordinates are longitude and latitude [deg], rounded, and height,
        whatever the CRS of the points, so that no role depends on it. Those of a CRS that nothing
        is known of stay as they are.

    Examples
    --------
    >>> import termsel
    >>> split = termsel.Split("all", "All points are control.",
    ...                       lambda ids, image, ground, rng: ["control"] * len(ids))
    >>> split.name
    'all'
    """

    name: str
    summary: str
    assign: Callable[[tuple[str, ...], FloatArray, FloatArray, np.random.Generator], Sequence[str]]
    on_globe: bool = False

    def roles(self, ids: tuple[str, ...], ground: FloatArray, shares: FloatArray,
              rng: np.random.Generator) -> tuple[str, ...]:
        """Return a role for each point; refuse, naming the plugin, what are none."""
        with blamed(self.assign, "assign"):
            assigned = self.assign(ids, ground.copy(), shares.copy(), rng)
        if isinstance(assigned, str) or not isinstance(assigned, Sequence | np.ndarray) \
                or len(assigned) != len(ids) or not set(map(str, assigned)) <= set(ASSIGNABLE):
            raise wrong(self.assign, "assign", f"returned {assigned!r:.200}; expected a role for "
                        f"each of {len(ids)} points: {', '.join(ASSIGNABLE)}")
        return tuple(map(str, assigned))


def stratified(_ids: tuple[str, ...], ground: FloatArray, shares: FloatArray,
               rng: np.random.Generator) -> list[str]:
    """Give neighbouring points different roles, so that each role covers the scene."""
    return _in_turn(spatial_order(ground[:, :2]), shares, rng)


def at_random(ids: tuple[str, ...], _ground: FloatArray, shares: FloatArray,
              rng: np.random.Generator) -> list[str]:
    """Draw roles without regard to place."""
    return _in_turn(rng.permutation(len(ids)), shares, rng)


def _in_turn(order: Sequence[int] | np.ndarray, shares: FloatArray,
             rng: np.random.Generator) -> list[str]:
    """Return a role for each place of an order, so that every stretch of it has all shares."""
    # Each place in the order goes to the role that lags most behind its share; among roles
    # that lag alike the draw decides, so that different seeds give different splits.
    names = ASSIGNABLE
    if not shares[0]:  # the same draws, whether points or lines are the control
        names = (*names[1:], names[0])
        shares = np.roll(shares, -1)
    counts = np.zeros(3)
    roles = [""] * len(order)
    for turn, i in enumerate(order):
        # What a role should have had by now, less what it has.
        lag = shares * (turn + 1) - counts
        lag = np.where(shares > 0, lag + rng.uniform(0.0, 0.5, 3), -np.inf)
        role = int(np.argmax(lag))
        counts[role] += 1
        roles[i] = names[role]
    return roles


STRATIFIED = Split("stratified", "Neighbouring points get different roles, so that each role "
                                 "covers"
                   " the scene.", stratified, on_globe=True)
SPLITS = (STRATIFIED, Split("random", "Roles are drawn at random, not by position.", at_random))
"""Built-in splits."""
