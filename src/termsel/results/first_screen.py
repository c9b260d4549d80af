"""The first screen of a run: what was read, the model, its accuracy, outliers, and a comparison."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePath
from shlex import quote

from termsel.adjustment.bayesian.field import SPLINE_MAX_POINTS, SPLINE_SURE_POINTS
from termsel.auto.methods import BY_NAME
from termsel.core.errors import (
    amount_in_words,
    count_in_words,
    cut,
    percent_text,
    rounded_size_text,
)
from termsel.data.coordinates.crs import LOCAL, is_geographic, short_crs_name
from termsel.data.record.cautions import (
    BEYOND_RPC,
    CONTRADICT,
    MIRRORED,
    ROUNDED,
    SLIP,
    SWAPPED_IMAGE,
)
from termsel.data.record.figures import (
    EXACTLY,
    FEW_EVALUATIONS,
    MANY_INDEPENDENT,
    NO_FIGURE,
    TOO_FEW,
    BaselineRow,
    Outlier,
)
from termsel.data.record.record import Record, WhatWasRead
from termsel.data.record.search import (
    ALL_TERMS_IN_USE,
    FITTED_IN,
    NAMED_BY_USER,
    RPC_UNUSED,
)
from termsel.results.accuracy import (
    accuracy_lines,
    are_places_wrong,
    is_exact,
    lattice_of,
    reused_points_in_words,
)
from termsel.results.blocks import Fact
from termsel.results.verdict import (
    AS_DELIVERED,
    CHANCE,
    NO_FIT,
    NOT_FEW,
    RPC_MODELS,
    are_alike,
    are_errors_large,
    are_too_few_to_test,
    does_nothing_fit,
    fit_that_works,
    label_of,
    may_be_shifted,
    misfit_in_words,
    names_to_leave_out,
    off_option,
    outlier_share_in_words,
    size_of_errors,
    uses_rpc,
    verdict_on_choice,
)

SCREEN_LINES = 12
"""Lines of the first screen, the command that comes last included."""
_SOURCE = 32
"""Characters of the names of files and of ids."""
_MAX_OUTLIERS_NAMED = 3
"""Outliers that are named."""
_LONGEST_OPTION = 60
"""Characters of the option that leaves out outliers."""
_WIDTH, _FULL_WIDTH = 76, 86
"""Characters of a line next to its label, and of one without a label."""
_MOST_OF_A_WARNING = 3
"""Lines that other facts leave to the first warning."""
_INSENSITIVE = 4.0
"""Least error that a test finds, by the size of their errors, above which it is stated."""
_BLUNT = 0.005
"""Share of the extent of the features in the image of an error that must be exceeded to be
detected."""
_CONTRADICTED = 2.0
"""Times the upper end of the predicted RMSE beyond which independent points contradict it."""
KNOWN_CAMERA = "known-camera"
"""Method of a photo whose focal length is stated."""

_PROVING = ("exact", "all-terms")
"""Solvers whose own search is the proof, or needs none."""

_BENDING = ("field", "tps")
"""Models that follow local deformation."""
_DEGREE_NAMES = {1: "affine", 2: "quadratic", 3: "cubic"}
_DIMENSIONS = {"poly2d": "2-D", "poly3d": "3-D"}


def first_screen(record: Record) -> list[Fact]:
    """Return the facts of the first screen; one more line is left for the command that follows.

    The facts are shortened until they and the first warning fit; further warnings are shown as far
    as there is room.
    """
    warnings = _urgent_warnings_and_notes(record)
    # The first warning must be seen; of further ones a line says how many there are.
    reserved = _lines_of_first(warnings)
    room = SCREEN_LINES - 1 - reserved - (1 if len(warnings) > 1 else 0)
    facts = _brief_facts(record, brief=0)
    for brief in (1, 2, 3):
        if sum(map(_lines_of_fact, facts)) > room:
            facts = _brief_facts(record, brief)
    return [*facts,
            *_fitting_cautions(warnings, SCREEN_LINES - 1 - sum(map(_lines_of_fact, facts)))]


def _brief_facts(record: Record, brief: int) -> list[Fact]:
    """Return all facts but cautions, the shorter the larger `brief` is.

    0 gives them in full, 1 leaves out the second lines of a topic, 2 also counts the outliers in
    place of naming them, and 3 also leaves out comparisons and the search.
    """
    compared: list[str] = []
    if record.feasible and brief < 3 and not are_places_wrong(record):
        # The best rival that needs no search, and the conventional fit.
        rival = next((row for row in record.baselines if row.name == record.reference), None)
        if rival is not None:
            compared += _comparison_with_rival(record, rival)
        if record.strategy is None and record.baselines:
            compared += _conventional_rmse(record, record.baselines[0])
    search = list(_facts_on_search(record)) if brief < 3 else []
    # The first line of a topic says it, further ones explain.
    if brief:
        compared = compared[:1]
        search = search[:1]
    outliers = _outlier_count_line(record) if brief >= 2 else outlier_lines(record)
    # Outliers may be found among features that nothing fits, which matters more than they do.
    if record.outliers and does_nothing_fit(record) and not may_be_shifted(record) and (
            fit_that_works(record) is None):
        outliers = [_no_model_in_words(record), *outliers]
    return [*_facts_on_data(record, brief), Fact(""), Fact(_model_in_words(record), "Model"),
            *_label_facts("Accuracy", accuracy_lines(record)), *_label_facts("Outliers", outliers),
            *_label_facts("Compared", compared), *_label_facts("Search", search)]


def _label_facts(label: str, lines: Iterable[str]) -> Iterator[Fact]:
    """Yield one fact for each line; the first has the label."""
    for i, line in enumerate(lines):
        yield Fact(line, label if i == 0 else " ")


def _lines_of_fact(fact: Fact) -> int:
    """Return how many lines of text a fact takes."""
    width = _WIDTH if fact.label else _FULL_WIDTH
    return max(1, -(-len(fact.text) // width))


def _facts_on_data(record: Record, brief: int) -> Iterator[Fact]:
    """Yield the file, its features and its CRS, then the features of each role.

    `brief` is how far the screen is shortened: from 1 on the features that were left out, with
    their reasons, are not named. What a reader would check first stands in the first line: which
    file, how many features, where on Earth.
    """
    data = record.data
    names = ", ".join(PurePath(name).name for name in data.source.split(", "))
    read = data.read or _read_by_earlier_versions(record)
    # A kind that the file does not have is not named.
    features = ", ".join(count_in_words(number, noun) for number, noun in (
        (read.points, "point"), (read.lines, "line")) if number)
    if read.lattice is not None:
        features += f", a lattice of {read.lattice[0]} lines and {read.lattice[1]} columns"
    heights = ""
    if read.without_height:
        if read.without_height == read.points + read.lines:
            heights = " without heights"
        else:
            heights = f" ({read.without_height} without a height)"
    crs = "coordinates without a CRS" if data.crs == LOCAL else short_crs_name(data.crs)
    image_in_file = f" ({read.place})" if read.place else ""
    unit = f"; z in {read.z_unit}" if read.z_unit else ""
    origin = f"; image coordinates from {read.image_origin}" if read.image_origin else ""
    opening = f"{cut(names, _SOURCE)}: {features}{heights}"
    end = f", {crs}{image_in_file}{unit}{origin}"
    # Without heights a model that bends may follow the relief in place of the image.
    may_be_relief = read.without_height and record.model in _BENDING and data.crs != LOCAL
    hint = " (--dem adds them)" if may_be_relief else ""
    yield Fact(f"{opening}{hint}{end}" if len(f"{opening}{hint}{end}") <= _FULL_WIDTH
               else f"{opening}{end}")
    yield Fact(roles_of(record))
    reasons = [f"{len(ids)} {reason}" for reason, ids in read.left_out.items()]
    if not reasons or brief:
        return
    # Reasons with their counts, if they fit into a line.
    unused = f"not used: {'; '.join(reasons)}"
    if len(unused) > _WIDTH:
        noun = record.data.counts.word.removesuffix("s")
        unused = f"not used: {count_in_words(sum(map(len, read.left_out.values())), noun)}"
    yield Fact(unused)


def roles_of(record: Record) -> str:
    """Return how many features have which role, in the words of the field."""
    counts = record.data.counts
    independent = _number_in_words(counts.independent, "independent check point")
    # termsel itself set all of them aside: whoever reads the figures must know.
    if record.data.read and 0 < counts.independent == record.data.read.set_aside:
        if counts.independent > 1:
            points = "independent check points"
        else:
            points = "an independent check point"
        independent = f"{counts.independent:,} set aside as {points}"
    if record.strategy:
        kinds = [count_in_words(number, noun) for number, noun in (
            (counts.lines, "line"), (counts.control + counts.check, "point")) if number]
        purpose = "fit" if is_only_method(record) else "choose and fit"
        return f"{' and '.join(kinds)} to {purpose} the model, {independent}"
    kinds = [count_in_words(number, noun) for number, noun in (
        (counts.control, "control point"), (counts.lines, "control line")) if number]
    return f"{', '.join(kinds)}, {_number_in_words(counts.check, 'selection point')}, {independent}"


def is_only_method(record: Record) -> bool:
    """Return whether the user named the method or the model, so that nothing was chosen."""
    return record.strategy is not None and record.strategy.reason.startswith(NAMED_BY_USER)


def _number_in_words(number: int, noun: str) -> str:
    """Return a number with its noun, "no" for 0."""
    return count_in_words(number, noun) if number else f"no {noun}s"


def _read_by_earlier_versions(record: Record) -> WhatWasRead:
    counts = record.data.counts
    return WhatWasRead(counts.control + counts.check + counts.independent + counts.off,
                       counts.lines, 0, "", "", {})


def model_title(record: Record) -> str:
    """Return the structure of the model in words, such as "cubic 2-D polynomial"."""
    strategy = record.strategy
    if strategy is None:
        return _title_by_degree(record.model, record.options.model.get("degree"))
    if shift := _shift_in_words(record):
        return f"vendor RPC {shift}"
    # So few points in a plane decide nothing: what is called a cubic polynomial is mostly affine.
    if record.model == "field" and record.selection.n_features <= SPLINE_SURE_POINTS:
        return "average of a similarity, polynomials and a spline"
    if record.model == "field" and record.selection.n_features < SPLINE_MAX_POINTS:
        return "average of polynomials, a spline and local deformation"
    if strategy.chosen == record.model and len(strategy.candidates) <= 1:
        return _title_by_degree(record.model, record.options.model.get("degree"))
    if (candidate := BY_NAME.get(strategy.chosen)) is None:
        return label_of(strategy.chosen)
    _article, _, title = candidate.title.partition(" ")
    return title


def _title_by_degree(model: str, degree: object) -> str:
    """Return the name of a model in words, with its degree if it is a polynomial.

    A model that has neither words nor an integer degree keeps its own name, such as "tps".
    """
    if model == "rfm":
        return "rational function model"
    if model not in _DIMENSIONS or not isinstance(degree, int):
        return model
    polynomial = f"{_DIMENSIONS[model]} polynomial"
    # A degree has a name up to the third; beyond, the number says more.
    if degree in _DEGREE_NAMES:
        return f"{_DEGREE_NAMES[degree]} {polynomial}"
    return f"{polynomial} of degree {degree}"


def _shift_in_words(record: Record) -> str:
    """Return the correction of a vendor's RPC in words: its shift [px], and where it has that.

    Returns "" for a model without a constant in either axis, which only the affine correction of an
    RPC has, and for a correction whose coefficients are all 0.
    """
    coefficients = record.coefficients
    if record.data.rpc is None or not {"line.bias:1", "sample.bias:1"} <= coefficients.keys():
        return ""
    # All are 0 where the correction is a local field, and no constant.
    if not any(coefficients.values()):
        return ""
    # Coefficients are in the scaled units of the image.
    line = coefficients["line.bias:1"] * record.scaling.line_scale
    sample = coefficients["sample.bias:1"] * record.scaling.sample_scale
    shift = f"by {line:+.2f} px in line and {sample:+.2f} px in sample"
    # With further coefficients the correction differs from place to place.
    further = coefficients.keys() - {"line.bias:1", "sample.bias:1"}
    if any(coefficients[name] for name in further):
        return f"corrected {shift} at the middle of the control"
    return f"shifted {shift}"


def _model_in_words(record: Record) -> str:
    """Return the model, and how it was chosen or selected.

    For the automatic choice the text says among how many methods, and whether the chosen one is the
    best of them, if more than one was held out; and why an RPC is used or not. For a search it says
    how many of the terms and features on offer are selected, and by which solver unless all are, or
    over how many selections the terms are stable.
    """
    title = model_title(record)
    strategy = record.strategy
    if strategy:
        figures = {row.name: row.predicted for row in strategy.candidates
                   if row.predicted is not None}
        # Cross-validation may prefer another model by less than its own noise.
        best = min(figures, key=lambda name: figures[name], default="") == strategy.chosen
        if len(figures) > 1 and record.predicted is not None:
            how = f" ({'best of' if best else 'chosen among'} {len(figures)} in cross-validation)"
        elif strategy.reason.endswith(ALL_TERMS_IN_USE) and not _shift_in_words(record):
            how = f", all {record.offered.n_terms} terms"
        else:
            how = ""
        rpc = f". {strategy.rpc}" if strategy.rpc and not _why_rpc_unused(record) else ""
        return f"{title}{how}{_fit_crs_in_words(record)}{rpc}"
    selection = record.selection
    offered = record.offered
    # Blunders that were rejected before the search were not on offer to it.
    excluded = 0 if were_selectable(record) else sum(
        outlier.excluded and outlier.role == "control" for outlier in record.outliers)
    n_features = max(offered.n_features - excluded, selection.n_features)
    text = (f"{title}, {share_in_words(selection.n_terms, offered.n_terms)} terms, "
            f"{share_in_words(selection.n_features, n_features)} {record.data.counts.word}")
    if record.stability:
        return f"{text}; stable over {record.stability.repeats} selections"
    is_all_in_use = (selection.n_terms == offered.n_terms
                     and selection.n_features == offered.n_features)
    return text if is_all_in_use else f"{text}, by {_solver_text(record)}"


def _fit_crs_in_words(record: Record) -> str:
    """Return the CRS that the model is fitted in; "" where it is that of the data."""
    data = record.data
    return "" if data.fit_crs == data.crs else f", fitted in {short_crs_name(data.fit_crs)}"


def _solver_text(record: Record) -> str:
    """Return the solver, and that of the second step if it has its own."""
    options = record.options.problem
    second = options.get("then") if options.get("steps", "joint") != "joint" else None
    first = _solver_in_words(record.solver)
    return f"{first} and {_solver_in_words(str(second))}" if second else first


_SEARCHES = {"ga": "genetic search", "ga-steady": "genetic search", "exact": "exact search",
             "random": "random search", "pso": "particle swarm", "nsga2": "NSGA-II",
             "ica": "imperialist competition", "swap": "exchange of single ones",
             "deap": "DEAP", "pymoo": "pymoo"}
"""What the screen calls searches, by the names of their solvers."""


def _solver_in_words(name: str) -> str:
    """Return what the screen calls a search: words, or the name of its solver."""
    return _SEARCHES.get(name, f"the solver {name}")


def were_selectable(record: Record) -> bool:
    """Return whether a search could select outliers: it was asked to keep them."""
    return record.options.problem.get("blunders") == "keep"


def share_in_words(selected: int, offered: int) -> str:
    """Return how many of those on offer are chosen."""
    return f"all {offered}" if selected == offered else f"{selected} of {offered}"


def outlier_lines(record: Record) -> list[str]:
    """Return the worst outliers of each kind: rejected, in use, and independent check points.

    Each line names the worst few with their errors. Where no feature contradicts the others, or
    nothing fits and independent points alone stand out, the only line says so, and why this may
    mean little; points of a lattice are never tested.
    """
    # An outlier that is in use weakens the model, one that was rejected does not.
    rejected, used, independent = groups = _group_outliers(record)
    if lattice_of(record) is not None:
        return ["not tested: the points of a lattice were computed"]
    if not any(groups):
        return [_no_outlier_clause(record)]
    lines = []
    if rejected:
        could = ", which could select them" if were_selectable(record) else ""
        lines.append(f"{_count_in_words(rejected)} {_how_excluded(record)}{could}: "
                     f"{_list_worst(rejected)}")
    if used:
        lines.append(f"{_count_in_words(used)} still in use: {_list_worst(used)}")
    # Where nothing fits, one check point is no worse than the others.
    if independent and not lines and does_nothing_fit(record):
        return [_no_outlier_clause(record)]
    if independent:
        lines.append(f"{count_in_words(len(independent), 'independent check point')} "
                     f"{'contradicts' if len(independent) == 1 else 'contradict'} the model: "
                     f"{_list_worst(independent)}")
    # A longer option would not fit into the command that follows.
    if len(off_option(record)) > _LONGEST_OPTION and not may_be_shifted(record):
        lines[-1] += "; --verbose shows the option that leaves them out"
    return lines


def _outlier_count_line(record: Record) -> list[str]:
    """Return how many outliers there are in one line, which takes the place of `outlier_lines`.

    Those lines come back themselves where they take one line anyway, or where there is no outlier.
    """
    rejected, used, independent = _group_outliers(record)
    named = outlier_lines(record)
    # A count saves nothing where the names take one line.
    height = sum(map(_lines_of_fact, _label_facts("Outliers", named)))
    if height == 1 or not any((rejected, used, independent)):
        return named
    counts = []
    if rejected:
        counts.append(f"{len(rejected)} {_how_excluded(record)}")
    if used:
        counts.append(f"{len(used)} still in use")
    if independent:
        counts.append(count_in_words(len(independent), "independent check point"))
    return [f"{', '.join(counts)}; --verbose lists them"]


def _how_excluded(record: Record) -> str:
    """Return how outliers came to be out of use: before the search, or by its selection."""
    return "not selected by the search" if were_selectable(record) else "rejected"


def _count_in_words(outliers: Sequence[Outlier]) -> str:
    """Return the number of outliers with their noun: points, lines, or features if both."""
    kinds = {outlier.kind for outlier in outliers}
    return count_in_words(len(outliers), kinds.pop() if len(kinds) == 1 else "feature")


def _no_outlier_clause(record: Record) -> str:
    """Return a clause that no outlier was detected, or not tested for, and why this may say little.

    Independent points may contradict the prediction all the same. A test that finds nothing may be
    blind: of few points each is fitted exactly, and where nothing fits no point stands out. The
    clause says so, or the size of an error that would have been found, where that is large against
    the image.
    """
    test = record.blunder_test
    accuracy = record.accuracy
    predicted = record.predicted
    if record.options.data.get("tested"):
        return "tested in an earlier run, not in this one"
    # Independent points far outside the prediction are outliers as a whole, or the model is.
    if (accuracy and predicted and predicted.weighted is not True
            and accuracy.image.total > _CONTRADICTED * predicted.high):
        return (f"none among the others, but the "
                f"{count_in_words(accuracy.image.n, 'independent check point')} contradict"
                f"{'s' if accuracy.image.n == 1 else ''} the prediction: check "
                f"{'it' if accuracy.image.n == 1 else 'them'}")
    if test is None:
        return "not tested"
    features = count_in_words(test.features, record.data.counts.word.removesuffix("s"))
    errors = size_of_errors(record)
    # Where nothing fits, everything is an outlier, and the test finds none.
    nothing_fits = errors > NO_FIT * test.extent
    is_blind = test.limit is None or are_too_few_to_test(test, errors)
    if is_blind and test.features < NOT_FEW:
        check = "; with errors this large check each of them" if nothing_fits else ""
        return f"not detectable: {features} {'is' if test.features == 1 else 'are'} too few{check}"
    if nothing_fits and fit_that_works(record):
        return f"not detectable: {misfit_in_words(record)}"
    if nothing_fits:
        return f"not detectable: {_no_model_in_words(record)}"
    if is_blind or test.limit is None:
        return f"not detectable by this model among {features}"
    # The size of their errors is 0 where it is not known.
    if test.limit > min(_BLUNT * test.extent, _INSENSITIVE * errors or test.extent):
        return (f"none found among {features}; below {rounded_size_text(test.limit)} px most "
                "cannot be detected")
    return f"none among {features}"


def _no_model_in_words(record: Record) -> str:
    """Return that no model fits, and what may be wrong with the data."""
    word = record.data.counts.word
    why = ("x and y have too few decimals" if _note_with(record, ROUNDED) else
           f"check the columns, the units, the CRS, and that all {word} are of this image, one in "
           "each row")
    return f"{misfit_in_words(record)}; {why}"


def _note_with(record: Record, words: str) -> str:
    """Return the first note of a record that has some words in it; "" if none has."""
    return next((note for note in record.notes if words in note), "")


def _group_outliers(record: Record) -> tuple[list[Outlier], list[Outlier], list[Outlier]]:
    """Return outliers that were rejected, those in use, and independent ones; the worst first."""
    worst = sorted(record.outliers, key=lambda outlier: -outlier.error)
    # Independent check points were never in use, so that they are not rejected either.
    control = [outlier for outlier in worst if outlier.role != "independent"]
    return ([outlier for outlier in control if outlier.excluded],
            [outlier for outlier in control if not outlier.excluded],
            [outlier for outlier in worst if outlier.role == "independent"])


def are_all_named(record: Record) -> bool:
    """Return whether the first screen names all outliers, with the option that leaves them out."""
    return (max(map(len, _group_outliers(record))) <= _MAX_OUTLIERS_NAMED
            and len(off_option(record)) <= _LONGEST_OPTION)


def _list_worst(outliers: Sequence[Outlier]) -> str:
    """Return the ids of the worst outliers with their errors [px], as a list in words.

    They are named in their order, up to `_MAX_OUTLIERS_NAMED`; the unit stands at the first.
    """
    texts = []
    for i, outlier in enumerate(outliers[:_MAX_OUTLIERS_NAMED]):
        certainty = "" if outlier.certainty == "certain" else f" ({outlier.certainty})"
        unit = " px" if i == 0 else ""
        texts.append(f"{cut(outlier.id, _SOURCE)} "
                     f"{rounded_size_text(outlier.error)}{unit}{certainty}")
    if len(outliers) > _MAX_OUTLIERS_NAMED:
        texts.append(f"{len(outliers) - _MAX_OUTLIERS_NAMED} more")
    return ", ".join(texts)


def _comparison_with_rival(record: Record, rival: BaselineRow) -> Iterator[str]:
    """Yield how a rival compares, at the independent check points or else in cross-validation.

    Many independent points compare both models best. Few are a matter of chance, so that the errors
    in cross-validation count. A search is held against the automatic choice, the choice against its
    best rival, and the sentence ends with what to do. Nothing is yielded where the RMSE of either
    is not known. A corrected RPC is also compared with the RPC as it was delivered, and with that
    alone if its rival is another correction or nothing was held out.
    """
    strategy = record.strategy
    by_held_out = strategy is not None and not _points_compare_better(record)
    # A single point is predicted by no other: only the RPC as delivered can be compared there.
    if by_held_out and record.predicted is None:
        if _shift_in_words(record):
            yield from _rmse_as_delivered(record)
        return
    if strategy is not None and by_held_out:
        # Those of both models alone: the prediction of the whole choice is larger than either.
        own_rmse = next((row.predicted for row in strategy.candidates
                         if row.name == strategy.chosen), None)
        rival_rmse = rival.predicted
    else:
        accuracy = record.accuracy_without or record.accuracy
        own_rmse = record.rmse.independent.total if accuracy is None else accuracy.image.total
        rival_rmse = rival.rmse.independent.total
    if own_rmse is None or rival_rmse is None:
        return
    # Another correction of the same RPC is nearly the chosen one.
    if _shift_in_words(record) and rival.name.startswith(RPC_MODELS) and rival.name != AS_DELIVERED:
        yield from _rmse_as_delivered(record)
        return
    name = "automatic choice without a search" if strategy is None else _rival_in_words(rival)
    if strategy is not None:
        gains = {row.name: row.gain for row in strategy.candidates}
        verdict = verdict_on_choice(own_rmse, rival_rmse, record.reference, gains,
                                    at_points=not by_held_out)
    elif are_alike(own_rmse, rival_rmse):
        verdict = "the search gains nothing"
    elif rival_rmse > own_rmse:
        verdict = f"the search is better by {100 * (1 - own_rmse / rival_rmse):.0f} %"
    elif record.solver == "all-terms":
        verdict = "better; leave out --model"
    else:
        verdict = "better; leave out the search"
    if by_held_out:
        # The screen states the prediction of the whole choice, repeated. The RMSE of this model
        # alone is added where it reads differently from that and from the rival's.
        own_text = rounded_size_text(own_rmse)
        rival_text = rounded_size_text(rival_rmse)
        if record.predicted is None:
            predicted_text = ""
        else:
            predicted_text = rounded_size_text(record.predicted.rmse)
        own = "" if own_text in (predicted_text, rival_text) else f", this model {own_text}"
        yield f"{name} {rival_text} px in leave-one-out{own}: {verdict}"
    else:
        yield f"{name} {rounded_size_text(rival_rmse)} px: {verdict}"
    if _shift_in_words(record) and rival.name != AS_DELIVERED:
        yield from _rmse_as_delivered(record)


def _rival_in_words(rival: BaselineRow) -> str:
    """Return what the screen calls a rival: its label, with the DLT spelt out."""
    label = label_of(rival.name)
    return "direct linear transformation (DLT)" if label == "DLT" else label


def _rmse_as_delivered(record: Record) -> Iterator[str]:
    """Yield the RMSE of the vendor's RPC without a correction."""
    for row in record.baselines:
        size = row.rmse.independent.total or row.predicted
        if row.name == AS_DELIVERED and size is not None:
            yield f"RPC as delivered: {rounded_size_text(size)} px"


