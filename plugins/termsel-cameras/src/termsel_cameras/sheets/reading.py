"""Options of reading for old maps: the meridian that longitudes count from, and the projection."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from termsel import FeatureSet, Option, TermselError
from termsel.toolkit import ONCE
from termsel.toolkit.coordinates import is_geographic, normalise
from termsel_cameras.roles import without_independent
from termsel_cameras.sheets.candidates import candidates_of
from termsel_cameras.sheets.meridians import MERIDIANS, meridian_of

if TYPE_CHECKING:
    from termsel_cameras.sheets.choosing import Choice

log = logging.getLogger("termsel.cameras")

AUTO = "auto"
_N_RIVALS = 2
_N_LISTED = 4

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
        that is stated, that of a series, or the one that "auto" finds most probable (see
        `choose_by_points`); without any, features keep their own. Raises TermselError for options
        that do not go together, and for a meridian or a projection that is none.
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
        # Without a projection of the map the model is fitted in the coordinates of the points.
        if "projection" not in values:
            return features
        if values["projection"] != AUTO:
            return replace(features, fit_crs=normalise(values["projection"]))
        # Only a choice fits models, whose modules take long to import.
        from termsel_cameras.sheets.choosing import choose_by_points

        candidates = candidates_of([features], values.get("projection_candidates"),
                                   values.get("map_century"))
        choice = choose_by_points([features], candidates)
        log.warning("Note: %s Coordinates stay in %s.", choice_in_words(choice), features.crs)
        return replace(features, fit_crs=normalise(choice.chosen.crs))


def choice_in_words(choice: Choice) -> str:
    """Return sentences on the chosen projection, its rivals, and whether the points show it."""
    chosen = choice.chosen
    count = len(choice.ranked)
    others = [projection.name for projection in choice.as_probable if projection is not chosen]
    if others:
        listed = others if len(others) <= _N_LISTED else [
            *others[:_N_LISTED - 1], f"{len(others) - _N_LISTED + 1} others"]
        return (f"of {count} projections the points do not tell {chosen.name} from "
                f"{', '.join(listed[:-1])}{' or ' if len(listed) > 1 else ''}{listed[-1]}. "
                f"{chosen.name} is taken: its map differs least from those in the others, by "
                f"{choice.apart:.2g} px (RMS by how probable they are).")
    rivals = ", ".join(f"{projection.name} {projection.rmse:.3g} px"
                       for projection in choice.ranked[1:1 + _N_RIVALS])
    predicted = f"{chosen.rmse:.3g} px{f' ({rivals})' if rivals else ''}."
    if all(chosen.rmse <= projection.rmse for projection in choice.ranked):
        return f"of {count} projections {chosen.name} predicts the points best: {predicted}"
    return (f"of {count} projections {chosen.name} is most probable, by the points and by how "
            f"little it stretches the paper: it predicts them within {predicted}")


def _sheet_of_series(features: FeatureSet, values: Mapping[str, Any]) -> FeatureSet:
    """Return a sheet with the projection and the paper of the series in `values["series"]`, a file.

    If the other sheets contradict their projection, the sheet is returned as it is; if they are no
    series, it states their paper, which the method for series then declines. Both are noted. Raises
    TermselError if options state or choose a projection, too, if the file is none, or if no other
    sheet shows its paper.
    """
    # These modules fit models, and so take long to import.
    from termsel_cameras.sheets.paper import reason_against
    from termsel_cameras.sheets.series_file import read_series, with_series_columns

    if idle_options := values.keys() & {"projection", "projection_candidates", "map_century"}:
        raise TermselError("the file of a series has its projection, so "
                           f"{min(idle_options)} has no use",
                           hint="Leave one of them out.")
    series = read_series(values["series"])
    if series.contradicted_by:
        log.warning("Note: %s lends nothing, and the map is fitted by itself: its sheets "
                    "contradict the projection that was stated for them, and are far more probable "
                    "in another (%s).", values["series"], series.contradicted_by,
                    extra={ONCE: "a series that is contradicted"})
        return features
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
