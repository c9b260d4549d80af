"""The rule by which one of several methods is chosen, from their errors at held-out features.

Errors are compared by logarithms of their squares, lest a few great ones make everything uncertain:
see `termsel.auto.rule.gain_of`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import erf, sqrt

import numpy as np

from termsel.adjustment.bayesian.field import SPLINE_MAX_POINTS, SPLINE_SURE_POINTS
from termsel.adjustment.equations import weights_of
from termsel.core.errors import percent_text, rounded_size_text
from termsel.data.coordinates.clusters import cluster_labels
from termsel.data.coordinates.metres import plan_of
from termsel.data.coordinates.places import MIN_LATTICE_LINES as FEWEST_LINES
from termsel.data.coordinates.places import ground_centres, lattice_of, spatial_order
from termsel.data.features import FeatureSet, FloatArray, IntArray, empty_points
from termsel.data.fit_data import FitData
from termsel.data.record.chances import chance_of_better_fit, t_quantile
from termsel.fitting.fit import Fit, Undetermined
from termsel.fitting.least_squares import left_out_squares
from termsel.fitting.method import Method
from termsel.models.quotient import guard_points, pole_margin, pole_violation

# A method fitted to features and held against them: what auto compares.

POLE_BOX_FACTOR = 1.5
"""A denominator must be positive in a box this much wider than that of the points."""


def validated(method: Method, data: FitData) -> Fit | None:
    """Return a method fitted to features, whose error at each held-out feature is known.

    Returns None where auto does not try the method, the features do not determine it with
    redundancy, or it has a pole.
    """
    if not method.tried(data):
        return None
    # Without redundancy each feature is fitted exactly, and at a pole an error may be anything.
    try:
        fitted = replace(method.fit(data), method=method)
        if fitted.stored_held_out is None and (
                fitted.adjustment.redundancy < 1 or has_pole(fitted)):
            return None
        fitted.held_out()
    except Undetermined:
        return None
    return fitted


def has_pole(fitted: Fit) -> bool:
    """Return whether a denominator falls short of the margin near the points, or is negative there.

    Near are places in a box POLE_BOX_FACTOR times as wide as the box of the points. Places behind
    the camera, which no image of such a view shows, do not count.
    """
    control = fitted.scaled_control
    return bool(pole_violation(
        fitted.model, fitted.adjustment.coefficients[None],
        guard_points(control, empty_points(), POLE_BOX_FACTOR), pole_margin(control))[0])


PAIRS_OF_CONTROL = 30
"""Pairs of control points, at most, between which a fit is looked at."""

FARTHER_THAN_CONTROL = 10.0
"""Departure from an affine map between control points, by the largest at them, from which on the
points do not show it: of control that lies on two lines a square across them."""

LEAST_DEPARTURE = 0.5
"""Departure of control [px] that counts as none."""


def is_astray_between(fitted: Fit) -> bool:
    """Return whether a fit runs away between its control points, by its own account.

    Control on two lines, or in a few clusters, hardly determines a curvature across them: held-out
    errors are small then, and between the lines the fit may be off by more than the image. It is
    astray where it departs from an affine map many times farther than any control does, and its own
    standard deviation there is larger than all departures of control.

    A central projection never is, as it takes straight lines to straight lines, nor is a geometry
    that is known, which control hardly determines. A spline and a field follow what all points have
    in common where there are none, and are not looked at; nor are fits to lines.
    """
    control = fitted.scaled_control
    method = method_of(fitted)
    if (len(control.lines) or method.central or method.from_one
            or fitted.interpolation is not None):
        return False
    points = control.points
    columns = points.ground if fitted.model.uses_height else points.ground[:, :2]
    affine = np.linalg.lstsq(np.column_stack([np.ones(len(points)), columns]), points.image)[0]

    def departures(ground: FloatArray, image: FloatArray) -> FloatArray:
        positions = ground[:, :columns.shape[1]]
        return np.asarray(np.linalg.norm(image - affine[0] - positions @ affine[1:], axis=1))

    # Middles of pairs of points: of each with the one half a table on, and with its neighbour in
    # the table. So some pairs lie across two lines, whether they are listed one after the other or
    # in turn.
    count = len(points)
    starts = np.linspace(0, count - 1, min(count, PAIRS_OF_CONTROL // 2)).astype(np.intp)
    ends = np.concatenate([starts + count // 2, starts + 1]) % count
    middles = (points.ground[np.tile(starts, 2)] + points.ground[ends]) / 2.0
    ground = fitted.scaling.unscaled(middles)
    at_middles = departures(middles, fitted.scaling.image(fitted.project(ground)))
    at_middles = at_middles[np.isfinite(at_middles)]
    largest_at_control = max(float(departures(points.ground, points.image).max()),
                             LEAST_DEPARTURE / fitted.scaling.image_scale)
    rms_at_middles = float(np.sqrt((at_middles**2).mean())) if len(at_middles) else 0.0
    if rms_at_middles <= FARTHER_THAN_CONTROL * largest_at_control:
        return False
    squares = (fitted.sigma(ground)**2).sum(axis=1)
    uncertainty = float(np.sqrt(np.nanmean(squares))) / fitted.scaling.image_scale
    return uncertainty > largest_at_control


def refusal(fitted: Fit) -> str:
    """Return why a fit by least squares, which is determined, is not judged; "" if it is."""
    if not fitted.estimator.least_squares:
        return ""
    if has_pole(fitted):
        return "a denominator is near zero or negative at or near the control (a pole)"
    if not np.isfinite(left_out_squares(fitted)).all():
        return ("without one of the features it is not determined, or has a denominator near "
                "zero or negative there (a pole)")
    return ""


def gain_of(squares: FloatArray, other_squares: FloatArray, rounding: float = 0.0) -> float:
    """Return by how many standard errors `squares` (n,) are smaller than `other_squares` (n,).

    The gain is the mean of g = log(other_squares / squares), divided by its standard error. It is
    negative where they are larger, and NaN for n = 1. Errors up to `rounding` [px] count as equal:
    where a model fits points exactly, the logarithms of residuals would differ by chance, and from
    processor to processor.
    """
    tiny = float(np.finfo(float).tiny)
    smallest = max(rounding**2, tiny)
    gains = np.log(np.maximum(other_squares, smallest) / np.maximum(squares, smallest))
    count = len(gains)
    mean = float(gains.sum()) / count
    deviations = gains - mean
    # A single gain shows no standard error.
    variance = float(deviations @ deviations) / (count - 1) if count > 1 else np.nan
    # Gains that are all the same are infinitely sure.
    return mean / max(float(np.sqrt(variance / count)), tiny)


# In how many folds features are held out, and which lines of a lattice are.

FOLDS_WITH_LINES = 10
"""Folds in which the whole choice is repeated where there are lines, which take longer."""

FOLDS = ((40, 20), (5000, 10), (50_000, 5), (np.inf, 2))
"""Folds for fewer points than a number: of many, nine tenths or four fifths predict all but as well
as all, and of very many a half."""

MIN_CLUSTERS = 10
"""Clusters of points from which on each is held out as a whole."""

CLUSTER_GAP = 3.0
"""Least ratio of the distances between such clusters to those within them."""

FOLDS_OF_LATTICE = 8
"""Folds of the lines of a lattice, and of its columns: of a radar image with ten, one each."""


def folds_of(features: FeatureSet) -> int:
    """Return in how many folds the whole choice is repeated.

    Where features are few, each is a fold; where they are many, a fold is a part of them that is
    spread over the scene; where points come in clusters, it is made of whole clusters; in a
    lattice, of some lines or of some columns.
    """
    if len(features.lines):
        return min(FOLDS_WITH_LINES, len(features))
    lattice = lattice_of(features)
    if lattice is not None:
        return folds_along(lattice.lines) + folds_along(lattice.columns)
    clusters = clusters_of(features)
    count = len(features) if clusters is None else int(clusters.max()) + 1
    return next(min(folds, count) for below, folds in FOLDS if len(features) < below)


def clusters_of(features: FeatureSet) -> IntArray | None:
    """Return the number of each point's cluster, (n,), where clusters are held out as a whole.

    If points of a cluster were held out one by one, their neighbours in the fit would predict them,
    and the errors would say nothing of other places. Returns None where points do not come in
    clusters, and for fewer than MIN_CLUSTERS: the others hardly predict a whole cluster then. In
    both cases points are held out one by one; the uncertainty of the model shows what lies between.
    """
    if len(features.lines) or len(features) < 2 * MIN_CLUSTERS:
        return None
    plan = plan_of(features.crs, features.points.ground)
    clusters = None if plan is None else cluster_labels(plan, CLUSTER_GAP)
    return None if clusters is None or clusters.max() + 1 < MIN_CLUSTERS else clusters


def fold_of_each(features: FeatureSet, folds: int) -> IntArray:
    """Return the number of each feature's fold, (n,).

    Every fold is spread over the whole scene, and every cluster lies within one fold.
    """
    centres = ground_centres(features)
    clusters = clusters_of(features)
    if clusters is None:
        clusters = np.arange(len(features))
    else:
        centres = np.array([centres[clusters == cluster].mean(axis=0)
                            for cluster in range(clusters.max() + 1)])
    # Along a curve through the ground, the clusters go to the folds in turn.
    fold_of_cluster = np.empty(len(centres), dtype=np.intp)
    fold_of_cluster[spatial_order(centres)] = np.arange(len(centres)) % folds
    return np.asarray(fold_of_cluster[clusters])


def held_out_lines(count: int) -> tuple[int, int]:
    """Return the numbers of the first and the last of `count` lattice lines that are held out.

    The outermost line on each side is kept, of many lines also the one next to it.
    """
    kept_on_each_side = 2 if count > 2 * FEWEST_LINES else 1
    return kept_on_each_side, count - 1 - kept_on_each_side


def folds_along(count: int) -> int:
    """Return the number of folds in which `count` lattice lines are held out."""
    first, last = held_out_lines(count)
    return min(FOLDS_OF_LATTICE, last - first + 1)


PRIOR_MARGIN = 1.0
"""Standard errors by which a method with a prior must be better than the one before it (the rule of
Breiman et al. 1984)."""

PROJECTION_MARGIN = 2.0
"""Standard errors by which a central projection must be better."""

CLEAR_MARGIN = 3.0
"""Standard errors by which any other method that no prior contains must be better, since the best
of several is so partly by luck."""

SUPPORTED_RMSE_RATIO = 0.75
SUPPORTED_MIN_FEATURES = 12
"""A central projection that the points support need not be better by standard errors where its
held-out RMSE is smaller by a quarter, and the errors are so many: what a polynomial misses at a few
points of the edge hardly counts in logarithms."""

FEWER_UNKNOWNS_RMSE_RATIO = 0.5
"""Of few points in a plane a projection with fewer unknowns than the base has in effect need not be
better by standard errors, which so few hardly show, where its held-out RMSE is half as large."""

CHANCE_OF_SIMILARITY = 0.05
"""Chance with which points of a similarity make a central projection fit as well, above which it is
not taken: the usual level of significance (Fisher 1925)."""

UNKNOWNS_OF_AFFINE = 6
"""Of an affine image of a plane."""

FEWEST_EQUATIONS_OF_CAMERA = 2
"""Equations that a central projection must leave to be held against a method that knows more."""

MOST_OF_CAMERA = 9.0
"""Unknowns of a camera without distortion: its place, its turn, its focal length and, as far as
their priors let them, the two of the principal point. An affine polynomial with heights has 8."""

SMALLEST_RMSE_REASON = "It has the smallest leave-one-out RMSE."
"""Why a method is chosen where none has a prior."""

OBLIQUE_DEPTH_RATIO = 0.8
"""Distance of the nearest point by that of the middle, along the view, below which a view is
oblique: a map has none, and points of a photo from above are at about the same distance."""

CENTRAL_AFFINE_SHARE = 0.1
"""What a central projection leaves by what an affine transformation leaves, from which on down the
points support a camera near by: of images from orbit it is mostly more."""

Describe = Callable[[Fit], str | None]
"""Returns one sentence on why the features support the method of a fit, if there is one."""


@dataclass(frozen=True, eq=False)
class Choice:
    """A method chosen from several: its fit, the fits it was compared with, and the reason.

    Parameters
    ----------
    chosen : Fit
        Its `method` is the one that is chosen.
    compared : tuple of Fit
        Of all methods that the features determine with redundancy.
    reason : str
        Why this one, in sentences with the figures that decided.
    """

    chosen: Fit
    compared: tuple[Fit, ...]
    reason: str

    @property
    def method(self) -> Method:
        """The method that is chosen."""
        return method_of(self.chosen)


def method_of(fitted: Fit) -> Method:
    """Return the method of a fit that was compared with others."""
    assert isinstance(fitted.method, Method)
    return fitted.method


def is_contained(method: Method, fits: Iterable[Fit]) -> bool:
    """Return whether a method is a limiting case of some fitted method with a prior.

    The affine polynomial is such a case of the regularised polynomials, which find it if the points
    support it.
    """
    return any(method_of(fitted).has_prior and method.name in method_of(fitted).contains
               for fitted in fits)


def best_of(fits: Iterable[Fit], describe: Describe = lambda _: None, *,
            explained: bool = True) -> Choice | None:
    """Return the choice among the fits of methods; None if there are none.

    Where no method has a prior, the smallest RMSE decides, or how well a wider model fits (see
    `_choice_without_prior`). Else one of the fits with a prior is the fit to beat (see
    `fit_to_beat`). Any method that no prior contains must be better than that by
    so many standard errors: CLEAR_MARGIN; for a central projection PROJECTION_MARGIN, or
    PRIOR_MARGIN where the points support an oblique or near camera. A supported projection may
    instead have a far smaller RMSE (see `is_supported_and_smaller`). A projection that fits few
    points better than a similarity by chance alone is left out (see `chance_of_similarity`). Of the
    methods that are so much better, and the fit to beat, the one with the smallest RMSE is chosen.
    Of control with lines a supported projection that explains it as well with fewer unknowns takes
    the place of the fit to beat (see `explains_lines_with_less`).

    The choice has its reason only where it is to be `explained`.
    """
    compared = tuple(fits)
    priors = [fitted for fitted in compared if method_of(fitted).has_prior]
    if not compared:
        return None
    if not priors:
        return _choice_without_prior(compared)
    base, reasons = fit_to_beat(priors)
    alternatives = [fitted for fitted in compared if not (
        method_of(fitted).has_prior or is_contained(method_of(fitted), priors))]
    rivals = [base]
    for alternative in alternatives.copy():
        is_clearly_better = gain(alternative, base) > required_gain(alternative, base)
        is_simpler = explains_lines_with_less(alternative, base)
        if not (is_clearly_better or is_simpler or is_supported_and_smaller(alternative, base)):
            continue
        if is_simpler:
            reasons.append(
                f"{method_of(alternative).label} leaves no more of the control than chance "
                f"explains, with {alternative.effective:.0f} unknowns in place of "
                f"{base.effective:.0f}.")
        # Five points let a camera fit well by chance, though the truth is a similarity.
        chance = chance_of_similarity(alternative, compared)
        if chance <= CHANCE_OF_SIMILARITY:
            rivals.append(alternative)
        else:
            alternatives.remove(alternative)
            reasons.append(f"{method_of(alternative).label} is not taken: it would fit points of a "
                           f"similarity as well in {chance:.0%} of cases.")
    simpler = [rival for rival in rivals if explains_lines_with_less(rival, base)]
    chosen = min(simpler or rivals, key=beyond_rounding)
    if not explained:
        return Choice(chosen, compared, "")
    # The reason compares both; where the base itself is chosen, they are one.
    descriptions = [describe(fitted) for fitted in dict.fromkeys((chosen, base))]
    reasons = [*filter(None, descriptions), *reasons]
    return Choice(chosen, compared,
                  _reason_for_choice(chosen, base, reasons, alternatives, compared))


def _choice_without_prior(compared: tuple[Fit, ...]) -> Choice:
    """Return the choice among fits without a prior: of five points with heights, for example.

    It is the fit with the smallest RMSE of held-out features, or a wider model whose residuals no
    chance explains. Four of five points determine a projection, or an affine polynomial with
    heights, without redundancy, so that it may predict the fifth badly though it is the geometry of
    the image. A wider model is chosen where it would fit points of the model with the smallest RMSE
    as well in at most CHANCE_OF_SIMILARITY of cases; of several, that of the least chance.
    """
    smallest = min(compared, key=beyond_rounding)
    wider, least_chance = smallest, CHANCE_OF_SIMILARITY
    for fitted in compared:
        chance = _chance_if_true(smallest, fitted)
        if chance is not None and chance <= least_chance:
            wider, least_chance = fitted, chance
    if wider is smallest:
        return Choice(smallest, compared, SMALLEST_RMSE_REASON)
    return Choice(wider, compared,
                  f"{method_of(smallest).label} has the smallest leave-one-out RMSE, but "
                  f"{method_of(wider).label} would fit points of it as well in "
                  f"{percent_text(least_chance)} of cases.")


def fit_to_beat(priors: Sequence[Fit]) -> tuple[Fit, list[str]]:
    """Return the fit with a prior that all others must beat, and sentences on why it is that one.

    The fits with a prior are taken in their order. A method takes the place of its own limiting
    case without a comparison, which is not worth a sentence; any other must be better by a margin
    to take the place of the one before it.
    """
    base = priors[0]
    reasons: list[str] = []
    for fitted in priors[1:]:
        method = method_of(fitted)
        base_method = method_of(base)
        if is_limit_of(base_method, method):
            base = fitted
            reasons = []
        elif not is_limit_of(method, base_method):
            # Leave-one-out says little of places beyond the points, where what is known holds, too.
            knows_more = base_method.from_one > method.from_one
            margin = _equally_sure_margin(base) if knows_more else PRIOR_MARGIN
            if margin < np.inf:
                reasons.append(_comparison_sentence(fitted, base, margin))
            if gain(fitted, base) > margin:
                base = fitted
    return base, reasons


def is_limit_of(method: Method, wider_method: Method) -> bool:
    """Return whether `wider_method` becomes `method` in the limit of its prior."""
    return method.name in wider_method.contains


def required_gain(fitted: Fit, base: Fit) -> float:
    """Return by how many standard errors a method that no prior contains must be better.

    The margin is infinite where the method cannot be chosen. For a camera that the points support
    it is smaller than for other methods.
    """
    if method_of(base).from_one > method_of(fitted).from_one:
        # Four points leave one equation of a camera of which nothing is known: its errors without
        # each of them may be small by chance.
        equations = 2 * len(base.held_out().squares) - fitted.effective
        says_nothing = method_of(fitted).central and equations < FEWEST_EQUATIONS_OF_CAMERA
        return np.inf if says_nothing else _equally_sure_margin(base)
    if not method_of(fitted).central:
        return CLEAR_MARGIN
    # Few points measured roughly, as in a drawn bird's-eye view, hardly resolve standard errors;
    # that they support an oblique view, or a camera near by, is evidence of its own. A camera with
    # about as many unknowns as an affine polynomial is not better for having more.
    has_few_unknowns = fitted.model.uses_height and fitted.effective <= MOST_OF_CAMERA
    return PRIOR_MARGIN if calls_for_camera(fitted) or has_few_unknowns else PROJECTION_MARGIN


def calls_for_camera(fitted: Fit) -> bool:
    """Return whether the control of a fit supports an oblique view, or a camera near by."""
    view = fitted.view
    return view is not None and (
        view.depth < OBLIQUE_DEPTH_RATIO or view.affine_share < CENTRAL_AFFINE_SHARE)


def explains_lines_with_less(fitted: Fit, base: Fit) -> bool:
    """Return whether a projection explains control with lines as well with fewer unknowns.

    A line shows no error along itself, so that errors at lines held out hardly show what further
    unknowns do between them. A projection that the control supports is then taken unless those of
    the base lessen the squares by more than chance: by the F test of both sums.
    """
    if not (len(fitted.control.lines) and method_of(fitted).central and calls_for_camera(fitted)):
        return False
    further_unknowns = base.effective - fitted.effective
    freedom = base.adjustment.n_equations - base.effective
    if further_unknowns <= 0.0 or freedom <= 0.0:
        return False
    share = _weighted_squares(base) / _weighted_squares(fitted)
    return chance_of_better_fit(share, freedom, further_unknowns) > CHANCE_OF_SIMILARITY


def is_supported_and_smaller(fitted: Fit, base: Fit) -> bool:
    """Return whether a central projection that the points support has a far smaller RMSE.

    A few large errors at the edge count in it; logarithms, by which methods are compared otherwise,
    hardly show them.
    """
    limit = supported_rmse_ratio(fitted, base) * beyond_rounding(base)
    return gain(fitted, base) > 0.0 and beyond_rounding(fitted) < limit


def supported_rmse_ratio(fitted: Fit, base: Fit) -> float:
    """Return below which part of the base's RMSE a central projection is taken without a margin.

    It is 0 for other methods, and for projections that must have the margin.
    """
    if not method_of(fitted).central:
        return 0.0
    count = len(fitted.held_out().squares)
    if fitted.view is not None and count >= SUPPORTED_MIN_FEATURES:
        return SUPPORTED_RMSE_RATIO
    # Of an average that spends more unknowns, larger errors are no sign that these are needed.
    is_simpler = not fitted.model.uses_height and fitted.effective < base.effective
    return FEWER_UNKNOWNS_RMSE_RATIO if is_simpler and count <= SPLINE_SURE_POINTS else 0.0


def chance_of_similarity(fitted: Fit, compared: Iterable[Fit]) -> float:
    """Return how likely a central projection fits as well as it does if a similarity is true.

    A similarity is the limit of a camera that looks straight down from far away. It is among the
    fits `compared` where the points are few; of five, a camera leaves two equations, so that its
    residuals and its errors held out may be small by chance. The chance is that of the F test of
    both sums of squared residuals, and 0.0 for other methods and without a similarity.
    """
    similarities = [other for other in compared
                    if method_of(other).for_few and other.effective < UNKNOWNS_OF_AFFINE]
    if not (method_of(fitted).central and similarities):
        return 0.0
    chance = _chance_if_true(min(similarities, key=_squares_left), fitted)
    return 0.0 if chance is None else chance


def _chance_if_true(simpler: Fit, wider: Fit) -> float | None:
    """Return how likely `wider` fits points as well as it does if the simpler model is true.

    It is the F test of both sums of squared residuals. Returns None if `wider` has no redundancy,
    or no more unknowns than the simpler model, and where there are lines.
    """
    if len(wider.control.lines):
        return None
    freedom = wider.adjustment.n_equations - wider.effective
    further_unknowns = wider.effective - simpler.effective
    if freedom <= 0.0 or further_unknowns <= 0.0:
        return None
    # Nested models: what the further unknowns take of the squares is compared with what is left.
    share = _squares_left(wider) / _squares_left(simpler)
    return chance_of_better_fit(share, freedom, further_unknowns)


def _squares_left(fitted: Fit) -> float:
    """Return the sum of weighted squared residuals of the points in use [px^2]."""
    residuals = fitted.control_errors(fitted.used)
    weights = weights_of(fitted.control.take(fitted.used).points)
    return max(float(((residuals * weights) ** 2).sum()), np.finfo(float).tiny)


def _weighted_squares(fitted: Fit) -> float:
    """Return the sum of weighted squared residuals of points and lines, scaled."""
    freedom = fitted.adjustment.n_equations - fitted.effective
    return max(fitted.adjustment.sigma0**2 * freedom, np.finfo(float).tiny)


def is_undecided(data: FitData) -> bool:
    """Return whether points in a plane are so few that the method with a prior is an average.

    So few points do not decide between what it averages, such as a similarity and a spline.
    """
    return not data.heights and not len(data.features.lines) and len(data) < SPLINE_MAX_POINTS


def _equally_sure_margin(base: Fit) -> float:
    """Return by how many standard errors a method must beat a base that knows more than it does.

    Of many features that is CLEAR_MARGIN. Few features hardly show the standard error, so that the
    margin of the same probability is larger (Student 1908); two show nothing of it, and the margin
    is infinite.
    """
    freedom = len(base.held_out().squares) - 1
    # Phi(CLEAR_MARGIN): a normal number stays below so many standard errors with this probability.
    probability = (1.0 + erf(CLEAR_MARGIN / sqrt(2.0))) / 2.0
    return t_quantile(probability, freedom) if freedom > 1 else np.inf


def _reason_for_choice(chosen: Fit, base: Fit, reasons: Sequence[str], alternatives: Sequence[Fit],
                       compared: Sequence[Fit]) -> str:
    """Return sentences on why a method is chosen, `reasons` for the fit to beat being the first.

    Then follow the alternative that is chosen, or else came nearest to it, with what it had to
    show; and the method with the smallest RMSE, where a method with a prior contains it.
    """
    sentences = list(reasons)
    if alternatives:
        # Where the base wins, the reader wants to know what came closest to it.
        nearest = chosen if chosen is not base else max(
            alternatives, key=lambda fitted: gain(fitted, base))
        sentences.append(_sentence_on_rival(nearest, base, is_chosen=nearest is chosen))
    if any(_UNCERTAINTY in sentence for sentence in sentences):
        sentences.append("That uncertainty is the standard error of the mean difference of "
                         "logarithms of squared leave-one-out errors.")
    smallest = min(compared, key=beyond_rounding)
    best = method_of(smallest)
    methods = [method_of(fitted) for fitted in compared]
    wider_methods = [method for method in methods if method.has_prior and is_limit_of(best, method)]
    if wider_methods and not best.has_prior:
        family = wider_methods[0].family or f"{wider_methods[0].title} and its like"
        advantage = advantage_in_words(gain(smallest, chosen), "the chosen model")
        sentences.append(f"{best.label} has the smallest RMSE of all ({advantage}), and is no "
                         f"candidate by itself: {family} contain it, and become it if the points "
                         "support it.")
    return " ".join(sentences) or SMALLEST_RMSE_REASON


_UNCERTAINTY = "the uncertainty of the difference"
"""What the difference of two models is measured by."""

_NO_ADVANTAGE = 0.005
"""Difference of two models, by its uncertainty, up to which a sentence calls them equal."""


def _sentence_on_rival(rival: Fit, base: Fit, *, is_chosen: bool) -> str:
    """Return how a method compares with the fit to beat, and why it is chosen or not."""
    margin = required_gain(rival, base)
    advantage = gain(rival, base)
    if advantage > margin and not is_chosen:
        return (f"{_difference_in_words(rival, base)}, and yet is not chosen: a few large errors "
                "make its RMSE the larger one.")
    if advantage > margin or not is_chosen:
        return _comparison_sentence(rival, base, margin)
    # Chosen without the margin, for its view.
    smaller_by = 1.0 - beyond_rounding(rival) / beyond_rounding(base)
    return (f"The points show a central projection, so {method_of(rival).label} needs only an RMSE "
            f"that is {1.0 - supported_rmse_ratio(rival, base):.0%} smaller than that of "
            f"{method_of(base).label}: it is {smaller_by:.0%} smaller.")


def _comparison_sentence(rival: Fit, base: Fit, margin: float) -> str:
    """Return how much better a method predicts than another, and whether that may be chance."""
    return (f"{_difference_in_words(rival, base)}"
            f"{requirement_in_words(gain(rival, base), margin)}.")


def _difference_in_words(rival: Fit, base: Fit) -> str:
    """Return by how much a method predicts held-out features better or worse than another."""
    label = method_of(rival).label
    return (f"{label[:1].upper()}{label[1:]} predicts left-out points "
            f"{advantage_in_words(gain(rival, base), method_of(base).label)}")


def advantage_in_words(advantage: float, other: str) -> str:
    """Return how much better than `other` a prediction is, from the gain of `gain_of`."""
    if not advantage > _NO_ADVANTAGE:
        return f"no better than {other}"
    times = rounded_size_text(advantage)
    return f"better than {other}, by {times} times {_UNCERTAINTY}"


def requirement_in_words(advantage: float, margin: float) -> str:
    """Return in words whether an advantage is more than chance, and how large it must be for that.

    `advantage` and the `margin` that it needs are in standard errors. Returns "" where there is no
    advantage.
    """
    if not advantage > _NO_ADVANTAGE:
        return ""
    if margin == np.inf:
        return ", which so few points cannot tell from chance"
    verdict = "more than chance explains" if advantage > margin else "which may be chance"
    return f", {verdict} (more than {margin:.2g} required)"


def beyond_rounding(fitted: Fit) -> float:
    """Return the RMSE of held-out features [px], or the rounding of the fit if that is larger.

    So fits that are exact but for rounding are equal, and the first of them is taken.
    """
    return max(fitted.held_out_rmse, fitted.rounding)


def gain(fitted: Fit, reference: Fit) -> float:
    """Return by how many standard errors a fit predicts held-out features better than another."""
    return gain_of(fitted.held_out().squares, reference.held_out().squares, fitted.rounding)
