"""The answers of auto to 300 cases, to compare a program with itself before and after a change.

``python -m benchmarks.frozen_answers FILE`` writes a table of the choice, coefficients, predicted
RMSE with its interval, blunders and RMSEs of each case; ``--against OLD`` compares them with an
older table, to 1e-6, and ends with code 1 where any differs. ``--only TEXT`` takes the cases whose
names hold the text, ``--every N`` each N-th. Cases are satellite images, maps, photos, lines, RPCs,
some with blunders; the sets of the folder of measured data are among them where it is there.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import termsel
from benchmarks.few_points import EXACT, exact
from benchmarks.oblique import scene as oblique_scene
from benchmarks.old_maps import MAPS
from benchmarks.rpc_few_points import columns_of, error_of, places_of
from benchmarks.sets import DATA, DERIVED, MEASURED, crs_of, split
from benchmarks.unlike_maps import KINDS, unlike_map
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Points
from termsel.simulate.catalogue import SCENES
from termsel.simulate.scenes import simulate_scene
from termsel_cameras import simulate_map
from termsel_rpc.simulated import RPC_FILE

TOLERANCE = 1e-6
"""Relative difference of two numbers that are the same answer."""

NOTHING = 1e-9
"""Numbers below which only their difference counts: coefficients are of scaled coordinates."""

Case = Callable[[], FeatureSet]


def without_heights(features: FeatureSet) -> FeatureSet:
    """Return features whose points have no heights."""
    ground = features.points.ground.copy()
    ground[:, 2] = np.nan
    return features.with_(points=replace(features.points, ground=ground))


def displaced(features: FeatureSet, count: int, seed: int) -> FeatureSet:
    """Return features of which some points are blunders of 15 to 80 px."""
    rng = np.random.default_rng([seed, 99])
    image = features.points.image.copy()
    wrong = rng.permutation(len(image))[:count]
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    size = rng.uniform(15.0, 80.0, count)
    image[wrong] += size[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return features.with_(points=replace(features.points, image=image))


def weighted(features: FeatureSet, seed: int) -> FeatureSet:
    """Return features whose points have standard deviations of their own."""
    rng = np.random.default_rng([seed, 98])
    sigma = rng.uniform(0.3, 1.5, features.points.image.shape)
    return features.with_(points=replace(features.points, sigma=sigma))


def satellite(name: str, count: int, seed: int) -> FeatureSet:
    """Return points of an embedded scene, a fourth of them independent check points."""
    return simulate_scene(name, seed=seed, roles=(count, 0, max(count // 4, 2)), n_lines=0)


def of_map(kind: str, count: int, seed: int) -> FeatureSet:
    """Return points of a simulated map."""
    if kind in KINDS:
        return FeatureSet(unlike_map(kind, count, seed), crs="local")
    return FeatureSet(replace(simulate_map(seed=seed, n_points=count, **MAPS[kind]).points,
                              roles=()), crs="local")


def measured(name: str, count: int, seed: int) -> FeatureSet:
    """Return some points of a set of the folder of measured data."""
    return FeatureSet(split(name, count, seed)[0], crs=crs_of(name))


def with_rpc(kind: str, count: int, seed: int) -> FeatureSet:
    """Return points of an image with a vendor's RPC, which has an error of some kind."""
    rng = np.random.default_rng([seed, count, len(kind)])
    rpc = termsel.read_rpc(RPC_FILE)
    ground = places_of(rpc, count, rng)
    seen, columns = columns_of(rpc, ground)
    image = seen + columns @ error_of(kind, rng) + rng.normal(0.0, 0.5, (count, 2))
    points = Points(tuple(map(str, range(count))), image, ground)
    return FeatureSet(points, crs="EPSG:4979", rpc=rpc)


