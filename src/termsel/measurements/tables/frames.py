"""Tables of features for pandas and geopandas, which are optional."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel.display import Glance
from termsel.errors import TermselError
from termsel.measurements.coordinates.crs import horizontal
from termsel.measurements.tables.attributes import Attributes


def frame(columns: Mapping[str, Any]) -> Any:
    """Return columns as a pandas DataFrame; raises TermselError if that is not installed."""
    try:
        from pandas import DataFrame
    except ImportError:
        raise TermselError("tables require pandas, which is not installed",
                           hint="Install it: pip install pandas.") from None
    return DataFrame(dict(columns))


def geo_frame(columns: Mapping[str, Any], places: NDArray[np.float64], crs: str) -> Any:
    """Return columns as a geopandas GeoDataFrame; raises TermselError if that is not installed.

    `places` are points (n, 3), or the two ends of lines (n, 2, 3); heights may be NaN.
    """
    try:
        import shapely
        from geopandas import GeoDataFrame
    except ImportError:
        raise TermselError("maps of features require geopandas, which is not installed",
                           hint="Install it: pip install geopandas.") from None
    flat = bool(np.isnan(places[..., 2]).any())
    at = places[..., :2] if flat else places
    shapes = shapely.points(at) if places.ndim == 2 else shapely.linestrings(at)
    return GeoDataFrame(dict(columns), geometry=shapes, crs=horizontal(crs) or None)


class Tabular(Glance):
    """Base of features that are tables: subclasses have `ground` and return columns."""

    ground: NDArray[np.float64]
    attributes: Attributes

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "attributes": dict(self.attributes)}  # a read-only view has no pickle

    def __setstate__(self, state: dict[str, Any]) -> None:
        columns = state["attributes"]
        for value in (*state.values(), *columns.values()):
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        vars(self).update(state, attributes=MappingProxyType(columns))

    def _columns(self) -> Mapping[str, Any]:
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame with the columns of a file of these features.

        Raises
        ------
        TermselError
            If pandas is not installed.
        """
        return frame(self._columns())

    def to_geopandas(self, crs: str = "local") -> Any:
        """Return a geopandas GeoDataFrame of these features on the ground.

        Parameters
        ----------
        crs : str
            As of the feature set.

        Raises
        ------
        TermselError
            If geopandas is not installed.
        """
        return geo_frame(self._columns(), self.ground, crs)
