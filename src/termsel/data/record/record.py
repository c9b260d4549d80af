"""The record of a run: the content of result.json, from its data to its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from msgspec import Meta, field

from termsel.data.record.figures import (
    Accuracy,
    AdjustmentFigures,
    BaselineRow,
    BlunderTest,
    Checksum,
    Correlation,
    Count,
    Name,
    Names,
    Objectives,
    Outlier,
    Positive,
    Predicted,
    RecordPart,
    RmseByRole,
    Scale,
    SensorFigure,
    Settings,
    Share,
    Significance,
    Size,
)
from termsel.data.record.search import (
    Certificate,
    HistoryRow,
    Member,
    Polish,
    SearchLimits,
    SelectionRecord,
    SizeRow,
    Strategy,
    TermFrequencies,
)

RESULT_SCHEMA: Final = "termsel-result-1"
"""Name and version of the layout."""


class Options(RecordPart, frozen=True):
    """Options as used, those by default included."""

    problem: Settings
    """Options of the problem."""
    data: Settings
    """Options of the data: roles, shares, coordinates of the fit."""
    model: Settings
    """Options of the model."""
    solver: Settings
    """Options of the solver."""
    criterion: Settings
    """Options of the criterion."""
    search: Settings
    """Options of any search: local refinement, tolerance."""
    then: Settings | None = None
    """Options of the second step's solver, if it is another one."""


class Counts(RecordPart, frozen=True):
    """Numbers of features by role."""

    control: Count
    """Control points."""
    check: Count
    """Check points."""
    independent: Count
    """Independent points."""
    lines: Count
    """Control lines."""
    off: Count
    """Features that took no part."""

    @property
    def word(self) -> str:
        """The word for the control: points, lines, or features if it is both."""
        if not self.lines:
            return "points"
        return "features" if self.control else "lines"


class IdsByRole(RecordPart, frozen=True):
    """Ids of features by role."""

    control: Names
    """Control points and lines."""
    off: Names
    """Features that took no part."""
    check: Names
    """Check points."""
    independent: Names
    """Independent points."""


class ImageFile(RecordPart, frozen=True):
    """What the file of an image is recognised by."""

    name: str
    """Name of the file, without its folder."""
    size: Count
    """Bytes of the file."""
    digest: str
    """Digest of the file, of a large one of its beginning and its end."""


class WhatWasRead(RecordPart, frozen=True):
    """What the files or the data set held."""

    points: Count
    """Number of points."""
    lines: Count
    """Number of lines."""
    without_height: Count
    """How many of these have no height."""
    place: str
    """Latitude and longitude of the middle, such as "34.8 N, 48.5 E"; empty where nothing shows."""
    doubt: str
    """Which axes look swapped, and why; empty if none do."""
    left_out: Mapping[str, Names]
    """Ids of what takes no part, by the reason; without blunders, which are `outliers`."""
    z_unit: str = ""
    """Unit of z and what shows it, where that was open or is not metres."""
    height_doubt: str = ""
    """How far a DEM is from the heights of control, where it contradicts them."""
    two_groups: str = ""
    """Which points lie a constant shift from the others, as if in another datum."""
    image_origin: str = ""
    """Where the file counted lines and samples from, where that was stated or told by its values;
    the result counts from the centre of the upper-left pixel."""
    lattice: tuple[Count, Count] | None = None
    """Lines and columns of the lattice that the points are: computed, not measured."""
    mixed: str = ""
    """Which coordinates look as if typed in another form than decimal degrees, or of a second zone
    of UTM."""
    set_aside: Count = 0
    """How many points became independent check points though no role says so."""
    image: ImageFile | None = None
    """The file of the image, where one was given."""


class RpcNumbers(RecordPart, frozen=True):
    """The vendor's RPC of the image."""

    image_offset: tuple[float, float]
    """Of line and sample [px]."""
    image_scale: tuple[float, float]
    """Of line and sample [px]."""
    ground_offset: tuple[float, float, float]
    """Of longitude, latitude [deg] and ellipsoidal height [m]."""
    ground_scale: tuple[float, float, float]
    """Of longitude, latitude [deg] and ellipsoidal height [m]."""
    line_numerator: tuple[float, ...]
    """In RPC00B order, as the other three."""
    line_denominator: tuple[float, ...]
    """Of the line."""
    sample_numerator: tuple[float, ...]
    """Of the sample."""
    sample_denominator: tuple[float, ...]
    """Of the sample."""
    error_bias: float | None = None
    """Root mean square of the bias [m], if the vendor states it."""
    error_random: float | None = None
    """Root mean square of the random error [m], if the vendor states it."""
    source: str = ""
    """Name of its file."""
    control_count: int = 0
    """Number of features that termsel fitted it to; 0 for one that a vendor made."""
    control_digests: tuple[str, ...] = ()
    """What these features are recognised by."""


