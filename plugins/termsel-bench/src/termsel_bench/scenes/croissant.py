"""Description of the sets as Croissant JSON-LD, with the checksum of each file.

``python -m termsel_bench.scenes.croissant`` freezes the sets again: for maintainers, when a new
version of the benchmark is published.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import termsel_bench
from termsel.toolkit import write_text
from termsel_bench.scenes.base import INDEPENDENT, LINE_COLUMNS, BenchSet, means_of
from termsel_bench.scenes.catalogue import MEANS, METADATA, SETS, simulate_set
from termsel_bench.scenes.measured import FOLDS, read_measured_set

VERSION = "1.0.0"
"""Of the sets: figures of different versions cannot be compared."""

CONTEXT: dict[str, Any] = {
    "@language": "en", "@vocab": "https://schema.org/", "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/", "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/", "conformsTo": "dct:conformsTo",
    "citeAs": "cr:citeAs", "column": "cr:column", "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "extract": "cr:extract",
    "field": "cr:field", "fileObject": "cr:fileObject", "fileSet": "cr:fileSet",
    "format": "cr:format", "includes": "cr:includes", "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath", "key": "cr:key", "md5": "cr:md5", "parentField": "cr:parentField",
    "path": "cr:path", "recordSet": "cr:recordSet", "references": "cr:references",
    "regex": "cr:regex", "repeated": "cr:repeated", "replace": "cr:replace",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "separator": "cr:separator",
    "source": "cr:source", "subField": "cr:subField", "transform": "cr:transform"}
"""The context of Croissant 1.0."""

POINT_COLUMNS = {
    "id": ("sc:Text", "name of the point"),
    "role": ("sc:Text", "control and check are what a method sees, independent judges it"),
    "line": ("sc:Float", "image line [px]; 0 is the centre of the first"),
    "sample": ("sc:Float", "image sample [px]; 0 is the centre of the first"),
    "x": ("sc:Float", "easting [m] or WGS84 longitude [deg]"),
    "y": ("sc:Float", "northing [m] or WGS84 latitude [deg]"),
    "z": ("sc:Float", "ellipsoidal height [m]; blank on maps")}
"""Type and meaning of the columns of points."""


def croissant_description(sets: Iterable[BenchSet]) -> dict[str, Any]:
    """Return the description of simulated sets in Croissant, as JSON-LD.

    It has the files of each set with their checksums, the columns of points with their types, and
    a statement of what the data are not.
    """
    # The sets are gone through twice: for files, and for columns.
    described_sets = list(sets)
    files: list[dict[str, Any]] = []
    for bench_set in described_sets:
        checksums = bench_set.checksums() | {
            file: hashlib.sha256(text.encode()).hexdigest()
            for file, text in bench_set.crs_files().items()}
        files += [{"@type": "cr:FileObject", "@id": file, "name": file, "contentUrl": file,
                   "encodingFormat": "text/csv" if file.endswith(".csv") else "text/plain",
                   "sha256": checksum} for file, checksum in checksums.items()]
    return {
        "@context": CONTEXT, "@type": "sc:Dataset", "conformsTo":
        "http://mlcommons.org/croissant/1.0", "name": "termsel-bench", "version": VERSION,
        "description": "Simulated ground control of images of nine kinds, to compare methods of "
                       f"georeferencing. Each set has {INDEPENDENT:,} independent check points.",
        "license": "https://spdx.org/licenses/MIT.html", "isLiveDataset": False,
        "creator": {"@type": "sc:Organization", "name": "The termsel developers"},
        "citeAs": "The termsel developers, termsel-bench " + VERSION,
        "keywords": ["georeferencing", "ground control points", "sensor models"],
        "rai:dataCollection": "Simulated from seeds; `termsel bench --files DIR` writes the files.",
        "rai:dataLimitations": "No set has measurements of the real world.",
        "distribution": files,
        "recordSet": [record_set for bench_set in described_sets
                      for record_set in _record_sets(bench_set)]}


MEASURED_COLUMNS = {name: POINT_COLUMNS[name] for name in POINT_COLUMNS if name != "role"}
"""Columns of the points of measured sets; some have no heights."""


def croissant_of_measured(names: Sequence[str], files: Mapping[str, str]) -> dict[str, Any]:
    """Return the description of measured sets and of the files that hold them, as JSON-LD.

    `names` are those of the sets, `files` the texts of all files by their names, that of `FOLDS`
    included. Each set has its source and licence, since others measured it.
    """
    sets = [read_measured_set(name) for name in names]
    folds = json.loads(files[FOLDS])
    # Files keep the names under which they were published; one of the tables is a .txt.
    tables = {fold["file"] for fold in folds.values()}
    record_sets = []
    # Croissant describes a set as records, whose fields are the columns of a file.
    for entry in sets:
        file = folds[entry.name]["file"]
        columns = files[file].partition("\n")[0].split(",")
        fields = [{"@type": "cr:Field", "@id": f"{entry.name}/{column}", "name": column,
                   "description": MEASURED_COLUMNS.get(column, ("", "image position [px]"))[1],
                   "dataType": MEASURED_COLUMNS.get(column, ("sc:Float", ""))[0],
                   "source": {"fileObject": {"@id": file}, "extract": {"column": column}}}
                  for column in columns]
        record_sets.append({
            "@type": "cr:RecordSet", "@id": f"{entry.name}/points", "name": f"{entry.name}/points",
            "description": f"Points of the set {entry.name} of the kind {entry.kind}, from "
                           f"{entry.source}, {entry.licence}.", "field": fields})
    return {
        "@context": CONTEXT, "@type": "sc:Dataset", "conformsTo":
        "http://mlcommons.org/croissant/1.0", "name": "termsel-bench-measured", "version": VERSION,
        "description": "Measured ground control: old maps and vertical photos by volunteers, and "
                       "automatic matches, with frozen folds. Blunders are not removed.",
        "license": sorted({f"https://spdx.org/licenses/{entry.licence}.html" for entry in sets}),
        "isLiveDataset": False,
        "creator": {"@type": "sc:Organization", "name": "See the source of each set"},
        "citeAs": "The sources of the sets, and termsel-bench " + VERSION,
        "keywords": ["georeferencing", "ground control points", "old maps"],
        "rai:dataCollection": "Published by others; meta.json of each folder has address and "
                              "commit.",
        "rai:dataLimitations": "Points have blunders, and nobody knows the truth.",
        "distribution": [
            {"@type": "cr:FileObject", "@id": file, "name": file, "contentUrl": file,
             "encodingFormat": "text/csv" if file in tables or file.endswith(".csv")
             else "text/plain",
             "sha256": hashlib.sha256(text.encode()).hexdigest()} for file, text in files.items()],
        "recordSet": record_sets}


def _record_sets(bench_set: BenchSet) -> Iterator[dict[str, Any]]:
    """Yield the JSON-LD record sets of a set's points and, where it has some, of its lines."""
    name, crs = bench_set.name, bench_set.features.crs
    yield _record_set(f"{name}/points", f"{name}.csv", POINT_COLUMNS,
                      f"Points of the set {name} of the kind {bench_set.kind}, in {crs}.")
    if len(bench_set.features.lines):
        columns = {column: POINT_COLUMNS[column.rstrip("12")] for column in LINE_COLUMNS}
        columns["id"] = ("sc:Text", "name of the line")
        yield _record_set(f"{name}/lines", f"{name}-lines.csv", columns,
                          f"Straight lines of the set {name}, each by two points of it in the "
                          f"image and two on the ground, which need not be the same, in {crs}.")


def _record_set(name: str, file: str, columns: Mapping[str, tuple[str, str]],
                description: str) -> dict[str, Any]:
    """Return the JSON-LD record set of a table; `columns` has the type and meaning of each."""
    fields = [{"@type": "cr:Field", "@id": f"{name}/{column}", "name": column,
               "description": meaning, "dataType": kind,
               "source": {"fileObject": {"@id": file}, "extract": {"column": column}}}
              for column, (kind, meaning) in columns.items()]
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "description": description,
            "field": fields}


def freeze(folder: Path) -> None:
    """Simulate all sets, and write their description and the means of their columns into a folder.

    Other machines simulate the same but for rounding, which the means show.
    """
    sets = [simulate_set(name) for name in SETS]
    write_text(folder / METADATA, json.dumps(croissant_description(sets), indent=1) + "\n")
    means: dict[str, list[float]] = {}
    for bench_set in sets:
        means |= {file: means_of(text)[0] for file, text in bench_set.files().items()}
    write_text(folder / MEANS, json.dumps(means, indent=0) + "\n")


if __name__ == "__main__":
    freeze(Path(str(termsel_bench.__file__)).parent)
