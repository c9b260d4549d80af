"""Best subsets beside the field's solvers: the smallest residuals of each number of columns.

``python -m benchmarks.best_subsets --write`` makes docs/evidence/best-subsets.md. Each peer runs in
an environment of its own, which is made from a stated requirement. With ``--kept FILE`` answers are
kept, and a repeated command goes on from there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legvander

import termsel
from benchmarks.environments import NotInstalled, python_of
from benchmarks.sets import crs_of, names, put, split
from benchmarks.short_budgets import FIRST_SEED, features
from termsel import FeatureSet, Problem
from termsel.core.threads import one_blas_thread
from termsel.data.features import FloatArray
from termsel.selection.best_subsets.columns.system import SubsetSystem
from termsel.selection.best_subsets.subsets import SubsetResult, search
from termsel.selection.solvers.proofs.proof import Proof as ProofState
from termsel.selection.solvers.proofs.proof import prove
from termsel_bench.scenes.cameras import KINDS

SECONDS = 10.0
"""Limit of each answer of a peer, at which the gap of `exact` is taken, too."""

PROOF_SECONDS = 60.0
"""Limit of a proof by `exact`."""

SIZES = (4, 8, 12)
SETS = (("ikonos-hamedan", 24), ("spot-isfahan", 96), ("ventoux_lines", 48))
FAMILIES = ("poly3d", "rfm", "legendre")
SYSTEMS = tuple((family, SETS[(number + turn) % len(SETS)]) for turn in (0, 2, 1)
                for number, family in enumerate(FAMILIES))
"""Families and sets: the first three have each of them once."""


REQUIREMENTS: Mapping[str, tuple[str, ...]] = {
    "sklearn": ("scikit-learn==1.9.1",), "abess": ("abess==0.4.11",),
    "okridge": ("okridge==0.1.1", "requests==2.32.5"), "l0bnb": ("l0bnb==1.0.0",),
    "highs": ("highspy==1.16.0",)}
TITLES = {"sklearn": "scikit-learn, forward", "highs": "HiGHS, cutting planes"}


@dataclass(frozen=True, eq=False)
class Case:
    """A system whose columns and target have length 1."""

    name: str
    X: FloatArray
    y: FloatArray


def cases(first: int) -> Iterator[Case]:
    """Yield so many systems: the columns of families for sets that are there."""
    for family, (name, rows) in SYSTEMS[:first]:
        if name not in names():
            continue
        points, _ = split(name, rows, 1)
        features = FeatureSet(replace(points, roles=("control",) * rows), crs=crs_of(name))
        system = termsel.prepare("rfm-terms", features=features, criterion="ebic"
                                 ).problem.parts()[0].system
        X = columns(family, system.design)
        y = system.target[:, 0]
        yield Case(f"{family}, {name}, {rows} rows", X / np.linalg.norm(X, axis=0),
                   y / np.linalg.norm(y))


def columns(family: str, design: FloatArray) -> FloatArray:
    """Return the columns of a family, of the rows of an RFM: 20 monomials above the line come
    first."""
    if family == "rfm":
        return design
    if family == "poly3d":
        return design[:, :20]
    # Products of Legendre polynomials of X, Y and Z, by their total degree: 35 up to the fourth.
    factors = [legvander(design[:, j], 5) for j in (1, 2, 3)]
    exponents = sorted(((i, j, k) for i in range(6) for j in range(6) for k in range(6)), key=sum)
    return np.stack([factors[0][:, i] * factors[1][:, j] * factors[2][:, k]
                     for i, j, k in exponents[:39]], axis=1)


def residuals(case: Case, subset: list[int]) -> float:
    """Return the residual sum of squares of some columns."""
    A = case.X[:, subset]
    return float(((case.y - A @ np.linalg.lstsq(A, case.y)[0]) ** 2).sum())


@dataclass(frozen=True, eq=False)
class Proof:
    """What `exact` finds, and when.

    `gap` is the share of the residuals that its bound leaves open after `SECONDS`; `proven` is
    false where it was stopped.
    """

    result: SubsetResult
    to_optimum: float
    seconds: float
    gap: float
    proven: bool


def ours(case: Case, k: int) -> Proof:
    """Return the best subset, its proof or the gap that is left, and the seconds to both."""
    system = SubsetSystem(case.X, case.y[:, None])
    start = process_time()
    least = np.inf
    to_optimum = seconds = 0.0
    gap = 1.0
    for state in search(system, "rss", max_terms=k):
        seconds = process_time() - start
        if state.best[k] < least * (1 - 1e-9):
            least = float(state.best[k])
            to_optimum = seconds
        if seconds <= SECONDS:
            gap = 1.0 - float(state.floor[k]) / least if np.isfinite(least) else 1.0
        if seconds > PROOF_SECONDS:
            break
    return Proof(state, to_optimum, seconds, gap, state.complete)


def penalties(result: SubsetResult, case: Case) -> dict[int, tuple[float, float]]:
    """Return for l0bnb the penalty that has each size as its optimum, and the largest coefficient.

    Sizes that are on no corner of the convex hull have none.
    """
    best = np.append([1.0], result.best[1:max(SIZES) + 2])
    of_sizes = {}
    for k in SIZES:
        below = np.arange(k)
        above = np.arange(k + 1, len(best))
        most = ((best[below] - best[k]) / (k - below)).min()
        least = ((best[k] - best[above]) / (above - k)).max()
        if least < most:
            A = case.X[:, result.columns(k)]
            largest = float(np.abs(np.linalg.lstsq(A, case.y)[0]).max())
            of_sizes[k] = (float(np.sqrt(most * max(least, most * 1e-6)) / 2), largest)
    return of_sizes


@one_blas_thread
def rows(kept: dict[tuple[str, str, int], dict[str, Any]], first: int
         ) -> Iterator[dict[str, Any]]:
    """Yield the answers that are not kept: ours first, then those of each peer."""
    for case in cases(first):
        ours(case, 3)  # compiles
        if all((case.name, method, k) in kept for method in ("exact", *REQUIREMENTS)
               for k in SIZES):
            continue
        longest = ours(case, max(SIZES) + 1).result
        best = dict.fromkeys(SIZES, np.inf)
        for k in SIZES:
            proof = ours(case, k)
            best[k] = min(float(proof.result.best[k]), float(longest.best[k]))
            if (case.name, "exact", k) not in kept:
                yield {"case": case.name, "method": "exact", "k": k, "least": best[k],
                       "residuals": float(proof.result.best[k]), "optimum": proof.to_optimum,
                       "seconds": proof.seconds, "gap": proof.gap, "proven": proof.proven}
        asked = json.dumps({"X": case.X.tolist(), "y": case.y.tolist(), "sizes": SIZES,
                            "seconds": SECONDS, "least": best,
                            "penalties": penalties(longest, case)})
        for peer, requirements in REQUIREMENTS.items():
            if all((case.name, peer, k) in kept for k in SIZES):
                continue
            try:
                python = python_of(peer, requirements)
            except NotInstalled as reason:
                yield {"case": case.name, "method": peer, "k": 0, "failure": str(reason)}
                continue
            answers = subprocess.run(
                [python, Path(__file__).with_name("subset_peers.py"), peer], input=asked,
                capture_output=True, text=True, check=True).stdout
            for line in answers.splitlines():
                answer = json.loads(line)
                left = residuals(case, answer["columns"]) if answer["columns"] else None
                yield {"case": case.name, "method": peer, "k": answer["k"], "residuals": left,
                       "size": len(answer["columns"]), "bound": answer["bound"],
                       "failure": answer["failure"], "seconds": answer["seconds"]}


def main() -> None:
    """Run what is not kept, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kept", type=Path, help="file of answers, which are not made again")
    parser.add_argument("--first", type=int, default=len(SYSTEMS),
                        help="only so many systems; 0 runs nothing")
    parser.add_argument("--write", action="store_true", help="write docs/evidence/best-subsets.md")
    asked = parser.parse_args()
    kept: dict[tuple[str, str, int], dict[str, Any]] = {}
    if asked.kept is not None and asked.kept.exists():
        for line in asked.kept.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            kept[row["case"], row["method"], row["k"]] = row
    for row in rows(kept, asked.first):
        if asked.kept is not None:
            with asked.kept.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row) + "\n")
        kept[row["case"], row["method"], row["k"]] = row
    put("best-subsets", page(kept), write=asked.write)


