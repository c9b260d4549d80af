"""Many runs as one study: plan, run what is not finished, show what came out."""

from __future__ import annotations

import glob
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from termsel.adjustment.kernels import needs_compilation
from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, count_in_words, shown_value
from termsel.core.files.atomic import make_folder, private_folder
from termsel.core.files.lock import lock_folder
from termsel.core.files.names import JOURNAL, RECORD
from termsel.core.isolation.parts import value_of_slot
from termsel.core.options import options_of_file
from termsel.data.features import FeatureSet
from termsel.io.export import writer_of
from termsel.plugins.registry import registry
from termsel.runs.finding import package_versions
from termsel.runs.notebook import line_of_many
from termsel.studies.cells.cell import Cell, cells_of, kind_of
from termsel.studies.cells.folder import PLAN, keys_by_labels, write_plan
from termsel.studies.cells.images import IMAGES, folders_of, write_files
from termsel.studies.cells.journal import Journal, read_journal
from termsel.studies.execution.contained import run_contained
from termsel.studies.execution.executors import defer_interrupts, run_in_processes, run_serially
from termsel.studies.execution.progress import StudyProgress, Tally
from termsel.studies.execution.work import OUT_OF_TIME, Outcome, do, failed_outcome
from termsel.studies.outputs import output_names
from termsel.studies.plan.data import data_of
from termsel.studies.plan.spec import READING, Spec, read_spec, spec_of
from termsel.studies.study import Study

log = logging.getLogger(__name__)

Observer = Callable[[StudyProgress], None]


@explains_arguments()
def compare(
    study: Path | str | Sequence[Path | str] | Mapping[str, Any] | None = None,
    *,
    out: Path | str | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    observers: tuple[Observer, ...] = (),
    **keys: Any,
) -> Study:
    """Run every combination of problems, data, models, solvers and seeds, and compare them.

    Parameters
    ----------
    study : path or mapping, optional
        A study file, or its content; or files of points, an image each, as a list or a pattern:
        this is `data=[{"points": files}]`.
    out : path, optional
        Folder of the journal and the tables. The same call goes on where an earlier one stopped.
        Without it nothing is kept.
    workers : int
        Processes at a time; 1 runs the cells in this process, those with parts of other plugins
        or of modules of yours in one more.
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://host:8786"; its workers run the cells.
    observers : tuple of callable
        Called with `StudyProgress` when the study begins and after every cell. In a notebook one
        more shows the progress.
    **keys
        Keys of a study, without `study` or in place of those of a mapping: problems, models,
        solvers, criteria, methods, strategies, data, seeds, splits, budget, options, exports,
        measure, measures, accept, title. Problems, models, solvers, criteria and methods may be
        objects, as in `run`; data may be a mapping of feature sets by name. With files of points
        also crs, dem and columns, which are those of `read`.

    Returns
    -------
    Study
        Also where Ctrl-C ended it early.

    Raises
    ------
    TermselError
        Before anything is run, for a study that cannot be, and for keys next to a study file; or
        if `out` cannot be written or another process is at work there.

    Examples
    --------
    >>> import termsel
    >>> study = termsel.compare(problems=["poly-terms"], solvers=["random", "swap"], seeds=2,
    ...                         budget={"evaluations": 200}, options={"degree": 2})
    >>> len(study.rows)
    4
    """
    if workers < 1:
        raise TermselError(f"{workers} workers cannot run anything", hint="Give 1 or more.")
    spec, folder = requested_study(study, keys)
    tables = () if out is None else [(Path(out) / name).resolve() for name in output_names()]
    cells = plan_cells(spec, folder, frozenset(tables))
    labels = {cell.key: cell.labels for cell in cells}
    folders = folders_of(labels)
    with ExitStack() as stack:
        # Without a folder a study keeps its journal all the same, until it ends.
        directory = Path(out) if out is not None else stack.enter_context(private_folder())
        plugins = _plugin_versions(cells, spec)
        journal = _open_journal(stack, directory, {**package_versions(), **plugins})
        # Read before the plan is replaced, to show what has changed since.
        before = keys_by_labels(directory)
        write_plan(spec, cells, workers, directory)
        finished = {cell.key: journal.records[cell.key] for cell in cells
                    if cell.key in journal.records}
        tally = Tally(labels, workers, finished)
        title = spec.title or "Study"
        show = stack.enter_context(line_of_many(title))
        observers = (*observers, lambda progress: show(
            f"{title}: {progress.finished} of {count_in_words(progress.total, 'run')}, "
            f"{progress.time_left()}", progress.finished == progress.total))
        for remark in journal.remarks:
            log.warning(remark)
        # The same labels under another key: its data or its code are other ones.
        changed = {key for cell in cells if cell.key not in finished
                   and (key := before.get(tuple(cell.labels.values()))) in journal.records}
        if changed:
            log.warning("%s repeated, as data, options, budget or code changed since.",
                        count_in_words(len(changed), "finished run"))
        if foreign := len(journal.records) - len(finished):
            log.warning("The journal keeps %s of other data, options or code, and does not use %s.",
                        count_in_words(foreign, "finished run"), "it" if foreign == 1 else "them")
        for observe in observers:
            observe(tally.progress())
        waiting = [cell for cell in cells if cell.key not in finished]
        # The first Ctrl-C lets the cells under way end: their work is kept.
        stopped = stack.enter_context(defer_interrupts(lambda: log.warning(FINISHING)))
        for outcome in _run_cells(waiting, stopped, workers, scheduler, plugins):
            key = outcome.record.cell
            # Files first: what the journal calls finished has them.
            if out is not None and outcome.files:
                write_files(directory / IMAGES / folders[key], outcome.files)
            journal.append(outcome.record)
            finished[key] = outcome.record
            tally.count(outcome.record)
            for observe in observers:
                observe(tally.progress())
        return Study(spec, labels, finished, Path(out) if out is not None else None)


