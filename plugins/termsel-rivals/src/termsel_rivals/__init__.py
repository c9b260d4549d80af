"""Solvers and criteria of the literature that termsel is compared with, as a plugin of termsel."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl
from termsel_rivals.colony import AntColony
from termsel_rivals.condition import FigureCondition
from termsel_rivals.lasso import Lasso
from termsel_rivals.nested import NestedRegression
from termsel_rivals.ransac import Ransac
from termsel_rivals.scatter import ScatterMatrix
from termsel_rivals.stepwise import Stepwise, TTest
from termsel_rivals.transgenic import TransgenicGA

if TYPE_CHECKING:
    from termsel import Criterion, Method, Solver

__all__ = ["AntColony", "FigureCondition", "Lasso", "NestedRegression", "Ransac", "ScatterMatrix",
           "Stepwise", "TTest", "TransgenicGA"]


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the solvers of this package."""
    return [AntColony, Lasso, NestedRegression, ScatterMatrix, Stepwise, TTest, TransgenicGA]


@hookimpl
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return the criteria of this package."""
    return [FigureCondition]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the methods of this package."""
    return [Ransac()]
