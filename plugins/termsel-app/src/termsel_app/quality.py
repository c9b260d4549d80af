"""What termsel says of the control: every figure comes from its public engine, none from here.

`judge_control` runs in a process of its own. Points are written as a table and read again, as the
command line reads them, so that the page and `termsel run` say the same to the last digit.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import termsel
from termsel import TermselError
from termsel.toolkit import charts, coordinates, count_in_words

if TYPE_CHECKING:
    from termsel import FeatureSet, Memory, Result

MIN_POINTS_OF_MODEL = 3
"""Points from which on there is a model without an RPC."""
N_NEXT = 3
"""Positions that are proposed for the next measurements."""
GRID_SIDE = 40
"""Positions along either side of the image at which the uncertainty is computed."""
MIN_LINES = 6
"""Lines from which on OWDIS chooses among them: two equations each, for the terms of a plane."""
MIN_GAIN = 0.05
"""Share of the uncertainty that a further point must gain to be worth measuring."""


@dataclass(frozen=True)
class Question:
    """Control to be judged.

    `serial` counts the changes; `size` is lines and samples of the image; `rpc` and `dem` are
    files.
    """

    serial: int
    features: FeatureSet
    size: tuple[int, int] | None
    rpc: Path | None = None
    dem: Path | None = None


Answer = dict[str, Any]


def import_engine() -> None:
    """Import the modules that the first answer needs, so that it does not wait for them."""
    from termsel.toolkit.files import plan

    # Names of the package load their modules when they are first used.
    for name in (termsel.run, termsel.read, plan, charts.first_screen):
        assert callable(name)


def judge_control(question: Question, memory: Memory | None = None) -> Iterator[Answer]:
    """Yield what is known of the control, as answers by stage, the quickest first.

    The stage "figures" has the figures and the result; "predicted" the errors of the points where
    they are left out; "lines", if there are enough, those that OWDIS uses; "next" the places to
    measure next; and "uncertainty" that all over the image. If there is no result, the only answer
    has the stage "waiting", for too few points, or "refused", with the reason. With a memory, what
    earlier questions found of the same control is not computed again.
    """
    features = question.features
    base = {"serial": question.serial}
    # An RPC is a model already: one point corrects it.
    n_in_use = [role != "off" for role in features.points.roles].count(True)
    n_needed = 1 if question.rpc is not None else MIN_POINTS_OF_MODEL
    if n_in_use < n_needed and not len(features.lines):
        yield {**base, "stage": "waiting",
               "text": f"{n_needed - n_in_use} more "
                       f"{'point' if n_needed - n_in_use == 1 else 'points'}, and there is a first "
                       "model."}
        return
    try:
        result = _run_question(question, memory)
    except TermselError as error:
        yield {**base, "stage": "refused", "text": f"{error.what}.", "hint": error.hint or "",
               "ids": list(error.ids)}
        return
    # The first stage takes a second, the last one several.
    yield {**base, "stage": "figures", **figures_for_page(result), "result": result}
    yield {**base, "stage": "predicted", "errors": prediction_errors(result)}
    if len(features.lines) >= MIN_LINES:
        yield {**base, "stage": "lines", **split_lines_by_owdis(features)}
    yield {**base, "stage": "next", **_next_places(result)}
    yield {**base, "stage": "uncertainty", "uncertainty": uncertainty_grid(result)}


def _run_question(question: Question, memory: Memory | None) -> Result:
    """Return the result of `termsel.run` with the control of a question, and its RPC and DEM."""
    with tempfile.TemporaryDirectory(prefix="termsel-app-") as folder:
        # The features are read from files, so that DEM, RPC and checks work as for a command.
        files = write_control_tables(question.features, Path(folder))
        features = termsel.read(
            files.get("points"), files.get("lines"), dem=question.dem, rpc=question.rpc)
    if question.size is not None:
        features = replace(features, image_size=question.size)
    return termsel.run(features=features, memory=memory)


def write_control_tables(features: FeatureSet, folder: Path) -> dict[str, Path]:
    """Write points and lines as tables to a folder; return their paths by "points" and "lines".

    A kind without features gets no table.
    """
    files = {}
    if len(features.points):
        files["points"] = folder / "points.csv"
        termsel.write_points_csv(features.points, files["points"], features.crs)
    if len(features.lines):
        files["lines"] = folder / "lines.csv"
        termsel.write_lines_csv(features.lines, files["lines"], features.crs)
    return files


def figures_for_page(result: Result) -> Answer:
    """Return what the page shows of a result: facts, accuracy, notes, residuals and blunders.

    They are as JSON takes them; distances are in px.
    """
    # All of it is by the functions that reports use, so that page and `termsel run` agree.
    strategy = result.strategy
    residuals = residuals_by_id(result)
    return {
        "facts": [{"label": fact.label, "text": fact.text}
                  for fact in charts.first_screen(result)],
        "accuracy": first_accuracy(result),
        "why": strategy.reason if strategy is not None else "",
        "judgement": result.judgement,
        "notes": list(result.notes),
        "errors": residuals,
        "blunders": [{"id": outlier.id, "kind": outlier.kind, "role": outlier.role,
                      "error": residuals.get(outlier.id, {}).get("distance", outlier.error),
                      "certainty": outlier.certainty,
                      "excluded": outlier.excluded} for outlier in result.outliers],
        "roles": {row.id: row.role for row in result.residuals},
    }


def first_accuracy(result: Result) -> Answer | None:
    """Return the RMSE that a report shows first; None if there is none.

    It is the predicted one or that of independent check points, as "kind" says. "px" are the RMSE
    and both ends of its interval, which holds it with the probability "level"; "metres" the same on
    the ground, None if the size of a pixel is not known.
    """
    predicted = charts.expected_rmse(result)
    # The same rule as on the first screen of a report.
    if predicted is not None and charts.is_prediction_surer(result):
        figure = (predicted.rmse, predicted.low, predicted.high)
        kind = "predicted by cross-validation"
        level = predicted.level
    elif result.accuracy is not None:
        image = result.accuracy.image
        figure = (image.total, *image.interval)
        kind = f"at {count_in_words(image.n, 'independent check point')}"
        level = 0.9
    else:
        return None
    scale = metres_per_pixel(result)
    return {"px": figure, "kind": kind, "level": level,
            "metres": None if scale is None else [value * scale for value in figure]}


def metres_per_pixel(result: Result) -> float | None:
    """Return the side of a pixel on the ground [m] in the middle of the control; None if unknown.

    The pixel is located at the median height of the control. Oblique pixels are longer one way, so
    the side is the root of the area on the ground.
    """
    fit = result.exported
    ground = fit.control.ground_vertices()
    if not len(ground):
        return None
    middle = fit.project(ground).mean(axis=0)
    height = np.nan_to_num(np.nanmedian(ground[:, 2])) if np.isfinite(ground[:, 2]).any() else 0.0
    # One pixel down and one to the right, on the ground.
    corners = fit.locate(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), height)
    edges = coordinates.offsets_in_metres(
        fit.control.crs, np.repeat(corners[:1], 2, axis=0), (corners[1:] - corners[0])[:, :2])
    if edges is None or not np.isfinite(edges).all():
        return None
    # The determinant is the area of the parallelogram that both edges span.
    return float(np.sqrt(abs(np.linalg.det(edges))))


def residuals_by_id(result: Result) -> dict[str, Answer]:
    """Return the residual of each feature by id: "line", "sample", "distance" [px], and its use.

    For a line, "distance" is the largest of its vertices, and "line" and "sample" are None. "used"
    is whether the model is fitted to the feature, "blunder" whether it is a probable blunder.
    """
    values_by_id: dict[str, Answer] = {}
    for row in result.residuals:
        # A line has a row for each of its vertices.
        largest = max(row.distance, values_by_id.get(row.id, {}).get("distance", 0.0))
        point = row.kind == "point"
        values_by_id[row.id] = {"line": row.line if point else None,
                         "sample": row.sample if point else None, "distance": largest,
                         "used": row.used, "blunder": row.blunder}
    return values_by_id


def prediction_errors(result: Result) -> dict[str, float]:
    """Return how far each feature is from where the others alone predict it [px], by id.

    Features that the model is fitted to, selection points included, are left out in turn of a fit
    of the chosen model. Points that it is not fitted to have their residuals, which are such errors
    already. Without a strategy, or if that fit fails, these are the only ones.
    """
    values_by_id = {row.id: row.distance for row in result.residuals
                    if row.kind == "point" and not row.used}
    if result.strategy is None:
        return values_by_id
    try:
        fit = termsel.fit(_features_fitted_to(result), result.strategy.chosen)
        residuals_left_out = fit.leave_one_out
    except TermselError:
        # The other features do not determine the model.
        return values_by_id
    for row in residuals_left_out:
        values_by_id[row.id] = max(row.distance, values_by_id.get(row.id, 0.0))
    return values_by_id


def _features_fitted_to(result: Result) -> FeatureSet:
    """Return the features that the chosen model is fitted to, without blunders, all as control."""
    ids = result.estimation.features
    # Without selection points these are the control that is used.
    if ids is None:
        return result.fit.control.take(np.asarray(result.fit.used))
    features = result.features.take(np.isin(result.features.ids, ids))
    return features.with_(points=replace(features.points,
                                         roles=("control",) * len(features.points)))


def split_lines_by_owdis(features: FeatureSet) -> Answer:
    """Return which lines OWDIS would use, as `termsel run --problem owdis-lines` finds it.

    "chosen" are their ids, and "text" says how many they are; if OWDIS fails, "chosen" is None and
    "text" the reason. The lines are judged by leaving out each in turn, not by selection points.
    """
    heights = features.lines.ground[..., 2]
    # Heights that are all equal do not determine terms of the height.
    is_flat = not np.isfinite(heights).all() or np.ptp(heights) == 0.0
    model: dict[str, Any] = {"model": "poly2d", "options": {"degree": 1}} if is_flat else {}
    lines = replace(features, points=features.points.take(np.zeros(0, dtype=np.intp)))
    try:
        result = termsel.run("owdis-lines", features=lines, criterion="press",
                             strategy="as-asked", **model)
    except TermselError as error:
        return {"text": f"OWDIS cannot choose among the lines: {error.what}.", "chosen": None}
    selected = [str(name) for name in result.selection.features]
    count = len(features.lines)
    return {"text": f"OWDIS uses {len(selected)} of {count} lines; the others are drawn dashed."
            if len(selected) < count else f"OWDIS uses all {count} lines.", "chosen": selected}


def _next_places(result: Result) -> Answer:
    """Return where a further point helps most ("next"), and whether one is worth while ("enough").

    If the model cannot say, "next" is empty, and the "text" of "enough" says why.
    """
    from termsel.toolkit.files import plan

    try:
        next_points = plan(result.as_exported(), N_NEXT)
    except TermselError as error:
        text = f"{error.what[:1].upper()}{error.what[1:]}."
        return {"next": [], "enough": {"text": text, "reached": False}}
    rows = [{"line": line, "sample": sample, "ground": [x, y, None if z != z else z],
             "uncertainty": remaining}
            for line, sample, x, y, z, remaining in next_points.values.tolist()]
    before = next_points.sigma_before
    after = rows[0]["uncertainty"]
    # The gain is a share of the mean uncertainty. If that is 0, no point can gain anything.
    gain = 1.0 - after / before if before else 0.0
    now, then, at_last = map(
        charts.rounded_size_text, (before, after, rows[-1]["uncertainty"]))
    text = (f"One more point takes the mean uncertainty of the model from {now} to {then} px, "
            f"{N_NEXT} more to {at_last} px.")
    return {"next": rows, "enough": {"text": text, "reached": gain < MIN_GAIN, "gain": gain,
                                     "now": before, "after": after}}


def uncertainty_grid(result: Result) -> Answer | None:
    """Return the standard deviation of the model [px] on a grid over the image, for the page.

    "values" are those of both axes together, sqrt(sigma_line^2 + sigma_sample^2), line by line, and
    None where they are not known. "side" is the number of positions along either side, and "box"
    the first line and sample and the last ones. None if nothing is known, as without redundancy.
    """
    fit = result.exported
    (first_line, first_sample), (last_line, last_sample) = fit.image_box()
    lines = np.linspace(first_line, last_line, GRID_SIDE)
    samples = np.linspace(first_sample, last_sample, GRID_SIDE)
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
    # At the median height of the control: a grid over the image has no heights of its own.
    ground = fit.control.ground_vertices()
    height = np.nan_to_num(np.nanmedian(ground[:, 2])) if np.isfinite(ground[:, 2]).any() else 0.0
    sigma = np.hypot(*result.sigma(fit.locate(image, height)).T)
    if not np.isfinite(sigma).any():
        return None
    box = [float(first_line), float(first_sample), float(last_line), float(last_sample)]
    return {"box": box, "side": GRID_SIDE,
            "values": [None if value != value else round(value, 4) for value in sigma.tolist()]}
