"""Polynomials with a degree of their own for each axis and coordinate, and the search for them."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel import Blocks, Inputs, Option, ParameterProblem, Problem, RationalModel, Recipe
from termsel.toolkit import (
    CAP,
    OBJECTIVES,
    RECOMMEND,
    Exponents,
    graded_exponents,
    monomial_name,
    monomials,
)

FloatArray = NDArray[np.float64]


class PolynomialByAxis(RationalModel):
    """A polynomial with a highest power of each coordinate, for line and for sample."""

    coordinates: ClassVar[str] = "xyz"

    @cached_property
    def exponents(self) -> tuple[Exponents, Exponents]:
        """Exponents of X, Y, Z of each column, of line and of sample."""
        everything = graded_exponents(int(self.options["degree"]), len(self.coordinates))
        line, sample = (tuple(e for e in everything if all(
            power <= self.options[f"{axis}_{coordinate}"]
            for coordinate, power in zip(self.coordinates, e, strict=False)))
            for axis in ("line", "sample"))
        return line, sample

    @property
    def polynomial_degree(self) -> int | None:
        """Total degree."""
        return max(sum(e) for exponents in self.exponents for e in exponents)

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials of each axis."""
        line, sample = self.exponents
        return Blocks(line=monomials(ground, line), sample=monomials(ground, sample))

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names."""
        return tuple(monomial_name(e) for e in self.exponents[block == "sample"])


def _powers(coordinates: str, most: int) -> tuple[Option, ...]:
    return (Option("degree", most, "Highest total degree.", int, 1, most),
            *(Option(f"{axis}_{coordinate}", 2, f"Highest power of {coordinate.upper()} in the "
                     f"polynomial of {axis}.", int, 0, most)
              for axis in ("line", "sample") for coordinate in coordinates))


class Polynomial2DByAxis(PolynomialByAxis):
    """Plane polynomial with a degree of its own for line and sample, in X and in Y."""

    name = "poly2d-by-axis"
    coordinates = "xy"
    uses_height = False
    declared_options = _powers("xy", 5)


class Polynomial3DByAxis(PolynomialByAxis):
    """Space polynomial with a degree of its own for line and sample, in X, in Y and in Z."""

    name = "poly3d-by-axis"
    declared_options = _powers("xyz", 4)


def degrees(inputs: Inputs) -> Problem:
    """Return the search for the degrees."""
    own = [option.name for option in inputs.model.declared_options
           if option.name.startswith(("line_", "sample_"))]
    return ParameterProblem(inputs, own or ("line_x",))


RECIPE = Recipe(
    "poly-degree", "Which degree to use for line and sample in each coordinate.", degrees,
    model="poly3d-by-axis", dataset="ikonos-hamedan", solver="swap",
    options=(CAP, OBJECTIVES, RECOMMEND))
