"""All estimators by their names in the record of a run."""

from __future__ import annotations

from typing import Any

from termsel.auto.physical import Physical, PinholeCamera
from termsel.auto.robust import Reweighted
from termsel.auto.selected import ForwardSelection
from termsel.auto.shrunken import Averaging, Interpolated, RidgeByOrder
from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, unknown_name_error
from termsel.fitting.fit import Estimator, FixedCoefficients
from termsel.fitting.least_squares import LeastSquares

ESTIMATORS: dict[str, type[Estimator]] = {one.name: one for one in (
    LeastSquares, RidgeByOrder, ForwardSelection, Averaging, Physical, Interpolated, Reweighted,
    PinholeCamera, FixedCoefficients)}


@explains_arguments()
def estimator(name: str, /, **options: Any) -> Estimator:
    """Return a built-in estimator.

    Parameters
    ----------
    name : str
        As records have it: least-squares, ridge-by-order, forward-selection, averaging,
        interpolated, reweighted, pinhole or given.
    **options
        As `Estimator.options` gives them.

    Returns
    -------
    Estimator
        With its options.

    Raises
    ------
    TermselError
        For a name that none has, or options that it does not take.

    Examples
    --------
    >>> import termsel
    >>> termsel.estimator("reweighted", biweight=True).options
    {'biweight': True}
    """
    if name not in ESTIMATORS:
        raise unknown_name_error("estimator", name, ESTIMATORS)
    try:
        return ESTIMATORS[name](**options)
    except TypeError as error:
        raise TermselError(f"the estimator {name} cannot be made with the options {options}",
                           hint="Copy the whole folder again, or repeat the run.") from error
