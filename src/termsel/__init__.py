"""Select sensor-model terms and ground control features for georeferencing images.

The names below are the public API. They are imported when first used, so that importing
termsel, and answering ``termsel --help``, costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module

from termsel.version import __version__

TYPE_CHECKING = False  # see termsel.interrupts
if TYPE_CHECKING:
    from typing import Any

    from termsel.adjustment import Equations, image_equations, line_normals, row_weights
    from termsel.criteria import Criterion, Fits
    from termsel.errors import TermselError
    from termsel.files.rasters import open_raster
    from termsel.files.remote import allow_remote
    from termsel.fits.accuracy import ce90
    from termsel.fits.fit import Fit
    from termsel.formats.base import Reader, Writer
    from termsel.formats.heights import open_dem
    from termsel.formats.readers.csv_tables import write_lines_csv, write_points_csv
    from termsel.formats.rpc_files import read_rpc, write_rpc
    from termsel.io.export import export
    from termsel.io.read import read
    from termsel.io.rectify import rectify
    from termsel.io.result_folder import read_result
    from termsel.measurements.datasets import DatasetSpec
    from termsel.measurements.features import FeatureSet, Lines, Points
    from termsel.measurements.scaling import Scaling
    from termsel.models import (
        DLT2D,
        DLT3D,
        Affine,
        Blocks,
        Field,
        Field3D,
        Helmert2D,
        Polynomial2D,
        Polynomial3D,
        Projective2D,
        RationalFunctions,
        RationalModel,
        SensorModel,
        Term,
        ThinPlate,
    )
    from termsel.models.rpc import Rpc
    from termsel.models.rpc_fit import rpc_of
    from termsel.options import Option
    from termsel.plugins.hookspecs import hookimpl
    from termsel.plugins.session import register
    from termsel.problems.base import Evaluation, Inputs, Problem, Selection
    from termsel.problems.coverage import uncovered_share
    from termsel.problems.genome import Genome
    from termsel.problems.objectives import Objective, PopulationSelection
    from termsel.problems.parameters import ParameterProblem
    from termsel.problems.recipes import Recipe, feature_options, term_options
    from termsel.problems.segments import (
        Bits,
        Categories,
        Integers,
        Permutation,
        Reals,
        Segment,
        Subset,
    )
    from termsel.problems.selection import SelectionProblem
    from termsel.results.result import Result
    from termsel.runs.fit import fit
    from termsel.runs.judgement.assess import assess
    from termsel.runs.run import run
    from termsel.runs.task.task import Task, prepare
    from termsel.simulate import simulate_scene
    from termsel.solvers import Generation, Solver
    from termsel.solvers.bridges.deap_algorithms import from_deap
    from termsel.solvers.bridges.deap_toolbox import to_deap
    from termsel.solvers.bridges.pymoo_algorithms import from_pymoo
    from termsel.solvers.bridges.pymoo_problem import to_pymoo
    from termsel.solvers.search import Search, search
    from termsel.studies.cells.folder import read_study
    from termsel.studies.compare import compare
    from termsel.studies.study import Study

_HOME = {
    "Affine": "termsel.models",
    "Bits": "termsel.problems.segments",
    "Blocks": "termsel.models",
    "Categories": "termsel.problems.segments",
    "Criterion": "termsel.criteria",
    "DLT2D": "termsel.models",
    "DLT3D": "termsel.models",
    "DatasetSpec": "termsel.measurements.datasets",
    "Equations": "termsel.adjustment",
    "Evaluation": "termsel.problems.base",
    "FeatureSet": "termsel.measurements.features",
    "Field": "termsel.models",
    "Field3D": "termsel.models",
    "Fit": "termsel.fits.fit",
    "Fits": "termsel.criteria",
    "Generation": "termsel.solvers",
    "Genome": "termsel.problems.genome",
    "Helmert2D": "termsel.models",
    "Inputs": "termsel.problems.base",
    "Integers": "termsel.problems.segments",
    "Lines": "termsel.measurements.features",
    "Objective": "termsel.problems.objectives",
    "Option": "termsel.options",
    "ParameterProblem": "termsel.problems.parameters",
    "Permutation": "termsel.problems.segments",
    "Points": "termsel.measurements.features",
    "Polynomial2D": "termsel.models",
    "Polynomial3D": "termsel.models",
    "PopulationSelection": "termsel.problems.objectives",
    "Problem": "termsel.problems.base",
    "Projective2D": "termsel.models",
    "RationalFunctions": "termsel.models",
    "RationalModel": "termsel.models",
    "Reader": "termsel.formats.base",
    "Reals": "termsel.problems.segments",
    "Recipe": "termsel.problems.recipes",
    "Result": "termsel.results.result",
    "Rpc": "termsel.models.rpc",
    "Scaling": "termsel.measurements.scaling",
    "Search": "termsel.solvers.search",
    "Segment": "termsel.problems.segments",
    "Selection": "termsel.problems.base",
    "SelectionProblem": "termsel.problems.selection",
    "SensorModel": "termsel.models",
    "Solver": "termsel.solvers",
    "Study": "termsel.studies.study",
    "Subset": "termsel.problems.segments",
    "Task": "termsel.runs.task.task",
    "Term": "termsel.models",
    "TermselError": "termsel.errors",
    "ThinPlate": "termsel.models",
    "Writer": "termsel.formats.base",
    "allow_remote": "termsel.files.remote",
    "assess": "termsel.runs.judgement.assess",
    "ce90": "termsel.fits.accuracy",
    "compare": "termsel.studies.compare",
    "export": "termsel.io.export",
    "feature_options": "termsel.problems.recipes",
    "fit": "termsel.runs.fit",
    "from_deap": "termsel.solvers.bridges.deap_algorithms",
    "from_pymoo": "termsel.solvers.bridges.pymoo_algorithms",
    "hookimpl": "termsel.plugins.hookspecs",
    "image_equations": "termsel.adjustment",
    "line_normals": "termsel.adjustment",
    "open_dem": "termsel.formats.heights",
    "open_raster": "termsel.files.rasters",
    "prepare": "termsel.runs.task.task",
    "read": "termsel.io.read",
    "read_result": "termsel.io.result_folder",
    "read_rpc": "termsel.formats.rpc_files",
    "read_study": "termsel.studies.cells.folder",
    "rectify": "termsel.io.rectify",
    "register": "termsel.plugins.session",
    "row_weights": "termsel.adjustment",
    "rpc_of": "termsel.models.rpc_fit",
    "run": "termsel.runs.run",
    "search": "termsel.solvers.search",
    "simulate_scene": "termsel.simulate",
    "term_options": "termsel.problems.recipes",
    "uncovered_share": "termsel.problems.coverage",
    "to_deap": "termsel.solvers.bridges.deap_toolbox",
    "to_pymoo": "termsel.solvers.bridges.pymoo_problem",
    "write_lines_csv": "termsel.formats.readers.csv_tables",
    "write_points_csv": "termsel.formats.readers.csv_tables",
    "write_rpc": "termsel.formats.rpc_files",
}

__all__ = [
    "DLT2D",
    "DLT3D",
    "Affine",
    "Bits",
    "Blocks",
    "Categories",
    "Criterion",
    "DatasetSpec",
    "Equations",
    "Evaluation",
    "FeatureSet",
    "Field",
    "Field3D",
    "Fit",
    "Fits",
    "Generation",
    "Genome",
    "Helmert2D",
    "Inputs",
    "Integers",
    "Lines",
    "Objective",
    "Option",
    "ParameterProblem",
    "Permutation",
    "Points",
    "Polynomial2D",
    "Polynomial3D",
    "PopulationSelection",
    "Problem",
    "Projective2D",
    "RationalFunctions",
    "RationalModel",
    "Reader",
    "Reals",
    "Recipe",
    "Result",
    "Rpc",
    "Scaling",
    "Search",
    "Segment",
    "Selection",
    "SelectionProblem",
    "SensorModel",
    "Solver",
    "Study",
    "Subset",
    "Task",
    "Term",
    "TermselError",
    "ThinPlate",
    "Writer",
    "__version__",
    "allow_remote",
    "assess",
    "ce90",
    "compare",
    "export",
    "feature_options",
    "fit",
    "from_deap",
    "from_pymoo",
    "hookimpl",
    "image_equations",
    "line_normals",
    "open_dem",
    "open_raster",
    "prepare",
    "read",
    "read_result",
    "read_rpc",
    "read_study",
    "rectify",
    "register",
    "row_weights",
    "rpc_of",
    "run",
    "search",
    "simulate_scene",
    "term_options",
    "to_deap",
    "to_pymoo",
    "uncovered_share",
    "write_lines_csv",
    "write_points_csv",
    "write_rpc",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