PROBE_SECONDS = 10.0
"""Seconds after which an estimate ends a cell."""

LONG_CELL_SECONDS = 20.0
"""Seconds from which on a cell is not run again to learn its time."""

FINISHING = "The runs under way are being finished. Ctrl-C once more ends at once."


def requested_study(study: Path | str | Sequence[Path | str] | Mapping[str, Any] | None,
                    keys: Mapping[str, Any]) -> tuple[Spec, Path]:
    """Return the spec of a study, and the folder that its file names are relative to.

    Raises TermselError for keys next to a study file.
    """
    if isinstance(study, str) and glob.has_magic(study):
        study = [study]
    if isinstance(study, Sequence) and not isinstance(study, str):
        return spec_of(_keys_of_images(study, keys)), Path()
    if isinstance(study, str | Path):
        if keys:
            raise TermselError(f"{min(keys)} is given next to a study file",
                               hint="Write it into the file.")
        return read_spec(Path(study)), Path(study).parent
    return spec_of({**(study or {}), **keys}), Path()


def _keys_of_images(files: Sequence[Path | str], keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a study of images, of which each has a file of points.

    Raises TermselError for what names no file, and for further data.
    """
    for item in files:
        if not isinstance(item, Path | str):
            raise TermselError(f"an item of the list is {shown_value(item)}, expected the name of "
                               "a file", hint="Features that were read: data={'a name': FEATURES}.")
    if "data" in keys:
        raise TermselError("data is given next to a list of files",
                           hint="Leave out the list, and give data=[{'points': FILES}].")
    reading = {key: value for key, value in keys.items() if key in READING}
    others = {key: value for key, value in keys.items() if key not in READING}
    return {"data": [{"points": list(files), **reading}], **others}


def plan_cells(spec: Spec, folder: Path, tables: frozenset[Path] = frozenset()) -> list[Cell]:
    """Return the cells of a study, all checked; file names are relative to `folder`.

    Files among `tables`, the resolved paths of what the study itself writes, are skipped.

    Raises TermselError, with the place in the study, for an unknown format of its exports.
    """
    for i, name in enumerate(spec.exports):
        try:
            # Unknown formats are refused before the first cell, not after hours.
            writer_of(name)
        except TermselError as error:
            raise spec.places.error(("exports", i), error.what, error.hint) from error
    with options_of_file(spec.places.file):
        return cells_of(spec, data_of(spec, folder, tables))


def works_of(cells: list[Cell]) -> tuple[list[Cell], dict[str, FeatureSet]]:
    """Return the cells that can run, without labels and features, and the features by their key.

    Cells go to other processes, and features travel once to each of these, not with every cell.
    """
    works = [replace(cell, labels={}, data=replace(cell.data, features=None))
             for cell in cells if cell.data.features is not None]
    features_by_key = {cell.data.key: cell.data.features for cell in cells
                       if cell.data.features is not None}
    return works, features_by_key


class Estimate(NamedTuple):
    """How long the cells of one kind take: seconds are the mean of all, None if none of them ended.

    `loading` is what the first run of a kind takes longer than a further one [s].
    """

    kind: tuple[str, ...]
    number: int
    seconds: float | None
    reason: str
    loading: float = 0.0


def estimate(study: Path | str | Mapping[str, Any] | None = None,
             **keys: Any) -> Iterator[Estimate]:
    """Yield how long the cells of each kind take, and why some of them failed, if any did.

    Arguments as for `compare`. Cells with the fewest, middling and most features are run, and the
    time of the others is interpolated; it is None where none of them can be run. The first also
    loads what its kind needs: another takes its place, unless it takes `LONG_CELL_SECONDS` and
    compiled nothing. A cell is ended after `PROBE_SECONDS`, which then is the least that it takes,
    and the reason says so.
    """
    spec, folder = requested_study(study, keys)
    # Before anything is run: the first cell would otherwise count the compilation.
    cold = needs_compilation()
    kinds: dict[tuple[str, ...], list[Cell]] = {}
    for cell in plan_cells(spec, folder):
        kinds.setdefault(kind_of(cell.labels), []).append(cell)
    for kind, cells in kinds.items():
        works, features = works_of(cells)
        if not works:
            yield Estimate(kind, len(cells), None, _reasons_not_to_run(cells))
            continue
        sizes = [len(features[cell.data.key]) for cell in works]
        sample, spare = _cells_of_all_sizes(works, sizes)
        records = [do(cell, features[cell.data.key]).record for cell in sample]
        loading = 0.0
        if cold or records[0].figures.get("seconds", LONG_CELL_SECONDS) < LONG_CELL_SECONDS:
            # The first run of a kind also loads or compiles what it needs.
            first_seconds = records[0].figures.get("seconds", 0.0)
            # The same features once more would be answered from memory; those of others are not.
            sample[0] = spare
            records[0] = do(spare, features[spare.data.key]).record
            # A batch compiles nothing that is compiled here, but loads it again.
            if not cold:
                further_seconds = records[0].figures.get("seconds", first_seconds)
                loading = max(first_seconds - further_seconds, 0.0)
        times_of_size: dict[int, list[float]] = {}
        for cell, record in zip(sample, records, strict=True):
            times = times_of_size.setdefault(len(features[cell.data.key]), [])
            if record.reason == OUT_OF_TIME.format(PROBE_SECONDS):
                times.append(PROBE_SECONDS)
            elif "seconds" in record.figures:
                times.append(record.figures["seconds"])
        seconds_by_size = {size: sum(times) / len(times)
                           for size, times in times_of_size.items() if times}
        reasons = [record.reason for record in records if record.reason]
        yield Estimate(kind, len(cells), _mean_time(sizes, seconds_by_size),
                       reasons[0] if reasons else "", loading)


def _probe(cell: Cell) -> Cell:
    """Return a cell that ends after `PROBE_SECONDS`, so that its time is known soon."""
    limit = cell.call.get("timeout")
    if limit is not None and limit <= PROBE_SECONDS:
        return cell
    return replace(cell, call={**cell.call, "timeout": PROBE_SECONDS})


def _reasons_not_to_run(cells: list[Cell]) -> str:
    """Return why cells cannot run: the first reason, and how many cells have others."""
    further = len({cell.data.reason for cell in cells}) - 1
    others = f" And {count_in_words(further, 'other reason')}." if further else ""
    return f"{cells[0].data.reason}{others}"


def _cells_of_all_sizes(cells: list[Cell], sizes: list[int]) -> tuple[list[Cell], Cell]:
    """Return up to three cells of one kind, and one to run in the place of the first.

    They have the fewest features, a middling number and the most, no two of them the same features,
    and end in time; `sizes` are the numbers of features of all cells. The one for the first has the
    fewest of those that are left; where none is left, it is the first itself.
    """
    by_size = [cells[i] for i in sorted(range(len(cells)), key=sizes.__getitem__)]
    cell_of_features = {by_size[rank].data.key: by_size[rank]
                        for rank in (len(cells) - 1, len(cells) // 2, 0)}
    sample = list(reversed(cell_of_features.values()))
    keys = {cell.key for cell in sample}
    spare = next((cell for cell in by_size if cell.key not in keys), sample[0])
    return [_probe(cell) for cell in sample], _probe(spare)


def _mean_time(sizes: list[int], seconds: Mapping[int, float]) -> float | None:
    """Return the mean time [s] of cells that have these numbers of features.

    `seconds` has the times of the cells that were run, by their number of features; between these
    the time is linear in the logarithm of the number. Returns None if no cell was timed.
    """
    if not seconds:
        return None
    timed_sizes = sorted(seconds)
    times = np.interp(np.log(sizes), np.log(timed_sizes), [seconds[size] for size in timed_sizes])
    return float(times.mean())


def _open_journal(stack: ExitStack, folder: Path, current_versions: Mapping[str, str]) -> Journal:
    """Return the open journal of a folder that this process alone works in.

    Raises TermselError where another process works in it, and where it has files of other origin.
    """
    make_folder(folder)
    stack.enter_context(lock_folder(
        folder, "Wait for it, or choose another --out. "
        f"`termsel compare --status {folder}` shows how far it is."))
    # Whatever reads the folder would take it for the study, and the result would be hidden.
    if (folder / RECORD).exists() and not (folder / JOURNAL).exists():
        raise TermselError(f"the folder has {RECORD}, the result of a run", file=folder,
                           hint="A study would hide it. Choose another --out.")
    # Files of another program with such names must not be replaced.
    outputs = [name for name in (*output_names(), PLAN, IMAGES) if (folder / name).exists()]
    if outputs and not (folder / JOURNAL).exists():
        raise TermselError(f"the folder has {outputs[0]}, but no journal of a study",
                           file=folder,
                           hint=f"{outputs[0]} could be replaced. Choose another --out.")
    journal = read_journal(folder)
    journal.open(current_versions)
    stack.callback(journal.close)
    return journal


def _plugin_versions(cells: list[Cell], spec: Spec) -> dict[str, str]:
    """Return the versions of the plugins that provide something the study names."""
    kinds = {"problem": "problems", "model": "models", "criterion": "criteria",
             "solver": "solvers"}
    named = {("writers", name) for name in spec.exports}
    for cell in cells:
        # An object that Python gave has no name by which a plugin could provide it.
        named |= {(kinds[role], cell.call[role]) for role in kinds
                  if cell.call[role] and role not in cell.things}
    origins: set[str] = set()
    for kind, name in named:
        origins |= {entry.provided_by for entry in registry().entries(kind)
                    if entry.answers_to(name)}
    origins.discard("termsel")
    return {origin: registry().version(origin) for origin in sorted(origins)}


def _run_cells(cells: list[Cell], stopped: Callable[[], bool], workers: int,
               scheduler: str | None, plugins: Mapping[str, str]) -> Iterator[Outcome]:
    """Yield the outcomes of cells as they end, by the executor that is asked for.

    Cells whose features could not be read fail first. `scheduler` is the address of a cluster; None
    runs the cells in `workers` processes of this machine. `stopped` says whether to begin no more.
    """
    for cell in cells:
        if cell.data.features is None:
            yield failed_outcome(cell.key, cell.data.reason)
    works, features = works_of(cells)
    if scheduler is not None:
        on_cluster = value_of_slot("scheduler", "a scheduler requires")
        yield from on_cluster(works, features, stopped, scheduler, plugins)
        return
    if workers == 1:
        # Other programs may crash: they run in a process of their own.
        yield from run_serially([cell for cell in works if not cell.others], features, stopped)
        yield from run_contained([cell for cell in works if cell.others], features, stopped)
        return
    if works and needs_compilation():
        # Compiled code is kept on disk: the first cell makes it once for all processes.
        yield from run_serially(works[:1], features, stopped)
        works = works[1:]
    yield from run_in_processes(works, features, stopped, workers)
