"""Scanners and radars as candidates of auto, where the points name their sensor or its metadata."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from termsel import Estimator, Fit, FitData, Method, SensorModel, Undetermined
from termsel_cameras.scanners.annotation import annotation_of, is_annotation
from termsel_cameras.scanners.physical import RobustFit, ShiftFit, as_stated
from termsel_cameras.scanners.product import images_of
from termsel_cameras.scanners.radar import Radar
from termsel_cameras.scanners.scanner import Scanner
from termsel_cameras.scanners.tracked import SUFFIXES, TrackedScanner

COLUMN = "sensor"
"""Column of a table of points that names the sensor."""

OF_RADAR = ("burst", "bistatic")
"""Columns that say which options a radar has."""

CAMERAS = ("frame", "panoramic")
"""What the column says of photos, which are no scanners' images."""

MAX_UNTELLING_POINTS = 2
"""Points of a radar that do not show their own error."""

MIN_SCANNER_POINTS, MAX_SCANNER_POINTS = 3, 12
"""Numbers of points for which it is: with more, those show as much as the physics."""


@dataclass(frozen=True, eq=False)
class NamedScanner(Method):
    """The scanner that a column of the points names."""

    def declines(self, control: FitData) -> str | None:
        """Return why the method cannot fit a scanner to the control; None if it can.

        Raises TermselError for a name that no sensor has, since the user meant to name one.
        """
        # From what the user says to what the points have: the first reason is the one to tell.
        features = control.features
        named = sensor_of(control)
        if not named:
            return f"the points have no column {COLUMN!r} that names one sensor"
        if named in CAMERAS:
            return "the points are said to be of a photo"
        if names_annotation(named):
            return "the points are said to be of a radar"
        if len(features.lines) or len(features.points) < MIN_SCANNER_POINTS:
            return (f"it is for {MIN_SCANNER_POINTS} to {MAX_SCANNER_POINTS} control points, "
                    "without lines")
        if features.without_height() or features.crs in ("", "local"):
            return "it needs heights and a CRS"
        # This raises the error for a name that no sensor has.
        _scanner_of_metadata(named)
        return None

    def fit(self, control: FitData) -> Fit:
        """Return the scanner that the points name, fitted to all features.

        Of a scanner without metadata the points show the direction of flight. Raises Undetermined
        if they name no sensor, or do not determine the scanner; TermselError for a name that no
        sensor has and for metadata that cannot be read.
        """
        named = sensor_of(control)
        if not named:
            raise Undetermined("no sensor is named", hint=f"Name it in a column {COLUMN!r}.")
        model = _scanner_of_metadata(named)
        if isinstance(model, Scanner):
            model = Scanner(sensor=named, track=_track_by_points(model, control))
        return _with_all_terms(self.estimator, model, control)

    def model(self, heights: bool) -> SensorModel | None:
        """Return None: the model depends on the sensor."""
        return None

    def size(self, heights: bool) -> float:
        """Return 0: what is known comes before what is fitted."""
        return 0.0

    def describe(self, fitted: Fit) -> str:
        """Return a sentence on the metadata, or on the sensor and the source of its constants."""
        if isinstance(fitted.model, TrackedScanner):
            return f"The points name the metadata {fitted.model.source}, with orbit and attitude."
        assert isinstance(fitted.model, Scanner)
        return (f"The points name the sensor {fitted.model.options['sensor']}. Its constants: "
                f"{fitted.model.source}.")