class DataRecord(RecordPart, frozen=True):
    """What the result was made from."""

    source: str
    """Files or data set."""
    sha256: Checksum
    """Checksum of ids, coordinates, roles, standard deviations and CRS as read."""
    crs: str
    """CRS of the features."""
    fit_crs: str
    """CRS in which the model was fitted."""
    heights: str | None
    """What heights refer to, and whether a DEM gave them; null if nothing says so."""
    noise: Size | None
    """Standard deviation of line and of sample [px] if it is known, as in simulated data."""
    image_size: tuple[Positive, Positive] | None
    """Lines and samples of the image, or null."""
    counts: Counts
    """Numbers of features by role."""
    roles: IdsByRole
    """Ids of features by role."""
    read: WhatWasRead | None = None
    """What was read."""
    rpc: RpcNumbers | None = None
    """The vendor's RPC of the image, if one is given."""


class Offered(RecordPart, frozen=True):
    """What there was to select from."""

    n_terms: Count
    """Terms of the model."""
    n_features: Count
    """Control features."""


class ScalingNumbers(RecordPart, frozen=True):
    """Offsets and scales between coordinates and scaled coordinates."""

    line_offset: float
    """[px]"""
    line_scale: Scale
    """[px]"""
    sample_offset: float
    """[px]"""
    sample_scale: Scale
    """[px]"""
    x_offset: float
    """In the unit of x."""
    y_offset: float
    """In the unit of y."""
    z_offset: float
    """In the unit of z."""
    x_scale: Scale
    """In the unit of x."""
    y_scale: Scale
    """In the unit of y."""
    z_scale: Scale
    """In the unit of z."""
    crs: str = ""
    """CRS of the features, where x, y and z are transformed before the fit."""
    fit_crs: str = ""
    """CRS of the fit, where x, y and z are transformed before the fit."""
    x_turn: float = 0.0
    """360 where x is a longitude, which is the same after a full turn."""
    x_start: float | None = None
    """x at which a map of more than half of the world begins; null for other images."""


class FitRecord(RecordPart, frozen=True):
    """How the coefficients were found: all that is needed to be the same fit again."""

    estimator: Name
    """Name of the estimator; `given` where coefficients are a solver's own."""
    options: Settings
    """Options of the estimator, such as whether the iteration for lines was run."""
    effective: float | None
    """Effective parameters where coefficients are shrunk; null elsewhere or if unknown."""
    held_out: tuple[tuple[float, float], ...] | None
    """Measured minus predicted line and sample of each feature in use under the same procedure
    without it [px], of lines for each vertex, where the estimator finds them on its way."""
    features: Names | None
    """Ids of all features it was fitted to, selection points included and twins as one; null where
    these are the control features of the selection."""


class FinalFit(RecordPart, frozen=True):
    """The chosen structure fitted to all points, independent ones included."""

    features: Names
    """Ids of the points it is fitted to."""
    scaling: ScalingNumbers
    """As the key `scaling`."""
    coefficients: Mapping[str, float]
    """Coefficients by term, in scaled coordinates."""
    standard_deviations: Mapping[str, float | None]
    """As the key `standard_deviations`."""
    adjustment: AdjustmentFigures
    """As the key `adjustment`."""
    fit: FitRecord
    """As the key `fit`."""
    predicted: Predicted | None = None
    """RMSE predicted for this fit: that of the key `predicted`, less what the independent points
    add by their places; null where none is."""


class PluginRecord(RecordPart, frozen=True):
    """What provides a part of the run."""

    name: Annotated[str, Meta(pattern=":")]
    """Name as distribution:name."""
    version: str
    """Version of the distribution."""
    class_: str | None = field(name="class", default=None)
    """Module and class, where no plugin provides it."""


class Checksums(RecordPart, frozen=True):
    """Checksums by which `termsel.read_result` refuses a result that was changed."""

    record: Checksum
    """Of the content of result.json without this key, whatever its layout."""
    features: Checksum
    """Of the features in the folder."""
    attributes: Checksum | None = None
    """Of the further columns of their files, if there are any."""


