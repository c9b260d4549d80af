"""Features from whatever holds them, for the verbs of Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from termsel.errors import TermselError
from termsel.formats.base import read_once
from termsel.io.read import read, read_features, readers_of
from termsel.measurements.features import FeatureSet
from termsel.measurements.tables.columns import columns_text


def features_of(given: Any, crs: str | None = None,
                columns: str | Mapping[str, Any] | None = None) -> FeatureSet:
    """Return features from whatever holds them.

    Parameters
    ----------
    given : FeatureSet, path-like or table
        Features, the name of a file of points or lines, or a table as `read` takes it.
    crs, columns
        As for `read`; not for a FeatureSet.

    Raises
    ------
    TermselError
        As `read`; if a FeatureSet is given with a CRS or columns.
    """
    if isinstance(given, FeatureSet):
        if crs is not None or columns is not None:
            raise TermselError(f"the features have the CRS {given.crs} already",
                               hint="Give crs and columns with a file or a table alone.")
        return given
    if not isinstance(given, str | Path):
        return read(given, crs=crs, columns=columns)
    with read_once(Path(given)) as path:
        return read_features(
            path, path, crs=crs, either=True,
            options={"columns": columns_text(columns)} if columns else {},
            readers=readers_of([path], ()))
