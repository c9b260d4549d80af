"""Models that each break one rule, and the check that finds it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray, IntArray
from termsel.data.scaling import Scaling
from termsel.models.polynomial import Affine, Polynomial2D
from termsel.models.quotient import Blocks, RationalFunctions, RationalModel


class Dlt(RationalModel):
    """Direct linear transformation, as a plugin author writes it."""

    name = "dlt-demo"

    def blocks(self, ground: FloatArray) -> Blocks:
        one = np.column_stack([np.ones(len(ground)), ground])
        return Blocks(line=one, sample=one, shared_denominator=ground)


class Undocumented(Dlt):
    declared_options = (Option("shift", 0.0, "", float),)


class SameNames(Affine):
    """Two terms of one name."""

    @property
    def terms(self) -> tuple[str, ...]:
        return (super().terms[1], *super().terms[1:])


class OtherNames(Affine):
    """Names of the terms of this very object."""

    @property
    def terms(self) -> tuple[str, ...]:
        return tuple(f"{id(self)}:{name}" for name in super().terms)


class ShortAxis(Affine):
    """An axis for some terms."""

    @property
    def axis(self) -> IntArray:
        return super().axis[1:]


class WrongAxis(Affine):
    """Line and sample mixed up."""

    @property
    def axis(self) -> IntArray:
        return 1 - super().axis


class NoLines(Dlt):
    """Control from points alone."""

    def equations(self, features: FeatureSet) -> Equations:
        if len(features.lines):
            raise TermselError("model 'dlt-demo' does not take control lines")
        return super().equations(features)


class OneRow(Affine):
    """A row too few."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        return Equations(found.A[:-1], found.b[:-1], found.feature[:-1])


class NotFinite(Affine):
    """A row that is not finite."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        found.A[0] = np.nan
        return found


class LinesFirst(Affine):
    """Features in another order."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        return Equations(found.A, found.b, found.feature[::-1].copy())


class Scribbler(Affine):
    """Writes to the ground points."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        ground *= 2.0
        return super().project(coefficients, ground / 2.0)


class ScribblesFeatures(Affine):
    """Writes to the features, which are read-only."""

    def equations(self, features: FeatureSet) -> Equations:
        features.points.ground[:] = 0.0
        return super().equations(features)


class NoSteps(Affine):
    """A start without equations about a solution."""

    def start(self, features: FeatureSet) -> FloatArray:
        return np.zeros(len(self.terms))


class WrongProjection(Affine):
    """Line and sample exchanged in the projection alone."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        return super().project(coefficients, ground)[..., ::-1]


class Mingled(Affine):
    """Rows weighted by their place among the others."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        weights = np.where(np.arange(len(found.b)) % 4 < 2, 1.0, 30.0)
        return replace(found, A=found.A * weights[:, None], b=found.b * weights)


class WrongLines(RationalFunctions):
    """The offset of image lines with the wrong sign."""

    def equations(self, features: FeatureSet) -> Equations:
        equations = super().equations(features)
        of_lines = equations.feature >= len(features.points)
        return replace(equations, b=np.where(of_lines, -equations.b, equations.b))


class NoConstant(Dlt):
    """No constant terms."""

    def blocks(self, ground: FloatArray) -> Blocks:
        return Blocks(line=ground, sample=ground)


class OneAtATime(Affine):
    """One set of coefficients alone."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        return super().project(coefficients.reshape(-1, len(self.terms))[0], ground)


class Relative(Affine):
    """Image positions that depend on the other sets of coefficients."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        image = super().project(coefficients, ground)
        return image - image.mean() if image.ndim > 2 else image


class Dice(Affine):
    """Noise in the equations."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        found.b[0] += np.random.default_rng().normal()
        return found


class Settles(Affine):
    """Moves to the place it is prepared for."""

    def prepared(self, scaling: Scaling, crs: str) -> Settles:
        self.scaling, self.crs = scaling, crs
        return self


class Lambda(Affine):
    """Keeps a function."""

    def __init__(self) -> None:
        super().__init__()
        self.hook: Callable[[], int] = lambda: 1


class NeedsTerms(Affine):
    """Refuses to have few terms."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        if (np.count_nonzero(coefficients, axis=-1) < 3).any():
            raise ValueError("too few terms")
        return super().project(coefficients, ground)


class NotFlat(Affine):
    """Says it needs no heights."""

    uses_height = False


class Flat(Polynomial2D):
    """Says it needs heights."""

    uses_height = True


class TurnedWeights(Affine):
    """Weights with rows and columns exchanged."""

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray:
        return np.zeros((len(control), len(ground)))


BROKEN_MODELS = [
    (Undocumented, "declaration", "docstring"),
    (SameNames, "term_names", r"several are called line.num:X"),
    (OtherNames, "term_names", "the same names"),
    (ShortAxis, "axis", r"shape \(8,\).* not \(7,\)"),
    (WrongAxis, "axis", "'line.num:1' does not act on the line"),
    (NoLines, "control_kinds", "lines alone: model 'dlt-demo' does not take"),
    (OneRow, "equations",
     r"A must have shape \(24, 8\), two rows per point or line, not \(23, 8\)"),
    (NotFinite, "equations", "finite"),
    (LinesFirst, "equations", "feature must number"),
    (Scribbler, "inputs_unchanged", "changes the ground points"),
    (ScribblesFeatures, "inputs_unchanged", "read-only"),
    (NoSteps, "linearisation", "a start and no equations about a solution"),
    (WrongProjection, "exact_recovery", r"equations\(\) and project\(\) do not say the same"),
    (WrongLines, "recovery_from_lines", "misses points"),
    (Mingled, "fit", "do the equations of a point depend on other points"),
    (NoConstant, "translation", "constant term"),
    (OneAtATime, "project_shapes", r"must have shape \(1, 0, 2\), not \(0, 2\)"),
    (Relative, "batch_project", "alone than among others"),
    (Dice, "deterministic", "differ from one call"),
    (Settles, "prepared", "changes the model itself"),
    (Lambda, "picklable", "another process"),
    (NeedsTerms, "masks_stay_finite", "ValueError was raised: too few terms"),
    (NotFlat, "height", "uses_height is False, but"),
    (Flat, "height", "uses_height is True, but"),
    (TurnedWeights, "residual_weights", r"must have shape \(0, 8\), not \(8, 0\)"),
]
