"""The table of all solvers in the documentation.

``python -m benchmarks.solver_table --write`` makes docs/evidence/solver-table.md: every solver over
30 seeds and 10,000 evaluations on the embedded scene `ikonos-hamedan`. Without ``--write`` the
table goes to stdout; ``--seeds N`` makes it shorter, and names of problems choose among them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.study import Standing, standings, trials
from termsel import TermselError, prepare, search
from termsel.plugins.registry import registry
from termsel.solvers.exact import count, prove

ALIKE = {"max_share": 1}
"""The same selections for all: solvers of papers have no cap by default, others have one."""
PROBLEMS: dict[str, tuple[str, dict[str, Any]]] = {
    "rfm-terms": ("rfm-terms", ALIKE),
    "poly-terms, 15 terms, per axis": ("poly-terms", {"degree": 4, **ALIKE}),
    "poly-terms, 15 terms, shared": ("poly-terms", {"degree": 4, "mask": "shared", **ALIKE}),
    "poly-terms, 21 terms, per axis": ("poly-terms", {"degree": 5, **ALIKE}),
    "poly-terms, 21 terms, shared": ("poly-terms", {"degree": 5, "mask": "shared", **ALIKE}),
    "owdis-points": ("owdis-points", {}),
    "owdis-lines": ("owdis-lines", {}),
}
EVALUATIONS = 10_000
WITHOUT_CHANCE = {"exact", "all-terms", "ridge", "stepwise", "nested-regression", "lasso", "t-test"}
HEAD = ("| solver | best | median | worst | optimum reached | evaluations | seconds | "
        "independent |\n|---|---:|---:|---:|---:|---:|---:|---:|")


def main() -> None:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="problems; by default all")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="write docs/evidence/solver-table.md")
    asked = parser.parse_args()
    chosen = [name for name in PROBLEMS
              if not asked.names or any(part in name for part in asked.names)]
    text = "\n".join(
        part for name in chosen for part in section(name, asked.seeds, asked.processes)) + "\n"
    if asked.write:
        target = Path(__file__).parents[1] / "docs" / "evidence" / "solver-table.md"
        target.write_text(f"{introduction(asked.seeds)}\n{text}")
    else:
        sys.stdout.write(text)


def introduction(seeds: int) -> str:
    """Return what stands above the tables."""
    return f"""# Solver table

Made by `python -m benchmarks.solver_table --write`: the embedded, simulated scene
`ikonos-hamedan`, {seeds} seeds, a budget of {EVALUATIONS:,} evaluations each, with local
refinement if a solver has it (the column counts its evaluations). Fitness is the check RMSE [px].
"Optimum reached" is the share of seeds that end at the proven optimum, where `exact` can tell it.
Evaluations, seconds and the independent RMSE [px] are medians. Solvers without chance run once.
Two processes ran at the same time; use the seconds only for comparison.

**A lower fitness is not a better model: compare the last column.** Solvers for several objectives
spend their evaluations on a whole front; the table shows its member of least fitness. Their local
refinement looks around the front and does not start again.
"""


def section(name: str, seeds: int, processes: int) -> Iterator[str]:
    """Yield the lines of one problem's table."""
    problem, options = PROBLEMS[name]
    best = optimum(problem, options)
    yield f"## {name}\n"
    yield f"Proven optimum: {best:.4f} px.\n" if best is not None else \
        "The optimum is not known.\n"
    yield HEAD
    own: dict[str, dict[str, Any]] = {}
    for entry in registry().entries("solvers"):
        if entry.provided_by == "termsel":
            own[entry.name] = {"recommend": "best"} if entry.object.max_objectives > 1 else {}
    if problem.startswith("owdis"):
        own["ga-steady"] = {"min_features": 12, "max_features": 12}
    able = [solver for solver in own if can(problem, solver, {**options, **own[solver]})]
    lucky = [solver for solver in able if solver not in WITHOUT_CHANCE]
    done = [*trials(problem, lucky, range(1, seeds + 1), evaluations=EVALUATIONS, options=options,
                    solver_options=own, processes=processes),
            *trials(problem, [solver for solver in able if solver in WITHOUT_CHANCE], [1],
                    evaluations=EVALUATIONS, options=options, solver_options=own)]
    for standing in standings(done, best):
        yield line(standing)
    yield ""


def can(problem: str, solver: str, options: dict[str, Any]) -> bool:
    """Return whether a solver handles a problem, judged by its first generation."""
    try:
        task = prepare(problem, solver=solver, options=options)
        search(task.problem, task.solver, evaluations=1)
    except TermselError as error:
        print(f"{problem}: {solver} skipped: {error}", file=sys.stderr)
        return False
    return True


def line(standing: Standing) -> str:
    """Return one row of a table."""
    reached = "" if standing.reached is None else f"{100 * standing.reached:.0f} %"
    return (f"| {standing.solver} | {standing.best:.4f} | {standing.median:.4f} | "
            f"{standing.worst:.4f} | {reached} | {standing.evaluations:.0f} | "
            f"{standing.seconds:.2f} | {standing.independent:.3f} |")


def optimum(problem: str, options: dict[str, Any]) -> float | None:
    """Return the proven least fitness, or None if that would take too long."""
    task = prepare(problem, options=options)
    try:
        if count(task.problem) > 1 << 22:
            return None
    except TermselError:
        return None
    *_, proof = prove(task.problem)
    return float(task.problem.evaluate(proof.front()[-1][None]).objectives[0, 0])


if __name__ == "__main__":
    main()
