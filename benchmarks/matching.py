"""Points and lines matched in rendered scenes, against the exact camera.

    python -m benchmarks.matching [--scenes 10] [--size 700] [--large] [--keep DIR] [--write]

Writes docs/evidence/matching.md. `--large` measures the whole chain on 4,000 x 4,000 px, too;
`--keep` renders scenes to a folder, and takes them from there the next time. Needs the packages
termsel-match and termsel-rpc.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import termsel
from termsel import FeatureSet, Points, write_rpc
from termsel_match.chain import georeference_image
from termsel_match.images.starts import Start
from termsel_match.judgement.selection import select_points, with_lines
from termsel_match.lines.rounds import are_bands_in_place, iterate_lines
from termsel_match.points.candidates import match_points
from termsel_match.simulated.world import WORLD_CRS, World
from termsel_match.simulated.world_files import write_world

PAGE = Path(__file__).parents[1] / "docs/evidence/matching.md"
SHARES = (0.0, 0.1, 0.3, 0.5, 0.6)
METHODS = ("selection", "RANSAC + least squares", "iterative least squares", "least squares of all")
MODEL = "rpc-drift"
WRONG = 20.0  # px, of the wrong model of the last check
TOLERANCE, SAMPLES = 2.0, 1000  # of RANSAC: px and random pairs


def spoilt(features: FeatureSet, share: float, seed: int) -> FeatureSet:
    """Return candidates of which a share is moved by 5 to 100 px in any direction."""
    rng, points = np.random.default_rng([seed, 9]), features.points
    wrong = rng.permutation(len(points))[:round(share * len(points))]
    turn, far = rng.uniform(0, 2 * np.pi, len(wrong)), rng.uniform(5, 100, len(wrong))
    image = points.image.copy()
    image[wrong] += np.stack([np.sin(turn), np.cos(turn)], axis=1) * far[:, None]
    return features.with_(points=replace(points, image=image))


def fitted(points: Points, crs: str, rpc: str) -> termsel.Fit:
    """Return the model fitted to points."""
    return termsel.fit(FeatureSet(replace(points, roles=()), crs=crs), MODEL, rpc=rpc)


def ransac(features: FeatureSet, rpc: str, seed: int) -> termsel.Fit:
    """Return the model by RANSAC of two points, then least squares of those within 2 px."""
    rng, points = np.random.default_rng([seed, 10]), features.points
    # The correction is linear in the line of the RPC: a0 + a1 l, the same for both axes.
    lon, lat = _geographic(points.ground[:, :2])
    seen = termsel.read_rpc(rpc).project(np.column_stack([lon, lat, points.ground[:, 2]]))
    away, line = points.image - seen, seen[:, 0]
    best = np.zeros(len(points), dtype=bool)
    for _ in range(SAMPLES):
        one, two = rng.choice(len(points), 2, replace=False)
        slope = (away[two] - away[one]) / (line[two] - line[one])
        rest = away - away[one] - (line - line[one])[:, None] * slope
        agree = np.linalg.norm(rest, axis=1) < TOLERANCE
        best = agree if agree.sum() > best.sum() else best
    return fitted(points.take(best), features.crs, rpc)


def iterative(features: FeatureSet, rpc: str) -> termsel.Fit:
    """Return least squares of all, repeated without those beyond 2.5 standard deviations."""
    points, used = features.points, np.ones(len(features.points), dtype=bool)
    while True:
        found = fitted(points.take(used), features.crs, rpc)
        errors = np.linalg.norm(points.image - found.project(points.ground), axis=1)
        limit = 2.5 * np.sqrt((errors[used] ** 2).sum() / (2 * used.sum() - 4))
        again = used & (errors < limit)
        if again.sum() == used.sum() or again.sum() < 6:
            return found
        used = again


def _geographic(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from pyproj import Transformer

    lon, lat = Transformer.from_crs(WORLD_CRS, "EPSG:4326", always_xy=True).transform(*plane.T)
    return np.asarray(lon), np.asarray(lat)


def rendered(world: World, keep: Path) -> Path:
    """Return the folder of a world, rendered if it is not there."""
    place = keep / f"{world.size}-{world.seed}"
    if not place.exists():
        keep.mkdir(parents=True, exist_ok=True)
        write_world(world, place)
    return place


def scene(seed: int, size: int, keep: Path) -> dict[str, float]:
    """Return the RMSE [px] of every method at 200 exact places of a scene."""
    found: dict[str, float] = {}
    world, nearer = World(size=size, seed=seed, off=30.0), World(size=size, seed=seed, off=20.0)
    place = rendered(world, keep)
    true, rpc, near = world.independent(), str(place / "image.RPB"), place / "nearer.RPB"
    write_rpc(nearer.rpc, near)
    image, roads, dem = (place / name for name in ("image.tif", "roads.gpkg", "dem.tif"))

    def error(model: object) -> float:
        away = model.project(true.ground) - true.image  # type: ignore[attr-defined]
        return float(np.sqrt((away**2).sum(axis=1).mean()))

    lon, lat = _geographic(true.ground[:, :2])
    delivered = world.rpc.project(np.column_stack([lon, lat, true.ground[:, 2]]))
    found["RPC as delivered"] = float(np.sqrt(((delivered - true.image) ** 2).sum(axis=1).mean()))
    candidates = match_points(image, place / "ortho.tif", dem=dem)
    features = FeatureSet(candidates.points, crs=candidates.crs, image_size=candidates.image_size)
    right = np.linalg.norm(features.points.image - _seen(world, features.points), axis=1) < 1.5
    found["candidates"], found["right"] = len(right), float(right.mean())
    for share in SHARES:
        some = spoilt(features, share, seed)
        selected = select_points(some, MODEL, {"rpc": rpc}, seed=seed)
        found[f"{METHODS[0]} {share}"] = error(selected.result)
        found[f"{METHODS[1]} {share}"] = error(ransac(some, rpc, seed))
        found[f"{METHODS[2]} {share}"] = error(iterative(some, rpc))
        found[f"{METHODS[3]} {share}"] = error(fitted(some.points, some.crs, rpc))
        if share == 0:
            best = selected
    for off, start in (("30", rpc), ("20", str(near))):
        lines = iterate_lines(image, roads, MODEL, {"rpc": start}, dem=dem, start=start)
        found[f"lines, {off} px"] = error(lines.result)
        if off == "30":
            both = with_lines(best, lines.features)
            found["points and lines"] = error(both.result)
    # The last check of the rounds: with a model that is right, and with one that is wrong.
    right_model = fitted(true, WORLD_CRS, rpc)
    for name, off in (("in place", 0.0), ("elsewhere", WRONG)):
        at = Start("a model", WORLD_CRS, 520.0, lambda ground,
                   off=off: right_model.project(ground) + off,
                   lambda seen, heights, off=off: right_model.locate(seen - off, heights))
        found[name] = float(are_bands_in_place(image, roads, at, dem=dem, search=60.0).mean())
    return found


def _seen(world: World, points: Points) -> np.ndarray:
    lon, lat = _geographic(points.ground[:, :2])
    return world.camera.project(np.column_stack([lon, lat, points.ground[:, 2]]))


def large(keep: Path) -> str:
    """Return time and memory of the whole chain on an image of 4,000 x 4,000 px."""
    # In processes of their own: the memory of the chain, and not that of the rendering.
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        place = pool.submit(rendered, World(size=4000, seed=1, off=30.0), keep).result()
        load = os.getloadavg()[0]
        seconds, spent, memory = pool.submit(chain, place).result()
    return (f"The whole chain on an image of 4,000 x 4,000 px, with lines, took {seconds:.0f} s "
            f"({spent:.0f} s of\nprocessor time) and {memory:.2f} GiB on {os.cpu_count()} cores, "
            f"with a load of {load:.1f} before it.")


def chain(place: Path) -> tuple[float, float, float]:
    """Return seconds, seconds of processor time and GiB of the whole chain."""
    start, spent = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        done = georeference_image(place / "image.tif", place / "ortho.tif",
                                  Path(folder) / "map.tif",
                                  dem=place / "dem.tif", vectors=place / "roads.gpkg")
    seconds, spent = time.perf_counter() - start, time.process_time() - spent
    assert not done.reasons, done.reasons
    return seconds, spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def page(scenes: list[dict[str, float]], size: int, whole: str) -> str:
    """Return the page."""
    def figures(name: str) -> str:
        values = [one[name] for one in scenes]
        return f"{np.median(values):.2f} | {max(values):.2f}"

    rows = [f"| {name} | {figures(key)} |" for name, key in (
        ("RPC as delivered", "RPC as delivered"), ("points, from 30 px", "selection 0.0"),
        ("lines alone, from 20 px", "lines, 20 px"), ("lines alone, from 30 px", "lines, 30 px"),
        ("points and lines, from 30 px", "points and lines"))]
    wrong = [f"| {method} | " + " | ".join(
        f"{np.median([one[f'{method} {share}'] for one in scenes]):.2f}" for share in SHARES) + " |"
        for method in METHODS]
    ratio = (np.median([one["selection 0.5"] for one in scenes])
             / np.median([one["selection 0.0"] for one in scenes]))
    head = " | ".join(f"{100 * share:.0f} %" for share in SHARES)
    candidates = np.median([one["candidates"] for one in scenes])
    right = 100 * np.median([one["right"] for one in scenes])
    newline = "\n"
    least = 100 * min(one["in place"] for one in scenes)
    most = 100 * max(one["elsewhere"] for one in scenes)
    return f"""# Matched points and lines

