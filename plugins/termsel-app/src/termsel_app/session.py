"""A session: its files, the control measured so far, what termsel says of it, and who is told."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import count, zip_longest
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.toolkit import make_folder, require_inside
from termsel.toolkit.coordinates import LOCAL, horizontal_crs, normalise
from termsel_app.control import (
    COORDINATE_LIMIT,
    MAX_FEATURES,
    ControlFeatures,
    Patch,
    Record,
    checked_record,
)
from termsel_app.iiif import IiifImage, fetch_image, is_iiif
from termsel_app.journal import Journal, entry_of, open_journal
from termsel_app.maps import TABLE_AS_LAYER, Box, Maps, box_around, box_of, open_maps
from termsel_app.pasting import read_pasted
from termsel_app.places import Places, shown_crs
from termsel_app.prediction import Prediction, prediction_of
from termsel_app.quality import Answer, Question
from termsel_app.rasters import Raster
from termsel_app.worker import Worker

MOST_PASTED = 2**20
"""Characters that may be pasted."""

Place = list[Any]
"""x, y and z on the ground; z is None where it is not known."""

_SAME_HEIGHT = 0.005
"""Heights that differ by no more [m] are the same in a table of two decimals."""

LONGEST_NAME = 4096
FILE_KEYS = ("image", "points", "lines", "rpc", "dem")
"""Fields of `Files` that are the name of a file each."""


def is_name(value: object) -> bool:
    """Return whether a value from a file can be the name of one: printable text, not too long."""
    return isinstance(value, str) and value.isprintable() and len(value) < LONGEST_NAME


def from_folder(name: str, folder: Path) -> str:
    """Return the name of a file relative to a folder, as a command that runs there gives it.

    Addresses stay; so does a path on another drive of Windows, made absolute.
    """
    if name.startswith("/vsi") or "://" in name:
        return name
    # Relative names let a folder move together with its files. Between drives of Windows there are
    # none.
    try:
        relative = os.path.relpath(Path(name).absolute(), folder.absolute())
    except ValueError:
        return str(Path(name).absolute())
    # A command would take a name that begins with a hyphen for an option.
    return os.path.join(os.curdir, relative) if relative.startswith("-") else relative


def from_here(name: str, folder: Path) -> str:
    """Return the name of a file, given relative to a folder, as seen from the current folder.

    Addresses stay as they are.
    """
    if name.startswith("/vsi") or "://" in name:
        return name
    return os.path.normpath(folder / name)


@dataclass(frozen=True)
class Files:
    """What a session was started with, as the first line of its journal keeps it."""

    image: str | None
    maps: tuple[str, ...] = ()
    points: str | None = None
    lines: str | None = None
    rpc: str | None = None
    dem: str | None = None
    crs: str | None = None
    size: tuple[int, int] | None = None

    def header(self, folder: Path) -> dict[str, Any]:
        """Return the files as the first line of a journal, with names relative to its folder.

        So the folder may move together with the files, and be opened from anywhere.
        """
        names = {key: None if (name := getattr(self, key)) is None else from_folder(name, folder)
                 for key in FILE_KEYS}
        return {**asdict(self), **names,
                "maps": [from_folder(name, folder) for name in self.maps]}

    @classmethod
    def of_header(cls, header: Mapping[str, Any], folder: Path) -> Files:
        """Return the files that the first line of a journal names, which lies in a folder.

        Maps on servers are left out: only the command line may ask a server for anything. Raises
        TermselError for values that are no names, and for a size that is none.
        """
        maps = header.get("maps") or []
        # The journal may come from anybody, so every value is checked.
        if not isinstance(maps, list) or not all(is_name(name) for name in maps):
            raise TermselError("the maps of this session are no list of files")
        texts = {key: header.get(key) for key in ("image", "points", "lines", "rpc", "dem", "crs")}
        for key, value in texts.items():
            if value is not None and not is_name(value):
                raise TermselError(f"{key} of this session is no name",
                                   hint="Begin a new session, or restore the file.")
        size = header.get("size")
        if size is not None and not (isinstance(size, list) and len(size) == 2
                                     and all(type(n) is int and 0 < n < 2**31 for n in size)):
            raise TermselError("the size of the image of this session is no pair of numbers")
        # Servers of tiles are given anew each time: a journal must not send requests.
        local = tuple(from_here(name, folder) for name in maps
                      if "://" not in name and not name.startswith("/vsi"))
        texts.update({key: from_here(str(texts[key]), folder) for key in FILE_KEYS
                      if texts[key] is not None})
        return cls(**texts, maps=local, size=None if size is None else (size[0], size[1]))


@dataclass
class Session:
    """All that the page shows and changes. Its methods may be called by any thread."""

    files: Files
    folder: Path
    journal: Journal
    control: ControlFeatures
    image: Raster | None
    maps: Maps
    places: Places
    notes: list[str]
    served: IiifImage | None = None
    version: int = 0
    asked: int = -1
    judged: list[Record] | None = None
    answers: dict[str, Answer] = field(default_factory=dict)
    prediction: Prediction | None = None
    tell: Callable[[dict[str, Any]], None] = lambda _: None
    lock: RLock = field(default_factory=RLock)
    worker: Worker | None = None
    result_made_from: tuple[object, ...] = ()
    """Command, control and state of files of the result folder that this session wrote last."""

    @property
    def size(self) -> tuple[int, int] | None:
        """Lines and samples of the image; None if neither an image nor an option states them."""
        return self.files.size if self.image is None else (self.image.height, self.image.width)

    def box(self) -> Box:
        """Return the extent (x min, y min, x max, y max) of map and control, with a margin.

        Without map and control it is that of the image by the model, or else a square of 1000
        units.
        """
        boxes = []
        if self.maps.box is not None:
            boxes.append(self.maps.box)
        positions: list[Any] = []
        for record in self.control.records.values():
            positions += _ground_places(record)
        if positions:
            boxes.append(box_of(self.places.to_map(positions)))
        # Without maps and control, an RPC may show where the image is.
        if not boxes and self.prediction is not None and self.size is not None:
            lines, samples = self.size
            boxes.append(box_of(self.prediction.to_map(
                [[0, 0], [0, samples], [lines, 0], [lines, samples]])))
        box = box_around(boxes) if boxes else (0.0, 0.0, 1000.0, 1000.0)
        extent = max(box[2] - box[0], box[3] - box[1]) or 1000.0
        # A margin leaves room to measure beyond the control. A map alone needs none.
        margin = 0.0 if self.maps.box is not None and len(boxes) == 1 else extent * 0.1
        return (box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin)

    # Changes

    def change(self, patches: list[Patch]) -> None:
        """Write a change to the journal, make it, notify the pages, and have the control judged.

        Raises TermselError, without a change, if a name is taken or the journal cannot be written.
        """
        with self.lock:
            self._require_new(patches)
            # The journal comes first, so that the page shows nothing that could be lost.
            self.journal.append(entry_of(patches))
            self.control.apply(patches)
            self._note_change()

    def _require_new(self, patches: list[Patch]) -> None:
        """Raise TermselError for changes that give a feature the name of another, or add too many.
        """
        for patch in patches:
            name = None if patch.after is None else patch.after["id"]
            before = None if patch.before is None else patch.before["id"]
            # A feature may keep its own name.
            if name is not None and name != before and name in self.control.records:
                raise TermselError(f"there is a feature {name!r} already",
                                   hint="Choose another name.", ids=[name])
        added = sum((patch.before is None) - (patch.after is None) for patch in patches)
        if added > 0 and len(self.control.records) + added > MAX_FEATURES:
            raise TermselError(f"a session has at most {MAX_FEATURES:,} features",
                               hint="Give so many as a table: termsel run --points FILE.")

    def undo(self) -> None:
        """Take back the last change; raises TermselError if there is none."""
        with self.lock:
            # The control comes first, as only it knows whether there is something to undo.
            self.control.undo()
            self._append_or_revert(self.control.redo, {"undo": True})
            self._note_change()

    def redo(self) -> None:
        """Repeat the change that was undone last; raises TermselError if there is none."""
        with self.lock:
            self.control.redo()
            self._append_or_revert(self.control.undo, {"redo": True})
            self._note_change()

    def _append_or_revert(self, revert: Callable[[], Any], entry: dict[str, Any]) -> None:
        """Append an entry to the journal; if that fails, call `revert` and raise the TermselError.
        """
        try:
            self.journal.append(entry)
        except TermselError:
            revert()
            raise

    def _note_change(self) -> None:
        """Count the change, have the control judged, and notify the pages."""
        self.version += 1
        self.judge()
        self.tell({"kind": "control", **self.state()})

    def judge(self) -> None:
        """Have the control judged, unless it is what was judged last.

        Features that are measured in one pane alone do not count.
        """
        with self.lock:
            complete = self.control.complete("point") + self.control.complete("line")
            if self.worker is None or complete == self.judged:
                return
            self.judged = complete
            # `keep_answer` passes over answers to other versions.
            self.asked = self.version
            try:
                features = self.control.features(self.places.crs)
            except TermselError as error:
                self.keep_answer({
                    "serial": self.version, "stage": "refused", "text": f"{error.what}.",
                    "hint": error.hint or "", "ids": list(error.ids)})
                return
            self.worker.ask(Question(
                self.version, features, self.size,
                None if self.files.rpc is None else Path(self.files.rpc),
                None if self.files.dem is None else Path(self.files.dem)))

    def keep_answer(self, answer: Answer) -> None:
        """Keep an answer of the worker in place of earlier ones, and notify the pages.

        `answer` is changed: its `result` is taken out, and its next points get their place on the
        `map`. An answer to any question but the last is passed over.
        """
        with self.lock:
            # Answers to earlier questions are of points that have moved since; -1 is a failure of
            # the worker itself, which belongs to no question.
            if answer["serial"] not in (self.asked, -1):
                return
            # The result has models and arrays, which pages cannot get.
            result = answer.pop("result", None)
            if result is not None:
                self.prediction = prediction_of(
                    result, self.control.features(self.places.crs), self.places)
            for next_point in answer.get("next", ()):
                next_point["map"] = self.places.to_map([next_point["ground"][:2]])[0].tolist()
            # Answers to an earlier question are out of date once the first stage of this one comes.
            if answer["stage"] in ("figures", "waiting", "refused"):
                self.answers.clear()
            self.answers[answer["stage"]] = answer
            self.tell({"kind": "answer", **answer})

    def state(self) -> dict[str, Any]:
        """Return the control as the page shows it: records, version, and how much can be undone."""
        with self.lock:
            return {"version": self.version, "asked": self.asked,
                    "records": [self._record_on_map(record)
                                for record in self.control.records.values()],
                    "undo": len(self.control.done), "redo": len(self.control.undone)}

    def _record_on_map(self, record: Record) -> Record:
        """Return a record with its ground places on the map as `map`; None if it has none."""
        positions = _ground_places(record)
        on_map = self.places.to_map(positions).tolist() if positions else None
        if record["kind"] == "point" and on_map:
            on_map = on_map[0]
        return {**record, "map": on_map}

    # What a page asks for

    def ground_of(self, xy: Any) -> list[list[float | None]]:
        """Return ground coordinates x, y, z of places on the map (n, 2); z is None if not known.

        Raises TermselError if one has no coordinates, as outside the area of a projection.
        """
        ground = self.places.to_ground(xy)
        if not np.isfinite(ground[:, :2]).all():
            raise TermselError(f"{self.places.crs} has no coordinates for this position",
                               hint="Choose a position within the area of this CRS, or start "
                                    "again with another --crs.")
        return [[x, y, None if z != z else z] for x, y, z in ground.tolist()]

    def put(self, values: Mapping[str, Any]) -> str:
        """Add or change a feature; return its id.

        `values` has the "id" of a feature, or the "kind" of a new one, by default a point, which
        gets an id; and what to set: "image", "map" or "ground", "role", and "name" for another id.
        A place on the map keeps a height that was given, and else gets that of the DEM, as a point
        does whose "ground" has none. A change is saved, can be undone and has all judged again.
        Raises TermselError if there is no such feature, a value is not valid, or the place is
        outside the image.
        """
        with self.lock:
            name = values.get("id")
            # Another page that shows this session may have deleted the feature.
            before = self.control.records.get(name) if isinstance(name, str) else None
            if before is None and name is not None:
                raise TermselError(f"there is no feature {name!r} any more", ids=[str(name)])
            after: Record
            if before is None:
                kind = values.get("kind", "point")
                after = {"id": self.control.new_id(kind), "kind": kind, "role": "",
                         "image": None, "ground": None}
            else:
                kind = before["kind"]
                after = dict(before)
            after.update({key: values[key] for key in ("image", "ground", "role") if key in values})
            if values.get("map") is not None:
                positions = values["map"] if kind == "line" else [values["map"]]
                moved = self.ground_of(check_place_pairs(positions))
                ground = self._with_given_heights(_places_of(after), moved)
                after["ground"] = ground if kind == "line" else ground[0]
            if "name" in values:
                after["id"] = values["name"]
            after = checked_record(after)
            if "image" in values:
                self._require_in_image(after)
            if (after.get("ground") and kind == "point" and after["ground"][2] is None
                    and values.get("ground") is not None):
                after["ground"] = self._with_height(after["ground"])
            # A click that changes nothing must not become a step to undo.
            if after != before:
                self.change([Patch(before, after)])
            return str(after["id"])

    def _require_in_image(self, record: Record) -> None:
        """Raise TermselError for a feature that is measured outside the image.

        Nothing is refused if the feature has no image position, or the size of the image is not
        known.
        """
        places = np.array(record["image"] or [], dtype=np.float64).reshape(-1, 2)
        # Ground positions of any kind make points of them, as `require_inside` takes features.
        points = Points(tuple(f"{i}" for i in range(len(places))), places,
                        np.column_stack([np.arange(len(places)), np.zeros((len(places), 2))]))
        try:
            require_inside(FeatureSet(points, crs=LOCAL), self.size, None)
        except TermselError as error:
            lines, samples = self.size or (0, 0)
            extent = f", which has {lines:,} lines and {samples:,} samples" if self.size else ""
            raise TermselError(f"this position is outside the image{extent}", ids=[record["id"]],
                               hint="Measure within the image.") from error

    def _with_given_heights(self, before: list[Place], after: list[Place]) -> list[Place]:
        """Return ground places `after` a move on the map, with heights that were given before it.

        A height that was that of the DEM becomes the one of the DEM at the new place. Places beyond
        those of `before` are unchanged.
        """
        return [[*place[:2], old[2]] if old is not None and self._has_given_height(old) else place
                for old, place in zip_longest(before[:len(after)], after)]

    def _has_given_height(self, place: Place) -> bool:
        """Return whether a ground place has a height, and that is not the one of the DEM."""
        if place[2] is None:
            return False
        height = self._with_height(place)[2]
        return height is None or abs(height - place[2]) > _SAME_HEIGHT

    def note_on_height(self, name: str) -> str:
        """Return a sentence if the DEM has another height at a feature; "" if none differs.

        "" too for an id that no feature has, and without a height of the DEM.
        """
        with self.lock:
            record = self.control.records.get(name)
            for place in () if record is None else _places_of(record):
                height = self._with_height(place)[2]
                if height is not None and self._has_given_height(place):
                    return (f"The height of {name} stays {place[2]:.2f}, as it was given; the DEM "
                            f"has {height:.2f} there.")
        return ""

    def _with_height(self, ground: Place) -> Place:
        """Return x, y and the height of the DEM there; None as height if the DEM has none."""
        height = self.places.heights(np.array([ground[:2]], dtype=np.float64))[0]
        return [*ground[:2], None if height != height else float(height)]

    def delete(self, names: list[str]) -> None:
        """Delete the features of these ids as one change; ids that no feature has are passed over.
        """
        with self.lock:
            records = [self.control.records[name] for name in names if name in self.control.records]
            if records:
                self.change([Patch(record, None) for record in records])

    def add(self, points_given: Any) -> int:
        """Add points as one change; return how many.

        `points_given` is a list of objects with "image" and "map". Raises TermselError if it is
        not, or a place is not valid.
        """
        if not isinstance(points_given, list) or not all(
                isinstance(point, dict) for point in points_given):
            raise TermselError("points were expected",
                               hint="Give a list of objects with line, sample, x and y.")
        with self.lock:
            patches = []
            # Ids are P01, P02 and so on, without the letter a number.
            number = int(self.control.new_id("point")[1:])
            for i, point in enumerate(points_given):
                ground = self.ground_of(check_place_pairs([point.get("map")]))[0]
                patches.append(Patch(None, checked_record({
                    "id": f"P{number + i:02d}", "kind": "point", "role": "",
                    "image": point.get("image"), "ground": ground})))
            if patches:
                self.change(patches)
        return len(patches)

    def paste(self, text: str) -> tuple[int, list[str]]:
        """Add points from a table that was pasted; return how many, and what to know of them.

        See `read_pasted`. A pasted point with the id of another point completes or replaces that.
        Raises TermselError for a text that is too long or cannot be read.
        """
        if len(text) > MOST_PASTED:
            raise TermselError(f"at most {MOST_PASTED:,} characters can be pasted")
        records, notes = read_pasted(text, self.places.crs, self.size)
        with self.lock:
            notes += self._note_on_distance(records)
            # Points without an id get one that no other row and no feature has.
            pasted = {record["id"] for record in records}
            first = int(self.control.new_id("point")[1:])
            new_ids = (name for number in count(first) if (name := f"P{number:02d}") not in pasted)
            patches = []
            for record in records:
                name = record["id"] or next(new_ids)
                before = self.control.records.get(name)
                after = self._complete_record({**record, "id": name}, before)
                patches.append(Patch(before, checked_record(after)))
            if patches:
                self.change(patches)
        return len(patches), notes

    def _complete_record(self, pasted: Record, before: Record | None) -> Record:
        """Return a point with the role and places of a pasted one, as far as that has them.

        `before` is the point so far, None for a new one. Without a height, the new ground gets that
        of the DEM, or keeps one that was given before.
        """
        after = dict(before or pasted)
        for key in ("role", "image", "ground"):
            after[key] = pasted[key] or after[key]
        if pasted["ground"] and pasted["ground"][2] is None:
            place = self._with_height(pasted["ground"])
            earlier_places = [] if before is None else _places_of(before)
            after["ground"] = self._with_given_heights(earlier_places, [place])[0]
        return after

    def _note_on_distance(self, records: list[Record]) -> list[str]:
        """Return [a note] if all points are far from the map and the other points; else [].

        [] too if there are no ground places, or nothing to compare them with. The note proposes to
        exchange x and y if that brings a point near.
        """
        ground = [record["ground"] for record in records if record["ground"]]
        if not ground or (self.maps.box is None and not self.control.complete("point")):
            return []
        box = self.box()
        turned = [[place[1], place[0]] for place in ground]
        if self._are_near(ground, box):
            return []
        remedy = "Exchange x and y" if self._are_near(turned, box) else "Check the coordinates"
        return [f"What was pasted lies far from the map and the other points. {remedy}, if that is "
                "wrong: Ctrl+Z takes it back."]

    def _are_near(self, ground: list[Place], box: Box) -> bool:
        """Return whether any of the ground places is in a box on the map, or not far outside.

        Near is within two extents of the box from its middle.
        """
        on_map = self.places.to_map(ground)
        middle = np.array([box[0] + box[2], box[1] + box[3]]) / 2.0
        extent = max(box[2] - box[0], box[3] - box[1])
        # Places that the CRS of the map does not have are infinite, and so not near.
        return bool((np.abs(on_map - middle) <= 2.0 * extent).all(axis=1).any())

    def predict(self, image: Any = None, xy: Any = None) -> dict[str, Any] | None:
        """Return where a place of the image is on the map, or one of the map (`xy`) in the image.

        See `Prediction.on_map` and `Prediction.in_image`; None as long as there is no model.
        """
        prediction = self.prediction
        if prediction is None:
            return None
        if image is not None:
            return prediction.on_map(check_place_pairs([image])[0])
        return prediction.in_image(check_place_pairs([xy])[0])


def check_place_pairs(positions: Any) -> list[list[float]]:
    """Return a list of one or two pairs of finite numbers that came from a page, as it is.

    Raises TermselError for anything else.
    """
    if not isinstance(positions, list) or not 1 <= len(positions) <= 2:
        raise TermselError("these are no positions")
    # JSON knows no infinity, but Python reads it.
    for position in positions:
        if not isinstance(position, list) or len(position) != 2 or not all(
                isinstance(value, int | float) and abs(value) < COORDINATE_LIMIT
                for value in position):
            raise TermselError("a position has two finite coordinates")
    return positions


def _places_of(record: Record) -> list[Place]:
    """Return the ground places x, y, z of a feature, up to two; [] if it has none."""
    if not record["ground"]:
        return []
    return [record["ground"]] if record["kind"] == "point" else record["ground"]


def _ground_places(record: Record) -> list[Place]:
    """Return x and y of the ground places of a feature, up to two; [] if it has none."""
    return [place[:2] for place in _places_of(record)]


def _read_features(files: Files) -> FeatureSet:
    """Return the points and lines that a session begins with.

    Raises TermselError for a list without places in the image, with what to do with it.
    """
    try:
        return termsel.read(files.points, files.lines, crs=files.crs)
    except TermselError as error:
        if error.code == "ground-alone":
            error.hint = ("The page begins with measured points. Give the list as a map, and click "
                          "each of its points there and in the image: --map FILE.gpkg. "
                          f"{TABLE_AS_LAYER}")
        raise


@contextmanager
def open_session(files: Files, folder: Path, *, remote: bool = False,
                 drivers: tuple[str, ...] = ()) -> Iterator[Session]:
    """Yield a session that is begun in a folder, or that goes on there; close it at the end.

    `remote` is whether servers may be asked; `drivers` are the further drivers of GDAL that are
    allowed. Raises TermselError for files that cannot be used, if the CRS of the ground is not
    known, and for a folder that has the session of another image or is in use.
    """
    with ExitStack() as stack:
        _make_folder(folder, stack)
        # The worker loads termsel while the files are opened here.
        worker = Worker(remote, drivers)
        stack.callback(worker.close)
        journal, header, control = stack.enter_context(open_journal(folder))
        before = None if header is None else Files.of_header(header, folder)
        _require_same(files, before, folder)
        served = None
        image = None
        # The browser itself loads the image of a IIIF server.
        if files.image is not None and is_iiif(files.image):
            served = fetch_image(files.image, remote)
            files = replace(files, size=served.size)
        elif files.image is not None:
            image = Raster(files.image, remote)
        if image is not None:
            stack.callback(image.close)
        # A session begins with features of files, and has them in its journal afterwards.
        features = None
        if before is None and (files.points or files.lines):
            features = _read_features(files)
        crs = _ground_crs(files, features, before)
        maps = open_maps(files.maps, crs, remote)
        stack.callback(maps.close)
        crs = crs or _crs_of_maps(maps)
        # Without a map the control is drawn in its own CRS, if that is plane.
        if not (maps.rasters or maps.vectors or maps.tiles):
            maps.shown = shown_crs(horizontal_crs(crs) or LOCAL)
        session_places = Places(crs, maps.shown, None if files.dem is None else Path(files.dem))
        stack.callback(session_places.close)
        # All files are open now: a session that cannot begin leaves no journal.
        if before is None:
            journal.begin(replace(files, crs=crs).header(folder))
        session = Session(replace(files, crs=crs), folder, journal, control, image, maps,
                          places=session_places, notes=list(maps.notes), served=served)
        if features is not None:
            # As a change, the features are in the journal and can be undone.
            session.change([Patch(None, record) for record in records_of(features)])
        worker.tell = session.keep_answer
        # Changes above were not judged, as the session was not complete.
        session.worker = worker
        session.judge()
        yield session


def _make_folder(folder: Path, stack: ExitStack) -> None:
    """Make a folder, which the stack removes again if it is still empty at the end."""
    if not folder.is_dir():
        make_folder(folder)
        stack.callback(_remove_empty, folder)


def _remove_empty(folder: Path) -> None:
    """Remove a folder if it is empty."""
    with suppress(OSError):
        folder.rmdir()


def _require_same(files: Files, before: Files | None, folder: Path) -> None:
    """Raise TermselError if the session in a folder is of another image than the one given."""
    # An image may be added later, or be left out.
    if before is None or files.image is None or before.image is None:
        return
    if (files.image != before.image
            and Path(files.image).absolute() != Path(before.image).absolute()):
        raise TermselError(f"the session in this folder is of another image, {before.image}",
                           file=folder, hint="Choose another --out for this image.")


def records_of(features: FeatureSet) -> list[Record]:
    """Return features as records: each point, then each piece of each line.

    A record has id, kind, role, image and ground, with None for an unknown height. Of several
    pieces with one id, the second gets the id ID.2, the third ID.3 and so on; numbers that make the
    id of another feature are passed over. Raises TermselError for what a record cannot hold (see
    `checked_record`).
    """
    points = features.points
    lines = features.lines
    records = [{"id": name, "kind": "point", "role": role, "image": image,
                "ground": _with_none(ground)}
               for name, role, image, ground in zip(points.ids, points.roles, points.image.tolist(),
                                                    points.ground.tolist(), strict=True)]
    # On the page each piece is measured by itself, so each has an id of its own.
    taken = {*points.ids, *lines.ids}
    ids_in_records = set[str]()
    for name, image, ground in zip(lines.ids, lines.image.tolist(), lines.ground.tolist(),
                                   strict=True):
        own_id = name
        if name in ids_in_records:
            own_id = next(candidate for candidate in (f"{name}.{number}" for number in count(2))
                          if candidate not in taken)
            taken.add(own_id)
        ids_in_records.add(name)
        records.append({"id": own_id, "kind": "line", "role": "", "image": image,
                        "ground": [_with_none(vertex) for vertex in ground]})
    return [checked_record(record) for record in records]


def _with_none(ground: list[float]) -> list[float | None]:
    """Return ground coordinates with None for a height that is NaN."""
    return [*ground[:2], None if ground[2] != ground[2] else ground[2]]


def _ground_crs(files: Files, features: FeatureSet | None, kept: Files | None) -> str | None:
    """Return the CRS of the ground coordinates; None if neither files nor options state it.

    Raises TermselError if an option contradicts the session that is there, `kept`.
    """
    # The coordinates in the journal are in the CRS of its first line.
    if kept is not None and kept.crs is not None:
        before = normalise(kept.crs)
        if files.crs is not None and normalise(files.crs) != before:
            raise TermselError(f"this session is in {before}, not in {files.crs}",
                               hint="Leave --crs out, or choose another --out.")
        return before
    if files.crs is not None:
        return normalise(files.crs)
    if features is not None and features.crs:
        return features.crs
    # RPCs are in longitude, latitude and ellipsoidal height.
    return "EPSG:4979" if files.rpc is not None else None


def _crs_of_maps(maps: Maps) -> str:
    """Return the CRS for ground coordinates that the maps give: that of the first raster.

    Without a raster it is the CRS in which the maps are shown. Raises TermselError without a map.
    """
    if maps.rasters:
        return maps.rasters[0].crs
    if maps.vectors or maps.tiles:
        return maps.shown
    raise TermselError("the CRS of the ground coordinates is not known",
                       hint="State it with --crs, such as --crs EPSG:25832; or --crs local for "
                            "plane coordinates without a CRS. A --map states it, too.")