def with_lines(points: int, lines: int, seed: int) -> FeatureSet:
    """Return points and lines of a simulated scene, one line in ten a blunder."""
    return simulate_scene("ikonos-hamedan", seed=seed, roles=(points, 0, 4), n_lines=lines,
                          wrong_lines=lines // 10)


def cases() -> Iterator[tuple[str, Case]]:
    """Yield the names of all cases, and what makes their features."""
    for name in SCENES:
        for count in (6, 8, 10, 12, 16, 24, 40, 80):
            for seed in (1, 2):
                make = partial(satellite, name, count, seed)
                yield f"satellite {name} {count} {seed}", make
                yield f"plane {name} {count} {seed}", lambda m=make: without_heights(m())
    for kind in (*MAPS, *KINDS):
        for count in (6, 9, 12, 20, 40, 80):
            yield f"map {kind} {count}", partial(of_map, kind, count, count)
    for depression in (10, 30):
        for relief in (0, 100):
            for count in (5, 8, 14, 20):
                yield (f"photo {depression} {relief} {count}", lambda d=depression, r=relief,
                       n=count: oblique_scene(d, r, n, 1, heights=True).features)
    for kind in EXACT:
        for count in (4, 6, 10):
            yield f"exact {kind} {count}", lambda k=kind, n=count: FeatureSet(
                exact(k, n, 1), crs="local")
    for count in (12, 16, 24, 40, 80):
        for seed in (3, 4):
            make = partial(satellite, "ikonos-hamedan", count, seed)
            wrong = max(1, count // 12)
            yield f"blunders {count} {seed}", lambda m=make, w=wrong, s=seed: displaced(m(), w, s)
            yield f"plane blunders {count} {seed}", lambda m=make, w=wrong, s=seed: \
                displaced(without_heights(m()), w, s)
            yield f"map blunders {count} {seed}", lambda n=count, w=wrong, s=seed: \
                displaced(of_map("old-map", n, s), w, s)
            yield f"weighted {count} {seed}", lambda m=make, s=seed: weighted(m(), s)
    for kind in ("shift", "drift", "affine"):
        for count in (1, 2, 4, 8, 16):
            yield f"rpc {kind} {count}", partial(with_rpc, kind, count, count)
    for points, lines in ((0, 14), (0, 30), (8, 6), (16, 12)):
        yield f"lines {points} {lines}", partial(with_lines, points, lines, 7)
    for count in (150, 400, 1100):
        yield f"many {count}", partial(satellite, "spot-isfahan", count, 5)
        yield f"many map {count}", partial(of_map, "old-map", count, 5)
    for name in (*DERIVED, *MEASURED):
        if (DATA / name).is_dir():
            for count in (8, 15, 30):
                yield f"measured {name} {count}", partial(measured, name, count, 1)


def answer(make: Case) -> dict[str, Any]:
    """Return what auto answers to a case."""
    try:
        result = termsel.run(features=make()).to_dict()
    except TermselError as error:
        return {"refused": str(error)}
    strategy = result["strategy"]
    return {
        "chosen": strategy["chosen"], "held_out": strategy["predicted"],
        "candidates": [[row["name"], row["effective"], row["predicted"]]
                       for row in strategy["candidates"]],
        "coefficients": result["coefficients"], "predicted": result["predicted"],
        "final": (result.get("final") or {}).get("coefficients"),
        "outliers": result["outliers"], "rmse": result["rmse"],
        "baselines": [[row["name"], row["predicted"]] for row in result["baselines"]]}


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """Yield where two answers differ, and by what."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from differences(before, after, f"{where}[{number}]")
    elif isinstance(old, float) and isinstance(new, float | int):
        if not math.isclose(old, new, rel_tol=TOLERANCE, abs_tol=NOTHING):
            yield f"{where}: {old!r} was, {new!r} is"
    elif old != new:
        yield f"{where}: {old!r:.60} was, {new!r:.60} is"


def main() -> int:
    """Write the table, and compare it with another."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--every", type=int, default=1)
    asked = parser.parse_args()
    old = json.loads(asked.against.read_text(encoding="utf-8")) if asked.against else {}
    table = {}
    changed = 0
    for number, (name, make) in enumerate(cases()):
        if asked.only not in name or number % asked.every:
            continue
        start = time.process_time()
        table[name] = json.loads(json.dumps(answer(make)))
        seconds = time.process_time() - start
        lines = list(differences(old[name], table[name])) if name in old else []
        changed += bool(lines)
        sys.stdout.write(f"{name}: {seconds:.2f} s {table[name].get('chosen')}\n")
        for line in lines[:6]:
            sys.stdout.write(f"    {line}\n")
        sys.stdout.flush()
    asked.file.write_text(json.dumps(table, indent=0), encoding="utf-8")
    sys.stdout.write(f"{len(table)} cases, {changed} differ\n")
    return int(changed > 0)


if __name__ == "__main__":
    sys.exit(main())
