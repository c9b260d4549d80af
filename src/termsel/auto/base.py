"""What the strategy auto chooses among: candidates, each of which fits and judges itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.control import Control
from termsel.data.features import BoolArray, FeatureSet, FloatArray, no_points
from termsel.fitting.adjustment.parts import independent_parts
from termsel.fitting.adjustment.rounding import ROUNDING
from termsel.fitting.fit import Estimator, Fit, Undetermined
from termsel.fitting.least_squares import LEAST_SQUARES, first_order, solutions_without_each
from termsel.fitting.of_features import control_of
from termsel.models.base import SensorModel
from termsel.models.poles import guard_points, pole_margin, pole_violation
from termsel.models.quotient import RationalModel
from termsel.selection.criteria import Fits

WIDER = 1.5
"""A denominator must be positive in a box this much wider than that of the points."""

REFITTED = 40
"""Points up to which distances are iterated again without each of them: of more, one step from the
solution is as good."""


@dataclass(frozen=True, eq=False)
class Suspects:
    """Features against the predictions of the others, points before lines.

    Parameters
    ----------
    blunders : ndarray of bool, shape (n,)
    probable : ndarray of bool, shape (n,)
        Those blunders that the features in use do not show for certain.
    undecided : ndarray of bool, shape (n,)
        Those with such an error that the others do not determine the model at their place.
    errors : ndarray, shape (n,)
        Largest error in line or sample, or of a vertex off its line, as the features in use predict
        it [px].
    limits : ndarray, shape (n,)
        Error that would be named at each feature [px].
    """

    blunders: BoolArray
    probable: BoolArray
    undecided: BoolArray
    errors: FloatArray
    limits: FloatArray

    def __post_init__(self) -> None:
        for one in (self.blunders, self.probable, self.undecided, self.errors, self.limits):
            one.setflags(write=False)  # who asks again gets the same


@dataclass(frozen=True, eq=False)
class Judged:
    """A candidate fitted to features, and its errors by leave-one-out.

    Parameters
    ----------
    candidate : Candidate
    fit : Fit
    squares : ndarray, shape (n,)
        Squared error of each feature under the same procedure without it [px^2]: of a point
        dl^2 + ds^2, of a line the sum over its vertices.
    """

    candidate: Candidate
    fit: Fit
    squares: FloatArray

    @property
    def name(self) -> str:
        """Name of the candidate."""
        return self.candidate.name

    @property
    def predicted(self) -> float:
        """RMSE by leave-one-out [px], over points and vertices of lines."""
        control = self.fit.control
        return float(np.sqrt(self.squares.sum()
                             / (len(control.points) + 2 * len(control.lines))))

    @property
    def rounding(self) -> float:
        """Errors up to which they are rounding [px]."""
        return ROUNDING * self.fit.scaling.image_scale


@dataclass(frozen=True, eq=False)
class Candidate(ABC):
    """A model that needs no search; the strategy auto chooses one of many.

    Its attributes say what place it has in the choice. It fits and judges itself. One object is
    fitted to many parts of the same features, so it keeps nothing of them.

    Parameters
    ----------
    name : str
        As in `termsel.fit` and ``termsel describe``.
    title : str
        In words, with its article, such as "a cubic polynomial".
    short : str
        Title in tables; by default the name.
    estimator : Estimator
        How its coefficients are found; with it a stored result is the same fit again.
    is_plain : bool
        Whether it takes neither selection nor shrinkage, and is plainer than a full RFM.
    has_prior : bool
        Whether a prior of its own holds what the features do not determine. Then it is chosen where
        it is better by one standard error; else it must be better by three, and have the smaller
        RMSE.
    contains : tuple of str
        Names of candidates that it has as limits. They are not chosen next to it. Where it has a
        prior, it takes the place of those among them that have one, as soon as it is called for.
    family : str
        Plural that names it together with others that have the same limits.
    needs : tuple of str
        Names of candidates without which it is not called for.
    for_few : bool
        Whether it is for features that are too few for any candidate with a prior.
    only_shown : bool
        Whether it is shown for comparison and never chosen.
    central : bool
        Whether it is a central projection, as whole images may be: two standard errors are then
        enough for it in place of three.
    from_one : bool
        Whether one feature is enough, as the candidate knows what features do not determine. Then
        two or three are not taken for a model that they determine exactly.
    most : float
        Number of features up to which it is tried: more tell as much as what it knows. Where the
        choice is repeated without some features, the number of all of them counts.
    """

    kind: ClassVar[str] = "candidate"
    """Word for it in messages."""
    name: str
    title: str
    _: KW_ONLY
    short: str = ""
    estimator: Estimator = LEAST_SQUARES
    is_plain: bool = False
    has_prior: bool = False
    contains: tuple[str, ...] = ()
    family: str = ""
    needs: tuple[str, ...] = ()
    for_few: bool = False
    only_shown: bool = False
    central: bool = False
    from_one: bool = False
    most: float = np.inf

    @property
    def label(self) -> str:
        """What tables and short sentences call it."""
        return self.short or self.name

    @property
    def summary(self) -> str:
        """What lists say of it."""
        return f"{self.title[:1].upper()}{self.title[1:]}."

    @abstractmethod
    def fit_control(self, control: Control) -> Fit:
        """Fit the candidate to features, whatever the roles of points.

        Parameters
        ----------
        control : Control
            The features with their scaling. All that is known of the image is in its features:
            the size of the image, the CRS, further columns of the file.

        Raises
        ------
        Undetermined
            If the features do not determine the candidate, or do not call for it.
        """

    def declines(self, control: Control) -> str | None:
        """Return in a sentence why it is not for such features, or None if it is.

        It is asked before every fit, so it should be quick.
        """
        return None

    def judge(self, control: Control) -> Judged | None:
        """Return the candidate fitted and judged; None without redundancy or with a pole.

        Errors are those that the estimator finds on its way (`Fit.held_out`), or those of least
        squares without each feature, in closed form.
        """
        try:
            fitted = self.fit_control(control)
        except Undetermined:
            return None
        if fitted.held_out is not None:
            return Judged(self, fitted, fitted.held_out.squares)
        if fitted.adjustment.redundancy < 1 or has_pole(fitted):
            return None
        squares = left_out_squares(fitted)
        return Judged(self, fitted, squares) if np.isfinite(squares).all() else None

    def refit(self, fitted: Fit, control: Control) -> Fit:
        """Return the final fit: the structure of a fit that was chosen, fitted to more features.

        It raises what `fit_control` does.
        """
        return self.fit_control(control)

    def describe(self, fitted: Fit) -> str:
        """Return one sentence on why the features call for it; "" if leave-one-out tells all."""
        return ""

    def nearly(self, control: Control) -> bool:
        """Return whether parts of many features may call for it where all of them do not.

        It is asked where it could not be fitted to all of them. Then it is fitted in the folds in
        which the choice is repeated, unless it says no; that saves time.
        """
        return True

    def settles(self, control: Control) -> str | None:
        """Return in a sentence why features call for this candidate alone; None if they do not.

        Such as points that were computed by the very geometry that it knows. No other candidate is
        then judged.

        Raises
        ------
        TermselError
            If they call for it alone, and it lacks something that the user must say: the run ends.
        """
        return None

    def suspects(self, control: Control) -> Suspects | None:
        """Return which features contradict what the candidate knows of the image.

        None, the default, leaves them to the test by regularised polynomials.
        """
        return None

    def model(self, heights: bool) -> SensorModel | None:
        """Return the model for features with heights, or without; None where it depends."""
        return None

    def size(self, heights: bool) -> float:
        """Return the number of terms if that is fixed; the plainest are judged first."""
        return np.inf

    @one_blas_thread
    def fit(self, features: FeatureSet) -> Fit:
        """Fit the candidate to control features.

        Parameters
        ----------
        features : FeatureSet
            Lines, and points with the role control or none, are control. Points with the role
            check, independent or off are left out.

        Raises
        ------
        TermselError
            If there is no control, the control does not determine the candidate, or it is not for
            such features.
        """
        control = Control.of(control_of(features))
        reason = self.declines(control)
        if reason is not None:
            raise TermselError(reason, hint="Choose another model, such as shrunken-cubic.")
        return self.fit_control(control)


def has_pole(fitted: Fit) -> bool:
    """Return whether a denominator falls short of the margin in a box wider than the points'.

    What no image of such a view shows, as it lies behind the camera, does not count.
    """
    control = fitted.scaled_control
    return bool(pole_violation(
        fitted.model, fitted.adjustment.coefficients[None],
        guard_points(control, no_points(), WIDER), pole_margin(control.points))[0])


def refusal(fitted: Fit) -> str:
    """Return why a fit by least squares, which is determined, is not judged; "" if it is."""
    if not fitted.estimator.least_squares:
        return ""
    if has_pole(fitted):
        return "a denominator is near zero or negative at the control or next to it (a pole)"
    if not np.isfinite(left_out_squares(fitted)).all():
        return ("without one of the features it is not determined, or has a denominator near zero "
                "or negative at its place (a pole)")
    return ""


def left_out_squares(fitted: Fit) -> FloatArray:
    """Return the squared error of each control feature under the fit without it [px^2], (n,).

    By least squares, as the criterion press judges: with equations to first order where others are
    not exact, so that this is closed form throughout; of few points the least squares of distances
    are found again without each. Infinite throughout where some feature is indispensable, and where
    a denominator falls short.
    """
    model = fitted.model
    control = fitted.scaled_control
    weighted = isinstance(model, RationalModel) and model.weighted
    equations = model.linearised(control, fitted.adjustment.coefficients) if weighted else None
    parts = independent_parts(equations or first_order(model, control), model.axis)
    solutions = solutions_without_each(parts, fitted.terms, fitted.used)
    if solutions is None:
        return np.full(len(control), np.inf)
    if weighted and len(control) <= REFITTED and not len(control.lines):
        solutions = _refitted_without_each(fitted)
    fits = Fits(model, control.points, no_points(), fitted.scaling.image_scale,
                fitted.terms[None], fitted.adjustment.coefficients[None], control.lines, parts)
    return np.asarray(fits.held_out_each(solutions[:, None])[0])


def _refitted_without_each(fitted: Fit) -> FloatArray:
    """Return the least squares of distances in the image of points without each, shape (n, k)."""
    model, control, n = fitted.model, fitted.scaled_control, len(fitted.control)
    assert isinstance(model, RationalModel)
    return model.least_distances(
        control.points, independent_parts(model.equations(control), model.axis),
        np.tile(fitted.terms, (n, 1)), ~np.eye(n, dtype=bool))


def gain_of(one: FloatArray, other: FloatArray, rounding: float = 0.0) -> float:
    """Return by how many standard errors one's squares are smaller, in logarithms.

    Errors up to `rounding` are none, and equal: of points that a model fits exactly, the logarithms
    of what is left would differ by chance, and from processor to processor.
    """
    tiny = np.finfo(float).tiny
    least = max(rounding**2, tiny)
    gain = np.log(np.maximum(other, least) / np.maximum(one, least))
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), tiny))