class Record(RecordPart, frozen=True, kw_only=True):
    """The content of result.json.

    `Result` is a record, and holds the fits that it is of as `fit` and `final`. What the file has
    under these names are numbers of theirs, and has other names here.
    """

    schema: Literal["termsel-result-1"]
    """Name and version of this layout."""
    problem: Name
    """Name of the problem, as given."""
    model: Name
    """Name of the model that was fitted."""
    solver: Name
    """Name of the solver; `auto` for the strategy auto."""
    criterion: Name
    """Name of the criterion."""
    seed: Count
    """Seed of the search."""
    options: Options
    """Options as used, those by default included."""
    data: DataRecord
    """What the result was made from."""
    selection: SelectionRecord
    """Terms and control features in use."""
    offered: Offered
    """What there was to select from."""
    feasible: bool
    """False if no selection satisfied all conditions."""
    objectives: Objectives
    """Objectives of the search at the selection, by name; the criterion is one of them."""
    rmse: RmseByRole
    """RMSE by role [px]; that of the independent points is the accuracy."""
    baselines: tuple[BaselineRow, ...]
    """Fits without a search, for comparison."""
    judgement: Annotated[str, Meta(min_length=1)]
    """The sentences of the report that say what the result is worth."""
    notes: tuple[str, ...]
    """Further sentences of the report."""
    reference: str = ""
    """Name of the baseline that the judgement compares with: the automatic choice without a search,
    or of that choice the best conventional model; empty if there is none."""
    outliers: tuple[Outlier, ...]
    """The outlier test: every feature that contradicts all others, used or not."""
    blunder_test: BlunderTest | None = None
    """What that verdict could find; absent where no test was made."""
    predicted: Predicted | None
    """RMSE that the strategy auto predicts for the fit without independent points, or null."""
    accuracy: Accuracy | None
    """Accuracy on the independent points, or null."""
    accuracy_without: Accuracy | None = None
    """Accuracy without the independent points among the outliers; absent where there are none."""
    final_fit: FinalFit | None = field(name="final")
    """The chosen structure fitted to all points, independent ones included, or null. The figures of
    the record are those of the fit without them."""
    shared_sigma: tuple[Size, Size] | None = None
    """Standard deviations of line and sample [px] that all places have in common and the control
    does not show, such as what the ties of a block share; absent where nothing is known of any."""
    exports: Literal["final", "selection"] = field(name="exported")
    """The fit that is exported unless another is asked for: `final`, or `selection`, that of the
    record's figures."""
    front: tuple[Member, ...]
    """Selections that no other found selection beats in every objective; from `exact` the best by
    number of terms; else empty."""
    certificate: Certificate | None
    """What was proven about the optimum, or null."""
    strategy: Strategy | None
    """The choice by the strategy auto, or null."""
    evaluations: Count
    """Individuals evaluated, those of the local refinement included."""
    lookups: Count
    """How many of them were looked up."""
    hit_rate: Share
    """Share of all evaluations, with those of the local refinement, that were looked up."""
    generations: Count
    """Generations after the first population."""
    seconds: Size
    """Duration of the search [s]."""
    history: tuple[HistoryRow, ...]
    """The search, generation by generation; of repeated searches one after the other."""
    budget: SearchLimits
    """Limits of each search, as given or as the problem has them; empty where the default or the
    solver itself ends it."""
    stability: TermFrequencies | None = None
    """Of `termsel stability` alone: how often each term was selected."""
    by_size: tuple[SizeRow, ...] = ()
    """From `exact`, also if it was stopped: the best selection of every number of terms, or of
    control features, each with its own proof. Absent otherwise."""
    interrupted: bool
    """True if the run was interrupted."""
    polish: Polish | None
    """The local refinement, or null."""
    coefficients: Mapping[str, float]
    """Coefficients by term, in scaled coordinates."""
    standard_deviations: Mapping[str, float | None]
    """Standard deviations of the coefficients by term; null where they are not determined."""
    estimation: FitRecord = field(name="fit")
    """How the coefficients were found."""
    adjustment: AdjustmentFigures
    """Figures of the least-squares adjustment."""
    sensor: tuple[SensorFigure, ...] = ()
    """What the coefficients say of the sensor, as of a camera its place, its angles and its focal
    length; empty where the model knows none."""
    significance: Mapping[str, Significance]
    """Test of each coefficient against zero, by term."""
    correlations: tuple[Correlation, ...]
    """Pairs of coefficients that correlate by 0.95 or more."""
    scaling: ScalingNumbers
    """Offsets and scales between coordinates and scaled coordinates."""
    versions: Mapping[str, str]
    """Versions of Python, termsel and the packages it computes with."""
    plugins: Mapping[str, PluginRecord]
    """Of problem, model, solver, criterion, the solver of a second step (then) and the method
    that auto chose, those that plugins provide."""
    checksums: Checksums | None = None
    """Checksums by which `termsel.read_result` refuses a result that was changed."""

    def __post_init__(self) -> None:
        """Raise ValueError where there are more lookups than evaluations."""
        # A lookup is an evaluation whose figures were kept.
        if self.lookups > self.evaluations:
            raise ValueError("there are more lookups than evaluations")
