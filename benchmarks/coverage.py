"""How often the interval of the predicted RMSE holds the independent RMSE, and what sigma is worth.

``python -m benchmarks.coverage --write`` makes docs/evidence/coverage.md. Sets and splits are
those of `benchmarks.sets`, with up to 300 independent check points, and scenes drawn for this page
alone: images of seven cameras, some of them looking straight down, and maps of
`benchmarks.unlike_maps`. The interval has no constant to choose; which sources of uncertainty it
has was decided on other splits of the same sets. With `--kept` a run resumes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import convert, to_builtins
from scipy.spatial import Delaunay

from benchmarks.kept import resumed
from benchmarks.sets import crs_of, names, put, rmse_of, split
from benchmarks.unlike_maps import KINDS as MAPS
from benchmarks.unlike_maps import unlike_map
from termsel.auto.auto import Auto
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.data.record.figures import CONFIDENCE, Predicted
from termsel.fitting.accuracy import predict_rmse, predict_rmse_of_fit
from termsel.simulate.catalogue import SCENES
from termsel_bench.scenes.cameras import ALL_KINDS, FRESH, image_of
from termsel_cameras.maps import MAP_NAME as OLD_MAP

COUNTS = (8, 12, 20, 40, 74)
FIRST_SPLIT = 100
"""Splits before it were those by which the sources were decided."""
FEWEST = 12
"""Control points from which on the interval is required to hold."""
FEW = 12
"""Independent points of the second table, as few as many a user has."""
CAMERAS = {f"camera: {kind}": (kind, replace(FRESH, number=31)) for kind in ALL_KINDS} | {
    f"straight down: {kind}": (kind, replace(FRESH, number=32, tilt=(0.0, 1.5)))
    for kind in ("steady", "frame")}
"""Images that were drawn for this page, and no constant was chosen by."""
NEW = (*CAMERAS, *(f"map: {kind}" for kind in MAPS))


@dataclass(frozen=True)
class Part:
    """Errors at the independent check points inside or outside the hull of the control, by sigma.
    """

    count: int
    within: tuple[float, float]  # part of lines and samples within 1 and within 1.645 sigma
    wide: float  # median sigma by the RMSE


@dataclass(frozen=True)
class Case:
    """One split: the independent RMSE, and that of a few independent check points, with intervals.

    `alone` is the prediction without what all places have in common.
    """

    name: str
    count: int
    rmse: float
    predicted: Predicted
    rmse_of_few: float
    predicted_of_few: Predicted
    alone: Predicted
    inside: Part | None
    outside: Part | None

    @classmethod
    def of(cls, figures: dict[str, Any]) -> Case:
        """Return a case as JSON has it."""
        return convert(figures, cls)

    @property
    def held(self) -> bool:
        """Whether the interval holds the RMSE."""
        return holds(self.predicted, self.rmse)

    @property
    def held_few(self) -> bool:
        """Whether that for few points holds theirs."""
        return holds(self.predicted_of_few, self.rmse_of_few)


def holds(predicted: Predicted, rmse: float) -> bool:
    """Return whether an interval holds an RMSE."""
    return predicted.low <= rmse <= predicted.high


def share(held: list[bool]) -> str:
    """Return a share in per cent with its standard error."""
    found = np.mean(held)
    return f"{100 * found:.0f} ± {100 * np.sqrt(found * (1 - found) / len(held)):.0f} %"


def drawn(name: str, count: int, seed: int) -> tuple[FeatureSet, Points]:
    """Return control and independent check points."""
    if name not in NEW:
        mine, others = split(name, count, seed)
        return FeatureSet(mine, crs=crs_of(name)), others
    first = np.arange(count + 200) < count
    if name in CAMERAS:
        kind, ranges = CAMERAS[name]
        every = image_of(kind, seed, ranges, count + 200)
    else:
        every = FeatureSet(unlike_map(name.removeprefix("map: "), count + 200, seed), crs="local")
    return every.take(first), every.points.take(~first)


@one_blas_thread
def case(name: str, count: int, seed: int) -> dict[str, Any] | None:
    """Return one split; None if the set has too few points, or the choice cannot be repeated."""
    mine, independent = drawn(name, count, seed)
    if len(independent) < 20:
        return None
    control = FitData.of(mine)
    choice = Auto().choose(control, with_contained=False)
    errors = None if choice is None else Auto().repeated(control)
    if choice is None or errors is None:
        return None
    fitted = choice.chosen
    found: FloatArray = fitted.errors(independent)
    sigma, n = fitted.sigma(independent.ground, measured=True), len(found)
    hull = Delaunay(mine.points.ground[:, :2]).find_simplex(independent.ground[:, :2]) >= 0

    def part(some: FloatArray) -> Part | None:
        if some.sum() < 3:
            return None
        ratio = np.abs(found[some]) / sigma[some]
        return Part(int(some.sum()), (float((ratio < 1).mean()), float((ratio < 1.645).mean())),
                    float(np.median(np.linalg.norm(sigma[some], axis=1)) / rmse_of(found[some])))

    def predicted(points: int) -> Predicted:
        return predict_rmse_of_fit(fitted, errors, points, independent.ground[:points])

    found_here: dict[str, Any] = to_builtins(Case(
        name, count, rmse_of(found), predicted(n), rmse_of(found[:FEW]), predicted(min(n, FEW)),
        predict_rmse(errors, fitted.effective, n, 0.0), part(hull), part(~hull)))
    return found_here


def table(cases: list[Case], wanted: list[str], counts: list[int]) -> str:
    """Return the share of splits whose interval holds the RMSE, sets by numbers of points."""
    def cell(some: list[Case]) -> str:
        return f"{sum(c.held for c in some)} of {len(some)}" if some else "-"

    def line(title: str, some: list[Case]) -> str:
        return f"| {title} | " + " | ".join(
            cell([c for c in some if c.count == count]) for count in counts) + " |"

    rows = ["| set | " + " | ".join(f"{count} points" for count in counts) + " |",
            "|---|" + "---:|" * len(counts)]
    rows += [line(name, [c for c in cases if c.name == name]) for name in wanted]
    for title, some in kinds(cases).items():
        rows.append(line(f"**{title}**", some))

    def figure(title: str, value: Callable[[list[Case]], str]) -> None:
        cells = [value(some) if (some := [c for c in cases if c.count == count]) else "-"
                 for count in counts]
        rows.append(f"| {title} | " + " | ".join(cells) + " |")

    def ratio(part: float) -> Callable[[list[Case]], str]:
        return lambda some: f"{np.quantile([c.rmse / c.predicted.rmse for c in some], part):.2f}"

    def width(some: list[Case]) -> str:
        return f"{np.median([c.predicted.high / c.predicted.low for c in some]):.1f}"

    figure(f"all, {FEW} independent check points", lambda some: share([c.held_few for c in some]))
    figure("high / low, median", width)
    for part in (0.05, 0.5, 0.95):
        figure(f"independent / predicted, {100 * part:.0f} %", ratio(part))
    return "\n".join(rows)


def kinds(cases: list[Case]) -> dict[str, list[Case]]:
    """Return cases by kind of set."""
    return {
        "drawn for this page": [c for c in cases if c.name in NEW],
        "embedded": [c for c in cases if c.name in (*SCENES, OLD_MAP)],
        "derived or measured": [c for c in cases if c.name not in (*SCENES, OLD_MAP, *NEW)]}


def verdict(cases: list[Case], counts: list[int]) -> str:
    """Return what was required next to what was measured."""
    rows = ["| what | points | required | measured | below it | above it | without what places "
            "have in common |", "|---|---:|---|---|---:|---:|---:|"]
    for title, every in (*kinds(cases).items(), ("all", cases)):
        for count in [*counts, None]:
            some = [c for c in every if c.count == count or (count is None and c.count >= FEWEST)]
            if not some:
                continue
            below, above = (f"{np.mean(out):.0%}" for out in (
                [c.rmse < c.predicted.low for c in some],
                [c.rmse > c.predicted.high for c in some]))
            rows.append(f"| {title} | {count or f'{FEWEST} and more'} | 86 to 94 % | "
                        f"{share([c.held for c in some])} of {len(some)} splits | {below} | "
                        f"{above} | {share([holds(c.alone, c.rmse) for c in some])} |")
    return "\n".join(rows)


def of_sigma(cases: list[Case], counts: list[int]) -> str:
    """Return what sigma is worth inside and outside the hull of the control."""
    rows = ["| what | points | where | within 1 sigma | within 1.645 sigma | median sigma / RMSE |",
            "|---|---:|---|---:|---:|---:|"]
    for title, every in (*kinds(cases).items(), ("all", cases)):
        for count in counts:
            for where in ("inside", "outside"):
                some = [part for c in every if c.count == count
                        and (part := getattr(c, where)) is not None]
                if not some:
                    continue
                weights = [part.count for part in some]
                one, more = (f"{np.average([part.within[i] for part in some], weights=weights):.0%}"
                             for i in (0, 1))
                rows.append(f"| {title} | {count} | {where} | {one} | {more} | "
                            f"{np.median([part.wide for part in some]):.2f} |")
    return "\n".join(rows)


def main() -> None:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--splits", type=int, default=12)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of cases that are done")
    parser.add_argument("--write", action="store_true", help="write docs/evidence/coverage.md")
    asked = parser.parse_args()
    wanted = asked.names or [*NEW, *names()]
    jobs = [(name, count, seed) for count in asked.counts for name in wanted
            for seed in range(FIRST_SPLIT, FIRST_SPLIT + asked.splits)]
    cases = [Case.of(one) for one in resumed(case, jobs, asked.processes, asked.kept) if one]
    text = f"""# The interval of the predicted RMSE

