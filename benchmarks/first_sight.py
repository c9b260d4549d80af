"""Processor time of auto at its first sight of points, by that of numpy's svd in the same run.

    python -m benchmarks.first_sight [8 12 ...] [--script] [--batch N]

The yardstick is one ``numpy.linalg.svd`` of 4,000 matrices of 24 by 20, before each case. A case is
a number of points of a simulated satellite image, with heights and without; the figure is the
median of some scenes, as termsel remembers what it found of the last one. ``--script`` times what
a user could write instead: polynomials of three degrees with five ridges by scikit-learn, chosen in
ten folds, and the choice repeated in ten folds. ``--batch N`` times an image of
``termsel compare --points`` of N files, more than two, with two workers, pages included.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

import termsel
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet

COUNTS = (8, 12, 24, 40, 80)
SCENES = 5
MATRICES = (4000, 24, 20)

PR_SET_CHILD_SUBREAPER = 36
"""Of prctl: orphans among the descendants become children of this process."""


def satellite(count: int, seed: int, *, heights: bool) -> FeatureSet:
    """Return points of a simulated satellite image."""
    features = termsel.simulate_scene("ikonos-hamedan", seed=seed, roles=(count, 0, 0), n_lines=0)
    if heights:
        return features
    ground = features.points.ground.copy()
    ground[:, 2] = np.nan
    return features.with_(points=replace(features.points, ground=ground))


def processor_seconds(call: Callable[[], object]) -> float:
    """Return the processor time of a call."""
    start = time.process_time()
    call()
    return time.process_time() - start


@one_blas_thread
def yardstick() -> float:
    """Return the processor time of numpy's svd of many small matrices."""
    matrices = np.random.default_rng(0).normal(size=MATRICES)
    return processor_seconds(lambda: np.linalg.svd(matrices))


def by_script(features: FeatureSet) -> None:
    """Choose a ridge polynomial as a user of scikit-learn does, and hold out the whole choice."""
    from sklearn.linear_model import Ridge
    from sklearn.model_selection import GridSearchCV, KFold, cross_val_predict
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures

    points = features.points
    columns = np.isfinite(points.ground).all(axis=0)
    folds = KFold(min(10, len(points)), shuffle=True, random_state=0)
    choice = GridSearchCV(
        make_pipeline(MinMaxScaler((-1, 1)), PolynomialFeatures(), Ridge()),
        {"polynomialfeatures__degree": (1, 2, 3), "ridge__alpha": np.logspace(-6, 2, 5)},
        scoring="neg_mean_squared_error", cv=min(10, len(points) - 1))
    cross_val_predict(choice, points.ground[:, columns], points.image, cv=folds)
    choice.fit(points.ground[:, columns], points.image)


def first_sights(counts: list[int], *, script: bool) -> None:
    """Print the time of each number of points, with heights and without."""
    for heights in (True, False):  # imports, and reads the compiled kernels
        termsel.run(features=satellite(12, 99, heights=heights))
        termsel.run(features=satellite(24, 99, heights=heights))
    sys.stdout.write("points  heights   auto [s]  by the svd" + "  script [s]" * script + "\n")
    for heights in (True, False):
        for count in counts:
            seconds = []
            yardsticks = []
            for seed in range(1, SCENES + 1):
                features = satellite(count, seed, heights=heights)
                yardsticks.append(yardstick())
                seconds.append(processor_seconds(partial(termsel.run, features=features)))
            ratio = median(seconds) / median(yardsticks)
            rival = f"{processor_seconds(partial(by_script, features)):12.2f}" if script else ""
            sys.stdout.write(f"{count:6}  {'yes' if heights else 'no':>7}  {median(seconds):9.3f}"
                             f"  {ratio:10.2f}{rival}\n")


def batch(images: int) -> None:
    """Print the processor time of an image of a batch, files and pages included."""
    batch_seconds(2)  # compiles kernels and modules of Python
    of_two = batch_seconds(2)
    of_all = batch_seconds(images)
    unit = yardstick()
    for what, seconds in ((f"an image of a batch of {images}", of_all / images),
                          ("a further image", (of_all - of_two) / (images - 2))):
        sys.stdout.write(f"{what}: {seconds:.3f} s, {seconds / unit:.2f} of the svd\n")


def batch_seconds(images: int) -> float:
    """Return the processor time of a batch of images, of all its processes."""
    # As an installed termsel: modules are compiled once, not in each process.
    environment = {name: value for name, value in os.environ.items()
                   if name != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(images):
            points = satellite(24, seed, heights=True).points
            file = Path(folder) / f"{seed}.csv"
            rows = [f"{name},{line},{sample},{x},{y},{z}" for name, (line, sample), (x, y, z) in
                    zip(points.ids, points.image.tolist(), points.ground.tolist(), strict=True)]
            file.write_text("\n".join(["id,line,sample,x,y,z", *rows]) + "\n", encoding="utf-8")
        before = os.times()
        subprocess.run([sys.executable, "-m", "termsel", "compare", "--points", f"{folder}/*.csv",
                        "--crs", "EPSG:4979", "--workers", "2", "--out", f"{folder}/out"],
                       check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                       env=environment)
        _wait_for_descendants()
        after = os.times()
    return (after.children_user + after.children_system
            - before.children_user - before.children_system)


def _adopt_descendants() -> None:
    """Let this process wait for what its commands leave, as the process that forks workers."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _wait_for_descendants() -> None:
    """Wait for all processes that were adopted, so that their time counts."""
    with suppress(ChildProcessError):
        while True:
            os.wait()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("counts", type=int, nargs="*", default=list(COUNTS))
    parser.add_argument("--script", action="store_true")
    parser.add_argument("--batch", type=int)
    asked = parser.parse_args()
    if asked.batch:
        _adopt_descendants()
        batch(asked.batch)
    else:
        first_sights(asked.counts, script=asked.script)


if __name__ == "__main__":
    main()
