"""Fits without any search, beside which every selection is shown and judged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.candidates.portfolio import SELECTED, SHRUNK, Choice, choose
from termsel.candidates.ridge import shrunken_coefficients
from termsel.fits.figures import BOTH, Baseline, baseline
from termsel.fits.fit import Fit, fit
from termsel.measurements.features import FeatureSet
from termsel.measurements.roles import Observations, together
from termsel.measurements.scaling import scaling_of
from termsel.models.rational import RationalFunctions

PLAIN = {"affine": 8, "dlt": 11, "quadratic": 20, "cubic": 40, "rfm-2": 38, "rfm-3": 78,
         "ridge": 78}
FLAT = {"affine": 6, "projective": 8, "quadratic": 12, "cubic": 20}
"""Names and numbers of terms with heights, and without."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a selection is compared with.

    Parameters
    ----------
    baselines : tuple of Baseline
        Each fitted to control and check together.
    reference : str
        Name of the one that leave-one-out over control and check chooses, without a look at
        the independent points; empty if none is determined.
    choice : Choice or None
        That choice.
    """

    baselines: tuple[Baseline, ...]
    reference: str
    choice: Choice | None


def compare(observations: Observations) -> Comparison:
    """Return plain structures fitted to control and check together.

    No search is made with the check points there, so they are free to serve as control.

    Parameters
    ----------
    observations : Observations
    """
    both, heights = together(observations), has_heights(observations)
    choice = choose(both, heights)
    found: dict[str, tuple[Fit, float | None]] = {}
    if heights:
        found |= {name: (fitted, None) for name, fitted in _rational(both)}
    if choice:
        found |= {one.name: (one.fit, one.predicted) for one in choice.fitted}
    baselines = []
    for name, n_terms in (PLAIN if heights else FLAT).items():
        if name in found:
            baselines.append(baseline(name, *found[name], observations))
        else:
            baselines.append(Baseline(name, n_terms, BOTH, False, dict.fromkeys(
                ("control", "check", "independent"))))
    for name in (SELECTED, *SHRUNK.values()):
        if name in found:
            baselines.append(baseline(name, *found[name], observations))
    return Comparison(tuple(baselines), choice.chosen.name if choice else "", choice)


def _rational(both: FeatureSet) -> Iterator[tuple[str, Fit]]:
    """Yield the full RFM and its ridge estimate (see `shrunken_coefficients`).

    The second-order one is among the candidates; one with a pole, which is not, is fitted here
    as well, as its figures are worth seeing.
    """
    scaling = scaling_of(both)
    for name, order in (("rfm-2", 2), ("rfm-3", 3)):
        fitted = fit(RationalFunctions(order=order), both, scaling)
        if fitted.adjustment.feasible and fitted.adjustment.redundancy > 0:
            yield name, fitted
    model = RationalFunctions()
    everything = fit(model, both, scaling)
    yield "ridge", everything.with_coefficients(shrunken_coefficients(
        model, scaling.features(both), everything.terms, everything.used))


def has_heights(observations: Observations) -> bool:
    """Return whether all features have heights, and they are not those of a plane.

    Of independent points only whether they have heights is looked at.
    """
    both = together(observations)
    if both.without_height() or np.isnan(observations.independent.ground[:, 2]).any():
        return False
    scaled = scaling_of(both).ground(both.ground_vertices())
    plane = np.column_stack([np.ones(len(scaled)), scaled[:, :2]])
    rest = scaled[:, 2] - plane @ np.linalg.lstsq(plane, scaled[:, 2])[0]
    return bool(np.abs(rest).max() > TOLERANCE)
