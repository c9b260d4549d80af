"""What a fit needs of a model, so that models, which stand above fits, can fit themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, Self

from termsel.data.extent import KnownImage
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.scaling import Scaling
from termsel.fitting.adjustment.equations import Equations
from termsel.fitting.adjustment.interpolation import Interpolation


class Fittable(Protocol):
    """A model that can be fitted; `termsel.SensorModel` says what each member means."""

    name: ClassVar[str]
    uses_height: ClassVar[bool]
    options: dict[str, Any]

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the k terms."""

    @property
    def axis(self) -> IntArray:
        """Image axis of each term, shape (k,)."""

    @property
    def polynomial_degree(self) -> int | None:
        """Degree of a polynomial of the ground coordinates; None for any other model."""

    def interpolation(self, control: FeatureSet) -> Interpolation | None:
        """Return the prediction by control points alone, or None."""

    @property
    def corrects(self) -> bool:
        """True if the control corrects predictions directly."""

    def with_parameters(self, parameters: Mapping[str, Any]) -> Self:
        """Return the model with parameters of a selection as values of its options."""

    def known_image(self) -> KnownImage | None:
        """Return what is known of the image before a fit, or None."""

    def prepared(self, scaling: Scaling, crs: str) -> Self:
        """Return the model for features that are scaled like this."""

    def equations(self, features: FeatureSet) -> Equations:
        """Return the linear equations of scaled control features."""

    def start(self, features: FeatureSet) -> FloatArray | None:
        """Return coefficients that the first step of a fit begins at, or None."""

    @property
    def first_terms(self) -> BoolArray | None:
        """Terms whose solution an iteration begins at, or None for all."""

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return the equations about a solution, or None where `equations` are exact."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions by the coefficients alone."""

    def predict(self, coefficients: FloatArray, control: FeatureSet,
                ground: FloatArray) -> FloatArray:
        """Return scaled image positions, corrected by the control."""

    def denominators(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray | None:
        """Return the denominators, or None where there are none."""
