"""A vendor's RPC and a few points: the strategy auto next to the best correction in hindsight.

``python -m benchmarks.rpc_few_points --write`` makes docs/evidence/rpc-few-points.md. RPCs are real
ones, where they are at hand, and that of the embedded data set. Their errors, the points and the
noise are simulated. No constant of the program was chosen by these cases.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.sets import DATA, put
from termsel import FeatureSet, Points, Rpc, read_rpc
from termsel.auto.blunders import find_blunders
from termsel.core.threads import one_blas_thread
from termsel.data.features import FloatArray
from termsel.data.fit_data import FitData
from termsel.runs.request import auto_of_all
from termsel_rpc.simulated import RPC_FILE

COUNTS = (1, 2, 4, 8, 16)
KINDS = ("shift", "drift", "affine")
FILES = (RPC_FILE, *(Path(DATA) / "rpc" / "original" / name for name in (
    "rpc_IKONOS.txt", "rpc_WV3.xml", "rpc_PLEIADES.xml", "md_kompsat.rpc", "rpc_PLANET_L1B.txt")))
SIZES, NOISES, BLUNDERS = (1.0, 60.0), (0.3, 1.0), (10.0, 80.0)
COLUMNS = {0: "as delivered", 1: "shift", 2: "drift", 3: "affine"}
WITH_BLUNDER = 5
CHECKS = 300


@dataclass(frozen=True)
class Case:
    """One scene: errors [px] over all the image, true and as measured, of auto and the others."""

    kind: str
    count: int
    auto: tuple[float, float]
    others: dict[int, tuple[float, float]]
    chosen: str
    named: bool = False  # the blunder, if there is one, left out or not
    left_out: bool = False
    falsely: int = 0  # right points that are left out

    def to_best(self, measured: int) -> float:
        """Return the ratio to the best correction in hindsight."""
        return self.auto[measured] / min(one[measured] for one in self.others.values())

    def to_delivered(self, measured: int) -> float:
        """Return the ratio to the RPC as delivered."""
        return self.auto[measured] / self.others[0][measured]


def error_of(kind: str, rng: np.random.Generator) -> FloatArray:
    """Return an RPC's error: of 1, line and sample (-1 to 1 in the image) [px], shape (3, 2)."""
    size = np.exp(rng.uniform(*np.log(SIZES)))
    error = np.zeros((3, 2))
    if kind == "affine":
        error = rng.normal(size=(3, 2))
        return np.asarray(error * size / np.linalg.norm(error))
    share = 1.0 if kind == "shift" else rng.uniform()
    one, other = (np.array([np.cos(turn), np.sin(turn)]) for turn in rng.uniform(0, 2 * np.pi, 2))
    error[0] = size * share * one
    if kind == "drift":  # from nothing at the first line to the rest at the last
        error[:2] += size * (1 - share) * other / 2
    return error


def places_of(rpc: Rpc, count: int, rng: np.random.Generator) -> FloatArray:
    """Return ground positions anywhere in the image and in a part of the RPC's heights."""
    unit = rng.uniform(-0.95, 0.95, (count, 3)) * [1, 1, 0.3]
    return rpc.locate(unit[:, :2] * rpc.image_scale + rpc.image_offset,
                      unit[:, 2] * rpc.ground_scale[2] + rpc.ground_offset[2])


