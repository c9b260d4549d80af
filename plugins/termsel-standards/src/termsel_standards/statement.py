"""Figures of errors on the ground, and what standards let one say of them."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, hypot, log10

import numpy as np

from termsel.toolkit import FloatArray, count_in_words
from termsel.toolkit.files import Prediction
from termsel.toolkit.models import (
    ASPRS_POINTS,
    NSSDA_POINTS,
    OnGround,
    distance_figures,
    nssda_accuracy,
)
from termsel_standards.errors import GroundErrors

ASPRS = ("ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2, "
         "Version 2 (2024)")
"""The standard, as the statements of its section 7.16 call it."""
VERTICAL_FACTOR = 1.96
"""NSSDA's factor from the vertical RMSE to 95 % confidence (appendix 3-A)."""
MAX_POINTS, AREA_STEP, POINT_STEP = 120, 1000.0, 10
"""ASPRS, table C.1: 10 points more for every 1,000 km2 above the first, 120 at most."""
SHIFT_CHANCE = 1 / 400
"""Probability that a mean is so far off by chance, below which a note tells of a shift."""
SHIFT_POINTS = 10
"""Check points below which the mean is not tested."""
MAX_SURVEY_RATIO = 2.0
"""Ratio of the RMSE of a survey to that of the errors against it, above which one of them is wrong:
the errors contain those of the survey."""
MAX_MEAN_SHARE = 0.25
"""ASPRS: largest mean error, as a share of the RMSE of the class."""
MIN_QUADRANT_SHARE, MIN_DISTANCE = 0.2, 0.1
"""NSSDA, appendix 3-C: least share of points in a quadrant, and distance over the diagonal."""
MIN_REDUCED = NSSDA_POINTS
"""Check points below which ASPRS is not stated by a reduced number either. The 2024 edition has no
lower limit; this is that of NSSDA and of the edition of 2014, as an RMSE of fewer says little."""
# How many errors a test of normality needs.
_MIN_NORMALITY = 3


@dataclass(frozen=True)
class Component:
    """Errors along one direction [m].

    Parameters
    ----------
    name : str
    mean, deviation, rmse, percentile95, maximum : float
        Mean, standard deviation (of n - 1), RMSE, and of the absolute errors the 95th percentile
        and the largest.
    normal : float or None
        Chance of so unlike a normal distribution if they had one (Shapiro, Wilk 1965); None for
        fewer than three errors, and for equal ones.
    """

    name: str
    mean: float
    deviation: float | None
    rmse: float
    percentile95: float
    maximum: float
    normal: float | None


@dataclass(frozen=True)
class Statement:
    """What a standard lets one say.

    Parameters
    ----------
    standard : str
    value : float or None
        The figure [m].
    words : str
        The statement in the prescribed words, or why there is none.
    """

    standard: str
    value: float | None
    words: str


@dataclass(frozen=True)
class Distribution:
    """Where check points are.

    Parameters
    ----------
    points : int
    required : int
        Number that ASPRS asks for, by the area.
    area : float or None
        Area of the data that they test [km2].
    quadrants : tuple of int or None
        Points in the south-west, south-east, north-west and north-east.
    apart : float or None
        Least distance of two points, divided by the diagonal of the area.
    """

    points: int
    required: int
    area: float | None
    quadrants: tuple[int, int, int, int] | None
    apart: float | None

    @property
    def faults(self) -> tuple[str, ...]:
        """What the distribution lacks of the recommended one, as parts of sentences; () if nothing.
        """
        faults = []
        if self.quadrants and min(self.quadrants) < MIN_QUADRANT_SHARE * self.points:
            faults.append(f"a quadrant has fewer than {MIN_QUADRANT_SHARE:.0%} of the points")
        if self.apart is not None and self.apart < MIN_DISTANCE:
            faults.append(f"two points are closer than {MIN_DISTANCE:.0%} of the diagonal")
        return tuple(faults)


