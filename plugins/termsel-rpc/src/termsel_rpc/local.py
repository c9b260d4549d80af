"""A vendor's RPC with a random field: what it leaves that is local, by the points around."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np

from termsel import (
    Estimator,
    FeatureSet,
    Field,
    Fit,
    FitData,
    HeldOut,
    Rpc,
    Scaling,
    Undetermined,
)
from termsel.toolkit import Remedy
from termsel_rpc.correction import BoolArray, CorrectedRpc, Correction, RefinementSolution, fit_of
from termsel_rpc.image_space import RpcAffine
from termsel_rpc.refinement import FloatArray

LIKELY = 0.75
"""Probability of a field beyond which points support it, as of the candidate ``field``."""


class Collocated(Protocol):
    """A prediction by control points (see `SensorModel.interpolation`) that may hold a field."""

    @property
    def probability(self) -> float:
        """Probability of a field."""

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point by the others, scaled, shape (n, 2)."""

    @property
    def effective(self) -> float:
        """Effective parameters of both axes."""

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,)."""


@dataclass(frozen=True, eq=False)
class FieldOverRpc:
    """The collocation of control points over where the RPC sees them."""

    model: RpcField
    over: Collocated

    @property
    def probability(self) -> float:
        """Probability that there is a field, beyond the correction of the RPC."""
        return self.over.probability

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point by the others, scaled, shape (n, 2)."""
        return self.over.errors

    @property
    def effective(self) -> float:
        """Effective parameters of both axes."""
        return self.over.effective

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of scaled places, shape (m, 2)."""
        return self.over.predict(self.model.plane(ground))

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,)."""
        return self.over.spread(self.model.plane(ground))


class RpcField(RpcAffine):
    """Vendor's RPC with local deformation: collocation over its image positions.

    The image is a regularised cubic polynomial of where the RPC sees a ground point, and a
    stationary random field there, averaged over scales as in the model ``field``. Heights enter by
    the RPC alone. The field takes up any affine function, so that the terms make no difference.

    References
    ----------
    As `rpc-shift`, and Moritz 1980, Advanced Physical Geodesy, for collocation.
    """

    name = "rpc-field"

    def plane(self, ground: FloatArray) -> FloatArray:
        """Return scaled image positions by the RPC and 0, (n, 3), as ground points of the field."""
        return np.column_stack([self.known(ground)[0], np.zeros(len(ground))])

    def interpolation(self, control: FeatureSet) -> FieldOverRpc | None:
        """Return the field over the RPC by control points; None if they are too few for one."""
        points = control.points
        field: Any = Field().interpolation(
            replace(control, points=replace(points, ground=self.plane(points.ground))))
        return None if field is None else FieldOverRpc(self, field)

    def predict(self, coefficients: FloatArray, control: FeatureSet,
                ground: FloatArray) -> FloatArray:
        """Return image positions of scaled ground points (n, 3) by the RPC and the control points.

        See `SensorModel.predict`; without a field they are those of the RPC.
        """
        field = None if len(control.lines) else self.interpolation(control)
        if field is None:
            return self.project(coefficients, ground)
        image = field.predict(ground)
        return np.broadcast_to(image, (*coefficients.shape[:-1], *image.shape)).copy()

    def as_rpc(self, coefficients: FloatArray) -> Rpc | None:
        """Return None: no RPC has such a correction."""
        return None


class Local(Estimator):
    """The collocation over an RPC, where the points support a field."""

    name = "rpc-field"

    def fit(self, model: Any, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Return the fit of the field to the points in use (see `Estimator.fit`).

        `used` (n,) marks the points in use; `terms` is not looked at. Raises Undetermined for
        lines, for too few points, and if the probability of a field is not above `LIKELY`.
        """
        in_use = control.take(used)
        if len(in_use.lines):
            raise Undetermined("local deformation takes control points alone, and there are "
                               "control lines", hint="Leave the lines out, or choose rpc-affine.")
        ready = model.prepared(scaling, control.crs)
        # A random field whose probability is that of there being one, against noise alone.
        field = ready.interpolation(scaling.features(in_use))
        if field is None:
            raise Undetermined(f"{used.sum()} control points are too few for local deformation",
                               hint="Measure more control, spread over the area.")
        if field.probability <= LIKELY:
            raise Undetermined("the points do not show local deformation beyond the RPC: its "
                               f"probability is {field.probability:.2g}",
                               hint=f"Choose rpc-affine, or {Remedy('strategy', 'auto')}.")
        solution = RefinementSolution(
            np.zeros(len(ready.terms)), field.effective, 2 * len(in_use.points), float("nan"),
            HeldOut.of(field.errors * scaling.image_scale, in_use))
        return fit_of(ready, scaling, control, used, self, solution)


@dataclass(frozen=True, eq=False)
class LocalRpc(CorrectedRpc):
    """The RPC that features have, with a random field where evidence and leave-one-out support it.
    """

    def fit(self, control: FitData) -> Fit:
        """Return the fit of a correction with a random field.

        Raises Undetermined without an RPC, if the points do not show a field, and if a correction
        alone predicts held-out points as well.
        """
        rpc = control.features.rpc
        if rpc is None:
            raise Undetermined("no RPC is given", hint="Give it with --rpc FILE.")
        all_features = np.ones(len(control), dtype=bool)
        model = RpcField(rpc=json.dumps(asdict(rpc)))
        with_field, without = (
            estimator.fit(compared, control.features, control.scaling,
                          np.ones(len(compared.terms), dtype=bool), all_features)
            for estimator, compared in ((self.estimator, model),
                                        (Correction(), RpcAffine(rpc=model.options["rpc"]))))
        # The mean is that of logarithms, so that no single point decides; 0 has none.
        tiny = np.finfo(float).tiny
        gain = np.log(np.maximum(without.held_out().squares, tiny)
                      / np.maximum(with_field.held_out().squares, tiny)).mean()
        if gain <= 0:
            raise Undetermined("corrections of the RPC alone predict left-out points as well as "
                               "local deformation does",
                               hint=f"Choose rpc-affine, or {Remedy('strategy', 'auto')}.")
        return with_field

    def describe(self, fitted: Fit) -> str:
        """Return a sentence on how likely the field is."""
        field = fitted.interpolation
        assert isinstance(field, FieldOverRpc)
        return (f"The points show local deformation beyond the vendor's RPC, with a probability of "
                f"{field.probability:.3g} (more than {LIKELY:g} required).")

    def suspects(self, control: FitData) -> None:
        """Return None: the corrections with a prior look for blunders."""


CANDIDATE = LocalRpc(
    "rpc-with-field", "the vendor's RPC with local deformation", short="RPC, local deformation",
    estimator=Local(), has_prior=True, from_one=True, family="corrections of the RPC",
    contains=("rpc", "rpc-as-delivered", "rpc-shifted", "rpc-drifted", "rpc-by-affine"))
"""A random field over the RPC."""
