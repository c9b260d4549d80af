"""Interpolating image models of Valadan Zoej et al. 2002, as a plugin of termsel.

References
----------
Valadan Zoej, Mansourian, Mojaradi, Sadeghian 2002: 2D geometric correction of IKONOS imagery
using genetic algorithm. Symposium on Geospatial Theory, Processing and Applications, Ottawa.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl
from termsel_hybrids.multiquadric import Multiquadric

if TYPE_CHECKING:
    from termsel import SensorModel

__all__ = ["Multiquadric"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the models of this package."""
    return [Multiquadric]
