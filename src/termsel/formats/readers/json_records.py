"""Points as a list of records in JSON, such as the control points of MapWarper's interface.

The list is the file itself, or the longest list of objects in it; values may be one level deeper,
in ``attributes`` as JSON:API has them. Names are as those of columns of tables.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.tables.columns import parse_columns
from termsel.formats.base import IMAGE_NAME, error_in_file, parse_json, read_text
from termsel.formats.readers.cells import Cells, count_meanings, rows_of_records
from termsel.formats.readers.csv_tables import PointsCsv, parts_of
from termsel.formats.readers.tables import COLUMNS, Table, table_of

_FLAT_OBJECT = re.compile(r"\{[^{}]*\}")
_OF_OTHER_READERS = ('"Feature', '"gcpList"', '"Annotation')
_FEWEST_NAMES = 3
_HINT = "Give a list of objects, each with id, line, sample, x and y."


class PointsJson(PointsCsv):
    """Points as a list of objects in JSON, with names as of the columns of a table."""

    name = "points-json"
    summary = "points as a list of JSON objects with line, sample, x, y; also of MapWarper"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_NAME, *COLUMNS[:2])

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for JSON with an object that names three numbers of a point."""
        text = head.decode("utf-8-sig", "replace").lstrip()
        if text[:1] not in ("{", "[") or any(name in text for name in _OF_OTHER_READERS):
            return False
        # `head` may end within the file, so that only an object in it is parsed.
        first = _FLAT_OBJECT.search(text)
        try:
            record = json.loads(first[0]) if first else {}
        except ValueError:
            return False
        stated = parse_columns(self.options.get("columns", ""))
        return count_meanings(list(record), self.aliases, stated) >= _FEWEST_NAMES

    def table(self, path: Path) -> Table:
        """Return the values of the objects by their meaning."""
        stated = parse_columns(self.options.get("columns", ""))
        return table_of(path, self._object_cells(path), self.aliases, stated,
                        self.options.get("decimal"), flat=True)

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the images of the list, where it has several, each of which is a part."""
        header, *rows = self._object_cells(path).rows
        return parts_of(header, rows)

    def _object_cells(self, path: Path) -> Cells:
        """Return the objects of the longest list as rows below their names.

        Raises TermselError for what is no JSON, and for JSON without a list of objects.
        """
        try:
            tree = parse_json(read_text(path), _HINT)
        except TermselError as error:
            raise error_in_file(error, path) from error
        records = max(_lists_of_objects(tree), key=len, default=[])
        if not records:
            raise TermselError("this JSON has no list of objects", file=path, hint=_HINT)
        return rows_of_records([_with_own_attributes(record) for record in records], "object", {})


def _lists_of_objects(tree: object) -> Iterator[list[Mapping[str, Any]]]:
    """Yield the lists of objects in JSON, at the top or in the objects there."""
    values = tree.values() if isinstance(tree, dict) else [tree]
    for value in values:
        if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            yield value


def _with_own_attributes(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return an object whose "attributes" are keys of its own; others stay as they are."""
    attributes = record.get("attributes")
    return {**record, **attributes} if isinstance(attributes, dict) else dict(record)
