"""A study that was run: its cells, its rows, and what is said about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from termsel.errors import TermselError
from termsel.studies.spec import Spec
from termsel.studies.table import Row, columns_of, rows_of

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Study:
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
    """

    spec: Spec
    cells: Mapping[str, Mapping[str, Any]]
    records: Mapping[str, Mapping[str, Any]]
    folder: Path | None

    @property
    def complete(self) -> bool:
        """Whether every cell is finished."""
        return len(self.records) == len(self.cells)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of `rows`."""
        return columns_of(self.spec.strategies)

    @cached_property
    def rows(self) -> list[Row]:
        """One row a cell; of the strategy auto alone the worst first."""
        return rows_of(self.cells, self.records, self.spec.strategies)

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a table of pandas.

        Raises
        ------
        TermselError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise TermselError("pandas is not installed", hint="Run: pip install "
                               '"termsel[studies]".') from error
        return pd.DataFrame(self.rows, columns=list(self.columns))
