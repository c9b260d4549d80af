"""Plain words on what a selection is worth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from termsel.auto.methods import BY_NAME
from termsel.core.errors import amount_in_words, count_in_words, rounded_size_text
from termsel.data.record.figures import FEW_EVALUATIONS, MANY_INDEPENDENT, NO_FIGURE, TOO_FEW
from termsel.data.roles import Observations
from termsel.fitting.extrapolation import warnings_of
from termsel.fitting.figures import PARALLEL, Baseline, Rmses, orientation_spread
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import fit
from termsel.fitting.method import Method
from termsel.plugins.registry import registry
from termsel.results.verdict import ALIKE_RATIO, times_in_words, verdict_on_choice
from termsel.selection.criteria import Criterion
from termsel.selection.problems.genome import Genome
from termsel.selection.solvers.search import SearchResult

_ROUNDING_PX = 1e-9  # px: smaller errors are those of arithmetic
POOR = 3.0
"""A selection with so many times the RMSE of a conventional model is not compared with all
terms."""


def judge(conventional: str, criterion: str, rmse: Rmses, baselines: tuple[Baseline, ...],
          reference: str, feasible: bool, noise: float | None, *, converged: bool = True,
          method: Method | None = None, blunders: int = 0, evaluations: int | None = None,
          has_figure: bool = True) -> str:
    """Return some sentences on what a selection is worth next to fits that need no search.

    If it must not be used, or independent points are missing, they say so instead.

    Parameters
    ----------
    conventional : str
        The features and terms of the conventional fit, such as "all lines". That fit is the first
        of the `baselines`.
    criterion : str
        What the search minimised.
    rmse : mapping
        The RMSE of the selection by role [px], as that of the baselines without independent points
        that contradict all others.
    baselines : tuple of Baseline
        The fits that it is compared with.
    reference : str
        The name of the baseline that the rule of auto chooses for control and check; "" if none is.
    feasible : bool
        Whether the selection satisfies all conditions.
    noise : float or None
        Standard deviation of the measurements [px], None if it is not known.
    converged : bool
        Whether the fit of the selection has.
    method : Method, optional
        That of the `reference`; by default the method of this name.
    blunders : int
        How many features that method leaves out as blunders.
    evaluations : int, optional
        How many the search made, if its budget ended it.
    has_figure : bool
        Whether the criterion gives the selection a finite figure.
    """
    unusable = _reason_not_to_use(criterion, evaluations, has_figure=has_figure,
                                  converged=converged, feasible=feasible)
    if unusable:
        return unusable
    # From here on the figure is the RMSE of independent points, which took no part.
    measured = rmse["independent"]
    if measured is None:
        return ("There are no independent check points, so the accuracy of this selection is not "
                f"known. The search minimised {criterion}.")
    best = next((b for b in baselines if b.name == reference), None)
    # Better than what fails is nothing to be proud of.
    poor = best is not None and _error_ratio(measured.total, _independent_rmse(best)) > POOR
    first = _sentence_on_conventional(measured.total, baselines[0], conventional, poor=poor)
    sentences = [f"{first} at {count_in_words(measured.n, 'independent check point')}."]
    # The rule of auto, for what the user would get without a search.
    method = method or BY_NAME.get(reference)
    if best is not None and method is not None:
        sentences.append(_sentence_on_automatic_choice(measured.total, _independent_rmse(best),
                                                       method, blunders))
    else:
        sentences.append("Control and selection points together determine no polynomial.")
    if noise is not None:
        # Both coordinates of a point have the noise, and the RMSE is that of distances.
        sentences.append(f"Measurement noise alone gives {_px_text(noise * np.sqrt(2))}.")
    return " ".join(sentences)


def _reason_not_to_use(criterion: str, evaluations: int | None, *, has_figure: bool,
                       converged: bool, feasible: bool) -> str:
    """Return why a selection must not be used, and what to do; "" if there is no such reason.

    The arguments are those of `judge`.
    """
    if not has_figure:
        return (f"The criterion {criterion!r} {NO_FIGURE} for this selection, and none was found "
                "that it gives one for. Do not use it: choose another criterion; if this one is "
                "your own, its score() gives NaN or infinity.")
    if not converged:
        return ("The fit of this selection did not converge: its coefficients are those of the "
                "last step. Do not use it: measure more control points or choose a simpler model.")
    if not feasible and evaluations is not None and evaluations < FEW_EVALUATIONS:
        return (f"This selection does not satisfy all conditions, and no better one was found with "
                f"{amount_in_words(evaluations, 'evaluation')}, {TOO_FEW}. Do not use it: search "
                f"with {FEW_EVALUATIONS:,} evaluations or more.")
    if not feasible:
        return ("This selection does not satisfy all conditions, and no better one was found. It "
                "has undetermined or too many terms, an axis without terms, or a pole in the "
                "scene. Do not use it: measure more control points or choose a smaller model.")
    return ""


def _sentence_on_conventional(rmse: float, baseline: Baseline, conventional: str, *,
                              poor: bool) -> str:
    """Return how a selection of some RMSE [px] compares with the conventional fit `baseline`.

    `conventional` says what that fit uses, such as "all lines". There is no comparison if it did
    not converge, or if the selection itself is `poor`: it would flatter one of both. The sentence
    has no full stop.
    """
    if poor or not baseline.converged:
        sentence = f"The RMSE of the selection is {_px_text(rmse)}"
        if not baseline.converged:
            sentence += f" (the fit of {conventional} did not converge)"
        return sentence
    return _comparison_sentence("The selection is", rmse, _independent_rmse(baseline), conventional,
                                determined=baseline.determined)


def _sentence_on_automatic_choice(rmse: float, rmse_of_choice: float, method: Method,
                                  blunders: int) -> str:
    """Return how a selection compares with what the user would get without a search.

    That is `method`, the automatic choice, which leaves out `blunders` features. Both RMSE are
    those of independent points [px].
    """
    removed = ", outliers removed" if blunders else ""
    title = f"{method.title} fitted to control and selection points{removed}"
    ratio = _error_ratio(rmse, rmse_of_choice)
    size = _px_text(rmse_of_choice)
    if ratio > ALIKE_RATIO and (blunders or not method.is_plain):
        return (f"The automatic choice, {title}, is {times_in_words(ratio)} better ({size}): omit "
                "--problem, --solver and --model.")
    if ratio > ALIKE_RATIO:
        return f"A simpler model, {title}, is {times_in_words(ratio)} better ({size})."
    if ratio > 1 / ALIKE_RATIO:
        return f"It is no better than the automatic choice, {title} ({size})."
    return f"It is {times_in_words(1 / ratio)} better than the automatic choice, {title} ({size})."


def judge_choice(method: Method, predicted: float | None, rmse: Rmses,
                 baselines: tuple[Baseline, ...], noise: float | None, *,
                 held_out: float | None = None, gains: Mapping[str, float | None] | None = None,
                 is_asked_for: bool = False) -> str:
    """Return some sentences on the worth of an automatic choice, or of a method asked for.

    `predicted` is the RMSE of the choice repeated in folds [px], and `held_out` that of the chosen
    model alone in leave-one-out. `gains` are those of the models that it was chosen among (see
    `verdict_on_choice`). `rmse` is that by role, and `noise` the standard deviation of the
    measurements [px], where it is known.

    The choice is compared with the conventional model that held-out features would have chosen,
    like with like: both at the independent points where there are `MANY_INDEPENDENT`, else both in
    leave-one-out. A conventional model that is better at so many independent points is named, too.
    """
    measured = rmse["independent"]
    subject = "The method that was asked for" if is_asked_for else "The automatic choice"
    if measured is None:
        expected = "" if predicted is None else f", with a predicted RMSE of {_px_text(predicted)}"
        sentences = [f"{subject} is {method.title}{expected}.",
                     "It is not verified: there are no independent check points."]
    else:
        # The prediction is for these points; that of new points elsewhere is another figure.
        expected = "" if predicted is None else f"; predicted there: {_px_text(predicted)}"
        sentences = [f"{subject} is {method.title}.",
                     f"The RMSE at {count_in_words(measured.n, 'independent check point')}, "
                     f"which took no part, is {_px_text(measured.total)}{expected}."]
    # The rival is chosen by held-out errors, never by independent check points.
    rivals = [(b.predicted, b, candidate.title) for b in baselines if b.predicted is not None
              and (candidate := registry().known("methods", b.name))
              and candidate.is_plain and candidate is not method]
    if rivals:
        # The surer figures decide: many independent points, else leave-one-out.
        by_points = measured is not None and (predicted is None
                                              or measured.n >= MANY_INDEPENDENT)
        rival_held_out, best, title = min(rivals, key=lambda rival: rival[0])
        deficient = "" if best.determined else ", which is rank-deficient"
        if by_points and measured is not None:
            rival_rmse = _independent_rmse(best)
            verdict = verdict_on_choice(measured.total, rival_rmse, best.name, gains or {},
                                        at_points=True)
            sentences.append(f"There {title}, the best conventional model in cross-validation, has "
                             f"{_px_text(rival_rmse)}{deficient}: {verdict}.")
            sentences += _conventional_in_hindsight(measured.total, best, [
                (b, name) for _, b, name in rivals])
        elif held_out is not None:
            verdict = verdict_on_choice(held_out, rival_held_out, best.name, gains or {})
            sentences.append("In leave-one-out, in which each is predicted by a fit without it, "
                             f"its model has {_px_text(held_out)}, and {title}, the "
                             f"best conventional model, {_px_text(rival_held_out)}{deficient}: "
                             f"{verdict}.")
    if noise is not None and measured is not None:
        sentences.append(f"Measurement noise alone gives {_px_text(noise * np.sqrt(2))}.")
    return " ".join(sentences)


def best_conventional(method: Method, baselines: tuple[Baseline, ...]) -> str:
    """Return the name of the conventional model that cross-validation prefers.

    It is that with the least RMSE of held-out features among the `baselines`. `method`, which was
    chosen, is no rival of its own. Returns "" if no rival was judged.
    """
    rmse_of_rival = {}
    for row in baselines:
        if row.predicted is None:
            continue
        candidate = registry().known("methods", row.name)
        if candidate and candidate.is_plain and candidate is not method:
            rmse_of_rival[row.name] = row.predicted
    return min(rmse_of_rival, key=lambda name: rmse_of_rival[name], default="")


def _conventional_in_hindsight(rmse: float, named: Baseline,
                               conventional: list[tuple[Baseline, str]]) -> Iterator[str]:
    """Yield which conventional model is better at the independent points, if one but `named` is.

    `rmse` is that of the chosen model there [px].
    """
    best, title = min(conventional, key=lambda rival: _independent_rmse(rival[0]))
    # Said apart, as these points chose it in hindsight.
    ratio = _error_ratio(rmse, _independent_rmse(best))
    if ratio > ALIKE_RATIO and best is not named:
        yield (f"At these points {title} is {times_in_words(ratio)} better "
               f"({_px_text(_independent_rmse(best))}), "
               "which only these points show.")


def name_conventional(genome: Genome, observations: Observations) -> str:
    """Return what a conventional fit uses, which selects nothing, such as "all lines".

    The features or terms are named that the search could select, as its genome says.
    """
    has_lines = len(observations.control.lines) > 0
    has_points = len(observations.control.points) > 0
    if has_lines and has_points:
        features = "all points and lines"
    else:
        features = "all lines" if has_lines else "all control points"
    segments = [segment.name for segment in genome.segments]
    selects_terms = any(name.startswith("terms") for name in segments)
    if "features" not in segments:
        return "all terms"
    return f"{features} with all terms" if selects_terms else features


def _independent_rmse(baseline: Baseline) -> float:
    """Return the RMSE [px] of the independent points; infinite where there are none."""
    value = baseline.rmse["independent"]
    return float("inf") if value is None else value.total


def _error_ratio(error: float, reference: float) -> float:
    """Return an error [px] by a reference [px]; errors below `_ROUNDING_PX` count as that."""
    return max(error, _ROUNDING_PX) / max(reference, _ROUNDING_PX)


def _px_text(value: float) -> str:
    """Return an error in px, rounded as on every screen."""
    return f"{rounded_size_text(value)} px"


def _comparison_sentence(start: str, rmse: float, reference: float, title: str, *,
                         determined: bool) -> str:
    """Return a sentence that compares an RMSE [px] with that of a reference named `title`.

    It begins with `start`, such as "The selection is", and has no full stop. Up to `ALIKE_RATIO`
    one of both is "no better". `determined` says whether the points determine all terms of the
    reference; if not, the sentence calls it rank-deficient.
    """
    figures = f"({_px_text(rmse)} against {_px_text(reference)}"
    figures += ")" if determined else ", which is rank-deficient)"
    ratio = _error_ratio(reference, rmse)
    if ratio > ALIKE_RATIO:
        return f"{start} {times_in_words(ratio)} better than {title} {figures}"
    if ratio > 1 / ALIKE_RATIO:
        return f"{start} no better than {title} {figures}"
    return f"{start} {times_in_words(1 / ratio)} worse than {title} {figures}"


def notes_on_search(observations: Observations, criterion: Criterion, search: SearchResult,
             fitted: Fit) -> Iterator[str]:
    """Yield further notes for the reader of a result, if there are any.

    `fitted` is the fit of what `search` selected. Notes are on the data that the search used, on
    its equations, on how far the selection is fitted to the selection points, and on figures that
    look alike and are not. Nothing is yielded where all is as usual.
    """
    yield from search.notes
    if len(observations.control.lines) and not len(observations.control.points):
        idle = len(observations.off)
        if idle:
            yield (f"{count_in_words(idle, 'control point')} of the file "
                   f"{'is' if idle == 1 else 'are'} "
                   "unused: lines are the control; --set mixed=true uses both.")
    lines = fitted.control.take(fitted.used).lines
    if len(lines) and not len(observations.control.points):
        spread = orientation_spread(lines)
        if spread < PARALLEL:
            yield (f"The lines in use run nearly alike (orientation spread {spread:.2g} of 1): "
                   "the model is hardly determined along them.")
    # Pseudo-observations of weight w: rows sqrt(w) c = 0 below the design matrix.
    prior = fitted.model.equations(fitted.scaled_control).prior
    if prior is not None and prior[fitted.terms].any() and fitted.estimator.least_squares:
        yield (f"Pseudo-observations of weight {prior.max()**2:.3g} hold coefficients of "
               "denominators near zero (--set ridge=...); they do not count as redundancy.")
    if fitted.model.start(fitted.scaled_control.take(fitted.used)) is not None:
        yield ("The model is not linear in its terms. The search judged each selection by one "
               "linear solution about the fit of all terms; the selection itself took "
               f"{count_in_words(fitted.adjustment.steps or 0, 'step')}.")
    if search.interrupted:
        yield "The search was interrupted; this is the best selection so far."
    check = fitted.rmse(observations.check)
    # Selection points were minimised: how much better they fit is the overfit.
    independent = fitted.rmse(observations.independent)
    if (criterion.needs_check and check and independent
            and independent.total > 1.5 * check.total):
        yield (f"The independent RMSE is {independent.total / check.total:.1f} times that "
               "at the selection points: the selection is fitted to them.")
    yield from warnings_of(observations.control, fitted.used, observations.check)
    objective = search.objectives[0]
    if (criterion.name == "check-rmse" and check and fitted.estimator.least_squares
            and search.violation == 0 and abs(check.total - objective) > 0.005 * check.total):
        first = fit(fitted.model, fitted.control, fitted.scaling, fitted.terms, fitted.used,
                    iterated=False).rmse(observations.check)
        if first and abs(first.total - objective) <= 0.005 * objective:
            yield (f"The search saw an RMSE of {objective:.4g} px at selection points, with "
                   "equations to first order; the fit was then iterated.")
        else:
            yield (f"The search minimised an RMSE of {objective:.4g} px over the points that the "
                   "problem judges by, which are not the selection points alone.")
    # As many equations as terms: residuals are zero whatever the errors.
    if fitted.adjustment.redundancy == 0:
        yield "The adjustment has no redundancy: its residuals are no measure of accuracy."