def _points_compare_better(record: Record) -> bool:
    """Return whether independent check points compare models more surely than cross-validation."""
    # Points that contradict all others say nothing of either model.
    accuracy = record.accuracy_without or record.accuracy
    return accuracy is not None and (
        record.predicted is None or accuracy.image.n >= MANY_INDEPENDENT)


def _conventional_rmse(record: Record, row: BaselineRow) -> Iterator[str]:
    """Yield the RMSE of the conventional fit, of all terms to all control, at independent points.

    Nothing is yielded if that is not known, or if the fit is the record's own. The text says what
    the record's fit lacks: "fit to all 24 points" if it left out features, else "fit of all 12
    terms".
    """
    total = row.rmse.independent.total
    if total is None or not row.determined or record.solver == row.name:
        return
    # The conventional fit has the outliers that the record's fit is without.
    excluded = any(outlier.excluded for outlier in record.outliers)
    lacks_features = record.selection.n_features < record.offered.n_features
    if lacks_features:
        fitted = f"fit to all {record.offered.n_features} {record.data.counts.word}"
    else:
        fitted = f"fit of all {record.offered.n_terms} terms"
    yield f"{fitted}{', outliers included' if excluded else ''}: {rounded_size_text(total)} px"


def _facts_on_search(record: Record) -> Iterator[str]:
    """Yield what is proven of the selection, if anything is, and the size of the Pareto front.

    That is the optimum, that nothing is feasible, or the gap to the optimum. A proof that a solver
    merely claims is left out here: the details say who claims it.
    """
    certificate = record.certificate
    if certificate is not None and not certificate.claimed_by:
        subsets = amount_in_words(certificate.subsets, "subset")
        if certificate.optimal:
            if record.solver in _PROVING:
                of_search = "proven optimum"
            else:
                of_search = f"{record.solver} found the optimum"
            yield f"{of_search}: {subsets} enumerated or excluded by bounds"
        elif certificate.feasible is False:
            yield f"proven: no selection is feasible ({subsets})"
        elif isinstance(certificate.optimum, float) and isinstance(certificate.gap, float):
            yield (f"optimality gap {percent_text(certificate.gap)}; --solver exact finds the "
                   "optimum")
        elif isinstance(certificate.gap, float) and certificate.gap <= 1.0:
            yield f"not proven: optimality gap at most {percent_text(certificate.gap)}"
        elif isinstance(certificate.gap, float) or record.solver in _PROVING:
            # No bound, or one of which the gap is a multiple, tells nothing of the selection.
            yield "not proven: no selection is excluded yet, for lack of time"
    if len(record.front) > 1:
        sizes = [int(next(iter(member.objectives.values())) or 0) for member in record.front]
        noun = next(iter(record.front[0].objectives)).removeprefix("n_")
        yield (f"Pareto front of {len(sizes)} selections, {min(sizes)} to {max(sizes)} {noun}; "
               "--verbose lists them")


