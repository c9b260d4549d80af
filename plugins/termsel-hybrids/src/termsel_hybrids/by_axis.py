"""Polynomials with a degree of their own for each axis and coordinate, and the search for them."""

from __future__ import annotations

from functools import cached_property
from itertools import chain, product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel import Blocks, Option, ParameterProblem, Problem, ProblemData, RationalModel, Recipe
from termsel.toolkit.models import Exponents, evaluate_monomials, graded_exponents, monomial_name
from termsel.toolkit.searches import CAP, OBJECTIVES, RECOMMEND

FloatArray = NDArray[np.float64]


class PolynomialByAxis(RationalModel):
    """A polynomial with a highest power of each coordinate, for line and for sample."""

    coordinates: ClassVar[str] = "xyz"

    @cached_property
    def exponents(self) -> tuple[Exponents, Exponents]:
        """Exponents (i, j, k) of the monomials X^i Y^j Z^k, for line and for sample.

        They are those up to the total degree whose powers are within the options of the axis.
        """
        # A model of the plane has two coordinates; the exponent of Z is then 0.
        n = len(self.coordinates)
        exponents_within_degree = graded_exponents(int(self.options["degree"]), n)
        exponents_of = {}
        for axis in ("line", "sample"):
            largest = np.array([self.options[f"{axis}_{coordinate}"]
                                for coordinate in self.coordinates])
            exponents_of[axis] = tuple(powers for powers in exponents_within_degree
                                       if (np.array(powers[:n]) <= largest).all())
        return exponents_of["line"], exponents_of["sample"]

    @property
    def polynomial_degree(self) -> int | None:
        """Largest total degree of any column."""
        return max(map(sum, chain(*self.exponents)))

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials of scaled places (n, 3) for line and for sample."""
        line, sample = self.exponents
        return Blocks(line=evaluate_monomials(ground, line),
                      sample=evaluate_monomials(ground, sample))

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the names of the monomials of a block, line or sample."""
        return tuple(monomial_name(e) for e in self.exponents[block == "sample"])


def _options_of_powers(coordinates: str, largest: int) -> tuple[Option, ...]:
    """Return the options of a polynomial by axis: the total degree, and the degrees by coordinate.

    `coordinates` is "xy" or "xyz", `largest` the highest degree that a user may state.
    """
    options = [Option("degree", largest, "Highest total degree.", int, 1, largest)]
    for axis, coordinate in product(("line", "sample"), coordinates):
        options.append(Option(
            f"{axis}_{coordinate}", 2, f"Highest power of {coordinate.upper()} in the polynomial "
            f"of {axis}.", int, 0, largest))
    return tuple(options)


class Polynomial2DByAxis(PolynomialByAxis):
    """2-D polynomial with a degree of its own for line and sample, in X and in Y."""

    name = "poly2d-by-axis"
    coordinates = "xy"
    uses_height = False
    declared_options = _options_of_powers("xy", 5)


class Polynomial3DByAxis(PolynomialByAxis):
    """3-D polynomial with a degree of its own for line and sample, in X, in Y and in Z."""

    name = "poly3d-by-axis"
    declared_options = _options_of_powers("xyz", 4)


def degree_search(inputs: ProblemData) -> Problem:
    """Return the search for the degrees of each axis and coordinate."""
    # For a model without degrees by axis, ParameterProblem refuses "line_x", and says why.
    names = [option.name for option in inputs.model.declared_options
             if option.name.startswith(("line_", "sample_"))]
    return ParameterProblem(inputs, names or ("line_x",))


RECIPE = Recipe(
    "poly-degree", "Which degree to use for line and sample in each coordinate.", degree_search,
    model="poly3d-by-axis", dataset="ikonos-hamedan", solver="swap",
    options=(CAP, OBJECTIVES, RECOMMEND))
