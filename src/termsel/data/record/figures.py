"""Parts of a record that show how good a fit is: RMSE, accuracy, diagnosis."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import log, nan, sqrt
from statistics import NormalDist
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType, field

from termsel.core.arguments import Explained
from termsel.core.errors import count_in_words
from termsel.data.record.chances import chi_squared_quantile, t_quantile

# What all parts of a record have in common: their kinds of values, and their JSON.
#
# msgspec was chosen over cattrs by measurement. It decodes the record of a run of auto, 28 kB, in
# 0.2 ms; cattrs takes 2 ms, the first time 160 ms, as it generates code. It is imported in 23 ms,
# cattrs in 35. It refuses unknown keys, values of another type and numbers out of range, and names
# their place. It generates the JSON Schema, for which cattrs has nothing, and it is one wheel
# without dependencies.

Name = Annotated[str, Meta(pattern=r"^\S+$")]
Names = Annotated[tuple[str, ...], Meta(extra_json_schema={"uniqueItems": True})]
Count = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]
Size = Annotated[float, Meta(ge=0)]
Scale = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Checksum = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$")]
Role = Literal["control", "check", "independent"]
Roles = Annotated[tuple[Role, ...], Meta(extra_json_schema={"uniqueItems": True})]
Value = str | float | int | bool | None
Settings = dict[str, Value]
Objectives = Mapping[str, int | float | None]
"""Objectives by name; counts are whole numbers."""


class RecordPart(Explained, msgspec.Struct, frozen=True, forbid_unknown_fields=True,
                 omit_defaults=True):
    """A part of the record. Keys with a default are left out where they have it."""


def as_plain_data(record_part: Any) -> dict[str, Any]:
    """Return a part of the record as dicts, lists, text and numbers, as JSON has them.

    NaN and infinity become None, and numbers of numpy become those of Python.
    """
    content: dict[str, Any] = _as_json(msgspec.to_builtins(
        record_part, enc_hook=lambda value: value.item()))
    return content


def _as_json(value: Any) -> Any:
    """Return a value with lists for tuples, and None for NaN and infinity, as JSON can hold it.

    msgspec's own JSON cannot be used: it refuses text that is not UTF-8, as file names may be.
    """
    if isinstance(value, dict):
        return {key: _as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


CONFIDENCE = 0.9
"""Probability of an interval."""

RARE = 0.01
"""Chance of a measured RMSE beyond its prediction, below which the prediction was wrong."""

FEW_EVALUATIONS = 1000
"""Evaluations below which a search that finds no selection shows nothing of the model."""

TOO_FEW = "which is too few"
"""What the judgement of a search says whose evaluations were too few to find a selection."""

NO_FIGURE = "gives no finite figure"
"""What the judgement of a search says whose criterion has no figure for the best selection."""

EXACTLY = "the model exactly"
"""What `is_determined_exactly` ends with."""

MANY_INDEPENDENT = 20
"""Number of independent points below which the predicted RMSE is shown before theirs: it varies
less, and its interval holds more often (docs/evidence/intervals.md)."""

SIGNIFICANT = 0.05
"""Chance below which a coefficient is called significant."""


def is_determined_exactly(number: int, noun: str) -> str:
    """Return that as many features determine all coefficients, so that no errors are left over."""
    return f"{count_in_words(number, noun)} determine{'s' if number == 1 else ''} {EXACTLY}"


def rmse_interval(total: float, freedom: float) -> tuple[float, float]:
    """Return the interval (low, high) of the RMSE [px] that endlessly many such points would have.

    `total` is the RMSE of the points at hand. The sum of squares of independent errors has a
    chi-squared distribution with `freedom` degrees: two for each point if its errors are normal and
    alike in line and sample, otherwise fewer.
    """
    # freedom * s^2 / sigma^2 is chi-squared, so that sigma = s * sqrt(freedom / quantile).
    tail = (1 - CONFIDENCE) / 2
    # Far below one degree the lower quantile is 0, and the interval would have no upper end.
    freedom = max(freedom, 1.0)
    return (total * sqrt(freedom / chi_squared_quantile(1 - tail, freedom)),
            total * sqrt(freedom / chi_squared_quantile(tail, freedom)))


@dataclass(frozen=True)
class Rmse:
    """Root mean square errors [px] over n features.

    `total` is sqrt(mean(dl^2 + ds^2)) over points. For control lines the error is the
    distance of each projected ground vertex from the image line, taken along its normal.
    """

    line: float
    sample: float
    total: float
    n: int
    freedom: float | None = None
    """Degrees of freedom of the squared errors, by `freedom_of`; None if not known."""


class RoleRmse(RecordPart, frozen=True):
    """RMSE over the features of one role [px]; null where there are none."""

    line: Size | None
    """Along lines [px]."""
    sample: Size | None
    """Along samples [px]."""
    total: Size | None
    """Of the distances [px]."""
    n: Count
    """Number of features."""
    freedom: Size | None = None
    """Degrees of freedom of the squared errors; absent where they are two of a feature."""

    @property
    def interval(self) -> tuple[float, float] | None:
        """Interval of the RMSE of endlessly many such points [px]; None without a total."""
        return rmse_interval(self.total, self.freedom or 2 * self.n) if self.total else None


class RmseByRole(RecordPart, frozen=True):
    """RMSE by role [px]."""

    control: RoleRmse
    """Over control features in use."""
    check: RoleRmse
    """Over selection points; the fitness where the objective is check-rmse, or a fit to them."""
    independent: RoleRmse
    """Over independent points; the accuracy."""
    leave_one_out: RoleRmse | None = field(name="leave-one-out", default=None)
    """Over control, each feature held out once, under models that the control corrects."""

    @property
    def by_role(self) -> dict[str, RoleRmse]:
        """The RMSE by the key of its role, with "leave-one-out" if it was computed."""
        # Absent, not null: most problems have no leave-one-out.
        of_roles = {"control": self.control, "check": self.check, "independent": self.independent}
        return of_roles if self.leave_one_out is None else {
            **of_roles, "leave-one-out": self.leave_one_out}

    def __iter__(self) -> Iterator[str]:
        return iter(self.by_role)

    def __getitem__(self, role: str) -> Rmse | None:
        """Return the RMSE of a role, or that by "leave-one-out"; None if it has no features.

        Its line, sample and total are NaN where the record has None.

        Raises
        ------
        KeyError
            If there is no such role.
        """
        if role not in self.by_role:
            raise KeyError(f"there is no RMSE of {role!r}, but of {', '.join(self.by_role)}")
        rmse = self.by_role[role]
        if not rmse.n:
            return None
        line, sample, total = (nan if value is None else value
                               for value in (rmse.line, rmse.sample, rmse.total))
        return Rmse(line, sample, total, rmse.n, rmse.freedom)


class BaselineRow(RecordPart, frozen=True):
    """A fit without a search, for comparison."""

    name: Name
    """Name of the structure; `all-terms` is the conventional fit."""
    n_terms: Count
    """Number of terms."""
    fitted_to: Roles
    """Roles of the points it was fitted to."""
    determined: bool
    """False if the points do not determine it, or its fit did not converge; its figures are then
    those of the least-norm solution, or of the last step."""
    predicted: float | None
    """RMSE by leave-one-out [px] where it was computed."""
    rmse: RmseByRole
    """RMSE by role [px]."""
    refused: str | UnsetType = UNSET
    """Why a choice left it out, though the points determine it."""


class Outlier(RecordPart, frozen=True, omit_defaults=False):
    """A feature that all others contradict."""

    id: str
    """Id of the feature."""
    kind: Literal["point", "line"]
    """What it is."""
    role: Role
    """Its role before it was left out."""
    error: Size
    """Its error [px]: of a point the larger in line and sample, of a line the largest distance of
    a vertex, as the others predict it."""
    certainty: Literal["certain", "probable", "possible"]
    """Whether it is a blunder: certainly; more likely than not; or the others are too few or too
    far to show."""
    excluded: bool
    """Whether the fit does without it."""


class BlunderTest(RecordPart, frozen=True, omit_defaults=False):
    """What the test of control and check features for blunders could find."""

    features: int
    """Number of features that were tested."""
    limit: Size | None
    """Error that half of them must exceed to be found for certain [px]; null where they are too few
    for any test."""
    extent: Size
    """Larger side of the box around them in the image [px]."""


class Predicted(RecordPart, frozen=True, omit_defaults=False):
    """A predicted RMSE with its interval."""

    rmse: Size
    """Of points held out in folds, and of what heights of independent points add [px]."""
    low: Size
    """Lower end of the interval [px]."""
    high: Size
    """Upper end of the interval [px]."""
    level: Share = CONFIDENCE
    """Probability that the interval holds the RMSE."""
    points: Positive | None = None
    """Number of independent points whose RMSE the interval is for; null for the true accuracy."""
    pixel: Size | None = None
    """How far a pixel is on the ground [m]; null where the CRS or the model does not show."""
    weighted: Literal[True] | UnsetType = UNSET
    """True if points state unlike standard deviations: their squared errors then count by the
    inverse squares of these; absent otherwise."""

    def chance_beyond(self, measured: float) -> float:
        """Return the one-sided chance of a measured RMSE as far above, or below, the predicted one.

        The interval is taken as that of a log-normal distribution. The chance is 0 if the interval
        or the measured RMSE is not positive.
        """
        if not 0.0 < self.low < self.high or measured <= 0.0:
            return 0.0
        level = NormalDist().inv_cdf(0.5 + self.level / 2.0)
        spread = log(self.high / self.low) / (2.0 * level)
        middle = log(self.high * self.low) / 2.0
        return 1.0 - NormalDist().cdf(abs(log(measured) - middle) / spread)


class Errors(RecordPart, frozen=True, kw_only=True):
    """Errors of independent points, in the image [px] or on the ground [m]."""

    n: Count
    """Number of points."""
    total: Size
    """RMSE of the distances."""
    maximum: Size
    """Largest distance."""
    ce90: Size
    """Distance that nine in ten points do not exceed."""
    mean: tuple[float, float] | None = None
    """Mean errors, of line and of sample, or of x and of y."""
    normal: tuple[float, float] | None = None
    """Of each axis the chance that normal errors look so little normal (Shapiro and Wilk 1965);
    absent for fewer than 8 points, more than 5000, or equal errors."""
    freedom: Size | None = None
    """Degrees of freedom of the squared errors; absent where they are two of a point."""

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the RMSE of endlessly many such points."""
        return rmse_interval(self.total, self.freedom or 2 * self.n) if self.total else (0.0, 0.0)


