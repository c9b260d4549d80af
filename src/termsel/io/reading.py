"""Files of ground control features, read by whatever reader is installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from termsel.features import FeatureSet
from termsel.io.base import read_features
from termsel.plugins.manager import registry


def read(
    points: Path | str | None = None,
    lines: Path | str | None = None,
    *,
    areas: Path | str | None = None,
    crs: str | None = None,
    format: str | Sequence[str] = (),
    dem: Path | str | None = None,
    **options: Any,
) -> FeatureSet:
    """Return the control features of files of points, of lines and of areas.

    Parameters
    ----------
    points, lines, areas : path-like, optional
        At least one of them. Areas become lines or, with ``areas_as="centroid"``, points.
    crs : str, optional
        CRS of the ground coordinates, where no file declares it: "EPSG:n", WKT, or "local".
    format : str or sequence of str, optional
        Names of readers, in the order of the files, instead of judging by the content.
    dem : path-like, optional
        Raster of heights, from which unknown ones are taken; see
        `termsel.io.heights.with_heights`.
    **options
        Options of the readers, such as `raster` of "qgis-points".

    Returns
    -------
    FeatureSet

    Raises
    ------
    TermselError
        Naming file, line and column, for anything the user can mend.
    """
    paths = [None if path is None else Path(path) for path in (points, lines, areas)]
    features = read_features(
        *paths[:2], areas=paths[2], crs=crs,
        readers=[entry.object for entry in registry().entries("readers")],
        formats=[format] if isinstance(format, str) else format,
        options={key: value for key, value in options.items() if value is not None})
    if dem is None:
        return features
    from termsel.io.heights import with_heights

    return with_heights(features, Path(dem))
