"""The automatic choice among its candidates, next to one among ridge polynomials by scikit-learn.

Both judge every candidate by leave-one-out and repeat the whole choice in 10 folds. Those of
scikit-learn are polynomials of the degrees 1 to 3, each with the best of 13 penalties by `RidgeCV`,
which has leave-one-out in closed form. It looks for no blunders, tests no denominators and has no
random field, so that it does less. Times are the least processor seconds of three runs. Each is of
a scene of its own, as termsel remembers what it found of the last one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures

import termsel
from benchmarks.bench_kernels import Row, best_of
from termsel.data.features import FloatArray

FOLDS = 10
POINTS = (50, 200, 1000)


def ridge(degree: int) -> Pipeline:
    """Return a ridge polynomial of which RidgeCV chooses the penalty of each axis."""
    return make_pipeline(MinMaxScaler((-1, 1)), PolynomialFeatures(degree),
                         RidgeCV(np.logspace(-9, 3, 13), alpha_per_target=True))


def chosen(ground: FloatArray, image: FloatArray) -> Pipeline:
    """Return the polynomial with the best leave-one-out score."""
    fitted = [ridge(degree).fit(ground, image) for degree in (1, 2, 3)]
    return max(fitted, key=lambda one: float(np.mean(one[-1].best_score_)))


def nested(ground: FloatArray, image: FloatArray) -> float:
    """Return the RMSE of the choice in folds that it did not see, and make it for all."""
    squares = 0.0
    for rest, out in KFold(FOLDS, shuffle=True, random_state=0).split(ground):
        squares += float(((image[out] - chosen(ground[rest], image[rest]).predict(ground[out]))
                          ** 2).sum())
    chosen(ground, image)
    return float(np.sqrt(squares / len(ground)))


def rows() -> Iterator[Row]:
    """Yield the choice for some numbers of points."""
    for n in POINTS:
        scenes = [termsel.simulate_scene("ikonos-hamedan", seed=seed, roles=(n, 0, 0), n_lines=0)
                  for seed in (1, 2, 3)]
        ours, theirs = best_of([
            partial(next, (termsel.run(features=one) for one in scenes)),
            partial(next, (nested(one.points.ground, one.points.image) for one in scenes))],
            seconds=0.0)
        yield (f"{n} points", ours, "scikit-learn, RidgeCV of degrees 1 to 3", theirs,
               theirs / ours, None)
