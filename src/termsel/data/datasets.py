"""Declaration of a data set that has a name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from termsel.data.features import FeatureSet


@dataclass(frozen=True)
class DatasetSpec:
    """A data set a problem can name.

    Parameters
    ----------
    name : str
        As in ``--dataset``.
    summary : str
        One line: what it holds and where it comes from.
    load : callable
        Returns the FeatureSet; called when the data are needed.
    simulated : bool
        True if the measurements were computed; shown wherever the data appear.

    Examples
    --------
    >>> import termsel
    >>> spec = termsel.DatasetSpec("mine", "two points", lambda: termsel.FeatureSet())
    >>> len(spec.load().points)
    0
    """

    name: str
    summary: str
    load: Callable[[], FeatureSet]
    simulated: bool = False
