"""Any regressor of scikit-learn as a method of termsel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.base import clone

from termsel import FeatureSet, FunctionMethod, TermselError, Undetermined
from termsel_sklearn.arrays import FloatArray


@dataclass(frozen=True)
class _Fitting:
    """The function of a method: fits a copy of a regressor to points, and returns its projection.

    It raises Undetermined if there are lines, or if the regressor refuses the points.
    """

    regressor: Any

    def __call__(self, features: FeatureSet) -> Any:
        """Return the projection of a regressor fitted to features: ground (n, 3) to image (n, 2).

        Raises Undetermined for lines, and if the regressor refuses the points.
        """
        points = features.points
        if len(features.lines):
            raise Undetermined("regressors take points alone, and there are lines",
                               hint="Leave the lines out, or choose another method.")
        # If any point has no height, the regressor gets X and Y alone.
        columns = 2 if np.isnan(points.ground[:, 2]).any() else 3
        ground_middle = points.ground[:, :columns].mean(axis=0)
        ground_size = np.ptp(points.ground[:, :columns], axis=0)
        # Regularisation and kernels assume coordinates and positions of about 1.
        ground_half_size = np.where(ground_size > 0.0, ground_size / 2, 1.0)
        # Points at one place have no extent to divide by.
        image_middle, image_size = points.image.mean(axis=0), float(np.ptp(points.image)) or 1.0
        regressor = clone(self.regressor)
        try:
            regressor.fit((points.ground[:, :columns] - ground_middle) / ground_half_size,
                          (points.image - image_middle) / image_size)
        except ValueError as error:
            raise Undetermined(f"{type(regressor).__name__} fits nothing: {error}",
                               hint="Measure more, or choose another regressor.") from error

        def project(ground: FloatArray) -> FloatArray:
            """Return image positions [px] of ground points (n, 3), shape (n, 2).

            They are NaN where a coordinate that the regressor uses is not known.
            """
            scaled = (ground[:, :columns] - ground_middle) / ground_half_size
            image = np.full((len(ground), 2), np.nan)
            is_known = np.isfinite(scaled).all(axis=1)
            if is_known.any():
                image[is_known] = image_middle + image_size * regressor.predict(scaled[is_known])
            return image

        return project


def regressor_method(regressor: Any, name: str = "", title: str = "") -> FunctionMethod:
    """Return a regressor of scikit-learn as a method of termsel.

    It is then fitted, held out, and compared with the models of termsel as any method is.

    Parameters
    ----------
    regressor : estimator
        One that predicts two values, such as a pipeline that ends with `Ridge`. It gets ground
        coordinates scaled to about [-1, 1], x and y, and z where all points have heights.
    name, title : str, optional
        As for `termsel.Method`; by default those of the regressor's class.

    Returns
    -------
    termsel.FunctionMethod
        A method that raises `termsel.Undetermined` for features with lines.

    Raises
    ------
    TermselError
        For a class, and for what has no ``predict``.

    Examples
    --------
    >>> import termsel
    >>> from sklearn.linear_model import LinearRegression
    >>> from termsel_sklearn import regressor_method
    >>> scene = termsel.simulate_scene("ikonos-hamedan", n_points=20, n_lines=0)
    >>> result = termsel.run(features=scene, method=regressor_method(LinearRegression()))
    >>> result.strategy.chosen
    'LinearRegression'
    """
    if isinstance(regressor, type) or not hasattr(regressor, "predict"):
        name = getattr(regressor, "__name__", type(regressor).__name__)
        raise TermselError(f"regressor is {regressor!r:.100}, expected an estimator",
                           hint=f"Give one with options of its own: regressor_method({name}())."
                           if isinstance(regressor, type) else
                           "Such as regressor_method(LinearRegression()).")
    kind = type(regressor).__name__
    return FunctionMethod(name or kind, title or f"a {kind} of scikit-learn",
                          function=_Fitting(regressor))
