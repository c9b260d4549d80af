"""Problems, selections and errors that tests of criteria share."""

from __future__ import annotations

import numpy as np

import termsel
from termsel.adjustment.equations import Equations, line_normals
from termsel.data.features import FeatureSet
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial3D
from termsel.models.quotient import POLE_MARGIN
from termsel.selection.problems.selection import SelectionProblem

CRITERIA = ("press", "kfold", "ebic")


class Spreading(Polynomial3D):
    """A polynomial that spreads the residuals of control points by inverse distance."""

    name = "spreading"

    def residual_weights(self, control: np.ndarray, ground: np.ndarray) -> np.ndarray:
        weights = 1 / (0.1 + np.linalg.norm(ground[:, None] - control[None], axis=2))
        return weights / weights.sum(axis=1, keepdims=True)


class Opaque(SensorModel):
    """An affine model that is no RationalModel, so that nothing is known of its form."""

    name = "opaque"
    inner = Polynomial3D(degree=1)

    @property
    def terms(self) -> tuple[str, ...]:
        return self.inner.terms

    def equations(self, features: FeatureSet) -> Equations:
        return self.inner.equations(features)

    def project(self, coefficients: np.ndarray, ground: np.ndarray) -> np.ndarray:
        return self.inner.project(coefficients, ground)


def problem_of(name: str, criterion: str, **given: object) -> SelectionProblem:
    problem = termsel.prepare(name, criterion=criterion, **given).problem
    assert isinstance(problem, SelectionProblem)
    return problem


def solution(problem: SelectionProblem, terms: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the coefficients of a selection by numpy."""
    equations = problem.equations
    rows = used[equations.feature]
    x = np.zeros(len(terms))
    x[terms] = np.linalg.lstsq(equations.A[np.ix_(rows, terms)], equations.b[rows], rcond=None)[0]
    return x


def errors_of(problem: SelectionProblem, x: np.ndarray, features: np.ndarray) -> np.ndarray:
    """Return the errors of control features held out [px]: of points dl and ds, of lines the
    distance of each vertex from the image line and 0."""
    inputs = problem.inputs
    model, points, lines = inputs.model, inputs.control.points, inputs.control.lines
    errors = []
    normal, rho = line_normals(lines)
    others = np.ones(len(points), dtype=bool)
    others[features[features < len(points)]] = False
    for i in features:
        j = i - len(points)
        ground = points.ground[[i]] if j < 0 else lines.ground[j]
        image = model.project(x, ground)
        weights = model.residual_weights(points.ground[others], ground)
        if weights is not None:
            residuals = points.image[others] - model.project(x, points.ground[others])
            image = image + weights @ residuals
        below = model.denominators(x, ground)
        if below is not None and below.min() < POLE_MARGIN:
            return np.full((1, 2), np.inf)
        if j < 0:
            errors.extend(points.image[[i]] - image)
        else:
            errors.extend([rho[j] - normal[j] @ end, 0.0] for end in image)
    return np.array(errors) * inputs.pixels


def refitted(problem: SelectionProblem, genes: np.ndarray, folds: list[np.ndarray]) -> float:
    """Return the RMSE over the folds by one refit each."""
    terms, features = (None if mask is None else mask[0] for mask in problem.masks(genes[None]))
    used = np.ones(len(problem.inputs.control), dtype=bool) if features is None else features
    errors = []
    for fold in folds:
        rest = used.copy()
        rest[fold] = False
        held = fold[used[fold]]
        if len(held):
            errors.append(errors_of(problem, solution(problem, terms, rest), held))
    return float(np.sqrt((np.concatenate(errors)**2).sum(axis=1).mean()))


def selections(problem: SelectionProblem, n: int = 12) -> np.ndarray:
    """Return feasible selections of few terms or of most features."""
    rng = np.random.default_rng(7)
    slices = problem.genome.slices()
    genes = np.zeros((40 * n, problem.genome.size), dtype=bool)
    for name, where in slices.items():
        share = 0.85 if name == "features" else 8 / (where.stop - where.start)
        genes[:, where] = rng.random((len(genes), where.stop - where.start)) < share
    genes = genes[problem.evaluate(genes).violation == 0]
    assert len(genes) >= n
    return genes[:n]


CASES = {
    "points, rational": ("rfm-terms", {}),
    "points, polynomial": ("poly-terms", {"options": {"degree": 3}}),
    "points, shared denominator": ("rfm-terms", {"options": {"denominators": "shared",
                                                             "order": 2}}),
    "points chosen": ("owdis-points", {"options": {"degree": 1}}),
    "lines chosen": ("owdis-lines", {}),
    "lines and terms, rational": ("owdis-lines-terms", {"options": {"ridge": 0.0}}),
    "points and lines": ("owdis-lines", {"options": {"mixed": True}}),
}
