"""Criteria: how good a population of fitted models is."""

from termsel.criteria.base import POLE_MARGIN, CheckRmse, Criterion, Fits
from termsel.criteria.cross_validation import KFold, Press
from termsel.criteria.information import Ebic

__all__ = ["POLE_MARGIN", "CheckRmse", "Criterion", "Ebic", "Fits", "KFold", "Press"]
