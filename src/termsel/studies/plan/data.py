"""The data of a study: read once, named, and identified by their content."""

from __future__ import annotations

import glob
import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

from termsel.core.display.quiet import quiet_logger
from termsel.core.errors import TermselError
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.io.read import parts_of, read
from termsel.plugins.registry import registry
from termsel.results.result import checksum_of_attributes, checksum_of_features
from termsel.studies.execution.naming import name_image_in_log
from termsel.studies.plan.places import Path as Keys
from termsel.studies.plan.spec import Source, Spec

log = logging.getLogger(__name__)

SOON = 5.0
"""Seconds after which a search for files is told."""

_WILD = "*?["


@dataclass(frozen=True, eq=False)
class Data:
    """Features that cells of a study share."""

    label: str  # what tables call them: the file as the study names it, or the data set
    key: str  # checksum of their content
    source: str  # where they come from, for the record
    features: FeatureSet | None  # None where they cannot be read, for this reason
    reason: str = ""
    path: Keys = ()  # where the study file names them
    warnings: tuple[str, ...] = ()  # on them as they were read


def data_of(spec: Spec, folder: Path, tables: frozenset[Path] = frozenset()) -> list[Data]:
    """Return all data that a study names, each once; file names are relative to `folder`.

    Files among `tables`, the resolved paths of what the study itself writes, are skipped. What the
    files have in common, such as heights from a raster, is told once for all.

    Raises TermselError for data that are named twice, and where none of the data can be read.
    """
    data_sets: list[Data] = []
    # What is said of the heights of one file would stand there for each of hundreds.
    with quiet_logger("termsel.formats.heights", logging.WARNING):
        for source in spec.data:
            data_sets += _data_of_source(spec, source, folder, tables)
    _say_heights(data_sets)
    labels: set[str] = set()
    for data in data_sets:
        # Tables call data by their labels.
        if data.label in labels:
            raise spec.places.error(data.path, f"the data {data.label} are named twice",
                                    "Name them once.")
        labels.add(data.label)
    if data_sets and all(data.features is None for data in data_sets):
        raise TermselError(data_sets[0].reason, hint=None if len(data_sets) == 1 else
                           f"None of the {len(data_sets)} data can be read; this is the first.")
    return data_sets


def _say_heights(data_sets: Sequence[Data]) -> None:
    """Say once which heights came from a raster, for all files together."""
    statements = [data.features.heights for data in data_sets if data.features is not None]
    counts: dict[str, list[tuple[int, int]]] = {}
    for statement in statements:
        if match := _HEIGHTS.fullmatch(statement):
            counts.setdefault(match[3], []).append((int(match[1]), int(match[2])))
    for raster, file_counts in counts.items():
        n_taken = sum(taken for taken, _ in file_counts)
        n_features = sum(total for _, total in file_counts)
        if n_taken:
            where = f", in {len(file_counts)} files" if len(file_counts) > 1 else ""
            log.info("Heights: %d of %d %s%s.", n_taken, n_features, raster, where)


_HEIGHTS = re.compile(r"(\d+) of (\d+) (heights from .*)")
"""What features state of their heights."""


def files_of(spec: Spec, folder: Path) -> list[Path]:
    """Return every file that a study names, each once, without reading any.

    These are all files that match its patterns of data, and the files that its options name.
    Raises TermselError where no file matches a pattern.
    """
    named: list[Path] = []
    for source in spec.data:
        for kind, patterns in source.files.items():
            named += [folder / name
                      for name in _matching_files(spec, source, kind, patterns, folder)]
        named += _files_named_by(source.reading, folder)
    for component in (*spec.problems, *spec.models, *spec.solvers, *spec.criteria):
        named += _files_named_by(component.options, folder)
    named += _files_named_by(spec.options, folder)
    return list(dict.fromkeys(named))


def _files_named_by(options: Mapping[str, Any], folder: Path) -> Iterator[Path]:
    """Yield the files that options name, such as a raster of heights or an RPC."""
    for value in options.values():
        if isinstance(value, str) and value:
            # Relative to the folder of the study, or to where the command runs.
            for candidate in (folder / value, Path(value)):
                with suppress(OSError, ValueError):  # a text that is too long for a name
                    if candidate.is_file():
                        yield candidate
                        break


def data_of_dataset(name: str, path: Keys = ()) -> Data:
    """Return a data set that is known by name."""
    dataset: DatasetSpec = registry().get("datasets", name)
    features = dataset.load()
    source = f"{dataset.name} (simulated)" if dataset.simulated else dataset.name
    return Data(name, _group_key(features), source, features, path=path)


def _data_of_source(spec: Spec, source: Source, folder: Path,
                    tables: frozenset[Path]) -> Iterator[Data]:
    """Yield the data of one source: feature sets, a data set, or files by pattern.

    Raises TermselError, with the place in the study, for a data set that is not known.
    """
    for label, features in source.features.items():
        yield Data(label, _group_key(features), label, features, path=source.path)
    if source.dataset is not None:
        try:
            yield data_of_dataset(source.dataset, source.path)
        except TermselError as error:
            raise spec.places.error((*source.path, "dataset"), error.what, error.hint) from error
    if source.files:
        # Files by kind, then paired to images, then divided into parts.
        matched = {kind: _without_tables(_matching_files(spec, source, kind, patterns, folder),
                                         folder, tables)
                   for kind, patterns in source.files.items()}
        for files in _group_files(spec, source, matched):
            for part_name, options in _options_by_part(source, files, folder).items():
                yield _read_image(source, files, folder, part_name, options)


