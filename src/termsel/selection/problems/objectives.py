"""Further objectives: number, correlation, condition and spread of what is selected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.leave_out import IndependentPart
from termsel.core.isolation.arrays import difference_from_shape
from termsel.core.isolation.faults import (
    attribute_errors_to,
    fault_of_method,
    function_in_words,
    is_own,
)
from termsel.data.coordinates.places import feature_centres
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.selection.problems.coverage import uncovered_share


@dataclass(frozen=True, eq=False)
class PopulationSelection:
    """What the individuals of a population select, for objectives.

    Parameters
    ----------
    equations : Equations
        Of all terms and all control features.
    parts : tuple of IndependentPart
        The independent systems they fall into, such as line and sample.
    control : FeatureSet
    terms : ndarray of bool, shape (p, k)
    features : ndarray of bool, shape (p, f)

    Examples
    --------
    >>> import termsel
    >>> fewest = termsel.Objective("n_on", "Number of terms.", lambda population:
    ...                            population.terms.sum(axis=1))  # a PopulationSelection
    >>> fewest.name
    'n_on'
    """

    equations: Equations
    parts: tuple[IndependentPart, ...]
    control: FeatureSet
    terms: BoolArray
    features: BoolArray


def n_terms(selected: PopulationSelection) -> FloatArray:
    """Return the number of terms in use of each individual, (p,)."""
    return np.asarray(selected.terms.sum(axis=1), dtype=np.float64)


def n_features(selected: PopulationSelection) -> FloatArray:
    """Return the number of control features in use of each individual, (p,)."""
    return np.asarray(selected.features.sum(axis=1), dtype=np.float64)


_CONSTANT = 1e-12
"""Length of a column's deviations, by its own, up to which it is constant."""


def unit_deviations(design: FloatArray) -> FloatArray:
    """Return columns (m, k) less their means, each of length 1; a constant column becomes 0."""
    centred = design - design.mean(axis=0)
    lengths = np.linalg.norm(centred, axis=0)
    # The deviations of a constant column are rounding: it is correlated with nothing.
    varies = lengths > _CONSTANT * np.linalg.norm(design, axis=0)
    return np.asarray(centred / np.where(varies, lengths, np.inf))


def max_correlation(selected: PopulationSelection) -> FloatArray:
    """Return the largest absolute correlation between two columns in use, (p,).

    Correlations are those of Akhoundi Khezrabad et al. 2020, eq. 3, over all control. Where line
    and sample are independent, each has a matrix of its own: in a common one the two constants
    would be each other's negative. Columns without variance have no correlation. (As an
    objective: Gholinejad et al. 2019.)
    """
    largest = np.zeros(len(selected.terms))
    for part in selected.parts:
        A = unit_deviations(part.equations.A)
        correlation = np.abs(A.T @ A)
        np.fill_diagonal(correlation, 0.0)
        terms = selected.terms[:, part.columns]
        # Column by column: the largest correlation with any other in use, where it is in use too.
        for row, mask in zip(correlation, terms.T, strict=True):
            correlated = np.where(terms, row, 0.0).max(axis=1)
            largest = np.maximum(largest, np.where(mask, correlated, 0.0))
    return np.minimum(largest, 1.0)


def log_condition(selected: PopulationSelection) -> FloatArray:
    """Return log10 of the condition number of the used rows and columns, (p,).

    Columns are scaled to length 1. It is _SINGULAR where they are dependent, or more than the rows.
    """
    A = selected.equations.A
    feature = selected.equations.feature
    result = np.empty(len(selected.terms))
    for i, (terms, features) in enumerate(zip(selected.terms, selected.features, strict=True)):
        design = A[np.ix_(features[feature], terms)]
        lengths = np.linalg.norm(design, axis=0) if design.size else np.zeros(1)
        if not design.size or (lengths == 0).any() or design.shape[0] < design.shape[1]:
            result[i] = _SINGULAR
            continue
        values = np.linalg.svd(design / lengths, compute_uv=False)
        # Ratio of the extreme singular values; the least may be rounding, or 0.
        result[i] = min(_SINGULAR, np.log10(values[0] / max(values[-1], 1e-300)))
    return result


# log10 of a condition from which no digit of double precision is left.
_SINGULAR = 16.0


def uncovered(selected: PopulationSelection) -> FloatArray:
    """Return the share of the image outside the hull of the selected features, (p,), 0 to 1."""
    return uncovered_share(feature_centres(selected.control), selected.features)


def unevenness(selected: PopulationSelection) -> FloatArray:
    """Return the unevenness of the selected features, (p,).

    It is the coefficient of variation of their distances to the nearest selected neighbour in the
    image: 0 where all these are equal. It is 1 for fewer than three features, as two are always
    equally far from each other. termsel's own measure.
    """
    positions = feature_centres(selected.control)
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    # No feature is its own neighbour.
    np.fill_diagonal(distances, np.inf)
    variation = np.ones(len(selected.features))
    for i, mask in enumerate(selected.features):
        if mask.sum() >= 3:
            to_nearest = distances[np.ix_(mask, mask)].min(axis=1)
            if to_nearest.mean() > 0:
                variation[i] = to_nearest.std() / to_nearest.mean()
    return variation


@dataclass(frozen=True)
class Objective:
    """A named figure of what a selection is made of; it is minimised.

    Parameters
    ----------
    name, summary : str
    score : callable
        Takes `PopulationSelection`, returns finite figures, shape (p,).

    Examples
    --------
    >>> import termsel
    >>> termsel.Objective("n_on", "Number of terms.", lambda s: s.terms.sum(axis=1)).name
    'n_on'
    """

    name: str
    summary: str
    score: Callable[[PopulationSelection], FloatArray]


def figures_of_objective(objective: Objective, selected: PopulationSelection) -> FloatArray:
    """Return the figures of an objective, (p,), one finite number for each individual.

    Raises PluginFault, naming the plugin, for figures of another shape or that are not finite.
    """
    score = objective.score
    called = "" if is_own(score) else function_in_words(f"objective {objective.name!r}", score)
    with attribute_errors_to(score, "score", name=called):
        figures = score(selected)
    if fault := difference_from_shape(figures, (len(selected.terms),)):
        raise fault_of_method(score, "score", fault, name=called)
    return figures


OBJECTIVES = tuple(Objective(score.__name__, summary, score) for score, summary in (
    (n_terms, "Number of terms in use."),
    (n_features, "Number of control features in use."),
    (max_correlation, "Largest correlation of two columns in use."),
    (log_condition, "Logarithm of the condition number."),
    (uncovered, "Share of the image outside the hull of the features in use."),
    (unevenness, "Unevenness of the distances between the features in use.")))
"""Built-in objectives next to the criterion."""
