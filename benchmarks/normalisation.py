"""The optimum depends on the origin of the ground coordinates; a hierarchy removes most of that.

``python -m benchmarks.normalisation [--write]`` proves the optimum of selections of terms with the
ground coordinates moved or scaled, with terms free and with the option ``hierarchy`` (a term enters
with its parents), and prints the page docs/evidence/normalisation.md. It takes some minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

import termsel
from benchmarks.sets import put
from termsel.measurements.features import FloatArray
from termsel.problems.selection import SelectionProblem
from termsel.simulate import simulate_scene
from termsel.solvers.proofs.proof import prove

SEEDS = range(101, 111)
"""Scenes next to the embedded one."""
WAYS: tuple[tuple[str, float, float], ...] = (
    ("as delivered, -1 to 1", 1.0, 0.0), ("twice as wide", 2.0, 0.0), ("half as wide", 0.5, 0.0),
    ("origin in the middle of an edge", 1.0, 0.5), ("origin in a corner, 0 to 2", 1.0, 1.0))
"""Names, factor and shift of all ground coordinates after termsel's own scaling."""
ROUNDS, WEIGHTED_SEEDS = 3, (None, 101, 102, 103)
"""Optima of each scene, each but the first with the weights of the one before."""
SPACES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("plane polynomial, 15 terms an axis", "poly-terms", {"degree": 4}),
    ("RFM of second order, 19 terms an axis", "rfm-terms", {"order": 2}))


def main() -> None:
    """Prove, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="write the page")
    asked = parser.parse_args()
    put("normalisation", "\n".join(page()), write=asked.write)


def page() -> Iterator[str]:
    """Yield the lines of the page."""
    yield HEAD
    for title, name, options in SPACES:
        yield (f"\n## {title[0].upper()}{title[1:]}\n\n| coordinates | free: check [px] | "
               "terms in common | independent [px] | hierarchy: check [px] | terms in common | "
               "independent [px] |\n|---|---:|---:|---:|---:|---:|---:|")
        first: dict[tuple[int, bool], frozenset[str]] = {}
        for way, factor, shift in WAYS:
            cells = []
            for hierarchy in (False, True):
                found = [optimum(name, {**options, "hierarchy": hierarchy}, seed, factor, shift)
                         for seed in (None, *SEEDS)]
                common = []
                for i, (_, _, terms) in enumerate(found):
                    same = first.setdefault((i, hierarchy), terms)
                    common.append(len(terms & same) / len(terms | same))
                cells.append(f"{spread([one[0] for one in found])} | {100 * np.mean(common):.0f} % "
                             f"| {np.median([one[1] for one in found]):.3f}")
            yield f"| {way} | {' | '.join(cells)} |"
    yield from weighted()
    yield END


def weighted() -> Iterator[str]:
    """Yield the section on equations that are weighted by their denominators."""
    yield WEIGHTED
    first: dict[tuple[int | None, bool, int], frozenset[str]] = {}
    for way, factor, shift in WAYS[::3] + WAYS[-1:]:
        cells = []
        for hierarchy in (False, True):
            found = {seed: optima("rfm-terms", {"order": 2, "hierarchy": hierarchy}, seed, factor,
                                  shift, ROUNDS) for seed in WEIGHTED_SEEDS}
            for number in (0, ROUNDS - 1):
                common = [len(terms & same) / len(terms | same) for seed, sets in found.items()
                          for terms in [sets[number][2]]
                          for same in [first.setdefault((seed, hierarchy, number), terms)]]
                cells.append(f"{np.median([sets[number][0] for sets in found.values()]):.4f} | "
                             f"{100 * np.mean(common):.0f} % | "
                             f"{np.median([sets[number][1] for sets in found.values()]):.3f}")
        yield f"| {way} | {' | '.join(cells)} |"


def spread(values: list[float]) -> str:
    """Return the values of the embedded scene and, after it, the median of all."""
    return f"{values[0]:.4f}; {np.median(values):.4f}"


def optimum(name: str, options: dict[str, Any], seed: int | None, factor: float,
            shift: float) -> tuple[float, float, frozenset[str]]:
    """Return check and independent RMSE [px] and terms of the proven optimum."""
    return optima(name, options, seed, factor, shift, 1)[0]


def optima(name: str, options: dict[str, Any], seed: int | None, factor: float, shift: float,
           rounds: int) -> list[tuple[float, float, frozenset[str]]]:
    """Return as much of proven optima, each weighted by the denominators of the one before.

    Equations of points are those in the image times the denominator. So a standard deviation that
    is the denominator at each control point makes them those in the image, for all selections that
    have about these denominators.
    """
    features = simulate_scene("ikonos-hamedan") if seed is None else \
        simulate_scene("ikonos-hamedan", seed=seed)
    task = termsel.prepare(name, features=features, solver="exact", options=options)
    inputs = task.problem.inputs

    def moved(points: termsel.Points) -> termsel.Points:
        return replace(points, ground=factor * points.ground + shift)

    inputs = replace(inputs, control=replace(inputs.control, points=moved(inputs.control.points)),
                     check=moved(inputs.check))
    found = []
    while True:
        found.append(_proven(task, inputs, moved))
        if len(found) == rounds:
            return [one[:3] for one in found]
        below = inputs.model.denominators(found[-1][3], inputs.control.points.ground)
        inputs = replace(inputs, control=replace(inputs.control, points=replace(
            inputs.control.points, sigma=np.abs(below))))


def _proven(task: termsel.Task, inputs: termsel.Inputs,
            moved: Callable[[termsel.Points], termsel.Points],
            ) -> tuple[float, float, frozenset[str], FloatArray]:
    """Return check and independent RMSE [px], terms and coefficients of the proven optimum."""
    problem = SelectionProblem(inputs, terms=True, features=False, mask=inputs.options["mask"])
    *_, proof = prove(problem)
    genes = proof.front()[-1]
    terms = problem.decode(genes).terms
    # The same adjustment again, for the independent points.
    equations = inputs.model.equations(inputs.control)
    chosen = np.isin([str(term) for term in inputs.model.terms], terms)
    coefficients = np.zeros(len(chosen))
    coefficients[chosen] = np.linalg.lstsq(equations.A[:, chosen], equations.b)[0]
    independent = task.observations.independent
    scaled = moved(task.scaling.points(independent))
    errors = (inputs.model.project(coefficients, scaled.ground) - scaled.image) * inputs.pixels
    return (float(problem.evaluate(genes[None]).objectives[0, 0]),
            float(np.sqrt((errors**2).sum(axis=1).mean())), frozenset(terms), coefficients)


HEAD = """# Origin and scale of the ground coordinates