@dataclass(frozen=True)
class Statements:
    """Figures of errors, and what standards let one say of them.

    Parameters
    ----------
    source : str
    components : tuple of Component
        East, north, and up where it is known.
    horizontal : float
        RMSE of the distances [m].
    ce90, ce95 : float
        Distances that 90 and 95 % of the points do not exceed [m].
    vertical, le90, three_dimensional : float or None
        RMSE of heights, error that 90 % do not exceed, RMSE in space [m].
    survey_horizontal, survey_vertical : float or None
        RMSE of the survey of the check points [m].
    distribution : Distribution
    statements : tuple of Statement
    notes : tuple of str
        What a reader must know.
    prediction : str or None
        Where the check points are too few for the standards: what the run predicts, in a sentence.
    """

    source: str
    components: tuple[Component, ...]
    horizontal: float
    ce90: float
    ce95: float
    vertical: float | None
    le90: float | None
    three_dimensional: float | None
    survey_horizontal: float | None
    survey_vertical: float | None
    distribution: Distribution
    statements: tuple[Statement, ...]
    notes: tuple[str, ...]
    prediction: str | None = None


@dataclass(frozen=True)
class PredictedStatement:
    """What can be said of the accuracy without a test.

    Parameters
    ----------
    source : str
    rmse, low, high : float
        Predicted RMSE in the image and its interval [px].
    level : float
        Probability that the interval holds the RMSE.
    rmse_ground, low_ground, high_ground : float or None
        Predicted RMSE on the ground and its interval [m].
    method : str
        How it was found.
    points : int
        Points that it rests on.
    words : str
        All of it in a sentence.
    statements : tuple of Statement
        Why the standards have none.
    """

    source: str
    rmse: float
    low: float
    high: float
    level: float
    rmse_ground: float | None
    low_ground: float | None
    high_ground: float | None
    method: str
    points: int
    words: str
    statements: tuple[Statement, ...]


def prediction_statement(source: str, prediction: Prediction) -> PredictedStatement:
    """Return the statement on a predicted accuracy of the result of a source.

    ASPRS and NSSDA are not stated, as a prediction is no test.
    """
    why = "not stated, as no independent check points were measured: a prediction is no test"
    rmse, low, high = prediction.metres or (None, None, None)
    return PredictedStatement(
        source, prediction.rmse, prediction.low, prediction.high, prediction.level,
        rmse_ground=rmse, low_ground=low, high_ground=high, method=prediction.method,
        points=prediction.points, words=prediction.sentence,
        statements=(Statement("ASPRS", None, why), Statement("NSSDA", None, why)))


