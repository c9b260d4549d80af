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
from termsel_app.outputs import run_command
from termsel_app.places import transform_places, transformer_between
from termsel_app.quality import write_control_tables
from termsel_app.session import from_folder

if TYPE_CHECKING:
    from termsel_app.control import Record
    from termsel_app.prediction import Prediction
    from termsel_app.rasters import Pixels
    from termsel_app.session import Session

HALF_WINDOW = 64
"""Pixels of the image around a point that are matched, to each side."""
SEARCH_RADIUS = 16.0
"""Pixels by which a click may be off."""
MIN_MATCHES, MAX_SPREAD = 3, 1.0
"""How many matches around a point must agree, and to how many pixels."""
NODES_OF_WINDOW = 9
MAX_WINDOW_SIDE = 1024
"""Pixels of the map along a side that are read around a point."""
MAX_PROPOSED, CELLS = 12, 4
"""New points that are proposed at once, and parts of the image along a side that they lie in."""
MAX_SIGMAS = 3.0
"""Standard deviations from the prediction beyond which a candidate is not proposed."""
CANDIDATES_FILE = "candidates.csv"
_MATCHERS = ("sift", "phase", "structure")


def can_match(session: Session) -> bool:
    """Return whether termsel-match is installed, and there are an image and a raster of the map."""
    return (find_spec("termsel_match") is not None and session.image is not None
            and bool(session.maps.rasters))


def require_model(session: Session) -> Prediction:
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


def refine_point(session: Session, name: str) -> dict[str, Any]:
    """Return where the image shows what the map shows at a point, to a fraction of a pixel.

    "image" is line and sample, "distance" how far that is from the click [px], and "matcher" which
    matcher found it. The point itself stays as it is. Raises TermselError if it has not both places
    or there is no model, and if image and map do not look alike around it.
    """
    prediction = require_model(session)
    record = session.control.records.get(name)
    if record is None or record["kind"] != "point" or not record["image"] or not record["ground"]:
        raise TermselError("only a point with both positions can be refined")
    first, second = _cut_windows(session, prediction, record)
    # The matchers in turn, until one finds matches that agree on a shift.
    for matcher in _MATCHERS:
        shift = _agreed_shift(_match_shifts(termsel.get("matchers", matcher)(), first, second))
        if shift is not None:
            # The map is where the point should be; the image shows it away by minus the shift.
            refined = np.asarray(record["image"]) - shift
            return {"image": refined.tolist(), "distance": float(np.hypot(*shift)),
                    "matcher": matcher}
    raise TermselError(f"image and map do not look alike around {name}",
                       hint="The point stays as it is.")


def _match_shifts(matcher: Any, first: Any, second: Any) -> FloatArray:
    """Return the shifts [px] of n matches from the first to the second window, shape (n, 2).

    They are exact to a fraction of a pixel.
    """
    from termsel_match.matchers.refinement import Layers, refine_matches

    matches = matcher.match(first, second, SEARCH_RADIUS)
    if not matcher.places_exactly:
        matches = refine_matches(Layers(first.pixels[None], first.known),
                                 Layers(second.pixels[None],
                                        second.known), matches.first, matches.second)
    shifts: FloatArray = matches.second - matches.first
    return shifts


def _agreed_shift(shifts: FloatArray) -> FloatArray | None:
    """Return the median [px] of the shifts (n, 2) that agree, shape (2,).

    Shifts agree that are within `MAX_SPREAD` of the median of all. None if these are fewer than
    `MIN_MATCHES` or than half of all.
    """
    if len(shifts) < MIN_MATCHES:
        return None
    median = np.median(shifts, axis=0)
    near = np.hypot(*(shifts - median).T) <= MAX_SPREAD
    if near.sum() < max(MIN_MATCHES, len(shifts) / 2):
        return None
    agreed: FloatArray = np.median(shifts[near], axis=0)
    return agreed


