"""The outlier test as a table: which features, how certain, and what to type."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping

from termsel.auto.compare import WITHOUT_BLUNDERS
from termsel.auto.methods import BY_NAME
from termsel.auto.rule import CLEAR_MARGIN
from termsel.core.errors import rounded_size_text
from termsel.data.record.figures import BaselineRow, BlunderTest, Outlier, RmseByRole
from termsel.data.record.record import Record
from termsel.results.blocks import Block, TableBlock

# This result among the fits without a search, and what they are called.

THIS = "this result"

ROLE_WORDS = {"control": "control", "check": "selection", "independent": "independent check",
              "off": "not used", "left out": "not used", "rejected": "rejected outlier"}
"""What tables and charts call the features of a role of files and options, or of a chart."""

CRITERIA_IN_WORDS = {
    "check-rmse": "selection RMSE", "kfold": "k-fold RMSE", "press": "leave-one-out RMSE",
    "median": "median selection error", "huber": "robust selection error (Huber)"}
"""What pages and charts call the criteria that have px; others keep their name."""

ALL_TERMS = "all-terms"
"""Baseline of a search: the fit of all terms to all control."""

AS_DELIVERED = "rpc-as-delivered"
"""Baseline of an RPC without a correction, which is fitted to nothing."""

ALIKE_RATIO = 1.05
"""Two RMSE whose ratio is below this are called alike: with a few dozen independent points
an RMSE is itself uncertain by more."""

CHANCE = 1.15
"""Ratio beyond which a model that was not chosen may be worth a try."""


def criterion_in_words(criterion: str) -> str:
    """Return a criterion in the words of the field, such as "selection RMSE" for check-rmse."""
    return CRITERIA_IN_WORDS.get(criterion, criterion)


def are_alike(first: float, second: float) -> bool:
    """Return whether the difference of two RMSE is of no practical use."""
    return first <= ALIKE_RATIO * second and second <= ALIKE_RATIO * first


def verdict_on_choice(own_rmse: float, rival_rmse: float, rival: str,
                      gains: Mapping[str, float | None], *, at_points: bool = False) -> str:
    """Return in a few words how the RMSE of a rival compares with that of the chosen model.

    `gains` says of all models that it was chosen among how much better than it they predict
    left-out points, each by the standard error of the difference. The RMSE are those of left-out
    points, too, or `at_points` those of independent ones, which had no say in the choice. Of a
    rival that is better by more than chance the option that takes it is named. The first screen and
    the summary say it with the same figures and in the same words.
    """
    if are_alike(own_rmse, rival_rmse):
        return "no practical difference"
    if rival_rmse > own_rmse:
        return f"{times_in_words(rival_rmse / own_rmse)} as large"
    smaller = smaller_in_words(own_rmse, rival_rmse)
    # Where a method was asked for, nothing else was on offer.
    if len(gains) <= 1:
        is_worth_it = len(gains) == 1 and rival in BY_NAME and own_rmse > CHANCE * rival_rmse
        return f"{smaller}; take --method {rival} in its place" if is_worth_it else smaller
    # The best of several has the smallest figure partly by luck, so one must be surer than that. A
    # choice asks for that; the user need not.
    gain = gains.get(rival) or 0.0
    if at_points and gain <= 0.0:
        certainty = "not in cross-validation"
    else:
        chance = "more than chance" if gain > CLEAR_MARGIN else "within chance"
        certainty = f"{chance} in cross-validation" if at_points else chance
    command = f"; --method {rival} takes it" if own_rmse > CHANCE * rival_rmse else ""
    return f"{smaller}, {certainty}{command}"


_BY_FACTOR = 20.0
"""Ratio from which on a smaller figure is told by how many times, as its share tells no more."""


def smaller_in_words(large: float, small: float) -> str:
    """Return how much smaller a figure is, such as "12 % smaller" or "3,000 times as small"."""
    if small > 0.0 and large / small >= _BY_FACTOR:
        return f"{times_in_words(float(f'{large / small:.2g}'))} as small"
    return f"{100 * (1 - small / large):.0f} % smaller"


def times_in_words(ratio: float) -> str:
    """Return a ratio in words, such as "1.1 times"."""
    return f"{ratio:.1f} times" if ratio < 10 else f"{ratio:,.0f} times"


def label_of(name: str) -> str:
    """Return what tables and charts call a fit without a search: a baseline or a candidate of auto.
    """
    method = BY_NAME.get(name)
    if method is not None:
        return method.label
    # The fit without blunders is made for comparison only and is of no method.
    words = {WITHOUT_BLUNDERS: "outliers removed"}
    return words.get(name, name.replace("-", " ").replace("rpc", "RPC"))


def fits_of(record: Record) -> Iterator[tuple[str, bool, int, RmseByRole]]:
    """Yield label, whether also fitted to selection points, number of terms, and RMSE by role.

    First come those of the result itself, then those of each fit that it is compared with.
    """
    # The strategy auto fits to control and check points together, a search to control alone.
    yield THIS, bool(record.strategy), record.selection.n_terms, record.rmse
    for baseline in record.baselines:
        fitted_to_check = "check" in baseline.fitted_to and baseline.name != AS_DELIVERED
        label = all_on_offer(record) if baseline.name == ALL_TERMS else label_of(baseline.name)
        yield label, fitted_to_check, baseline.n_terms, baseline.rmse


def all_on_offer(record: Record) -> str:
    """Return what a fit without a selection uses and this result does not, such as "all lines"."""
    selection = record.selection
    lacking = []
    if selection.n_features < record.offered.n_features:
        lacking.append(record.data.counts.word)
    if selection.n_terms < record.offered.n_terms or not lacking:
        lacking.append("terms")
    return f"all {' and '.join(lacking)}"


CERTAINTY = {"certain": "blunder", "probable": "probable blunder", "possible": "possible blunder"}
"""What a feature is called that contradicts all others."""

NOT_FEW = 20
"""Features that are not called too few for a test: the model is, or their errors, if none works."""
TESTABLE_RATIO = 10.0
"""Least error that a test of enough features finds, by the size of their errors, at most."""


def names_to_leave_out(record: Record) -> str:
    """Return the ids of the blunders that the next run should leave out, with commas.

    Returns "" where all of them, but those that are merely possible, were rejected in this run.
    Otherwise it names the rejected ones as well: the next run gives roles anew, and would have them
    as independent check points. It also names what this run was asked to leave out, since the
    option of the next run replaces that of this one.
    """
    wrong = [outlier for outlier in record.outliers if outlier.certainty != "possible"]
    if all(outlier.excluded for outlier in wrong):
        return ""
    asked = [name.strip() for name in str(record.options.data.get("off") or "").split(",")]
    names = dict.fromkeys([*filter(None, asked), *(outlier.id for outlier in wrong)])
    return ",".join(names)


def off_option(record: Record) -> str:
    """Return the option --off that leaves blunders out of the next run; "" if none is needed."""
    names = names_to_leave_out(record)
    return f"--off {shlex.quote(names)}" if names else ""


_MANY_OUTLIERS = (5, 0.15)
"""Number and share of the points from which on outliers are no slips: rows may be shifted, as by
sorting a part of a table, or matches wrong."""


def may_be_shifted(record: Record) -> bool:
    """Return whether so many points contradict the others that rows may be shifted."""
    fewest, least_share = _MANY_OUTLIERS
    outliers = _sure_outliers(record)
    return len(outliers) >= fewest and len(outliers) > least_share * _points_in(record)


def _sure_outliers(record: Record) -> list[Outlier]:
    """Return the points that are outliers, without possible ones."""
    return [outlier for outlier in record.outliers
            if outlier.kind == "point" and outlier.certainty != "possible"]


def _points_in(record: Record) -> int:
    """Return the number of points that took part, or were rejected as outliers."""
    counts = record.data.counts
    roles = record.data.roles
    in_use = {*roles.control, *roles.check, *roles.independent}
    rejected = [outlier for outlier in record.outliers
                if outlier.kind == "point" and outlier.id not in in_use]
    return counts.control + counts.check + counts.independent + len(rejected)


def outlier_share_in_words(record: Record) -> str:
    """Return how many of the points are outliers, such as "16 of 97 points"."""
    return f"{len(_sure_outliers(record))} of {_points_in(record)} points"


def outliers_in_words(record: Record) -> str:
    """Return the id of the outlier among independent points, or how many of them are outliers."""
    wrong = [outlier.id for outlier in record.outliers if outlier.role == "independent"]
    return wrong[0] if len(wrong) == 1 else f"{len(wrong)} outliers among them"


def size_of_errors(record: Record) -> float:
    """Return the RMSE that features which took no part have, or are predicted to have [px].

    It is the smaller of the two where both are known, and 0 where neither is.
    """
    sizes = []
    if record.predicted:
        sizes.append(record.predicted.rmse)
    if record.accuracy:
        sizes.append(record.accuracy.image.total)
    return min(sizes, default=0.0)


NO_FIT = 0.01
"""Share of the extent of the features in the image of an RMSE, beyond which no model fits."""


def does_nothing_fit(record: Record) -> bool:
    """Return whether no model fits, of features so many that this cannot be chance."""
    test = record.blunder_test
    return test is not None and test.features >= NOT_FEW and are_errors_large(record)


def are_errors_large(record: Record) -> bool:
    """Return whether the errors are larger than those of any model that fits the features."""
    test = record.blunder_test
    return test is not None and size_of_errors(record) > NO_FIT * test.extent


_FITS_BETTER = 0.1
"""Share of the errors of a model, below which those of a rival show that the model is at fault."""


def fit_that_works(record: Record) -> tuple[BaselineRow, float] | None:
    """Return a fit that works, and its RMSE [px], where this model does not fit.

    Columns, units and CRS are right where another model fits. Returns None where the errors are not
    large, and where those of all models are.
    """
    test = record.blunder_test
    if test is None or not are_errors_large(record):
        return None
    largest = min(_FITS_BETTER * size_of_errors(record), NO_FIT * test.extent)
    fitting = []
    for row in record.baselines:
        size = row.rmse.independent.total or row.predicted
        if row.determined and row.name in BY_NAME and size is not None and size <= largest:
            fitting.append((row, size))
    # The screen compares with the reference already.
    return min(fitting, key=lambda pair: (pair[0].name != record.reference, pair[1]), default=None)


RPC_MODELS = "rpc"
"""How the names of corrections of an RPC begin."""


def uses_rpc(record: Record) -> bool:
    """Return whether the model is a correction of a vendor's RPC."""
    return record.data.rpc is not None and record.model.startswith(RPC_MODELS)


