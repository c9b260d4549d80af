"""Simulated features that are kept as files, with all their digits.

A scene that is computed at use differs in its last bits from one kind of processor to the next, and
so would the cells of a study, the files of ``termsel example`` and the optimum of a search. The
embedded data sets are therefore read; ``python -m benchmarks.embedded`` computes and writes them.
"""

from __future__ import annotations

from importlib.resources import files

import msgspec
import numpy as np

from termsel.data.features import FeatureSet, Lines, Points

FOLDER = "kept"
"""Folder of the files in the package that has them."""


class _Points(msgspec.Struct, frozen=True):
    ids: list[str]
    roles: list[str]
    image: list[tuple[float, float]]
    ground: list[tuple[float, float, float]]


class _Lines(msgspec.Struct, frozen=True):
    ids: list[str]
    image: list[tuple[tuple[float, float], tuple[float, float]]]
    ground: list[tuple[tuple[float, float, float], tuple[float, float, float]]]


class _Features(msgspec.Struct, frozen=True):
    crs: str
    image_size: tuple[int, int]
    noise: float
    points: _Points
    lines: _Lines


def kept_features(package: str, name: str) -> FeatureSet:
    """Return the features that a package keeps by a name.

    Parameters
    ----------
    package : str
        An importable package; its folder `kept` holds the file.
    name : str
        The file's name without `.json`.

    Returns
    -------
    FeatureSet
        As they were kept, with their CRS and the size of the image.

    Examples
    --------
    >>> from termsel.simulate import kept_features
    >>> len(kept_features("termsel.simulate", "spot-isfahan").points)
    35
    """
    content = (files(package) / FOLDER / f"{name}.json").read_bytes()
    stored = msgspec.json.decode(content, type=_Features)
    points = stored.points
    lines = stored.lines
    return FeatureSet(
        Points(tuple(points.ids), np.array(points.image).reshape(-1, 2),
               np.array(points.ground).reshape(-1, 3), None, tuple(points.roles)),
        Lines(tuple(lines.ids), np.array(lines.image).reshape(-1, 2, 2),
              np.array(lines.ground).reshape(-1, 2, 3)),
        stored.crs, stored.image_size, stored.noise)


def kept_text(name: str) -> str:
    """Return a text that this package keeps, such as an RPC."""
    return (files("termsel.simulate") / FOLDER / name).read_text("utf-8")


def bytes_to_keep(features: FeatureSet) -> bytes:
    """Return features as bytes that `kept_features` reads, every number with all its digits.

    Heights that are not known become 0, as JSON has no NaN. Features must have an image size and a
    noise, and neither an RPC nor standard deviations: the file has no place for these.
    """
    points = features.points
    lines = features.lines
    assert features.image_size is not None
    assert features.noise is not None
    assert features.rpc is None
    assert points.sigma is None
    ground = np.where(np.isnan(points.ground), 0.0, points.ground)
    stored = _Features(
        features.crs, features.image_size, features.noise,
        _Points(list(points.ids), list(points.roles), points.image.tolist(), ground.tolist()),
        _Lines(list(lines.ids), lines.image.tolist(), lines.ground.tolist()))
    return msgspec.json.encode(stored) + b"\n"
