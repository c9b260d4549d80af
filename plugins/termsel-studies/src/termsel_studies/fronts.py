"""Fronts of several objectives compared: hypervolume and IGD+."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.toolkit import FloatArray
from termsel_studies.groups import Groups

BEYOND = 1.1
"""Where the reference point lies: as far from the best values as the worst, and a tenth more."""


@dataclass(frozen=True)
class FrontFigures:
    """Figures of the fronts of one method on one instance.

    Medians over the runs, of objectives scaled to 0..1 by the reference front.
    """

    instance: str
    method: str
    hypervolume: float
    igd_plus: float
    reference: str  # "proven", or "all runs": the front that they are measured against


def front_figures(groups: Groups) -> list[FrontFigures]:
    """Return the figures of all fronts of a study.

    A proven front is the reference where there is one; else the non-dominated members of all runs.
    """
    found = []
    for instance, by_method in groups.instances.items():
        fronts = {method: [np.array(one.front, dtype=float) for one in runs.records
                           if one.front] for method, runs in by_method.items()}
        fronts = {method: several for method, several in fronts.items() if several}
        widths = {front.shape[1] for several in fronts.values() for front in several}
        if len(fronts) < 2 or len(widths) != 1:  # nothing to compare, or different objectives
            continue
        exact = [np.array(record.front, dtype=float) for method in fronts
                 for row, record in zip(by_method[method].rows, by_method[method].records,
                                        strict=True) if row.get("proven") and record.front]
        known = exact or [front for several in fronts.values() for front in several]
        reference = non_dominated(np.vstack(known))
        for method, several in fronts.items():
            figures = np.array([indicators(front, reference) for front in several])
            volume, distance = np.median(figures, axis=0)
            found.append(FrontFigures(instance, method, float(volume), float(distance),
                                      "proven" if exact else "all runs"))
    return found


def non_dominated(points: FloatArray) -> FloatArray:
    """Return the points (n, objectives) that no other one dominates, each once; lower is better."""
    points = np.unique(points, axis=0)
    better = (points[:, None] <= points[None]).all(axis=2) & (points[:, None] != points[None]
                                                              ).any(axis=2)
    return np.asarray(points[~better.any(axis=0)])


def indicators(front: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return hypervolume and IGD+ of a front (n, objectives), scaled by a reference front.

    Lower is better. The reference spans 0 to 1 in each objective; the reference point of the
    hypervolume is `BEYOND`.
    """
    from pymoo.indicators.hv import HV
    from pymoo.indicators.igd_plus import IGDPlus

    # As pymoo computes them: Zitzler and Thiele 1998, PPSN V; Ishibuchi, Masuda, Tanigaki and
    # Nojima 2015, EMO, equation 18.
    low = reference.min(axis=0)
    span = np.ptp(reference, axis=0)
    span[span == 0] = 1.0
    scaled = (front - low) / span
    target = (reference - low) / span
    corner = np.full(front.shape[1], BEYOND)
    return float(HV(ref_point=corner)(scaled)), float(IGDPlus(target)(scaled))