def page(kept: Mapping[tuple[str, str, int], Mapping[str, Any]]) -> str:
    """Return the page."""
    proofs = {(case, k): row for (case, method, k), row in kept.items() if method == "exact"}
    lines = [HEAD, *_summary(kept, proofs)]
    for k in SIZES:
        lines += ["", f"## {k} columns", "",
                  "| system | method | seconds | residuals by the least | gap that is left |",
                  "|---|---|---:|---:|---:|"]
        for (case, size), proof in proofs.items():
            if size != k:
                continue
            lines.append(_line_of_exact(case, proof))
            lines += [_line(kept[case, peer, k], proof["least"]) for peer in REQUIREMENTS
                      if (case, peer, k) in kept]
    return "\n".join([*lines, "", EACH_SIZE, *each_size(), "", FIRST_ANSWERS, *first_answers()])


@one_blas_thread
def each_size() -> Iterator[str]:
    """Yield the rows of the table of the least residuals of each number of columns."""
    yield f"| system | seconds | {' | '.join(map(str, range(1, max(SIZES) + 1)))} |"
    yield "|---|" + "---:|" * (max(SIZES) + 1)
    for case in cases(len(SYSTEMS)):
        system = SubsetSystem(case.X, case.y[:, None])
        start = process_time()
        for latest in search(system, "rss", max_terms=max(SIZES)):
            state = latest
            seconds = process_time() - start
            if seconds > SECONDS:
                break
        # Of a size without a proof the best known subset is told, with the bound that is left.
        cells = [f"{best:.3g}" if floor >= best * (1 - PROVEN) else f"{best:.3g} ({floor:.3g})"
                 for best, floor in zip(state.best[1:], state.floor[1:], strict=True)]
        yield f"| {case.name} | {seconds:.2f} | {' | '.join(cells[:max(SIZES)])} |"