RMSE in px at 200 exact places of each of {len(scenes)} simulated scenes of {size} x {size} px,
rendered by `termsel match-example` with seeds 1 to {len(scenes)}. Candidates, selection and fit
never see these places. The model is `rpc-drift`; selections of points may choose another
correction.

| control | median | worst scene |
|---|---|---|
{newline.join(rows)}

The median scene has {candidates:.0f} candidate points, of which {right:.0f} % are within 1.5 px of
the truth.

## With wrong candidates

A share of the candidate points is moved by 5 to 100 px in any direction, in addition to those that
are wrong anyway. This is the comparison of figure 6 of Konugurthi et al. (2016) on other data.
Medians of the scenes:

| method | {head} |
|---|{"---|" * len(SHARES)}
{newline.join(wrong)}

With half of the candidates moved, the selection has {ratio:.2f} times its error without. RANSAC
draws {SAMPLES:,} pairs and takes those within {TOLERANCE:g} px. Iterative least squares leaves out
what is beyond 2.5 standard deviations, until nothing is.

## The last check of lines

Rounds of lines end with an error message unless half of the pieces have their clearest band
within 3 px of where the model sees the vector. With the true model, {least:.0f} % or more of the
pieces have it there in each scene; with a model that is {WRONG:g} px off in both directions,
{most:.0f} % or less.

## Time and memory

{whole}

To repeat: `python -m benchmarks.matching --scenes {len(scenes)} --size {size} --large --write`.
"""


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--size", type=int, default=700)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--keep", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        keep = asked.keep or Path(folder)
        whole = large(keep) if asked.large else "Not measured: `--large` measures it."
        print(whole, flush=True)
        scenes = []
        for seed in range(1, asked.scenes + 1):
            scenes.append(scene(seed, asked.size, keep))
            print(seed, {name: round(value, 3) for name, value in scenes[-1].items()}, flush=True)
    text = page(scenes, asked.size, whole)
    if asked.write:
        PAGE.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
