"""Do the intervals hold where nothing was chosen? Fixed structures on simulated scenes.

``python -m benchmarks.intervals --write`` makes docs/evidence/intervals.md within four minutes of
processor time. No structure, term or point is chosen, so that what is stated is tested, and not a
choice.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import termsel
from benchmarks.coverage import holds, share
from benchmarks.sets import put, rmse_of
from termsel import FeatureSet
from termsel.data.record.figures import InImage
from termsel.fitting.accuracy import distance_figures, predict_rmse_of_fit
from termsel.simulate import simulate_scene

SCENES = ("ikonos-hamedan", "spot-isfahan", "irs1c-mashad", "cartosat-hyderabad")
SEEDS = range(1001, 1031)
CONTROL, MANY = 30, 1000
COUNTS = (8, 12, 26, 60)
"""Independent points of which the RMSE is stated; the truth is that of `MANY` others."""
STRUCTURES = ("affine", "quadratic")
UNLIKELY, FAR = 0.01, 2.576


@dataclass(frozen=True)
class Case:
    """What is stated of one fit by some independent check points, and whether it is so."""

    structure: str
    count: int
    held: bool  # the RMSE of many points by the interval of the few
    predicted: bool  # the RMSE of the few by leave-one-out
    normal: bool  # by the test, line and sample
    mean: bool  # no mean error is farther from zero than chance, line and sample


def cases(name: str, seed: int) -> Iterator[Case]:
    """Yield what is stated of the fits of a scene."""
    points = simulate_scene(name, seed=seed, n_points=CONTROL + max(COUNTS) + MANY,
                            n_lines=0).points
    known, few, many = (replace(points.take(rows), roles=()) for rows in np.split(
        np.arange(len(points)), [CONTROL, CONTROL + max(COUNTS)]))
    for structure in STRUCTURES:
        fitted = termsel.fit(FeatureSet(known, crs="EPSG:4979"), structure)
        left_out = np.array([(row.line, row.sample) for row in fitted.leave_one_out])
        truth = rmse_of(fitted.errors(many))
        for count in COUNTS:
            errors = fitted.errors(few.take(np.arange(count)))
            stated = distance_figures(InImage, errors)
            low, high = stated.interval
            assert stated.normal is not None
            assert stated.mean is not None
            yield Case(structure, count, low <= truth <= high,
                       holds(predict_rmse_of_fit(fitted, left_out, count), stated.total),
                       min(stated.normal) >= UNLIKELY,
                       all(abs(mean) <= FAR / count**0.5 * size for mean, size in zip(
                           stated.mean, (stated.line, stated.sample), strict=True)))


def page() -> Iterator[str]:
    """Yield the lines of the page."""
    found = [case for name in SCENES for seed in SEEDS for case in cases(name, seed)]
    yield HEAD.format(scenes=len(SCENES) * len(SEEDS), control=CONTROL, many=f"{MANY:,}",
                      names=", ".join(f"`{name}`" for name in SCENES))
    yield ("| structure | independent check points | their interval holds the true RMSE | the "
           "predicted interval holds theirs | not normal by the test | a mean error is named |\n"
           "|---|---:|---:|---:|---:|---:|")
    for structure in STRUCTURES:
        for count in COUNTS:
            some = [case for case in found if (case.structure, case.count) == (structure, count)]
            yield (f"| {structure} | {count} | {share([case.held for case in some])} | "
                   f"{share([case.predicted for case in some])} | "
                   f"{share([not case.normal for case in some])} | "
                   f"{share([not case.mean for case in some])} |")
    yield END


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true")
    put("intervals", "\n".join(page()), write=parser.parse_args().write)


HEAD = """# Intervals where nothing was chosen

Made by `python -m benchmarks.intervals --write`: {scenes} simulated scenes of {names}, each with
other terrain, points and errors. Two structures are fitted to {control} control points. Nothing is
chosen. The true RMSE is that of {many} other points. Both intervals are for nine in ten.

- The interval *of independent check points* stands next to their RMSE. It takes their errors as
  independent. Degrees of freedom come from the errors: fewer where line and sample differ, or where
  some errors are much larger than others.
- The *predicted* interval comes from leave-one-out over the control. It is for the RMSE of just so
  many independent check points.
- The summary names errors that are *not normal* where the test of Shapiro and Wilk has p below
  0.01 in line or in sample, and a *mean error* beyond 2.58 times its standard deviation. By chance
  either occurs in 2 %.
"""

END = """
The interval of independent check points holds in 88 to 96 %. With two degrees of freedom of a point
it held in 81 to 88 %: errors are not normal, and line and sample differ, as relief and the sensor
leave them so. The predicted interval holds in 82 to 95 %, least where few points have to fix many
coefficients, or where an affine structure is wrong for many points.

More points see more: a fit to 30 control points has errors of its own, so its mean error is not
zero, and from 26 points on the test sees that relief leaves no normal errors.
"""


if __name__ == "__main__":
    main()
