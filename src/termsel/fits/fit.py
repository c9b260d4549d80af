"""One fitted model: its adjustment, its residuals, its RMSE."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from termsel.adjustment.equations import Equations, line_normals
from termsel.adjustment.solve import Adjustment, solve
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.measurements.scaling import Scaling, scaling_of
from termsel.models.base import SensorModel
from termsel.models.locate import Surface, locate

ITERATIONS = 20
"""Most Gauss-Newton steps of a fit; two or three are usual."""

HALVINGS = tuple(0.5**i for i in range(8))
"""Shares of a Gauss-Newton step that are tried in turn."""


@dataclass(frozen=True)
class Rmse:
    """Root mean square errors [pixel] over n features.

    `total` is sqrt(mean(dl^2 + ds^2)) over points. For control lines the error is the
    distance of each projected ground vertex from the image line, taken along its normal.
    """

    line: float
    sample: float
    total: float
    n: int


@dataclass(frozen=True, eq=False)
class Fit:
    """A model fitted to control features.

    Parameters
    ----------
    model : SensorModel
    scaling : Scaling
    control : FeatureSet
        All control features on offer [pixel, ground units].
    terms : ndarray of bool, shape (k,)
    used : ndarray of bool, shape (len(control),)
        Features in the adjustment, points before lines.
    adjustment : Adjustment
    """

    model: SensorModel
    scaling: Scaling
    control: FeatureSet
    terms: BoolArray
    used: BoolArray
    adjustment: Adjustment

    def with_coefficients(self, coefficients: FloatArray) -> Fit:
        """Return the fit with coefficients that are not those of least squares."""
        equations = self.model.equations(self.scaling.features(self.control))
        unknown = np.full(len(coefficients), np.nan)
        return replace(self, adjustment=replace(
            self.adjustment, coefficients=coefficients, deviations=unknown,
            residuals=equations.b - equations.A @ coefficients, sigma0=float("nan"),
            correlations=None))

    def project(self, ground: FloatArray) -> FloatArray:
        """Return line and sample [pixel] of ground points, shape (n, 2)."""
        used = self.scaling.features(self.control.take(self.used))
        scaled = self.model.predict(self.adjustment.coefficients, used,
                                    self.scaling.ground(ground))
        return self.scaling.pixels(scaled)

    def locate(self, image: ArrayLike, height: ArrayLike | Surface) -> FloatArray:
        """Return the ground points seen at image points (see `termsel.models.locate.locate`)."""
        centre, scale = self.ground_box()
        return locate(self.project, image, height, centre=centre, scale=scale)

    def ground_box(self) -> tuple[FloatArray, FloatArray]:
        """Return middle and half-range of the control, shapes (3,), in its own CRS."""
        box = self.scaling
        if box.fit_crs:
            box = scaling_of(replace(self.control, fit_crs=""))
        return np.array(box.ground_offset), np.array(box.ground_scale)

    def image_box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return first and last line and sample [pixel]: of the image, or of the control."""
        if self.control.image_size is not None:
            lines, samples = self.control.image_size
            return (0.0, 0.0), (lines - 1.0, samples - 1.0)
        image = self.control.image_vertices()
        (top, left), (bottom, right) = image.min(axis=0).tolist(), image.max(axis=0).tolist()
        return (top, left), (bottom, right)

    def errors(self, points: Points) -> FloatArray:
        """Return measured minus computed line and sample [pixel], shape (n, 2)."""
        return points.image - self.project(points.ground)

    def line_errors(self) -> FloatArray:
        """Return the errors of the control lines' ground vertices [pixel], shape (n, 2, 2).

        For each line and vertex: the vector along the normal from the projected vertex to
        the image line, as line and sample.
        """
        lines = self.control.lines
        normal, rho = line_normals(lines)
        image = self.project(lines.ground.reshape(-1, 3)).reshape(-1, 2, 2)
        distance = rho[:, None] - np.einsum("ia,iva->iv", normal, image)
        return np.asarray(distance[..., None] * normal[:, None, :])

    def control_rmse(self) -> Rmse | None:
        """Return the RMSE of the control features in use."""
        return _rmse(self._control_errors(self.used), int(self.used.sum()))

    def leave_one_out_rmse(self) -> Rmse | None:
        """Return the RMSE of the control features in use, each under the fit without it."""
        one_each = np.eye(len(self.used), dtype=bool)[self.used]
        errors = [fit(self.model, self.control, self.scaling, self.terms, self.used & ~one)
                  ._control_errors(one) for one in one_each]
        return _rmse(np.concatenate(errors), len(errors))

    def _control_errors(self, features: BoolArray) -> FloatArray:
        """Return the errors of some control features [pixel], of lines at each vertex."""
        some = self.control.take(features)
        errors = [self.errors(some.points)]
        if len(some.lines):
            which = features[len(self.control.points):][self.control.lines.feature]
            errors.append(self.line_errors()[which].reshape(-1, 2))
        return np.concatenate(errors)

    def rmse(self, points: Points) -> Rmse | None:
        """Return the RMSE of points that took no part in the adjustment; None without points."""
        return _rmse(self.errors(points), len(points))


