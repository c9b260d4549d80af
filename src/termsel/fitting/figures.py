"""Figures of a fit: RMSE and residuals by role, and baselines."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from msgspec import UNSET

from termsel.data.record.base import Role
from termsel.data.record.figures import BaselineRow, Outlier, RmseByRole, RoleRmse
from termsel.data.roles import Observations
from termsel.fitting.fit import FIXED_COEFFICIENTS, Fit
from termsel.fitting.residuals import Residuals, Rmse, control_residuals, point_residuals

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
        return BaselineRow(self.name, self.n_terms, self.fitted_to, self.determined,
                           self.predicted, rmse_record(self.rmse), self.refused or UNSET)


def rmse_record(rmse: Rmses) -> RmseByRole:
    """Return RMSE by role, with that by leave-one-out if there is one, as result.json holds them.
    """
    control, check, independent = (_of_role(rmse.get(role)) for role in ROLES)
    return RmseByRole(control, check, independent,
                      _of_role(rmse[LEAVE_ONE_OUT]) if LEAVE_ONE_OUT in rmse else None)


def _of_role(rmse: Rmse | None) -> RoleRmse:
    if rmse is None:
        return RoleRmse(None, None, None, 0)
    return RoleRmse(finite_or_none(rmse.line), finite_or_none(rmse.sample),
                    finite_or_none(rmse.total), rmse.n, rmse.freedom)


def rmse_from(record: RmseByRole) -> dict[str, Rmse | None]:
    """Return the RMSE by role that `rmse_record` gave a record for."""
    return {role: Rmse(number(one.line), number(one.sample), number(one.total), one.n, one.freedom)
            if one.n else None for role, one in record.by_role.items()}


def number(value: float | None) -> float:
    return np.nan if value is None else value


def finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def baseline(name: str, fitted: Fit, predicted: float | None, observations: Observations,
             roles: tuple[Role, ...] = BOTH, refused: str = "") -> Baseline:
    """Return the figures of a fit to some roles, whose RMSE by leave-one-out [px] is `predicted`.

    `refused` is as for `Baseline`.
    """
    return Baseline(name, int(fitted.terms.sum()), roles, fitted.determined,
                    figures(in_role(fitted, observations), observations), predicted,
                    fitted.adjustment.converged, refused)


def in_role(fitted: Fit, observations: Observations) -> Fit:
    """Return a fit whose control figures are of the control alone, whatever it was fitted to.

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
                   estimator=FIXED_COEFFICIENTS, stored_held_out=None, made=fitted)


def figures(fitted: Fit, observations: Observations) -> dict[str, Rmse | None]:
    """Return the RMSE by role, and where control corrects itself, also that by leave-one-out."""
    found = {"control": fitted.control_rmse(), "check": fitted.rmse(observations.check),
             "independent": fitted.rmse(observations.independent)}
    if fitted.model.corrects and fitted.estimator.repeatable:
        found[LEAVE_ONE_OUT] = fitted.leave_one_out_rmse()
    return found


def residuals_of(chosen: Fit, observations: Observations, outliers: Iterable[Outlier] = (), *,
                 check_used: bool = False,
                 independent_used: Collection[str] = ()) -> Residuals:
    """Return the residuals of all features that have a role, of a fit to the control.

    Outliers are told, and those that lost their role are among them. Whether check points, and the
    ids of which independent points, took part in the adjustment too.
    """
    check = observations.check
    independent = observations.independent
    certainty = {outlier.id: outlier.certainty for outlier in outliers}
    points = observations.features.points
    off = points.take([name in certainty and role == "off"
                       for name, role in zip(points.ids, points.roles, strict=True)])
    rows = (
        *control_residuals(observations.control, chosen.used,
                           chosen.errors(observations.control.points), chosen.line_errors()),
        *point_residuals(check, chosen.errors(check), "check", [check_used] * len(check)),
        *point_residuals(independent, chosen.errors(independent), "independent",
                         [name in independent_used for name in independent.ids]),
        *point_residuals(off, chosen.errors(off), "off", [False] * len(off)))
    return Residuals((replace(row, blunder=certainty[row.id]) if row.id in certainty else row
                      for row in rows), observations.control.crs)
