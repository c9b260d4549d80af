"""Recipes: named problems with all their defaults."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.options import COUNT, Option
from termsel.selection.problems.base import Problem, ProblemData
from termsel.selection.problems.constraints import FORCE_OPTIONS, TERM_OPTIONS
from termsel.selection.problems.selection import SelectionProblem


@dataclass(frozen=True)
class Recipe:
    """A named problem: defaults, and how to build it from data and model.

    Parameters
    ----------
    name, summary : str
    build : callable
        Takes `ProblemData`, returns a `Problem`.
    model, dataset, criterion, solver : str
        Names of the defaults, so that the problem's name alone runs.
    model_options : mapping
        Options of the default model that differ from the defaults of the model.
    control : {"points", "lines", "both"}
        Kind of control features; with both, points and lines are in one adjustment.
    options : tuple of Option
        Further settings of the problem.
    second : str
        The second objective of a solver for several objectives.
    for_methods : bool
        Whether the strategy "auto" may answer the problem: it asks for the best model of the
        features, with any terms.
    solver_options : mapping
        Options of solvers, by the solver's name, that differ from their defaults.
    generations, patience : int, optional
        Budget of the problem's search if none is given: generations, and generations without a
        gain; by default that of every search.
    refined : bool
        Whether the problem's own solver is followed by a local refinement.
    search_first : bool
        Whether the problem's own solver runs all the same, unless the strategy "auto" is asked for.
    source : str
        The paper the problem comes from.

    Examples
    --------
    >>> import termsel
    >>> recipe = termsel.Recipe("mine", "Terms of a polynomial.", lambda inputs: inputs, "poly2d",
    ...                          "ikonos-hamedan")
    >>> recipe.solver
    'ga'
    """

    name: str
    summary: str
    build: Callable[[ProblemData], Problem]
    model: str
    dataset: str
    criterion: str = "check-rmse"
    solver: str = "ga"
    model_options: Mapping[str, Any] = field(default_factory=dict)
    control: str = "points"
    options: tuple[Option, ...] = ()
    second: str = "n_terms"
    for_methods: bool = False
    search_first: bool = False
    solver_options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    generations: int | None = None
    patience: int | None = None
    refined: bool = True
    source: str = ""

    def __post_init__(self) -> None:
        """Raise TermselError for an unknown kind of control, and for options that are no `Option`.
        """
        if self.control not in ("points", "lines", "both"):
            raise TermselError(f"recipe {self.name!r} has the control {self.control!r:.100}",
                               hint="Give points, lines or both.")
        # A plugin's mistake is told when it is made, not when the option is used.
        not_options = [option for option in self.options if not isinstance(option, Option)]
        if not_options:
            raise TermselError(f"recipe {self.name!r} has the option {not_options[0]!r:.100}",
                               hint="Give objects of Option.")


MASK = Option("mask", "per-axis", "Whether line and sample select their terms separately or "
              "together.", choices=("per-axis", "shared"))
MIXED = Option("mixed", False, "Use control points and control lines together in one adjustment.",
               bool)
COUNT_OPTIONS = (
    Option("min_features", None, "Fewest control features of a selection; by default not limited.",
           int, 1, COUNT),
    Option("max_features", None, "Most control features of a selection; by default not limited. "
           "The same number for both selects m of n features.", int, 1, COUNT),
    Option("max_uncovered", None, "Largest share of the image outside the hull of the selected "
           "features, 0 to 1; by default not limited.", float, 0.0, 1.0),
)

TERMS = Option("terms", None, "Terms of the model in use, separated by commas; by default all.")
STEPS = Option("steps", "joint", "Whether terms and features are selected together; or terms "
               "first, with all features, then features with these terms; or the reverse. The "
               "first of two steps has half of the budget, the second what is left.",
               choices=("joint", "terms-first", "features-first"))
THEN = Option("then", None, "Solver of the second of two steps (--then); by default that of the "
              "first.")

OBJECTIVES = Option(
    "objectives", None, "Objectives next to the criterion, separated by commas: n_terms, "
    "n_features, max_correlation, log_condition, uncovered, unevenness, or those of plugins "
    "(termsel list objectives). By default none; with a "
    "solver for several objectives, the second objective of the problem.")
RECOMMEND = Option(
    "recommend", None, "Which member of a front is the selection: the knee; the best criterion; "
    "or, within one standard error of the best, the least second objective (with exact the fewest "
    "terms). By default one-standard-error with several objectives and a criterion that has a "
    "standard error; otherwise best.",
    choices=("one-standard-error", "knee", "best"))
RECOMMEND_TERMS = replace(RECOMMEND, doc=RECOMMEND.doc.replace(
    "the best criterion; or,", "the best criterion; the least EBIC; or,"),
    choices=(*RECOMMEND.choices, "ebic"))

BLUNDERS = Option(
    "blunders", "leave-out", "What becomes of blunders among control and selection points: "
    "leave-out searches without them; keep is the search as published.",
    choices=("leave-out", "keep"))

CAP = next(option for option in TERM_OPTIONS if option.name == "max_share")
# What problems of terms, with or without features, have in common.
_BOTH = (MASK, MIXED, *TERM_OPTIONS, OBJECTIVES)
OF_TERMS = (*_BOTH, RECOMMEND_TERMS)
OF_FEATURES = (TERMS, MIXED, *COUNT_OPTIONS, *FORCE_OPTIONS, OBJECTIVES, RECOMMEND, BLUNDERS)
OF_BOTH = (*_BOTH, RECOMMEND, *COUNT_OPTIONS, STEPS, THEN, BLUNDERS)


def feature_options(**defaults: Any) -> tuple[Option, ...]:
    """Return the options of problems that select features, for use in a recipe of your own.

    Parameters
    ----------
    **defaults
        Defaults that differ from the usual ones, such as ``max_features=6``.

    Returns
    -------
    tuple of Option
        All of them, with the given defaults.

    Raises
    ------
    TermselError
        If a default is given for an option that does not exist.

    Examples
    --------
    >>> import termsel
    >>> [option.name for option in termsel.feature_options(max_features=6)][:2]
    ['terms', 'mixed']
    """
    return with_defaults(OF_FEATURES, **defaults)


def term_options(**defaults: Any) -> tuple[Option, ...]:
    """Return the options of problems that select terms, for use in a recipe of your own.

    Parameters
    ----------
    **defaults
        Defaults that differ from the usual ones, such as ``max_share=0.5``.

    Returns
    -------
    tuple of Option
        All of them, with the given defaults.

    Raises
    ------
    TermselError
        If a default is given for an option that does not exist.

    Examples
    --------
    >>> import termsel
    >>> options = termsel.term_options(max_share=0.5)
    >>> [option.default for option in options if option.name == "max_share"]
    [0.5]
    """
    return with_defaults(OF_TERMS, **defaults)


def with_defaults(declared: tuple[Option, ...], **defaults: Any) -> tuple[Option, ...]:
    """Return options with other defaults for some of them, given by name.

    The text of such an option no longer states its usual default.

    Raises
    ------
    TermselError
        If a default is given for an option that does not exist.
    """
    options = {option.name: option for option in declared}
    for name, default in defaults.items():
        if name not in options:
            raise unknown_name_error("option", name, options)
        # A text that shows the usual default would be wrong of this one.
        options[name] = replace(options[name], default=default,
                                doc=_USUAL.sub("", options[name].doc))
    return tuple(options.values())


_USUAL = re.compile(r"; by default [^.]*| By default [^.]*\.")


def select_terms(inputs: ProblemData) -> Problem:
    """Return the selection of terms."""
    return SelectionProblem(inputs, terms=True, features=False, mask=inputs.options["mask"])


def select_features(inputs: ProblemData) -> Problem:
    """Return the selection of features."""
    return SelectionProblem(inputs, terms=False, features=True)


def select_both(inputs: ProblemData) -> Problem:
    """Return the selection of terms and features."""
    return SelectionProblem(inputs, terms=True, features=True, mask=inputs.options["mask"])


_ALSO = (*TERM_OPTIONS, MIXED, OBJECTIVES, RECOMMEND_TERMS, TERMS, *COUNT_OPTIONS, STEPS, THEN,
         BLUNDERS)


def undeclared_options(recipe: Recipe) -> tuple[Option, ...]:
    """Return the options that a recipe's problem may take beside its declared ones.

    A recipe that declares no option of `SelectionProblem` takes these options all the same. Whether
    its problem is a `SelectionProblem` is known once it has been built, from `options_of`.
    """
    # A recipe with objectives declares all that it takes.
    declared = {option.name for option in recipe.options}
    return () if OBJECTIVES.name in declared else tuple(
        option for option in _ALSO if option.name not in declared)


def options_of(problem: Problem) -> frozenset[str]:
    """Return the names of the options that a problem has by being a `SelectionProblem`."""
    if not isinstance(problem, SelectionProblem):
        return frozenset()
    # What is selected shows which options have a meaning.
    names = {segment.name for segment in problem.genome.segments}
    options: tuple[Option, ...] = OF_BOTH
    if "features" not in names:
        options = OF_TERMS
    elif names == {"features"}:
        options = OF_FEATURES
    # How terms share a mask is an argument of the class.
    return frozenset(option.name for option in options) - {MASK.name}


YAVARI = "Yavari, Valadan Zoej, Salehi 2018 (OWDIS)"

RECIPES = (
    Recipe("rfm-terms", "Which terms of a rational function model to use.", select_terms,
           model="rfm", dataset="ikonos-hamedan", options=OF_TERMS, for_methods=True,
           source="Valadan Zoej et al. 2007; Akhoundi Khezrabad et al. 2020"),
    Recipe("rfm-terms-lines", "Which terms of a rational function model to use, with lines as "
           "control.", select_terms,
           model="rfm", dataset="ikonos-hamedan", control="lines", options=OF_TERMS,
           for_methods=True, search_first=True,
           source=f"{YAVARI}; its companion on particle swarm could not be consulted"),
    Recipe("poly-terms", "Which terms of a 2-D polynomial to use.", select_terms,
           model="poly2d", dataset="ikonos-hamedan", options=OF_TERMS, for_methods=True,
           source="Valadan Zoej et al. 2002; Zakaryaie Nejad et al. 2015"),
    Recipe("owdis-points", "Which control points to use.", select_features,
           model="poly3d", dataset="ikonos-hamedan", options=OF_FEATURES, second="n_features",
           for_methods=True, search_first=True,
           source=YAVARI),
    Recipe("owdis-lines", "Which control lines to use.", select_features,
           model="poly3d", dataset="ikonos-hamedan", control="lines",
           options=OF_FEATURES, second="n_features", for_methods=True, search_first=True,
           source=YAVARI),
    Recipe("owdis-points-terms", "Which control points and which model terms to use.", select_both,
           model="rfm", model_options={"order": 2}, dataset="ikonos-hamedan",
           options=OF_BOTH, for_methods=True, search_first=True,
           source=YAVARI),
    Recipe("owdis-lines-terms", "Which control lines and which model terms to use.", select_both,
           model="rfm", model_options={"order": 2}, dataset="ikonos-hamedan",
           control="lines", options=OF_BOTH, for_methods=True, search_first=True,
           source=YAVARI),
)
