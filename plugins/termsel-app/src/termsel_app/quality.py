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

MIN_POINTS = 3
"""Points from which on there is a model without an RPC."""
NEXT = 3
"""Places to measure next."""
GRID = 40
"""Places along either side of the image where the uncertainty is computed."""
MIN_LINES = 6
"""Lines from which on OWDIS chooses among them: two equations each, for the terms of a plane."""
ENOUGH = 0.05
"""Share of the uncertainty that a further point must gain to be worth measuring."""


@dataclass(frozen=True)
class Question:
    """Control to be judged.

    `serial` counts the changes; `size` is lines and samples of the image; `rpc` and `dem` are
    files; `remote` and `drivers` say what files may refer to and be.
    """

    serial: int
    features: FeatureSet
    size: tuple[int, int] | None
    rpc: Path | None = None
    dem: Path | None = None


Answer = dict[str, Any]


def prepare() -> None:
    """Import what the first answer needs, so that it does not wait for that."""
    from termsel.toolkit.files import plan

    # Names of the package load their modules when they are first used.
    for name in (termsel.run, termsel.read, plan, charts.first_screen):
        assert callable(name)


def judge_control(question: Question, memory: Memory | None = None) -> Iterator[Answer]:
    """Yield what is known of the control, the quickest first.

    With a memory, what earlier questions found of the same control is not computed again: a change
    is taken back, or is one of independent check points alone.

    The first answer has the figures and the result; the others the points' own prediction errors,
    the places to measure next, and the uncertainty all over the image. Where there is no result,
    the only answer has a reason.
    """
    features = question.features
    base = {"serial": question.serial}
    # An RPC is a model already: one point corrects it.
    in_use = [role != "off" for role in features.points.roles].count(True)
    fewest = 1 if question.rpc is not None else MIN_POINTS
    if in_use < fewest and not len(features.lines):
        yield {**base, "stage": "waiting",
               "text": f"{fewest - in_use} more "
                       f"{'point' if fewest - in_use == 1 else 'points'}, and there is a first "
                       "model."}
        return
    try:
        # What termsel refuses is shown like any other answer.
        result = _run(question, memory)
    except TermselError as error:
        yield {**base, "stage": "refused", "text": f"{error.what}.", "hint": error.hint or "",
               "ids": list(error.ids)}
        return
    # Each stage is sent as soon as it is there: the first takes a second, the last several.
    yield {**base, "stage": "figures", **figures_for_page(result), "result": result}
    yield {**base, "stage": "predicted", "errors": prediction_errors(result)}
    if len(features.lines) >= MIN_LINES:
        yield {**base, "stage": "lines", **split_lines_by_owdis(features)}
    yield {**base, "stage": "next", **_next_places(result)}
    yield {**base, "stage": "uncertainty", "uncertainty": uncertainty_grid(result)}


def _run(question: Question, memory: Memory | None) -> Result:
    """Return the result of `termsel.run` with the control of a question, and its RPC and DEM."""
    with tempfile.TemporaryDirectory(prefix="termsel-app-") as folder:
        # Read from files like any others, so that DEM, RPC and checks work as for a command.
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
    """Return what the page shows of a result: accuracy, model, blunders, and each feature's error.

    Nothing is computed here: facts, figures and words are those of the result, so that the page
    says what `termsel run` says.
    """
    strategy = result.strategy
    residuals = residuals_by_id(result)
    return {
        "facts": [{"label": fact.label, "text": fact.text}
                  for fact in charts.first_screen(result)],
        "accuracy": shown_accuracy(result),
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


def shown_accuracy(result: Result) -> Answer | None:
    """Return the RMSE that a report shows first, with its interval, in px and metres.

    It is the predicted one or that of independent check points. `metres` is None if the size of a
    pixel is not known; None altogether if there is neither RMSE.
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

    The parallelogram of one pixel down and one to the right is located at the median height; the
    root of its area is the side, as oblique pixels are longer one way.
    """
    fit = result.exported
    ground = fit.control.ground_vertices()
    if not len(ground):
        return None
    # In the middle of the control, where the model is best known.
    middle = fit.project(ground).mean(axis=0)
    height = np.nan_to_num(np.nanmedian(ground[:, 2])) if np.isfinite(ground[:, 2]).any() else 0.0
    # One pixel down and one to the right, on the ground.
    corners = fit.locate(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), height)
    edges = coordinates.offsets_in_metres(
        fit.control.crs, np.repeat(corners[:1], 2, axis=0), (corners[1:] - corners[0])[:, :2])
    if edges is None or not np.isfinite(edges).all():
        return None
    # The area of the parallelogram that the two edges of a pixel span.
    return float(np.sqrt(abs(np.linalg.det(edges))))


