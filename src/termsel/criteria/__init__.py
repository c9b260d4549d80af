"""Criteria: how good a population of fitted models is."""

from termsel.criteria.base import CheckRmse, Criterion, Fits
from termsel.criteria.cross_validation import KFold, Press
from termsel.criteria.information import Ebic
from termsel.criteria.robust import Huber, Median

__all__ = ["CheckRmse", "Criterion", "Ebic", "Fits", "Huber", "KFold", "Median", "Press"]
