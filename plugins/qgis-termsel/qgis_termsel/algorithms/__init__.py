"""The algorithms of the provider."""

from .georeference import Georeference, SelectLines
from .results import ExportModel, NextPlaces, Rectify, Report
from .setup import SetUp
from .several import AdjustBlock, MatchReference

ALGORITHMS = (Georeference, SelectLines, Rectify, ExportModel, Report, NextPlaces, MatchReference,
              AdjustBlock, SetUp)