def _urgent_warnings_and_notes(record: Record) -> list[str]:
    """Return urgent warnings, then each note that neither they nor the facts say already."""
    accuracy = record.accuracy
    reused = accuracy is not None and bool(reused_points_in_words(accuracy))
    heights = _caution_on_heights(record)
    read = record.data.read
    doubt = read.doubt.casefold() if read else ""
    is_exact_said = is_exact(record)
    # Wrong heights under an RPC make every figure one of other places.
    wrong_heights = [note for note in record.notes if BEYOND_RPC in note]
    if BEYOND_RPC in _why_rpc_unused(record):
        wrong_heights.clear()
    # What outliers bring about matters less than that there are some.
    notes = sorted(record.notes, key=lambda note: CONTRADICT not in note)
    return [*_urgent_warnings(record), *wrong_heights,
            *(note for note in notes if note and not _is_shown(note)
              and BEYOND_RPC not in note
              and note not in (heights, *_said_of_rpc(record))
              and not (is_exact_said and EXACTLY in note)
              and not (read and read.mixed and note == read.mixed)
              and not (doubt and note.casefold().startswith(doubt))
              and not (reused and " no longer independent: " in note))]


def _caution_on_heights(record: Record) -> str:
    """Return the caution that the heights of the DEM may not be those of the control.

    Returns "" where the record has no such doubt.
    """
    doubt = record.data.read.height_doubt if record.data.read else ""
    if not doubt:
        return ""
    # The note of the result that begins alike also says what it does to a map in px.
    opening = doubt.partition("; ")[0]
    return next((note for note in record.notes if note.startswith(opening)), doubt)