def columns_of(rpc: Rpc, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where an RPC sees places, and 1, line and sample there, from -1 to 1."""
    seen = rpc.project(ground)
    return seen, np.column_stack([np.ones(len(seen)), (seen - rpc.image_offset) / rpc.image_scale])


@one_blas_thread
def case(asked: tuple[str, int, int, bool]) -> Case:
    """Return what auto and least squares make of a scene; with a blunder, or none."""
    kind, count, seed, blunder = asked
    rng = np.random.default_rng([seed, count, KINDS.index(kind), blunder])
    files = [file for file in FILES if file.exists()]
    rpc = read_rpc(files[seed % len(files)])
    error, noise = error_of(kind, rng), rng.uniform(*NOISES)
    ground, others = places_of(rpc, count, rng), places_of(rpc, CHECKS, rng)
    seen, columns = columns_of(rpc, ground)
    image = seen + columns @ error + rng.normal(0, noise, (count, 2))
    right = np.ones(count, dtype=bool)
    if blunder:
        right[rng.integers(count)] = False
        turn = rng.uniform(0, 2 * np.pi)
        image[~right] += np.exp(rng.uniform(*np.log(BLUNDERS))) * np.array([np.cos(turn),
                                                                          np.sin(turn)])
    there, of_checks = columns_of(rpc, others)
    true = there + of_checks @ error
    of_measuring = rng.normal(0, noise, true.shape)

    def missed(predicted: FloatArray) -> tuple[float, float]:
        one, two = (float(np.sqrt(((predicted - one) ** 2).sum(axis=1).mean()))
                    for one in (true, true + of_measuring))
        return one, two

    rows = {width: there + of_checks[:, :width] @ np.linalg.lstsq(
        columns[right][:, :width], (image - seen)[right])[0]
        for width in COLUMNS if width <= right.sum()}
    points = Points(tuple(map(str, range(count))), image, ground)
    control, portfolio = FitData.of(FeatureSet(points, crs="EPSG:4979", rpc=rpc)), auto_of_all()
    suspects = portfolio.suspects(control) or find_blunders(control, portfolio)
    out = np.zeros(count, dtype=bool) if suspects is None else suspects.blunders
    choice = portfolio.choose(control.take(~out), with_contained=False)
    assert choice is not None
    return Case(kind, count, missed(choice.chosen.project(others)),
                {width: missed(one) for width, one in rows.items()}, choice.method.name,
                suspects is not None and bool((out | suspects.undecided)[~right].any()),
                bool(out[~right].any()), int(out[right].sum()))


def table(cases: Sequence[Case]) -> Iterator[str]:
    """Yield the rows: a number of points and a kind of error each, and all kinds together."""
    yield ("| points | error | cases | to best, median | 90 % | to best as measured, median | 90 % "
           "| to delivered, worst | as measured, worst | RPC chosen |")
    yield "|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|"
    for count, kind in product(COUNTS, (*KINDS, "all")):
        some = [one for one in cases if one.count == count and kind in (one.kind, "all")]
        best, measured = (np.array([one.to_best(i) for one in some]) for i in (0, 1))
        worst = [max(one.to_delivered(i) for one in some) for i in (0, 1)]
        chosen = np.mean([one.chosen.startswith("rpc") for one in some])
        yield (f"| {count} | {kind} | {len(some)} | {np.median(best):.2f} | "
               f"{np.quantile(best, 0.9):.2f} | {np.median(measured):.2f} | "
               f"{np.quantile(measured, 0.9):.2f} | {worst[0]:.2f} | {worst[1]:.2f} | "
               f"{chosen:.0%} |")


def summary(cases: Sequence[Case], blunders: Sequence[Case]) -> Iterator[str]:
    """Yield what is required and what was measured."""
    yield "| what | required | measured |\n|---|---|---|"
    for what, i in (("true places", 0), ("places as measured", 1)):
        medians = [float(np.median([one.to_best(i) for one in cases if one.count == count]))
                   for count in COUNTS]
        worst = np.array([one.to_delivered(i) for one in cases])
        yield (f"| RMSE by that of the best correction in hindsight, {what}, median with "
               f"{', '.join(map(str, COUNTS))} points | at most 1.15 | "
               f"{', '.join(f'{one:.2f}' for one in medians)} |")
        yield (f"| RMSE by that of the RPC as delivered, {what}, worst of {len(cases)} | at most "
               f"1.3 | {worst.max():.2f}; {(worst > 1.3).sum()} of {len(worst)} above |")
    named, out = (sum(getattr(one, name) for one in blunders) for name in ("named", "left_out"))
    yield (f"| one blunder of 10 to 80 px among {WITH_BLUNDER} points is named; left out | "
           f"always | {named} of {len(blunders)}; {out} |")
    yield (f"| right points left out, without blunders | | "
           f"{sum(one.falsely for one in cases)} of {sum(one.count for one in cases)} |")
    ratios = [one.to_best(0) for one in blunders]
    yield (f"| RMSE with a blunder by that of the best correction that knows it, median | | "
           f"{np.median(ratios):.2f} |")


def above(cases: Sequence[Case]) -> str:
    """Return in words which cases are worse than the RPC as delivered by more than 1.3."""
    some = [one for one in cases if one.to_delivered(0) > 1.3]
    counts = sorted({one.count for one in some})
    return "; ".join(f"{sum(one.count == count for one in some)} with {count}"
                     for count in counts) or "none here"


def main() -> None:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--cases", type=int, default=30, help="of each kind and number of points")
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", action="store_true",
                        help="write docs/evidence/rpc-few-points.md")
    asked = parser.parse_args()
    seeds, start = range(asked.first, asked.first + asked.cases), time.perf_counter()
    with ProcessPoolExecutor(asked.workers) as pool:
        cases = list(pool.map(case, [(kind, count, seed, False) for count in COUNTS
                                     for kind in KINDS for seed in seeds]))
        blunders = list(pool.map(case, [(kind, WITH_BLUNDER, seed, True) for kind in KINDS
                                        for seed in seeds]))
    sys.stderr.write(f"{time.perf_counter() - start:.0f} s\n")
    put("rpc-few-points", TEXT.format(
        cases=len(cases), each=asked.cases, summary="\n".join(summary(cases, blunders)),
        above=above(cases), table="\n".join(table(cases))), write=asked.write)


TEXT = """# An RPC and a few points

Made by `python -m benchmarks.rpc_few_points --write`: {cases} simulated cases, {each} of each
number of points and kind of error. RPCs are real ones of five vendors, and that of an embedded
data set. An error is

- a shift,
- a drift along the lines, from nothing at the first to its full size at the last, and a shift of
  any share,
- or affine, with six random coefficients.

Its size is 1 to 60 px, alike on a logarithmic scale; noise is 0.3 to 1 px in line and in sample.
Points lie anywhere in the image. auto is compared with four corrections by least squares: as
delivered, shift, drift and affine, as far as the points determine them. The best of them is
chosen with hindsight, case by case, by its RMSE over the whole image. "As measured" adds the
noise of a measurement to the places that are compared, as it is in independent check points.

How corrections are [averaged](../how-to/rpc-few-points.md) has these constants: a shift has half
of the probability beforehand, no error a quarter, drift and affine an eighth each; noise is half
a pixel within a factor of 2, and from three points on its logarithm has Student's distribution with
4 degrees of freedom about that. They were set on other cases of the same kind, among a few round
numbers.

## Requirement and measurement

{summary}

With one point no method separates drift from shift. Where the point lies at an edge that a drift
has moved, a shift by it is wrong elsewhere. Say the RPC has a drift d l about its middle and no
shift, l being -1 to 1 over the lines. The RPC as delivered misses d / sqrt(3). Correcting the share
q of what a point at l shows raises this by the factor sqrt(1 + 3 q^2 l^2), which is above 1.3 where
q l is above 0.48. So "never above 1.3" with a point near an edge means to leave half of each shift
uncorrected. Shifts are what vendors' errors mostly are, so they are corrected, and the stated sigma
holds the drift. Cases above 1.3 by number of points: {above}. With two points the best correction
in hindsight is often the drift that fits both exactly, which they do not give away. A blunder among
five points is not named where the other four do not determine an affine error well enough to
contradict it.

## All cases

{table}
"""


if __name__ == "__main__":
    main()
