"""What searches are worth: their gap to the proven optimum of the RFM of 78 terms.

``python -m benchmarks.gap --out DIR`` proves the optimum of `rfm-terms`, runs the studies
benchmarks/gap-rfm.toml, gap-rfm-long.toml, gap-rfm-local.toml and gap-rfm-papers.toml, repeats
the proof for RFM of second order on more scenes, and prints the page. ``--write`` makes
docs/evidence/gap-to-optimum.md and its figure. What DIR already holds is read.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy.stats import binom

import termsel
from benchmarks.new_points import correlation_interval, rmse_interval, scene
from benchmarks.sets import ROOT, put
from termsel.data.features import FloatArray, empty_lines
from termsel.data.record.figures import RmseByRole
from termsel.data.record.search import Certificate
from termsel.results.theme import (
    BLUNDER,
    CONTROL,
    INDEPENDENT,
    UNUSED,
    chart_rows,
    require_altair,
    with_theme,
)
from termsel.selection.best_subsets.columns.system import SubtreeNode
from termsel.selection.best_subsets.score_systems import ScoreSystems, score_systems
from termsel.selection.solvers.proofs.proof import limits_of
from termsel_studies.groups import Runs, group
from termsel_studies.summaries import quantiles_with_infinity, reachable_value, wilson_interval

Front: TypeAlias = list[tuple[int, float, tuple[float, float, float]]]
"""Terms, selection RMSE and RMSE at the new points, with its interval, of the best of each size."""

HERE = Path(__file__).parent
STUDIES = ("gap-rfm", "gap-rfm-long", "gap-rfm-local", "gap-rfm-papers")
FIGURE = ROOT / "docs" / "_static" / "gap-to-optimum.svg"
SCENES = range(101, 131)
"""Seeds of the scenes of the second proof; none is that of the embedded scene."""
SHARES = (1.0, 0.98, 0.9, 0.7, 0.5, 0.3, 0.1)
"""Limits to the selection RMSE, as shares of the optimum, for which the work is sampled."""
PIECE, PIECES = 1 << 25, 80
"""Most selections of a piece of the search, and pieces of an axis that are timed."""
OPTIMUM = """
    line.num:1 line.num:X line.num:Y line.num:Z line.num:X2 line.num:X2Y line.num:Y3
    line.num:X2Z line.den:XY line.den:XZ line.den:X2Y line.den:Y2Z sample.num:1 sample.num:X
    sample.num:Y sample.num:Z sample.num:XY sample.num:XZ sample.num:YZ sample.num:XY2
    sample.num:XZ2 sample.num:X2Y sample.den:Z sample.den:XY sample.den:XZ sample.den:Y2
    sample.den:X2Y sample.den:X2Z
"""
"""Terms of the optimum on the page, whose proof takes minutes: for what needs them alone."""
NEAR = 1.3
"""Runs within so much of the optimum enter the correlation; those far off failed."""


def main() -> None:
    """Prove, run the studies, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of proof and studies")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write page and figure")
    asked = parser.parse_args()
    proof = proven(asked.out / "proof", "check-rmse")
    residuals = proven(asked.out / "proof-ebic", "ebic")
    studies = [studied(name, asked.out, asked.workers) for name in STUDIES]
    front = front_of(proof)
    put("gap-to-optimum", "\n".join(page(proof, residuals, studies, front)), write=asked.write)
    if asked.write:
        figure(front, studies[0]).save(str(FIGURE))


def studied(name: str, folder: Path, workers: int) -> termsel.Study:
    """Return a study of this folder, with the scene of the new points."""
    study = tomllib.loads((HERE / f"{name}.toml").read_text(encoding="utf-8"))
    return termsel.compare(**study, data={"ikonos-hamedan": scene()}, out=folder / name,
                           workers=workers)