Made by `python -m benchmarks.coverage --write`: {asked.splits} splits of each set and number of
points, up to 300 independent check points. A cell says in how many splits the interval
holds the RMSE of just these independent check points with a chance of
{100 * CONFIDENCE:.0f} %: it knows their number, and what so few
of them add is part of its width. Splits that leave fewer than 20
independent check points are left out, as are those with too few points to repeat the choice.

The first sets were drawn for this page: images of seven cameras with new seeds, two of them looking
straight down, and nine kinds of maps. No constant was fitted to them. The kinds of maps, with other
seeds, were looked at when a spline became a course of the average for few points.
The embedded scenes are simulated. The other sets are derived from sensor models or measured.

The interval has no constant that was fitted to any set. Its width has three sources: few squared
errors, coefficients that few points determine, and solutions that disagree
([how](../explanation/auto-accuracy.md#its-interval)). Which sources it has was decided on other
splits of the embedded, derived and measured sets. A standard error is that of a share;
splits of a measured
set have points in common, so that it is rather larger.

## Requirement and measurement

{verdict(cases, asked.counts)}

## Sigma

`Fit.sigma` of the chosen fit at the independent check points, with the noise of a measurement
there. Of right deviations of normal errors 68 % lie within one and 90 % within 1.645.
Points are inside or
outside the hull of the control.

{of_sigma(cases, asked.counts)}

## All sets

{table(cases, wanted, asked.counts)}

A cell is a count, not a share.
"""
    put("coverage", text, write=asked.write)


if __name__ == "__main__":
    main()
