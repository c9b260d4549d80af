"""Options of reading for old maps: the meridian that longitudes count from, and the projection."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from termsel import FeatureSet, Option, TermselError
from termsel.toolkit import ONCE, FloatArray
from termsel.toolkit.coordinates import is_geographic, normalise, to_wgs84
from termsel_cameras.roles import without_independent
from termsel_cameras.sheets.candidates import (
    Projection,
    candidate_projections,
    projections_of_file,
)
from termsel_cameras.sheets.meridians import MERIDIANS, meridian_of

if TYPE_CHECKING:
    from termsel_cameras.sheets.choosing import Tried

log = logging.getLogger("termsel.cameras")

AUTO = "auto"
_N_RIVALS = 2

SHEET_OPTIONS = (
    Option("prime_meridian", None, "Meridian that longitudes of the points count from: "
           f"{', '.join(MERIDIANS)}, or degrees from Greenwich."),
    Option("series", None, "File of the series that a map is a sheet of, by termsel map-series: "
           "its projection is taken, and a sheet of few points borrows what the others show of the "
           "paper."),
    Option("projection", None, "Projection that a map was drawn in, in which its model is fitted: "
           "a CRS, or auto for the one that predicts the points best."),
    Option("projection_candidates", None, "File of the projections that auto chooses from, a CRS a "
           "line. By default those that maps of such places were drawn in."),
    Option("map_century", None, "Century of the map, such as 18: auto tries what was used then.",
           int, 15, 21))


class SheetOptions:
    """Options of reading that say in what coordinates an old map was drawn."""

    options = SHEET_OPTIONS

    def read(self, features: FeatureSet, options_given: Mapping[str, Any],
             image: Path | str | None) -> FeatureSet:
        """Return features with longitudes from Greenwich, and with the projection of the map.

        `options_given` has the options that the user gave; `image` is not used. The projection
        becomes `fit_crs`, in which the model is fitted; coordinates stay as they are. It is the one
        that is stated, that of a series, or one that "auto" chooses by cross-validation; without
        any, features keep their own. Raises TermselError for options that do not go together.
        """
        values = {option.name: option.parse(options_given[option.name]) for option in SHEET_OPTIONS
                  if options_given.get(option.name) is not None}
        if "prime_meridian" in values:
            meridian = meridian_of(values["prime_meridian"])
            features = from_greenwich(features, meridian)
            if meridian == meridian_of("paris") and "x" not in features.named_units:
                log.warning("Note: longitudes and latitudes are taken for degrees. Many French "
                            "maps that count from Paris are in grads, 100 to a right angle: if "
                            "this one is, name the columns lon_gon and lat_gon.",
                            extra={ONCE: "grads"})
        if "series" in values:
            return _sheet_of_series(features, values)
        if (values.keys() & {"projection_candidates", "map_century"}
                and values.get("projection") != AUTO):
            raise TermselError("candidates and century are for a projection that is chosen",
                               hint="Add --set projection=auto, or --crs auto.")
        if "projection" not in values:
            return features
        if values["projection"] != AUTO:
            return replace(features, fit_crs=normalise(values["projection"]))
        from termsel_cameras.sheets.choosing import (  # it fits models
            first_of_the_best,
            rank_projections,
        )

        candidates = candidates_of([features], values.get("projection_candidates"),
                                   values.get("map_century"))
        ranked = rank_projections([features], candidates)
        best = first_of_the_best(ranked, candidates)
        log.warning("Note: of %d projections %s Coordinates stay in %s.", len(ranked),
                    _projection_in_words(ranked, best), features.crs)
        return replace(features, fit_crs=normalise(best.crs))


def _projection_in_words(ranked: Sequence[Tried], chosen: Tried) -> str:
    """Return sentences on the chosen projection, and how well it and its rivals predict.

    `ranked` are all that were tried, the best first. `chosen` is the best, or the first candidate
    that is nearly as good.
    """
    from termsel_cameras.sheets.choosing import NEARLY_BEST

    def errors_in_words(projections: Sequence[Tried]) -> str:
        """Return the names of projections with the RMSE of their predictions."""
        return ", ".join(f"{projection.name} {projection.rmse:.3g} px"
                         for projection in projections)

    best = ranked[0]
    if best is chosen:
        return (f"{chosen.name} predicts the points best: {chosen.rmse:.3g} px "
                f"({errors_in_words(ranked[1:1 + _N_RIVALS])}).")
    return (f"{chosen.name} is taken: {chosen.rmse:.3g} px. Of those that predict within "
            f"{100 * (NEARLY_BEST - 1.0):.0f} % of the best ({errors_in_words([best])}) it is the "
            "first of the list.")


def _sheet_of_series(features: FeatureSet, values: Mapping[str, Any]) -> FeatureSet:
    """Return a sheet with the projection and the paper of the series in `values["series"]`, a file.

    A note is logged if the other sheets are no series. Raises TermselError if options state or
    choose a projection, too, if the file is none, or if no other sheet shows its paper.
    """
    from termsel_cameras.sheets.paper import reason_against
    from termsel_cameras.sheets.series_file import (  # it fits models
        read_series,
        with_series_columns,
    )

    if idle_options := values.keys() & {"projection", "projection_candidates", "map_century"}:
        raise TermselError("the file of a series has its projection, so "
                           f"{min(idle_options)} has no use",
                           hint="Leave one of them out.")
    series = read_series(values["series"])
    if reason := reason_against(series.paper_for(features)):
        log.warning("Note: %s lends no paper: %s.", values["series"], reason)
    return with_series_columns(features, series)


def from_greenwich(features: FeatureSet, meridian: float) -> FeatureSet:
    """Return features with longitudes from Greenwich, where they count from `meridian` [deg].

    Raises
    ------
    TermselError
        If the ground coordinates are no degrees.
    """
    if not is_geographic(features.crs):
        raise TermselError(f"longitudes in degrees have a prime meridian, not {features.crs}",
                           hint="Leave the prime meridian out: coordinates of maps count from that "
                                "of their CRS.")
    longitudes = without_independent(features).ground_vertices()[:, 0]
    # Whole turns are taken off, so that most longitudes are from -180 to 180.
    middle = np.median(longitudes) + meridian if len(longitudes) else 0.0
    turns = np.floor((middle + 180.0) / 360.0)
    shift = [meridian - 360.0 * turns, 0.0, 0.0]
    points = replace(features.points, ground=features.points.ground + shift)
    lines = replace(features.lines, ground=features.lines.ground + shift)
    return features.with_(points=points, lines=lines)


def candidates_of(sheets: list[FeatureSet], file: str | None,
                  century: int | None) -> list[Projection]:
    """Return the projections to choose from: those in `file`, or by the sheets and the century."""
    if file is not None:
        return projections_of_file(file)
    return candidate_projections(corners_of_sheets(sheets), century)


def corners_of_sheets(sheets: list[FeatureSet]) -> FloatArray:
    """Return the south-western and north-eastern corner of all sheets (2, 2).

    Rows are longitude and latitude on WGS84 [deg]. Across 180 degrees the eastern longitude is
    larger than that. Independent points take no part, as the corners decide what is tried.

    Raises
    ------
    TermselError
        If no sheet has features that take part.
    """
    vertices = []
    for sheet in map(without_independent, sheets):
        ground = sheet.ground_vertices().copy()
        ground[:, 2] = 0.0
        vertices.append(to_wgs84(sheet.crs)(ground)[:, :2])
    degrees = np.concatenate(vertices)
    if not len(degrees):
        raise TermselError("no map has control points, which show what projections to try",
                           hint="Measure control points, or state the projection.")
    # All longitudes are brought to within half a turn of the first.
    first = degrees[0, 0]
    degrees[:, 0] = first + (degrees[:, 0] - first + 180.0) % 360.0 - 180.0
    return np.stack([degrees.min(axis=0), degrees.max(axis=0)])