def proven(folder: Path, criterion: str) -> termsel.Result:
    """Return the result of `exact`, from its folder if there is one."""
    if (folder / "result.json").is_file():
        return termsel.read_result(folder)
    return termsel.run("rfm-terms", solver="exact", criterion=criterion, out=folder)


def certified(proof: termsel.Result) -> Certificate:
    """Return the certificate of an optimum."""
    if proof.certificate is None or not proof.certificate.optimal:
        raise SystemExit("exact has not proven the optimum")
    return proof.certificate


def page(proof: termsel.Result, residuals: termsel.Result,
         studies: list[termsel.Study], front: Front) -> Iterator[str]:
    """Yield the lines of the page."""
    certificate, check = certified(proof), total(proof.rmse, "check")
    optimum = rmse_interval(errors_of(proof))
    plain = rmse_interval(quadratics()[1])
    quadratic = plain[0]
    everything = runs_of(studies)
    near = [one for one in everything if one["fitness"] < NEAR * check]
    fitness, terms, independent = (np.array([one[key] for one in near])
                                   for key in ("fitness", "n_terms", "independent"))
    share = certificate.bounded / certificate.subsets
    line, sample = (sum(name.startswith(axis) for name in proof.selection.terms)
                    for axis in ("line", "sample"))
    yield HEAD.format(
        minutes=proof.seconds / 60, check=check,
        independent=of_three(optimum), terms=line + sample, line=line,
        sample=sample, quadratic=of_three(plain), worth=100 * (optimum[0] / quadratic - 1),
        subsets=certificate.subsets, share=100 * share,
        runs=len(everything), near=len(near),
        reached=sum(one["fitness"] <= reachable_value(check) for one in everything),
        typical=100 * (np.median([one["fitness"] for one in everything]) / check - 1),
        space=certificate.space, rho=correlation_interval(fitness, independent),
        worse=100 * np.mean(independent > quadratic), median=np.median(independent),
        fewer=correlation_interval(terms, independent),
        listed=", ".join(f"`{name}`" for name in proof.selection.terms))
    yield from worth(proof)
    yield "## The best selection of each size\n"
    yield FRONT
    yield "| terms | selection RMSE [px] | RMSE at the new points [px] |\n|---:|---:|---:|"
    for terms, of_check, new in front:
        yield f"| {terms} | {of_check:.4f} | {of_three(new)} |"
    yield "\n## What searches reach\n"
    yield TABLES
    for study in studies:
        yield f"### {study.spec.title}\n"
        yield from table(study, check)
        yield ""
    yield from carried(proof)
    yield RESIDUALS.format(
        space=certified(residuals).space, seconds=residuals.seconds,
        terms=len(residuals.selection.terms), minutes=proof.seconds / 60,
        independent=of_three(rmse_interval(errors_of(residuals))))
    yield from other_scenes()
    yield END


def total(rmse: RmseByRole, role: str) -> float:
    """Return the RMSE of the points of a role [px]."""
    found = rmse[role]
    if found is None:
        raise SystemExit(f"there are no {role} points")
    return found.total


def of_three(value: tuple[float, float, float]) -> str:
    """Return a figure with its interval."""
    return "{:.3f} ({:.3f} to {:.3f})".format(*value)


def errors_of(result: termsel.Result) -> FloatArray:
    """Return errors at the independent check points (n, 2) [px]."""
    points = scene().points
    independent = points.take([role == "independent" for role in points.roles])
    return np.asarray(result.project(independent.ground) - independent.image)


def quadratics() -> tuple[FloatArray, FloatArray]:
    """Return errors (n, 2) of a quadratic polynomial, by control, and with selection points."""
    points = scene().points
    independent = points.take([role == "independent" for role in points.roles])
    together = tuple("control" if role == "check" else role for role in points.roles)
    alone, both = (
        termsel.fit(replace(scene(), points=replace(points, roles=roles), lines=empty_lines()),
                    "quadratic").errors(independent) for roles in (points.roles, together))
    return alone, both


