"""Fits in a record: what is stored of them, and the same fits again.

What is stored are the figures that cost time or depend on a choice: coefficients, their standard
deviations, effective parameters, errors of features that were held out. The rest follows from them
and the features in closed form: no estimator but least squares is run again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from termsel.adjustment.solve import Adjustment
from termsel.auto import estimators
from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.record.figures import AdjustmentFigures, Correlation, Predicted
from termsel.data.record.record import FinalFit, FitRecord, Offered
from termsel.data.scaling import Scaling
from termsel.fitting.figures import (
    correlated_terms,
    finite_or_none,
    number,
    orientation_spread,
    term_significance,
)
from termsel.fitting.fit import Estimator, Fit, HeldOut
from termsel.fitting.least_squares import LeastSquares
from termsel.fitting.sensor import sensor_of
from termsel.models.base import SensorModel
from termsel.models.quotient import guard_points, pole_margin, pole_violation


def numbers_of(fitted: Fit) -> dict[str, Any]:
    """Return the fields of a record that describe a fit, by the name of the field.

    They are those of the fit to the control, or of a fit that takes its place. The record of a
    further fit, to all points, is made by `final_fit`.
    """
    lines = fitted.control.take(fitted.used).lines
    return {
        "offered": Offered(len(fitted.model.terms), len(fitted.control)),
        "coefficients": fitted.coefficients,
        "standard_deviations": fitted.standard_deviations,
        "estimation": fit_record(fitted),
        "adjustment": adjustment_figures(
            fitted, orientation_spread(lines) if len(lines) else None),
        "sensor": sensor_of(fitted),
        "significance": term_significance(fitted),
        "correlations": tuple(Correlation((first, second), value)
                              for first, second, value in correlated_terms(fitted)),
        "scaling": fitted.scaling.numbers()}


def final_fit(final: Fit | None, predicted: Predicted | None) -> FinalFit | None:
    """Return the record of the fit to all points, with its predicted RMSE; None without that fit.
    """
    if final is None:
        return None
    return FinalFit(
        features=final.control.ids, scaling=final.scaling.numbers(),
        coefficients=final.coefficients, standard_deviations=final.standard_deviations,
        adjustment=adjustment_figures(final), fit=fit_record(final), predicted=predicted)


def fit_record(fitted: Fit) -> FitRecord:
    """Return how the coefficients of a fit were found."""
    # The fit may state features that were merged with twins; held-out errors are of the merged.
    original = fitted.original or fitted
    errors = None if original.stored_held_out is None else original.stored_held_out.errors
    held_out = None if errors is None else errors.tolist()
    return FitRecord(original.estimator.name, original.estimator.options,
                     None if original.trace is None else finite_or_none(original.trace), held_out,
                     None if fitted.original is None else original.control.ids)


def adjustment_figures(fitted: Fit, orientation_spread: float | None = None) -> AdjustmentFigures:
    """Return the figures of the adjustment of a fit, with the orientation spread of its lines."""
    adjustment = fitted.adjustment
    return AdjustmentFigures(
        equations=adjustment.n_equations, terms=adjustment.n_terms,
        redundancy=adjustment.redundancy, rank=adjustment.rank,
        condition=finite_or_none(adjustment.condition),
        # In px; that of the adjustment is in the scaled unit.
        sigma0=finite_or_none(adjustment.sigma0 * fitted.scaling.image_scale),
        orientation_spread=orientation_spread, steps=adjustment.steps,
        converged=None if adjustment.steps is None else adjustment.converged)


def fit_of_record(model: SensorModel, control: FeatureSet, scaling: Scaling, used: BoolArray,
                  coefficients: Mapping[str, float], deviations: Mapping[str, float | None],
                  figures: AdjustmentFigures, how: FitRecord,
                  by_plugin: Estimator | None = None) -> Fit:
    """Return the fit that a record describes, of the features in use among the control.

    Coefficients and figures are those of the record; only the correlations of least squares are
    computed again. `used` (n,) is a mask of the control features in use, `deviations` are the
    standard deviations of the coefficients, `how` the estimator, its trace and its held-out errors.
    The estimator of a plugin's method, `by_plugin`, is taken if the record names it. Raises
    TermselError for a name that no estimator has, and for held-out errors that are more or fewer
    than those of the features in use.
    """
    if by_plugin is not None and by_plugin.name == how.estimator:
        estimator = by_plugin
    else:
        estimator = estimators.estimator(how.estimator, **how.options)
    # As every fit does: the model then knows its place on Earth.
    model = model.prepared(scaling, control.crs)
    terms = np.array([name in coefficients for name in model.terms], dtype=bool)
    values = _array_of_terms(model, coefficients, 0.0)
    term_correlations = None
    if estimator.least_squares:
        iterated = getattr(estimator, "iterated", True)
        refit = LeastSquares(iterated).fit(model, control, scaling, terms, used)
        term_correlations = refit.adjustment.correlations
    trace = how.effective
    held_out = None
    if how.held_out is not None:
        in_use = control.take(used)
        errors = np.array(how.held_out).reshape(-1, 2)
        if len(errors) != len(in_use.vertex_feature):
            raise TermselError(f"this result is damaged at fit.held_out: {len(errors)} errors, "
                               f"expected {len(in_use.vertex_feature)}",
                               hint="Copy the whole folder again, or repeat the run.")
        held_out = HeldOut.of(errors, in_use)
    # JSON has no NaN: a trace that is not known is stored as None, which stands for least squares
    # in a fit.
    if trace is None and not estimator.least_squares:
        trace = np.nan
    # The figures of the record, whatever the rounding of this machine.
    adjustment = Adjustment(
        coefficients=values,
        deviations=_array_of_terms(model, deviations, 0.0 if estimator.least_squares else np.nan),
        n_terms=figures.terms, n_equations=figures.equations, rank=figures.rank,
        condition=np.inf if figures.condition is None else figures.condition,
        sigma0=number(figures.sigma0) / scaling.image_scale, correlations=term_correlations,
        steps=figures.steps, converged=figures.converged is not False)
    return Fit(model, scaling, control, terms=terms, used=used, adjustment=adjustment,
               estimator=estimator, trace=trace, stored_held_out=held_out)


def _array_of_terms(model: SensorModel, values: Mapping[str, float | None],
                    default: float) -> FloatArray:
    """Return values by term as an array (k,); NaN for None, `default` for terms without a value."""
    return np.array([number(values.get(name, default)) for name in model.terms])


def fit_of_selection(model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
                     used: BoolArray, check: Points, iterated: bool | None = None) -> Fit:
    """Return the fit of selected terms, a mask (k,), and features in use, a mask (n,).

    Lines under separate denominators are fitted by iteration. With `iterated` True the last step is
    returned, with False the first, which the search judged. With None it is the last, or the first
    if the last has a pole in the scene of control and `check` points.
    """
    fitted = LeastSquares(iterated is not False).fit(model, control, scaling, terms, used)
    if iterated is None and has_pole(fitted, check):
        return LeastSquares(False).fit(model, control, scaling, terms, used)
    return fitted


def has_pole(fitted: Fit, check: Points) -> bool:
    """Return whether a denominator of a fit is below `pole_margin` somewhere in the scene.

    The scene is the box around control and `check` points, which `guard_points` samples.
    """
    scaling = fitted.scaling
    control = scaling.features(fitted.control)
    return bool(pole_violation(
        fitted.model, fitted.adjustment.coefficients[None],
        guard_points(control, scaling.points(check)),
        pole_margin(control)).any())
