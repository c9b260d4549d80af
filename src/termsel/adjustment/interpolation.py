"""What a model must distinguish that predicts from the control points themselves."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from termsel.data.features import FloatArray


@runtime_checkable
class Interpolation(Protocol):
    """A prediction by control points, in scaled coordinates."""

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each control point, by the other points, shape (n, 2)."""

    @property
    def effective(self) -> float:
        """Trace of the matrix that turns measurements into their fitted values, both axes."""

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,)."""