def statements_of(ground_errors: GroundErrors, horizontal_class: float | None = None,
                  vertical_class: float | None = None) -> Statements:
    """Return the figures of errors and the statements of ASPRS and NSSDA.

    Parameters
    ----------
    ground_errors : GroundErrors
        As `errors_of` or `read_errors` returns them.
    horizontal_class, vertical_class : float, optional
        RMSE of the accuracy class that the data were to meet [m]; by default the least class of two
        digits that they meet.

    Returns
    -------
    Statements
        Figures along each axis, in the plane and in space [m], and the sentences.

    Notes
    -----
    The words are those of ASPRS, edition 2, version 2, section 7.16. With fewer than 30 check
    points they are those for a reduced number; with fewer than 20 none is stated. Of the 3D
    statement the part on vegetated ground is left out, as nothing shows which points are there.

    ASPRS, edition 2, adds the error of the survey: the horizontal accuracy is the root of the sum
    of the squares of the RMSE against the check points and of the RMSE of their survey, and the
    vertical one likewise. The three-dimensional accuracy is the root of the sum of the squares of
    both. NSSDA takes the survey as free of errors.

    Examples
    --------
    >>> import termsel
    >>> from termsel_standards import errors_of, statements_of
    >>> result = termsel.run("poly-terms", evaluations=200, options={"degree": 2})
    >>> stated = statements_of(errors_of(result))
    >>> stated.statements[0].standard
    'ASPRS horizontal'
    """
    errors = ground_errors.errors
    n, axes = errors.shape
    components = tuple(_component_figures(name, errors[:, i])
                       for i, name in enumerate(("east", "north", "up")[:axes]))
    distances = np.linalg.norm(errors[:, :2], axis=1)
    figures = distance_figures(OnGround, errors[:, :2])
    # ASPRS 2024: RMSE^2 against the check points plus RMSE^2 of their survey.
    survey_horizontal = _survey_rmse(ground_errors.survey[:, :2])
    survey_vertical = _survey_rmse(ground_errors.survey[:, 2:]) if axes > 2 else None
    # A survey that is not known counts as free of errors, and a note says so.
    horizontal_with_survey = hypot(figures.total, survey_horizontal or 0.0)
    vertical = components[2].rmse if axes > 2 else None
    vertical_with_survey = None if vertical is None else hypot(vertical, survey_vertical or 0.0)
    three_dimensional = (None if vertical_with_survey is None
                         else hypot(horizontal_with_survey, vertical_with_survey))
    distribution = distribution_of(ground_errors)
    vegetated_sentence = "not stated, as it is not known which check points are under vegetation"
    if vertical_with_survey is None:
        vegetated_sentence = "not stated, as no heights were tested"
    by_nssda = nssda_accuracy(n, figures)
    if by_nssda.value is None:
        nssda_sentence = f"not stated: {by_nssda.reason}"
    else:
        nssda_sentence = (f"Tested {_size_text(by_nssda.value)} meters horizontal accuracy at 95% "
                          "confidence level")
    too_few = f"{count_in_words(n, 'independent point')}, at least {NSSDA_POINTS} needed"
    # The errors found contain those of the survey: a survey said to be worse is a wrong statement.
    horizontal = _asprs_statement("horizontal", n, horizontal_with_survey, horizontal_class)
    if survey_horizontal is not None and survey_horizontal > MAX_SURVEY_RATIO * figures.total:
        horizontal = Statement("ASPRS horizontal", horizontal_with_survey,
                               "not stated, as the error stated for the survey is larger than the "
                               "errors found, which contain it")
    statements = (
        horizontal,
        _asprs_statement("vertical", n, vertical_with_survey, vertical_class),
        _asprs_statement("three-dimensional", n, three_dimensional, None),
        Statement("ASPRS vegetated vertical", None, vegetated_sentence),
        Statement("NSSDA horizontal", by_nssda.value, nssda_sentence),
        _nssda_vertical(vertical, too_few if n < NSSDA_POINTS else None))
    # The mean error is held against the class that is stated, be it asked for or the least met.
    classes = (_stated_class(n, horizontal_with_survey, horizontal_class),
               _stated_class(n, vertical_with_survey, vertical_class))
    notes = _limiting_notes(ground_errors, figures.total, survey_horizontal, distribution,
                            components, classes)
    return Statements(
        source=ground_errors.source, components=components, horizontal=figures.total,
        ce90=figures.ce90, ce95=float(np.quantile(distances, 0.95)), vertical=vertical,
        le90=float(np.quantile(np.abs(errors[:, 2]), 0.9)) if axes > 2 else None,
        three_dimensional=None if vertical is None else hypot(figures.total, vertical),
        survey_horizontal=survey_horizontal, survey_vertical=survey_vertical,
        distribution=distribution, statements=statements, notes=tuple(notes))


def _component_figures(name: str, errors: FloatArray) -> Component:
    """Return the figures of the errors (n,) along one axis [m], of at least one point.

    `name` is that of the axis: "east", "north" or "up".
    """
    n = len(errors)
    size = np.abs(errors)
    # Shapiro and Wilk's test divides by the scatter, which is 0 for equal errors.
    normal = None
    if n >= _MIN_NORMALITY and np.ptp(errors) > 0:
        # SciPy's statistics take long to import, and some statements need none.
        from scipy.stats import shapiro

        normal = float(shapiro(errors).pvalue)
    return Component(
        name, mean=float(errors.mean()), deviation=float(errors.std(ddof=1)) if n > 1 else None,
        rmse=float(np.sqrt((errors**2).mean())), percentile95=float(np.quantile(size, 0.95)),
        maximum=float(size.max()), normal=normal)


def _survey_rmse(sigma: FloatArray) -> float | None:
    """Return the RMSE of a survey by the standard deviations of its coordinates, (n, d) [m].

    None if any is not known (NaN).
    """
    # RMSE^2 is the mean over the points of the sum of sigma^2 over the d coordinates.
    if np.isnan(sigma).any():
        return None
    return float(np.sqrt((sigma**2).sum(axis=1).mean()))


