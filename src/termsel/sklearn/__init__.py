"""Sensor models and the selection of terms as estimators of scikit-learn.

Requires ``pip install termsel[sklearn]``.
"""

from termsel.sklearn.blocks import spatial_blocks
from termsel.sklearn.regressor import EXPECTED_FAILED_CHECKS, SensorModelRegressor
from termsel.sklearn.selector import TermSelector

__all__ = ["EXPECTED_FAILED_CHECKS", "SensorModelRegressor", "TermSelector", "spatial_blocks"]
