"""Tables of what charts show, for those who cannot see them or need the numbers."""

from __future__ import annotations

from termsel.measurements.features import select
from termsel.report.charts.search import spaced
from termsel.report.charts.terms import frequency_rows, term_rows
from termsel.report.page import Table
from termsel.report.view import View

GENERATIONS = 30
"""Rows of the search."""
PAIRS = 60
"""Pairs of correlated coefficients."""
STEP = 9
"""Every so many cells of the map of uncertainty there is a row."""


def convergence_table(view: View) -> Table:
    """Return the search, generation by generation."""
    rows = spaced(view.record["history"], GENERATIONS)
    empires = any("empires" in one for one in rows)
    return Table("The search, generation by generation", (
        "evaluations", "best", "median", "infeasible", *["empires left"] * empires), [
            (str(one["evaluations"]), *("-" if one[key] is None else f"{one[key]:.4g}"
                                        for key in ("best", "median")),
             f"{1 - one['feasible']:.0%}",
             *[str(sum(map(bool, one.get("empires", ()))))] * empires) for one in rows],
        folded=True)


def frequency_table(view: View) -> Table:
    """Return how often terms are selected."""
    return Table("How often terms are selected", ("term", "share of selections", "in this result"),
                 [(row["term"], f"{row['share']:.0%}", "yes" if row["used"] else "no")
                  for row in frequency_rows(view)], folded=True)


def term_table(view: View) -> Table:
    """Return the terms with the significance of their coefficients."""
    return Table("Terms and their significance", ("term", "t", "chance if zero"), [
        (row["term"], f"{row['t']:.3g}", f"{row['p']:.2g}") for row in term_rows(view)],
        folded=True)


def correlation_table(view: View) -> Table:
    """Return the pairs of coefficients that correlate most."""
    matrix = view.correlations
    assert matrix is not None
    names = select(view.fit.model.terms, view.fit.terms)
    pairs = sorted(((float(matrix[i, j]), names[j], names[i]) for i in range(len(names))
                    for j in range(i) if matrix[i, j] == matrix[i, j]),
                   key=lambda pair: -abs(pair[0]))
    return Table("Pairs of coefficients that correlate most", ("term", "and term", "correlation"),
                 [(one, other, f"{value:.3f}") for value, one, other in pairs[:PAIRS]],
                 folded=True)


def sigma_table(view: View) -> Table:
    """Return the standard deviation at places all over the image."""
    cells = view.sigma
    rows = sorted({cell["line"] for cell in cells})[::STEP]
    columns = sorted({cell["sample"] for cell in cells})[::STEP]
    return Table("Standard deviation at places of the image", (
        "line", "sample", "standard deviation [px]"), [
            (f"{(cell['line'] + cell['line2']) / 2:.0f}",
             f"{(cell['sample'] + cell['sample2']) / 2:.0f}", f"{cell['sigma']:.3g}")
            for cell in cells if cell["line"] in rows and cell["sample"] in columns], folded=True)
