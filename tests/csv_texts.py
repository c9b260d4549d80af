"""Texts of tables of points and lines, and their readers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from termsel.data.features import FeatureSet
from termsel.formats.base import Reader
from termsel.formats.readers.csv_tables import (
    LinesCsv,
    PointsCsv,
)
from termsel.io.read import find_reader

READERS: list[type[Reader]] = [PointsCsv, LinesCsv]
POINTS = "id,role,line,sample,x,y,z\n"
LINES = "id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2\n"
A = "a,control,1.5,2.5,5.25,44.5,300\n"
L = "l,1,2,3,4,5,44,10,5.1,44.1,20\n"


def put(folder: Path, text: str | bytes, name: str = "data.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read_file(path: Path, readers: Iterable[type[Reader]], format: str | None = None,
              options: Mapping[str, Any] | None = None) -> FeatureSet:
    """Return the features of a file by the reader that recognises it."""
    return find_reader(path, readers, format, options).read(path)
