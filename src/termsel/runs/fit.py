"""The public verb `fit`: any model by its name, its class or itself, and any method."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, first_names_in_words, unknown_name_error
from termsel.core.isolation.faults import attribute_errors_to
from termsel.core.threads import one_blas_thread
from termsel.data.coordinates.crs import CrsLike
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.data.roles import with_roles
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import control_of, fit_all_terms
from termsel.fitting.method import Method
from termsel.io.read import features_of
from termsel.models.base import SensorModel, require_heights
from termsel.plugins.registry import registry
from termsel.runs.request import note_on_blank, owners_of_options, to_leave_out

log = logging.getLogger(__name__)


@explains_arguments()
def fit(features: Any, model: str | type[SensorModel] | SensorModel | Method = "rfm", *,
        crs: CrsLike | None = None, columns: str | Mapping[str, Any] | None = None,
        **options: Any) -> Fit:
    """Fit one model to control features, without any selection.

    Parameters
    ----------
    features : FeatureSet, path-like or table
        The name of a file, or a table such as a DataFrame, is read by `termsel.read`. Lines, and
        points with the role control or none, are control. Points with the role check,
        independent or off are left out.
    model : str, class, SensorModel or Method
        Name of a model, or of a method, which needs no search: affine, quadratic, ridge, huber or
        another that ``termsel list methods`` shows. Of a name that both have, the model is taken.
    crs, columns : optional
        As for `termsel.read`, where features are read.
    **options
        Options of the model; a method has none.

    Returns
    -------
    Fit
        The model with its coefficients: it projects, locates, and knows its errors.

    Raises
    ------
    TermselError
        For an unknown name or option; if there is no control, the control does not determine the
        terms, or heights that the model uses are unknown.

    Examples
    --------
    >>> import termsel
    >>> scene = termsel.simulate_scene("ikonos-hamedan")
    >>> fitted = termsel.fit(scene, "poly3d", degree=1)
    >>> fitted.adjustment.redundancy  # of 24 points and 120 lines
    280
    >>> independent = scene.points.take([role == "independent" for role in scene.points.roles])
    >>> round(fitted.rmse(independent).total, 1)  # px
    2.7
    """
    features = features_of(features, crs, columns)
    resolved: Any = model
    if isinstance(model, str):
        names = registry()
        # A model comes before a method of the same name: it has options.
        resolved = names.known("models", model) or names.known("methods", model)
        if model == "auto":
            raise TermselError("'auto' is the choice of a model, and fit takes one",
                               hint="termsel.run(features=FEATURES) chooses, and returns a result: "
                                    "its fit is result.fit.")
        if resolved is None:
            raise unknown_name_error("model", model,
                                     {*names.names("models"), *names.names("methods")},
                                     names.hint(model, "models", "methods"))
    elif not isinstance(model, Method):
        resolved = registry().resolve("models", model)
    if isinstance(resolved, Method):
        _refuse(options, f"method {resolved.name!r}")
        return _fit_by_method(resolved, features)
    if isinstance(resolved, SensorModel):
        _refuse(options, f"model {resolved.name!r}, which has its options already,")
    else:
        if options:
            _refuse_unknown(options, resolved)
        resolved = resolved(**options)
    control = control_of(features)
    if resolved.uses_height and features.without_height():
        control = control_of(_with_heights(features))
        require_heights(resolved, control)
    return fit_all_terms(resolved, control)


@one_blas_thread
def _fit_by_method(method: Method, features: FeatureSet) -> Fit:
    """Return the fit by a method that the user names.

    Raises TermselError, with its reason, where the method declines the features.
    """
    # Check and independent points stay out, as in a run without them.
    data = FitData.of(control_of(_with_heights(features)))
    with attribute_errors_to(method, "fit"):
        reason = method.declines(data)
        if reason is not None:
            raise TermselError(reason, hint="Choose another method, such as regularised-cubic.")
        return replace(method.fit(data), method=method)


def _with_heights(features: FeatureSet) -> FeatureSet:
    """Return the features without those that lack a height, if the others have them; say so."""
    # As a run does: otherwise one blank height would cost all heights.
    blank = to_leave_out(features)
    if not blank:
        return features
    log.warning("Note: %s", note_on_blank(blank, features))
    return with_roles(features, dict.fromkeys(blank, "off"))


def _refuse_unknown(options: Mapping[str, Any], model: type[SensorModel]) -> None:
    """Raise TermselError for an option that the model has not, with models that have it, if any."""
    names = [option.name for option in model.declared_options]
    for key in options:
        if key not in names:
            # Where no model is named, another one may be meant.
            kind, *owners = owners_of_options().get(key, ("",))
            hint = ""
            if key == "options":
                known = f"{names[0]}=VALUE" if names else "a model that has some"
                hint = f"Options are arguments of their own here: {known}."
            elif kind == "model":
                hint = f"{first_names_in_words(owners, 3)} have it: model={owners[0]!r}."
            error = unknown_name_error("option", key, [*names, "crs", "columns"], hint)
            error.what = f"{error.what} of the model {model.name!r}"
            raise error


def _refuse(options: dict[str, Any], subject: str) -> None:
    """Raise TermselError for options of something that takes none."""
    if options:
        raise TermselError(f"{subject} takes no option {next(iter(options))!r}",
                           hint="Give options with the name or the class of a model.")