def _said_of_rpc(record: Record) -> tuple[str, ...]:
    """Return what the lines above the cautions say of the RPC, as a note may say it again."""
    return (record.strategy.rpc,) if record.strategy else ()


def _why_rpc_unused(record: Record) -> str:
    """Return why the RPC that was given is not used; "" if it is, or if there is none."""
    reason = record.strategy.rpc if record.strategy else ""
    return reason if reason.startswith(RPC_UNUSED) else ""


def _fitting_cautions(warnings: Sequence[str], room: int) -> Iterator[Fact]:
    """Yield the most urgent warnings that fit into `room` lines, and how many more there are.

    A warning that does not fit as a whole is given by its first sentence. The first warning is
    shown whatever the room: at least its first sentence.
    """
    label = "Caution"
    for i, warning in enumerate(warnings):
        remaining = len(warnings) - i
        space = room - (1 if remaining > 1 else 0)
        texts = [warning.removesuffix("."), _first_sentence_of(warning)]
        facts = [Fact(text, label) for text in texts]
        largest = max(space, _lines_of_fact(facts[-1]) if i == 0 else 0)
        fitting = [fact for fact in facts if _lines_of_fact(fact) <= largest]
        if not fitting:
            yield Fact(f"{count_in_words(remaining, 'more note')}: --verbose", label)
            return
        yield fitting[0]
        room -= _lines_of_fact(fitting[0])
        label = " "


