"""What is measured on the page: points and lines, as plain records, and changes of them.

A change is a list of patches, each the record of a feature before and after it; so every change can
be undone, written to a journal, and repeated from there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from termsel import FeatureSet, Lines, Points, TermselError

ROLES = ("", "control", "check", "independent", "off")
"""Roles that the page offers; "" lets termsel assign one."""
MAX_FEATURES = 20_000
"""Features that a session may have."""
COORDINATE_LIMIT = 1e300
"""Coordinates are smaller than this: JSON has integers that are too large for a float."""

Record = dict[str, Any]
"""A feature: id, kind ("point" or "line"), role, and image and ground, either of which may still be
missing. Of a point these are [line, sample] and [x, y, z]; of a line two of each. z is None where
it is not known."""


@dataclass(frozen=True)
class Patch:
    """A feature before a change and after it; None where it is not there."""

    before: Record | None
    after: Record | None

    def inverse(self) -> Patch:
        """Return the patch that takes this one back: before and after exchanged."""
        return Patch(self.after, self.before)


@dataclass
class ControlFeatures:
    """All features of a session by id, in the order in which they were begun, and their changes.

    `done` has the changes that can be undone, `undone` those that can be done again.
    """

    undone: list[tuple[Patch, ...]] = field(default_factory=list)
    done: list[tuple[Patch, ...]] = field(default_factory=list)
    _records: dict[str, Record] = field(default_factory=dict)
    _ranks: dict[str, int] = field(default_factory=dict)
    _last_rank: int = 0
    _in_order: bool = True

    @property
    def records(self) -> dict[str, Record]:
        """All features by id, in the order in which they were begun; a renamed one keeps its rank.
        """
        if not self._in_order:
            # Sorting at every change would be slow: a journal may have many thousands of them.
            self._records = dict(sorted(self._records.items(),
                                        key=lambda item: self._ranks[item[0]]))
            self._in_order = True
        return self._records

    def __len__(self) -> int:
        """Return the number of features."""
        return len(self._records)

    def apply(self, patches: Iterable[Patch]) -> None:
        """Change the records by patches, which are undone together; nothing can be redone then."""
        patches = tuple(patches)
        self._apply_patches(patches)
        self.done.append(patches)
        self.undone.clear()

    def undo(self) -> tuple[Patch, ...]:
        """Take back the last change and return its patches; raises TermselError if there is none.
        """
        if not self.done:
            raise TermselError("there is nothing to undo")
        patches = self.done.pop()
        self._apply_patches([patch.inverse() for patch in reversed(patches)])
        self.undone.append(patches)
        return patches

    def redo(self) -> tuple[Patch, ...]:
        """Repeat the change that was undone last, and return its patches.

        Raises TermselError if there is none, as after a new change.
        """
        if not self.undone:
            raise TermselError("there is nothing to do again")
        patches = self.undone.pop()
        self._apply_patches(patches)
        self.done.append(patches)
        return patches

    def _apply_patches(self, patches: Iterable[Patch]) -> None:
        """Change the records by patches, in their order; `done` and `undone` stay as they are."""
        for patch in patches:
            # A patch without `after` deletes a feature, one without `before` adds one.
            before = None if patch.before is None else patch.before["id"]
            after = None if patch.after is None else patch.after["id"]
            # A feature that gets another name keeps its rank among the others.
            if before is not None and before != after:
                self._records.pop(before, None)
                rank = self._ranks.pop(before, self._last_rank)
                if after is not None:
                    self._ranks[after] = rank
                    self._in_order = False
            if after is not None and patch.after is not None:
                self._last_rank += 1
                self._ranks.setdefault(after, self._last_rank)
                self._records[after] = patch.after

    def new_id(self, kind: str) -> str:
        """Return an id that no feature has: the next after the largest in use, from P01 or L01 on.

        Ids that are no such letter and number do not count.
        """
        letter = "P" if kind == "point" else "L"
        numbers = [int(match[1]) for name in self.records
                   if (match := re.fullmatch(rf"{letter}(\d{{1,9}})", name))]
        return f"{letter}{max(numbers, default=0) + 1:02d}"

    def complete(self, kind: str) -> list[Record]:
        """Return the features of a kind, "point" or "line", with a place in image and ground each.

        A line may have but one of its two ends there; see `is_whole`.
        """
        return [record for record in self.records.values()
                if record["kind"] == kind and record["image"] and record["ground"]]

    def features(self, crs: str) -> FeatureSet:
        """Return the complete features as termsel takes them.

        They are the points with both places, of any role, and the lines with both ends in both
        spaces, unless they are off. Raises TermselError for what cannot be control, such as two
        points at one place.
        """
        points = self.complete("point")
        lines = [record for record in self.complete("line")
                 if record["role"] != "off" and is_whole(record)]
        # Heights that are None become NaN, which numpy needs to have one array of all vertices.
        vertices: list[Any] = []
        for record in lines:
            vertices += record["ground"]
        point_ground = _ground_array(record["ground"] for record in points)
        return FeatureSet(
            points=Points(tuple(record["id"] for record in points),
                          np.array([record["image"] for record in points]).reshape(-1, 2),
                          point_ground.reshape(-1, 3), None,
                          tuple(record["role"] for record in points)),
            lines=Lines(tuple(record["id"] for record in lines),
                        np.array([record["image"] for record in lines]).reshape(-1, 2, 2),
                        _ground_array(vertices).reshape(-1, 2, 3)),
            crs=crs)


def is_whole(record: Record) -> bool:
    """Return whether a line has both its ends in the image and both on the ground."""
    return all(record[space] and len(record[space]) == 2 for space in ("image", "ground"))


def _ground_array(positions: Iterable[Any]) -> Any:
    """Return ground coordinates (n, 3) of x, y, z; heights that are None become NaN."""
    return np.array([[x, y, np.nan if z is None else z] for x, y, z in positions], dtype=np.float64)


def checked_record(record: Mapping[str, Any]) -> Record:
    """Return a record that came from a page or a file, checked, without its other keys.

    It has id, kind, role, image and ground. Blanks around the id are dropped; a missing role is "",
    and a missing place None. Raises TermselError if it is no point or line, or if its id, role or
    coordinates are not valid.
    """
    kind = record.get("kind")
    if kind not in ("point", "line"):
        raise TermselError(f"{kind!r} is no kind of feature", hint="Kinds are point and line.")
    name = record.get("id")
    if not isinstance(name, str) or not name.strip() or len(name) > 200 or not name.isprintable():
        raise TermselError("this is no name of a feature",
                           hint="Give 1 to 200 printable characters.")
    role = record.get("role", "")
    if role not in ROLES:
        raise TermselError(f"{role!r} is no role", hint=f"Roles are {', '.join(ROLES[1:])}, or "
                                                        "none.")
    if kind == "line" and role not in ("", "control", "off"):
        raise TermselError("a line is always control", hint="Choose control or off.")
    count = None if kind == "point" else 2
    return {"id": name.strip(), "kind": kind, "role": role,
            "image": _checked_places(record.get("image"), 2, count),
            "ground": _checked_places(record.get("ground"), 3, count)}


def _checked_places(value: Any, size: int, count: int | None) -> Any:
    """Return the checked place of a point, or the list of checked places of a line.

    For a point `count` is None; a line has at most `count` places. A place has `size` coordinates.
    None if there is no place. Raises TermselError for another shape or wrong coordinates.
    """
    if value is None or value == []:
        return None
    if count is None:
        return _checked_place(value, size)
    if not isinstance(value, list) or len(value) > count:
        raise TermselError("a line has two ends")
    return [_checked_place(position, size) for position in value]


def _checked_place(value: Any, size: int) -> list[float | None]:
    """Return a place of `size` finite coordinates; the third, a height, may be None.

    Raises TermselError for other lengths and values.
    """
    if not isinstance(value, list) or len(value) != size:
        raise TermselError(f"a position has {size} coordinates")
    if size == 3 and value[2] is None:
        return [*(_checked_coordinate(number) for number in value[:2]), None]
    return [_checked_coordinate(number) for number in value]


def _checked_coordinate(value: Any) -> float:
    """Return a coordinate; raise TermselError if it is no number below `COORDINATE_LIMIT`."""
    if (isinstance(value, bool) or not isinstance(value, int | float)
            or not abs(value) < COORDINATE_LIMIT):
        raise TermselError(f"{value!r:.40} is no coordinate", hint="Give finite numbers.")
    return float(value)
