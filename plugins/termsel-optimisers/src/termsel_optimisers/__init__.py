"""Solvers to compare with, as a plugin: of DEAP, of pymoo, of the literature and its papers.

Algorithms of DEAP and pymoo are solvers by name, and problems come for scripts of theirs. `rivals`
holds solvers, a criterion and a method of the literature, `papers` the set-ups of papers.

References
----------
Fortin, De Rainville, Gardner, Parizeau and Gagné 2012, DEAP: Evolutionary algorithms made easy,
J. Mach. Learn. Res. 13. Blank and Deb 2020, pymoo: Multi-objective optimization in Python, IEEE
Access 8.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    from termsel import Criterion, DatasetSpec, Method, Recipe, Solver
    from termsel_optimisers.ask_tell import from_ask_tell
    from termsel_optimisers.deap_algorithms import from_deap
    from termsel_optimisers.deap_toolbox import to_deap
    from termsel_optimisers.pymoo_algorithms import from_pymoo
    from termsel_optimisers.rivals.colony import AntColony
    from termsel_optimisers.rivals.condition import FigureCondition
    from termsel_optimisers.rivals.lasso import Lasso
    from termsel_optimisers.rivals.nested import NestedRegression
    from termsel_optimisers.rivals.ransac import Ransac
    from termsel_optimisers.rivals.scatter import ScatterMatrix
    from termsel_optimisers.rivals.stepwise import Stepwise, TTest
    from termsel_optimisers.rivals.transgenic import TransgenicGA

# What is not needed for `termsel list` is not imported for it: DEAP and pymoo take a second.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "ask_tell": ["from_ask_tell"], "deap_algorithms": ["from_deap"],
    "deap_toolbox": ["to_deap"], "pymoo_algorithms": ["from_pymoo"],
    "rivals.colony": ["AntColony"], "rivals.condition": ["FigureCondition"],
    "rivals.lasso": ["Lasso"], "rivals.nested": ["NestedRegression"],
    "rivals.ransac": ["Ransac"], "rivals.scatter": ["ScatterMatrix"],
    "rivals.stepwise": ["Stepwise", "TTest"], "rivals.transgenic": ["TransgenicGA"]})

__all__ = ["AntColony", "FigureCondition", "Lasso", "NestedRegression", "Ransac", "ScatterMatrix",
           "Stepwise", "TTest", "TransgenicGA", "from_ask_tell", "from_deap", "from_pymoo",
           "to_deap"]


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the solvers of this package.

    They are the algorithms of DEAP and pymoo, those of papers, and rivals of the literature on the
    selection of terms.
    """
    from termsel_optimisers.deap_algorithms import Deap
    from termsel_optimisers.papers.correlation import CorrelationSeededGA
    from termsel_optimisers.pymoo_algorithms import Pymoo
    from termsel_optimisers.rivals.colony import AntColony
    from termsel_optimisers.rivals.lasso import Lasso
    from termsel_optimisers.rivals.nested import NestedRegression
    from termsel_optimisers.rivals.scatter import ScatterMatrix
    from termsel_optimisers.rivals.stepwise import Stepwise, TTest
    from termsel_optimisers.rivals.transgenic import TransgenicGA
    from termsel_optimisers.survivals import AgeMoea2, SmsEmoa, Spea2

    return [Deap, Pymoo, AgeMoea2, SmsEmoa, Spea2, CorrelationSeededGA, AntColony, Lasso,
            NestedRegression, ScatterMatrix, Stepwise, TTest, TransgenicGA]


@hookimpl
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return the criterion of the predicted error over the whole image."""
    from termsel_optimisers.rivals.condition import FigureCondition

    return [FigureCondition]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return RANSAC."""
    from termsel_optimisers.rivals.ransac import Ransac

    return [Ransac()]


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the problems with the set-ups of papers."""
    from termsel_optimisers.papers.setups import PAPERS

    return PAPERS


@hookimpl
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return the simulated data sets of papers."""
    from termsel_optimisers.papers.datasets import DATASETS

    return DATASETS