def _rmse(errors: FloatArray, n: int) -> Rmse | None:
    if not n:
        return None
    line, sample = np.sqrt((errors**2).mean(axis=0)).tolist()
    return Rmse(line, sample, float(np.hypot(line, sample)), n)


def fit(model: SensorModel, control: FeatureSet, scaling: Scaling,
        terms: BoolArray | None = None, used: BoolArray | None = None, *,
        iterated: bool = True) -> Fit:
    """Fit a model to control features.

    Parameters
    ----------
    model : SensorModel
    control : FeatureSet
        In pixels and ground units.
    scaling : Scaling
    terms : ndarray of bool, shape (k,), optional
        Terms in use; all by default.
    used : ndarray of bool, shape (len(control),), optional
        Features in use; all by default.
    iterated : bool
        Whether to go on from equations that hold to first order to the least squares of
        distances; else the fit is the one a search judges.
    """
    terms = np.ones(len(model.terms), dtype=bool) if terms is None else terms
    used = np.ones(len(control), dtype=bool) if used is None else used
    model = model.prepared(scaling, control.crs)
    features = scaling.features(control)
    adjustment = (adjust(model, features, terms, used) if iterated
                  else solve(model.equations(features), terms, used))
    return Fit(model, scaling, control, terms, used, adjustment)


def adjust(model: SensorModel, features: FeatureSet, terms: BoolArray,
           used: BoolArray) -> Adjustment:
    """Return the least squares of distances, by Gauss-Newton where equations are not exact.

    A step that does not lessen the sum of squared distances is halved, and where that does not
    help the search ends.

    Parameters
    ----------
    model : SensorModel
        Prepared for the features.
    features : FeatureSet
        In scaled coordinates.
    terms, used : ndarray of bool
        As for `fit`.
    """
    adjustment = solve(model.equations(features), terms, used)

    def left(equations: Equations, coefficients: FloatArray) -> FloatArray:
        """Return what the rows in use leave, pseudo-observations with them."""
        A, b = equations.take(used[equations.feature], np.ones_like(terms)).held()
        return np.asarray(b - A @ coefficients)

    equations = (model.linearised(features, adjustment.coefficients)
                 if adjustment.feasible else None)
    for _ in range(ITERATIONS):
        if equations is None:
            break
        v = left(equations, adjustment.coefficients)
        step = solve(equations, terms, used).coefficients - adjustment.coefficients
        for share in HALVINGS:
            coefficients = adjustment.coefficients + share * step
            nearer = model.linearised(features, coefficients)
            assert nearer is not None
            w = left(nearer, coefficients)
            if w @ w < (1 - 1e-10) * (v @ v):
                break
        else:
            break
        there = solve(nearer, terms, used)
        if not there.feasible:  # near a pole, where the equations say nothing of what is determined
            break
        equations = nearer
        adjustment = replace(there, coefficients=coefficients,
                             residuals=equations.b - equations.A @ coefficients)
    return adjustment


