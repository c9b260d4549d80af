"""What termsel itself provides, through the hooks any plugin uses.

Each hook imports what it returns, so that listing solvers does not load the models.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel.plugins.hookspecs import hookimpl

if TYPE_CHECKING:
    from termsel.data.datasets import DatasetSpec
    from termsel.data.roles import Split
    from termsel.fitting.method import Method
    from termsel.formats.base import Reader, Writer
    from termsel.models import SensorModel
    from termsel.selection.criteria import Criterion
    from termsel.selection.problems.objectives import Objective
    from termsel.selection.problems.recipes import Recipe
    from termsel.selection.solvers import Solver


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the built-in sensor models."""
    from termsel.models.interpolating import Field, Field3D, ThinPlate
    from termsel.models.polynomial import Affine, Helmert2D, Polynomial2D, Polynomial3D
    from termsel.models.projective import DLT2D, DLT3D, Projective2D
    from termsel.models.quotient import RationalFunctions

    return [RationalFunctions, Polynomial2D, Polynomial3D, Affine, Projective2D, DLT2D, DLT3D,
            Helmert2D, ThinPlate, Field, Field3D]


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the built-in problems."""
    from termsel.selection.problems.recipes import RECIPES

    return RECIPES


@hookimpl
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return the built-in criteria."""
    from termsel.selection.criteria import CheckRmse, Ebic, Huber, KFold, Median, Press

    return [CheckRmse, Press, KFold, Ebic, Median, Huber]


@hookimpl
def termsel_objectives() -> Iterable[Objective]:
    """Return the built-in objectives."""
    from termsel.selection.problems.objectives import OBJECTIVES

    return OBJECTIVES


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the built-in solvers."""
    from termsel.selection.solvers.bridges.pareto import Nsga2
    from termsel.selection.solvers.genetic.fast import FastMutation
    from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
    from termsel.selection.solvers.genetic.ga_steady import SteadyStateGA
    from termsel.selection.solvers.heuristics.ica import ImperialistCompetition
    from termsel.selection.solvers.heuristics.pso import BinarySwarm
    from termsel.selection.solvers.heuristics.swap import Swap
    from termsel.selection.solvers.heuristics.yardsticks import AllTerms, RandomSearch
    from termsel.selection.solvers.proofs.exact import Exact
    from termsel.selection.solvers.regression.ridge import Ridge

    return [GeneticAlgorithm, FastMutation, SteadyStateGA, ImperialistCompetition, BinarySwarm,
            Nsga2, Exact, Swap, RandomSearch, AllTerms, Ridge]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the built-in methods that need no search."""
    from termsel.auto.methods import METHODS

    return METHODS


@hookimpl
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return the embedded data sets."""
    from termsel.simulate.scenes import DATASETS, FURTHER

    return [*DATASETS, *FURTHER]


@hookimpl
def termsel_splits() -> Iterable[Split]:
    """Return the built-in splits."""
    from termsel.data.roles import SPLITS

    return SPLITS


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return the built-in readers."""
    from termsel.formats.readers.areas_table import AreasCsv
    from termsel.formats.readers.csv_tables import LinesCsv, PointsCsv
    from termsel.formats.readers.geojson_points import GeoJsonPoints, VectorPoints
    from termsel.formats.readers.ground_lines import GeoJsonLines, VectorLines
    from termsel.formats.readers.json_records import PointsJson
    from termsel.formats.readers.qgis_points import QgisPoints

    # A table of corners has all columns of points, so it is asked for first.
    return [AreasCsv, PointsCsv, LinesCsv, QgisPoints, GeoJsonPoints, GeoJsonLines,
            VectorPoints, VectorLines, PointsJson]


@hookimpl
def termsel_writers() -> Iterable[type[Writer]]:
    """Return the built-in writers."""
    from termsel.formats.writers.grids import GcpGridVrt, GeolocationVrt
    from termsel.formats.writers.rpcs import Rpb, RpcTxt, RpcVrt
    from termsel.formats.writers.selections import GcpVrt, LinesTable, PointsTable, QgisPointsWriter

    return [Rpb, RpcTxt, RpcVrt, GcpGridVrt, GeolocationVrt, QgisPointsWriter, GcpVrt,
            PointsTable, LinesTable]
