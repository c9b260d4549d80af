"""What every data set must do."""

from __future__ import annotations

from termsel.data.coordinates.crs import normalise
from termsel.data.coordinates.plausible import check_ground
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.results.result import checksum_of_features
from termsel.testing.cases import Case, Suite, declaration_check, require, through_pickle


def loads_features(spec: DatasetSpec) -> None:
    """It loads a FeatureSet with points or lines."""
    features = _load_alike(spec)
    require(len(features), "load() returns no points and no lines")


def ground_in_crs(spec: DatasetSpec) -> None:
    """It states the CRS of its ground coordinates, which can be in it."""
    features = _load_alike(spec)
    require(features.crs, "load() states no crs; give EPSG:n, WKT or local")
    normalise(features.crs)
    check_ground(features)


def alike_each_time(spec: DatasetSpec) -> None:
    """It loads the same features each time, and they survive pickle, as between processes."""
    first = _load_alike(spec)
    for second in (_load_alike(spec), through_pickle(first)):
        # Compared by checksums, as arrays may hold NaN.
        require(checksum_of_features(first) == checksum_of_features(second),
                "two calls of load() differ; draw random numbers from a generator with a seed")


def enough_of_them(spec: DatasetSpec) -> None:
    """It has at least 5 features, the fewest of any run: 3 of control and 2 that check."""
    count = len(_load_alike(spec))
    require(count >= 5, f"it has {count} features; no problem can be run on fewer than 5")


def cases(spec: DatasetSpec) -> list[Case]:
    """Return a data set."""
    return [Case(spec.name, lambda: spec)]


SUITE = Suite((declaration_check("datasets"), loads_features, ground_in_crs, alike_each_time,
               enough_of_them), cases)


def _load_alike(spec: DatasetSpec) -> FeatureSet:
    """Return the features of a data set; raises AssertionError if it loads others than these."""
    features = spec.load()
    # `through_pickle` takes the features there and back, as on their way to another process.
    require(isinstance(features, FeatureSet),
            f"load() must return a FeatureSet, not {type(features).__name__}")
    return features
