"""Sets of points that the pages in docs/evidence are about, and their splits.

The sets are the embedded scenes, each split with new points and noise, and those of the folder
named by the environment variable TERMSEL_DATA, or ../shared/data, where it is there: sets derived
from a sensor model get Gaussian noise of 0.5 px on line and sample. A split draws so many
points at random as control and check together, and up to 300 of the others as independent.
"""

from __future__ import annotations

import json
import os
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np

from termsel.data.features import FloatArray, Points
from termsel.io.read import read
from termsel.simulate import simulate_scene
from termsel.simulate.catalogue import SCENES
from termsel_cameras import simulate_map
from termsel_cameras.maps import MAP_NAME as OLD_MAP

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("TERMSEL_DATA", ROOT.parent / "shared" / "data"))
NOISE = 0.5
DERIVED = ("phr_grid_nice_a", "rpcfit_s1_test", "rpcfit_s1_train", "s1_grd_iw")
"""Sets without noise of their own."""
MEASURED = ("ikonos_lines", "ventoux_lines", "kastoria_1925", "maplat_fushimijo")
PLAIN = ("affine", "dlt", "projective", "quadratic", "cubic")


def put(page: str, text: str, *, write: bool) -> None:
    """Print a page of docs/evidence, and renew it if asked to."""
    sys.stdout.write(text)
    if write:
        (ROOT / "docs" / "evidence" / f"{page}.md").write_text(text.rstrip() + "\n",
                                                               encoding="utf-8")


def names() -> list[str]:
    """Return the available sets."""
    return [*SCENES, OLD_MAP, *(name for name in (*DERIVED, *MEASURED) if (DATA / name).is_dir())]


@lru_cache(maxsize=4)
def _read(name: str) -> Points:
    return read(DATA / name / "points.csv", crs="local").points


def crs_of(name: str) -> str:
    """Return the CRS of a set, as its data state it: local for simulated maps."""
    if name in SCENES:
        return "EPSG:4979"
    meta = DATA / name / "meta.json"
    if not meta.is_file():
        return "local"
    return str(json.loads(meta.read_text(encoding="utf-8"))["crs"]).split()[0]


def split(name: str, count: int, seed: int) -> tuple[Points, Points]:
    """Return control and selection points together, and independent check points."""
    rng = np.random.default_rng([count, seed])
    if name in SCENES:
        points = simulate_scene(name, seed=seed, n_points=count + 150).points
    elif name == OLD_MAP:
        points = simulate_map(seed=seed, n_points=count + 150).points
    else:
        points = _read(name)
    image = points.image + (NOISE * rng.standard_normal(points.image.shape)
                            if name in DERIVED else 0.0)
    points = Points(points.ids, image, points.ground)
    order = rng.permutation(len(points))
    return points.take(order[:count]), points.take(order[count:count + 300])


def heights_of(points: Points) -> bool:
    """Return whether points have heights that differ."""
    z = points.ground[:, 2]
    return not np.isnan(z).any() and bool(np.ptp(z) > 0)


def rmse_of(errors: FloatArray) -> float:
    """Return the RMSE of errors, shape (n, 2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))
