"""What the equations of every sensor model must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.adjustment.solve import solve
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import adjust
from termsel.models.base import SensorModel
from termsel.models.quotient import RationalModel
from termsel.runs.fit import fit as fit_model
from termsel.testing.cases import require
from termsel.testing.scenes import (
    MIXES,
    accepted_scenes,
    features_with_truth,
    fit_and_project,
    seeded_generator,
)

EXACT = 1e-6
"""Allowed error of a model fitted to its own image positions, in scaled units."""

NOISE, REPEATED = 1e-4, 0.05
"""Noise of points, as a share of the image, and by how much of an error leave-one-out may differ
from a refit."""

NEAR, SLOPE = 1e-5, 1e-3
"""Step of numerical derivatives, and the share by which others may differ from them."""

FIRST_ORDER = 0.01
"""Allowed median error if line equations are of first order, relative to the image."""


def control_kinds(model: SensorModel) -> None:
    """It accepts control from points, from lines and from both.

    A model that cannot refuses with a TermselError, and has this check among its expected
    failures; the others are then run on the control it accepts.
    """
    for mix, name in zip(MIXES, ("points alone", "lines alone", "points and lines"), strict=True):
        try:
            model.equations(features_with_truth(model, *mix)[0])
        except TermselError as error:
            raise AssertionError(f"it refuses control from {name}: {error}") from error


def equations(model: SensorModel) -> None:
    """Points and lines give two finite rows each, points first, over all terms."""
    k = len(model.terms)
    for features in accepted_scenes(model):
        if len(features.lines):
            features = _split_last_line(features)
        n = len(features.points)
        # Two rows, line and sample, for a point; two for a line, one for each vertex.
        m = len(features.lines)
        rows_found = model.equations(features)
        of = f"of {n} points and {m} lines in {len(features) - n} features"
        rows = 2 * (n + m)
        for name, value, shape in (("A", rows_found.A, (rows, k)), ("b", rows_found.b, (rows,)),
                                   ("feature", rows_found.feature, (rows,))):
            require(np.shape(value) == shape, f"equations {of}: {name} must have shape {shape}, "
                    f"two rows per point or line, not {np.shape(value)}")
        require(np.isfinite(rows_found.A).all() and np.isfinite(rows_found.b).all(),
                f"equations {of}: A and b must be finite")
        require(np.array_equal(rows_found.feature, np.repeat(features.feature, 2)),
                f"equations {of}: feature must number the features each row belongs to, points "
                "first and then lines, as np.repeat(features.feature, 2) does")


def _split_last_line(features: FeatureSet) -> FeatureSet:
    """Return the features with the last line as a piece of the one before it."""
    # Two lines under one id are one feature of two pieces.
    ids = features.lines.ids
    return features.with_(lines=replace(features.lines, ids=(*ids[:-1], ids[-2])))


def linearisation(model: SensorModel) -> None:
    """Its equations about a solution, if any, have values and derivatives of its image positions.

    From its start, or the solution of `equations`, a fit to points that it computed converges.
    """
    features, truth, _ = features_with_truth(model, 1, 0)
    points = features.points
    terms = np.ones(len(truth), bool)
    used = np.ones(len(features), bool)
    try:
        linear = model.linearised(features, truth)
    except TermselError:  # a model of lines alone, as `control_kinds` says
        return
    if linear is None:
        require(model.start(features) is None, "it has a start and no equations about a solution; "
                                               "give them in linearised()")
        return
    # Central differences: (f(x + h) - f(x - h)) / 2h for each coefficient.
    steps = NEAR * np.eye(len(truth))
    projected, ahead, behind = (model.project(x, points.ground)
                                for x in (truth, truth + steps, truth - steps))
    columns = np.moveaxis(ahead - behind, 0, -1).reshape(linear.A.shape) / (2 * NEAR)
    for meaning, value, expected in (
            ("A: the derivatives of project() by the terms", linear.A, columns),
            ("b: what is measured less project(), plus A times the coefficients", linear.b,
             (points.image - projected).ravel() + columns @ truth)):
        # Relative to the largest expected value, as columns differ in size.
        off = np.abs(value - expected).max()
        require(off <= SLOPE * max(np.abs(expected).max(), 1.0),
                f"linearised() at the truth is {off:.1g} from what it must have as {meaning}")
    require(adjust(model, features, terms, used).converged,
            "a fit to points that project() gave does not converge; give a nearer start()")


def exact_recovery(model: SensorModel) -> None:
    """Fitted to points it computed itself, it computes other points correctly.

    Standard deviations, which weight the points, make no difference.
    """
    features, truth, ground = features_with_truth(model, 1, 0)
    _require_recovered(model, features, truth, ground, "points")
    points = features.points
    sigma = seeded_generator().uniform(0.5, 2.0, (len(points), 2))
    weighted = Points(points.ids, points.image, points.ground, sigma)
    _require_recovered(model, features.with_(points=weighted), truth, ground,
                       "points with standard deviations")


def recovery_from_lines(model: SensorModel) -> None:
    """Fitted to lines it computed itself, it computes points correctly."""
    if not any(len(features.lines) for features in accepted_scenes(model)):
        return
    # With a denominator for each axis the equations of lines hold to first order only, as they need
    # approximate image positions of the vertices: small coefficients keep the error small.
    is_first_order = _has_separate_denominators(model)
    # Lines alone suffice for a RationalModel, but may not for other models.
    points = 0 if isinstance(model, RationalModel) else 1
    features, truth, ground = features_with_truth(model, points, 1,
                                                  shrink=0.1 if is_first_order else 1.0)
    if not is_first_order:
        _require_recovered(model, features, truth, ground, "lines")
        return
    image = model.project(truth, ground)
    allowed = FIRST_ORDER * float(np.ptp(image))
    # A search has only the equations; a fit continues from them and may correct their errors.
    coefficients = solve(model.equations(features)).coefficients
    for how, predicted in (("by equations()", model.predict(coefficients, features, ground)),
                           ("by a fit", fit_and_project(model, features, ground))):
        error = float(np.median(np.abs(predicted - image)))
        require(error <= allowed,
                f"fitted to lines without noise {how}, it misses points by {error:.1g} (median, "
                f"scaled units); at most {allowed:.1g} is to be expected")


def translation(model: SensorModel) -> None:
    """A shift of all image coordinates shifts its prediction by as much."""
    features, truth, ground = features_with_truth(model, 1, 0)
    # Different in line and sample, so that the check fails if a model exchanges them.
    shift = np.array([0.1, -0.05])
    points = features.points
    moved = features.with_(points=Points(points.ids, points.image + shift, points.ground))
    error = np.abs(fit_and_project(model, moved, ground) - model.project(truth, ground)
                   - shift).max()
    require(error <= EXACT, f"a shift of all image coordinates by {shift} does not shift its "
                            f"prediction by as much, but differs by {error:.1g}; has it a constant "
                            "term for line and for sample?")


def fit(model: SensorModel) -> None:
    """Its method `fit` recovers what it computed, and leaves one out as refits do.

    Points without noise must be fitted to rounding, in the model's own scaling at least. With a
    little noise, the errors left out of two points must be those of refits, which fails for a model
    whose rows for one point depend on others.
    """
    try:
        scaled, truth, ground = features_with_truth(model, 1, 0)
        model.equations(scaled)
    except TermselError:  # a model of lines alone, as `control_kinds` says
        return
    scaling = model.scaling
    points = scaled.points
    require(scaling is not None, "it must be prepared")
    assert scaling is not None
    features = FeatureSet(Points(points.ids, scaling.pixels(points.image),
                                 scaling.unscaled(points.ground)), crs=model.crs)
    exact = fit_model(features, model)
    # In px, as `fit` takes features that are not scaled.
    image = scaling.pixels(model.project(truth, ground))

    def error_of(fitted: Fit) -> float:
        errors = np.abs(fitted.project(scaling.unscaled(ground)) - image)
        return float(errors.max() / scaling.image_scale)

    # `fit` has a scaling of its own, in which a model with sines or radial bases has other
    # functions than those of project() above. Polynomials are the same.
    if error_of(exact) > EXACT:
        exact = exact.estimator.fit(exact.model.prepared(scaling, model.crs), exact.control,
                                    scaling, exact.terms, exact.used)
    error = error_of(exact)
    require(error <= EXACT, "fit() to points without noise that project() gave, in the scaling "
                            f"that they were made in, misses other points by {error:.1g} (scaled "
                            "units); equations() and project() need not be closed under "
                            "rescaling, but must be of the same model")
    # A little noise, so that errors without a point are not zero.
    noise = NOISE * scaling.image_scale * seeded_generator().normal(size=(len(points), 2))
    noisy_fit = fit_model(features.with_(points=replace(
        features.points, image=features.points.image + noise)), model)
    left_out = noisy_fit.leave_one_out
    for i in (0, len(points) // 2):
        is_used = np.arange(len(points)) != i
        # In the same scaling, as leave-one-out has it.
        refit = noisy_fit.estimator.fit(
            noisy_fit.model, noisy_fit.control.take(is_used), noisy_fit.scaling,
            noisy_fit.terms, np.ones(len(points) - 1, dtype=bool))
        expected = refit.errors(noisy_fit.control.points.take(~is_used))[0]
        off = np.hypot(*(expected - (left_out[i].line, left_out[i].sample)))
        # Relative to the error, and to the noise where that is small by chance.
        require(off <= REPEATED * (np.hypot(*expected) + NOISE * scaling.image_scale),
                f"leave_one_out of fit() is {off:.2g} px from a fit without the point; do "
                "the equations of a point depend on other points?")


def _require_recovered(model: SensorModel, features: FeatureSet, truth: FloatArray,
                       ground: FloatArray, kind: str) -> None:
    """Require that a model, fitted to its own features, projects as with the true coefficients."""
    error = np.abs(fit_and_project(model, features, ground) - model.project(truth, ground)).max()
    require(error <= EXACT,
            f"fitted to {kind} without noise that project() gave, it misses other points by "
            f"{error:.1g} (scaled units); equations() and project() do not say the same")


def _has_separate_denominators(model: SensorModel) -> bool:
    """Return whether line or sample have a denominator of their own; False for other models."""
    if not isinstance(model, RationalModel):
        return False
    blocks = model.blocks(np.zeros((1, 3)))
    return any(block is not None and block.shape[1]
               for block in (blocks.line_denominator, blocks.sample_denominator))