_CLASS_AND_FIGURE = {
    "horizontal": ("RMSEH Horizontal Positional Accuracy Class",
                   "tested horizontal positional accuracy was found to be RMSEH = {}"),
    "vertical": ("RMSEV Vertical Accuracy Class",
                 "Non-Vegetated Vertical Accuracy (NVA) was found to be RMSEV = {}"),
    "three-dimensional": ("RMSE3D Three-Dimensional Positional Accuracy Class",
                          "tested three-dimensional accuracy was found to be RMSE3D = {} within "
                          "the NVA tested area")}
"""Name of the class, and sentence on the figure, in the statements of ASPRS by direction."""


def _asprs_statement(direction: str, points: int, value: float | None,
                     stated_class: float | None) -> Statement:
    """Return the statement of ASPRS on an RMSE [m], or a statement that says why there is none.

    `direction` is "horizontal", "vertical" or "three-dimensional"; `points` is how many check
    points there are; `stated_class` is the class to test [m], None for the least that is met.
    There is none without a value, with too few points, or if the class is not met.
    """
    name = f"ASPRS {direction}"
    if value is None:
        return Statement(name, None, "not stated, as no heights were tested")
    if points < MIN_REDUCED:
        return Statement(name, value, f"not stated: {count_in_words(points, 'check point')}; at "
                         f"least {MIN_REDUCED} are needed for a statement by a reduced number, "
                         f"and {ASPRS_POINTS} for the full one")
    # Without a class to test, the data are said to meet the least class that they do meet.
    class_ = class_of(value) if stated_class is None else stated_class
    kind, figure_words = _CLASS_AND_FIGURE[direction]
    if value > class_:
        return Statement(name, value, f"not stated, as {_in_statement_unit(value)} is above the "
                         f"{_in_statement_unit(class_)} of the class")
    figure = "The " + figure_words.format(_in_statement_unit(value))
    # The words are prescribed by the standard, with others for fewer than 30 points.
    if points >= ASPRS_POINTS:
        return Statement(name, value, f"This data set was tested to meet {ASPRS} for a "
                         f"{_in_statement_unit(class_)} {kind}. {figure}")
    return Statement(
        name, value, f"This data set was tested as required by {ASPRS}. Although the Standards "
        f"call for a minimum of thirty (30) checkpoints, this test was performed using ONLY "
        f"{points} checkpoints. This data set was produced to meet a {_in_statement_unit(class_)} "
        f"{kind}. {figure} using the reduced number of checkpoints")


def _stated_class(points: int, value: float | None, asked: float | None) -> float | None:
    """Return the class [m] that a statement on an RMSE [m] has; None if there is no statement.

    `asked` is the class to test; without one it is the least that is met.
    """
    if asked is not None or value is None or points < MIN_REDUCED:
        return asked
    return class_of(value)


def class_of(value: float) -> float:
    """Return the least class [m], a number of two digits, that an RMSE [m] meets; 0 for 0."""
    if value <= 0:
        return 0.0
    # The unit of the second digit: 0.1 for 1 to 9.9.
    unit = 10.0 ** (floor(log10(value)) - 1)
    # The term lets a value be in a class that it exceeds by rounding alone.
    return float(f"{ceil(value / unit - 1e-9) * unit:.10g}")


def _nssda_vertical(vertical: float | None, too_few: str | None) -> Statement:
    """Return the statement of NSSDA on a vertical RMSE [m], or one that says why there is none.

    There is none if `vertical` is None, as no heights were tested, or if `too_few` is not None: the
    words for too few points.
    """
    if vertical is None or too_few:
        return Statement("NSSDA vertical", None, "not stated, as no heights were tested"
                         if vertical is None else f"not stated: {too_few}")
    value = VERTICAL_FACTOR * vertical
    return Statement("NSSDA vertical", value,
                     f"Tested {_size_text(value)} meters vertical accuracy "
                     "at 95% confidence level")