def residuals_by_id(result: Result) -> dict[str, Answer]:
    """Return the residual of each feature by id [px]: `line`, `sample` and `distance`.

    Of a line the distance is the larger of its vertices', and `line` and `sample` are None.
    """
    table: dict[str, Answer] = {}
    for row in result.residuals:
        # Rows are of vertices, and of all pieces of a line.
        largest = max(row.distance, table.get(row.id, {}).get("distance", 0.0))
        point = row.kind == "point"
        table[row.id] = {"line": row.line if point else None,
                         "sample": row.sample if point else None, "distance": largest,
                         "used": row.used, "blunder": row.blunder}
    return table


def prediction_errors(result: Result) -> dict[str, float]:
    """Return how far off each feature is where the others alone predict it [px].

    Of what the model is fitted to, selection points included, by the chosen model without it; of
    all others their residuals are just that.
    """
    table = {row.id: row.distance for row in result.residuals
             if row.kind == "point" and not row.used}
    if result.strategy is None:
        return table
    try:
        held_out = termsel.fit(_features_fitted_to(result), result.strategy.chosen).leave_one_out
    except TermselError:  # without some feature the fit is not determined
        return table
    for row in held_out:
        table[row.id] = max(row.distance, table.get(row.id, 0.0))
    return table


def _features_fitted_to(result: Result) -> FeatureSet:
    """Return the features that a choice is fitted to, as control; without blunders."""
    ids = result.estimation.features
    if ids is None:  # there are no selection points
        return result.fit.control.take(np.asarray(result.fit.used))
    features = result.features.take(np.isin(result.features.ids, ids))
    return features.with_(points=replace(features.points,
                                         roles=("control",) * len(features.points)))


def split_lines_by_owdis(features: FeatureSet) -> Answer:
    """Return which lines OWDIS would use, and which not; as `termsel run --problem owdis-lines`.

    Judged by leaving out each of the lines in turn, since the points of a session may be few.
    """
    heights = features.lines.ground[..., 2]
    # Without relief terms of the height are not determined.
    flat = not np.isfinite(heights).all() or np.ptp(heights) == 0.0
    model: dict[str, Any] = {"model": "poly2d", "options": {"degree": 1}} if flat else {}
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
    """Return where a further point helps most (`next`), and whether one is worth while (`enough`).

    `next` is empty if the model cannot say, and `text` of `enough` says why.
    """
    from termsel.toolkit.files import plan

    try:
        next_points = plan(result.as_exported(), NEXT)
    except TermselError as error:
        text = f"{error.what[:1].upper()}{error.what[1:]}."
        return {"next": [], "enough": {"text": text, "reached": False}}
    rows = [{"line": line, "sample": sample, "ground": [x, y, None if z != z else z],
             "uncertainty": remaining}
            for line, sample, x, y, z, remaining in next_points.values.tolist()]
    before = next_points.sigma_before
    after = rows[0]["uncertainty"]
    # Of the mean uncertainty; a perfect model gains nothing.
    gain = 1.0 - after / before if before else 0.0
    now, then, at_last = map(
        charts.rounded_size_text, (before, after, rows[-1]["uncertainty"]))
    text = (f"One more point takes the mean uncertainty of the model from {now} to {then} px, "
            f"{NEXT} more to {at_last} px.")
    return {"next": rows, "enough": {"text": text, "reached": gain < ENOUGH, "gain": gain,
                                     "now": before, "after": after}}


def uncertainty_grid(result: Result) -> Answer | None:
    """Return the model's standard deviation [px] on a grid over the image, line by line.

    None where it is not known.
    """
    fit = result.exported
    (first_line, first_sample), (last_line, last_sample) = fit.image_box()
    lines = np.linspace(first_line, last_line, GRID)
    samples = np.linspace(first_sample, last_sample, GRID)
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = fit.control.ground_vertices()
    height = np.nan_to_num(np.nanmedian(ground[:, 2])) if np.isfinite(ground[:, 2]).any() else 0.0
    sigma = np.hypot(*result.sigma(fit.locate(image, height)).T)
    # Without redundancy no deviation is known.
    if not np.isfinite(sigma).any():
        return None
    box = [float(first_line), float(first_sample), float(last_line), float(last_sample)]
    return {"box": box, "side": GRID,
            "values": [None if value != value else round(value, 4) for value in sigma.tolist()]}
