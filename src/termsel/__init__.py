"""Select sensor-model terms and ground control features for georeferencing images.

The names below are the public API. They are imported when first used, so that importing
termsel, and answering ``termsel --help``, costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from termsel.adjustment import Equations, image_equations, line_normals, row_weights
    from termsel.criteria import Criterion, Fits
    from termsel.datasets import DatasetSpec
    from termsel.errors import TermselError
    from termsel.features import FeatureSet, Lines, Points
    from termsel.io.base import Reader, Writer
    from termsel.io.reading import read
    from termsel.io.rectifying import rectify
    from termsel.io.result_files import read_result
    from termsel.io.rpc_files import read_rpc
    from termsel.models import Blocks, Polynomial2D, RationalModel, SensorModel
    from termsel.options import Option
    from termsel.plugins import hookimpl
    from termsel.problems.base import Evaluation, Genome, Problem, Segment, Selection
    from termsel.problems.recipes import Recipe, feature_options
    from termsel.problems.selection import Inputs, SelectionProblem
    from termsel.result import Result
    from termsel.rpc import Rpc
    from termsel.running import Task, prepare, run
    from termsel.scaling import Scaling
    from termsel.searching import Search, search
    from termsel.simulate import simulate_scene
    from termsel.solvers import Generation, Solver

_HOME = {
    "Blocks": "termsel.models",
    "Criterion": "termsel.criteria",
    "DatasetSpec": "termsel.datasets",
    "Equations": "termsel.adjustment",
    "Evaluation": "termsel.problems.base",
    "FeatureSet": "termsel.features",
    "Fits": "termsel.criteria",
    "Generation": "termsel.solvers",
    "Genome": "termsel.problems.base",
    "Inputs": "termsel.problems.selection",
    "Lines": "termsel.features",
    "Option": "termsel.options",
    "Points": "termsel.features",
    "Polynomial2D": "termsel.models",
    "Problem": "termsel.problems.base",
    "RationalModel": "termsel.models",
    "Reader": "termsel.io.base",
    "Recipe": "termsel.problems.recipes",
    "Result": "termsel.result",
    "Rpc": "termsel.rpc",
    "Scaling": "termsel.scaling",
    "Search": "termsel.searching",
    "Segment": "termsel.problems.base",
    "Selection": "termsel.problems.base",
    "SelectionProblem": "termsel.problems.selection",
    "SensorModel": "termsel.models",
    "Solver": "termsel.solvers",
    "Task": "termsel.running",
    "TermselError": "termsel.errors",
    "Writer": "termsel.io.base",
    "feature_options": "termsel.problems.recipes",
    "hookimpl": "termsel.plugins",
    "image_equations": "termsel.adjustment",
    "line_normals": "termsel.adjustment",
    "prepare": "termsel.running",
    "read": "termsel.io.reading",
    "read_result": "termsel.io.result_files",
    "read_rpc": "termsel.io.rpc_files",
    "rectify": "termsel.io.rectifying",
    "row_weights": "termsel.adjustment",
    "run": "termsel.running",
    "search": "termsel.searching",
    "simulate_scene": "termsel.simulate",
}

__all__ = [
    "Blocks",
    "Criterion",
    "DatasetSpec",
    "Equations",
    "Evaluation",
    "FeatureSet",
    "Fits",
    "Generation",
    "Genome",
    "Inputs",
    "Lines",
    "Option",
    "Points",
    "Polynomial2D",
    "Problem",
    "RationalModel",
    "Reader",
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
    "Task",
    "TermselError",
    "Writer",
    "__version__",
    "feature_options",
    "hookimpl",
    "image_equations",
    "line_normals",
    "prepare",
    "read",
    "read_result",
    "read_rpc",
    "rectify",
    "row_weights",
    "run",
    "search",
    "simulate_scene",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