class InImage(Errors, frozen=True, kw_only=True):
    """Errors of independent points in the image [px]."""

    line: Size
    """RMSE of line."""
    sample: Size
    """RMSE of sample."""


class OnGround(Errors, frozen=True, kw_only=True):
    """Errors of independent points on the ground, each at its height [m]."""

    x: Size
    """RMSE along x, which is to the east in most CRSs."""
    y: Size
    """RMSE along y, which is to the north in most CRSs."""


class StandardFigure(RecordPart, frozen=True, omit_defaults=False):
    """A figure of a standard, or why there is none."""

    value: float | None
    """The figure [m], or null."""
    reason: str | None = None
    """Why there is no figure, or null."""


class Accuracy(RecordPart, frozen=True):
    """The accuracy on independent points."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        "rmse": "It is accuracy.image.total [px]; by roles, result.rmse.",
        "mae": "The RMSE is accuracy.image.total [px].",
        "ce90": "termsel.ce90(errors) computes it.",
        "std": "The RMSE is accuracy.image.total [px].",
        "value": "The RMSE is accuracy.image.total [px].",
        "px": "The RMSE is accuracy.image.total [px].",
        "n": "It is accuracy.image.n."}

    image: InImage
    """In the image [px]."""
    ground: OnGround | None
    """On the ground, at the height of each point [m]; null where it is not known in metres."""
    nssda: StandardFigure
    """Horizontal accuracy by NSSDA at 95 % confidence."""
    asprs: StandardFigure
    """Horizontal RMSE by ASPRS 2024, without the error of the check points' survey."""
    spent_by: Names | None = None
    """Folders of earlier results that showed errors of these points under another fit; absent where
    none did."""
    spent: Names | None = None
    """Ids of the points that these showed; absent where `spent_by` is."""

    @property
    def spent_count(self) -> int:
        """Number of points whose errors an earlier result showed under another fit."""
        # A point without a finite error is not among the n.
        return min(len(self.spent or ()), self.image.n)