def misfit_in_words(record: Record) -> str:
    """Return that no model fits features with large errors, or which one does if this does not."""
    features = f"these {record.data.counts.word}"
    works = fit_that_works(record)
    if works is None:
        return f"no model fits {features}"
    rival, size = works
    at_fault = "the RPC" if uses_rpc(record) else "this model"
    return (f"{at_fault} does not fit {features}, which {BY_NAME[rival.name].title} fits to "
            f"{rounded_size_text(size)} px")


def are_too_few_to_test(test: BlunderTest, errors: float) -> bool:
    """Return whether features are too few for a test, given the size of their errors [px].

    Then an error that could be found is larger than the image, and not because all errors are
    large.
    """
    return test.limit is None or test.limit > max(test.extent, TESTABLE_RATIO * errors)


def _none_detected_in_words(test: BlunderTest | None, errors: float) -> str:
    """Return that no outlier was detected, or can be, and how large one may be that was not.

    `errors` is the size of the errors of features that took no part [px].
    """
    if test is None:
        return "Outliers were not tested."
    if test.limit is None or are_too_few_to_test(test, errors):
        if test.features >= NOT_FEW:
            return f"No outlier can be detected by this model among {test.features} features."
        return f"No outlier can be detected: {test.features} features are too few."
    # Only an error that is larger than the extent of the features would show.
    if test.limit > test.extent:
        return ("No outlier can be detected: no model fits these features. Several are wrong, or "
                "no model is suitable.")
    return (f"No outliers detected. At half of the {test.features} features, an error must exceed "
            f"{rounded_size_text(test.limit)} px to be detected.")


