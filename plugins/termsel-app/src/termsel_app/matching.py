"""Places matched by the images themselves, where termsel-match is installed: shown, never taken.

A click is refined by what lies around it: the map is resampled as the model sees it from the image,
held at the point's own two places, and a matcher says how far both are apart. More points are
proposed by `termsel match-points`, which starts from those there are.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

import termsel
from termsel import TermselError
from termsel.toolkit import FloatArray
from termsel_app.maps import MapRaster
from termsel_app.outputs import call
from termsel_app.places import transform_places, transformer_between
from termsel_app.quality import write_control_tables
from termsel_app.session import from_folder

if TYPE_CHECKING:
    from termsel_app.control import Record
    from termsel_app.prediction import Prediction
    from termsel_app.rasters import Pixels
    from termsel_app.session import Session

HALF = 64
"""Pixels of the image around a point that are matched, to each side."""
SEARCH = 16.0
"""Pixels that a click may be off."""
MIN_MATCHES, MAX_SPREAD = 3, 1.0
"""Matches that must agree around a point, and to how many pixels."""
NODES_OF_WINDOW = 9
MAX_WINDOW_SIDE = 1024
"""Pixels of the map along a side that are read around a point."""
PROPOSED, CELLS = 12, 4
"""New points that are proposed at once, and parts of the image along a side that they lie in."""
FAR = 3.0
"""Standard deviations from the prediction beyond which a candidate is not proposed."""
CANDIDATES_FILE = "candidates.csv"
_MATCHERS = ("sift", "phase", "structure")


def is_possible(session: Session) -> bool:
    """Return whether termsel-match is installed, and there are an image and a raster of the map."""
    return (find_spec("termsel_match") is not None and session.image is not None
            and bool(session.maps.rasters))


def require(session: Session) -> Prediction:
    """Return the model that matching starts from.

    Raises TermselError without termsel-match, an image, a raster of the map, or a model.
    """
    if find_spec("termsel_match") is None:
        raise TermselError("matching needs the package termsel-match",
                           hint="Install it, and start termsel app again.")
    if session.image is None or not session.maps.rasters:
        raise TermselError("matching needs an image and a raster of the map")
    if session.prediction is None:
        raise TermselError("matching starts from a model, and there is none yet",
                           hint="Measure three points first.")
    return session.prediction


def refined_place(session: Session, name: str) -> dict[str, Any]:
    """Return where the image shows what the map shows at a point, to a part of a pixel.

    Raises TermselError where both do not look alike around it.
    """
    prediction = require(session)
    record = session.control.records.get(name)
    if record is None or record["kind"] != "point" or not record["image"] or not record["ground"]:
        raise TermselError("only a point with both positions can be refined")
    first, second = _cut_windows(session, prediction, record)
    for matcher in _MATCHERS:
        shift = _agreed_shift(_match_shifts(termsel.get("matchers", matcher)(), first, second))
        if shift is not None:
            refined = np.asarray(record["image"]) - shift
            return {"image": refined.tolist(), "distance": float(np.hypot(*shift)),
                    "matcher": matcher}
    raise TermselError(f"image and map do not look alike around {name}",
                       hint="The point stays as it is.")


def _match_shifts(matcher: Any, first: Any, second: Any) -> FloatArray:
    """Return how far matches of two windows are apart (n, 2), each to a part of a pixel [px]."""
    from termsel_match.matchers.refinement import Layers, refine_matches

    matches = matcher.match(first, second, SEARCH)
    if not matcher.places_exactly:
        matches = refine_matches(Layers(first.pixels[None], first.known),
                                 Layers(second.pixels[None],
                                        second.known), matches.first, matches.second)
    shifts: FloatArray = matches.second - matches.first
    return shifts


def _agreed_shift(shifts: FloatArray) -> FloatArray | None:
    """Return the median (2,) [px] of shifts (n, 2) that agree; None if too few agree."""
    if len(shifts) < MIN_MATCHES:
        return None
    median = np.median(shifts, axis=0)
    near = np.hypot(*(shifts - median).T) <= MAX_SPREAD
    if near.sum() < max(MIN_MATCHES, len(shifts) / 2):
        return None
    agreed: FloatArray = np.median(shifts[near], axis=0)
    return agreed


def _cut_windows(session: Session, prediction: Prediction, record: Record) -> tuple[Any, Any]:
    """Return the window of the image around a point, and the map as the image would show it.

    Raises TermselError if no raster of the map shows half of it.
    """
    from termsel_match.matchers import Window

    assert session.image is not None
    width = 2 * HALF + 1
    line, sample = record["image"]
    # Whole pixels, so that the image itself is not resampled.
    first_line = round(line) - HALF
    first_sample = round(sample) - HALF
    picture = session.image.pixels((first_line, first_sample, width, width), (width, width))
    nodes = np.linspace(0, width - 1, NODES_OF_WINDOW)
    mesh = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    on_map = prediction.to_map(mesh + np.array([first_line, first_sample]))
    at_point = prediction.to_map([record["image"]])[0]
    # The map is looked at where it would be if the point were right: the mean difference of model
    # and point is taken off.
    on_map += session.places.to_map([record["ground"][:2]])[0] - at_point
    for raster in session.maps.rasters:
        map_window = _grey_at(raster, on_map, session.maps.shown, width)
        if map_window[1].mean() > 0.5:
            return Window(*_grey_and_opaque(picture)), Window(*map_window)
    raise TermselError("no raster of the map shows this position",
                       hint="Refine points that lie on a raster; keep this one as it was clicked.")


def _grey_at(raster: MapRaster, on_map: FloatArray, page_crs: str, width: int) -> tuple[Any, Any]:
    """Return the grey that a raster shows at places that a grid of nodes gives, and where it does.

    Interpolated: the nearest pixels would be off by up to half of one.
    """
    from scipy.ndimage import map_coordinates

    positions = transform_places(transformer_between(raster.crs, page_crs), on_map, inverse=True)
    columns, rows = ~raster.raster.dataset.transform @ (positions[:, 0], positions[:, 1])
    if not np.isfinite(rows + columns).all():
        return _grey_and_opaque(np.zeros((width, width, 4), dtype=np.uint8))
    first_row, first_column = np.floor([rows.min(), columns.min()]).astype(int) - 1
    size = np.ceil([rows.max() - first_row, columns.max() - first_column]).astype(int) + 2
    step = max(-(-int(size.max()) // MAX_WINDOW_SIDE), 1)  # a map that is far finer than the image
    shape = (-(-int(size[0]) // step), -(-int(size[1]) // step))
    box = (first_row, first_column, shape[0] * step, shape[1] * step)
    grey, opaque = _grey_and_opaque(raster.raster.pixels(box, shape))
    at = np.arange(width) / (width - 1) * (NODES_OF_WINDOW - 1)
    mesh = np.meshgrid(at, at, indexing="ij")
    lines, samples = (
        (map_coordinates(values.reshape(NODES_OF_WINDOW, NODES_OF_WINDOW), mesh, order=1)
         - start) / step - 0.5
        for values, start in ((rows, first_row), (columns, first_column)))
    return (map_coordinates(grey, [lines, samples], order=1),
            map_coordinates(opaque.astype(np.float32), [lines, samples], order=1) > 0.999)


def _grey_and_opaque(pixels: Pixels) -> tuple[Any, Any]:
    """Return the mean of the colours (lines, samples), and where pixels are not transparent."""
    return pixels[..., :3].mean(axis=2).astype(np.float32), pixels[..., 3] > 0


def propose_points(session: Session) -> list[dict[str, Any]]:
    """Return points that matching proposes, spread over the image, the clearest first.

    They lie where the model expects them; which of them are right the user sees.
    """
    prediction = require(session)
    # The points so far are the start: matching looks near where they put a place.
    with session.lock:
        features = session.control.features(session.places.crs)
    write_control_tables(features, session.folder)
    arguments = ["match-points", from_folder(str(session.files.image), session.folder),
                 "--reference", from_folder(str(session.maps.rasters[0].raster.path),
                                            session.folder),
                 "--start", "points.csv", "--output", CANDIDATES_FILE, "--overwrite", "--quiet"]
    if session.files.dem is not None:
        arguments += ["--dem", from_folder(session.files.dem, session.folder)]
    call(arguments, session.folder)
    candidates = termsel.read(session.folder / CANDIDATES_FILE)
    points = candidates.points
    plane = transform_places(
        transformer_between(candidates.crs, session.maps.shown), points.ground[:, :2])
    # What lies farther from its prediction than this may be by chance is a mismatch.
    away = np.hypot(*(prediction.to_image(plane) - points.image).T)
    sigma = np.hypot(*prediction.sigma(plane).T)
    score = candidates.numbers("score") if "score" in points.attributes else np.zeros(len(points))
    size = np.asarray(session.size or (1, 1))
    used: set[tuple[int, ...]] = set()
    proposals: list[dict[str, Any]] = []
    # The best of each cell, so that the proposals do not crowd where the image is clearest.
    for i in np.argsort(-score, kind="stable"):
        cell = tuple((points.image[i] * CELLS // size).astype(int).tolist())
        if cell in used or not away[i] <= FAR * sigma[i] or len(proposals) == PROPOSED:
            continue
        used.add(cell)
        proposals.append({"image": points.image[i].tolist(), "map": plane[i].tolist(),
                          "score": float(score[i])})
    return proposals
