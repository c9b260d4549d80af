"""The embedded data set: control candidates of mixed quality, and a vendor's geometry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from termsel import FeatureSet, simulate_scene
from termsel.simulate import Angle, Pushbroom, scene_truth

DATASET_NAME = "hamedan-candidates"
SCENE = "ikonos-hamedan"
MATCHES = "cartosat-matches"
NOMINAL = {DATASET_NAME: SCENE, MATCHES: "cartosat-hyderabad"}
"""Data sets with a vendor's geometry, and the scenes they are of."""

RPC_FILE = Path(__file__).with_name("hamedan_vendor.RPB")
"""RPC that replaces `nominal_sensor`, as vendors do (`make_vendor_rpc.py`)."""

ROLL, PITCH, YAW, ROLL_DRIFT = 9.0, -6.0, 0.4, 1.5
"""Errors of the nominal attitude, as movement in the image [px]: everywhere by roll and pitch,
of the ends of the array by yaw, at the end of the scene by the drift of roll."""

_POINTS, _SEED = 240, 0
_INEXACT, _WRONG = 0.25, 0.15
_GOOD_NOISE, _INEXACT_NOISE = 0.5, 2.0
_NEAREST, _FARTHEST = 5.0, 40.0


def nominal_sensor(data_set: str = DATASET_NAME) -> Pushbroom:
    """Return the scanner of a data set in `NOMINAL` as its vendor knows it.

    Its attitude has the errors `ROLL`, `PITCH`, `YAW` and `ROLL_DRIFT`, and no jitter.
    """
    true = scene_truth(NOMINAL[data_set]).sensor
    # Time from the middle of the scene to its end [s].
    end = true.centre[0] * true.line_period
    roll = -ROLL * true.ifov, -ROLL_DRIFT * true.ifov / end
    return replace(true, roll=_with_drift(true.roll, roll),
                   pitch=_with_drift(true.pitch, (-PITCH * true.ifov,)),
                   yaw=_with_drift(true.yaw, (-YAW / true.centre[1],)))


def _with_drift(angle: Angle, by: tuple[float, ...]) -> Angle:
    """Return an angle without jitter, with `by` added to the first coefficients of its drift.

    The drift is a polynomial of time [s] in radians.
    """
    drift = np.array(angle.drift)
    drift[:len(by)] += by
    return Angle(tuple(drift.tolist()))


def simulate_candidates() -> FeatureSet:
    """Return points like those of image matching: most good, some inexact, some blunders.

    80 control, 80 check and 80 independent points of the simulated scene "ikonos-hamedan". Of
    control and check points 60 % are measured to 0.5 px in line and in sample, 25 % to 2
    px, and 15 % are mismatched: 5 to 40 px from their true positions. Independent points are
    all good.

    Returns
    -------
    FeatureSet
        WGS84 longitude, latitude [deg], ellipsoidal height [m].

    Examples
    --------
    >>> from termsel_rpc import simulate_candidates
    >>> len(simulate_candidates().points)
    240
    """
    scene = simulate_scene(SCENE, n_points=_POINTS, n_lines=0, noise=0.0)
    return _simulate_measured_scene(scene, candidate_quality(), np.random.default_rng(_SEED))


def simulate_matches(wrong: float = 0.3, seed: int = 0) -> FeatureSet:
    """Return points as image matching finds them in a Cartosat-1 scene, some of them wrong.

    They are 100 control and 100 independent points of the simulated scene "cartosat-hyderabad".
    Some control points are mismatched, by 5 to 40 px; the others are measured to 0.5 px, and so are
    the independent ones.

    Parameters
    ----------
    wrong : float
        Share of the control points that are mismatched, 0 to 1.
    seed : int
        Seed of the scene and of the mismatches.

    Returns
    -------
    FeatureSet
        WGS84 longitude, latitude [deg], ellipsoidal height [m].

    Examples
    --------
    >>> from termsel_rpc import simulate_matches
    >>> len(simulate_matches(wrong=0.5).points)
    200
    """
    scene = simulate_scene(NOMINAL[MATCHES], seed=seed, noise=0.0)
    control = np.flatnonzero(np.array(scene.points.roles) == "control")
    rng = np.random.default_rng([seed, 2])
    kind = np.full(len(scene.points), "good", dtype="<U7")
    # Independent points stay good, so that they judge a selection.
    kind[rng.permutation(control)[:round(wrong * len(control))]] = "wrong"
    return _simulate_measured_scene(scene, kind, rng)


def _simulate_measured_scene(scene: FeatureSet, kind: np.ndarray[tuple[int], np.dtype[np.str_]],
                             rng: np.random.Generator) -> FeatureSet:
    """Return a scene whose points are measured with the errors that `kind` (n,) names.

    "good" and "inexact" have normal errors of 0.5 and 2 px, "wrong" a good point's error and a
    mismatch of 5 to 40 px.
    """
    points = scene.points
    n = len(points)
    # Errors are drawn for all points, so that those of one do not depend on the others' kinds.
    noise = rng.standard_normal((n, 2)) * np.where(
        kind == "inexact", _INEXACT_NOISE, _GOOD_NOISE)[:, None]
    # Mismatches lie anywhere within a ring around the true position.
    direction = rng.uniform(0, 2 * np.pi, n)
    distance = rng.uniform(_NEAREST, _FARTHEST, n)
    mismatch = np.column_stack([np.sin(direction), np.cos(direction)]) * distance[:, None]
    image = points.image + noise + np.where(kind == "wrong", 1.0, 0.0)[:, None] * mismatch
    return replace(scene, points=replace(points, image=image), noise=_GOOD_NOISE)


def candidate_quality() -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """Return how well each point of `simulate_candidates` is measured, (n,).

    It is "good", "inexact" or "wrong"; all independent points are good.
    """
    scene = simulate_scene(SCENE, n_points=_POINTS, n_lines=0, noise=0.0)
    kind = np.full(_POINTS, "good", dtype="<U7")
    rng = np.random.default_rng([_SEED, 1])
    for role in ("control", "check"):
        # The same shares among control and among check points.
        order = rng.permutation(np.flatnonzero(np.array(scene.points.roles) == role))
        inexact, wrong = (round(share * len(order)) for share in (_INEXACT, _WRONG))
        kind[order[:inexact]] = "inexact"
        kind[order[inexact:inexact + wrong]] = "wrong"
    return kind
