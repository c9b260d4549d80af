"""What is shown of a result: six questions in the order in which they are asked.

The blocks are those of the record. With a view there are charts too, and the tables and sections
that only a page has room for.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator

from termsel.auto.auto import MAX_EXACT_POINTS
from termsel.core.errors import count_in_words, first_names_in_words, rounded_size_text
from termsel.data.coordinates.crs import short_crs_name
from termsel.data.record.figures import (
    Accuracy,
    InImage,
    OnGround,
    Predicted,
    RoleRmse,
    as_plain_data,
)
from termsel.data.record.record import Record
from termsel.fitting.figures import LEAVE_ONE_OUT
from termsel.results.accuracy import (
    agreement_of_computed,
    are_computed,
    expected_rmse,
    is_prediction_surer,
    lattice_of,
)
from termsel.results.blocks import (
    Block,
    Code,
    Detail,
    Document,
    Fact,
    Note,
    Section,
    Statement,
    TableBlock,
)
from termsel.results.charts import bars, maps
from termsel.results.first_screen import are_all_named, first_screen
from termsel.results.plots import chart_block, why_chart_missing
from termsel.results.selected import blocks_on_selection
from termsel.results.tables import sigma_table
from termsel.results.verdict import (
    CERTAINTY,
    CRITERIA_IN_WORDS,
    ROLE_WORDS,
    criterion_in_words,
    fits_of,
    label_of,
    outliers_in_words,
    verdict_table,
)
from termsel.results.view import View

EXACT_BELOW = 1e-9
"""RMSE [px] that is rounding of the computation alone."""

_UNLIKELY, _FAR_DEVIATIONS = 0.01, 2.576
"""Chance below which a mean error or a shape is no accident, and how many standard deviations."""


def result_document(record: Record, view: View | None = None, picture: str = "",
                    further: tuple[Section, ...] = ()) -> Document:
    """Return the document that shows a result.

    Parameters
    ----------
    record : Record
    view : View, optional
        What charts show, for a page.
    picture : str
        The image, smaller, as a data URL.
    further : tuple of Section
        The sections of plugins, which come last.
    """
    # The strategy auto answers, whatever the problem; without one asked for there is none.
    title = record.data.source if record.strategy else f"{record.data.source}: {record.problem}"
    return Document(
        title, _origin_line(record),
        (*_first_screen_lines(record, view), *_detail_on_fit_crs(record),
         *_residuals_picture(view, picture)),
        # A section without an answer has no heading either.
        (*(Section(title, blocks) for title, answer in (
            ("How accurate is it?", _answer_on_accuracy(record)),
            ("Is it better than conventional models?", _answer_on_conventional(record, view)),
            ("Which points or lines are outliers?", _answer_on_bad_points(record, view)),
            ("In which areas is the model uncertain?", _answer_on_weak_places(view)),
            ("Which terms and features were selected, and why?",
             blocks_on_selection(record, view, picture)),
            ("How can it be repeated?",
             _answer_on_repeating(record, view))) if (blocks := tuple(answer))),
         *further))


_ON_A_PAGE = {": --verbose": " below", "; --verbose lists them": ", listed below",
              "; --verbose shows the option that leaves them out": ""}
"""What a page says in place of the option that shows more on a terminal."""


def _first_screen_lines(record: Record, view: View | None) -> Iterator[Fact]:
    """Yield the facts of the first screen, for a page where there is a `view`.

    Where the screen names an option that shows more, a page refers to what it shows further down.
    """
    for fact in first_screen(record):
        text = fact.text
        if view is not None:
            for on_screen, on_page in _ON_A_PAGE.items():
                text = text.replace(on_screen, on_page)
        yield Fact(text, fact.label)


def _residuals_picture(view: View | None, picture: str) -> Iterator[Block]:
    """Yield the residuals over the image, which a page shows before its first heading."""
    if view is not None:
        yield from chart_block(view, "residuals", maps.image_map(view, picture))


def _detail_on_fit_crs(record: Record) -> Iterator[Block]:
    """Yield a detail on the CRS of the fit, if it is another than that of the data."""
    data = record.data
    if data.fit_crs != data.crs:
        yield Detail(f"Fitted in {short_crs_name(data.fit_crs)}; coordinates are given in "
                     f"{short_crs_name(data.crs)}, heights {data.heights}")


def _answer_on_accuracy(record: Record) -> Iterator[Block]:
    """Yield the answer to "How accurate is it?".

    The statement comes first, then a table for independent check points, with and without outliers
    among them, and sentences on how the figures were found and of which fit they are.
    """
    yield Statement(accuracy_statement(record))
    # Of computed points an RMSE would look like an accuracy.
    accuracy = None if are_computed(record) else record.accuracy
    predicted = record.predicted
    if accuracy:
        yield from _errors_table(accuracy, f", which took no part in any "
                                           f"choice{_scope_of_choice(accuracy)}")
        if record.accuracy_without:
            yield from _errors_table(record.accuracy_without,
                                     f", without {outliers_in_words(record)}")
        if predicted and (_predicts_fit_to_all(record) or not is_prediction_surer(record)):
            yield _prediction_sentence(predicted)
    if (strategy := record.strategy) and strategy.predicted is not None:
        # Compared as they are shown: a difference that nobody sees needs no sentence.
        if (accuracy and predicted
                and rounded_size_text(predicted.rmse) != rounded_size_text(strategy.predicted)):
            yield ("The independent check points have other heights than the control points. At "
                   "the heights of the control points the predicted RMSE is "
                   f"{rounded_size_text(strategy.predicted)} px.")
        # More folds than that are of repeated choices, fewer of points left out one by one.
        yield Detail(
            f"Cross-validation repeated the whole choice in {strategy.folds} folds."
            if strategy.folds > MAX_EXACT_POINTS + 1 else
            "Cross-validation left out each point in turn from the chosen model.")
    if record.final_fit:
        refitted = "features" if record.data.counts.lines else "points"
        count = len(record.final_fit.features)
        yield (f"Exported: the refit to all {count} {refitted}. The measured "
               "accuracy refers to the fit without independent check points, which --no-final "
               "exports.")


def _scope_of_choice(accuracy: Accuracy) -> str:
    """Return how "which took no part in any choice" goes on, if check points were shown before.

    It may be " of this run (3 of them already assessed the fit in A)". It is "" if no point was
    shown before.
    """
    if not accuracy.spent_by:
        return ""
    if accuracy.spent_count < accuracy.image.n:
        reused = f"{accuracy.spent_count} of them"
    else:
        reused = "they"
    return (f" of this run ({reused} already assessed the fit in "
            f"{first_names_in_words(accuracy.spent_by)})")


def accuracy_statement(record: Record) -> str:
    """Return the accuracy as a statement that can be pasted, the surer figure first.

    It stands alone: which RMSE, by what points or by which prediction, its interval, and whether
    anything verifies it. Of computed points it is their agreement with the model, as an RMSE would
    look like an accuracy.
    """
    accuracy = record.accuracy
    expected = expected_rmse(record)
    sentences = []
    if are_computed(record):
        text = agreement_of_computed(record)
        return f"{text[:1].upper()}{text[1:]}."
    # The surer figure comes first: readers quote the first one.
    if expected and is_prediction_surer(record):
        sentences.append(_prediction_sentence(expected, exported=_predicts_fit_to_all(record),
                                              lattice=lattice_of(record) is not None))
    if accuracy:
        sentences += _independent_rmse(record, accuracy)
    elif lattice_of(record) is not None:
        sentences.append("The points of the lattice were computed, so the accuracy of the product "
                         "is not known.")
    elif expected:
        sentences.append("It is not verified: there are no independent check points.")
    else:
        sentences.append("The accuracy is not known: there are no independent check points. Give "
                         "some points the role independent.")
    return " ".join(sentences)


def _predicts_fit_to_all(record: Record) -> bool:
    """Return whether the prediction is for the fit to all points."""
    return record.final_fit is not None and record.final_fit.predicted is not None


def _independent_rmse(record: Record, accuracy: Accuracy) -> Iterator[str]:
    """Yield the RMSE at independent check points, and whether they are still independent."""
    yield _rmse_sentence(accuracy)
    if record.accuracy_without is not None:
        yield f"Without {outliers_in_words(record)}: {_rmse_sentence(record.accuracy_without)}"
    reused = accuracy.spent_count
    n = accuracy.image.n
    # Points that assessed an earlier fit helped to choose this one, if only by what was tried next.
    if reused and 2 * reused >= n:
        points = "These check points" if reused == n else f"{reused} of these check points"
        yield f"{points} already assessed another fit; this RMSE may be optimistic."


def _rmse_sentence(accuracy: Accuracy) -> str:
    """Return the RMSE of independent points with its interval in a sentence."""
    image = accuracy.image
    ground = accuracy.ground
    low, high = image.interval
    metres = f", {rounded_size_text(ground.total)} m on the ground" if ground else ""
    points = count_in_words(image.n, "independent check point")
    return (f"RMSE {rounded_size_text(image.total)} px{metres} at {points} "
            f"(90 % interval {rounded_size_text(low)} to {rounded_size_text(high)} px).")


def _errors_table(accuracy: Accuracy, caption_end: str) -> Iterator[Block]:
    """Yield the errors of independent points as a table, then sentences on their distribution.

    Figures by standards come last, with the reason where a standard gives none. The caption of the
    table begins with the number of points.
    """
    image = accuracy.image
    ground = accuracy.ground
    rows = [("in the image", *_distance_texts(image, "px", image.line, image.sample))]
    shapes = [*_sentences_on_shape(image, "px", {"line": image.line, "sample": image.sample})]
    if ground:
        rows.append(("on the ground", *_distance_texts(ground, "m", ground.x, ground.y)))
        shapes += _sentences_on_shape(ground, "m", {"x": ground.x, "y": ground.y})
    yield TableBlock(f"{count_in_words(image.n, 'independent check point')}{caption_end}",
                     ("", "RMSE", "line or x", "sample or y", "maximum", "CE90"), rows)
    yield from shapes
    # Standards set conditions, such as a number of points, which may not be met.
    for standard, title, meaning in (
            (accuracy.nssda, "NSSDA", "horizontal accuracy at 95 % confidence"),
            (accuracy.asprs, "ASPRS 2024", "RMSE, survey error excluded")):
        value = standard.value
        yield (f"{title}: {rounded_size_text(value)} m, {meaning}." if value is not None else
               Detail(f"{title}: no figure ({standard.reason})."))


def _sentences_on_shape(errors: InImage | OnGround, unit: str,
                        rmse: dict[str, float]) -> Iterator[Block]:
    """Yield the mean errors, and whether the errors are normal; nothing if no mean is known.

    `rmse` is the RMSE by axis. A sentence is a detail unless it shows a bias, or errors that are
    not normal.
    """
    if errors.mean is None:
        return
    means = dict(zip(rmse, errors.mean, strict=True))
    figures = ", ".join(f"{axis} {'+' if mean > 0 else ''}{rounded_size_text(mean)} {unit}"
                        for axis, mean in means.items())
    sentence = f"Mean error: {figures}."
    # A mean of n errors scatters by rmse / sqrt(n): beyond 2.576 of that, 1 % of means are by
    # chance.
    biased_axes = [axis for axis, mean in means.items()
                   if abs(mean) > _FAR_DEVIATIONS * errors.n**-0.5 * rmse[axis] > 0]
    if biased_axes:
        yield f"{sentence} The bias of {' and '.join(biased_axes)} is significant."
    else:
        yield Detail(sentence)
    if errors.normal:
        on_ground = isinstance(errors, OnGround)
        test = "The same test on the ground" if on_ground else "Test of normality (Shapiro, Wilk)"
        chances = [f"{axis} {p:.2g}" for axis, p in zip(rmse, errors.normal, strict=True)]
        sentence = f"{test}: p of {', '.join(chances)}."
        # Errors on the ground are those in the image, transformed: they say nothing new.
        if min(errors.normal) < _UNLIKELY and not on_ground:
            yield f"{sentence} These errors are not normal; the intervals allow for it."
        else:
            yield Detail(sentence)


def _prediction_sentence(
        predicted: Predicted, *, exported: bool = False, lattice: bool = False) -> str:
    """Return the predicted RMSE with its interval in a sentence.

    It says what the prediction is about: the independent check points of the data, if there are
    any, else new points; with `lattice`, places between the points of a product's lattice; with
    `exported`, the refit to all points.
    """
    if lattice:
        scope = "between the points of the lattice"
    elif predicted.points:
        scope = f"at {count_in_words(predicted.points, 'independent check point')}"
    else:
        scope = "of new points within the control area"
    if exported:
        scope += ", for the exported fit to all points"
    if predicted.pixel:
        metres = f", {rounded_size_text(predicted.rmse * predicted.pixel)} m on the ground"
    else:
        metres = ""
    return (f"Predicted RMSE {scope}: {rounded_size_text(predicted.rmse)} px{metres} "
            f"({100 * predicted.level:.0f} % interval {rounded_size_text(predicted.low)} to "
            f"{rounded_size_text(predicted.high)} px).")


def _distance_texts(
        of: InImage | OnGround, unit: str, first: float, second: float) -> tuple[str, ...]:
    """Return total, both axes, maximum and CE90 with their unit, rounded alike."""
    return tuple(f"{rounded_size_text(value)} {unit}" for value in (
        of.total, first, second, of.maximum, of.ce90))


def _answer_on_conventional(record: Record, view: View | None) -> Iterator[Block]:
    """Yield the answer to "Is it better than a conventional model?"."""
    yield record.judgement
    yield from map(Note, record.notes)
    yield from chart_block(view, "baselines")
    yield Detail(_table_of_fits(record))
    yield from (Detail(f"Refused: {label_of(baseline.name)}, as {baseline.refused}.")
                for baseline in record.baselines if baseline.refused)
    yield from map(Detail, _legend_of_fits(record, view))


def _legend_of_fits(record: Record, view: View | None) -> Iterator[str]:
    """Yield sentences that explain the table of all fits.

    Only what the table shows is explained: leave-one-out, marks, dashes, and which figure is the
    accuracy where another one was minimised.
    """
    baselines = record.baselines
    if record.rmse.leave_one_out is not None:
        yield (f"{LEAVE_ONE_OUT}: each control feature by the fit without it, as "
               f"{record.model} corrects by control")
    if record.data.counts.check and any(fitted for _, fitted, *_ in fits_of(record)):
        yield ("* also fitted to the selection points, so their RMSE is a fit"
               + (" (a hollow symbol in the chart)" if view is not None else ""))
    if any(all(rmse.n == 0 for rmse in baseline.rmse.by_role.values()) for baseline in baselines):
        yield "- no redundancy"
    objective = next(iter(record.objectives), "")
    if not record.data.counts.independent:
        return  # no column of theirs is to be explained
    if record.strategy or not objective or record.solver == "all-terms":  # nothing was minimised
        yield "Accuracy: the RMSE at independent check points."
    elif objective == "check-rmse":
        yield ("The search minimised the RMSE at selection points, so it is optimistic; the "
               "accuracy is the RMSE at independent check points.")
    else:
        article = "the " if objective in CRITERIA_IN_WORDS else ""
        yield (f"The search minimised {article}{criterion_in_words(objective)}. Accuracy: the "
               "RMSE at independent check points.")


def _table_of_fits(record: Record) -> TableBlock:
    """Return the RMSE of this result and of all fits without a search.

    A mark says that selection points took part in a fit. Columns of roles without features are left
    out; the interval of the selection points is on the page alone, as a terminal is too narrow.
    """
    rows = []
    keys = []
    for name, fitted_to_check, n_terms, rmse in fits_of(record):
        # Control first: a fit to it, then what took no part.
        figures = [_rmse_as_cell(rmse.control)]
        for of_role in (rmse.check, rmse.independent):
            interval = map(rounded_size_text, of_role.interval) if of_role.interval else "-"
            figures += [_rmse_as_cell(of_role), " to ".join(interval)]
        has_mark = fitted_to_check and record.data.counts.check > 0
        rows.append((name + " *" * has_mark, str(n_terms), *figures))
        keys.append(name)
        if rmse.leave_one_out is not None:
            # Leave-one-out is of all control, so that it has one figure and no interval.
            rows.append((f"  {LEAVE_ONE_OUT}", "", _rmse_as_cell(rmse.leave_one_out), *[""] * 4))
            keys.append(name)
    header = ("fit", "terms", "control", "selection", "interval", "independent check", "interval")
    # Column 3 is the RMSE of selection points, 5 that of independent ones; their intervals follow.
    empty = [column for column in (3, 5) if all(row[column] in ("-", "") for row in rows)]
    shown_columns = [i for i in range(len(header)) if i not in empty and i - 1 not in empty]
    return TableBlock("RMSE [px], with 90 % intervals" if len(shown_columns) > 3 else "RMSE [px]",
                      tuple(header[i] for i in shown_columns),
                      [tuple(row[i] for i in shown_columns) for row in rows],
                      choice="fit", keys=keys,
                      page_only=(shown_columns.index(4),) if 4 in shown_columns else ())


def _rmse_as_cell(rmse: RoleRmse) -> str:
    """Return an RMSE as a cell of a table; "exact" where only rounding is left."""
    total = rmse.total
    if total is None:
        return "-"
    if total < EXACT_BELOW:  # what is left of points that a fit goes through
        return "exact"
    return rounded_size_text(total) if total < 1e5 else f"{total:.2e}"


def _answer_on_bad_points(record: Record, view: View | None) -> Iterator[Block]:
    """Yield the answer to "Which points or lines are outliers?".

    The verdict of the blunder test comes first, then the largest residuals as a chart and as a
    folded table. Of a line the vertex with the larger residual on the ground counts.
    """
    if are_all_named(record):
        yield from map(Detail, verdict_table(record))
    else:
        yield from verdict_table(record)
    if view is None:
        return
    yield from chart_block(view, "worst", bars.bars_of_worst(view))
    # A line has two vertices, each with a row: the larger residual counts.
    on_ground: dict[str, float] = {}
    for row in view.on_ground:
        if row["metres"] is not None:
            on_ground[row["id"]] = max(row["metres"], on_ground.get(row["id"], 0.0))
    listed = f"{len(view.worst):,}" if view.partly else "all"
    rows = []
    for row in view.worst:
        metres = rounded_size_text(on_ground[row["id"]]) if row["id"] in on_ground else "-"
        rows.append((row["id"], row["kind"], str(ROLE_WORDS.get(row["role"], row["role"])),
                     rounded_size_text(row["distance"]), metres,
                     CERTAINTY.get(row["blunder"], "")))
    yield TableBlock(
        f"Residuals of {listed} features, the largest first",
        ("feature", "kind", "role", "residual [px]", "on the ground [m]", "outlier test"), rows,
        choice="picked", keys=[row["id"] for row in view.worst], folded=True)


def _answer_on_weak_places(view: View | None) -> Iterator[Block]:
    """Yield the answer to "In which areas is the model uncertain?"; nothing without a `view`.

    The standard deviation is shown as a chart and a table, or the reason why it is not known.
    """
    if view is None:
        return
    # Without redundancy nothing shows how certain the model is.
    if why := why_chart_missing(view, "sigma"):
        yield f"The standard deviation is not known: {why}."
    elif caveat := view.fit.uncertainty_caveat:
        yield caveat
    yield from chart_block(view, "sigma")
    yield from chart_block(view, "ground")
    if not why:
        yield sigma_table(view)
    yield "termsel plan suggests positions for further points."


def _origin_line(record: Record) -> str:
    """Return a line on model, method, seed and version of a result."""
    strategy = record.strategy
    if strategy:
        by = f"strategy {strategy.name}"
    else:
        by = f"solver {record.solver}, criterion {record.criterion}"
    return (f"Model {record.model}, {by}, seed {record.seed}; termsel "
            f"{record.versions['termsel']}")


def _answer_on_repeating(record: Record, view: View | None) -> Iterator[Block]:
    """Yield how the run is repeated: the command, its limits, and the versions and checksums.

    Without a `view`, as in a text, one line on the origin of the result is all.
    """
    if view is None:
        yield Detail(f"{'' if record.strategy else f'Problem {record.problem}. '}"
                     f"{_origin_line(record)}")
        return
    if view.command:
        yield "Run in the folder of this result:"
        yield Code(f"{view.command} --out again")
    else:
        yield view.no_command
    if record.interrupted:
        yield "This run was interrupted; the command repeats it to its end."
    elif record.budget.seconds:
        yield ("The run had a limit of time, so the result depends on the machine. It took "
               f"{count_in_words(record.evaluations, 'evaluation')}.")
    if record.stability:
        yield ("The frequencies of terms are those of termsel stability. The command repeats the "
               "fit of the stable terms.")
    yield TableBlock("Versions", ("package", "version"), [
        *record.versions.items(),
        *((plugin.name, plugin.version) for plugin in record.plugins.values()),
        ("system of this report", platform.system())])
    yield TableBlock("Checksums (SHA-256)", ("of", "checksum"), [
        ("data as read",
         record.data.sha256), *as_plain_data(record.checksums).items()], folded=True)
