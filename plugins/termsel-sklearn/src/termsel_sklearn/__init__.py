"""Sensor models and the selection of terms as estimators of scikit-learn."""

from termsel_sklearn.blocks import spatial_blocks
from termsel_sklearn.method import regressor_method
from termsel_sklearn.regressor import EXPECTED_FAILED_CHECKS, SensorModelRegressor
from termsel_sklearn.selector import TermSelector

__all__ = ["EXPECTED_FAILED_CHECKS", "SensorModelRegressor", "TermSelector", "regressor_method",
           "spatial_blocks"]