@dataclass(frozen=True, eq=False)
class NamedRadar(Method):
    """The radar whose annotation a column of the points names."""

    def declines(self, control: FitData) -> str | None:
        """Return why the method cannot fit a radar to the control; None if it can.

        Raises TermselError for an annotation that cannot be read.
        """
        features = control.features
        named = sensor_of(control)
        if not names_annotation(named):
            return f"the points have no column {COLUMN!r} that names the annotation of a radar"
        if len(features.lines) or not len(features.points):
            return "it is for control points, without lines"
        if features.without_height() or features.crs in ("", "local"):
            return "it needs heights and a CRS"
        annotation_of(named)
        return None

    def settles(self, control: FitData) -> str | None:
        """Return why no other method need be tried: the points are the annotation's own lattice.

        None if they are not. Raises TermselError if they are a lattice over bursts that overlap.
        """
        if control.lattice is None or not names_annotation(sensor_of(control)):
            return None
        radar = _radar_of_points(control)
        if as_stated(radar.prepared(control.scaling, control.features.crs), control) is None:
            return None
        return ("The points are the lattice that was computed from this annotation. Its orbit "
                "and timing are valid between them, too, so nothing is fitted to them.")

    def fit(self, control: FitData) -> Fit:
        """Return the radar that the points name, with shifts fitted to all features.

        No shift is fitted to its own lattice. Raises Undetermined if they name none.
        """
        named = sensor_of(control)
        if not names_annotation(named):
            raise Undetermined("no annotation is named",
                               hint=f"Name its file in a column {COLUMN!r}.")
        return _with_all_terms(self.estimator, _radar_of_points(control), control)


    def model(self, heights: bool) -> SensorModel | None:
        """Return None: the model depends on the annotation."""
        return None

    def size(self, heights: bool) -> float:
        """Return 0: what is known comes before what is fitted."""
        return 0.0

    def describe(self, fitted: Fit) -> str:
        """Return sentences on the annotation, and on the error of measurements if it was assumed.

        "" if the points are its own lattice, of which `settles` says so.
        """
        assert isinstance(fitted.model, Radar)
        if not fitted.effective:
            return ""
        statement = (f"The points name the annotation {fitted.model.source}, with orbit, timing "
                     "and ranges.")
        points = fitted.control.take(fitted.used).points
        if len(points) > MAX_UNTELLING_POINTS or points.sigma is not None:
            return statement
        return (f"{statement} So few points do not show their own error: it is taken as about half "
                "a pixel. If you know it, give it in the columns sigma_line and sigma_sample.")


def names_annotation(named: str) -> bool:
    """Return whether the name of a sensor is an annotation of Sentinel-1, or leads to one."""
    path = Path(named)
    return bool(named) and (bool(images_of(path)) or (
        named.lower().endswith(".xml") and is_annotation(path)))


def _radar_of_points(control: FitData) -> Radar:
    """Return the radar that the points name; its options are those that all points have alike."""
    options: dict[str, Any] = {}
    for name in OF_RADAR:
        values = set(control.features.points.attributes.get(name, ()))
        if len(values) == 1 and (value := str(values.pop()).strip()):
            options[name] = value
    return Radar(metadata=sensor_of(control), **options)


def _with_all_terms(estimator: Estimator, model: SensorModel, control: FitData) -> Fit:
    """Return the fit of a model with all its terms to all control."""
    return estimator.fit(model, control.features, control.scaling,
                         np.ones(len(model.terms), dtype=bool), np.ones(len(control), dtype=bool))


def _scanner_of_metadata(named: str) -> Scanner | TrackedScanner:
    """Return the scanner of a file of metadata, by its suffix, else of a sensor or its constants.
    """
    if named.lower().endswith(SUFFIXES):
        return TrackedScanner(metadata=named)
    return Scanner(sensor=named)


def _track_by_points(scanner: Scanner, control: FitData) -> str:
    """Return the direction of flight: ascending if latitudes grow with lines, else descending."""
    prepared = scanner.prepared(control.scaling, control.features.crs)
    latitude = prepared.geographic(control.scaled.points.ground)[:, 1]
    line = control.features.points.image[:, 0]
    covariance = float((latitude - latitude.mean()) @ (line - line.mean()))
    return "ascending" if covariance > 0 else "descending"


def sensor_of(control: FitData) -> str:
    """Return the one name that all points have in the column, or ""."""
    names = set(control.features.points.attributes.get(COLUMN, ()))
    return str(names.pop()).strip() if len(names) == 1 else ""


SCANNER = NamedScanner("named-scanner", "the physical scanner that the points name",
                       short="physical scanner", estimator=RobustFit(), has_prior=True,
                       from_one=True, max_features=MAX_SCANNER_POINTS)

RADAR = NamedRadar("named-radar", "the radar whose annotation the points name", short="radar",
                   estimator=ShiftFit(), has_prior=True, from_one=True)
