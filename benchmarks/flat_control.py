"""Control on flat ground, check points on mountains: does auto know what it does not?

``python -m benchmarks.flat_control --write`` makes docs/evidence/flat-control.md. Cameras are those
of `termsel_bench.scenes.cameras`, of the ranges that took no part in choosing any constant.
"""

from __future__ import annotations

import argparse
import re
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import Delaunay

import termsel
from benchmarks.sets import put, rmse_of
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet
from termsel_bench.scenes.cameras import FRESH, image_of

KINDS = ("steady", "agile", "frame")
COUNTS = (4, 8, 20, 40)
HILLS = {"plain": 0, "one hill": 1, "two hills": 2, "six hills": 6}
"""How many points of control are on hills; the plain has numerical dust."""

LEVEL, HIGH, OTHERS, FEWEST, DUST = 0.1, 0.2, 60, 15, 1e-5


@dataclass(frozen=True)
class Case:
    """Figures of one image."""

    true: float  # RMSE of points on mountains [px]
    predicted: float
    alone: float  # by held-out points alone
    holds: bool  # whether the interval holds the true one
    inside: float  # part of errors within 1.645 sigma
    digits: int  # the most before the point of any number in the summary


def scene(kind: str, relief: str, count: int, seed: int) -> FeatureSet:
    """Return control on a plain, with some on hills, and independent check points on mountains."""
    every, rng = image_of(kind, seed, FRESH, 800, level=LEVEL), np.random.default_rng(
        [seed, count])
    z = every.points.ground[:, 2]
    flat, high = (rng.permutation(np.flatnonzero(one)) for one in (z == 0.0, z > HIGH * z.max()))
    hills = HILLS[relief]
    mine = np.concatenate([high[:hills], flat[:count - hills]])
    plan = every.points.ground[:, :2]
    inside = Delaunay(plan[mine]).find_simplex(plan[high]) >= 0
    order = np.concatenate([mine, np.setdiff1d(high[inside], mine)[:OTHERS]])
    points = every.points.take(order)
    ground = points.ground.copy()
    ground[hills:count, 2] += DUST * rng.standard_normal(count - hills)
    roles = ("control",) * count + ("independent",) * (len(order) - count)
    return every.with_(points=replace(points, ground=ground, roles=roles))


@one_blas_thread
def case_of(kind: str, relief: str, count: int, seed: int) -> Case | None:
    """Return the figures of an image; None where it has too few points of either kind."""
    try:
        features = scene(kind, relief, count, seed)
        result = termsel.run(features=features)
    except TermselError:
        return None
    others = features.points.take(np.array(features.points.roles) == "independent")
    if len(others) < FEWEST or result.predicted is None:
        return None
    errors = result.fit.errors(others)
    near = np.abs(errors) < 1.645 * result.fit.sigma(others.ground, measured=True)
    true, found = rmse_of(errors), result.predicted
    said = result.summary(verbose=True).replace(",", "")
    assert result.strategy is not None
    assert result.strategy.predicted is not None
    return Case(true, found.rmse, result.strategy.predicted, found.low <= true <= found.high,
                float(near.mean()), max(len(one) for one in re.findall(r"\d+", said)))


def row(kind: str, relief: str, count: int, cases: list[Case]) -> str:
    """Return a row of the table."""
    ratio = np.array([one.true / one.predicted for one in cases])
    low, middle, high = np.quantile(ratio, (0.1, 0.5, 0.9))
    return (f"| {kind} | {relief} | {count} | {len(cases)} | "
            f"{np.median([one.true for one in cases]):.1f} | "
            f"{np.median([one.predicted for one in cases]):.1f} | "
            f"{low:.2f} | {middle:.2f} | {high:.2f} | {np.mean([c.holds for c in cases]):.0%} | "
            f"{np.mean([c.inside for c in cases]):.0%} |")


HEAD = """| camera | control on | points | images | true [px] | predicted [px] \
| 10 % of ratios below | median ratio | 90 % below | interval holds | within 1.645 sigma |
|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""

PAGE = """# Flat control

Control lies on a plain, and the places to map are mountains. Nothing in the points shows what a
height does in the image. Does the strategy auto know how wrong it may be there?

`python -m benchmarks.flat_control --write` makes this page.

Up to {images} images of each kind, simulated with other constants each, and {fewest} to {others}
independent check points on mountains between the control. The control is on a plain at the height 0
with numerical dust of 1e-5 m, but for some points on hills. A ratio is that of the true RMSE to the
predicted one. The interval is to hold in 90 % of cases, and 90 % of errors are to lie within 1.645
sigma.

{table}

In all rows together the interval holds in {holds:.0%} of cases, {inside:.0%} of errors lie within
1.645 sigma, and the ratio is between {low:.2f} and {high:.2f} in 80 % of cases. Held-out points
alone, as they predict errors at heights like the control's, would give a ratio of
{alone:.1f} (median of rows without six hills). The longest number in any summary has {digits}
digits before the point.

## What is missed

- Without heights that differ, the prediction is that of views in general: half a metre sideways for
  a metre of height. A view straight down is predicted too badly, one from far aside too well.
- Points given as independent show at which heights the model will be used. Without them the
  predicted RMSE is for heights like the control's, and a note says what others add.
- Places outside the control are less certain for other reasons, too, which this page leaves out.
- With a few points on hills, their errors are most of those held out, and few of them show little:
  there the ratio scatters most.
"""


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--images", type=int, default=4)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    asked = parser.parse_args()
    rows, every, alone = [HEAD], list[Case](), list[float]()
    with ProcessPoolExecutor(asked.processes) as pool:
        for kind in KINDS:
            for relief, hills in HILLS.items():
                for count in (one for one in COUNTS if one >= hills + 4):
                    cases = [one for one in pool.map(partial(case_of, kind, relief, count),
                                                     range(asked.images)) if one]
                    if cases:
                        rows.append(row(kind, relief, count, cases))
                        every += cases
                        alone += [one.true / one.alone for one in cases] * (hills < 6)
    low, high = np.quantile([one.true / one.predicted for one in every], (0.1, 0.9))
    put("flat-control", PAGE.format(
        images=asked.images, others=OTHERS, fewest=FEWEST, table="\n".join(rows), low=low,
        high=high, alone=np.median(alone),
        holds=np.mean([one.holds for one in every]), digits=max(one.digits for one in every),
        inside=np.mean([one.inside for one in every])), write=asked.write)


if __name__ == "__main__":
    main()
