"""The forty simulated sets: kinds, numbers of points, and seeds, all of them frozen."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.random import Generator

import termsel
from termsel import FeatureSet, Points, TermselError, rpc_of, simulate_scene
from termsel.toolkit import require_import, unknown_name_error
from termsel_bench.scenes.base import INDEPENDENT, BenchSet, means_of, round_to_files
from termsel_bench.scenes.cameras import FRESH, image_of

METADATA, MEANS = "croissant.json", "means.json"
"""Files of the package with the description of all sets and their checksums, and with means."""

# Seed of the first set of each kind; no constant of termsel was chosen on these seeds.
_FIRST_SEED = 7000
# Points to which the vendor's RPC is fitted.
_N_VENDOR_POINTS = 400
# Least and largest error of a vendor's RPC [px].
_BIAS = (2.0, 60.0)
# Displacement of blunders [px].
_NEAREST, _FARTHEST = 5.0, 60.0


@dataclass(frozen=True)
class SetSettings:
    """Settings of a simulated set: number of control and selection points, and what else."""

    name: str
    kind: str
    seed: int
    count: int
    settings: Mapping[str, Any]


def _sets_of(kind: str, counts: tuple[int, ...],
             **settings: tuple[Any, ...]) -> tuple[SetSettings,
                                                   ...]:
    """Return the settings of the sets of a kind, one for each count of points.

    The i-th set has the i-th value of each of the `settings`.
    """
    sets = []
    for i, count in enumerate(counts):
        set_values = {name: values[i] for name, values in settings.items()}
        sets.append(SetSettings(f"{kind}-{i + 1}", kind, _FIRST_SEED + i, count, set_values))
    return tuple(sets)


_ALL_SETS = (
    *_sets_of("steady", (10, 14, 20, 30, 44, 64)),
    *_sets_of("agile", (12, 18, 26, 40, 60)),
    *_sets_of("frame", (10, 16, 28, 50)),
    *_sets_of("panoramic", (14, 22, 36, 60)),
    *_sets_of("radar", (10, 18, 32, 56)),
    *_sets_of(
        "old-map",
        (16, 24, 40, 60, 90),
        local=(5.0, 0.0, 15.0, 5.0, 0.0),
        joints=(6.0, 10.0, 0.0, 6.0, 0.0),
        sheets=((2, 2), (2, 3), (1, 1), (2, 2), (1, 1)),
    ),
    *_sets_of("vendor-rpc", (2, 4, 8, 16), error=("shift", "drift", "affine", "shift")),
    *_sets_of("matches", (40, 60, 80, 100), wrong=(0.1, 0.2, 0.3, 0.4)),
    *_sets_of(
        "lines",
        (6, 6, 8, 8),
        scene=("ikonos-hamedan", "geoeye-tehran", "spot-isfahan", "cartosat-hyderabad"),
        n_lines=(24, 40, 60, 100),
        wrong_lines=(0, 3, 0, 10),
    ),
)
SETS: Mapping[str, SetSettings] = {bench_set.name: bench_set for bench_set in _ALL_SETS}
"""Settings of all sets by name."""

QUICK = ("steady-3", "agile-2", "frame-2", "panoramic-2", "radar-2", "old-map-2", "vendor-rpc-3",
         "matches-1", "lines-1")
"""One set of each kind."""


def set_names(pattern: str = "") -> list[str]:
    """Return names of sets that contain a text, all without one.

    Raises
    ------
    TermselError
        If there is none.
    """
    names = [name for name in SETS if pattern in name]
    if not names:
        raise unknown_name_error("set", pattern, set(SETS))
    return names


@lru_cache(maxsize=2)  # each method of a benchmark asks for the same set
def simulated_set(name: str) -> BenchSet:
    """Return a set, simulated here and checked against its checksums.

    Raises
    ------
    TermselError
        For an unknown name; if the set is not the frozen one.
    """
    if name not in SETS:
        raise unknown_name_error("set", name, set(SETS))
    bench_set = simulate_set(name)
    frozen = frozen_checksums()
    for file, checksum in bench_set.checksums().items():
        if frozen.get(file) != checksum and not _differs_by_rounding(bench_set, file):
            raise TermselError(
                f"the set {name}, simulated here, is not the frozen one: {file} "
                "differs", hint="Figures of other sets cannot be compared. Install the version of "
                                "termsel that this termsel-bench was published with.")
    return bench_set


_MEANS_SHARE = 0.1
"""Share of the unit of the last decimal by which means may differ.

Sines and inverses of other processors end in another bit, so that of some thousand numbers a few,
which lie where rounding changes, have another last decimal. Other noise changes means by more.
"""


def _differs_by_rounding(bench_set: BenchSet, file: str) -> bool:
    """Return whether the means of a file's columns are those of the frozen one but for rounding."""
    frozen = json.loads(files("termsel_bench").joinpath(MEANS).read_text("utf-8"))
    means, units = means_of(bench_set.files()[file])
    return len(frozen.get(file, ())) == len(means) and bool(np.all(
        np.abs(np.subtract(means, frozen[file])) <= _MEANS_SHARE * np.array(units)))


def frozen_checksums() -> dict[str, str]:
    """Return the frozen SHA-256 of each file by its name."""
    described = json.loads(files("termsel_bench").joinpath(METADATA).read_text("utf-8"))
    return {file["name"]: file["sha256"] for file in described["distribution"]}


def simulate_set(name: str) -> BenchSet:
    """Return the set of a name in `SETS` as this machine simulates it.

    Its files may differ from the frozen ones; `frozen_checksums` shows whether they do.
    """
    return simulate_from(SETS[name])


