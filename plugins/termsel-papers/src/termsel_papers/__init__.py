"""A solver and set-ups of papers on the selection of terms, as a plugin.

References
----------
Valadan Zoej, Mansourian, Mojaradi and Sadeghian 2002; Zakaryaie Nejad, Ezzatpanah and Ramezani
2015; Yavari, Valadan Zoej and Salehi 2018; Akhoundi Khezrabad, Valadan Zoej and Safdarinezhad 2020.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl

if TYPE_CHECKING:
    from termsel import DatasetSpec, Recipe, Solver


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the problems with the set-ups of papers."""
    from termsel_papers.setups import PAPERS

    return PAPERS


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the solvers."""
    from termsel_papers.correlation import CorrelationSeededGA

    return [CorrelationSeededGA]


@hookimpl
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return the simulated data sets."""
    from termsel_papers.datasets import DATASETS

    return DATASETS
