"""Verdicts of `auto-georeference` on rendered places: bad ones, that must not pass, and good ones.

    python -m benchmarks.verdicts [--bad 200] [--good 200] [--size 400] [--jobs 1]
                                  [--kept FILE [--seconds S]] [--write]

A bad case passes if a map would be made without a remark. Writes docs/evidence/verdicts.md. With
--kept, cases that the file has are not done again, and the others are added: so a run can be made
in parts of --seconds. Needs the packages termsel-match and termsel-rpc.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from time import monotonic

import numpy as np
import rasterio

from termsel import TermselError
from termsel_match.chain import judge
from termsel_match.simulated.scenery import Scenery
from termsel_match.simulated.world import World
from termsel_match.simulated.world_files import write_world

PAGE = Path(__file__).parents[1] / "docs/evidence/verdicts.md"
BAD = ("seam", "half replaced", "another place", "wrong heights", "repeated texture", "clouds")
REFUSED, REMARKED, PASSED = "refused", "remark", "passed"


class Repeated(World):
    """A world whose ground repeats."""

    @cached_property
    def ground(self) -> Scenery:
        """What is on the ground: one tile, again and again."""
        own = World(size=self.size, seed=self.seed).ground
        period = int(self._rng(20).integers(60, 160))
        times = -(-len(own.buildings) // period)

        def tiled(pixels: np.ndarray) -> np.ndarray:
            return np.tile(pixels[:period, :period], (times, times))[:len(pixels), :len(pixels)]

        return replace(own, days=(tiled(own.days[0]), tiled(own.days[1])),
                       buildings=np.zeros_like(own.buildings))


@dataclass(frozen=True)
class Verdict:
    """What was said of a case.

    Parameters
    ----------
    kind, what : str
        What was done to the place, in general and in particular.
    seed : int
    end : str
        "refused", "remark" or "passed".
    told, true : float
        RMSE [px] of independent candidates, and at 200 exact places; NaN where it was refused
        without a model.
    said : str
        Remarks and reasons.
    """

    kind: str
    what: str
    seed: int
    end: str
    told: float
    true: float
    said: str


def verdict(kind: str, seed: int, size: int, folder: Path) -> Verdict:
    """Return what is said of a case, which the seed draws."""
    rng, good = np.random.default_rng([seed, 50]), kind == "good"
    world = (Repeated if kind == "repeated texture" else World)(
        size=size, seed=seed, off=float(rng.uniform(5, 40)) if good else 30.0,
        off_nadir=float(rng.uniform(3, 20)) if good else 12.0)
    place = folder / f"{kind}-{seed}".replace(" ", "-")
    write_world(world, place)
    what = spoil(kind, world, place, rng)
    told = true = float("nan")
    try:
        done = judge(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", seed=1)
    except TermselError as error:
        return Verdict(kind, what, seed, REFUSED, told, true, error.what)
    exact = world.independent()
    away = done.selected.result.project(exact.ground) - exact.image
    told, true = done.selected.rmse, float(np.sqrt((away**2).sum(axis=1).mean()))
    end = REFUSED if done.reasons else REMARKED if done.remarks else PASSED
    return Verdict(kind, what, seed, end, told, true, " ".join((*done.reasons, *done.remarks)))


def spoil(kind: str, world: World, place: Path, rng: np.random.Generator) -> str:
    """Change files of a place as a kind of case has it, and return in words what was done."""
    part, axis, end = float(rng.uniform(0.35, 0.6)), int(rng.integers(2)), int(rng.integers(2))

    def some(shape: tuple[int, ...]) -> tuple[slice, slice]:
        count = round(part * shape[axis])
        own = slice(count) if end else slice(shape[axis] - count, None)
        return (own, slice(None)) if axis == 0 else (slice(None), own)

    where = f"{100 * part:.0f} %"
    if kind == "seam":
        far, turn = rng.uniform(2, 12), rng.uniform(0, 2 * np.pi)
        move = np.round(far * np.array([np.sin(turn), np.cos(turn)])).astype(int)
        with _changed(place / "ortho.tif") as pixels:
            pixels[some(pixels.shape)] = np.roll(pixels, move, axis=(0, 1))[some(pixels.shape)]
        return f"{where} of the reference moved by {np.hypot(*move):.1f} px"
    if kind in ("half replaced", "another place"):
        other = World(size=world.size, seed=world.seed + 5000).ortho()
        with _changed(place / "ortho.tif") as pixels:
            of = some(pixels.shape) if kind == "half replaced" else (slice(None), slice(None))
            pixels[of] = other[of]
        return f"{where if kind == 'half replaced' else 'all'} of the reference is of another place"
    if kind == "wrong heights":
        fault = rng.choice(["300 m too high", "zero", "upside down"])
        with _changed(place / "dem.tif") as heights:
            heights[:] = {"300 m too high": heights + 300, "zero": 0 * heights,
                          "upside down": 2 * heights.mean() - heights}[str(fault)]
        return f"the heights are {fault}"
    if kind == "clouds":
        with _changed(place / "image.tif") as pixels:
            of = some(pixels.shape)
            pixels[of] = np.round(1700 + 10 * rng.standard_normal(pixels[of].shape))
        return f"clouds over {where} of the image"
    return "a tile of the ground again and again" if kind == "repeated texture" else "nothing"


@contextmanager
def _changed(path: Path) -> Iterator[np.ndarray]:
    """Yield pixels of a raster of one band, which are written at the end."""
    with rasterio.open(path) as raster:
        pixels = raster.read(1)
    yield pixels
    with rasterio.open(path, "r+") as raster:
        raster.write(pixels, 1)


def page(cases: list[Verdict], size: int) -> str:
    """Return the page."""
    rows = []
    for kind in (*BAD, "good"):
        own = [case for case in cases if case.kind == kind]
        ends = Counter(case.end for case in own)
        true = [case.true for case in own if case.end != REFUSED]
        worst = f"{max(true):.2f}" if true else "-"
        rows.append(f"| {kind} | {len(own)} | {ends[REFUSED]} | {ends[REMARKED]} | {ends[PASSED]} "
                    f"| {worst} |")
    bad, good = ([case for case in cases if (case.kind == "good") == one] for one in (False, True))
    newline, ends = "\n", Counter(case.end for case in good)
    first = "" if min(len(bad), len(good)) >= 200 else \
        "These are the first cases of 200 bad and 200 good ones. "
    return f"""# Bad references: refused or remarked on

