"""The answer first: what was read, the model, its accuracy, blunders, and what to do next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import PurePath

from termsel.auto.structures import named
from termsel.core.errors import counted, cut
from termsel.data.coordinates.crs import LOCAL, short
from termsel.data.record.figures import MANY_INDEPENDENT, Accuracy, Outlier, Predicted
from termsel.data.record.record import Record, WhatWasRead
from termsel.report.blocks import Note
from termsel.report.compared import label_of
from termsel.report.verdict import contradicting, off_option

_SOURCE = 32
"""Characters of the names of files."""
_NAMED = 3
"""Blunders that are named."""
_LONGEST = 60
"""Characters of the ids of an option that fit in."""
_NO_FIT, _BLUNT = 0.01, 0.005
"""Shares of the extent of the features in the image: of an RMSE, beyond which no model fits, and of
an error that must be exceeded to be found."""
_ROUNDING = 1e-9
"""Predicted RMSE [px] below which points without errors leave only rounding."""
_MEASURED = 0.01
"""RMSE [px] below which points were computed: nobody measures so well."""
_CONTRADICTED = 2.0
"""Times the upper end of the predicted RMSE beyond which independent points contradict it."""
_MOST, _WIDTH = 8, 85
"""Lines of all, and characters of a line."""
_PLAIN = {"shrunken": "uncertain terms held near zero",
          "field": "small local shifts that fade with distance"}
"""What words of statistics mean."""


def opening(record: Record) -> list[Note]:
    """Return the answer in at most eight lines of text."""
    whole = list(_notes(record, brief=False))
    return list(_notes(record, brief=True)) if _lines(whole) > _MOST else whole


def _lines(notes: Sequence[Note]) -> int:
    """Return about how many lines of text notes take."""
    return sum(1 + (len(note.label) + len(note.text)) // _WIDTH for note in notes)


def _notes(record: Record, brief: bool) -> Iterator[Note]:
    yield from _data(record, brief)
    yield Note(_model(record), "Model")
    yield Note(accuracy_of(record), "Accuracy")
    yield Note(blunders_of(record, brief), "Blunders")
    yield Note(_next(record), "Next")


def _data(record: Record, brief: bool) -> Iterator[Note]:
    data, counts = record.data, record.data.counts
    source = cut(", ".join(PurePath(name).name for name in data.source.split(", ")), _SOURCE)
    read = data.read or _as_in_earlier_records(record)
    kinds = ", ".join(counted(n, word) for n, word in (
        (read.points, "point"), (read.lines, "line")) if n)
    if read.lattice is not None:
        kinds += f", a lattice of {read.lattice[0]} lines and {read.lattice[1]} columns"
    heights = "" if not read.without_height else (
        " without heights" if read.without_height == read.points + read.lines else
        f" ({read.without_height} without a height)")
    crs = "coordinates without a CRS" if data.crs == LOCAL else short(data.crs)
    near = f" near {read.place}" if read.place else ""
    unit = f"; z in {read.z_unit}" if read.z_unit else ""
    origin = f"; image coordinates from {read.image_origin}" if read.image_origin else ""
    yield Note(f"{source}: {kinds}{heights}; {crs}{near}{unit}{origin}.", "Read")
    control = [counted(n, word) for n, word in ((counts.control, "point"), (counts.lines, "line"))
               if n]
    blunders = sum(outlier.excluded for outlier in record.outliers)
    left = [*[counted(blunders, "blunder")] * bool(blunders),
            *(f"{len(ids)} {reason}" for reason, ids in read.left_out.items())]
    if brief and left:
        left = [counted(blunders + sum(map(len, read.left_out.values())), "feature")]
    yield Note(f"{' and '.join(control)}; {_some(counts.check, 'check point')}; "
               f"{_some(counts.independent, 'independent point')}."
               + (f" Left out: {'; '.join(left)}." if left else ""), "Control")


def _some(number: int, noun: str) -> str:
    return counted(number, noun) if number else f"no {noun}s"


def _as_in_earlier_records(record: Record) -> WhatWasRead:
    counts = record.data.counts
    return WhatWasRead(counts.control + counts.check + counts.independent + counts.off,
                       counts.lines, 0, "", "", {})


def title_of(record: Record) -> str:
    """Return the structure of the model in words, without an article."""
    if record.strategy is None:
        return record.model
    candidate = named(record.strategy.chosen)
    return label_of(record.strategy.chosen) if candidate is None else \
        candidate.title.partition(" ")[2]


def _model(record: Record) -> str:
    title = title_of(record)
    selection = record.selection
    offered = record.offered
    if record.strategy:
        meaning = next((f" ({text})" for word, text in reversed(_PLAIN.items())
                        if word in title), "")
        rpc = f" {record.strategy.rpc}" if record.strategy.rpc else ""
        return f"{title}{meaning}, chosen by auto.{rpc}"
    by = f"; stable over {record.stability.repeats} selections" if record.stability else \
        f"; selected by {record.solver} (criterion {record.criterion})"
    whole = (selection.n_terms, selection.n_features) == (offered.n_terms, offered.n_features)
    return (f"{title}, {share(selection.n_terms, offered.n_terms)} terms, "
            f"{share(selection.n_features, offered.n_features)} "
            f"{record.data.counts.word}{'' if whole else by}"
            + ("." if record.feasible else ". Do not use it: its fit did not converge."
               if record.adjustment.converged is False else
               ". Do not use it: not all conditions hold."))


def share(chosen: int, offered: int) -> str:
    """Return how many of those on offer are chosen."""
    return f"all {offered}" if chosen == offered else f"{chosen} of {offered}"


def accuracy_of(record: Record) -> str:
    """Return the accuracy in one sentence: the surer figure first."""
    accuracy = record.accuracy
    expected = expected_of(record)
    if lattice_of(record) is not None and accuracy is None:
        return _between_points(record, expected)
    if are_computed(record):
        return said_of_computed(record)
    confirmed = "" if accuracy is None else _confirmed(record, accuracy)
    if expected is None:
        return f"{confirmed}." if accuracy else "not known, as there are no independent points."
    if not predicted_first(record):
        return f"{confirmed}."
    if expected.high < _ROUNDING:
        return f"the points fit exactly; {confirmed or 'no independent point confirms it'}."
    return (f"{rounded(expected.rmse)} px predicted ({rounded(expected.low)} to "
            f"{rounded(expected.high)} px); {confirmed or 'no independent point confirms it'}.")


def _between_points(record: Record, expected: Predicted | None) -> str:
    """Return how well a model interpolates between the points of a lattice, or meets them."""
    control = record.rmse.control
    if expected is not None:
        return (f"{rounded(expected.rmse)} px predicted between the points of the lattice "
                f"({rounded(expected.low)} to {rounded(expected.high)} px); they were computed, so "
                "nothing tells that of the product.")
    meets = "" if control is None or control.total is None else \
        f"the model meets the points of the lattice to {rounded(control.total)} px; "
    return f"{meets}they were computed, so nothing tells the accuracy of the product."


def lattice_of(record: Record) -> tuple[int, int] | None:
    """Return the lines and columns of the lattice that the points are, if they are one."""
    return record.data.read.lattice if record.data.read else None


def are_computed(record: Record) -> bool:
    """Return whether the model meets points that took no part closer than anyone measures."""
    # Of simulated data the noise is known, and may be none.
    if record.data.noise is not None or lattice_of(record) is not None:
        return False
    expected = expected_of(record)
    if record.accuracy is not None:
        return max(record.accuracy.image.total, expected.high if expected else 0.0) < _MEASURED
    return expected is not None and _ROUNDING <= expected.high < _MEASURED


def said_of_computed(record: Record) -> str:
    """Return that a model meets points that were computed, and that this is no accuracy."""
    expected = expected_of(record)
    size = record.accuracy.image.total if record.accuracy else expected.rmse if expected else 0.0
    agreement = f"to {rounded(size)} px" if size >= _ROUNDING else "to rounding"
    return (f"the model meets points that took no part {agreement}, closer than anyone measures. "
            "They were computed, or one column is a copy of another: nothing tells the accuracy.")


def expected_of(record: Record) -> Predicted | None:
    """Return the RMSE predicted for the fit that is exported, if one is."""
    return (record.final and record.final.predicted) or record.predicted


def predicted_first(record: Record) -> bool:
    """Return whether the predicted RMSE is surer than that of the independent points."""
    return expected_of(record) is not None and (
        record.accuracy is None or record.accuracy.image.n < MANY_INDEPENDENT)


def _confirmed(record: Record, accuracy: Accuracy) -> str:
    """Return the RMSE of the independent points in a few words."""
    less = record.accuracy_without
    without = f"; {rounded(less.image.total)} px without " \
        f"{cut(contradicting(record), _SOURCE)}" if less else ""
    return f"{_sizes(accuracy)} (RMSE of {independent_points(accuracy)}){without}"


def independent_points(accuracy: Accuracy) -> str:
    """Return how many independent points there are, and how many are spent where most are."""
    spent = accuracy.spent_count
    n = accuracy.image.n
    if not spent or 2 * spent < n:
        return counted(n, "independent point")
    if spent == n:
        return f"{counted(n, 'spent independent point')}, which an earlier result showed"
    return f"{counted(n, 'independent point')}, of which an earlier result showed {spent}: spent"


def _sizes(accuracy: Accuracy) -> str:
    ground = f", {rounded(accuracy.ground.total)} m on the ground" if accuracy.ground else ""
    return f"{rounded(accuracy.image.total)} px{ground}"


def rounded(value: float) -> str:
    """Return a size with three digits, a large one with all before the decimal point."""
    return f"{value:.3g}" if value < 999.5 else f"{value:,.0f}"


def blunders_of(record: Record, brief: bool) -> str:
    """Return the worst blunders, with the option that leaves out those in use."""
    out, used, independent = groups = _grouped(record)
    off = off_option(record)
    if lattice_of(record) is not None:
        return "none, as the points of a lattice were computed."
    if not any(groups):
        return "looked for before, not here." if record.options.data.get("tested") \
            else _none_found(record)
    said = "; ".join([
        *[f"{_listed(out)} left out"] * bool(out), *[f"{_listed(used)} in use"] * bool(used),
        *[f"{_listed(independent)} contradict{'s' * (len(independent) == 1)} all others"]
        * bool(independent)])
    if brief:
        said = f"{sum(map(len, groups))} found, {len(used) + len(independent)} of them in use"
    if not off:
        return f"{said}{'; see the list below' * brief}."
    return (f"{said}: leave {'them' if ',' in off else 'it'} out by "
            f"{off if len(off) <= _LONGEST else 'the option --off below'}.")


def _none_found(record: Record) -> str:
    """Return that no blunder was found, and why this may say little."""
    test = record.blunder_test
    size = _size_of_errors(record)
    accuracy = record.accuracy
    predicted = record.predicted
    if accuracy and predicted and accuracy.image.total > _CONTRADICTED * predicted.high:
        points = counted(accuracy.image.n, "independent point")
        return (f"none found, but {points} {'is' if accuracy.image.n == 1 else 'are'} "
                f"{rounded(accuracy.image.total)} px off where {rounded(predicted.rmse)} px are "
                "predicted: look there.")
    if test is None:  # of a record that has none
        return "none found."
    features = counted(test.features, record.data.counts.word.removesuffix("s"))
    if test.limit is None:
        return f"none can be found with {features}."
    if test.limit > test.extent:
        return f"none can be found with {features}; any may be one."
    if size > _NO_FIT * test.extent:
        return (f"none can be told, as no model agrees with the {record.data.counts.word} better "
                f"than {rounded(size)} px: several are wrong, or no model holds.")
    if test.limit > _BLUNT * test.extent:
        return f"none found; with {features} errors below {rounded(test.limit)} px may go unseen."
    return "none found."


def _size_of_errors(record: Record) -> float:
    """Return the RMSE that features which took no part have, or are predicted to have [px]."""
    known = []
    if record.predicted:
        known.append(record.predicted.rmse)
    if record.accuracy:
        known.append(record.accuracy.image.total)
    return min(known, default=0.0)


def _grouped(record: Record) -> tuple[list[Outlier], list[Outlier], list[Outlier]]:
    """Return blunders left out, those in use, and those among the independent points."""
    worst = sorted(record.outliers, key=lambda one: -one.error)
    mine = [one for one in worst if one.role != "independent"]
    return ([one for one in mine if one.excluded], [one for one in mine if not one.excluded],
            [one for one in worst if one.role == "independent"])


def are_all_named(record: Record) -> bool:
    """Return whether the opening names all blunders, with the option that leaves them out."""
    return max(map(len, _grouped(record))) <= _NAMED and len(off_option(record)) <= _LONGEST \
        and _lines(list(_notes(record, brief=False))) <= _MOST


def _listed(some: Sequence[Outlier]) -> str:
    more = f" and {len(some) - _NAMED} more" if len(some) > _NAMED else ""
    return ", ".join(
        f"{cut(one.id, _SOURCE)} ({rounded(one.error)} px"
        f"{'' if one.certainty == 'certain' else f', {one.certainty}'})"
        for one in some[:_NAMED]) + more


def _next(record: Record) -> str:
    """Return what to do next, the most urgent alone."""
    read = record.data.read
    if read and read.doubt:
        return f"{read.doubt.partition(':')[0]}: check them before anything else."
    if read and read.height_doubt:
        doubt = f"{read.height_doubt[:1].lower()}{read.height_doubt[1:]}"
        return f"check what heights refer to: {doubt}"
    if read and read.two_groups:
        return f"check the datum of the points: {read.two_groups}."
    if record.interrupted:
        return "the run was interrupted; run it again to its end."
    if not record.feasible:
        return "measure more control, or choose a smaller model."
    if any(not outlier.excluded for outlier in record.outliers):
        return "look at the blunders in use: correct them, or leave them out and run again."
    if not record.data.counts.independent and lattice_of(record) is None:
        return "measure further points, some of the role independent; termsel plan names places."
    if "Let auto choose" in record.judgement:
        return "name no problem and no method: then auto chooses, and predicts better."
    return "termsel report, export and rectify take the folder that --out DIR writes."
