"""Solvers, criteria and methods of the literature that termsel is compared with, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    from termsel import Criterion, Method, Solver
    from termsel_rivals.colony import AntColony
    from termsel_rivals.condition import FigureCondition
    from termsel_rivals.lasso import Lasso
    from termsel_rivals.nested import NestedRegression
    from termsel_rivals.ransac import Ransac
    from termsel_rivals.scatter import ScatterMatrix
    from termsel_rivals.stepwise import Stepwise, TTest
    from termsel_rivals.transgenic import TransgenicGA

# Every choice asks for methods; the solvers, some of which need scipy, are for searches alone.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "colony": ["AntColony"], "condition": ["FigureCondition"], "lasso": ["Lasso"],
    "nested": ["NestedRegression"], "ransac": ["Ransac"], "scatter": ["ScatterMatrix"],
    "stepwise": ["Stepwise", "TTest"], "transgenic": ["TransgenicGA"]})

__all__ = ["AntColony", "FigureCondition", "Lasso", "NestedRegression", "Ransac", "ScatterMatrix",
           "Stepwise", "TTest", "TransgenicGA"]


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the solvers of this package."""
    from termsel_rivals.colony import AntColony
    from termsel_rivals.lasso import Lasso
    from termsel_rivals.nested import NestedRegression
    from termsel_rivals.scatter import ScatterMatrix
    from termsel_rivals.stepwise import Stepwise, TTest
    from termsel_rivals.transgenic import TransgenicGA

    return [AntColony, Lasso, NestedRegression, ScatterMatrix, Stepwise, TTest, TransgenicGA]


@hookimpl
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return the criteria of this package."""
    from termsel_rivals.condition import FigureCondition

    return [FigureCondition]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the methods of this package."""
    from termsel_rivals.ransac import Ransac

    return [Ransac()]
