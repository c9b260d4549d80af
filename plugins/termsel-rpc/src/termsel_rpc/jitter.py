"""A vendor's RPC with a smooth correction along the lines: the jitter of the attitude."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from termsel import Fit, FitData, Option, Rpc, Undetermined
from termsel_rpc.correction import CorrectedRpc
from termsel_rpc.image_space import RPC, RpcShift
from termsel_rpc.refinement import FloatArray

_DEGREE = 3
# Features that each interval requires.
_MIN_FEATURES = 3
_MAX_LEVERAGE = 0.999

INTERVALS = Option("intervals", 8, "Intervals of the spline over the lines of the RPC's image.",
                   int, 2, 64)
ACROSS = Option("across", False, "Add a term that is linear along each line, as rpc-affine has.",
                bool)
TRIED = (2, 4, 8, 16, 32)
"""Numbers of intervals that are tried where the features choose."""


class RpcJitter(RpcShift):
    """Vendor's RPC with a smooth correction along the lines: 2 (intervals + 3) terms.

    With `across` there are 2 more, a multiple of the sample for each axis. With (l, s) the RPC
    position of a ground point, image = (l + f(l), s + g(l)), where f and g are cubic splines with
    equal intervals. Lines are imaged one after the other, so that any motion of the attitude that
    the vendor did not know acts along the lines. Shift and drift are contained.

    References
    ----------
    Splines after de Boor 1978: A practical guide to splines. For attitude jitter of scanners and
    its size see Teshima, Iwasaki 2008: Correction of attitude fluctuation of Terra spacecraft using
    ASTER/SWIR imagery with parallax observation. IEEE TGRS 46(1), 222-227.
    """

    name = "rpc-jitter"
    declared_options = (RPC, INTERVALS, ACROSS)

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the columns: one for each spline, and that across the lines."""
        names = [f"spline{i + 1}" for i in range(int(self.options["intervals"]) + _DEGREE)]
        return (*names, "across") if self.options["across"] else tuple(names)

    def first_order(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scaled image positions (n, 2) by the RPC, and the terms' columns (n, 2, k).

        `ground` (n, 3) is scaled; a column is what a term of 1 adds to line and sample.
        """
        geographic = self.geographic(ground)
        assert self.scaling is not None  # otherwise `geographic` has raised an error
        positions = self.rpc.project(geographic)
        values = spline_values(positions[:, 0], self.rpc, int(self.options["intervals"]))
        if self.options["across"]:
            sample = (positions[:, 1] - self.rpc.image_offset[1]) / abs(self.rpc.image_scale[1])
            values = np.column_stack([values, sample])
        # The same columns for both axes, each with its own terms: a block diagonal of two.
        both_axes = np.einsum("ab,nc->nabc", np.eye(2), values)
        return self.scaling.image(positions), both_axes.reshape(
            len(positions), 2, len(self.terms))

    def as_rpc(self, coefficients: FloatArray) -> Rpc | None:
        """Return None: no RPC has such a correction."""
        return None


def spline_values(lines: FloatArray, rpc: Rpc, intervals: int) -> FloatArray:
    """Return the values (n, intervals + 3) of all cubic splines at lines (n,) [px].

    They add up to 1 at each line. Beyond the lines of the RPC's image they are those at its edge.
    """
    # Other models need not import it.
    from scipy.interpolate import BSpline

    # Uniform knots from 3 intervals before the image to 3 behind it: cubic splines of de Boor.
    step = 2 / intervals
    knots = -1 + step * np.arange(-_DEGREE, intervals + _DEGREE + 1)
    unit = np.clip((lines - rpc.image_offset[0]) / abs(rpc.image_scale[0]), -1, 1 - 1e-12)
    return np.asarray(BSpline(knots, np.eye(intervals + _DEGREE), _DEGREE)(unit))


@dataclass(frozen=True, eq=False)
class JitteredRpc(CorrectedRpc):
    """The RPC that features have, with as many intervals as leave-one-out supports."""

    def fit(self, control: FitData) -> Fit:
        """Return the fit of the fewest intervals that predict within a standard error of the best.

        Raises Undetermined without an RPC, and if the features determine no number of intervals.
        """
        rpc = control.features.rpc
        if rpc is None:
            raise Undetermined("no RPC is given", hint="Give it with --rpc FILE.")
        squares_by_model: list[tuple[Any, FloatArray]] = []
        for intervals in TRIED:
            if _MIN_FEATURES * intervals > len(control):
                break
            model = RpcJitter(rpc=json.dumps(asdict(rpc)), intervals=intervals).prepared(
                control.scaling, control.features.crs)
            squares = _held_out_squares(model, control)
            if squares is not None:
                squares_by_model.append((model, squares))
        if not squares_by_model:
            raise Undetermined("the features do not determine a correction along the lines",
                               hint="Give more points, all along the lines.")
        best = min((squares for _, squares in squares_by_model), key=np.mean)
        # The best model itself differs by 0, so that there is always one.
        model = next(model for model, squares in squares_by_model if (squares - best).mean()
                     <= (squares - best).std() / np.sqrt(len(squares)))
        return self.estimator.fit(
            model, control.features, control.scaling, np.ones(len(model.terms), dtype=bool),
            np.ones(len(control), dtype=bool))

    def describe(self, fitted: Fit) -> str:
        """Return a sentence on the correction, with its number of intervals."""
        return (f"The points support a correction of the vendor's RPC that changes along the "
                f"lines, over {fitted.model.options['intervals']} intervals.")

    def suspects(self, control: FitData) -> None:
        """Return None: the corrections with a prior look for blunders."""


def _held_out_squares(model: RpcJitter, control: FitData) -> FloatArray | None:
    """Return the squared error (m,) of each equation by all others, scaled.

    None if the equations, or those without one of them, do not determine the model.
    """
    equations = model.equations(control.scaling.features(control.features))
    u, size, _ = np.linalg.svd(equations.A, full_matrices=False)
    if size[-1] < 1e-8 * size[0]:
        return None
    # An equation of leverage 1 alone determines a term, and has no error by the others.
    leverage = (u**2).sum(axis=1)
    if leverage.max() > _MAX_LEVERAGE:
        return None
    # Leave-one-out in closed form: r / (1 - h), by the leverage h of each row.
    residuals = equations.b - u @ (u.T @ equations.b)
    return np.asarray((residuals / (1 - leverage)) ** 2)


CANDIDATE = JitteredRpc("rpc-jittered", "the vendor's RPC with a smooth correction along the lines",
                        short="RPC, along lines", is_plain=True)
"""A smooth correction along the lines."""