def simulate_from(settings: SetSettings) -> BenchSet:
    """Return the set of some settings, as those of a frozen set with another seed."""
    features, independent = _MAKERS.get(settings.kind, _simulate_camera)(settings)
    # Control and selection points alternate, so that both are all over the image.
    roles = tuple("control" if i % 2 == 0 else "check" for i in range(len(features.points)))
    points = replace(features.points, roles=roles,
                     ids=tuple(f"P{i + 1}" for i in range(len(roles))))
    independent = replace(independent, roles=("independent",) * len(independent),
                          ids=tuple(f"I{i + 1}" for i in range(len(independent))))
    # Methods are not told how exact the measurements are.
    return round_to_files(BenchSet(settings.name, settings.kind,
                                   replace(features, points=points, noise=None),
                                   independent))


def _split(scene: FeatureSet, count: int) -> tuple[FeatureSet, Points]:
    """Return a scene with its first `count` points, and the `INDEPENDENT` points after them."""
    order = np.arange(len(scene.points))
    return (scene.with_(points=scene.points.take(order < count)),
            scene.points.take((order >= count) & (order < count + INDEPENDENT)))


def _simulate_camera(settings: SetSettings) -> tuple[FeatureSet, Points]:
    """Return control of a simulated camera, and independent points."""
    return _split(image_of(settings.kind, settings.seed, FRESH, settings.count + INDEPENDENT,
                           settings.count),
                  settings.count)


def _simulate_old_map(settings: SetSettings) -> tuple[FeatureSet, Points]:
    """Return the control of a simulated old map, with noise, and independent points without.

    Raises TermselError without termsel-cameras.
    """
    with require_import("sets of old maps require", "termsel_cameras", "./plugins/termsel-cameras"):
        from termsel_cameras import simulate_map

    arguments = {"seed": settings.seed, "n_points": settings.count + INDEPENDENT,
                 **settings.settings}
    # Points are spread out in the order in which they are drawn, so that control is drawn from all.
    order = np.random.default_rng(settings.seed).permutation(settings.count + INDEPENDENT)
    # The same map is simulated with noise for control, and without it for independent points.
    measured = simulate_map(**arguments)
    exact = simulate_map(**arguments, noise=0.0)
    return (measured.with_(points=measured.points.take(order[:settings.count])),
            exact.points.take(order[settings.count:]))


def _simulate_lines(settings: SetSettings) -> tuple[FeatureSet, Points]:
    """Return a scene with control lines, and independent points."""
    arguments = {"seed": settings.seed, "roles": (settings.count, 0, INDEPENDENT),
                 **{name: value for name, value in settings.settings.items() if name != "scene"}}
    measured = simulate_scene(settings.settings["scene"], **arguments)
    exact = simulate_scene(settings.settings["scene"], **arguments, noise=0.0)
    control = np.array(measured.points.roles) == "control"
    return (measured.with_(points=measured.points.take(control)), exact.points.take(~control))


def _simulate_matches(settings: SetSettings) -> tuple[FeatureSet, Points]:
    """Return points of which a share is mismatched, by 5 to 60 px, and independent points.

    The share is the setting `wrong` of the set; independent points have no mismatches.
    """
    scene = image_of("steady", settings.seed + 100, FRESH, settings.count + INDEPENDENT,
                     settings.count)
    features, independent = _split(scene, settings.count)
    # A generator of its own, so that the scene is the same for any share.
    rng = np.random.default_rng([settings.seed, 1])
    n_blunders = round(settings.settings["wrong"] * settings.count)
    blunders = rng.permutation(settings.count)[:n_blunders]
    image = features.points.image.copy()
    image[blunders] += _random_directions(
        rng, n_blunders) * rng.uniform(_NEAREST, _FARTHEST, (n_blunders, 1))
    return features.with_(points=replace(features.points, image=image)), independent


def _simulate_vendor_rpc(settings: SetSettings) -> tuple[FeatureSet, Points]:
    """Return control of an image with the RPC of a vendor, and independent points.

    The RPC has errors of 2 to 60 px: a shift, a drift along the lines or an affine change.
    """
    count = settings.count
    n_points = count + INDEPENDENT + _N_VENDOR_POINTS
    scene = image_of("steady", settings.seed + 200, FRESH, n_points, count)
    features, independent = _split(scene, count)
    assert scene.image_size is not None
    rng = np.random.default_rng([settings.seed, 2])
    vendor = scene.points.take(np.arange(len(scene.points)) >= count + INDEPENDENT)
    # The size of the vendor's error, log-uniform.
    size = float(np.exp(rng.uniform(*np.log(_BIAS))))
    from_middle = vendor.image / (np.array(scene.image_size) / 2) - 1
    # A shift, of which half is replaced by a drift or an affine change about the middle.
    bias = np.tile(_random_directions(rng, 1), (_N_VENDOR_POINTS, 1))
    if settings.settings["error"] == "drift":
        bias = bias / 2 + from_middle[:, :1] * _random_directions(rng, 1) / 2
    elif settings.settings["error"] == "affine":
        bias = (bias + from_middle @ rng.normal(0.0, 1.0, (2, 2))) / 2
    biased = Points(vendor.ids, vendor.image + size * bias, vendor.ground)
    rpc = rpc_of(termsel.fit(FeatureSet(biased, crs=scene.crs), "poly3d", degree=3)).rpc
    return replace(features, rpc=rpc.as_delivered()), independent


def _random_directions(
        rng: Generator, count: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return random directions of length 1, shape (count, 2)."""
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([np.sin(angle), np.cos(angle)])


_MAKERS: Mapping[str, Callable[[SetSettings], tuple[FeatureSet, Points]]] = {
    "old-map": _simulate_old_map, "vendor-rpc": _simulate_vendor_rpc, "matches": _simulate_matches,
    "lines": _simulate_lines}