def _lines_of_first(warnings: Sequence[str]) -> int:
    """Return the lines that the first warning needs: its first sentence, or some more."""
    if not warnings:
        return 0
    lines_of_whole = _lines_of_fact(Fact(warnings[0].removesuffix("."), "Caution"))
    return max(min(lines_of_whole, _MOST_OF_A_WARNING),
               _lines_of_fact(Fact(_first_sentence_of(warnings[0]), "Caution")))


def _first_sentence_of(note: str) -> str:
    """Return the first sentence of a note, without its full stop."""
    # A full stop within a number or a name is not followed by a space.
    head, stop, _ = note.partition(". ")
    return head if stop else note.removesuffix(".")


def _is_shown(note: str) -> bool:
    """Return whether the lines above the warnings already say a note."""
    return note.startswith((FITTED_IN, "The vendor's RPC", "The search removed", "With ",
                            "Left out for"))


def _urgent_warnings(record: Record) -> Iterator[str]:
    """Yield warnings that come before any figure, the costliest mistake first.

    Each is what the screen has room for; the notes of the result say more. The first is that no
    selection is feasible. Warnings of data come before those of figures, as with wrong coordinates
    all figures are those of other places.
    """
    if not record.feasible and NO_FIGURE in record.judgement:
        yield (f"do not use this fit: the criterion {NO_FIGURE} for any selection that was found. "
               "Choose another (--criterion); if it is your own, its score() gives NaN or infinity")
    elif not record.feasible and TOO_FEW in record.judgement:
        yield ("do not use this fit: a budget of "
               f"{amount_in_words(record.evaluations, 'evaluation')} is "
               f"too small to find a selection. Allow {FEW_EVALUATIONS:,} or more (--evaluations, "
               "--seconds)")
    elif not record.feasible:
        if record.adjustment.converged is False:
            why = "it did not converge"
        else:
            why = "it breaks a condition (rank, pole or number of terms)"
        yield f"do not use this fit: {why}. Measure more control points or take a smaller model"
    read = record.data.read
    if read and read.doubt:
        # The note says how to exchange them, and when it is the other pair.
        doubt = read.doubt.casefold()
        yield next((f"{note[0].lower()}{note[1:]}" for note in record.notes
                    if note.casefold().startswith(doubt)),
                   f"{read.doubt.partition(':')[0]}: check them before anything else")
    if read and read.mixed:
        doubt = f"{read.mixed[:1].lower()}{read.mixed[1:]}"
        yield f"correct the coordinates first: {_first_sentence_of(doubt)}"
    if heights := _caution_on_heights(record):
        # Without the name of the raster and how the difference was found it fits into a line.
        difference, _, found_by = heights.rpartition(" (median of ")
        yield f"the DEM {difference[difference.rindex(' is ') + 1:]}{found_by.partition(')')[2]}"
    if unused := _why_rpc_unused(record):
        yield unused
    if read and read.two_groups:
        shift = read.two_groups.partition(", as if")[0]
        yield f"check the datum of the points: {shift}"
    elif may_be_shifted(record):
        yield (f"are rows shifted, or matches wrong? {outlier_share_in_words(record)} contradict "
               "the others")
    if doubt := _caution_on_known_camera(record):
        yield doubt
    if record.interrupted:
        yield "the run was interrupted; run it again to its end"


