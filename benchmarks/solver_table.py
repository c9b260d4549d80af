"""The page of all solvers in the documentation, made of two studies.

``python -m benchmarks.solver_table --out DIR`` runs benchmarks/solver-table-terms.toml and
benchmarks/solver-table-features.toml as `termsel compare` does, and prints their tables;
``--write`` makes docs/evidence/solver-table.md of them. The same command goes on where an earlier
one stopped, and reads a study that is finished.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import termsel
from benchmarks.sets import put
from termsel.core.errors import count_in_words
from termsel_studies.pages import table_as_markdown, tables_of

HERE = Path(__file__).parent
STUDIES = ("solver-table-terms", "solver-table-exact", "solver-table-features")

INTRODUCTION = """# Solver table

Made by the studies `benchmarks/solver-table-terms.toml`, `solver-table-exact.toml` and
`solver-table-features.toml`: `python -m benchmarks.solver_table --out DIR --write`. The scene
`ikonos-hamedan` is embedded and simulated. Every search has 10,000 evaluations, and its paper's
options; one that is repeated without blunders has them again. A solver that is "refined" has the
same budget, of which the local refinement takes three quarters. Values are the fitness, the
selection RMSE [px]. "Optimum reached" counts the seeds that end at the proven optimum, where
`exact` can find it within seconds; its interval is that of Wilson. Solvers without chance run once,
and are not refined. The independent RMSE, evaluations and CPU seconds are
medians. `exact` has a section of its own: it excludes most selections without an evaluation, so its
evaluations do not show its cost.
The optimum of `rfm-terms` is proven by a run of its own, as it takes minutes: no selection of up to
16 terms per image coordinate is below 0.7201 px. Its RMSE of 1,000 new points is 1.021 px.

**A lower fitness is not a better model: compare the independent RMSE.** A solver for several
objectives spends its evaluations on a whole front; the table shows the member of least fitness.
`ga-steady` chooses a fixed number of features, so it searches another space than the others.
"""


def main() -> None:
    """Run the studies, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the studies")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write docs/evidence/solver-table.md")
    asked = parser.parse_args()
    studies = [termsel.compare(HERE / f"{name}.toml", out=asked.out / name, workers=asked.workers)
               for name in STUDIES]
    page = "\n".join([INTRODUCTION, *map(part, studies)])
    put("solver-table", page, write=asked.write)


def part(study: termsel.Study) -> str:
    """Return the tables of a study but that of all pairs, which has hundreds of rows."""
    tables, said = tables_of(study)
    heading = f"## {study.spec.title}, {count_in_words(len(study.spec.seeds), 'seed')}\n"
    claims = "\n".join(f"- {sentence}" for sentence in said)
    return "\n".join([heading,
                      *(table_as_markdown(one, 3) for one in tables if one.caption != "Pairs"),
                      f"### What may be claimed\n\n{claims}\n"])


if __name__ == "__main__":
    main()
