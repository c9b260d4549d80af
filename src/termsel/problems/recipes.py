"""Recipes: named problems with everything they need by default."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from termsel.options import Option
from termsel.problems.base import Inputs, Problem
from termsel.problems.constraints import FORCED, WISHES
from termsel.problems.selection import SelectionProblem


@dataclass(frozen=True)
class Recipe:
    """A named problem: defaults, and how to build it from data and model.

    Parameters
    ----------
    name, summary : str
    build : callable
        Takes `Inputs`, returns a `Problem`.
    model, dataset, criterion, solver : str
        Names of the defaults, so that the problem's name alone runs.
    model_options : mapping
        Options of the default model that differ from the model's own defaults.
    control : {"points", "lines"}
        Kind of control features.
    options : tuple of Option
        Further settings of the problem.
    second : str
        The objective beside the criterion where a solver for several is asked for.
    portfolio : bool
        Whether the strategy "auto" may answer the problem: what is wanted is the best model of
        the points, by whatever terms.
    source : str
        The paper the problem comes from.
    """

    name: str
    summary: str
    build: Callable[[Inputs], Problem]
    model: str
    dataset: str
    criterion: str = "check-rmse"
    solver: str = "ga"
    model_options: Mapping[str, Any] = field(default_factory=dict)
    control: str = "points"
    options: tuple[Option, ...] = ()
    second: str = "n_terms"
    portfolio: bool = False
    source: str = ""


MASK = Option("mask", "per-axis", "Whether line and sample select their terms each or together.",
              choices=("per-axis", "shared"))
MIXED = Option("mixed", False, "Use control points and control lines together in one adjustment.",
               bool)
COUNTS = (
    Option("min_features", None, "Fewest control features of a selection; by default free.",
           int, 1),
    Option("max_features", None, "Most control features of a selection; by default free. With "
           "the same number for both, m of n features are chosen.", int, 1),
    Option("max_uncovered", None, "Largest share of the image that the hull of the chosen "
           "features may leave out, 0 to 1; by default free.", float, 0.0, 1.0),
)

TERMS = Option("terms", None, "Terms of the model in use, with commas between; by default all.")
STEPS = Option("steps", "joint", "Whether terms and features are selected together; or terms "
               "first, with all features, then features under these terms; or the reverse.",
               choices=("joint", "terms-first", "features-first"))

OBJECTIVES = Option(
    "objectives", None, "Objectives beside the criterion, with commas between: n_terms, "
    "n_features, max_correlation, log_condition, uncovered, unevenness. By default none, or, "
    "with a solver for several, the number of what is selected.")
RECOMMEND = Option(
    "recommend", None, "Which member of a front is the selection: the one with the least second "
    "objective, or with exact the fewest terms, within one standard error of the best criterion; "
    "the knee; or the best criterion. By default one-standard-error with several objectives, "
    "best otherwise and for a criterion without a standard error.",
    choices=("one-standard-error", "knee", "best"))
RECOMMEND_TERMS = replace(RECOMMEND, doc=RECOMMEND.doc.replace(
    "or the best criterion. By", "the least EBIC; or the best criterion. By"),
    choices=(*RECOMMEND.choices, "ebic"))

_BOTH = (MASK, MIXED, *WISHES, OBJECTIVES)
OF_TERMS = (*_BOTH, RECOMMEND_TERMS)
OF_FEATURES = (TERMS, MIXED, *COUNTS, *FORCED, OBJECTIVES, RECOMMEND)
OF_BOTH = (*_BOTH, RECOMMEND, *COUNTS, STEPS)


def feature_options(**defaults: Any) -> tuple[Option, ...]:
    """Return the options of problems that select features, for the recipe of another one.

    Parameters
    ----------
    **defaults
        Of options that have others there, such as ``max_features=6``.
    """
    options = {option.name: option for option in OF_FEATURES}
    for name, default in defaults.items():
        options[name] = replace(options[name], default=default,
                                doc=options[name].doc.replace("; by default free", ""))
    return tuple(options.values())


def _terms(inputs: Inputs) -> Problem:
    return SelectionProblem(inputs, terms=True, features=False, mask=inputs.options["mask"])


def _features(inputs: Inputs) -> Problem:
    return SelectionProblem(inputs, terms=False, features=True)


def _both(inputs: Inputs) -> Problem:
    return SelectionProblem(inputs, terms=True, features=True, mask=inputs.options["mask"])


YAVARI = "Yavari, Valadan Zoej, Salehi 2018 (OWDIS)"

RECIPES = (
    Recipe("rfm-terms", "Which terms of a rational function model to use.", _terms,
           model="rfm", dataset="ikonos-hamedan", options=OF_TERMS, portfolio=True,
           source="Valadan Zoej et al. 2007; Akhoundi Khezrabad et al. 2020"),
    Recipe("poly-terms", "Which terms of a plane polynomial to use.", _terms,
           model="poly2d", dataset="ikonos-hamedan", options=OF_TERMS, portfolio=True,
           source="Valadan Zoej et al. 2002; Zakaryaie Nejad et al. 2015"),
    Recipe("owdis-points", "Which control points to use.", _features,
           model="poly3d", dataset="ikonos-hamedan", options=OF_FEATURES, second="n_features",
           source=YAVARI),
    Recipe("owdis-lines", "Which control lines to use.", _features,
           model="poly3d", dataset="ikonos-hamedan", control="lines",
           options=OF_FEATURES, second="n_features", source=YAVARI),
    Recipe("owdis-points-terms", "Which control points and which model terms to use.", _both,
           model="rfm", model_options={"order": 2, "ridge": 0.0}, dataset="ikonos-hamedan",
           options=OF_BOTH, source=YAVARI),
    Recipe("owdis-lines-terms", "Which control lines and which model terms to use.", _both,
           model="rfm", model_options={"order": 2, "ridge": 0.0}, dataset="ikonos-hamedan",
           control="lines", options=OF_BOTH, source=YAVARI),
)