class Significance(RecordPart, frozen=True):
    """A coefficient against zero."""

    t: float
    """The coefficient divided by its standard deviation."""
    p: Share
    """Chance of so large a t if the coefficient were zero (two-sided Student test)."""


class SensorFigure(RecordPart, frozen=True):
    """A figure of the sensor that the coefficients stand for, such as the angle omega."""

    name: str
    """What it is."""
    value: float
    """Its value."""
    unit: str
    """Its unit: px, deg, m, or the foot of the CRS: ft or us-ft."""
    standard_deviation: float | None = None
    """Its standard deviation, in the same unit; null where it is not known."""


class Correlation(RecordPart, frozen=True):
    """Two coefficients that correlate."""

    terms: tuple[str, str]
    """The two terms."""
    correlation: Annotated[float, Meta(ge=-1, le=1)]
    """Their correlation."""


class AdjustmentFigures(RecordPart, frozen=True):
    """Figures of the least-squares adjustment."""

    equations: Count
    """Number of equations."""
    terms: Count
    """Number of terms; effective parameters, rounded, of a regularised polynomial."""
    redundancy: int
    """Equations less terms."""
    rank: Count
    """Rank of the design matrix."""
    condition: float | None
    """Ratio of extreme singular values, columns scaled to one length; null if infinite."""
    sigma0: float | None
    """Standard deviation of unit weight [px]."""
    orientation_spread: float | None
    """1 if control lines of all directions occur equally, 0 if all are parallel; null without
    lines."""
    steps: Count | None = None
    """Gauss-Newton steps of a fit whose equations are not exact."""
    converged: bool | None = None
    """Whether these steps converged."""

    @property
    def least_t(self) -> float:
        """The t from which on a coefficient is significant, for a redundancy of 1 or more."""
        # Two-sided: a coefficient may be too large in either direction.
        return t_quantile(1 - SIGNIFICANT / 2, self.redundancy)
