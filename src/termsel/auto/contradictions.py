"""Features held against what the features in use predict for them.

`termsel.auto.blunders` decides by it which are blunders.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from termsel.adjustment.bayesian.field import (
    GaussianProcess,
    blunder_odds,
    fit_gaussian_process,
)
from termsel.adjustment.bayesian.held_out import HeldOutPredictions, chance_of
from termsel.adjustment.bayesian.line_posterior import line_posterior
from termsel.adjustment.bayesian.posterior import (
    FALLS,
    SLOW_FALL,
    Posterior,
    scales_of,
    solve_posterior,
)
from termsel.adjustment.equations import row_weights, weights_of
from termsel.auto.rule import PRIOR_MARGIN, gain_of
from termsel.auto.shrunken import FIELD_CALLED_FOR
from termsel.data.coordinates.crs import is_geographic
from termsel.data.coordinates.longitudes import unwrap_longitudes
from termsel.data.coordinates.metres import is_polar
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.data.fit_data import FitData
from termsel.data.monomials import Exponents, evaluate_monomials, graded_exponents
from termsel.fitting.fit import Undetermined
from termsel.fitting.method import Method, Suspects
from termsel.models.polynomial import Polynomial, Polynomial2D, Polynomial3D

FALSE_ALARM = 1e-3
"""Chance of naming any point where there is no blunder, under normal errors."""

MIN_STRAIN = 4.0
"""Standard deviations of a prediction that an error must exceed: real errors are not normal, and no
model is exact."""

STRAIN_PER_SPREAD = 1.0
"""Standard deviations it must exceed for each standard deviation of the noise that the prediction
has, on account of the form of the model."""

NEGLIGIBLE_ERROR = 1e-6
"""Errors that are none [px]."""

LOOK_STRAIN = 2.0
"""Standard deviations within which an error says nothing of a blunder, and is not looked at."""

MAX_COMPARED_POINTS = 1000
"""Points by which the quadratic and the cubic polynomial are compared, about; more decide alike."""

BEND_DEGREE = 5
"""Degree in X and Y of a polynomial that follows strong bends, as of a map of half the Earth."""

DOUBTFUL_STRAIN = 8.0
"""Standard deviations up to which an error may be a deformation that only its own point shows."""

LOG_ODDS_OF_BLUNDER = float(np.log(19.0))
"""Odds from which on such a point is a blunder: 95 %. To leave out a right one, which alone shows
what the image does at its place, costs more than to keep a wrong one, which is named."""

UNUSED_WEIGHT = 1e-3
"""Weight at which a point has no influence and is predicted all the same."""


@dataclass(frozen=True, eq=False)
class Test:
    """Errors of all features against what the features in use predict for each.

    A feature in use is predicted by the others, as its own measurement would hide its error.
    """

    errors: FloatArray  # (n,): largest in line or sample, or of a vertex off its line [px]
    probability: FloatArray  # (n,): of an error as large
    strain: FloatArray  # (n,): the error in standard deviations
    spread: FloatArray  # (n,): standard deviation of the prediction by that of the noise
    noise: float  # [px]
    freedom: int  # degrees of freedom of the noise
    squares: FloatArray  # of the errors of features in use
    by_field: bool = False  # whether a random field predicts

    def beyond_chance(self, n: int) -> BoolArray:
        """Return which of n features have an error that chance does not explain, (n,)."""
        # Of n features one is named by chance with FALSE_ALARM in all (Bonferroni).
        is_improbable = self.probability < FALSE_ALARM / n
        return is_improbable & (self.strain > MIN_STRAIN) & (self.errors > NEGLIGIBLE_ERROR)

    def beyond_form(self) -> BoolArray:
        """Return which errors are larger than a wrong form of the model explains, (n,).

        Far from the other features a prediction rests on that form: its `spread` is large there,
        and so must the strain be.
        """
        return self.strain > STRAIN_PER_SPREAD * self.spread

    def suspects(self, blunders: BoolArray, probable: BoolArray, undecided: BoolArray,
                 judged: BoolArray) -> Suspects:
        """Return the findings on the `judged` features, in their order; all masks are (n,).

        Beside each error stands its limit: the least error [px] there that the test would name.
        """
        # The chance of a strain s is (1 + 2 s^2 / f)^(-f/2), as of `chance_of`: this s is the one
        # whose chance is FALSE_ALARM / n.
        improbable_strain = np.sqrt(self.freedom / 2
                                    * ((FALSE_ALARM / judged.sum()) ** (-2 / self.freedom) - 1))
        least_strain = np.maximum(max(MIN_STRAIN, float(improbable_strain)),
                                  STRAIN_PER_SPREAD * self.spread)
        limits = np.maximum(least_strain * self.spread * self.noise, NEGLIGIBLE_ERROR)
        return Suspects(blunders[judged], probable[judged], undecided[judged], self.errors[judged],
                        limits[judged])


@dataclass(frozen=True, eq=False)
class Division:
    """Features of which those in use, the mask `used` (n,), predict all."""

    all_features: FitData
    used: BoolArray

    @cached_property
    def in_use(self) -> FitData:
        """The features in use, with the scaling in which all features are predicted.

        Points are tested in the CRS of their own coordinates, even where the fit has another one.
        Around a pole they are tested in the CRS of the fit: degrees are no plane coordinates there.
        """
        features = self.all_features.features
        # Lines are straight in the CRS of the fit only.
        if not features.fit_crs or len(features.lines) or self._around_pole:
            return self.all_features.take(self.used)
        return FitData.of(replace(features, fit_crs="").take(self.used), self.all_features.heights)

    @cached_property
    def _around_pole(self) -> bool:
        """Whether the points are in degrees around a pole."""
        features = self.all_features.features
        if not is_geographic(features.crs):
            return False
        ground = features.points.ground
        return is_polar(np.column_stack([unwrap_longitudes(ground[:, 0]), ground[:, 1]]))

    @property
    def _gaussian_process(self) -> GaussianProcess | None:
        """The random field of the points in use, with heights or in the plane; None if too few."""
        return fit_gaussian_process(self.in_use.scaled.points,
                                    3 if self.all_features.heights else 2)

    def test(self) -> Test | None:
        """Return the test by a random field where points support one, else by `shrunken_test`.

        Returns None where the features in use are too few for either.
        """
        return self.local_test() or self.shrunken_test()

    def local_test(self) -> Test | None:
        """Return the test of all points by a random field of those in use.

        Returns None where the points do not support a field, and where there are lines.
        """
        if len(self.all_features.features.lines):
            return None
        process = self._gaussian_process
        if process is None or process.probability <= FIELD_CALLED_FOR:
            return None
        points = self.all_features.features.points
        scaling = self.in_use.scaling
        used = self.used
        scaled = scaling.points(points)
        # Variance of the field at each point, and of the noise of weight one; then of each point.
        variance, unit_noise = process.spread(scaled.ground)
        noise = unit_noise / weights_of(points) ** 2
        errors = scaled.image - process.predict(scaled.ground)
        # Mean of the squares of both coordinates' errors, each divided by its variance.
        statistic = (errors**2 / (variance + noise)).sum(axis=1) / 2
        # The noise has the freedom of the points, whatever the field.
        freedom = process.solutions[0].posterior.freedom
        rows = np.stack([*np.abs(errors.T), chance_of(statistic, freedom), np.sqrt(statistic),
                         np.sqrt((1 + variance / noise).max(axis=1))], axis=1)
        # A point in use is predicted by the others: its own measurement would hide its error.
        rows[used] = _point_figures(process.held_out)
        rows[used, :2] /= weights_of(self.in_use.features.points)
        pixels = rows[:, :2] * scaling.image_scale
        return Test(np.abs(pixels).max(axis=1), rows[:, 2], rows[:, 3], rows[:, 4],
                    float(np.sqrt(unit_noise[0])) * scaling.image_scale, freedom,
                    (pixels[used] ** 2).sum(axis=1), by_field=True)

    def shrunken_test(self) -> Test | None:
        """Return the test by the regularised quadratic polynomial, or the cubic if clearly better.

        Returns None where the features in use are too few.
        """
        if len(self.all_features.features.lines):
            return _clearly_better_of(*(_test_of_lines(self, degree) for degree in (2, 3)))
        prediction = _clearly_better_of(*(_prediction_of_points(self, degree) for degree in (2, 3)))
        return prediction.test() if prediction else None

    def test_by_projection(self, projection: Method) -> Test | None:
        """Return the test of all points by a central projection of those in use.

        With the leverage h of a point in use and its residual r, the others predict it with the
        error r / (1 - h) and the variance s^2 / (1 - h), s^2 being the noise that they leave.
        Returns None where the points in use do not determine the projection with redundancy, or
        some point has no finite error.
        """
        try:
            # A central projection may be undetermined where a polynomial is not.
            fitted = projection.fit(self.in_use)
        except Undetermined:
            return None
        points = self.all_features.features.points
        used = self.used
        spread = fitted.estimator.spread(fitted, fitted.scaling.ground(points.ground))
        weights = weights_of(points)
        # The leverage h: the variance of the prediction divided by that of the point's noise.
        leverage = spread.variance / spread.noise * weights**2
        freedom = 2 * int(used.sum()) - round(fitted.effective)
        errors = fitted.errors(points)
        if freedom <= 2 or not np.isfinite(leverage).all() or not np.isfinite(errors).all():
            return None
        # 1 - h, hardly above 0 of a point that determines the fit alone.
        redundancy = np.maximum(1.0 - np.minimum(leverage, 1.0), NEGLIGIBLE_ERROR)
        squares = errors**2 * weights**2
        sum_in_use = float(squares[used].sum())
        noise = np.full(len(points), sum_in_use / freedom)
        # Without a point the squares fall by r^2 / (1 - h), and the freedom by two.
        squares_without = np.maximum(sum_in_use - (squares / redundancy).sum(axis=1),
                                     NEGLIGIBLE_ERROR**2)
        noise[used] = (squares_without / (freedom - 2))[used]
        # r / (1 - h): the error if the point were left out.
        errors[used] /= redundancy[used]
        relative_variance = np.where(used[:, None], 1.0 / redundancy, 1.0 + leverage)
        statistic = (errors**2 * weights**2 / relative_variance).sum(axis=1) / 2 / noise
        return Test(np.abs(errors).max(axis=1), chance_of(statistic, freedom - 2),
                    np.sqrt(statistic), np.sqrt(relative_variance.max(axis=1)),
                    float(np.sqrt(sum_in_use / freedom)), freedom, (errors[used]**2).sum(axis=1))

    def likeliest_blunder(self) -> int | None:
        """Return the index of the point in use that is likeliest a blunder; None if none is likely.

        The odds are averaged over all polynomials and fields. Beforehand one point in use is
        believed to be a blunder; a point is likely one if it is likelier a blunder than right.
        """
        process = self._gaussian_process
        if process is None:
            return None
        # In a fit without errors rounding would decide which point is worst.
        largest_errors = np.abs(process.errors).max(axis=1) * self.in_use.scaling.image_scale
        has_error = largest_errors > NEGLIGIBLE_ERROR
        doubtful = np.flatnonzero(has_error & (process.held_out.statistic > LOOK_STRAIN**2))
        if not doubtful.size:
            return None
        log_odds = process.blunder_odds(doubtful)
        if not log_odds.max() > self.log_odds_of_right_points:
            return None
        return int(np.flatnonzero(self.used)[doubtful[log_odds.argmax()]])

    def may_show_deformation(self, point: int) -> bool:
        """Return whether a point out of use may be right, by a deformation that it alone shows.

        That is where the points with it support a random field, and it is not clearly a blunder
        under all polynomials and fields.
        """
        used = self.used.copy()
        used[point] = True
        with_point = Division(self.all_features, used)
        process = with_point._gaussian_process
        if process is None or process.probability <= FIELD_CALLED_FOR:
            return False
        odds = process.blunder_odds(np.flatnonzero(np.flatnonzero(used) == point))
        return bool(odds[0] - with_point.log_odds_of_right_points < LOG_ODDS_OF_BLUNDER)

    @property
    def log_odds_of_right_points(self) -> float:
        """Log of the odds beforehand that a point in use is right, if one of them is a blunder."""
        return float(np.log(len(self.in_use) - 1))

    def candidates_of_bend(self) -> IntArray:
        """Return the indices (c,) of points out of use that a bend may explain, likeliest first.

        A regularised polynomial which follows strong bends predicts these points within chance, or
        too weakly to say. There are none where it has no prediction.
        """
        prediction = _prediction_by(self, *_bending_polynomial(heights=self.all_features.heights))
        if prediction is None:
            return np.empty(0, dtype=np.intp)
        predicted = prediction.posterior.predict_unused(UNUSED_WEIGHT)
        strain = np.sqrt(predicted.statistic)
        # Off the bend is what chance does not explain and the prediction is sharp enough to say:
        # FALSE_ALARM is divided by the number of points, as each might be named (Bonferroni).
        is_off_the_bend = ((predicted.probability < FALSE_ALARM / len(self.used))
                           & (strain > STRAIN_PER_SPREAD * np.sqrt(predicted.spread.max(axis=1))))
        likeliest_first = np.argsort(-predicted.probability, kind="stable")
        possible = likeliest_first[~is_off_the_bend[likeliest_first]]
        return np.asarray(np.flatnonzero(~self.used)[possible])

    def shows_bend_at(self, point: int) -> bool:
        """Return whether a point out of use is likelier right, on a bend, than a blunder.

        It is judged by a regularised polynomial which follows strong bends, fitted with the point.
        """
        used = self.used.copy()
        used[point] = True
        with_point = Division(self.all_features, used)
        prediction = _prediction_by(with_point,
                                    *_bending_polynomial(heights=self.all_features.heights))
        if prediction is None:
            return False
        # Logarithms: the evidence for a blunder must not outweigh the odds beforehand against one.
        odds = blunder_odds([(1.0, prediction.posterior, False)],
                            np.flatnonzero(prediction.order == point))
        return bool(odds[0] <= with_point.log_odds_of_right_points)


_Squares = TypeVar("_Squares", Test, "_PointPrediction")


def _clearly_better_of(quadratic: _Squares | None, cubic: _Squares | None) -> _Squares | None:
    """Return the cubic polynomial's test if its errors are clearly smaller, else the quadratic's.

    Where the points are too few for one polynomial, the test is that by the other one. Returns None
    where they are too few for both.
    """
    if quadratic is None or cubic is None:
        return cubic or quadratic
    gain = gain_of(cubic.squares, quadratic.squares, NEGLIGIBLE_ERROR)
    return cubic if gain > PRIOR_MARGIN else quadratic


def polynomial_of(heights: bool, degree: int) -> Polynomial:
    """Return the polynomial of a degree in X, Y and Z, or in X and Y alone without heights."""
    return (Polynomial3D if heights else Polynomial2D)(degree=degree)


@dataclass(frozen=True, eq=False)
class _PointPrediction:
    """What a regularised polynomial of the points in use predicts for all points.

    `order` is that of the points in `posterior`: those in use come first.
    """

    posterior: Posterior
    order: IntArray
    weights: FloatArray
    image_scale: float

    @cached_property
    def squares(self) -> FloatArray:
        """Squared error of each point in use as the others predict it [px^2], shape (m,).

        Of more than MAX_COMPARED_POINTS points these are of a part, evenly spread over the table.
        """
        # Each point left out costs the same: of many a part must do.
        sample = slice(0, self.posterior.in_use, -(-self.posterior.in_use // MAX_COMPARED_POINTS))
        errors = (self.posterior.held_out
                  if sample.step == 1 else self.posterior.held_out_of(sample)).errors
        return np.asarray(((errors / self.weights[self.order[sample]]
                            * self.image_scale) ** 2).sum(axis=1))

    def test(self) -> Test:
        """Return the test of all points, whether they are in use or not."""
        posterior = self.posterior
        # The posterior counts points in use first: rows go back to the order of the features.
        rows = np.empty((len(self.order), 5))
        rows[self.order] = np.concatenate(
            [_point_figures(posterior.held_out),
             _point_figures(posterior.predict_unused(UNUSED_WEIGHT))])
        pixels = rows[:, :2] / self.weights * self.image_scale
        # The noise is averaged over the solutions by their probabilities.
        noise = float(np.sqrt(posterior.cells.share @ posterior.square / posterior.freedom))
        return Test(np.abs(pixels).max(axis=1), rows[:, 2], rows[:, 3], rows[:, 4],
                    noise * self.image_scale, posterior.freedom,
                    (pixels[self.order[:posterior.in_use]] ** 2).sum(axis=1))


def _prediction_of_points(division: Division, degree: int) -> _PointPrediction | None:
    """Return what a regularised polynomial of the points in use predicts; None if too few."""
    exponents = polynomial_of(division.all_features.heights, degree).exponents
    return _prediction_by(division, exponents, FALLS)


def _bending_polynomial(*, heights: bool) -> tuple[Exponents, tuple[float, ...]]:
    """Return the terms of a polynomial that follows strong bends, and rates at which they may fall.

    A rate is by how much coefficients are smaller in each degree than in the one before. Bends are
    of the plane: heights have only the terms of a cubic polynomial.
    """
    terms_of_plane = graded_exponents(BEND_DEGREE, 2)
    cubic = polynomial_of(heights, 3).exponents
    # Exponents are in the order of their degree, so that those up to the third come first.
    beyond_cubic = terms_of_plane[len(graded_exponents(3, 2)):]
    return (*cubic, *beyond_cubic), (*FALLS, SLOW_FALL)


def _prediction_by(division: Division, exponents: Exponents,
                   falls: tuple[float, ...]) -> _PointPrediction | None:
    """Return what a regularised polynomial of these terms, fitted to the points in use, predicts.

    Returns None if the points in use are too few. The other points take part with a tiny weight: so
    the same factorisation predicts them, too.
    """
    points = division.all_features.features.points
    used = division.used
    scaling = division.in_use.scaling
    scaled = scaling.points(points)
    powers = np.array(exponents).sum(axis=1)
    weights = weights_of(points)
    # The posterior takes the points in use first.
    order = np.argsort(~used, kind="stable")
    weights_of_equations = weights * np.where(used, 1.0, UNUSED_WEIGHT)[:, None]
    posterior = solve_posterior(
        evaluate_monomials(scaled.ground[order], exponents), scaled.image[order], powers,
        weights_of_equations[order], scales_of(np.array(exponents)[powers > 1], falls=falls),
        int(used.sum()))
    if posterior is None:
        return None
    return _PointPrediction(posterior, order, weights, scaling.image_scale)


def _test_of_lines(division: Division, degree: int) -> Test | None:
    """Return the test of points and lines by a regularised polynomial; None if too few are in use.

    The prior has no random factor for each term, which would take longer: many tests are made.
    """
    control = division.all_features
    used = division.used
    scaling = division.in_use.scaling
    scaled = scaling.features(control.features)
    model = polynomial_of(control.heights, degree)
    equations = model.equations(scaled)
    weights = np.where(used, 1.0, UNUSED_WEIGHT)[equations.feature]
    posterior_of_lines = line_posterior(
        replace(equations, A=equations.A * weights[:, None], b=equations.b * weights),
        model.exponents, 0, int((weights == 1.0).sum()))
    if posterior_of_lines is None:
        return None
    # A tiny weight instead of none: a feature out of use is predicted by the same factorisation.
    predictions = posterior_of_lines.predictions(np.where(used, 1.0, UNUSED_WEIGHT))
    pixels = predictions.errors / row_weights(scaled, heights=control.heights) * scaling.image_scale
    largest, squares = np.zeros((2, len(control)))
    # A line has the error of its worst vertex.
    np.maximum.at(largest, equations.feature, np.abs(pixels))
    np.add.at(squares, equations.feature, pixels**2)
    return Test(largest, predictions.probability, predictions.strain, predictions.spread,
                posterior_of_lines.noise * scaling.image_scale, posterior_of_lines.freedom,
                squares[used])


def _point_figures(predictions: HeldOutPredictions) -> FloatArray:
    """Return a row for each point, (m, 5): errors in line and sample, probability, strain, spread.

    The strain, in standard deviations, is the root of the statistic: of the mean square of both
    coordinates' errors, each divided by its variance.
    """
    return np.stack([*predictions.errors.T, predictions.probability, np.sqrt(predictions.statistic),
                     np.sqrt(predictions.spread.max(axis=1))], axis=1)
