"""A sensor model as a regressor from ground to image."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from termsel.candidates.ridge import RidgeByOrder
from termsel.candidates.robust import Reweighted
from termsel.candidates.selected import ForwardSelection
from termsel.candidates.shrunken import Averaging
from termsel.candidates.structures import Structure
from termsel.errors import TermselError
from termsel.fits.fit import Estimator
from termsel.fits.least_squares import LEAST_SQUARES
from termsel.measurements.features import FeatureSet, FloatArray, Points
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial2D, Polynomial3D
from termsel.plugins.registry import registry

STRATEGIES: dict[str, Estimator] = {
    "least-squares": LEAST_SQUARES, "ridge": RidgeByOrder(), "shrunken": Averaging(),
    "selected": ForwardSelection(), "huber": Reweighted(biweight=False),
    "tukey": Reweighted(biweight=True)}
"""How coefficients are found, by name."""


class SensorModelRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Predict line and sample from ground coordinates.

    Parameters
    ----------
    model : str
        Name of a sensor model, such as "rfm"; "polynomial" is that of X, Y and Z where heights
        differ, and otherwise that of X and Y.
    degree : int or None
        Option of polynomials; None for the model's own default.
    strategy : {"least-squares", "ridge", "shrunken", "selected", "huber", "tukey"}
        How coefficients are found. "shrunken" averages polynomials of degree 2 or more by their
        posterior probability; "selected" selects their terms forward; "huber" and "tukey" are
        robust.
    options : dict or None
        Further options of the model.

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
    >>> from termsel.sklearn import SensorModelRegressor
    >>> points = termsel.simulate_scene("ikonos-hamedan").points
    >>> model = SensorModelRegressor(degree=1).fit(points.ground, points.image)
    >>> model.predict(points.ground).shape == points.image.shape
    True
    """

    def __init__(self, model: str = "polynomial", degree: int | None = None,
                 strategy: str = "least-squares", options: dict[str, Any] | None = None) -> None:
        self.model = model
        self.degree = degree
        self.strategy = strategy
        self.options = options

    def fit(self, X: Any, y: Any) -> SensorModelRegressor:
        """Fit the model to control points.

        Parameters
        ----------
        X : array_like, shape (n, 2) or (n, 3)
        y : array_like, shape (n, 2) or (n,)

        Raises
        ------
        ValueError
            If the points do not determine the model, or a parameter is not known.
        """
        X, y = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64,
                             ensure_min_samples=2, ensure_min_features=2)
        image = np.asarray(y, dtype=np.float64).reshape(len(X), -1)
        if X.shape[1] not in (2, 3) or image.shape[1] not in (1, 2):
            raise ValueError(f"X has {X.shape[1]} columns and y {image.shape[1]}; ground "
                             "coordinates have 2 or 3, image coordinates 1 or 2")
        if self.strategy not in STRATEGIES:
            raise ValueError(f"strategy is {self.strategy!r}; it is one of "
                             f"{', '.join(STRATEGIES)}")
        self._columns = None if np.ndim(y) == 1 else image.shape[1]
        # One image coordinate stands for both, of which `predict` returns one.
        points = Points(tuple(f"{i}" for i in range(len(X))),
                        np.broadcast_to(image, (len(X), 2)), _ground(X))
        try:
            high, flat = self._models()
            if self.strategy in ("shrunken", "selected") and (flat.polynomial_degree or 0) < 2:
                raise ValueError(f"strategy {self.strategy!r} needs a polynomial of at least "
                                 "degree 2")
            self.fit_ = Structure(
                self.model, f"model {self.model!r}", high, flat,
                estimator=STRATEGIES[self.strategy]).fit(FeatureSet(points, crs="local"))
        except TermselError as error:
            raise ValueError(str(error)) from error
        return self

    def predict(self, X: Any) -> FloatArray:
        """Return image coordinates of ground points, in the shape of y.

        Parameters
        ----------
        X : array_like, shape (n, 2) or (n, 3)
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        image: FloatArray = self.fit_.project(_ground(X))
        return image[:, 0] if self._columns is None else image[:, :self._columns]

    def _models(self) -> tuple[SensorModel, SensorModel]:
        """Return the model for points with heights that differ, and for others."""
        options = {**({} if self.degree is None else {"degree": self.degree}),
                   **(self.options or {})}
        if self.model == "polynomial":
            return Polynomial3D(**options), Polynomial2D(**options)
        model: SensorModel = registry().get("models", self.model)(**options)
        return model, model


def _ground(X: FloatArray) -> FloatArray:
    """Return ground coordinates with a third column, which is not known where X has two."""
    return X if X.shape[1] == 3 else np.column_stack([X, np.full(len(X), np.nan)])
