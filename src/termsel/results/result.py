"""The record of a run: result.json and its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET, convert, structs
from numpy.typing import ArrayLike

from termsel.core.display import Glance
from termsel.core.errors import TermselError, counted
from termsel.core.files.atomic import write_text
from termsel.core.files.names import is_there
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.locate import Surface
from termsel.data.record.base import plain
from termsel.data.record.figures import Accuracy, BlunderTest, Correlation, Outlier, Predicted
from termsel.data.record.record import (
    SCHEMA,
    DataRecord,
    FinalFit,
    Offered,
    Options,
    PluginRecord,
    Record,
)
from termsel.data.record.search import (
    Certificate,
    HistoryRow,
    Member,
    Polish,
    SearchLimits,
    SizeRow,
    Strategy,
    TermFrequencies,
)
from termsel.data.roles import by_roles
from termsel.data.thumbnail import thumbnail
from termsel.fitting.diagnosis import Diagnosis
from termsel.fitting.figures import Baseline, Rmses, in_role, residuals_of, rmse_record
from termsel.fitting.fit import Fit
from termsel.fitting.residuals import Residuals
from termsel.report.accuracy import accuracy_of
from termsel.report.answers import document
from termsel.report.first_screen import next_step, title_of
from termsel.report.page import page
from termsel.report.plots import Plots
from termsel.report.text import first_screen_of, text_of
from termsel.report.view import View
from termsel.results.checksums import SEALS, checksums_of
from termsel.results.extras import further_sections
from termsel.results.same_fit import adjustment_figures, fit_record, least_squares_of
from termsel.selection.problems.base import Selection

if TYPE_CHECKING:
    from termsel.data.rpc import Rpc

CARRIED = (
    "problem", "model", "solver", "criterion", "seed", "data", "feasible", "judgement", "notes",
    "reference", "outliers", "blunder_test", "predicted", "accuracy", "accuracy_without",
    "objectives", "front",
    "certificate", "strategy", "evaluations", "lookups", "generations", "seconds", "history",
    "budget", "stability", "by_size", "interrupted", "polish", "versions", "shared_sigma")
"""Fields that a result and its record have in common."""



@dataclass(frozen=True, eq=False, repr=False)
class Result(Glance):
    """Fitted model, accuracy and outliers of a run.

    Attributes
    ----------
    problem, model, solver, criterion : str
    seed : int
    options : mapping
        Options of problem, model, solver, criterion and data.
    data : DataRecord
        Source, checksum, counts, and noise where it is known.
    selection : Selection
    feasible : bool
        False if no selection satisfied all conditions.
    rmse : mapping
        By role. "independent" is the accuracy; "check" is not, where the search minimised it.
    baselines : tuple of Baseline
    judgement : str
        The comparison with models that need no search, in one or two sentences.
    reference : str
        Name of the baseline that the comparison is with; empty if there is none.
    notes : tuple of str
        What else the reader must know.
    objectives : mapping
        The search's objectives at the selection.
    evaluations, lookups, generations : int
        Individuals evaluated, those of the local refinement included, how many of them were
        looked up, and generations of the solver.
    seconds : float
    interrupted : bool
    polish : Polish, optional
        What local refinement added.
    fit : Fit
        The fitted model.
    residuals : Residuals
        Of all features, as a table.
    diagnosis : Diagnosis
        What the fit says about its terms and its lines.
    features : FeatureSet
        What was measured; each point has the role it played.
    versions : mapping
    plugins : mapping
        Of problem, model, solver and criterion those that plugins provide, with
        ``distribution:name`` and version.
    front : tuple of Member
        Non-dominated selections of a search with several objectives; from `exact` the best by
        number of terms, as soon as all is proven.
    certificate : Certificate, optional
        What was proven.
    by_size : tuple of SizeRow
        From `exact`, at any time: the best selection of every number of terms or features, with
        what is proven of those as large.
    outliers : tuple of Outlier
        The outlier test: every feature that contradicts all others, used or not.
    blunder_test : BlunderTest, optional
        What that verdict could find; None where no test was made.
    predicted : Predicted, optional
        RMSE that a choice by the strategy "auto" predicts, with its interval.
    predicted_final : Predicted, optional
        The same of `final`, by the places of all points; the independent points' measurements take
        no part.
    accuracy : Accuracy, optional
        Of the independent points, in px and on the ground, and by standards.
    accuracy_without : Accuracy, optional
        The same without the independent points among the outliers, where there are some.
    final : Fit, optional
        Of a choice by the strategy "auto": the same structure fitted to all points, independent
        ones included. It is exported, and `project`, `sigma`, `locate` and `to_rpc` use it. All
        figures are those of `fit`.
    strategy : Strategy, optional
        Of a choice by the strategy "auto": what was chosen, the accuracy it predicts, and all
        candidates with theirs.
    history : tuple of HistoryRow
        Each generation of the search.
    budget : SearchLimits
        Limits of each search.
    stability : TermFrequencies, optional
        Of a fit of the stable terms: how often each term was selected.
    shared_sigma : tuple of float, optional
        Standard deviations of line and sample [px] that all places have in common and the control
        does not show, such as what the ties of a block share. `sigma` includes them.
    files : mapping of str to str
        Further files that the folder of the result gets, by name: certificate.json of a proof.
        Empty for a result that was read.

    Examples
    --------
    >>> import termsel
    >>> result = termsel.run("poly-terms", seed=1, generations=2)
    >>> result.rmse["independent"].n
    26
    >>> result.project([[48.5, 34.8, 1850.0]]).shape  # line and sample [px]
    (1, 2)
    """

    problem: str
    model: str
    solver: str
    criterion: str
    seed: int
    options: Mapping[str, Any]
    data: DataRecord
    selection: Selection
    feasible: bool
    rmse: Rmses
    baselines: tuple[Baseline, ...]
    judgement: str
    notes: tuple[str, ...]
    objectives: Mapping[str, float]
    evaluations: int
    lookups: int
    generations: int
    seconds: float
    interrupted: bool
    polish: Polish | None
    fit: Fit
    residuals: Residuals
    diagnosis: Diagnosis
    features: FeatureSet
    versions: Mapping[str, str]
    front: tuple[Member, ...] = ()
    certificate: Certificate | None = None
    strategy: Strategy | None = None
    outliers: tuple[Outlier, ...] = ()
    blunder_test: BlunderTest | None = None
    predicted: Predicted | None = None
    predicted_final: Predicted | None = None
    accuracy: Accuracy | None = None
    accuracy_without: Accuracy | None = None
    plugins: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    final: Fit | None = None
    history: tuple[HistoryRow, ...] = ()
    budget: SearchLimits = field(default_factory=SearchLimits)
    stability: TermFrequencies | None = None
    by_size: tuple[SizeRow, ...] = ()
    shared_sigma: tuple[float, float] | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    reference: str = ""

    @property
    def hit_rate(self) -> float:
        """Share of all evaluations that were looked up."""
        return self.lookups / max(self.evaluations, 1)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of result.json, without its checksums."""
        # Checksums are of what is written: of a dictionary they would say nothing.
        content = plain(self.record)
        del content[SEALS]
        return content

    @cached_property
    def record(self) -> Record:
        """The content of result.json, typed."""
        # By way of JSON, so that it is the same when it is read again.
        record = convert(plain(self._content()), Record)
        return structs.replace(record, checksums=checksums_of(plain(record), self.features))

    def _content(self) -> Record:
        """Return the content of result.json before it is made the same as when it is read."""
        # What is carried is the same in both; the rest is computed from fits and figures.
        final = self.final
        terms = self.fit.model.terms
        return Record(
            **{name: getattr(self, name) for name in CARRIED}, schema=SCHEMA,
            options=convert(plain(self.options), Options), selection=self.selection.record(),
            offered=Offered(len(terms), len(self.fit.control)), rmse=rmse_record(self.rmse),
            baselines=tuple(baseline.row() for baseline in self.baselines),
            final=None if final is None else FinalFit(
                features=final.control.ids, scaling=final.scaling.numbers(),
                coefficients=final.coefficients, standard_deviations=final.standard_deviations,
                adjustment=adjustment_figures(final), fit=fit_record(final),
                predicted=self.predicted_final),
            exported="final" if final else "selection", hit_rate=self.hit_rate,
            coefficients=self.fit.coefficients,
            standard_deviations=self.fit.standard_deviations, fit=fit_record(self.fit),
            adjustment=adjustment_figures(self.fit, self.diagnosis.orientation_spread),
            significance=self.diagnosis.significance,
            correlations=tuple(Correlation((first, second), value)
                               for first, second, value in self.diagnosis.correlations),
            scaling=self.fit.scaling.numbers(),
            plugins=convert(plain(self.plugins), dict[str, PluginRecord]))

    def fit_of(self, member: Member) -> Fit:
        """Return the fit of a member of the front, or of the best selection of a size."""
        observations = by_roles(self.features)
        selected = member.selection
        # Genes of a member may have chosen other options of the model than the selection did.
        model = self.fit.model.with_parameters(selected.parameters or {})
        iterated = None if member.iterated is UNSET else member.iterated
        control = observations.control
        return least_squares_of(
            model, control, self.fit.scaling, terms=np.isin(model.terms, selected.terms),
            used=np.isin(control.ids, selected.features), check=observations.check,
            iterated=iterated)

    def of_image(self, size: tuple[int, int]) -> Result:
        """Return the result with the size of its image, which files of points do not state.

        Parameters
        ----------
        size : tuple of int
            Lines and samples [px].
        """
        # The fit knows the size as well: it bounds places on the ground.
        control = replace(self.fit.control, image_size=size)
        return replace(self, features=replace(self.features, image_size=size),
                       fit=replace(self.fit, control=control))

    def as_exported(self, final: bool | None = None) -> Result:
        """Return the result with the fit that is exported as its only fit.

        Parameters
        ----------
        final : bool, optional
            Whether to take the final fit; by default if there is one. False takes the other.

        Raises
        ------
        TermselError
            If the final fit is asked for and there is none.
        """
        # Nothing to choose between: the only fit is exported.
        if self.final is None:
            if final:
                raise TermselError("this result has no fit to all points (--final)",
                                   hint="Leave --final out: only the automatic choice makes such a "
                                        "fit, where there are independent check points.")
            return self
        # The other fit is exported, and the final one forgotten.
        if final is False:
            return replace(self, final=None, predicted_final=None)
        observations = by_roles(self.features)
        # Of independent points, the outliers stay out of the final fit; twins of others are in it.
        in_use = set(observations.independent.ids) - {outlier.id for outlier in self.outliers}
        return replace(self, fit=self.final, final=None, residuals=residuals_of(
            in_role(self.final, observations), observations, self.outliers, check_used=True,
            independent_used=in_use))

    @property
    def exported(self) -> Fit:
        """The fit that is exported and that `project`, `sigma`, `locate` and `to_rpc` use.

        The final one if there is one. `Result.fit` is the one whose figures these are.
        """
        # The final fit has used all points: it is the better map, the other one the honest figure.
        return self.final or self.fit

    def project(self, ground: ArrayLike) -> FloatArray:
        """Return where the exported fit sees ground points (see `termsel.Fit.project`)."""
        return self.exported.project(ground)

    def sigma(self, ground: ArrayLike, *, measured: bool = False) -> FloatArray:
        """Return the standard deviation of the error of `project` (see `termsel.Fit.sigma`).

        It includes what all places have in common, where that is known (`shared_sigma`).
        """
        # Independent errors: their squares add.
        return np.hypot(self.exported.sigma(ground, measured=measured), self.shared_sigma or 0.0)

    def locate(self, image: ArrayLike, height: ArrayLike | Surface) -> FloatArray:
        """Return the ground points seen at image points, by the exported fit.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [px].
        height : array_like, shape (n,), a number, or callable
            Heights, or what gives them for x and y, shape (n, 2), such as a DEM.

        Returns
        -------
        ndarray, shape (n, 3)
            In the CRS of the control; NaN where there is none.
        """
        return self.exported.locate(image, height)

    def to_rpc(self, heights: tuple[float, float] | None = None) -> Rpc:
        """Return the exported fit as RPC.

        Rational functions and polynomials to the third degree of WGS84 longitude, latitude and
        ellipsoidal height are RPCs as they are. Any other fit is replaced by the RPC next to
        it, and what that costs is logged; `termsel.fitting.rpc_fit.rpc_of` returns it.

        Parameters
        ----------
        heights : tuple of float, optional
            Least and largest height that the RPC is for, by default those of the control.

        Raises
        ------
        TermselError
            If the ground coordinates cannot be turned into longitude and latitude, or no RPC
            comes near the fit.
        """
        from termsel.fitting.rpc_fit import rpc_of

        return rpc_of(self.exported, heights).rpc

    def to_json(self) -> str:
        """Return result.json as text: `to_dict` and its checksums."""
        return json.dumps(plain(self.record), indent=1) + "\n"

    @cached_property
    def view(self) -> View:
        """What charts and pages read of the result."""
        return View(self.record, self.fit, self.features, self.residuals,
                     lambda: [self.fit_of(member) for member in self.front])

    @property
    def plot(self) -> Plots:
        """Charts: ``result.plot.residuals()`` and so on return Altair charts."""
        return Plots(self.view)

    def report(self, path: Path | str, *, image: Path | str | None = None,
               overwrite: bool = False) -> None:
        """Write a page about the result that opens in any browser, without a connection.

        Parameters
        ----------
        path : path-like
        image : path-like, optional
            The image, to be shown below the residuals.
        overwrite : bool
            Whether a file that is there may be replaced.

        Raises
        ------
        TermselError
            If the file exists and may not be replaced or cannot be written, the image cannot be
            read or has another size, or the extra `report` is not installed.
        """
        path = Path(path)
        # Before the charts are drawn, which take seconds.
        if not overwrite and is_there(path):
            raise TermselError("this file already exists", file=path,
                               hint="Choose another name, or pass overwrite=True.")
        depicted = self
        picture = ""
        if image is not None:
            picture, size = thumbnail(image, self.features.image_size)
            depicted = self.of_image(size)
        write_text(path, page(document(depicted.view.record, depicted.view, picture,
                                       further_sections(self))))

    def summary(self, *, verbose: bool = False) -> str:
        """Return the first screen as text: data, model, accuracy, outliers and a comparison.

        Parameters
        ----------
        verbose : bool
            Whether to return all of it, as summary.txt has it: every table, term and proof.
        """
        # The first screen fits into a terminal; summary.txt has every table and proof.
        if not verbose:
            return first_screen_of(document(self.record))
        return text_of(document(self.record, further=further_sections(self)), titled=False)

    def next_step(self, folder: Path | str = "") -> str:
        """Return the command that comes next, for the last line of the first screen.

        Parameters
        ----------
        folder : path-like
            Where the result was written; by default nowhere.
        """
        return next_step(self.record, str(folder))

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        counts = self.data.counts
        record = self.record
        features = [counted(n, noun) for n, noun in (
            (counts.control, "control point"), (counts.lines, "control line"),
            (counts.check, "selection point"), (counts.independent, "independent check point"))
            if n]
        # The strategy auto fits to the check points, too.
        used = len(record.selection.features) + counts.check * bool(self.strategy)
        left_out_ids = [outlier.id for outlier in self.outliers if outlier.excluded]
        title = f"{title_of(record)} ({self.model})" if self.strategy else title_of(record)
        return f"Result: {title}, {counted(len(self.selection.terms), 'term')}", {
            "data": f"{self.data.source}; {', '.join(features)}",
            "fitted to": f"{used} {counts.word}" + (
                f"; exported: fitted to {len(self.final.control)}" if self.final else ""),
            "blunders left out": ", ".join(left_out_ids) or "none",
            "accuracy": accuracy_of(record),
            "see": "summary(), plot.residuals(), report('report.html')"}
