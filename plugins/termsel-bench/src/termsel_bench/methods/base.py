"""A method by its name, and what it returns for a set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import numpy as np

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.toolkit import (
    FloatArray,
    attribute_errors_to,
    modules_here,
    options_of_file,
    unknown_name_error,
)
from termsel_bench.methods import peers, scripts

Projection = Callable[[FloatArray], FloatArray]
"""Image positions [px], shape (n, 2), of ground positions, shape (n, 3)."""

METHOD_KINDS = ("auto", "method", "solver", "model", "package", "peer")

FUNCTION = "georeference"
"""Function of a package that is called where none is named."""

PEERS: Mapping[str, Callable[[FeatureSet, int], Projection]] = {
    "gdal-polynomial": peers.gdal_polynomial, "gdal-tps": peers.gdal_spline,
    "orthority": peers.fit_orthority, "opencv": peers.fit_opencv_pose, "ransac": peers.fit_ransac,
    "scikit-learn": peers.fit_ridge, "deap-script": scripts.deap_projection,
    "pymoo-script": scripts.pymoo_projection}
"""Methods that termsel is compared with."""


@dataclass(frozen=True)
class Method:
    """A method of the benchmark.

    Parameters
    ----------
    kind : {"auto", "method", "solver", "model", "package", "peer"}
    name : str
        Name of the method, solver, model or peer; "module:function" for a package.
    options : mapping
        Options of a solver or a model by name.
    problem : str
        Problem of a solver; "" for that of the features.
    file : str, optional
        The file that names the method, if one does: its options are those that files may set.
    """

    kind: str
    name: str
    options: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""
    file: str | None = None

    @property
    def title(self) -> str:
        """Name of the method in tables, with its problem and options."""
        suffixes = [*filter(None, [self.problem]),
                    *(f"{name}={value}" for name, value in self.options.items())]
        if self.kind == "auto":
            label = "auto"
        elif self.kind == "peer":
            label = self.name
        else:
            label = f"{self.kind} {self.name}"
        return " ".join([label, *suffixes])

    def require(self) -> None:
        """Raise TermselError if the kind or the name is not known, or an option is refused.

        It is asked before a benchmark, so that a misspelt name does not fail after hours.
        """
        if self.kind not in METHOD_KINDS:
            raise unknown_name_error("kind of method", self.kind, METHOD_KINDS)
        if self.kind in ("solver", "model"):
            extension = termsel.get(f"{self.kind}s", self.name)
            # An option may be qualified by its kind, such as solver.population.
            with options_of_file(self.file):
                for option in extension.declared_options:
                    for key in (option.name, f"{self.kind}.{option.name}"):
                        if key in self.options:
                            option.parse(self.options[key])
        elif self.kind == "method":
            termsel.get("methods", self.name)
        elif self.kind == "peer" and self.name not in PEERS:
            raise unknown_name_error("peer", self.name, PEERS)
        elif self.kind == "package":
            function_of(self.name)

    def applied(self, features: FeatureSet, seed: int) -> Projection:
        """Return the projection that the method finds by control and selection points, lines, RPC.

        Raises
        ------
        TermselError
            If the method cannot, or code of a package fails.
        """
        with options_of_file(self.file):
            return self._apply_method(features, seed)

    def _apply_method(self, features: FeatureSet, seed: int) -> Projection:
        """Return the projection that the method finds: a function of ground points (n, 3).

        It returns image positions (n, 2) [px]. `seed` is that of methods that draw random numbers.
        """
        if self.kind == "auto":
            return termsel.run(features=features, seed=seed).project
        if self.kind == "method":
            return termsel.run(features=features, method=self.name, seed=seed).project
        if self.kind == "solver":
            return termsel.run(self.problem or _problem_for(features), features=features,
                               solver=self.name, seed=seed, options=self.options,
                               strategy="as-asked").project
        if self.kind == "model":
            # A plain fit selects nothing, so that selection points are control, too.
            without_roles = replace(features.points, roles=())
            return termsel.fit(features.with_(points=without_roles), self.name,
                               **self.options).project
        if self.kind == "peer":
            return PEERS[self.name](features, seed)
        function = function_of(self.name)
        with attribute_errors_to(function, FUNCTION,
                                 "Correct the function, then repeat the command."):
            returned = function(features)
        return _projection_of_answer(returned, self.name)

    def positions(self, features: FeatureSet, points: Points, seed: int) -> FloatArray:
        """Return the image positions (n, 2) [px] of points by their ground coordinates.

        Raises
        ------
        TermselError
            As `applied`; if positions are missing or not finite.
        """
        project = self.applied(features, seed)
        # The projection may be code of a package, whose answer may have any shape.
        with attribute_errors_to(project, "project",
                                 "Correct the function, then repeat the command."):
            positions = np.asarray(project(points.ground.copy()), dtype=np.float64)
        if positions.shape != (len(points), 2):
            raise TermselError(f"{self.title} returned positions of the shape {positions.shape}, "
                               f"expected {(len(points), 2)}",
                               hint="Return line and sample of each position.")
        if missing := int((~np.isfinite(positions).all(axis=1)).sum()):
            raise TermselError(f"{self.title} has no position for {missing} of {len(points)} "
                               "places")
        return positions


AUTO = Method("auto", "auto")
"""What termsel does where nothing is asked."""


def _problem_for(features: FeatureSet) -> str:
    """Return the problem of a solver: that of lines if there are any, else terms of a polynomial
    without heights, or of an RFM.
    """
    if len(features.lines):
        return "owdis-lines"
    return "poly-terms" if features.without_height() else "rfm-terms"


def function_of(name: str) -> Callable[[FeatureSet], Any]:
    """Return the function of "module" or "module:function"; the module may be in this folder.

    Raises
    ------
    TermselError
        If there is no such module or function.
    """
    module, _, function = name.partition(":")
    # The command was typed in the folder of the module, which Python does not search by itself.
    try:
        with modules_here():
            target = getattr(import_module(module), function or FUNCTION)
    except ImportError as error:
        raise TermselError(f"the package {module!r} cannot be imported: {error}",
                           hint="Install it, or run the command in its folder.") from error
    except AttributeError as error:
        raise TermselError(f"the package {module!r} has no function {function or FUNCTION!r}",
                           hint="Name it: --package MODULE:FUNCTION.") from error
    if not callable(target):
        raise TermselError(f"{name} is no function", hint="Name one: --package MODULE:FUNCTION.")
    return target  # type: ignore[no-any-return]


def _projection_of_answer(returned: Any, name: str) -> Projection:
    """Return the projection in the answer of a package's function: its method `project`, or itself.

    Raises TermselError if that cannot be called.
    """
    project = getattr(returned, "project", returned)
    if not callable(project):
        raise TermselError(f"{name} returned {type(returned).__name__}, which projects nothing",
                           hint="Return a function of ground positions, or an object with such a "
                                "method `project`.")
    return project  # type: ignore[no-any-return]
