"""Genetic algorithm whose first population follows the correlations of the design matrix."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from deap import base

from termsel import Bits, GeneticAlgorithm, Option, Problem, TermselError
from termsel.toolkit.searches import unit_deviations
from termsel_optimisers.arrays import BoolArray, FloatArray

PRESETS = {"case-1": (1.19, 0.15), "case-2": (1.69, 0.0), "case-3": (1.0, 0.0)}
"""Scale and offset of the cases of Akhoundi Khezrabad et al. 2020, table 3."""

_ROUNDING = 1e-9


def correlation_sums(design: FloatArray) -> FloatArray:
    """Return the sum of the absolute correlations of each column with all columns, shape (g,).

    It is that of Akhoundi Khezrabad et al. 2020, eq. 3 and the last line of eq. 4. `design` (m, g)
    has a row for each equation and a column for each gene. Sums are at least 1, the correlation of
    a column with itself. A constant column has the least sum of the others, a column of zeros the
    largest.
    """
    unit = unit_deviations(design)
    varies = unit.any(axis=0)
    sums = np.ones(design.shape[1])
    if varies.any():
        # sum_j |u_i'u_j|, with columns u less their means, at unit length.
        sums[varies] = np.abs(unit[:, varies].T @ unit[:, varies]).sum(axis=0)
        # The correlation of a constant is undefined. Every model needs one, so that it counts as
        # the least correlated.
        sums[~varies] = sums[varies].min()
    # The term of a column of zeros cannot be determined.
    sums[~design.any(axis=0)] = sums.max()
    return sums


def activation_probabilities(sums: FloatArray, scale: float, offset: float) -> FloatArray:
    """Return the probability (g,) of each gene to be on: P = S (1 - sum / max(sum)) + O.

    It is that of Akhoundi Khezrabad et al. 2020, eq. 4, with the sums of `correlation_sums`, scale
    S and offset O. Raises TermselError, which names permitted values, if one exceeds 1.
    """
    # 0 for the most correlated gene.
    independence = 1.0 - sums / sums.max()
    probability = scale * independence + offset
    if probability.max() > 1.0 + _ROUNDING:
        most_independent = float(independence.max())
        # Rounded down, so that the printed value is accepted.
        largest = np.floor((1.0 - offset) / most_independent * 1e3) / 1e3
        largest_offset = 1.0 - scale * most_independent
        allowed = f"These data allow a scale of up to {largest:g} with offset {offset:g}"
        if largest_offset >= 0:
            rounded_offset = np.floor(largest_offset * 1e3) / 1e3
            allowed += f", or an offset of up to {rounded_offset:g} with scale {scale:g}"
        raise TermselError(
            f"with scale {scale:g} and offset {offset:g} a gene has the probability "
            f"{probability.max():.3f}, which exceeds 1",
            hint=f"{allowed}. Use --set preset=own --set scale={largest:g} "
                 f"--set offset={offset:g}.")
    return np.asarray(np.clip(probability, 0.0, 1.0))


def seed_population(probability: FloatArray, n: int, rng: np.random.Generator) -> BoolArray:
    """Return n chromosomes (n, g) in which gene i is on exactly round(P_i n) times, at random."""
    # The first round(P_i n) rows of column i are on; then each column is put in a random order.
    is_on = np.arange(n)[:, None] < np.rint(probability * n)
    return rng.permuted(is_on, axis=0)


class CorrelationSeededGA(GeneticAlgorithm):
    """GA that begins with the terms least correlated with others.

    Akhoundi Khezrabad et al. 2020: the first population switches each gene on with the
    probability of eq. 4, from the correlations of eq. 3; all else is the `ga`. The columns are
    those of the joint matrix of line and sample over all control, as in the paper; forced
    genes and bounds on their number are kept by repairing the chromosomes afterwards.

    The presets of scale and offset are the paper's cases. They were fitted to its matrix, where
    the probabilities are 0.15 to 0.85, 0 to 1 and 0 to 0.59; with other data they differ, and
    are refused if they exceed 1. Case 3 cannot exceed 1 and is the paper's fastest, so it is the
    default. With it the paper saves 37 per cent of the time, and its RMSE at independent points
    grows by 45 per cent. The simulated scene of that place shows neither: generations and
    independent RMSE are as with `ga`. With 100 chromosomes and the paper's mutation of 0.001
    terms are lost for good. Of 30 runs 4 of case 3 fail then, and 2 of `ga`; in the paper's
    tables 4 and 7 both are worst with 100 as well.
    """

    name = "ga-correlation"
    departures: ClassVar[tuple[str, ...]] = (
        *GeneticAlgorithm.departures[:-1],
        "The columns are those of all control; forced genes and numbers of genes are kept.")
    segments = (Bits,)
    declared_options = (
        *(option for option in GeneticAlgorithm.declared_options if option.name != "first"),
        Option("preset", "case-3", "Scale and offset: own, or a case of Akhoundi Khezrabad et al. "
                                   "2020, table 3 (1.19 and 0.15, 1.69 and 0, 1 and 0).",
               choices=(*PRESETS, "own")),
        Option("scale", None, "S of eq. 4, with preset=own.", float, 0.0, 1e6),
        Option("offset", None, "O of eq. 4, the least probability, with preset=own.", float,
               0.0, 1.0),
    )

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # Scale and offset are those of the preset, or the user's own, never a mixture.
        stated = [name for name in ("scale", "offset") if self.options[name] is not None]
        own_preset = self.options["preset"] == "own"
        if own_preset and len(stated) < 2:
            raise TermselError("preset=own requires scale and offset",
                               hint="For example --set preset=own --set scale=1 --set offset=0.")
        if stated and not own_preset:
            raise TermselError(f"option {stated[0]!r} requires preset=own, but the preset is "
                               f"{self.options['preset']}", hint="Add --set preset=own.",
                               name=stated[0])

    def toolbox(self, problem: Problem, rng: np.random.Generator) -> base.Toolbox:
        """Return the toolbox of the GA, with a first population drawn by correlations.

        A gene is on with the probability of Akhoundi Khezrabad et al. 2020, eq. 4: the more its
        column is correlated with others, the lower. Chromosomes that break a rule of the genome are
        repaired. Raises TermselError if a probability exceeds 1.
        """
        o = self.options
        box = super().toolbox(problem, rng)
        scale, offset = PRESETS.get(o["preset"], (o["scale"], o["offset"]))
        # One probability for each column of the design, that is for each gene.
        probability = activation_probabilities(correlation_sums(problem.design()), scale, offset)
        size = self.population_size(problem)

        def population() -> BoolArray:
            return problem.genome.repair(seed_population(probability, size, rng), rng)

        box.register("population", population)
        return box