@one_blas_thread
def first_answers() -> Iterator[str]:
    """Yield the rows of the table of first answers, each next to the proven optimum."""
    yield "| image | first EBIC | seconds | proven EBIC | seconds |"
    yield "|---|---:|---:|---:|---:|"
    longest = excess = 0.0
    for kind in KINDS:
        problem = termsel.prepare("poly-terms", features=features(kind, FIRST_SEED + 1),
                                  criterion="ebic", solver="exact",
                                  options={"degree": 5}).problem
        least_ebic(problem, next(prove(problem, workers=1)))  # compiles
        start = process_time()
        first = least_ebic(problem, next(prove(problem, workers=1)))
        first_seconds = process_time() - start
        *_, complete = prove(problem, workers=1)
        least = least_ebic(problem, complete)
        longest = max(longest, first_seconds)
        excess = max(excess, first - least)
        yield (f"| {kind} | {first:.2f} | {first_seconds:.2f} | {least:.2f} | "
               f"{process_time() - start - first_seconds:.2f} |")
    yield ""
    yield (f"A first answer takes {longest:.2f} s at most, and its EBIC is at most {excess:.2f} "
           "above the proven one.")


def least_ebic(problem: Problem, proof: ProofState) -> float:
    """Return the criterion of the best selection that is known."""
    return float(problem.evaluate(proof.front()[-1][None]).objectives[0, 0])


def _line_of_exact(case: str, row: Mapping[str, Any]) -> str:
    ratio = f"{row['residuals'] / row['least']:.4g}"
    seconds = f"{row['optimum']:.3f}"
    gap = f"{row['gap']:.1%} after {SECONDS:.0f} s"
    if not row["proven"]:
        return f"| {case} | exact | {seconds}, no proof in {row['seconds']:.0f} | {ratio} | {gap} |"
    proof = "proven" if row["seconds"] <= SECONDS else f"proven; {gap}"
    return f"| {case} | exact | {seconds}, proof {row['seconds']:.3f} | {ratio} | {proof} |"


def _line(row: Mapping[str, Any], least: float) -> str:
    title = TITLES.get(row["method"], row["method"])
    if row["failure"] or row["residuals"] is None:
        return f"| | {title} | {row['seconds']:.2f} | none: {row['failure'] or 'no subset'} | |"
    if row["size"] != row["k"]:
        return f"| | {title} | {row['seconds']:.2f} | {row['size']} columns | |"
    gap = _gap(row)
    left = "" if gap is None else "proven" if gap <= PROVEN else f"{gap:.1%}"
    return f"| | {title} | {row['seconds']:.2f} | {row['residuals'] / least:.4g} | {left} |"


PROVEN = 2e-4
"""Gap of a proof: that at which peers end, and the rounding of their penalties."""


def _gap(row: Mapping[str, Any]) -> float | None:
    """Return which share of the residuals the bound leaves open, at most all of it."""
    if row["bound"] is None:
        return None
    gap = 1.0 - float(row["bound"]) / float(row["residuals"])
    return min(1.0, max(0.0, gap))


