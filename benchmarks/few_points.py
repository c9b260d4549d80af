"""Few points: auto next to the conventional model, and for maps the spline, best in hindsight.

``python -m benchmarks.few_points --write`` makes docs/evidence/few-points.md. Sets are those of
`benchmarks.sets`, the simulated maps of `benchmarks.old_maps` and `benchmarks.unlike_maps`, and
images that are exactly affine or projective. A ratio is that of medians over splits. With `--kept`
a run resumes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median

import numpy as np

import termsel
from benchmarks.kept import resumed
from benchmarks.old_maps import MAPS, drawn
from benchmarks.sets import MEASURED, crs_of, names, put, rmse_of
from benchmarks.unlike_maps import KINDS, unlike_map
from termsel.auto.auto import Auto
from termsel.auto.methods import named
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData

PLAIN = ("affine", "projective", "dlt", "quadratic")
SPLINES = ("tps", "tps, exact")
EXACT = ("affine, space", "affine, plane", "projective, plane")
OLD_MAPS = (*MAPS, *KINDS, *MEASURED[2:])
NOISE = 0.5
REQUIRED, ANY = 1.05, 1.3


def exact(kind: str, count: int, seed: int) -> Points:
    """Return points of an image of 4000 px that is of one kind, but for noise."""
    rng = np.random.default_rng([count, seed])
    at = rng.uniform(-1.0, 1.0, (count, 3))
    relief = 0.1 * at[:, 2:] * rng.normal(0, 0.4, 2) * ("space" in kind)
    image = 2000.0 * (at[:, :2] + relief)
    if kind.startswith("projective"):
        image /= 1.0 + at[:, :2] @ rng.normal(0, 0.05, (2, 1))
    ground = at * [20e3, 20e3, 2e3 if "space" in kind else np.nan]
    return Points(tuple(map(str, range(count))), image + rng.normal(0, NOISE, (count, 2)), ground)


def split(name: str, count: int, seed: int) -> tuple[FeatureSet, Points]:
    """Return control and independent check points."""
    if name in EXACT or name in KINDS:
        every = (exact if name in EXACT else unlike_map)(name, count + 150, seed)
        first = np.arange(count + 150) < count
        mine, others = every.take(first), every.take(~first)
    else:
        mine, others = drawn(name, count, seed)
    return FeatureSet(mine, crs=crs_of(name)), others


@one_blas_thread
def errors_of(name: str, count: int, seed: int) -> dict[str, float]:
    """Return the independent RMSE [px] of auto, of conventional models and of splines."""
    mine, independent = split(name, count, seed)
    control = FitData.of(mine)
    choice, found = Auto().choose(control, with_contained=False), dict[str, float]()
    found["auto"] = np.inf if choice is None else rmse_of(choice.chosen.errors(independent))
    for plain in PLAIN:
        candidate = named(plain)
        if candidate is not None and candidate.declines(control) is None:
            try:
                found[plain] = rmse_of(termsel.fit(mine, candidate).errors(independent))
            except TermselError:  # not determined
                continue
    for spline in SPLINES if name in OLD_MAPS else ():
        fitted = termsel.fit(mine, "tps") if spline == "tps" else \
            termsel.fit(mine, "tps", smoothing=0.0)
        found[spline] = rmse_of(fitted.errors(independent))
    return found


PAGE = """# Few points

Six to twelve points hardly determine a model. Is `auto` then as good as the conventional model that
one would take in hindsight, and for maps as good as a thin-plate spline?

Made by `python -m benchmarks.few_points --write`: {splits} splits of each set and number of points.
Structures are {plain}; splines are smoothed by REML, or exact.
The best is that of the least median of the independent RMSE over all splits, chosen with hindsight,
and a ratio is that of medians; "to the better" is that to the better of structure and spline. Each
split of a simulated set has another seed. The first {maps} sets are maps: those of
[Old maps](old-maps.md), nine kinds drawn by other mechanisms, and measured ones. The last three are
images that are exactly affine or projective, but for {noise:g} px.

## Requirement and measurement

{verdict}

## All sets

| set | points | best structure | px | best spline | px | auto | ratio | to the better |
|---|---:|---|---:|---|---:|---:|---:|---:|
{rows}

## What is missed

- With six points a plane has six equations left: nothing separates noise from deformation. Where a
  map is sound, an affine model is better than the average by up to 12 %, on one measured map by
  24 %; with ten points and more by some per cent.
- Maps that deform strongly and smoothly, or jump at one joint, are predicted worse than by an exact
  spline with 8 to 12 points, as polynomials and noise stay in the average.
"""


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=[6, 8, 10, 12])
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of cases that are done")
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    asked = parser.parse_args()
    wanted = asked.names or [name for name in dict.fromkeys((*OLD_MAPS, *names(), *EXACT))
                             if name not in MEASURED or name in names()]
    jobs = [(name, count, seed) for name in wanted for count in asked.counts
            for seed in range(asked.splits)]
    found = dict(zip(jobs, resumed(errors_of, jobs, asked.processes, asked.kept), strict=True))
    rows = []
    plain: dict[int, dict[str, float]] = {count: {} for count in asked.counts}
    better: dict[int, dict[str, float]] = {count: {} for count in asked.counts}
    of_spline: dict[int, dict[str, float]] = {count: {} for count in asked.counts}
    for name in wanted:
        for count in asked.counts:
            every = [found[name, count, seed] for seed in range(asked.splits)]
            medians = {kind: median(one.get(kind, np.inf) for one in every)
                       for kind in ("auto", *PLAIN, *SPLINES)}
            best, spline = (min(some, key=medians.__getitem__) for some in (PLAIN, SPLINES))
            ratio = plain[count][name] = medians["auto"] / medians[best]
            cells = ["-", "-", "-"]
            if name in OLD_MAPS:
                least = min(medians[best], medians[spline])
                better[count][name] = medians["auto"] / least
                of_spline[count][name] = medians["auto"] / medians[spline]
                cells = [spline, f"{medians[spline]:.2f}", f"{better[count][name]:.2f}"]
            rows.append(f"| {name} | {count} | {best} | {medians[best]:.2f} | {cells[0]} | "
                        f"{cells[1]} | {medians['auto']:.2f} | {ratio:.2f} | {cells[2]} |")
    put("few-points", PAGE.format(
        splits=asked.splits, plain=", ".join(PLAIN), maps=len(OLD_MAPS), noise=NOISE,
        verdict=verdict(plain, of_spline, better), rows="\n".join(rows)), write=asked.write)


def verdict(plain: dict[int, dict[str, float]], of_spline: dict[int, dict[str, float]],
            better: dict[int, dict[str, float]]) -> str:
    """Return what was required next to what was measured."""
    lines = ["| what | points | required | median over sets | sets above it |",
             "|---|---:|---|---:|---|"]
    for what, ratios, limit in (("auto by the best structure", plain, ANY),
                                ("maps: auto by the spline", of_spline, REQUIRED),
                                ("maps: auto by the better of structure and spline", better,
                                 REQUIRED)):
        for count, found in ratios.items():
            if not found:
                continue
            above = ", ".join(f"{name} ({ratio:.2f})" for name, ratio in found.items()
                              if ratio > limit) or "none"
            asked = f"at most {REQUIRED}, on any set {ANY}" if ratios is plain else \
                f"at most {REQUIRED}"
            lines.append(f"| {what} | {count} | {asked} | {median(found.values()):.2f} | {above} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
