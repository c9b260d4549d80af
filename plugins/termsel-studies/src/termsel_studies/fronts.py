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
    # "proven", or "all runs": the front that they are measured against.
    reference: str


def front_figures(groups: Groups) -> list[FrontFigures]:
    """Return the figures of all fronts of a study.

    A proven front is the reference where there is one; else the non-dominated members of all runs.
    """
    figures_of_fronts = []
    for instance, by_method in groups.instances.items():
        fronts = {}
        for method, runs in by_method.items():
            several = [np.array(record.front, dtype=float) for record in runs.records
                       if record.front]
            if several:
                fronts[method] = several
        all_fronts = list(chain.from_iterable(fronts.values()))
        # With one method there is nothing to compare, and other objectives cannot be.
        if len(fronts) < 2 or len({front.shape[1] for front in all_fronts}) != 1:
            continue
        exact = []
        for method in fronts:
            runs = by_method[method]
            exact += [np.array(record.front, dtype=float)
                      for row, record in zip(runs.rows, runs.records, strict=True)
                      if row.get("proven") and record.front]
        reference = non_dominated(np.vstack(exact or all_fronts))
        for method, several in fronts.items():
            figures = np.array([front_indicators(front, reference) for front in several])
            volume, distance = np.median(figures, axis=0)
            figures_of_fronts.append(FrontFigures(instance, method, float(volume), float(distance),
                                                  "proven" if exact else "all runs"))
    return figures_of_fronts


def non_dominated(points: FloatArray) -> FloatArray:
    """Return the points (n, objectives) that none dominates, each once and sorted; lower is better.
    """
    points = np.unique(points, axis=0)
    # Another point is at most as large in all objectives, and smaller in one.
    better = (points[:, None] <= points[None]).all(axis=2) & (points[:, None] != points[None]).any(
        axis=2
    )
    return np.asarray(points[~better.any(axis=0)])


def front_indicators(front: FloatArray, reference: FloatArray) -> tuple[float, float]:
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
    # An objective that is the same all over the reference is not scaled.
    span[span == 0] = 1.0
    scaled = (front - low) / span
    target = (reference - low) / span
    corner = np.full(front.shape[1], BEYOND)
    return float(HV(ref_point=corner)(scaled)), float(IGDPlus(target)(scaled))
