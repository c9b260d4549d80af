"""Criteria: how good a population of fitted models is."""

from termsel.fitting.population import Fits
from termsel.selection.criteria.base import CheckRmse, Criterion
from termsel.selection.criteria.cross_validation import KFold, Press
from termsel.selection.criteria.information import Ebic
from termsel.selection.criteria.robust import Huber, Median

__all__ = ["CheckRmse", "Criterion", "Ebic", "Fits", "Huber", "KFold", "Median", "Press"]
