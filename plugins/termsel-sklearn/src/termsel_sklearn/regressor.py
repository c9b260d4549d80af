"""A sensor model as a regressor from ground to image."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from sklearn.base import MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from termsel import (
    Auto,
    Estimator,
    FeatureSet,
    Method,
    Points,
    Polynomial2D,
    Polynomial3D,
    SensorModel,
    Structure,
    TermselError,
    estimator,
    fit,
    get,
)
from termsel_sklearn.arrays import FloatArray
from termsel_sklearn.parts import WithOptions, weights_of

STRATEGIES: dict[str, Estimator] = {
    "least-squares": estimator("least-squares"), "ridge": estimator("ridge-by-order"),
    "regularised": estimator("averaging"), "selected": estimator("forward-selection"),
    "huber": estimator("reweighted", biweight=False),
    "tukey": estimator("reweighted", biweight=True)}
"""How coefficients are found, by name."""

EXPECTED_FAILED_CHECKS = dict.fromkeys((
    "check_n_features_in_after_fitting", "check_positive_only_tag_during_fit",
    "check_estimators_dtypes", "check_dtype_object", "check_regressors_train",
    "check_regressor_data_not_an_array", "check_regressor_multioutput",
    "check_regressors_no_decision_function", "check_regressors_int",
    "check_sample_weight_equivalence_on_dense_data", "check_all_zero_sample_weights_error"),
    "its data have 4, 5 or 10 columns, or 5 outputs, which no sensor model takes")
"""Checks of scikit-learn that `SensorModelRegressor` fails, with the reason, as ``check_estimator``
takes them; `TermSelector` fails none."""


class SensorModelRegressor(MultiOutputMixin, RegressorMixin, WithOptions):  # type: ignore[misc]
    """Predict line and sample from ground coordinates.

    Parameters
    ----------
    model : str, class or SensorModel
        A sensor model, such as "rfm"; "polynomial" is that of X, Y and Z where heights
        differ, and otherwise that of X and Y.
    degree : int or None
        Option of polynomials; None for the model's own default.
    strategy : {"least-squares", "ridge", "regularised", "selected", "huber", "tukey"} or a method
        How the coefficients of the model are found. "regularised" averages polynomials of degree 2
        or more by their posterior probability; "selected" selects their terms forward; "huber" and
        "tukey" are robust. Or a `termsel.Method`, or the name of one (``termsel list methods``)
        such as "auto": it has models of its own.
    options : dict or None
        Further options of the model. ``set_params`` and grids also take each by its name, such as
        ``set_params(order=2)`` of "rfm".

    Attributes
    ----------
    fit_ : termsel.Fit
        The fitted model, with residuals, standard deviations and `locate`.
    n_features_in_ : int
        2 or 3.

    Notes
    -----
    X holds x, y and optionally z in the units of one CRS, shape (n, 2) or (n, 3); y holds line and
    sample [px], shape (n, 2), or one image coordinate.

    Examples
    --------
    >>> import termsel
    >>> from termsel_sklearn import SensorModelRegressor
    >>> points = termsel.simulate_scene("ikonos-hamedan").points
    >>> model = SensorModelRegressor(degree=1).fit(points.ground, points.image)
    >>> round(model.score(points.ground, points.image), 6)  # R^2
    0.999999
    """

    extension = "model"
    attributes_elsewhere: ClassVar[Mapping[str, str]] = {
        "coef_": "They are fit_.coefficients, of scaled coordinates.",
        "intercept_": "It is in fit_.coefficients.",
        "residuals_": "They are fit_.residuals.", "result_": "termsel.run returns a result.",
        "project": "It is predict(X).", "transform": "It is predict(X).",
        "locate": "It is fit_.locate(image, heights).", "sigma": "It is fit_.sigma(ground)."}

    def __init__(self, model: Any = "polynomial", degree: int | None = None,
                 strategy: str | Method = "least-squares",
                 options: dict[str, Any] | None = None) -> None:
        self.model = model
        self.degree = degree
        self.strategy = strategy
        self.options = options

    def fit(self, X: Any, y: Any, sample_weight: Any = None) -> SensorModelRegressor:
        """Fit the model to control points.

        Parameters
        ----------
        X : array_like, shape (n, 2) or (n, 3)
            Ground coordinates x, y and z.
        y : array_like, shape (n, 2) or (n,)
        sample_weight : array_like, shape (n,), optional
            Weights of the points, 1 / sigma^2 up to a common factor; points with 0 are left out.
            Points of one place count as one, with their mean and the sum of their weights.

        Returns
        -------
        SensorModelRegressor
            Itself, fitted.

        Raises
        ------
        ValueError
            If the points do not determine the model, if a parameter is not known, or if columns of
            tables are called x, y, z or line, sample in another order.
        """
        _require_order("X", X, ("x", "y", "z"))
        _require_order("y", y, ("line", "sample"))
        X, y = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64,
                             ensure_min_samples=2, ensure_min_features=2)
        image = np.asarray(y, dtype=np.float64).reshape(len(X), -1)
        if X.shape[1] not in (2, 3) or image.shape[1] not in (1, 2):
            remedy = (". Give X without PolynomialFeatures: the model makes its own terms"
                      if X.shape[1] > 3 else "")
            raise ValueError(f"X has {X.shape[1]} columns and y {image.shape[1]}; ground "
                             f"coordinates have 2 or 3, image coordinates 1 or 2{remedy}")
        if isinstance(self.model, str) and self.model in STRATEGIES:
            raise ValueError(f"model is {self.model!r}, which is a strategy: write "
                             f"strategy={self.model!r} beside a model")
        method = self._method_or_strategy()
        self._n_image_columns = None if np.ndim(y) == 1 else image.shape[1]
        # A model has two image coordinates: a single one is fitted as both, and predicted once.
        image = np.broadcast_to(image, (len(X), 2))
        positions, image, weights = _merge_points(X, image, weights_of(sample_weight, X))
        # Only ratios of weights are known, so equal weights say nothing of standard deviations.
        if np.ptp(weights) == 0:
            sigma = None
        else:
            sigma = np.column_stack([np.sqrt(weights.mean() / weights)] * 2)
        try:
            points = Points(tuple(f"{i}" for i in range(len(positions))), image,
                            _ground_with_heights(positions),
                            sigma)
            features = FeatureSet(points, crs="local")
            if method is not None:
                self.fit_ = fit(features, method)
                return self
            # `Structure` takes the plane model where heights are all alike or absent.
            model_with_height, plane_model = self._models_by_dimension()
            degree = plane_model.polynomial_degree or 0
            if self.strategy in ("regularised", "selected") and degree < 2:
                raise ValueError(f"strategy {self.strategy!r} needs a polynomial of at least "
                                 "degree 2")
            self.fit_ = fit(features, Structure(
                plane_model.name, f"model {plane_model.name!r}", model_with_height, plane_model,
                estimator=STRATEGIES[str(self.strategy)]))
        except TermselError as error:
            raise ValueError(_in_words_of_sklearn(str(error))) from error
        return self

    def predict(self, X: Any) -> FloatArray:
        """Return image coordinates of ground points, in the shape of y.

        Parameters
        ----------
        X : array_like, shape (n, 2) or (n, 3)
            Ground coordinates x, y and z.

        Returns
        -------
        ndarray, shape (n, 2), (n, 1) or (n,)
            Line and sample [px], or the one coordinate that the model was fitted to.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        ground = _ground_with_heights(X)
        image: FloatArray = self.fit_.project(ground)
        if remark := self.fit_.remark_on(ground):
            warnings.warn(remark, UserWarning, stacklevel=2)
        return image[:, 0] if self._n_image_columns is None else image[:, :self._n_image_columns]

    def _method_or_strategy(self) -> Method | None:
        """Return the method that `strategy` is or names; None if it names one of `STRATEGIES`.

        Raises ValueError for a name that is neither.
        """
        if isinstance(self.strategy, Method):
            return self.strategy
        if self.strategy in STRATEGIES:
            return None
        try:
            return Auto() if self.strategy == "auto" else get("methods", self.strategy)
        except TermselError as error:
            raise ValueError(f"strategy is {self.strategy!r}; it is one of "
                             f"{', '.join(STRATEGIES)}, a termsel.Method or the name of one"
                             ) from error

    def _models_by_dimension(self) -> tuple[SensorModel, SensorModel]:
        """Return the model for points whose heights differ, and the one for other points.

        Both are the same unless `model` is "polynomial".
        """
        degree = {} if self.degree is None else {"degree": self.degree}
        if isinstance(self.model, str) and self.model == "polynomial":
            options = {**degree, **self._given_options()}
            return Polynomial3D(**options), Polynomial2D(**options)
        model: SensorModel = self._make_extension(**degree)
        return model, model

    def _given_extension(self) -> Any:
        """Return the class or instance of the model; for "polynomial" that of X, Y and Z."""
        polynomial = isinstance(self.model, str) and self.model == "polynomial"
        return Polynomial3D if polynomial else super()._given_extension()


