"""The table of all solvers in the documentation.

``python -m benchmarks.solver_table --write`` makes docs/evidence/solver-table.md: every solver over
30 seeds and 10,000 evaluations on the embedded scene `ikonos-hamedan`, with and without local
refinement. Without ``--write`` the
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

PROBLEMS: dict[str, tuple[str, dict[str, Any]]] = {
    "rfm-terms": ("rfm-terms", {}),
    "poly-terms, 15 terms, per axis": ("poly-terms", {"degree": 4}),
    "poly-terms, 15 terms, shared": ("poly-terms", {"degree": 4, "mask": "shared"}),
    "poly-terms, 21 terms, per axis": ("poly-terms", {"degree": 5}),
    "poly-terms, 21 terms, shared": ("poly-terms", {"degree": 5, "mask": "shared"}),
    "owdis-points": ("owdis-points", {}),
    "owdis-lines": ("owdis-lines", {}),
}
EVALUATIONS = 10_000
WITHOUT_CHANCE = {"exact", "all-terms", "ridge", "stepwise", "nested-regression", "lasso", "t-test"}
HEAD = ("| solver | best | median | worst | hits | CPU s | independent | refined: best | median | "
        "worst | hits | CPU s | independent |\n|---|" + "---:|" * 12)


def main() -> None:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="problems; by default all")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--front-seeds", type=int, default=3,
                        help="seeds of solvers for several objectives, which take ten times as "
                             "long; 0 leaves them out")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write docs/evidence/solver-table.md")
    asked = parser.parse_args()
    chosen = [name for name in PROBLEMS
              if not asked.names or any(part in name for part in asked.names)]
    text = ""
    for name in chosen:
        done = "\n".join(section(name, asked.seeds, asked.front_seeds, asked.processes)) + "\n"
        print(done, file=sys.stderr, flush=True)
        text += done
    if asked.write:
        target = Path(__file__).parents[1] / "docs" / "evidence" / "solver-table.md"
        target.write_text(f"{introduction(asked.seeds, asked.front_seeds)}\n{text}")
    else:
        sys.stdout.write(text)


def introduction(seeds: int, front_seeds: int) -> str:
    """Return what stands above the tables."""
    return f"""# Solver table

Made by `python -m benchmarks.solver_table --write`: the embedded, simulated scene
`ikonos-hamedan`, {seeds} seeds, {front_seeds} for solvers of several objectives (0: left out).
Every search has {EVALUATIONS:,} evaluations. On the left the solver is alone, with its paper's
options. On the right ("refined") it has the same budget, of which the local refinement takes three
quarters. Fitness is the check RMSE [px]. "Hits" are seeds that end at the proven optimum, where
`exact` can tell it. CPU seconds and the independent RMSE [px] are medians. Solvers without chance
run once, and are not refined.

**A lower fitness is not a better model: compare the independent RMSE.** Solvers for several
objectives spend their evaluations on a whole front; the table shows its member of least fitness.
Their local refinement looks around the front and does not start again.

Alone, the solvers differ much: with 21 terms for each axis none but `swap` reaches the optimum from
most seeds. In the same budget the local refinement brings most of them to it, or close, whatever
came before: even random selections end near. It is a search of its own.
"""


def section(name: str, seeds: int, front_seeds: int, processes: int) -> Iterator[str]:
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
    able = [solver for solver in own if (front_seeds or "recommend" not in own[solver])
            and can(problem, solver, {**options, **own[solver]})]
    lucky = [solver for solver in able if solver not in WITHOUT_CHANCE]
    counts = {solver: front_seeds if "recommend" in own[solver] else seeds for solver in lucky}
    alone, refined = (
        {one.solver: one for one in standings((
            trial for solver in lucky for trial in trials(
                problem, [solver], range(1, counts[solver] + 1), evaluations=EVALUATIONS,
                polish=polish, options=options, solver_options=own, processes=processes)), best)}
        for polish in (False, True))
    certain = standings(trials(
        problem, [solver for solver in able if solver in WITHOUT_CHANCE], [1],
        evaluations=EVALUATIONS, options=options, solver_options=own), best)
    for solver in lucky:
        yield (f"| {solver} | {cells(alone[solver], counts[solver])} | "
               f"{cells(refined[solver], counts[solver])} |")
    for one in certain:
        yield f"| {one.solver} | {cells(one, 1)} | | | | | | |"
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


def cells(standing: Standing, seeds: int) -> str:
    """Return the figures of one solver."""
    hits = "" if standing.reached is None else f"{round(standing.reached * seeds)} of {seeds}"
    return (f"{standing.best:.4f} | {standing.median:.4f} | {standing.worst:.4f} | {hits} | "
            f"{standing.seconds:.2f} | {standing.independent:.3f}")


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
