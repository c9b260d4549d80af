"""Figures of a fit: RMSE and residuals by role, and baselines."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from msgspec import UNSET

from termsel.adjustment.equations import line_normals
from termsel.data.features import FloatArray, Lines, select
from termsel.data.record.chances import t_beyond
from termsel.data.record.figures import (
    BaselineRow,
    Outlier,
    Rmse,
    RmseByRole,
    Role,
    RoleRmse,
    Significance,
)
from termsel.data.roles import Observations
from termsel.fitting.fit import FIXED_COEFFICIENTS, Fit
from termsel.fitting.residuals import Residuals, control_residuals, point_residuals

ROLES = ("control", "check", "independent")

BOTH: tuple[Role, ...] = ("control", "check")
"""What the fits without any search are fitted to."""

LEAVE_ONE_OUT = "leave-one-out"
"""Key of a further RMSE of the control, under models that correct predictions by it."""

Rmses = Mapping[str, Rmse | None]


@dataclass(frozen=True)
class Baseline:
    """A fit without any search, with which the selection is compared.

    It has `n_terms` of both axes, and was fitted to the features of the roles `fitted_to`. If the
    control does not determine it, its figures are those of the least-norm solution, and if it has
    not `converged`, those of its last step. RMSE [px] are by role, None without points; `predicted`
    is that by leave-one-out over the features it was fitted to. `refused` says why a choice left it
    out though it is determined.
    """

    name: str
    n_terms: int
    fitted_to: tuple[Role, ...]
    determined: bool
    rmse: Rmses
    predicted: float | None = None
    converged: bool = True
    refused: str = ""

    def row(self) -> BaselineRow:
        """Return the fit as the record of a run holds it."""
        return BaselineRow(name=self.name, n_terms=self.n_terms, fitted_to=self.fitted_to,
                           determined=self.determined, predicted=self.predicted,
                           rmse=rmse_record(self.rmse), refused=self.refused or UNSET)


def rmse_record(rmse: Rmses) -> RmseByRole:
    """Return RMSE by role as result.json holds them, with that by leave-one-out if it was computed.
    """
    control, check, independent = (_rmse_of_role(rmse.get(role)) for role in ROLES)
    return RmseByRole(control, check, independent,
                      _rmse_of_role(rmse[LEAVE_ONE_OUT]) if LEAVE_ONE_OUT in rmse else None)


def _rmse_of_role(rmse: Rmse | None) -> RoleRmse:
    """Return the RMSE of a role as a record holds it, with None for values without features."""
    if rmse is None:
        return RoleRmse(None, None, None, 0)
    return RoleRmse(finite_or_none(rmse.line), finite_or_none(rmse.sample),
                    finite_or_none(rmse.total), rmse.n, rmse.freedom)


def number(value: float | None) -> float:
    return np.nan if value is None else value


def finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def baseline_figures(name: str, fitted: Fit, predicted: float | None, observations: Observations,
                     roles: tuple[Role, ...] = BOTH, refused: str = "") -> Baseline:
    """Return the figures of a fit to some roles, whose RMSE by leave-one-out [px] is `predicted`.

    `refused` is as for `Baseline`.
    """
    return Baseline(name=name, n_terms=int(fitted.terms.sum()), fitted_to=roles,
                    determined=fitted.determined,
                    rmse=rmse_by_role(restrict_to_control(fitted, observations), observations),
                    predicted=predicted, converged=fitted.adjustment.converged, refused=refused)


def restrict_to_control(fitted: Fit, observations: Observations) -> Fit:
    """Return a fit whose control figures are of the control alone, not of check points too.

    It cannot be repeated without a feature, as it does not know all that it was fitted to. Lines
    that it was not fitted to are on offer, and not used.
    """
    control = observations.control
    if fitted.control is control:
        return fitted
    lines = frozenset(fitted.control.lines.features)
    used = np.array([True] * len(control.points)
                    + [name in lines for name in control.lines.features], dtype=bool)
    return replace(fitted, control=control, used=used,
                   estimator=FIXED_COEFFICIENTS, stored_held_out=None, original=fitted)


def rmse_by_role(fitted: Fit, observations: Observations) -> dict[str, Rmse | None]:
    """Return the RMSE by role, None for roles without features.

    Where control corrects the model itself, it also has that by leave-one-out.
    """
    rmse_by_role = {"control": fitted.control_rmse(), "check": fitted.rmse(observations.check),
                    "independent": fitted.rmse(observations.independent)}
    if fitted.model.corrects and fitted.estimator.repeatable:
        rmse_by_role[LEAVE_ONE_OUT] = fitted.leave_one_out_rmse()
    return rmse_by_role


def residuals_of(fitted: Fit, observations: Observations, outliers: Iterable[Outlier] = (), *,
                 check_used: bool = False,
                 independent_used: Collection[str] = ()) -> Residuals:
    """Return the residuals of all features that have a role, of a fit to the control.

    `outliers` are marked; outliers that lost their role are among the features. `check_used` says
    whether check points took part in the adjustment, too, and `independent_used` has the ids of the
    independent points that did.
    """
    check = observations.check
    independent = observations.independent
    certainty = {outlier.id: outlier.certainty for outlier in outliers}
    # Outliers without a role are shown as well: their residuals say why they lost it.
    points = observations.features.points
    off = points.take([name in certainty and role == "off"
                       for name, role in zip(points.ids, points.roles, strict=True)])
    residuals = [
        *control_residuals(observations.control, fitted.used,
                           fitted.errors(observations.control.points), fitted.line_errors()),
        *point_residuals(check, fitted.errors(check), "check", [check_used] * len(check)),
        *point_residuals(independent, fitted.errors(independent), "independent",
                         [name in independent_used for name in independent.ids]),
        *point_residuals(off, fitted.errors(off), "off", [False] * len(off))]
    marked = (
        replace(residual, blunder=certainty[residual.id]) if residual.id in certainty else residual
        for residual in residuals)
    return Residuals(marked, observations.control.crs)


# What a fit says about its terms and its lines.

NORMAL_MEDIAN = 0.6745
"""Median absolute value of a standard normal variable."""

CORRELATED = 0.95
"""Absolute correlation of two coefficients from which on they are named."""

PARALLEL = 0.05
"""Orientation spread from which on lines fix both image axes; that of lines within 13 degrees."""


def term_significance(fit: Fit) -> dict[str, Significance]:
    """Return the significance of each term in use; empty without redundancy.

    It is that of the adjustment as if the terms had been given. After a search among many it
    is too favourable. A term whose standard deviation is 0 or not known has none.
    """
    adjustment = fit.adjustment
    if not adjustment.feasible or adjustment.redundancy <= 0:
        return {}
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(adjustment.coefficients) / adjustment.deviations
    return {name: Significance(float(t[i]), t_beyond(float(t[i]), adjustment.redundancy))
            for i, name in enumerate(fit.model.terms) if fit.terms[i] and np.isfinite(t[i])}


def correlated_terms(fit: Fit) -> Iterator[tuple[str, str, float]]:
    """Yield pairs of terms whose coefficients correlate by CORRELATED or more, highest first."""
    matrix = fit.adjustment.correlations
    if matrix is None:
        return
    names = select(fit.model.terms, fit.terms)
    high = np.argwhere(np.triu(np.abs(matrix) >= CORRELATED, 1))
    for i, j in sorted(high.tolist(), key=lambda pair: -abs(matrix[pair[0], pair[1]])):
        yield names[i], names[j], float(matrix[i, j])


def orientation_spread(lines: Lines) -> float:
    """Return how widely the directions of image lines, at least one, spread.

    It is twice the smaller eigenvalue of the mean of n n^T over the unit normals n: 1 where all
    directions occur alike, 0 where all lines are parallel and fix one image axis alone.
    """
    normal: FloatArray = line_normals(lines)[0]
    return float(max(0.0, 2.0 * np.linalg.eigvalsh(normal.T @ normal / len(normal))[0]))
