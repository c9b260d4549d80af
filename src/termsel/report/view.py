"""What charts and pages show of a result: plain rows, whoever computed them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from termsel.data.record.record import Record

Row = dict[str, Any]


class View(Protocol):
    """A result as it is shown.

    A row of a residual has "id", "kind" ("point" or "line"), "role", "blunder" (its certainty, or
    "") and "distance" [px].
    """

    @property
    def record(self) -> Record:
        """The content of result.json."""

    @property
    def image_box(self) -> tuple[float, float, float, float]:
        """First line, first sample, last line, last sample [px]: of the image, or of features."""

    @property
    def count(self) -> int:
        """Number of residuals, shown or not."""

    @property
    def partly(self) -> str:
        """Which residuals are shown, in a sentence; "" where all are."""

    @property
    def in_image(self) -> list[Row]:
        """Residuals with their places in the image: line, sample, dl, ds [px]."""

    @property
    def on_ground(self) -> list[Row]:
        """Residuals with their places on the ground: x, y, dx, dy in the unit of the CRS."""

    @property
    def worst(self) -> list[Row]:
        """Features by their largest residual, the largest first."""

    @property
    def lines(self) -> list[Row]:
        """Control lines as measured in the image: line, sample, line2, sample2 [px]."""

    @property
    def ground_box(self) -> tuple[float, float, float, float]:
        """Least x and y, greatest x and y of the features, in the unit of the CRS."""

    @property
    def flattening(self) -> float:
        """Length of a unit of x over that of a unit of y on the ground."""

    @property
    def units_per_metre(self) -> float | None:
        """Units of y on the ground in a metre; None where that is not known."""

    @property
    def sigma(self) -> list[Row]:
        """Standard deviation in cells of the image: line, sample, line2, sample2, sigma [px]."""

    @property
    def control(self) -> list[Row]:
        """Control in use as measured in the image: line, sample [px]."""

    @property
    def hull(self) -> list[Row]:
        """Corners of the control's convex hull, the first repeated: i, line, sample [px]."""

    @property
    def correlations(self) -> list[Row]:
        """Correlations of coefficients: one, other, correlation, a row a pair; may be none."""

    @property
    def members(self) -> list[Row]:
        """Residuals in the image by all members of the front: dls, dss [`unit`], one a member.

        `uses` has 1 for each member that the feature supports, else 0.
        """

    @property
    def unit(self) -> float:
        """Unit of the residuals of members [px]."""

    @property
    def command(self) -> str:
        """The command that repeats the run; "" where none does."""

    @property
    def no_command(self) -> str:
        """Why no command repeats the run; "" where one does."""


def nice(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(f"{max(step * power for step in (1, 2, 5) if step * power <= value):.1g}")
