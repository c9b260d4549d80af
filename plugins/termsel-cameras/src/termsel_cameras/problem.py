"""The search for the centre of distortion."""

from __future__ import annotations

from termsel import ParameterProblem, Problem, ProblemData, Recipe, term_options

CENTRE_OPTIONS = ("centre_line", "centre_sample")


def centre_and_terms(inputs: ProblemData) -> Problem:
    """Return the selection of terms together with the centre of distortion."""
    return ParameterProblem(inputs, CENTRE_OPTIONS, terms=True, mask=inputs.options["mask"])


RECIPE = Recipe(
    "distortion", "Which terms of a polynomial and of radial distortion to use, and where the "
    "centre of distortion is.", centre_and_terms, model="radial3d", dataset="aerial-photo",
    solver="pso",
    # Distortion bends lines, so that the problem takes none.
    options=tuple(option for option in term_options() if option.name != "mixed"))
