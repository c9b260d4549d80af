"""The folder of a result: result.json, what it was made from, and tables for people."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, first_names_in_words
from termsel.core.files.atomic import make_folder, private_folder, put_in_place, sync, utf8_bytes
from termsel.core.files.lock import lock_folder
from termsel.core.files.names import (
    CERTIFICATE,
    JOURNAL,
    RECORD,
    STABILITY,
    is_there,
    path_inside,
    refuse_link,
)
from termsel.core.files.texts import csv_table
from termsel.core.options import options_of_file
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import normalise
from termsel.data.features import FeatureSet, empty_lines, empty_points
from termsel.data.record.record import Record
from termsel.data.roles import observations_by_role
from termsel.data.rpc import Rpc
from termsel.formats.base import error_in_file, parse_json, read_utf8
from termsel.formats.readers.csv_tables import LinesCsv, PointsCsv, lines_text, points_text
from termsel.io.result_of_record import AGAIN, record_from, result_from
from termsel.results.result import (
    Result,
    checksum_of_attributes,
    checksum_of_features,
    checksum_of_record,
    require_result,
)

POINTS, LINES = "points.csv", "lines.csv"
RESIDUALS, SUMMARY = "residuals.csv", "summary.txt"
FILES = (RECORD, POINTS, LINES, RESIDUALS, SUMMARY, CERTIFICATE, STABILITY)
_PENDING = ".termsel-pending"
"""Folder in that of a result, complete or not there: files that are newer than those next to it."""

RESIDUAL_COLUMNS = ("id", "kind", "role", "used", "residual_line", "residual_sample", "distance",
                    "blunder")


def files_of_result(folder: Path) -> list[Path]:
    """Return all files that a result in this folder may have."""
    return [directory / name for directory, name in product((folder, folder / _PENDING), FILES)]


def names_of(features: FeatureSet) -> tuple[str, ...]:
    """Return the names of the files that a result of these features has."""
    names = [RECORD, RESIDUALS, SUMMARY]
    if len(features.points):
        names.append(POINTS)
    if len(features.lines):
        names.append(LINES)
    return tuple(names)


@contextmanager
def lock_output_folder(folder: Path, *, overwrite: bool = False) -> Iterator[None]:
    """Make the folder unless it is there, and keep other processes out of it during the block.

    Raises TermselError for a folder that cannot be made or written to; in which another process is
    at work; that is the folder of a study; or that has a result that may not be replaced, or files
    that would be replaced and are not those of a result.
    """
    make_folder(folder)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise TermselError(f"cannot write to the folder {folder}", hint="Choose another --out.")
    with lock_folder(folder):
        _refuse_taken(folder, overwrite)
        yield


def _refuse_taken(folder: Path, overwrite: bool) -> None:
    """Raise TermselError for the folder of a study, or with files that a result would replace.

    Those of an earlier result may be replaced with `overwrite`.
    """
    if is_there(folder / JOURNAL):
        raise TermselError("this is the folder of a study, which takes no further result",
                           file=folder, hint="Choose another --out.")
    # A file of such a name without a record was written by somebody else.
    for name in (POINTS, LINES, RESIDUALS, SUMMARY, CERTIFICATE):
        if is_there(folder / name) and not is_there(_path_of_file(folder, RECORD)):
            raise TermselError("the result would replace this file, which is not part of a result",
                               file=folder / name, hint="Choose another --out.")
    if not overwrite and _path_of_file(folder, RECORD).exists():
        raise TermselError("there is a result in this folder already", file=folder,
                           hint=f"Choose another {Remedy('out')}, or add {Remedy('overwrite')}.")


@explains_arguments(checked_within=("result",))
def write_result(result: Result, folder: Path | str) -> None:
    """Write result.json, residuals.csv, summary.txt and the features, all of them or none.

    With points.csv and lines.csv the folder is self-contained.

    Parameters
    ----------
    result : Result
        As `termsel.run` returns it.
    folder : path-like
        It must exist; a result that is there is replaced.

    Returns
    -------
    None

    Raises
    ------
    TermselError
        If the folder cannot be written.

    Examples
    --------
    >>> import tempfile, termsel
    >>> result = termsel.run(features=termsel.simulate_scene("spot-isfahan"), strategy="as-asked",
    ...                      model="affine", solver="all-terms")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     termsel.write_result(result, folder)
    ...     round(termsel.read_result(folder).rmse["control"].total, 1)  # px
    9.3
    """
    require_result(result, "write_result")
    folder = Path(folder)
    files = {name: utf8_bytes(text) for name, text in _contents_by_file(result).items()}
    _put_in_place(folder)  # an earlier result, if that was interrupted
    try:
        # Wherever this is interrupted, `read_result` finds the earlier result or the new one: the
        # new files are written into a folder of their own, one renaming makes them valid, and then
        # they are put in place one by one.
        with private_folder(folder) as new:
            # On the disk before the renaming that makes them valid.
            for name, content in files.items():
                (new / name).write_bytes(content)
                sync(new / name)
            # As permissive as the folder that the user made.
            shutil.copymode(folder, new)
            new.rename(folder / _PENDING)
            sync(folder)
    except OSError as error:
        raise _cannot_write(folder, error) from error
    _put_in_place(folder)


def _contents_by_file(result: Result) -> dict[str, str]:
    """Return the text of each file of a result by its name, the record last.

    There is a table of points and one of lines only for a result that has any.
    """
    points = result.features.points
    lines = result.features.lines
    crs = result.features.crs
    size = result.features.image_size
    texts: dict[str, str] = {}
    if len(points):
        texts[POINTS] = points_text(points, crs, size)
    if len(lines):
        texts[LINES] = lines_text(lines, crs, size)
    return {**texts, RESIDUALS: residuals_csv(result), SUMMARY: result.summary(verbose=True),
            **result.files, RECORD: result.to_json()}


def _put_in_place(folder: Path) -> None:
    """Replace the files of a folder by the pending ones; nothing without these.

    Raises TermselError for a pending file that is not part of a result, and where the folder cannot
    be written to.
    """
    pending = _pending_folder(folder)
    if not pending.is_dir():
        return
    try:
        # Repeating this after an interruption goes on where it stopped.
        for file in sorted(pending.iterdir()):
            if file.name not in FILES:
                raise TermselError("this file is not part of a result, and stays where it is",
                                   file=file, hint="Remove it, or choose another --out.")
            put_in_place(path_inside(pending, file.name), path_inside(folder, file.name))
        sync(folder)
        pending.rmdir()
    except OSError as error:
        raise _cannot_write(folder, error) from error


def _cannot_write(folder: Path, error: OSError) -> TermselError:
    """Return the error for a result that cannot be written, and why."""
    if not folder.exists():
        return TermselError("cannot write the result: this folder does not exist", file=folder,
                            hint="Make it before: its mkdir(parents=True). termsel.run(out=...) "
                                 "makes its own.")
    return TermselError(f"cannot write the result: {error.strerror or error}", file=folder,
                        hint="Check that the folder is writable and has free space, or choose "
                             "another --out.")


def _path_of_file(folder: Path, name: str) -> Path:
    """Return the path of a file of the result: the pending one, if it is not yet in place."""
    # A result that was interrupted while it was put in place is read from where it is complete.
    pending = path_inside(_pending_folder(folder), name)
    return pending if is_there(pending) else path_inside(folder, name)


def _pending_folder(folder: Path) -> Path:
    """Return the folder of files that are pending, which is no link."""
    refuse_link(folder / _PENDING)
    return folder / _PENDING


@explains_arguments()
def read_result(folder: Path | str) -> Result:
    """Return the result a run has written to a folder.

    Parameters
    ----------
    folder : path-like
        The folder that ``--out`` named.

    Returns
    -------
    Result
        The result that the run returned.

    Raises
    ------
    TermselError
        If there is no result, a file of it is missing, was changed or is of another version, or
        its model is of a plugin that is not installed.

    Examples
    --------
    >>> import tempfile, termsel
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     out = f"{folder}/result"
    ...     result = termsel.run("poly-terms", seed=1, generations=2, out=out)
    ...     termsel.read_result(out).seed
    1
    """
    path = _path_of_file(Path(folder), RECORD)
    if not is_there(path):
        raise _no_result_error(Path(folder), path)
    try:
        content = parse_json(read_utf8(path), AGAIN)
        record = record_from(content)
        _refuse_changed(record.checksums is None
                        or record.checksums.record != checksum_of_record(content),
                        path)
        features = _read_features(Path(folder), record)
        # A record that was edited, and features that do not go with it, are refused alike.
        seals = record.checksums
        files = [
            name for name, table in ((POINTS, features.points), (LINES, features.lines))
            if len(table)]
        _refuse_changed(seals is None or seals.features != checksum_of_features(features)
                        or seals.attributes != checksum_of_attributes(features),
                        path.with_name(" or ".join(files)))
        with options_of_file(Path(folder) / RECORD):
            return result_from(record, features)
    # An error that names no file is one of the record.
    except TermselError as error:
        raise (error if error.file is not None else error_in_file(error, path)) from error


def results_within(folder: Path) -> list[str]:
    """Return the folders of results within a folder, such as those of a block or a study."""
    records = {*folder.glob(f"*/{RECORD}"), *folder.glob(f"*/*/{RECORD}")}
    return sorted(str(result.parent) for result in records)


def _no_result_error(folder: Path, path: Path) -> TermselError:
    """Return the error for a folder without a result.

    Where folders within it have results, as those of a block or a study do, it names some of them.
    """
    if not folder.exists():
        return TermselError("there is no result here: this folder does not exist", file=folder,
                            hint="Give the folder of a run, as in termsel run --out DIR.")
    if folder.is_file():
        return TermselError("this is a file, expected the folder of a result", file=folder,
                            hint="Give the folder that termsel run --out DIR wrote.")
    names = results_within(folder)
    if names:
        return TermselError("there is no result here, but in folders within it", file=folder,
                            hint=f"Give one of them: {first_names_in_words(names, 3)}.")
    return TermselError("there is no result here", file=path,
                        hint="Give the folder of a run, as in termsel run --out DIR.")


def _read_features(folder: Path, record: Record) -> FeatureSet:
    """Return the features of a result; refuse features other than those it was made from.

    Ids, roles and counts of the tables are compared with those of the record, as anybody can edit a
    table: figures of a result must not be told of other points. Raises TermselError for files that
    are missing or differ.
    """
    data = record.data
    counts = data.counts
    normalise(data.crs)
    # The record says which tables there are: one that it does not count is of an earlier result.
    point_count = counts.control + counts.check + counts.independent + counts.off
    lines_path = _path_of_file(folder, LINES)
    points_path = _path_of_file(folder, POINTS)
    for path, count in ((lines_path, counts.lines), (points_path, point_count)):
        if count and not path.exists():
            raise TermselError(f"the folder of this result lacks its file {path.name}",
                               file=folder, hint=AGAIN)
    lines = LinesCsv().read(lines_path).lines if counts.lines else empty_lines()
    points = PointsCsv().read(points_path).points if point_count else empty_points()
    features = FeatureSet(points, lines, crs=data.crs, image_size=data.image_size,
                          noise=data.noise, heights=data.heights or "",
                          fit_crs=record.scaling.fit_crs,
                          rpc=None if data.rpc is None else Rpc.from_numbers(data.rpc))
    observations = observations_by_role(features)
    roles = {"control": observations.control.ids, "check": observations.check.ids,
             "independent": observations.independent.ids, "off": observations.off}
    for role, ids in roles.items():
        if set(ids) != set(getattr(data.roles, role)):
            raise TermselError(f"{POINTS} and {LINES} do not have the {role} features that "
                               f"{RECORD} names", file=folder,
                               hint="Copy the original folder again, or repeat the run.")
    return features


def _refuse_changed(changed: bool, path: Path) -> None:
    """Raise TermselError for a file that was changed after the run."""
    if changed:
        raise TermselError("this file was changed after the run wrote it", file=path,
                           hint="Copy the original folder again, or repeat the run.")


def residuals_csv(result: Result) -> str:
    """Return the residuals of all features [px] as CSV."""
    rows = [(r.id, r.kind, r.role, "yes" if r.used else "no", f"{r.line:.6g}", f"{r.sample:.6g}",
             f"{r.distance:.6g}", r.blunder) for r in result.residuals]
    return csv_table([RESIDUAL_COLUMNS, *rows])
