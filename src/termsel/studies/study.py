"""A study that was run: its cells, its rows, and what is said about them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from termsel.core.display import Glance
from termsel.core.errors import count_in_words, require_import
from termsel.core.isolation.parts import value_of_slot
from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.table import Row, batch_of_records, columns_of, rows_of
from termsel.studies.plan.spec import Spec

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd


class Rows(list[Row]):
    """Rows of a study as a table: `to_pandas` gives a DataFrame."""

    def __init__(self, rows: Iterable[Row], columns: tuple[str, ...]) -> None:
        super().__init__(rows)
        self.columns = columns

    def __repr__(self) -> str:
        return f"<Rows: {len(self)} of {len(self.columns)} columns>"

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a table of pandas.

        Raises
        ------
        TermselError
            If pandas is not installed.
        """
        with require_import("tables require", "pandas", '"termsel[studies]"'):
            import pandas as pd
        return pd.DataFrame(list(self), columns=list(self.columns))


@dataclass(frozen=True, eq=False, repr=False)
class Study(Glance):
    """Cells and what came of them.

    Parameters
    ----------
    spec : Spec
        What was asked for.
    cells : mapping
        What tables call the problem, data, split, strategy, model, criterion, solver and seed of
        every cell, by its key, in the order of the tables.
    records : mapping
        Of the finished cells, by their key.
    folder : path or None
        Where journal and tables are.

    Examples
    --------
    >>> import termsel
    >>> study = termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=2,
    ...                         budget={"evaluations": 50})
    >>> len(study.records)
    2
    """

    spec: Spec
    cells: Mapping[str, Mapping[str, Any]]
    records: Mapping[str, CellRecord]
    folder: Path | None

    @property
    def complete(self) -> bool:
        """Whether every cell is finished."""
        return len(self.records) == len(self.cells)

    @property
    def noun(self) -> str:
        """The word for a row: an image of a batch, or a run of a study of searches."""
        return "image" if self.spec.strategies == ("auto",) else "run"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of `rows`."""
        return columns_of(self.spec.strategies, self.spec.measures)

    @cached_property
    def rows(self) -> Rows:
        """One row a cell; of the strategy auto alone the worst first."""
        return Rows(rows_of(self.cells, self.records, self.spec.strategies,
                            self.spec.measures, self.spec.accept), self.columns)

    @property
    def failures(self) -> int:
        """Number of images of the strategy auto that have no result."""
        return sum(row["strategy"] == "auto" and row["state"] == "failed" for row in self.rows)

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on images that lie elsewhere than most, or are mirrored unlike most."""
        return batch_of_records(self.cells, self.records).sentences

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a table of pandas (see `Rows.to_pandas`)."""
        return self.rows.to_pandas()

    def to_geopandas(self) -> gpd.GeoDataFrame:
        """Return the images as a map of geopandas: their rows, with the outline of the control.

        Only images of the strategy auto that have a result are on it, in longitude and latitude.
        Images without a CRS are on it only where no image has one.

        Raises
        ------
        TermselError
            If geopandas or termsel-studies is not installed, or the study has no folder.
        """
        return value_of_slot("study-map", "maps of studies require")(self)

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        """Return a title and the rows, by their heads, by which a study shows itself."""
        spec = self.spec
        kinds = {"problems": spec.problems, "models": spec.models, "criteria": spec.criteria,
                 "solvers": spec.solvers}
        named = {}
        for kind, components in kinds.items():
            if components:
                named[kind] = ", ".join(component.label for component in components)
        # Each data set once, in the order of the cells.
        data = list(dict.fromkeys(str(cell["data"]) for cell in self.cells.values()))
        states = Counter(row["state"] for row in self.rows)
        return f"Study of {count_in_words(len(self.cells), 'run')}: {spec.title or 'no title'}", {
            "state": ", ".join(f"{n} {state}" for state, n in states.items()) or "empty",
            "data": f"{len(data)}: {', '.join(data)}", **named,
            "strategies": ", ".join(spec.strategies),
            **({"folder": str(self.folder)} if self.folder else {}),
            "see": "rows.to_pandas(), to_geopandas()"}