def distribution_of(ground_errors: GroundErrors) -> Distribution:
    """Return the number of check points, the number that ASPRS asks for, and their distribution.

    The area [km2] is that of the corners of the check area, or of the box of the points. If a
    position is not known, area, quadrants and distances are None, and the number asked for is that
    of a small area.
    """
    n = len(ground_errors.ids)
    positions = ground_errors.positions
    if not np.isfinite(positions).all():
        return Distribution(n, ASPRS_POINTS, None, None, None)
    low = positions.min(axis=0)
    high = positions.max(axis=0)
    corners = ground_errors.area
    if corners is None:
        corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    x, y = corners.T
    # The shoelace formula, in km2.
    area = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2e6
    required = ASPRS_POINTS + POINT_STEP * max(ceil(area / AREA_STEP) - 1, 0)
    # Quadrants are those of the area, not of the points.
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    east, north = (positions >= middle).T
    quadrants = tuple(int(quadrant.sum()) for quadrant in (
        ~east & ~north, east & ~north, ~east & north, east & north))
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    separations = np.linalg.norm(positions[:, None] - positions[None],
                                 axis=2)[np.triu_indices(n, 1)]
    return Distribution(n, min(required, MAX_POINTS), area,
                        (quadrants[0], quadrants[1], quadrants[2], quadrants[3]),
                        float(separations.min()) / diagonal if n > 1 and diagonal > 0 else None)


def _limiting_notes(ground_errors: GroundErrors, total: float, survey: float | None,
                    distribution: Distribution, components: tuple[Component, ...],
                    classes: tuple[float | None, float | None]) -> list[str]:
    """Return sentences on what limits the figures; [] if nothing does.

    They are on the number and distribution of points, blunders, the survey and shifts. `total` is
    the horizontal RMSE and `survey` that of the survey [m]; `classes` are the horizontal and the
    vertical class to test [m], if any.
    """
    from scipy.stats import t as student

    notes = []
    # With fewer points than `ASPRS_POINTS`, the statement says so.
    if ASPRS_POINTS <= len(ground_errors.ids) < distribution.required:
        notes.append(f"ASPRS asks for {distribution.required} check points for this area; this is "
                     f"a test by {count_in_words(len(ground_errors.ids), 'check point')}.")
    if ground_errors.blunders:
        notes.append(f"{', '.join(ground_errors.blunders)}: all other points contradict "
                     f"{'it' if len(ground_errors.blunders) == 1 else 'them'}. Look at the image "
                     "before you file these figures.")
    if survey is None:
        notes.append("The error of the survey is not known and not included: give columns sigma_x "
                     "and sigma_y, or --survey-sigma.")
    elif survey > MAX_SURVEY_RATIO * total:
        notes.append(f"The survey is said to be off by {_size_text(survey)} m, and the errors "
                     f"found are {_size_text(total)} m. Check --survey-sigma or the columns "
                     "sigma_x and sigma_y: "
                     "they are in metres.")
    elif survey > total / 2:
        notes.append("The check points are not twice as accurate as what they test.")
    notes += [f"Check points: {fault}." for fault in distribution.faults]
    n = len(ground_errors.ids)
    for component in components:
        # Student's distribution allows for the chance of few points. Below `SHIFT_POINTS` even that
        # is not enough, as errors that neighbours share look like a shift.
        bound = student.ppf(1.0 - SHIFT_CHANCE / 2, n - 1) / n**0.5 if n >= SHIFT_POINTS else np.inf
        if component.deviation and abs(component.mean) > bound * component.deviation:
            notes.append(f"The mean error {component.name} is significant (Student's t of {n} "
                         f"check points, p < {SHIFT_CHANCE}): look for a shift.")
        limit = classes[component.name == "up"]
        if limit is not None and abs(component.mean) > MAX_MEAN_SHARE * limit:
            notes.append(f"The mean error {component.name} is above {MAX_MEAN_SHARE:.0%} of "
                         "the RMSE of the class, ASPRS's limit: look for its cause.")
    return notes


def _in_statement_unit(value: float) -> str:
    """Return a length [m] in centimetres, the unit of the statements of ASPRS."""
    return f"{_size_text(100 * value)} cm"


def _size_text(value: float) -> str:
    """Return a length to three digits, or to whole units if it has four or more."""
    return f"{value:.3g}" if value < 999.5 else f"{value:.0f}"
