"""The plain way to an image without control: ties intersected from two images, then auto on them.

Both controlled images of a triplet are fitted by auto to six points of their own, 34 ties are
intersected by these fits, and auto fits the third image to their places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.block_kinds import OWN, Kind, drawn
from termsel import FeatureSet, Fit, Points
from termsel.data.fit_data import FitData
from termsel.runs.request import auto_of_all
from termsel_block.accuracy import independent_points, rms_length
from termsel_block.block import Block
from termsel_block.geometry.frame import FloatArray, Frame
from termsel_block.joint import adjust

NAMES = ("triplet", "triplet, third between", "triplet without RPCs")
_TIES = 34
_STEP = 5.0  # m
_ROUNDS = 12


def fitted(block: Block, i: int, points: Points) -> Fit:
    """Return the fit of an image to points alone, by auto."""
    points = replace(points, roles=())
    found = auto_of_all().choose(FitData.of(FeatureSet(
        points, crs=block.crs, rpc=block.images[i].rpc)), with_contained=False)
    assert found is not None
    return found.chosen


def compared(kind: Kind, seed: int) -> tuple[float, float, float]:
    """Return the RMSE [px] of the third image by the block, the plain way, and six points."""
    with drawn(kind, seed) as (_, block, _, _):
        result, ties = adjust(block), block.ties
        fits = []
        for i in range(2):
            features = block.images[i].features
            assert features is not None
            fits.append(fitted(block, i, features.points.take(
                [role == "control" for role in features.points.roles])))
        seen = [dict(zip(ties.tie[ties.image == i].tolist(), ties.position[ties.image == i],
                         strict=True)) for i in range(3)]
        rng = np.random.default_rng([seed, 5])
        common = rng.permutation(sorted(set(seen[0]) & set(seen[1]) & set(seen[2])))[:_TIES]
        places = [np.array([image[tie] for tie in common.tolist()]) for image in seen]
        start = np.tile(result.adjusted.state.ties.mean(axis=0), (len(common), 1))
        ground = result.frame.ground(intersected(fits, places[:2], start, result.frame))
        points = independent_points(result, 2)
        assert points is not None
        by_ties = fitted(block, 2, Points(tuple(map(str, common)), places[2], ground))
        own, judging = np.split(rng.permutation(len(points)), [OWN])
        few, judge = fitted(block, 2, points.take(own)), points.take(judging)
        return (rms_length(judge.image - result.project(2, judge.ground)),
                rms_length(judge.image - by_ties.project(judge.ground)),
                rms_length(judge.image - few.project(judge.ground)))


def intersected(fits: list[Fit], places: list[FloatArray], start: FloatArray, frame: Frame,
                ) -> FloatArray:
    """Return where the rays of two fits meet, by least squares [m]."""
    ties = start.copy()
    for _ in range(_ROUNDS):
        normal, right = np.zeros((len(ties), 3, 3)), np.zeros((len(ties), 3))
        for fit, place in zip(fits, places, strict=True):
            at = fit.project(frame.ground(ties))
            slopes = np.stack([(fit.project(frame.ground(ties + _STEP * axis)) - at) / _STEP
                               for axis in np.eye(3)], axis=2)
            normal += np.einsum("nai,naj->nij", slopes, slopes)
            right += np.einsum("nai,na->ni", slopes, place - at)
        # A fit of few points may have no term of height.
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        ties = ties + np.linalg.solve(normal, right[..., None])[..., 0]
    return ties


def row(kind: Kind, seeds: list[int]) -> str:
    """Return a row of the table of the plain way."""
    block, plain, six = np.array([compared(kind, seed) for seed in seeds]).T
    return (f"| {kind.name} | {len(seeds)} | {np.median(plain / six):.2f} "
            f"| {np.median(block / six):.2f} | {np.median(block / plain):.2f} "
            f"| {int((block < plain).sum())} |")


HEAD = ("| block | blocks | ties by hand over six own | block over six own "
        "| block over ties by hand | block is better |\n|---|---:|---:|---:|---:|---:|")
