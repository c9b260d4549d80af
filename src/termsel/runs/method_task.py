"""The task of a method that needs no search: all control and selection points, in their roles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from termsel.auto.auto import Auto
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.plugins.registry import registry
from termsel.runs.fit_crs import with_polar
from termsel.runs.request import Request, request_of
from termsel.runs.rpc_given import part_of_rpc, with_part
from termsel.runs.task import Task, observe, with_shares
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.heuristics.yardsticks import AllTerms

LEAST = 2
"""Control points without which there is no answer."""


def request_of_method(problem: str | Recipe, *, options: Any = None, **arguments: Any) -> Request:
    """Return what is asked for where a method answers a problem, in place of the problem's search.

    `arguments` are features, data set, source and model, as for `request_of`. The criterion needs
    no selection points, as the method is fitted to them as to control, and yet shows their figures;
    points go together with lines.

    Raises
    ------
    TermselError
        As `request_of`.
    """
    options = {"check_as": "judge", **(options or {})}
    if registry().taken("problems", problem).control == "lines":
        options["mixed"] = True
    request = request_of(problem, **{
        **arguments, "criterion": "press", "solver": AllTerms, "options": options})
    if request.recipe.search_first and request.features.without_height():
        # The model of the search is not asked for, so that it asks for no heights.
        request = replace(request, model=registry().get("models", "poly2d")())
    return with_shares(request, auto=True)


def task_of_method(request: Request, auto: Auto) -> Task:
    """Return the task of a method: features in their roles, and the part of an image an RPC is of.

    Parameters
    ----------
    request : Request
        As `request_of_method` returns it.
    auto : Auto
        The choice among the methods that are to be fitted.

    Raises
    ------
    TermselError
        If the features are too few, or their heights not those of the RPC.
    """
    fewest = fewest_features(request.features, auto)
    observations = observe(request, fewest)
    # The image may be a part, or a coarser copy, of that of its RPC, as control tells; roles are
    # assigned again then, as the RPC has moved.
    image_part = part_of_rpc(observations.together)
    if image_part is not None:
        request = with_part(request, image_part)
        observations = observe(request, fewest)
    return Task(request, with_polar(observations))


def fewest_features(features: FeatureSet, auto: Auto) -> int:
    """Return the fewest features to choose by: one where something is known of the image."""
    if features.rpc is not None:
        return 1
    # Independent points must not decide whether the others are enough.
    in_use = np.array([role not in ("independent", "off") for role in features.points.roles]
                      + [True] * len(features.lines.features), dtype=bool)
    if not 0 < in_use.sum() < LEAST:
        return LEAST
    return min(LEAST, auto.fewest(FitData.of(features.take(in_use))))


def require_alone(method: object, words: list[str]) -> None:
    """Refuse a method next to what is asked for of a search, in words."""
    if method is not None and words:
        raise TermselError(f"a method is asked for, and {words[0]}", hint="Leave one of them out.")