def _summary(kept: Mapping[tuple[str, str, int], Mapping[str, Any]],
             proofs: Mapping[tuple[str, int], Mapping[str, Any]]) -> Iterator[str]:
    """Yield how often each method has the least residuals, proves them, and is faster."""
    yield ("| method | asked | least residuals | proven | faster than the proof of exact "
           "| median ratio |")
    yield "|---|---:|---:|---:|---:|---:|"
    count = len(proofs)
    proven_by_exact = sum(row["proven"] and row["seconds"] <= SECONDS for row in proofs.values())
    least_by_exact = sum(row["residuals"] < row["least"] * (1 + PROVEN) for row in proofs.values())
    yield f"| exact | {count} | {least_by_exact} | {proven_by_exact} | | 1 |"
    for peer in REQUIREMENTS:
        answers = [(kept[case, peer, k], proof) for (case, k), proof in proofs.items()
                   if (case, peer, k) in kept]
        valid = [(row, proof) for row, proof in answers
                 if row["residuals"] is not None and row["size"] == row["k"]]
        ratios = [row["residuals"] / proof["least"] for row, proof in valid]
        proven = sum(gap is not None and gap <= PROVEN for gap in (_gap(row) for row, _ in valid))
        faster = sum(row["seconds"] < proof["seconds"] for row, proof in valid)
        yield (f"| {TITLES.get(peer, peer)} | {len(answers)} | "
               f"{sum(ratio < 1 + PROVEN for ratio in ratios)} | {proven} | {faster} | "
               + (f"{np.median(ratios):.4g} |" if ratios else "|"))
    unasked = [TITLES.get(peer, peer) for peer in REQUIREMENTS
               if sum((case, peer, k) in kept for case, k in proofs) < count]
    if unasked:
        yield ""
        yield f"Not run on all systems when this page was made: {', '.join(unasked)}."
    missing = sorted({f"{row['method']} ({row['failure']})" for (_, _, k), row in kept.items()
                      if not k})
    if missing:
        yield ""
        yield f"Not installed: {'; '.join(missing)}."


HEAD = f"""# Best subsets beside other solvers

Made by `python -m benchmarks.best_subsets --write`: which columns leave the smallest residual sum
of squares, for {", ".join(map(str, SIZES))} columns. Systems are the line coordinate of
simulated and measured points, by the 20 terms of `poly3d`, the 39 columns of one axis of an RFM,
without a guard against poles, and 39 products of Legendre polynomials. Columns and target have
length 1.

Each peer has an environment of its own:
{", ".join(packages[0] for packages in REQUIREMENTS.values())}.
Seconds are those of one processor core, without compilation; each answer of a peer may take
{SECONDS:.0f}. A proof ends at a relative gap of 0.01 % of the residuals, for all alike.

- **exact** needs no penalty and no bound on coefficients. It proves all sizes up to
  the one that is asked, and {PROOF_SECONDS:.0f} s is its limit; 'proven' in the first table is
  within {SECONDS:.0f}. Seconds are those to the optimum, and to its proof.
- **okridge** proves a ridge regression; its penalty is 1e-9 times the squared coefficients. Its own
  gap is relative to the explained squares, next to which residuals are tiny: it gets the gap that
  is 0.01 % of the least residuals. Its version 0.1.1 calls `lower_solve`, which it lacks, and
  gets `lower_solve_fast` by that name.
- **l0bnb** has a penalty on each column: the one that has this size as its optimum, from the proven
  residuals, which it would not know. It gets 1.2 times the largest coefficient as bound.
- **HiGHS** solves no mixed-integer quadratic programs. It gets the tangents of the least squares as
  a function of the columns in use, one by one (Bertsimas and Van Parys 2020), with the ridge
  penalty of okridge.
- **abess** splices and proves nothing. Its thresholds are absolute: it gets the target times 1,
  1e2, 1e4, 1e6 and 1e8, and the best subset counts. The constant is one of the columns here; with
  the constant taken out, `python -m benchmarks peers` has it leave at most 3 times as much.
- **scikit-learn** adds one column after another, each the best.

The gap that is left is one less the lower bound by the residuals of the subset found.
"""

EACH_SIZE = f"""## Each number of columns

The proof of `exact` for a number of columns is one for all smaller ones. The table has the least
residual sums of squares of 1 to {max(SIZES)} columns after {SECONDS:.0f} s at most; where a number
is not proven by then, the lower bound is in brackets.
"""

FIRST_ANSWERS = """## A first answer

A criterion such as EBIC needs no size. The first answer of `exact` comes from descents, which
splice as abess does, but tell all exchanges of two columns exactly from one factorisation; here
the proof hardly takes longer. The 56 products of `poly-terms` of degree 5, for line and sample
together, with 24 control points and 24 selection points of simulated images of six kinds.
"""


if __name__ == "__main__":
    main()