def _cut_windows(session: Session, prediction: Prediction, record: Record) -> tuple[Any, Any]:
    """Return two windows around a point: of the image, and of the map as the image would show it.

    The map is the first raster that shows more than half of the window. Raises TermselError if none
    does.
    """
    from termsel_match.matchers import Window

    assert session.image is not None
    width = 2 * HALF_WINDOW + 1
    line, sample = record["image"]
    # Whole pixels, so that the image itself is not resampled.
    first_line = round(line) - HALF_WINDOW
    first_sample = round(sample) - HALF_WINDOW
    picture = session.image.pixels((first_line, first_sample, width, width), (width, width))
    nodes = np.linspace(0, width - 1, NODES_OF_WINDOW)
    mesh = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    map_nodes = prediction.to_map(mesh + np.array([first_line, first_sample]))
    predicted_on_map = prediction.to_map([record["image"]])[0]
    # The map is moved so that the model agrees with the point: matching finds the error that is
    # left.
    map_nodes += session.places.to_map([record["ground"][:2]])[0] - predicted_on_map
    for raster in session.maps.rasters:
        map_window = _grey_at(raster, map_nodes, session.maps.shown, width)
        if map_window[1].mean() > 0.5:
            return Window(*_grey_and_opaque(picture)), Window(*map_window)
    raise TermselError("no raster of the map shows this position",
                       hint="Refine points that lie on a raster; keep this one as it was clicked.")


def _grey_at(raster: MapRaster, map_nodes: FloatArray, page_crs: str, width: int,
             ) -> tuple[Any, Any]:
    """Return the grey of a raster in a window, and where it is known, both of shape (width, width).

    `map_nodes` (n, 2) are the places on the map, in the CRS of the page, of a regular grid of nodes
    over the window; places between them, and the grey between pixels, are interpolated linearly.
    Nothing is known if a node has no place in the raster's CRS.
    """
    from scipy.ndimage import map_coordinates

    positions = transform_places(transformer_between(raster.crs, page_crs), map_nodes, inverse=True)
    columns, rows = ~raster.raster.dataset.transform @ (positions[:, 0], positions[:, 1])
    if not np.isfinite(rows + columns).all():
        return _grey_and_opaque(np.zeros((width, width, 4), dtype=np.uint8))
    first_row, first_column = np.floor([rows.min(), columns.min()]).astype(int) - 1
    size = np.ceil([rows.max() - first_row, columns.max() - first_column]).astype(int) + 2
    # Of a map that is far finer than the image, one pixel of `step` is read.
    step = max(-(-int(size.max()) // MAX_WINDOW_SIDE), 1)
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
    """Return the mean of the colours of pixels, and whether they are not transparent at all places.

    Both have the shape (lines, samples).
    """
    return pixels[..., :3].mean(axis=2).astype(np.float32), pixels[..., 3] > 0


def propose_points(session: Session) -> list[dict[str, Any]]:
    """Return up to `MAX_PROPOSED` points that matching proposes, the clearest first.

    Each has its place in the "image" and on the "map", and a "score". They are spread over the
    image, one in each cell, and agree with the model within `MAX_SIGMAS`; the user decides which
    are right. Control and all candidates are written into the session's folder, where the command
    match-points runs. Raises TermselError without what `require_model` asks for, or if matching
    fails.
    """
    prediction = require_model(session)
    # Matching starts from the points there are, and searches near where they put a place.
    with session.lock:
        features = session.control.features(session.places.crs)
    write_control_tables(features, session.folder)
    arguments = ["match-points", from_folder(str(session.files.image), session.folder),
                 "--reference", from_folder(str(session.maps.rasters[0].raster.path),
                                            session.folder),
                 "--start", "points.csv", "--output", CANDIDATES_FILE, "--overwrite", "--quiet"]
    if session.files.dem is not None:
        arguments += ["--dem", from_folder(session.files.dem, session.folder)]
    run_command(arguments, session.folder)
    candidates = termsel.read(session.folder / CANDIDATES_FILE)
    points = candidates.points
    plane = transform_places(
        transformer_between(candidates.crs, session.maps.shown), points.ground[:, :2])
    errors = np.hypot(*(prediction.to_image(plane) - points.image).T)
    sigma = np.hypot(*prediction.sigma(plane).T)
    score = candidates.numbers("score") if "score" in points.attributes else np.zeros(len(points))
    size = np.asarray(session.size or (1, 1))
    used: set[tuple[int, ...]] = set()
    proposals: list[dict[str, Any]] = []
    # One proposal a cell, as otherwise they would crowd where the image is clearest.
    for i in np.argsort(-score, kind="stable"):
        cell = tuple((points.image[i] * CELLS // size).astype(int).tolist())
        if cell in used or not errors[i] <= MAX_SIGMAS * sigma[i] or len(proposals) == MAX_PROPOSED:
            continue
        used.add(cell)
        proposals.append({"image": points.image[i].tolist(), "map": plane[i].tolist(),
                          "score": float(score[i])})
    return proposals