def verdict_table(record: Record) -> Iterator[Block]:
    """Yield all features that contradict the others, and how many a search did not need.

    Without any, a sentence says why none was found. Sentences after the table say what to do: leave
    them out, with the option to type, or compare the table with the map where so many contradict
    the others that rows seem to be shifted.
    """
    outliers = record.outliers
    if outliers:
        rows = []
        for outlier in outliers:
            # Independent points are in no fit, but their errors are in its figures.
            use = "in the figures" if outlier.role == "independent" else "in use"
            rows.append((outlier.id, outlier.kind, ROLE_WORDS[outlier.role],
                         rounded_size_text(outlier.error), CERTAINTY[outlier.certainty],
                         "rejected" if outlier.excluded else use))
        yield TableBlock("Outliers and their prediction errors", (
            "feature", "kind", "role", "error [px]", "outlier test", "use"), rows)
        off = off_option(record)
        if may_be_shifted(record):
            yield (f"{outlier_share_in_words(record)} contradict the others, more than slips do. "
                   "Rows of the table may be shifted against each other or sorted in part, or "
                   "matches wrong: compare some points with the map before leaving any out.")
        elif off:
            yield f"Leave them out with {off} and run again."
    else:
        if record.options.data.get("tested"):
            yield "Outliers were tested in an earlier run, not here."
        else:
            yield _none_detected_in_words(record.blunder_test, size_of_errors(record))
    certainties = {outlier.certainty for outlier in outliers}
    if "probable" in certainties:
        yield "A probable blunder is more likely wrong than right: look at it in the image."
    if "possible" in certainties:
        yield ("For a possible blunder the other features are too few or too far away to decide: "
               "look at it in the image.")
    # Control that fits and was not selected is no outlier: the search did without it.
    spare = set(record.data.roles.control).difference(
        record.selection.features, (outlier.id for outlier in outliers))
    if spare and not record.strategy:
        yield f"{len(spare)} more {record.data.counts.word} fit but were not selected."
