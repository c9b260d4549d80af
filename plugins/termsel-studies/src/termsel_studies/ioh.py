"""Runs in the format of IOHprofiler, which IOHanalyzer and iohinspector read."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from itertools import chain, count
from pathlib import Path
from typing import Any

from termsel import Study, __version__
from termsel.toolkit import CellRecord, file_word, write_text
from termsel_studies.groups import Groups, group, length

FOLDER = "ioh"

FORMAT = "0.3.5"
"""Version of the format, as IOHexperimenter numbers it."""


def ioh_files(groups: Groups) -> Iterator[tuple[str, str]]:
    """Yield names and texts of IOHprofiler's files: a folder a method, two files an instance."""
    # De Nobel, Ye, Vermetten, Wang, Doerr and Bäck 2024, IOHexperimenter, Evol. Comput. 32(3); a
    # run begins with the row of its first evaluation.
    folders = _folders(groups.methods)
    for number, (instance, by_method) in enumerate(groups.instances.items(), 1):
        file_name = file_word(instance, "all")
        # Readers compare methods of the same dimension alone, so an instance has one.
        dimension = 1
        for runs in by_method.values():
            dimension = max([dimension, *(row.get("n_terms") or 0 for row in runs.rows)])
        for method, runs in by_method.items():
            with_trace = [record for record in runs.records if record.trace]
            if not with_trace:
                continue
            folder = folders[method]
            stem = f"IOHprofiler_f{number}_{file_name}"
            data = f"data_f{number}_{file_name}/{stem}.dat"
            yield f"{folder}/{data}", _data(with_trace)
            yield f"{folder}/{stem}.json", json.dumps(
                _description(number, instance, method, dimension, with_trace, data),
                indent=1) + "\n"


def write(study: Study, folder: Path) -> list[Path]:
    """Write the runs of a study below its folder; return the folder, if any run searched."""
    if study.spec.strategies == ("auto",):
        return []
    files = dict(ioh_files(group(study.rows, study.records, study.spec.measure)))
    for name, text in files.items():
        (folder / FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        write_text(folder / FOLDER / name, text)
    return [folder / FOLDER] if files else []


def _data(records: list[CellRecord]) -> str:
    """Return the improvements of all runs, each run from evaluation 1 to its last one."""
    lines = ["evaluations raw_y"]
    for record in records:
        trace = record.trace
        last = length(record.figures)
        # Before the end of the first generation nothing is known of the best value.
        points = {1: math.inf, **{int(point[0]): point[1] for point in trace}}
        # A run ends with the number of its evaluations, though the last improved nothing.
        points.setdefault(int(max(last, *points)), trace[-1][1])
        lines += [f"{evaluations} {value:.17g}" for evaluations, value in points.items()]
    return "\n".join(lines) + "\n"


def _description(number: int, instance: str, method: str, dimension: int,
                 records: list[CellRecord], data: str) -> dict[str, Any]:
    return {
        "version": FORMAT, "suite": "termsel", "function_id": number, "function_name": instance,
        "maximization": False,
        "algorithm": {"name": method, "info": f"termsel {__version__}"},
        "attributes": ["evaluations", "raw_y"],
        "scenarios": [{
            "dimension": dimension, "path": data,
            "runs": [{"instance": 1, "evals": int(max(length(record.figures), 1)),
                      "best": {"evals": int(record.trace[-1][0]), "y": record.trace[-1][1],
                               "x": []}} for record in records if math.isfinite(
                                   record.trace[-1][1])]}]}


def _folders(methods: Iterable[str]) -> dict[str, str]:
    """Return a folder of its own for each method, capitals ignored as some file systems do."""
    folders: dict[str, str] = {}
    used_names: set[str] = set()
    for method in methods:
        file_name = file_word(method, "all")
        names = chain([file_name], (f"{file_name}-{n}" for n in count(2)))
        folders[method] = next(name for name in names if name.lower() not in used_names)
        used_names.add(folders[method].lower())
    return folders