def _caution_on_known_camera(record: Record) -> str:
    """Return that a camera of which nothing is stated fits clearly better than the stated one.

    Returns "" where none does. The caution asks for the distortion where none is stated: a focal
    length alone means a lens without distortion.
    """
    strategy = record.strategy
    if strategy is None or strategy.chosen != KNOWN_CAMERA:
        return ""
    # Cameras whose focal length is fitted, with nothing stated of them.
    figures = {row.name: row.predicted for row in strategy.candidates if row.predicted is not None}
    free_cameras = {name: figures[name] for name in figures
                    if name in BY_NAME and BY_NAME[name].central}
    best = min(free_cameras, key=lambda name: free_cameras[name], default="")
    # CHANCE is the ratio of two such figures that differ by chance.
    if not best or figures.get(KNOWN_CAMERA, 0.0) <= CHANCE * free_cameras[best]:
        return ""
    distortion = str(record.options.model.get("distortion") or "")
    if any(float(number) for number in distortion.split(",") if number):
        remedy = "check the focal length and the distortion that are stated"
    else:
        remedy = ("does the lens distort? State it with --set camera_distortion=K1,K2, or check "
                  "the focal length")
    return (f"{BY_NAME[best].title}, of which nothing is stated, has "
            f"{rounded_size_text(free_cameras[best])} px in leave-one-out, the camera as stated "
            f"{rounded_size_text(figures[KNOWN_CAMERA])} px: {remedy}")