def worth(proof: termsel.Result) -> Iterator[str]:
    """Yield the section on the optimum and a plain polynomial, fitted to the same points."""
    both = refitted(proof.selection.terms, criterion="press", check_as="control")
    found = (errors_of(proof), errors_of(both), *quadratics())
    yield WORTH.format(*(of_three(rmse_interval(errors)) for errors in found))


def refitted(terms: Sequence[str], criterion: str = "check-rmse",
             **options: str) -> termsel.Result:
    """Return the fit of these terms alone to the scene of the new points."""
    names = (str(term) for term in termsel.RationalFunctions().terms)
    others = ",".join(name for name in names if name not in terms)
    return termsel.run("rfm-terms", features=scene(), solver="all-terms", criterion=criterion,
                       options={"force_off": others, **options})


def front_of(proof: termsel.Result) -> Front:
    """Return terms, selection RMSE and RMSE at new points of the best selection of each size."""
    return [(int(member.objectives["n_terms"]), total(member.rmse, "check"),
             rmse_interval(errors_of(refitted(member.selection.terms))))
            for member in proof.front]


def carried(proof: termsel.Result) -> Iterator[str]:
    """Yield the section on the work that limits below the optimum take."""
    problem = termsel.prepare("rfm-terms", solver="exact").problem
    names = [str(term) for term in termsel.RationalFunctions().terms]
    means, variances = np.zeros((2, len(SHARES)))
    for part in problem.parts():
        whole = score_systems(part.system, part.score, part.folds,
                              limits_of(problem, part, None)[1])
        chosen = [j for j, gene in enumerate(part.genes) if names[gene] in proof.selection.terms]
        nothing = np.full(whole.k + 1, np.inf), np.zeros(whole.k + 1, dtype=np.uint64)
        alone = SubtreeNode(np.array(chosen), whole.everything.candidates[:0], 0)
        optimum = float(whole.walk(alone, *nothing).best.min())
        for i, seconds in enumerate(sampled(whole, optimum)):
            means[i] += seconds.mean()
            variances[i] += seconds.var(ddof=1) / len(seconds)
    yield CARRIED
    yield "| limit, share of the optimum | gap that it proves | work, share of the proof |"
    yield "|---:|---:|---:|"
    for share, mean, variance in zip(SHARES, means, variances, strict=True):
        yield (f"| {share:g} | {100 * (1 / share - 1):.0f} % | {100 * mean / means[0]:.0f} % "
               f"± {100 * variance**0.5 / means[0]:.0f} |")
    yield ""


def sampled(whole: ScoreSystems, optimum: float) -> Iterator[FloatArray]:
    """Yield, for every share, estimates of the processor time to rule out what scores less.

    Each is the time of one piece over the probability of drawing it. All shares have the same
    pieces, so that their ratios are more certain than their sizes.
    """
    pieces, todo = [], [whole.everything]
    while todo:
        piece = todo.pop()
        if piece.count > PIECE:
            todo += piece.halves()
        elif piece.count:
            pieces.append(piece)
    weights = np.sqrt([float(piece.count) for piece in pieces])
    weights /= weights.sum()
    drawn = np.random.default_rng(0).choice(len(pieces), PIECES, p=weights)
    masks = np.zeros(whole.k + 1, dtype=np.uint64)
    whole.walk(pieces[int(np.argmin(weights))], np.full(whole.k + 1, optimum), masks)  # compiles
    for share in SHARES:
        limit = np.full(whole.k + 1, optimum * share**2)
        seconds = np.empty(PIECES)
        for i, j in enumerate(drawn):
            start = time.process_time()
            whole.walk(pieces[j], limit, masks)
            seconds[i] = (time.process_time() - start) / weights[j]
        yield seconds