def _in_words_of_sklearn(text: str) -> str:
    """Return a message with parameters of the regressor in place of options of the command line."""
    for option, parameter in (("--method", "strategy"), ("--model", "model")):
        text = re.sub(rf"{option} ([\w-]+)", rf"{parameter}='\1'", text)
    return text


def _merge_points(X: FloatArray, image: FloatArray, weights: FloatArray,
                  ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points without those of weight 0, and those at one ground position as one point.

    Parameters
    ----------
    X : ndarray, shape (n, 2) or (n, 3)
        Ground coordinates.
    image : ndarray, shape (n, 2)
        Image positions.
    weights : ndarray, shape (n,)

    Returns
    -------
    X, image, weights : ndarray
        The same of the m points that are left, in the order in which they first occur. The image
        position of a merged point is the weighted mean of theirs, and its weight their sum.
    """
    is_used = weights > 0
    X = X[is_used]
    image = image[is_used]
    weights = weights[is_used]
    _, first, place_of = np.unique(X, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(X):
        return X, image, weights
    # In the order in which they first occur.
    order = np.argsort(first)
    place_of = np.argsort(order)[place_of.ravel()]
    # Weights of points of one place add up, and their positions are averaged by them.
    total_weights = np.bincount(place_of, weights).astype(np.float64)
    mean_positions = np.column_stack([np.bincount(place_of, weights * coordinate) / total_weights
                                      for coordinate in image.T])
    return X[first[order]], mean_positions, total_weights


def _ground_with_heights(X: FloatArray) -> FloatArray:
    """Return ground coordinates with a third column, which is not known where X has two."""
    return X if X.shape[1] == 3 else np.column_stack([X, np.full(len(X), np.nan)])


def _require_order(argument: str, table: Any, expected: tuple[str, ...]) -> None:
    """Raise ValueError for a table whose columns have the expected names in another order.

    Columns are taken by their places, so that names would be no help but mislead. Two columns or
    more of these names alone count; others may be called anything.
    """
    names = [str(name).strip().casefold() for name in getattr(table, "columns", ())]
    if len(names) > 1 and set(names) <= set(expected) and names != list(expected[:len(names)]):
        in_order = list(expected[:len(names)])
        raise ValueError(f"the columns of {argument} are {names}, expected {in_order}: they are "
                         f"taken by their places. Give TABLE[{in_order}].")
