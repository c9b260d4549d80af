"""What charts and pages show of a result, as plain rows, each computed when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from termsel.data.coordinates.crs import is_geographic
from termsel.data.coordinates.metres import offsets_in_metres
from termsel.data.coordinates.places import convex_hull
from termsel.data.features import FeatureSet, FloatArray, select
from termsel.data.record.record import Record
from termsel.data.roles import observations_by_role
from termsel.fitting.figures import residuals_of
from termsel.fitting.fit import Fit
from termsel.fitting.residuals import Residual, Residuals
from termsel.fitting.scene import errors_on_ground, scene_grid
from termsel.results.repeat import reason_for_no_command, repeating_command

Row = dict[str, Any]

SIGMA_SIDE = 28
"""Cells along either side of the map of uncertainty."""
DRAWN, LARGEST_RESIDUALS = 2000, 1000
"""Most residuals that are drawn, and how many of them are the largest: nobody can distinguish more,
and no browser draws a hundred thousand."""
SMOOTH = 8
"""Control whose heights a cell of it has, so that it shows the model and not steps of heights."""


@dataclass(frozen=True, eq=False)
class View:
    """A result as it is shown.

    A row of a residual has "id", "kind" ("point" or "line"), "role", "blunder" (its certainty, or
    "") and "distance" [px].
    """

    record: Record
    fit: Fit
    features: FeatureSet
    residuals: Residuals
    fits_of_front: Callable[[], list[Fit]]

    @cached_property
    def image_box(self) -> tuple[float, float, float, float]:
        """First line, first sample, last line, last sample [px]: of the image, or of features."""
        # By the centres of the first and the last pixel.
        if self.features.image_size is not None:
            lines, samples = self.features.image_size
            return 0.0, 0.0, lines - 1.0, samples - 1.0
        return _coordinate_box(self.features.image_vertices())

    @property
    def count(self) -> int:
        """Number of residuals, shown or not."""
        return int(np.isfinite([r.distance for r in self.residuals]).sum())

    @property
    def partly(self) -> str:
        """Which residuals are shown, in a sentence; "" where all are."""
        if self._drawn_residuals is self.residuals:
            return ""
        return (f"Shown are the {LARGEST_RESIDUALS:,} largest of {self.count:,} residuals, and one "
                f"in {self._step:,} of all. The file residuals.csv has all of them.")

    @cached_property
    def in_image(self) -> list[Row]:
        """Residuals (`dl`, `ds`) with their places (`line`, `sample`) in the image [px].

        Those of features that the fit does not project are left out.
        """
        rows = []
        # Numbers have few digits, as a page holds thousands of rows.
        for r, (line, sample) in zip(self._drawn_residuals, self._image_positions, strict=True):
            if np.isfinite([line, sample, r.distance]).all():
                rows.append({**self._row_of(r), "line": _shorten_number(line),
                             "sample": _shorten_number(sample),
                             "dl": _shorten_number(r.line, 4), "ds": _shorten_number(r.sample, 4)})
        return rows

    @cached_property
    def on_ground(self) -> list[Row]:
        """Residuals with their places on the ground: x, y, dx, dy in the unit of the CRS.

        `metres` is the length of dx, dy; None where the CRS has no unit. Residuals that cannot be
        carried to the ground are left out.
        """
        offsets = errors_on_ground(self.fit, self._drawn_residuals)
        metres = offsets_in_metres(self.features.crs, self._drawn_residuals.ground, offsets)
        rows = []
        for i, (r, (dx, dy)) in enumerate(
                zip(self._drawn_residuals, offsets.tolist(), strict=True)):
            if np.isfinite([dx, dy]).all():
                length = None if metres is None else _shorten_number(float(np.hypot(*metres[i])), 4)
                # Twelve digits: of northings in metres a hundredth of a millimetre.
                rows.append({**self._row_of(r), "x": _shorten_number(r.x, 12),
                             "y": _shorten_number(r.y, 12),
                             "dx": _shorten_number(dx, 4), "dy": _shorten_number(dy, 4),
                             "metres": length})
        return rows

    @cached_property
    def worst(self) -> list[Row]:
        """Features by the largest residual of their vertices, the largest first.

        Where residuals are too many to be drawn, only the features of the LARGEST_RESIDUALS largest
        ones are among them.
        """
        largest: dict[str, Row] = {}
        are_all_drawn = self._drawn_residuals is self.residuals
        for i in self._residuals_by_length[:None if are_all_drawn else LARGEST_RESIDUALS]:
            if np.isfinite(self.residuals[i].distance):
                largest.setdefault(self.residuals[i].id, self._row_of(self.residuals[i]))
        return list(largest.values())

    @cached_property
    def lines(self) -> list[Row]:
        """Control lines as measured in the image: `line`, `sample`, `line2`, `sample2` [px].

        `role` is "control" for a line in use, "rejected" for a blunder that is not, and "left out"
        for others; `blunder` is True for a line that is listed among the outliers, in use or not.
        """
        lines = self.features.lines
        selected = set(self.record.selection.features)
        blunders = {outlier.id for outlier in self.record.outliers}
        rows = []
        for name, ((l1, s1), (l2, s2)) in zip(lines.ids, lines.image.tolist(), strict=True):
            role_out_of_use = "rejected" if name in blunders else "left out"
            role = "control" if name in selected else role_out_of_use
            rows.append({"id": name, "role": role, "blunder": name in blunders,
                         "line": _shorten_number(l1), "sample": _shorten_number(s1),
                         "line2": _shorten_number(l2), "sample2": _shorten_number(s2)})
        return rows

    @cached_property
    def ground_box(self) -> tuple[float, float, float, float]:
        """Least x and y, greatest x and y of the features, in the unit of the CRS."""
        return _coordinate_box(self._ground[np.isfinite(self._ground[:, :2]).all(axis=1), :2])

    @cached_property
    def flattening(self) -> float:
        """Length of a unit of x over that of a unit of y on the ground."""
        if not is_geographic(self.features.crs):
            return 1.0
        # cos(latitude); at a pole it would be 0, and a map have no width.
        return max(float(np.cos(np.radians(np.nanmean(self._ground[:, 1])))), 0.05)

    @cached_property
    def units_per_metre(self) -> float | None:
        """Units of y on the ground in a metre; None where that is not known."""
        middle = np.nanmean(self._ground[:, :2], axis=0, keepdims=True)  # heights may be unknown
        # About a metre: a degree is 111 km.
        step = 1e-5 if is_geographic(self.features.crs) else 1.0
        metres = offsets_in_metres(self.features.crs, middle, np.array([[0.0, step]]))
        return None if metres is None else step / float(metres[0, 1])

    @cached_property
    def sigma(self) -> list[Row]:
        """Standard deviation of the fit (`sigma`) in cells of the image, with their ends [px].

        A cell reaches from `line` to `line2` and from `sample` to `sample2`.
        """
        image, ground = scene_grid(self.fit, SIGMA_SIDE, SMOOTH, self.image_box)
        # What all images of a block share adds to what this one has: variances add.
        sigma = np.linalg.norm(np.hypot(self.fit.sigma(ground),
                                        self.record.shared_sigma or 0.0), axis=1)
        # Cells reach half the distance of nodes to either side.
        half_line, half_sample = ((image[-1] - image[0]) / (SIGMA_SIDE - 1) / 2).tolist()
        return [{"line": _shorten_number(line - half_line),
                 "line2": _shorten_number(line + half_line),
                 "sample": _shorten_number(sample - half_sample),
                 "sample2": _shorten_number(sample + half_sample),
                 "sigma": _shorten_number(value, 4)}
                for (line, sample), value in zip(image.tolist(), sigma.tolist(), strict=True)
                if np.isfinite(value)]

    @cached_property
    def control(self) -> list[Row]:
        """Control in use as measured in the image: line, sample [px]."""
        step = max(1, len(self._control_in_image) // DRAWN)
        return [{"line": line, "sample": sample}
                for line, sample in self._control_in_image[::step].tolist()]

    @cached_property
    def hull(self) -> list[Row]:
        """Corners of the control's convex hull in order, the first repeated: `line`, `sample` [px].

        `i` is the number of the corner in this order. Control on one straight line has no corners.
        """
        corners = convex_hull(self._control_in_image)
        return [{"i": i, "line": float(self._control_in_image[corner, 0]),
                 "sample": float(self._control_in_image[corner, 1])}
                for i, corner in enumerate(corners + corners[:1])]

    @cached_property
    def correlations(self) -> list[Row]:
        """Correlations of coefficients in use, a row for each pair: one, other, correlation.

        Empty for a fit by another estimator than least squares, which has no correlations.
        """
        matrix = self.fit.adjustment.correlations
        if matrix is None or not self.fit.estimator.least_squares:
            return []
        names = select(self.fit.model.terms, self.fit.terms)
        rows = []
        # Below the diagonal: each pair once.
        for i in range(len(names)):
            for j in range(i):
                if np.isfinite(matrix[i, j]):
                    rows.append({"one": names[i], "other": names[j],
                                 "correlation": float(matrix[i, j])})
        return rows

    @cached_property
    def members(self) -> list[Row]:
        """Residuals of each drawn feature by every member of the front, as charts of it show them.

        A row has a residual's own items, the feature's line and sample [px], and three lists with
        an item for each member: dls and dss are residuals in `unit`, and `uses` is 1 where the
        member uses the feature for control, else 0. A feature for which any member computes no
        position is left out.
        """
        unit = self.unit
        rows = []
        for i, r, (line, sample) in zip(self._drawn_indices, self._drawn_residuals,
                                        self._image_positions, strict=True):
            member_residuals = [residuals[i] for residuals in self._residuals_by_member]
            coordinates = [line, sample]
            for residual in member_residuals:
                coordinates += [residual.line, residual.sample]
            # A chart cannot draw what is not finite. Residuals are whole multiples of `unit`, as
            # there are many of them.
            if np.isfinite(coordinates).all():
                rows.append({**self._row_of(r), "line": _shorten_number(line),
                             "sample": _shorten_number(sample),
                             "dls": [round(residual.line / unit) for residual in member_residuals],
                             "dss": [round(residual.sample / unit)
                                     for residual in member_residuals],
                             "uses": [int(residual.used) for residual in member_residuals]})
        return rows

    @cached_property
    def unit(self) -> float:
        """Unit of the residuals of members [px]: their median has three digits or four in it.

        Whole numbers of it take half the space of numbers in px.
        """
        lengths: list[float] = []
        for residuals in self._residuals_by_member:
            lengths += [residual.distance for residual in residuals]
        finite = [length for length in lengths if np.isfinite(length)]
        median = float(np.median(finite or [0.0]))
        return float(f"{10.0 ** (np.floor(np.log10(median)) - 2):.0e}") if median > 0 else 1.0

    @cached_property
    def command(self) -> str:
        """The command that repeats the run; "" where none does."""
        return "" if self.no_command else repeating_command(self.record)

    @cached_property
    def no_command(self) -> str:
        """Why no command repeats the run; "" where one does."""
        return reason_for_no_command(self.record)

    @cached_property
    def _ground(self) -> FloatArray:
        """Ground positions of the residuals, shape (n, 3)."""
        return self.residuals.ground

    @cached_property
    def _residuals_by_length(self) -> list[int]:
        """The residuals, the largest first, unknown ones last."""
        lengths = np.array([r.distance for r in self.residuals])
        # NaN is last in any order; a stable sort keeps that of the file among equal ones.
        return [int(i) for i in np.argsort(-lengths, kind="stable")]

    @property
    def _step(self) -> int:
        """Distance, in the order of the file, from one regularly drawn residual to the next."""
        if len(self.residuals) <= DRAWN:
            return 1
        # -(-a // b) is a / b rounded upwards.
        return -(-len(self.residuals) // (DRAWN - LARGEST_RESIDUALS))

    @cached_property
    def _drawn_indices(self) -> list[int]:
        """Indices of the residuals that are drawn, ascending: regular ones and the largest."""
        regular_indices = range(0, len(self.residuals), self._step)
        return sorted({*regular_indices, *self._residuals_by_length[:LARGEST_RESIDUALS]})

    @cached_property
    def _drawn_residuals(self) -> Residuals:
        """Residuals that are drawn, in the order of the file."""
        if self._step == 1:
            return self.residuals
        return Residuals((self.residuals[i] for i in self._drawn_indices), self.residuals.crs)

    @cached_property
    def _image_positions(self) -> list[list[float]]:
        """Line and sample of each drawn residual [px], measured for points, computed for lines.

        The vertices of a line on the ground were not measured in the image: the fit projects them.
        """
        measured = dict(zip(self.features.points.ids, self.features.points.image.tolist(),
                            strict=True))
        computed_positions = self.fit.project(self._drawn_residuals.ground).tolist()
        return [measured[r.id] if r.kind == "point" else computed
                for r, computed in zip(self._drawn_residuals, computed_positions, strict=True)]

    @cached_property
    def _control_in_image(self) -> FloatArray:
        """Places of the control in use in the image, shape (n, 2)."""
        # The refit to all points has no points left to show as independent.
        original = self.fit.original or self.fit
        return original.control.take(original.used).image_vertices()

    @cached_property
    def _residuals_by_member(self) -> list[Residuals]:
        """Residuals of all features by each member of the front, in its order."""
        roles = observations_by_role(self.features)
        return [residuals_of(fitted, roles) for fitted in self.fits_of_front()]

    def _row_of(self, r: Residual) -> Row:
        """Return id, kind, role, blunder and distance [px] of a residual, as charts need them."""
        role = r.role
        if role in ("control", "off") and not r.used:
            role = "rejected" if r.blunder else "left out"
        return {"id": r.id, "kind": "point" if r.kind == "point" else "line", "role": role,
                "blunder": r.blunder, "distance": _shorten_number(r.distance, 4)}


def _coordinate_box(points: FloatArray) -> tuple[float, float, float, float]:
    """Return the least of both coordinates of points (n, 2), then the greatest of both."""
    (least_first, least_second) = points.min(axis=0).tolist()
    (greatest_first, greatest_second) = points.max(axis=0).tolist()
    return least_first, least_second, greatest_first, greatest_second


def _shorten_number(value: float, digits: int = 7) -> float:
    """Return a number with fewer digits, as data of a page."""
    return float(f"{value:.{digits}g}")


def nice_number(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(f"{max(step * power for step in (1, 2, 5) if step * power <= value):.1g}")
