"""Control features with image positions by a model, free of noise, in scaled coordinates."""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, FloatArray, Lines, Points, empty_lines, empty_points
from termsel.fitting.least_squares import adjust
from termsel.models.base import SensorModel

LEAST_DENOMINATOR = 0.5

MIXES = ((1, 0), (0, 1), (1, 1))
"""Points only, lines only, both."""


def seeded_generator() -> np.random.Generator:
    """Return the generator of the checks, always in the same state."""
    return np.random.default_rng(1)


def random_ground(rng: np.random.Generator, n: int) -> FloatArray:
    """Return ground points in the cube of scaled coordinates, shape (n, 3)."""
    return rng.uniform(-1.0, 1.0, (n, 3))


def flatten_heights(ground: FloatArray) -> FloatArray:
    """Return ground coordinates with other heights, all the same."""
    return np.asarray(ground * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.25])


def random_coefficients(model: SensorModel, rng: np.random.Generator) -> FloatArray:
    """Return coefficients (k,) that give a model a finite image within [-1, 1], without poles.

    They lie within 1 of 0, or within 0.1 of the start of a model that has one; that start is for an
    image of half the size of the ground, with north above. Raises AssertionError where no such
    coefficients are found.
    """
    ground = random_ground(rng, 500)
    change = rng.uniform(-1.0, 1.0, len(model.terms))
    north_up = 0.5 * ground[:, 1::-1] * [-1.0, 1.0]
    start = model.start(FeatureSet(Points(numbered_names("p", 500), north_up, ground)))
    middle: FloatArray | float = 0.0
    if start is not None:
        middle = start
        change = 0.1 * change
    for _ in range(60):
        coefficients = middle + change
        # Copies, so that a model that changes its inputs fails only in that check.
        image = model.project(coefficients.copy(), ground.copy())
        below = model.denominators(coefficients.copy(), ground.copy())
        if (np.isfinite(image).all() and np.abs(image).max() <= 1.0
                and (below is None or below.min() > LEAST_DENOMINATOR)):
            return coefficients
        # With smaller changes poles, and places outside of [-1, 1], disappear.
        change *= 0.8
    raise AssertionError("project() gives no finite image within [-1, 1] of ground points within "
                         "[-1, 1], however small the coefficients, or near the start")


def imaged_features(model: SensorModel, coefficients: FloatArray, rng: np.random.Generator, *,
                    points: int = 0, lines: int = 0) -> FeatureSet:
    """Return control whose image coordinates the model computes itself, in scaled coordinates.

    The model has the `coefficients` (k,). `points` and `lines` are how many there are of each.
    """
    ground = random_ground(rng, points)
    middle = rng.uniform(-0.7, 0.7, (lines, 1, 3))
    # Lines of different directions, each at least a tenth of the scene long.
    half_line = rng.uniform(0.1, 0.3, (lines, 1, 3)) * rng.choice([-1.0, 1.0], (lines, 1, 3))
    vertices = np.concatenate([middle - half_line, middle + half_line], axis=1)
    ends = model.project(coefficients, vertices.reshape(-1, 3)).reshape(-1, 2, 2)
    # The ground vertices of a line lie on the image line, but the image points that define it are
    # elsewhere along it.
    offsets = np.array([-0.3, 1.4])[None, :, None] * (ends[:, 1:] - ends[:, :1])
    control_points = empty_points()
    if points:
        image = model.project(coefficients, ground)
        control_points = Points(numbered_names("p", points), image, ground)
    control_lines = empty_lines()
    if lines:
        control_lines = Lines(numbered_names("l", lines), ends[:, :1] + offsets, vertices)
    return FeatureSet(control_points, control_lines)


def features_with_truth(model: SensorModel, points: int, lines: int, shrink: float = 1.0,
                        ) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return features, the coefficients (k,) they were computed with, and other places (50, 3).

    `points` and `lines` are 1 or 0, whether there are any; there are enough of either to determine
    all terms twice over. Random coefficients are multiplied by `shrink`.
    """
    rng = seeded_generator()
    truth = random_coefficients(model, rng) * shrink
    # Twelve or more, so that every model of up to 24 terms is determined.
    number = max(12, len(model.terms))
    features = imaged_features(model, truth, rng, points=points * number, lines=lines * number)
    return features, truth, random_ground(rng, 50)


def accepted_scenes(model: SensorModel) -> list[FeatureSet]:
    """Return features of each mix of points and lines that the model accepts, in order of `MIXES`.

    Raises AssertionError where the model accepts none.
    """
    accepted = []
    refusal: TermselError | None = None
    for mix in MIXES:
        features = features_with_truth(model, *mix)[0]
        try:
            model.equations(features)
        except TermselError as error:
            refusal = error
        else:
            accepted.append(features)
    if not accepted:
        raise AssertionError(f"equations() refuses points and lines: {refusal}")
    return accepted


def fit_and_project(model: SensorModel, features: FeatureSet, ground: FloatArray) -> FloatArray:
    """Return image positions, shape (n, 2), after fitting all terms to the features."""
    terms, used = (np.ones(n, dtype=bool) for n in (len(model.terms), len(features)))
    coefficients = adjust(model, features, terms, used).coefficients
    return model.predict(coefficients, features, ground)


def numbered_names(letter: str, n: int) -> tuple[str, ...]:
    """Return names such as p1, p2, p3."""
    return tuple(f"{letter}{i + 1}" for i in range(n))
