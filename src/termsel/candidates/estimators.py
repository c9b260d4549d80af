"""All estimators by their names in the record of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from termsel.candidates.local import Interpolated
from termsel.candidates.ridge import RidgeByOrder
from termsel.candidates.robust import Reweighted
from termsel.candidates.selected import ForwardSelection
from termsel.candidates.shrunken import Averaging
from termsel.errors import TermselError, unknown_name
from termsel.fits.fit import Estimator, Given
from termsel.fits.least_squares import LeastSquares

ESTIMATORS: dict[str, type[Estimator]] = {one.name: one for one in (
    LeastSquares, RidgeByOrder, ForwardSelection, Averaging, Interpolated, Reweighted, Given)}


def estimator_named(name: str, options: Mapping[str, Any]) -> Estimator:
    """Return the estimator of a name, made with options as `Estimator.options` gives them.

    Refuses a name that none has, and options that it does not take.
    """
    if name not in ESTIMATORS:
        raise unknown_name("estimator", name, ESTIMATORS)
    try:
        return ESTIMATORS[name](**options)
    except TypeError as error:
        raise TermselError(f"the estimator {name} cannot be made with the options {dict(options)}",
                           hint="Run the search again.") from error
