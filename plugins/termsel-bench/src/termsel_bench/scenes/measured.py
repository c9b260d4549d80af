"""The measured sets: points that people and programs measured, with frozen folds.

Each source has a folder in the package, with its files as they were published, its licence, and
`meta.json`: address, commit, checksum of each file. Every point is hidden once: a method gets the
points of the other folds, and the hidden ones judge it. Of matches, which are many, a method gets
one fold. Volunteers and matchers make blunders, so that a set is judged by the median of the
distances.

``python -m termsel_bench.scenes.measured`` draws the folds again: for maintainers.
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from io import StringIO
from typing import Any

import numpy as np

from termsel import FeatureSet, Points, TermselError
from termsel.toolkit import unknown_name_error

FOLDS = "folds.json"
"""File of the package with the fold of each point of each set."""

MEASURED = "measured-"
"""How the names of measured sets begin."""

FOCAL_COLUMN = "camera_focal"
"""Column of the points with the stated focal length [px], which termsel-cameras reads."""

_SEED = 2026


@dataclass(frozen=True)
class MeasuredSource:
    """A published collection of sets.

    Parameters
    ----------
    folder : str
        In the package.
    kind : str
        What tables call its sets, and how their names begin.
    crs : str
    folds : int
        Number of folds of each set.
    sees_one : bool
        Whether a method sees one fold and the others judge it; else one is hidden and judges.
    """

    folder: str
    kind: str
    crs: str
    folds: int
    sees_one: bool = False


SOURCES = (MeasuredSource("slv_maps", "measured-map", "EPSG:4326", 4),
           # Photos have as few as six points.
           MeasuredSource("smapshot_nadir", "measured-photo", "EPSG:4979", 3),
           # Some 87 of 694 matches.
           MeasuredSource("loftr_matches", "measured-matches", "local", 8, sees_one=True))
"""The sources; their licences allow to pass them on."""


@dataclass(frozen=True, eq=False)
class MeasuredSet:
    """A measured set.

    Parameters
    ----------
    name, kind : str
    features : FeatureSet
        All its points, without roles.
    folds : ndarray of int, shape (n,)
        In which fold each point is.
    sees_one : bool
        As for `MeasuredSource`.
    licence, source, sha256 : str
        Licence, source with its commit, and checksum of the file of its points.
    """

    name: str
    kind: str
    features: FeatureSet
    folds: np.ndarray[tuple[int], np.dtype[np.intp]]
    sees_one: bool
    licence: str
    source: str
    sha256: str

    @property
    def trials(self) -> int:
        """Number of folds, and so how often a method is fitted."""
        return int(self.folds.max()) + 1

    def trial(self, fold: int) -> tuple[FeatureSet, Points]:
        """Return the features that a method sees in a trial, and the points that are hidden.

        The fold `fold` is hidden or, with `sees_one`, the only one that is seen.
        """
        points = self.features.points
        hidden = (self.folds == fold) != self.sees_one
        return self.features.with_(points=points.take(~hidden)), points.take(hidden)


def measured_names(pattern: str = "") -> list[str]:
    """Return the names of all measured sets whose name contains a text.

    Raises
    ------
    TermselError
        If there is none.
    """
    names = [name for name in _source_and_file_by_set() if pattern in name]
    if not names:
        raise TermselError(f"there is no measured set {pattern!r}",
                           hint=f"Kinds are {', '.join(source.kind for source in SOURCES)}.")
    return names


def first_of_each_kind(names: Sequence[str]) -> list[str]:
    """Return the first set of each kind among the names of measured sets."""
    names_by_kind = [[name for name in names if name.startswith(source.kind)]
                     for source in SOURCES]
    return [kind_names[0] for kind_names in names_by_kind if kind_names]


@lru_cache(maxsize=2)  # each method of a benchmark asks for the same set
def read_measured_set(name: str) -> MeasuredSet:
    """Return a measured set.

    Raises
    ------
    TermselError
        If there is none of the name, or its file is not the published one.
    """
    if name not in _source_and_file_by_set():
        raise unknown_name_error("set", name, _source_and_file_by_set())
    source, file = _source_and_file_by_set()[name]
    meta = _read_meta(source.folder)
    content = _read_source_text(source.folder, file)
    checksum = hashlib.sha256(content.encode()).hexdigest()
    # Scores are compared with published ones, which are of the published points.
    if checksum != meta["sha256"][file]:
        raise TermselError(f"the SHA-256 of {file} is {checksum}, not that of the published file",
                           hint="Install termsel-bench again.")
    folds = np.array(json.loads(_read_source_text("", FOLDS))[name], dtype=np.intp)
    points = _parse_points(content)
    size = None
    if source.folder == "smapshot_nadir":
        photo = _photo_rows()[file.removesuffix(".csv")]
        size = (int(photo["height"]), int(photo["width"]))
        points = replace(
            points,
            attributes={FOCAL_COLUMN: np.array([photo["focal_px"]] * len(points), dtype=object)},
        )
    features = FeatureSet(points, crs=source.crs, image_size=size)
    return MeasuredSet(name, source.kind, features, folds, source.sees_one, meta["licence"],
                       f"https://{meta['source']} {meta['commit']}", checksum)


def checksums_of_measured() -> dict[str, str]:
    """Return the published SHA-256 of the points of each set."""
    return {name: _read_meta(source.folder)["sha256"][file]
            for name, (source, file) in _source_and_file_by_set().items()}


def build_published_files(names: Sequence[str]) -> dict[str, str]:
    """Return the texts of the published files of some sets, by folder/name.

    Licence and meta.json of each folder are among them, and a file with the folds of the sets.
    """
    contents: dict[str, str] = {}
    for source in SOURCES:
        source_files = [file for name, (set_source, file) in _source_and_file_by_set().items()
                        if set_source == source and name in names]
        if not source_files:
            continue
        # Photos have a table of their own, of what is known of each.
        extra = ["photos.csv"] if "photos.csv" in _read_meta(source.folder)["sha256"] else []
        for file in (*source_files, *extra, "LICENSE", "meta.json"):
            contents[f"{source.folder}/{file}"] = _read_source_text(source.folder, file)
    folds = json.loads(_read_source_text("", FOLDS))
    fold_by_set = {}
    for name in names:
        source, file = _source_and_file_by_set()[name]
        fold_by_set[name] = {"file": f"{source.folder}/{file}", "fold": folds[name]}
    contents[FOLDS] = json.dumps(fold_by_set, indent=1) + "\n"
    return contents


@lru_cache(maxsize=1)  # files of the package, which do not change
def _source_and_file_by_set() -> Mapping[str, tuple[MeasuredSource, str]]:
    """Return the source and the file of points of each set, by the name of the set."""
    by_set: dict[str, tuple[MeasuredSource, str]] = {}
    for source in SOURCES:
        # Sets are called kind-001 and so on in the order of file names; photos.csv has no points.
        point_files = sorted(
            file for file in _read_meta(source.folder)["sha256"] if file != "photos.csv")
        for number, file in enumerate(point_files, 1):
            by_set[f"{source.kind}-{number:03d}"] = (source, file)
    return by_set


@lru_cache(maxsize=8)  # files of the package, which do not change
def _read_meta(folder: str) -> dict[str, Any]:
    """Return the content of meta.json in the folder of a source."""
    content: dict[str, Any] = json.loads(_read_source_text(folder, "meta.json"))
    return content


def _read_source_text(folder: str, file: str) -> str:
    """Return the text of a file in the folder of a source, or in that of all sources if it is "".
    """
    all_sources = files("termsel_bench") / "measured"
    return ((all_sources / folder if folder else all_sources) / file).read_bytes().decode()


def _parse_points(content: str) -> Points:
    """Return the points of a published file; a file without ids has matches of two images."""
    rows = list(csv.DictReader(StringIO(content)))
    if "id" not in rows[0]:
        return _parse_matches([list(map(float, row.values())) for row in rows])
    image = np.array([[float(row["line"]), float(row["sample"])] for row in rows])
    ground = np.array([[float(row["x"]), float(row["y"]), float(row.get("z") or "nan")]
                       for row in rows])
    return Points(tuple(row["id"] for row in rows), image, ground)


def _parse_matches(rows: Sequence[Sequence[float]]) -> Points:
    """Return matches of two images as points, from rows of x and y, then sample and line.

    The first image is the ground; its rows are turned upwards, and there are no heights.
    """
    x, y, sample, line = np.array(rows).T
    return Points(tuple(f"M{i + 1:03d}" for i in range(len(rows))), np.column_stack([line, sample]),
                  np.column_stack([x, -y, np.full(len(rows), np.nan)]))


@lru_cache(maxsize=1)  # files of the package, which do not change
def _photo_rows() -> dict[str, dict[str, str]]:
    """Return the row of each photo by its name: its size and its camera."""
    rows = csv.DictReader(StringIO(_read_source_text("smapshot_nadir", "photos.csv")))
    return {row["photo"]: row for row in rows}


def draw_folds() -> dict[str, list[int]]:
    """Return a fold for each point of each set, drawn by a seed.

    Folds of a set differ in their number of points by one at most.
    """
    folds = {}
    for number, (name, (source, file)) in enumerate(_source_and_file_by_set().items()):
        n = len(_parse_points(_read_source_text(source.folder, file)))
        rng = np.random.default_rng([_SEED, number])
        folds[name] = rng.permutation(np.arange(n) % source.folds).tolist()
    return folds


if __name__ == "__main__":
    from pathlib import Path

    import termsel_bench

    target = Path(str(termsel_bench.__file__)).parent / "measured" / FOLDS
    rows_of_text = [f" {json.dumps(name)}: {json.dumps(row)}"
                    for name, row in draw_folds().items()]
    target.write_text("{\n" + ",\n".join(rows_of_text) + "\n}\n", encoding="utf-8")
