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


WORST = 1e9
"""What is written of a run without a feasible selection, and a little more for each further run:
JSON has no infinity."""


def ioh_files(groups: Groups) -> Iterator[tuple[str, str]]:
    """Yield names and texts of IOHprofiler's files: a folder a method, two files an instance.

    Runs without a feasible selection are among them, with `WORST` as their best value.
    """
    # De Nobel, Ye, Vermetten, Wang, Doerr and Bäck 2024, IOHexperimenter, Evol. Comput. 32(3); a
    # run begins with the row of its first evaluation.
    folders = _folder_names(groups.methods)
    for number, (instance, by_method) in enumerate(groups.instances.items(), 1):
        file_name = file_word(instance, "all")
        # Methods of an instance search the same genome; a run that failed does not show its size.
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
    """Write the runs of a study below its folder; return [folder of them], [] if nothing searched.

    Runs of an earlier form of the study, which lie there, are removed: an analysis of the folder
    would take them for methods of this one.
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
    """Return the improvements of all runs as text, each run from evaluation 1 to its last one."""
    lines = ["evaluations raw_y"]
    for number, record in enumerate(records):
        # No two runs begin alike: iohinspector drops a row with the value of the row before it,
        # though that is of another run.
        points = {1: WORST + number, **{int(point[0]): point[1] for point in record.trace}}
        # A run ends with the number of its evaluations, though the last improved nothing.
        points.setdefault(_evaluations_of_run(record), _best_of_run(record, number)[1])
        lines += [f"{evaluations} {value:.17g}" for evaluations, value in points.items()]
    return "\n".join(lines) + "\n"


def _evaluations_of_run(record: CellRecord) -> int:
    """Return the evaluations of a run; 1 where it failed before it could show."""
    return int(max([1, evaluations_of_run(record.figures), *(point[0] for point in record.trace)]))


def _best_of_run(record: CellRecord, number: int) -> tuple[int, float]:
    """Return the evaluation that found the best value of the number-th run, and that value.

    A run that found none has a value worse than any.
    """
    if not record.trace:
        return _evaluations_of_run(record), WORST + number
    evaluation, value, _seconds = record.trace[-1]
    return int(evaluation), value


def _method_description(number: int, instance: str, method: str, dimension: int,
                        records: list[CellRecord], data: str) -> dict[str, Any]:
    """Return the description of one method on one instance, as IOHanalyzer reads it."""
    described = []
    for number, record in enumerate(records):
        evaluation, value = _best_of_run(record, number)
        described.append({"instance": 1, "evals": _evaluations_of_run(record),
                          "best": {"evals": evaluation, "y": value, "x": []}})
    return {
        "version": FORMAT, "suite": "termsel", "function_id": number, "function_name": instance,
        "maximization": False,
        "algorithm": {"name": method, "info": f"termsel {__version__}"},
        "attributes": ["evaluations", "raw_y"],
        "scenarios": [{"dimension": dimension, "path": data, "runs": described}]}


def _folder_names(methods: Iterable[str]) -> dict[str, str]:
    """Return a folder name of its own for each method, different without regard to capitals."""
    folders: dict[str, str] = {}
    used_names: set[str] = set()
    for method in methods:
        file_name = file_word(method, "all")
        names = chain([file_name], (f"{file_name}-{n}" for n in count(2)))
        folders[method] = next(name for name in names if name.lower() not in used_names)
        used_names.add(folders[method].lower())
    return folders