def _matching_files(spec: Spec, source: Source, kind: str, patterns: tuple[str, ...],
                    folder: Path) -> list[str]:
    """Return the files of patterns, in the order of the patterns and then of their names.

    Raises TermselError, with the place in the study, for a pattern that no file matches.
    """
    files: list[str] = []
    for pattern in patterns:
        # A plain name must exist; a pattern must match something.
        has_wildcard = any(sign in pattern for sign in _WILD)
        names = _glob_files(pattern, folder) if has_wildcard else [pattern]
        if not names or (not has_wildcard and not os.path.exists(folder / pattern)):
            raise spec.places.error((*source.path, kind), f"no file matches {pattern!r} in "
                                    f"{folder.resolve()}", _how_to_name(pattern, kind, folder))
        files += [Path(name).as_posix() for name in names]
    return list(dict.fromkeys(files))


def _without_tables(files: list[str], folder: Path, tables: frozenset[Path]) -> list[str]:
    """Return files without those that the study itself writes, and say which these are."""
    measured = [name for name in files if (folder / name).resolve() not in tables]
    # Where nothing else is left, the reader says what such a file lacks.
    if not measured or len(measured) == len(files):
        return files
    log.info("Note: %s in the folder of --out: a table that termsel wrote there is no file of "
             "points, and is skipped.", ", ".join(name for name in files if name not in measured))
    return measured


def _how_to_name(pattern: str, kind: str, folder: Path) -> str:
    """Return advice on a pattern that no file matches."""
    names = [name.strip() for name in pattern.split(",")]
    if len(names) > 1 and all(os.path.exists(folder / name) for name in names):
        return f"Separate files by --{kind}: --{kind} {f' --{kind} '.join(names)}."
    return "Check the name and the folder."


def _glob_files(pattern: str, folder: Path) -> list[str]:
    """Return the files that match a pattern, and say that this goes on where it takes long."""
    timer = Timer(SOON, log.warning, (
        "Note: looking for files that match %s in %s takes long. Ctrl-C ends the command.",
        pattern, folder.resolve()))
    timer.daemon = True
    timer.start()
    try:
        return sorted(glob.glob(pattern, root_dir=folder, recursive=True))
    finally:
        timer.cancel()


def _group_files(spec: Spec, source: Source,
                 matched: Mapping[str, list[str]]) -> Iterator[dict[str, str]]:
    """Yield the files of each image by their kind, such as points and lines.

    `matched` has all files of each kind. Of a single kind every file is an image. Files of two
    kinds belong to one image by their names without the suffix, unless there is only one of each.
    Raises TermselError where they do not pair.
    """
    kinds = list(matched)
    if all(len(names) == 1 for names in matched.values()):
        yield {kind: names[0] for kind, names in matched.items()}
        return
    # The name without its folder and suffix pairs the files of one image.
    by_stem = {}
    for kind, names in matched.items():
        by_stem[kind] = {Path(name).stem: name for name in names}
    if len(kinds) == 1:
        yield from ({kinds[0]: name} for name in matched[kinds[0]])
        return
    stems = by_stem[kinds[0]]
    for kind in kinds:
        are_unique = len(by_stem[kind]) == len(matched[kind])
        if not are_unique or set(by_stem[kind]) != set(stems):
            raise spec.places.error(
                (*source.path, kind), f"the files of {kind} do not pair with those of {kinds[0]}",
                "Several files of two kinds are paired by their names without the suffix.")
    for stem in stems:
        yield {kind: by_stem[kind][stem] for kind in kinds}


def _options_by_part(
    source: Source, files: Mapping[str, str], folder: Path
) -> dict[str, dict[str, Any]]:
    """Return the options with which each part of a file is read, by the part's name.

    {"": {}}, a single part without a name or options, where the file has no parts.
    """
    undivided: dict[str, dict[str, Any]] = {"": {}}
    if set(files) != {"points"}:
        return undivided
    try:
        return parts_of(folder / files["points"], **source.reading) or undivided
    # Of a file that cannot be read nothing is known of its parts.
    except TermselError:
        return undivided  # it is told when the file is read


def _read_image(source: Source, files: Mapping[str, str], folder: Path, part_name: str,
                options: Mapping[str, Any]) -> Data:
    """Return the features of one image's files as data of a study, or why they cannot be read.

    `files` are names in `folder`, by what they are, such as "points" or "lines"; `part_name` is the
    name of a part of them, "" for all. `options` go before those of the source.
    """
    label = " + ".join(dict.fromkeys(files.values()))
    if part_name:
        label = f"{label}#{part_name}"
    of_files: dict[str, Any] = {kind: folder / name for kind, name in files.items()}
    try:
        with name_image_in_log(label) as warnings:
            features = read(**of_files, **{**source.reading, **options})
    except TermselError as error:
        return Data(label, "unreadable", label, None, str(error), source.path)
    return Data(label, _group_key(features), label, features, path=source.path,
                warnings=tuple(warnings))


def _group_key(features: FeatureSet) -> str:
    """Return the key that images with equal features share."""
    # Attributes are columns that methods may read.
    return checksum_of_features(features) + (checksum_of_attributes(features) or "")