def options_of_next_run(record: Record) -> dict[str, str]:
    """Return the options, with their values, that would correct what is wrong with this run.

    There are none where nothing is wrong, or no option would correct it: the next step is another
    one then.
    """
    read = record.data.read
    # Wrong coordinates come first: points may look like blunders for no other reason.
    if read and read.mixed:
        return {}
    if read and read.doubt:
        pair = "line-sample" if read.doubt.startswith(SWAPPED_IMAGE) else "xy"
        return {"--set": f"swapped={pair}"}
    if may_be_shifted(record):
        return {}
    rejected, used, _ = _group_outliers(record)
    names = names_to_leave_out(record) if rejected or used or not does_nothing_fit(record) else ""
    # A command that is complete is better than advice.
    if names and len(off_option(record)) <= _LONGEST_OPTION:
        return {"--off": names}
    # Points alone without heights look like those of a map; a fit in another CRS than that of the
    # data is in a projection that was found already.
    is_like_a_map = (read is not None and not read.lines and read.without_height == read.points
                     and record.data.fit_crs == record.data.crs)
    if (is_like_a_map and is_geographic(record.data.crs) and does_nothing_fit(record)
            and not _note_with(record, ROUNDED)):
        return {"--crs": "auto"}
    return {}


def next_step_for_user(record: Record, folder: str = "", command: str = "",
                       page: str = "") -> str:
    """Return the next step for the user, as a command if one can be typed.

    `folder` is where the result was written, "" if it was not. `command` is the command of this run
    with `options_of_next_run`; without it the step names the options. `page` is the report of this
    run, "" if there is none.
    """
    read = record.data.read
    if read and read.mixed:
        return "Next: correct the coordinates, then run again"
    if options := options_of_next_run(record):
        pairs = " ".join(f"{name} {quote(value)}" for name, value in options.items())
        purpose = "   (finds the projection, if this is a map)" if "--crs" in options else ""
        return f"Next: {command or f'run again with {pairs}'}{purpose}"
    if may_be_shifted(record):
        return "Next: compare some of these points with the map before leaving any out"
    if fit_that_works(record):
        return ("Next: give the RPC of this image, or leave it out" if uses_rpc(record)
                else "Next: leave the model out, and one is chosen that fits")
    if _note_with(record, ROUNDED):
        return "Next: take the coordinates with more decimals from their source, then run again"
    if does_nothing_fit(record):
        return "Next: correct the columns, the units, the CRS or the rows, then run again"
    if _note_with(record, MIRRORED):
        return ("Next: correct the axis that mirrors the map, then run again; not where the image "
                "itself is mirrored")
    if are_errors_large(record):
        word = record.data.counts.word
        return f"Next: check the {word}, their columns, units and CRS, then run again"
    if slip := _note_with(record, SLIP):
        return (f"Next: correct {slip.partition(SLIP)[0]} in the file if its source says so, then "
                "run again")
    if not folder:
        return "Not saved: add --out DIR, then termsel report DIR"
    if (not record.data.counts.independent and record.data.counts.word == "points"
            and lattice_of(record) is None):
        # Without redundancy nothing is known of the errors, so that no place is the best.
        if record.adjustment.redundancy == 0:
            return "Next: measure at least one more point, then run again with it"
        return f"Next: termsel plan {quote(folder)}   (best positions for further points)"
    return f"Next: open {page}" if page else f"Next: termsel report {quote(folder)}"