def runs_of(studies: list[termsel.Study]) -> list[dict[str, Any]]:
    """Return the runs of searches: all but those of solvers without chance."""
    return [dict(one) for study in studies for one in study.rows
            if one["state"] == "done" and one["evaluations"] > 1]


def table(study: termsel.Study, optimum: float) -> Iterator[str]:
    """Yield the lines of the table of one study: gaps in per cent of the optimum."""
    yield ("| solver | runs | least gap | median gap | largest gap | optimum reached | terms | "
           "independent [px] | evaluations | CPU s |")
    yield "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
    (by_method,) = group(study.rows, study.records, "fitness").instances.values()
    for method, runs in by_method.items():
        yield row(method, runs, optimum)


def row(method: str, runs: Runs, optimum: float) -> str:
    """Return a line of such a table."""
    least, median, largest = (f"{max(0.0, 100 * (value / optimum - 1)):.1f} %"
                              for value in quantiles_with_infinity(runs.values, (0, 0.5, 1)))
    if len(runs.values) > 1:
        low, high = (max(0.0, 100 * (value / optimum - 1)) for value in around(runs.values))
        median = f"{median} ({low:.1f} to {high:.1f})"
    reached, count = sum(value <= reachable_value(optimum)
                         for value in runs.values), len(runs.values)
    upper = 100 * wilson_interval(reached, count)[1]
    share = f"{reached}, up to {upper:.0f} %" if count > 1 else ""
    terms, evaluations, seconds = (np.median([one[key] for one in runs.rows])
                                   for key in ("n_terms", "evaluations", "cpu_seconds"))
    return (f"| {method} | {count} | {least} | {median} | {largest} | {share} | {terms:.0f} | "
            f"{spread_of([one['independent'] for one in runs.rows])} | {evaluations:,.0f} | "
            f"{seconds:.2f} |")


def around(values: list[float]) -> tuple[float, float]:
    """Return the interval of 95 % of a median, by order statistics."""
    ordered = sorted(values)
    rank = max(int(binom.ppf(0.025, len(ordered), 0.5)) - 1, 0)
    return ordered[rank], ordered[-rank - 1]


def spread_of(values: list[float]) -> str:
    """Return a median with its interval."""
    if len(values) == 1:
        return f"{values[0]:.3f}"
    return of_three((float(np.median(values)), *around(values)))


def other_scenes() -> Iterator[str]:
    """Yield the section on RFM of second order."""
    found: dict[str, list[tuple[float, float]]] = {}
    for seed in SCENES:
        features = scene(seed)
        best = termsel.run("rfm-terms", features=features, solver="exact", options={"order": 2})
        if best.certificate is None or not best.certificate.optimal:
            raise SystemExit(f"exact has not proven the optimum of scene {seed}")
        search = termsel.run("rfm-terms", features=features, solver="ga", options={"order": 2})
        auto = termsel.run("rfm-terms", features=features, strategy="auto")
        plain = {one.name: one.rmse for one in best.baselines}["quadratic"]
        for name, rmse in (("proven optimum", best.rmse), ("ga", search.rmse),
                           ("quadratic", plain), ("auto", auto.rmse)):
            found.setdefault(name, []).append((total(rmse, "check"), total(rmse, "independent")))
    values = {name: np.array(pairs) for name, pairs in found.items()}
    optimum = values["proven optimum"]
    yield SECOND.format(scenes=len(SCENES))
    yield ("| method | selection RMSE [px] | selection / optimum | independent RMSE [px] | "
           "scenes in which it is better on independent check points than the optimum |")
    yield "|---|---:|---:|---:|---:|"
    for name, pairs in values.items():
        ratio = np.median(pairs[:, 0] / optimum[:, 0])
        wins = "" if name == "proven optimum" else \
            f"{int((pairs[:, 1] < optimum[:, 1]).sum())} of {len(pairs)}"
        yield (f"| {name} | {spread_of(list(pairs[:, 0]))} | {ratio:.2f} | "
               f"{spread_of(list(pairs[:, 1]))} | {wins} |")
    yield ("\nMedians, with intervals. `quadratic` and `auto` are fitted to control and "
           "selection points together.")


