"""The algorithms of the provider."""

from .georeference import Georeference, SelectLines
from .results import ExportModel, NextPlaces, Rectify, Report, Uncertainty
from .setup import SetUp
from .several import AdjustBlock, MatchReference

ALGORITHMS = (Georeference, SelectLines, Rectify, ExportModel, Report, NextPlaces, Uncertainty,
              MatchReference, AdjustBlock, SetUp)
