"""Solvers of the literature that termsel is compared with, as a plugin of termsel."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl
from termsel_rivals.colony import AntColony
from termsel_rivals.lasso import Lasso
from termsel_rivals.nested import NestedRegression
from termsel_rivals.stepwise import Stepwise, TTest
from termsel_rivals.transgenic import TransgenicGA

if TYPE_CHECKING:
    from termsel import Solver

__all__ = ["AntColony", "Lasso", "NestedRegression", "Stepwise", "TTest", "TransgenicGA"]


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the solvers of this package."""
    return [AntColony, Lasso, NestedRegression, Stepwise, TTest, TransgenicGA]