def figure(front: Front, study: termsel.Study) -> Any:
    """Return the chart of selection and independent RMSE over the number of terms."""
    alt = require_altair()
    kinds = ("selection RMSE of the best selection", "its independent RMSE")
    rows = [{"terms": terms, "rmse": rmse, "what": kind}
            for terms, check, new in front if terms >= 8
            for rmse, kind in zip((check, new[0]), kinds, strict=True)]
    runs = [{"terms": one["n_terms"], "rmse": one[key], "what": kind}
            for one in runs_of([study]) if one["solver"] == "ga"
            for key, kind in (("check", "selection RMSE of a run of ga"),
                              ("independent", "its independent RMSE, ga"))]
    plain = rmse_interval(quadratics()[1])[0]
    names = [*kinds, "selection RMSE of a run of ga", "its independent RMSE, ga"]
    x = alt.X("terms:Q", title="terms, line and sample together", scale=alt.Scale(zero=False))
    y = alt.Y("rmse:Q", title="RMSE [px]", scale=alt.Scale(
        type="log", domain=[0.65, 3.5], nice=False), axis=alt.Axis(values=[0.7, 0.8, 1, 1.5, 2, 3]))
    colour = alt.Color("what:N", sort=names, legend=alt.Legend(
        title=None, orient="top", columns=2, columnPadding=60),
                       scale=alt.Scale(domain=names, range=[CONTROL, BLUNDER, UNUSED, INDEPENDENT]))
    shape = alt.Shape("what:N", sort=names, legend=None, scale=alt.Scale(
        domain=names, range=["circle", "circle", "circle", "triangle-up"]))
    lines = alt.Chart(chart_rows(rows)).mark_line(point={"size": 30}).encode(x, y, colour)
    dots = alt.Chart(chart_rows(runs)).mark_point(size=22, opacity=0.7).encode(x, y, colour, shape)
    rule = alt.Chart(chart_rows([{"rmse": plain}])).mark_rule(
        strokeDash=[5, 3], color=INDEPENDENT).encode(alt.Y("rmse:Q"))
    label = alt.Chart(chart_rows([{"rmse": plain, "terms": 8.2}])).mark_text(
        text="independent RMSE, quadratic", align="left", dy=12,
        color=INDEPENDENT).encode(x, y)
    return with_theme((dots + lines + rule + label).properties(width=560, height=330))


HEAD = """# The optimum of the RFM of 78 terms

Made by `python -m benchmarks.gap --out DIR --write`. The scene `ikonos-hamedan` is embedded and
simulated; it has the numbers of points of Akhoundi Khezrabad et al. (2020), 24 control and 24 check
points. New points are 1,000 further ones of the same scene, measured as well. Intervals are of
95 %: of an RMSE over the 1,000 points, of a median over the runs.

## In short

- The papers select terms of an RFM of 78 terms by GA, ICA or PSO, such that the RMSE at selection
  points is small. How close they come was not known. Here the optimum is proven.
- **The least selection RMSE is {check:.4f} px**, with {terms} terms. No selection of up to 16 terms
  per image coordinate has less: {subsets:,} selections were tried or excluded,
  {share:.1f} % of them by bounds.
- {reached} of {runs:,} runs of searches reached it. The median run ends {typical:.0f} % above it.
  The local search by axis below had 6 million evaluations, which take one to two minutes.
- **The optimum is a bad choice for new points:** its RMSE there is {independent} px,
  {worth:.0f} % above that of a conventional quadratic polynomial, {quadratic} px. The median of the
  searches has {median:.3f} px.
- Among the {near:,} runs within 30 % of the optimum, selection RMSE and RMSE of new points have the
  rank correlation {rho}; number of terms and RMSE of new points {fewer}.
  {worse:.0f} % of these runs are worse on new points than the quadratic polynomial.

A better search does not give a better result here, nor over
[ten scenes of the full RFM](overfitting.md). It is why termsel's strategy
[auto](honest-accuracy.md) does not minimise a selection RMSE.

## Question

An RFM has 20 terms in each numerator and 19 in each denominator, so 39 for line and 39 for sample.
A selection is fitted to the control points and judged by the RMSE at the selection points. With up
to 16 terms per image coordinate, two thirds of its equations, there are {subsets:,} selections.
Poles rule some out: no denominator may be near zero at a point.

## Proof

Line and sample share no term, so each is proven by itself. The solver `exact` walks their
selections by branch and bound. The bound uses three facts on all selections of some columns:
their fits lie on one sphere through the observations; their denominators are positive; their
squared errors at selection points are a weighted sum that the best known selection limits. A
convex quadratic form holds all three. If its minimum is above the limit, none of these selections
can be better. The module
`termsel.selection.best_subsets.bounds.closed` has the proof; tests hold it against
enumeration. Linear
programs first find how much a denominator may exceed the others, as none is below the margin at
the selection points and the guard points.

The proof took {minutes:.0f} minutes on two cores. The optimum: {listed}.
"""

