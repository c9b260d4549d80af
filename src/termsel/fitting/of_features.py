"""The verb of the public API: from features with their roles to a fit, or to what is missing."""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError, counted
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet
from termsel.data.scaling import scaling_of
from termsel.fitting.fit import Fit, Undetermined
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.models.base import SensorModel

AS_CONTROL = ("control", "")
"""Roles of the points that a fit takes as control; "" is that of a point without a role."""


def control_of(features: FeatureSet) -> FeatureSet:
    """Return the features that a fit takes as control: lines, and points of `AS_CONTROL`.

    Raises TermselError if there are none.
    """
    points = features.points
    is_control = np.isin(np.array(points.roles, dtype=object), AS_CONTROL)
    if not is_control.any() and not len(features.lines):
        other_roles = ", ".join(sorted(set(points.roles)))
        raise TermselError(
            f"all {len(points)} points have other roles than control: {other_roles}" if other_roles
            else "there are no control features",
            hint="Give points the role control or none; a fit takes these and all lines.")
    if is_control.all():
        return features
    return features.take(
        np.concatenate([is_control, np.ones(len(features) - len(points), dtype=bool)]))


@one_blas_thread
def fit_all_terms(model: SensorModel, control: FeatureSet) -> Fit:
    """Fit all terms of a model by least squares to the features that `control_of` returns.

    Raises `Undetermined` if the control does not determine the terms.
    """
    terms, used = (np.ones(n, dtype=bool) for n in (len(model.terms), len(control)))
    return require_determined(
        LEAST_SQUARES.fit(model, control, scaling_of(control), terms, used))


def require_determined(fitted: Fit) -> Fit:
    """Return a fit; raise `Undetermined` for one that is not `Fit.determined`."""
    if fitted.determined:
        return fitted
    adjustment = fitted.adjustment
    name = fitted.model.name
    if not adjustment.converged:
        raise Undetermined(f"the fit of model {name!r} did not converge (it ended after "
                           f"{counted(adjustment.steps or 0, 'step')})",
                           hint="Give more control, or choose a plainer model.")
    if adjustment.n_equations < adjustment.n_terms:
        raise Undetermined(
            f"{fitted.used.sum()} control features give {adjustment.n_equations} equations for the "
            f"{adjustment.n_terms} terms of model {name!r}",
            hint=f"Measure at least {-(-adjustment.n_terms // 2)}, or choose a model with fewer "
                 "terms.")
    raise Undetermined(
        f"the control determines only {adjustment.rank} of the {adjustment.n_terms} terms of "
        f"model {name!r}",
        hint="Spread the control over the area and its heights, or choose a model with fewer "
             "terms.")
