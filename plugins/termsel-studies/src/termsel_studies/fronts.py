"""Fronts of several objectives compared: hypervolume and IGD+."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

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
    # Which front the figures are measured against: "proven", or that of "all runs" together.
    reference: str


def front_figures(groups: Groups) -> list[FrontFigures]:
    """Return the figures of each method with fronts on each instance, instance by instance.

    They are measured against the proven front of the instance, or, where none is proven, against
    the non-dominated members of all runs. Instances have no figures if fewer than two methods have
    fronts there, or if fronts differ in their number of objectives.
    """
    figures_of_fronts = []
    for instance, by_method in groups.instances.items():
        fronts = {}
        for method, runs in by_method.items():
            fronts_of_runs = [np.array(record.front, dtype=float) for record in runs.records
                              if record.front]
            if fronts_of_runs:
                fronts[method] = fronts_of_runs
        all_fronts = list(chain.from_iterable(fronts.values()))
        # Fronts of different numbers of objectives cannot be compared.
        if len(fronts) < 2 or len({front.shape[1] for front in all_fronts}) != 1:
            continue
        proven_fronts = []
        for method in fronts:
            runs = by_method[method]
            proven_fronts += [np.array(record.front, dtype=float)
                              for row, record in zip(runs.rows, runs.records, strict=True)
                              if row.get("proven") and record.front]
        reference = non_dominated(np.vstack(proven_fronts or all_fronts))
        for method, fronts_of_runs in fronts.items():
            figures = np.array([front_indicators(front, reference) for front in fronts_of_runs])
            volume, distance = np.median(figures, axis=0)
            figures_of_fronts.append(FrontFigures(instance, method, float(volume), float(distance),
                                                  "proven" if proven_fronts else "all runs"))
    return figures_of_fronts


def non_dominated(points: FloatArray) -> FloatArray:
    """Return which of the points (n, objectives) no other one dominates; lower is better.

    They come sorted by their first objective, each once, shape (m, objectives).
    """
    points = np.unique(points, axis=0)
    # Row i, column j: point i is at most as large as j in all objectives, and differs in one.
    better = (points[:, None] <= points[None]).all(axis=2) & (points[:, None] != points[None]).any(
        axis=2
    )
    return np.asarray(points[~better.any(axis=0)])


def front_indicators(front: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return hypervolume and IGD+ of a front (n, objectives) against a reference front.

    Objectives are minimised. Each is scaled so that the reference front spans 0 to 1; the reference
    point of the hypervolume is at `BEYOND` in each. A better front has a larger hypervolume and a
    smaller IGD+, which is 0 for the reference itself.
    """
    from pymoo.indicators.hv import HV
    from pymoo.indicators.igd_plus import IGDPlus

    # As pymoo computes them: Zitzler and Thiele 1998, PPSN V; Ishibuchi, Masuda, Tanigaki and
    # Nojima 2015, EMO, equation 18.
    low = reference.min(axis=0)
    span = np.ptp(reference, axis=0)
    # An objective with one value all over the reference has no span, and keeps its unit.
    span[span == 0] = 1.0
    scaled = (front - low) / span
    target = (reference - low) / span
    corner = np.full(front.shape[1], BEYOND)
    return float(HV(ref_point=corner)(scaled)), float(IGDPlus(target)(scaled))
