"""Where to measure next, for a result and places from a table or on a grid."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from termsel.core.errors import TermselError, count_in_words, first_names_in_words
from termsel.data.features import FloatArray
from termsel.fitting.fit import Fit
from termsel.fitting.next_places import rank_places
from termsel.fitting.scene import scene_grid
from termsel.formats.readers.csv_tables import table_text
from termsel.io.project import GIVE_HEIGHTS, read_ground

if TYPE_CHECKING:
    from termsel.results.result import Result

log = logging.getLogger(__name__)

COLUMNS = ("id", "line", "sample", "x", "y", "z", "uncertainty_px")
GRID = 20
"""Places along either side of the image on which the uncertainty is averaged."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Places in the order in which they should be measured.

    The columns of `values`, shape (n, 6), are line and sample [px], x, y and z, and the root mean
    square uncertainty of a position over the scene once the place is measured, and those before it
    [px]; it is `sigma_before` before [px]. They are those of `Fit.sigma`, but of a local model,
    which is taken for the polynomial of its control: the mean of its own `sigma` differs.
    """

    ids: tuple[str, ...]
    values: FloatArray
    sigma_before: float
    crs: str

    def to_csv(self) -> str:
        """Return the plan as CSV headed by COLUMNS."""
        return table_text(self.crs, list(COLUMNS), [[name] for name in self.ids], self.values)


def _warn_of_unknown_size(fitted: Fit) -> None:
    """Warn that places may be outside the image, if only its RPC shows how large it is."""
    features = fitted.control
    if features.image_size is None and features.rpc is not None and "rpc" in fitted.model.options:
        (first_line, first_sample), (last_line, last_sample) = fitted.image_box()
        log.warning("Note: the size of the image is not known. By the scale of its RPC it is taken "
                    "as lines %.0f to %.0f and samples %.0f to %.0f; positions may be outside "
                    "it. Give --image FILE to termsel run to state it.", first_line, last_line,
                    first_sample, last_sample)


def plan(result: Result, count: int, candidates: Path | None = None) -> Plan:
    """Return the places where further points lessen the uncertainty over the scene most.

    The places to choose from are those of the table `candidates`, id,x,y,z; by default a grid over
    the image, with the height of the nearest control. Candidates that the image does not show, or
    that are control already, are told by warnings. Raises TermselError if the table cannot be read
    or has no place in the image, or the uncertainty of the model is not known.
    """
    fitted = result.fit
    _warn_of_unknown_size(fitted)
    scene = scene_grid(fitted, GRID)[1]
    scene = scene[np.isfinite(scene).all(axis=1)]
    if candidates is None:
        ids = tuple(f"N{i + 1:03d}" for i in range(len(scene)))
        positions = scene
    else:
        try:
            named, positions = read_ground(result, candidates)
        except TermselError as error:
            # There is no option of a DEM or of columns here.
            if error.code == "column-missing":
                header = "id,x,y,z" if fitted.model.uses_height else "id,x,y"
                error.hint = f"Rename the columns in the file: {header}."
                error.options.clear()
            elif error.code == "height-missing":
                error.hint = (error.hint or "").replace(
                    GIVE_HEIGHTS, "Give heights in the file, in a column named z. termsel project "
                                  "with --dem FILE, or --height H, writes a table that has them.")
            raise
        ids = tuple(named)
    image = fitted.project(positions)
    is_seen = np.isfinite(image).all(axis=1)
    size = fitted.control.image_size
    if candidates is not None and size is not None:
        with np.errstate(invalid="ignore"):
            is_seen &= ((image > -0.5) & (image < np.array(size) - 0.5)).all(axis=1)
    if not is_seen.any() or not len(scene):
        raise TermselError("the image shows none of the positions", file=candidates,
                           hint="Give positions in the CRS of the control, inside the scene.")
    if candidates is not None and not is_seen.all():
        _say_unseen([ids[number] for number in np.flatnonzero(~is_seen)])
    numbers = np.flatnonzero(is_seen)
    # The scene itself where all of it is seen, so that its figures are computed once.
    choices = scene if positions is scene and is_seen.all() else positions[numbers]
    ranking = rank_places(fitted, choices, scene, count)
    # What all images of a block share is lessened by no further point.
    shared = float(np.linalg.norm(result.shared_sigma or 0.0))
    best_positions = positions[numbers[ranking.order]]
    if np.isnan(fitted.control.ground_vertices()[:, 2]).any():
        # The grid of a plane model has a height for the sake of arithmetic.
        best_positions[:, 2] = np.nan
    names = tuple(ids[i] for i in numbers[ranking.order])
    if candidates is not None:
        _say_measured(names, best_positions, fitted.control.points.ground)
    return Plan(names, np.column_stack(
        [fitted.project(best_positions), best_positions, np.hypot(ranking.sigma, shared)]),
        float(np.hypot(ranking.sigma_before, shared)), fitted.control.crs)


def _say_unseen(unseen: list[str]) -> None:
    """Say which candidates the image does not show."""
    log.warning("Note: %s left out, as the image does not show %s: %s.",
                count_in_words(len(unseen), "candidate"), "it" if len(unseen) == 1 else "them",
                first_names_in_words(unseen))


def _say_measured(names: Sequence[str], positions: FloatArray, control: FloatArray) -> None:
    """Warn which places (n, 3), with their names, are those of control points (p, 3) already."""
    measured_places = {tuple(place) for place in control[:, :2].tolist()}
    measured = [name for name, place in zip(names, positions[:, :2].tolist(), strict=True)
                if tuple(place) in measured_places]
    if measured:
        log.warning("Note: control of this fit already, so that a further point there is the same "
                    "place measured again: %s.",
                    first_names_in_words(measured))
