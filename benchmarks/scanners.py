"""Auto on six kinds of cameras with few points, with and without what is known of scanners.

``python -m benchmarks.scanners --write`` makes docs/evidence/scanners.md. Images are those of
`termsel_bench.scenes.cameras`, of the ranges that took no part in choosing any constant; `--chosen`
takes the others. The sets are those of `benchmarks.sets`.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.sets import crs_of, names, put, rmse_of, split
from termsel.auto.auto import Auto
from termsel.auto.methods import METHODS
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.runs.request import auto_of_all
from termsel_bench.scenes.cameras import ALL_KINDS, CHOSEN, FRESH, Ranges, image_of
from termsel_cameras.scanners.photos import PHOTO_METHODS as CAMERAS

COUNTS = (6, 8, 12, 16)
INDEPENDENT = 100
KNOWN = ("physical-cubic",)
"""Candidates that know of scanners."""

PHOTOS = tuple(one.name for one in CAMERAS)
"""Candidates that know of photos, of termsel-cameras."""

OF_PHOTOS = ("frame", "panoramic", "airborne")


@dataclass(frozen=True)
class Case:
    """RMSE of independent check points [px] without and with the prior, and which candidate it was.
    """

    before: float
    after: float
    chosen: str


@one_blas_thread
def case_of(name: str, count: int, seed: int, ranges: Ranges, known: tuple[str, ...]) -> Case:
    """Return the figures of one image of a kind, or of one split of a set."""
    every_one = auto_of_all() if known == PHOTOS else Auto(methods=METHODS)
    without = Auto(methods=tuple(
        method for method in every_one.methods if method.name not in known))
    if name in ALL_KINDS:
        every = image_of(name, seed, ranges, count + INDEPENDENT)
        first = np.arange(count + INDEPENDENT) < count
        mine, others = every.take(first), every.points.take(~first)
        if known == PHOTOS:  # as a user says who knows what it is; the scanner is taken for a photo
            said = np.full(count, "panoramic" if name == "panoramic" else "frame", dtype=object)
            mine = mine.with_(points=replace(mine.points, attributes={"sensor": said}))
    else:
        points, others = split(name, count, 1000 + seed)
        mine = FeatureSet(points, crs=crs_of(name))
    control = FitData.of(mine)
    found = [portfolio.choose(control, with_contained=False) for portfolio in (without, every_one)]
    if found[0] is None or found[1] is None:
        return Case(np.nan, np.nan, "")
    before, after = (rmse_of(one.chosen.errors(others)) for one in found if one)
    return Case(before, after, found[1].method.name)


def row(name: str, count: int, cases: list[Case], known: tuple[str, ...]) -> str:
    """Return a row of the table."""
    before, after = (np.array([getattr(one, which) for one in cases])
                     for which in ("before", "after"))
    ratio = after / before
    used = np.mean([one.chosen in known for one in cases])
    return (f"| {name} | {count} | {np.median(before):.2f} | {np.median(after):.2f} "
            f"| {np.median(after) / np.median(before):.2f} | {np.median(ratio):.2f} "
            f"| {np.quantile(ratio, 0.9):.2f} | {before.max():.0f} | {after.max():.0f} "
            f"| {used:.0%} |")


HEAD = """| image | points | without [px] | with [px] | ratio of medians | median ratio | \
90 % of ratios below | worst without | worst with | chosen |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""

PAGE = """# Scanners and few points

What is it worth to know that an image may be of a scanner or radar in orbit, or a photo? Auto with
the candidate [`physical-cubic`](../explanation/auto.md#a-scanner-in-orbit) next to auto without, on
the same points. Figures are the RMSE of independent check points. A ratio below 1 says that the
prior helps.

`python -m benchmarks.scanners --write` makes this page.

## Seven kinds of images

Simulated: {images} images of each kind, {independent} independent check points each, hills, noise
of 0.2 to 1 px. Sizes are drawn: place, orbit, view, pixel, relief. Constants of the program were
chosen on images of other ranges. An agile satellite turns while it scans, in any direction; the
attitude of the small one ("cubesat") wanders by some 40 px. An airborne scanner shakes, a photo
is a central projection with distortion, and a panoramic camera turns. The radar counts samples by
the range along the ray.

{kinds}

## Sets

The embedded scenes, old maps and the measured or derived sets; {splits} splits each.

{sets}

## Photos by their equations

Auto with `frame-camera` and `panoramic-camera` (termsel-cameras) next to auto without, on {photos}
images of each kind, with {independent} independent check points each. The column `sensor` says what
the photo is; the airborne scanner is said to be a frame. Constants were chosen on images of other
ranges.

{cameras}

With 12 points one frame photo in ten is worse by the part in the table. Lenses that distort by much
more than 3 px are declined.

## What is missed

- An agile satellite, a small one or an aircraft is sometimes taken for a steady scanner. One
  image in ten is worse by the part in the table.
- ikonos_lines is up to 1.1 times as far off with it (8 points).
- With 12 points, one split in ten of phr_grid_nice_a, an agile satellite, is 1.6 times worse.
- s1_grd_iw is merged of three swaths, with steps of some pixels. One of its splits in ten is 1.2
  and 1.4 times worse with 12 and 16 points.
- Beyond 12 points the prior must also predict left-out points better; it ends at 18 points.
- With 4 or 5 points nothing distinguishes a scanner from another image, and the prior is not used.
"""


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="kinds and sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("--splits", type=int, default=10)
    parser.add_argument("--photos", type=int, default=8)
    parser.add_argument("--chosen", action="store_true", help="images constants were chosen on")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    asked = parser.parse_args()
    ranges, tables = CHOSEN if asked.chosen else FRESH, []
    with ProcessPoolExecutor(asked.processes) as pool:
        for every, number, known in (
                (ALL_KINDS, asked.images, KNOWN), (tuple(names()), asked.splits, KNOWN),
                (OF_PHOTOS, asked.photos, PHOTOS)):
            rows = [HEAD]
            for name in (one for one in every if one in (asked.names or every)):
                for count in asked.counts if number else ():
                    cases = pool.map(partial(case_of, name, count, ranges=ranges, known=known),
                                     range(number))
                    rows.append(row(name, count, list(cases), known))
            tables.append("\n".join(rows))
    put("scanners", PAGE.format(images=asked.images, splits=asked.splits, kinds=tables[0],
                                sets=tables[1], photos=asked.photos, cameras=tables[2],
                                independent=INDEPENDENT), write=asked.write)


if __name__ == "__main__":
    main()
