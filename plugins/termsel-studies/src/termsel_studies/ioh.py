"""Runs in the format of IOHprofiler, which IOHanalyzer and iohinspector read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from itertools import chain, count
from pathlib import Path
from typing import Any

from termsel import Study, __version__
from termsel.toolkit import write_text
from termsel.toolkit.studies import CellRecord, file_word
from termsel_studies.groups import Groups, evaluations_of_run, group

IOH_FOLDER = "ioh"

FORMAT = "0.3.5"
"""Version of the format, as IOHexperimenter numbers it."""


INFEASIBLE_VALUE = 1e9
"""Value written for a run without a feasible selection, as JSON has no infinity. The number of the
run is added, so that no two runs have the same value."""


def ioh_files(groups: Groups) -> Iterator[tuple[str, str]]:
    """Yield the names and texts of the files of IOHprofiler.


    Each method has a folder, and in it two files for each instance that it was run on: the
    improvements of its runs, and their description. Runs without a feasible selection are among
    them; their best value is `INFEASIBLE_VALUE` plus the number of the run.
    """
    # De Nobel, Ye, Vermetten, Wang, Doerr and Bäck 2024, IOHexperimenter, Evol. Comput. 32(3).
    folders = _folder_names(groups.methods)
    for number, (instance, by_method) in enumerate(groups.instances.items(), 1):
        file_name = file_word(instance, "all")
        # Methods of an instance search the same genome. A run that failed has no size of it.
        dimension = max([1, *(record.figures.get("n_genes") or 0
                              for runs in by_method.values() for record in runs.records)])
        for method, runs in by_method.items():
            folder = folders[method]
            stem = f"IOHprofiler_f{number}_{file_name}"
            data = f"data_f{number}_{file_name}/{stem}.dat"
            yield f"{folder}/{data}", _improvements_text(runs.records)
            yield f"{folder}/{stem}.json", json.dumps(
                _method_description(number, instance, method, dimension, runs.records, data),
                indent=1) + "\n"


def write(study: Study, folder: Path) -> list[Path]:
    """Write the runs of a study into "ioh" below a folder; return [that folder].

    Returns [] if nothing was written, as for a study of the strategy auto alone, which does not
    search. Files of runs that the study no longer has are removed: an analysis of the folder would
    take them for methods of this study.
    """
    ioh_folder = folder / IOH_FOLDER
    earlier = set(ioh_folder.rglob("IOHprofiler_f*"))
    written = set()
    if study.spec.strategies != ("auto",):
        for name, text in ioh_files(group(study.rows, study.records, study.spec.measure)):
            path = ioh_folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, text)
            written.add(path)
    for path in earlier - written:
        path.unlink()
    return [ioh_folder] if written else []


def _improvements_text(records: list[CellRecord]) -> str:
    """Return rows of evaluation and best value of all runs, after a header, as text.

    A run has a row for its first evaluation, for each improvement and for its last evaluation.
    """
    lines = ["evaluations raw_y"]
    for number, record in enumerate(records):
        # No two runs may begin with the same value: iohinspector drops a row that has the value of
        # the row before it, though that is of another run.
        points = {1: INFEASIBLE_VALUE + number}
        points |= {int(point[0]): point[1] for point in record.trace}
        # The last row shows how many evaluations the run had, even if the last improved nothing.
        points.setdefault(_evaluations_of_run(record), _best_of_run(record, number)[1])
        lines += [f"{evaluations} {value:.17g}" for evaluations, value in points.items()]
    return "\n".join(lines) + "\n"


def _evaluations_of_run(record: CellRecord) -> int:
    """Return how many evaluations a run had: at least those of its trace, and at least 1."""
    return int(max([1, evaluations_of_run(record.figures), *(point[0] for point in record.trace)]))


def _best_of_run(record: CellRecord, number: int) -> tuple[int, float]:
    """Return the evaluation at which a run found its best value, and that value.

    `number` counts the runs from 0. Of a run without a feasible selection they are its last
    evaluation and `INFEASIBLE_VALUE` plus the number.
    """
    if not record.trace:
        return _evaluations_of_run(record), INFEASIBLE_VALUE + number
    evaluation, value, _seconds = record.trace[-1]
    return int(evaluation), value


def _method_description(number: int, instance: str, method: str, dimension: int,
                        records: list[CellRecord], data: str) -> dict[str, Any]:
    """Return the description of one method on one instance, as IOHanalyzer reads it.

    `number` is that of the instance, from 1; `dimension` the number of genes; `data` the path of
    the file of improvements below the folder of the method.
    """
    runs_described = []
    for run, record in enumerate(records):
        evaluation, value = _best_of_run(record, run)
        runs_described.append({"instance": 1, "evals": _evaluations_of_run(record),
                          "best": {"evals": evaluation, "y": value, "x": []}})
    return {
        "version": FORMAT, "suite": "termsel", "function_id": number, "function_name": instance,
        "maximization": False,
        "algorithm": {"name": method, "info": f"termsel {__version__}"},
        "attributes": ["evaluations", "raw_y"],
        "scenarios": [{"dimension": dimension, "path": data, "runs": runs_described}]}


def _folder_names(methods: Iterable[str]) -> dict[str, str]:
    """Return the name of a folder for each method.

    Names that differ in capitals alone get a number, as some file systems take them for one.
    """
    folders: dict[str, str] = {}
    used_names: set[str] = set()
    for method in methods:
        file_name = file_word(method, "all")
        names = chain([file_name], (f"{file_name}-{n}" for n in count(2)))
        folders[method] = next(name for name in names if name.lower() not in used_names)
        used_names.add(folders[method].lower())
    return folders