`termsel auto-georeference` on {len(bad)} rendered places with a fault, and {len(good)} without.
Images have {size} x {size} px; the vendor's RPC is 30 px off, in good cases 5 to 40 px. A bad case
must be refused, or the report must have a remark. "True" is the largest RMSE in px at 200 exact
places, of the cases that are not refused.

| fault | cases | refused | remark | neither | true |
|---|---|---|---|---|---|
{newline.join(rows)}

Seams move 35 to 60 % of the reference by 2 to 12 px. Replaced parts and clouds are as large.
Heights are 300 m too high, zero or upside down. Repeated ground is one tile of 30 to 80 m. Of the
bad cases, {sum(case.end == PASSED for case in bad)} pass without a remark. Of the good ones,
{ends[REFUSED]} are refused, and {ends[REMARKED]} have a remark.

{first}To repeat, in parts until all are done:
`python -m benchmarks.verdicts --size {size} --kept FILE --seconds 480 --write`.
"""


def one(kind: str, seed: int, size: int, until: float) -> Verdict | None:
    """Return the verdict on a case, in a folder of its own; None after the time."""
    if monotonic() > until:
        return None
    with tempfile.TemporaryDirectory() as folder:
        return verdict(kind, seed, size, Path(folder))


def main() -> None:
    """Print each case and the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bad", type=int, default=200)
    parser.add_argument("--good", type=int, default=200)
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    kept = asked.kept.read_text().splitlines() if asked.kept and asked.kept.exists() else []
    cases = [Verdict(**json.loads(line)) for line in kept]
    done = {case.seed for case in cases}
    # Bad cases have the seeds 1 to --bad, and good ones those after them.
    todo = [(seed, BAD[(seed - 1) % len(BAD)] if seed <= asked.bad else "good")
            for seed in range(1, asked.bad + asked.good + 1)]
    # One part has some of all kinds.
    todo.sort(key=lambda case: (case[0] - asked.bad * (case[1] == "good"), case[0]))
    until = monotonic() + asked.seconds
    with ProcessPoolExecutor(asked.jobs) as pool:
        for future in as_completed([pool.submit(one, kind, seed, asked.size, until)
                                    for seed, kind in todo if seed not in done]):
            case = future.result()
            if case is None:
                continue
            cases.append(case)
            print(case, flush=True)
            if asked.kept:
                with asked.kept.open("a") as file:
                    file.write(json.dumps(asdict(case)) + "\n")
    text = page(cases, asked.size)
    if asked.write:
        PAGE.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