Made by `python -m benchmarks.normalisation --write`. All scenes are simulated: `ikonos-hamedan`,
and ten of the same kind with other terrain, points and errors. The optima are proven.

A selection of monomials is not invariant. If the origin moves by c, X² becomes (X + c)²: one term
becomes three. So the best selection in one coordinate system is none of that
size in another. termsel scales the ground coordinates of the control to -1 to 1. That choice is
part of every optimum on these pages, and of the selections in the papers. Below the coordinates
are moved or scaled after that.

A selection with a *hierarchy* has each term with its parents: X²Y comes with XY and X², these
with X and Y. If the origin or the scale changes, such terms span the same polynomials.
`--set hierarchy=true` selects among these alone.

Check RMSE: of the embedded scene; after it, the median of eleven scenes. "Terms in common" is the
share of terms that the optimum has in common with that of the first row, mean over scenes.
Independent RMSE: median of eleven."""

WEIGHTED = """
## RFM of second order, equations weighted by their denominators

The optimum is proven, then proven again with each equation divided by the denominator of that
optimum at its control point, and once more. Such equations are those of errors in the image, and
the weights are the same for all selections of one proof. Medians of four scenes.

| coordinates | free: check [px] | terms in common | independent [px] | weighted, check [px] | \
terms in common | independent [px] | hierarchy: check [px] | terms in common | independent [px] | \
weighted, check [px] | terms in common | independent [px] |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""

END = """
## What it means

- Scale alone changes nothing: it multiplies each term by a number. Where termsel scales each
  coordinate by its own range, the origin moves as well, and the origin matters.
- A polynomial with a hierarchy has the same optimum in all coordinates. Without, optimum and
  terms depend on the origin.
- A rational function is fitted to equations multiplied by its denominator, which is 1 at the
  origin. So another origin weighs the equations in another way, and with a hierarchy a part of
  the difference stays.
- Weights from the denominators of the best selection do not remove it: the weights are those of
  one selection, and the next proof compares all others under them. What survives is that
  the optimum of a polynomial with a hierarchy is one of the scene alone.
- Orthogonal bases are no way out: they depend on the points, or on an interval, and so on origin
  and scale themselves. With a hierarchy they span what monomials span, and add nothing.
- Conclusions on *names* of terms ("X²Y matters for this sensor") hold for one coordinate system.
  Those on accuracy are to be read from the columns of independent points.

**Recommended:** `--set hierarchy=true` where terms are to be interpreted, compared between
scenes, or published. For accuracy alone use the strategy auto. Weighting is not recommended: five
of six medians of independent points are worse by it.
"""


if __name__ == "__main__":
    main()
