"""Interpolating, hybrid and line-based image models, and polynomials with degrees by axis.

References
----------
Valadan Zoej, Mansourian, Mojaradi, Sadeghian 2002: 2D geometric correction of IKONOS imagery
using genetic algorithm. Symposium on Geospatial Theory, Processing and Applications, Ottawa.
Shaker 2004: The line based transformation model (LBTM). ISPRS Archives XXXV-B3.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import Recipe, SelectionProblem, hookimpl
from termsel_hybrids.by_axis import RECIPE, Polynomial2DByAxis, Polynomial3DByAxis
from termsel_hybrids.hybrid1 import Hybrid1
from termsel_hybrids.legendre import RationalLegendre
from termsel_hybrids.line_directions import LineAffine, LineConformal
from termsel_hybrids.multiquadric import Hybrid3, Multiquadric
from termsel_hybrids.piecewise import Piecewise
from termsel_hybrids.pointwise import Pointwise

if TYPE_CHECKING:
    from termsel import ProblemData, SensorModel

__all__ = ["Hybrid1", "Hybrid3", "LineAffine", "LineConformal", "Multiquadric", "Piecewise",
           "Pointwise", "RationalLegendre"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the models of this package."""
    return [Multiquadric, Pointwise, Piecewise, Hybrid1, Hybrid3, Polynomial2DByAxis,
            Polynomial3DByAxis, LineAffine, LineConformal, RationalLegendre]


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the problems of this package.

    They are hybrid model 2 of the paper, which is a search rather than a model, and the search for
    the degrees of a polynomial.
    """
    return [Recipe("hybrid-2", "Hybrid model 2: terms of a 2-D polynomial selected by a GA.",
                   _terms_of_each_axis, model="poly2d", dataset="ikonos-hamedan",
                   source="Valadan Zoej et al. 2002, section 3.2"), RECIPE]


def _terms_of_each_axis(inputs: ProblemData) -> SelectionProblem:
    """Return the problem of selecting terms, which uses all features."""
    return SelectionProblem(inputs, terms=True, features=False)