WORTH = """## What it is worth

RMSE at the new points [px], with coefficients from the control points, or from control and
selection points together:

| terms | control | control and selection |
|---|---:|---:|
| the optimum | {} | {} |
| quadratic polynomial | {} | {} |

More points do not correct it: the terms themselves suit the selection points alone.
"""

FRONT = """The walk finds the best selection of each number of terms as well. One that fewer terms
beat is left out. So the selection RMSE falls with each line; the independent RMSE does not.

```{image} ../_static/gap-to-optimum.svg
:alt: With more terms the selection RMSE of the best selection falls, its independent RMSE does not.
```
"""

TABLES = """The gap is that of the selection RMSE to the optimum. "Refined" runs spend three
quarters of the same budget on local refinement. "Optimum reached" is the number of runs, and the
upper end of Wilson's 95 % interval of their share. Other columns are medians. Solvers without
chance run once. `swap` is a plain local search: each step takes the best change of line and that of
sample together. Refinement is the same search, and on by default where a problem runs with its own
solver.
"""

CARRIED = f"""## How far the bounds carry

The gap of a proof that was ended early depends on what is ruled out by then. Below, all selections
better than a share of the optimum are ruled out on each axis; the work is processor time, from
{PIECES} pieces of the search per image coordinate, with its standard error.
A gap of a few per cent takes nearly the whole proof. So `exact` first proves a wide gap, then all.
"""

RESIDUALS = """Residuals resist less. With `--criterion ebic` the same RFM is fitted to control and
selection points together, and bounds of its residuals know the poles at the guard points. The
optimum of {space} is proven in {seconds:.0f} s, the selection RMSE's in {minutes:.0f} min. It has
{terms} terms and an RMSE at the new points of {independent} px.
"""

SECOND = """## Other scenes

One scene may be an accident. With an RFM of second order, 19 terms per image coordinate, the
proof takes a
second. It was repeated on {scenes} simulated scenes of the same kind, with other terrain,
points and errors.
"""

END = """
## Limits

- One scene has a proof for the full RFM; [ten](overfitting.md) are searched. All are simulated.
- The cap of 16 terms per image coordinate is part of the claim. More terms leave less redundancy.
- The proof is one of floating-point numbers: bounds allow for rounding, but are not
  interval arithmetic. [Certificates](../explanation/certificates.md) are, and reach smaller spaces.
- The optimum holds for the ground coordinates as scaled: another origin has
  [another one](normalisation.md).
- Settings that papers do not state are termsel's own; see [Papers](../explanation/papers.md).
"""


if __name__ == "__main__":
    main()
