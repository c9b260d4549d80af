"""The result of a run: what result.json holds, and the fits that it is of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import numpy as np
from msgspec import UNSET, convert, field, structs
from numpy.typing import ArrayLike

from termsel.core.arguments import (
    CALLED_LOCATE,
    CALLED_PROJECT,
    changes_said,
    explains_arguments,
)
from termsel.core.display import Glance
from termsel.core.errors import TermselError, count_in_words
from termsel.core.files.atomic import write_text
from termsel.core.files.names import is_there
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.georeferenced import warn_of_map
from termsel.data.locate import Surface
from termsel.data.record.figures import as_plain_data
from termsel.data.record.record import Checksums, Record
from termsel.data.record.search import Member
from termsel.data.roles import observations_by_role
from termsel.data.thumbnail import make_thumbnail
from termsel.fitting.figures import residuals_of, restrict_to_control
from termsel.fitting.fit import Fit
from termsel.fitting.residuals import Residuals
from termsel.results.accuracy import accuracy_of
from termsel.results.answers import result_document
from termsel.results.extras import further_sections
from termsel.results.first_screen import (
    first_screen,
    model_title,
    next_step_for_user,
    options_of_next_run,
)
from termsel.results.page import render_page
from termsel.results.plots import Plots
from termsel.results.same_fit import fit_of_selection, numbers_of
from termsel.results.text import text_of, text_of_blocks
from termsel.results.view import View

if TYPE_CHECKING:
    from termsel.data.rpc import Rpc

# Checksums by which a result that was changed since its run is told from what the run wrote.

SEALS = "checksums"
"""Key of the checksums in result.json."""


def checksum_of_features(features: FeatureSet) -> str:
    """Return a checksum of all that a fit depends on: SHA-256 as 64 hexadecimal digits.

    That is ids, coordinates, roles, standard deviations, CRS and RPC, but no attributes.
    """
    digest = hashlib.sha256(features.crs.encode())
    if features.rpc is not None:
        digest.update(msgspec.json.encode(features.rpc.numbers()))
    digest.update("\n".join(features.points.roles).encode())
    for sigma in (features.points.sigma, features.lines.sigma):
        if sigma is not None:
            digest.update(sigma.tobytes())
    for content in (features.points, features.lines):
        digest.update("\n".join(content.ids).encode())
        digest.update(content.image.tobytes())
        # NaN has many bit patterns; heights that are not known are one and the same.
        digest.update(np.where(np.isnan(content.ground), np.nan, content.ground).tobytes())
    return digest.hexdigest()


def checksum_of_certificate(content: Mapping[str, Any]) -> str:
    """Return the checksum that a certificate without its own has (`termsel.check.checksum`)."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def checksum_of_attributes(features: FeatureSet) -> str | None:
    """Return a checksum of the columns of attributes, None where there are none.

    It is not part of `checksum_of_features`, which is the same for the same control whatever else
    its files say of it.
    """
    # By the name of the column, points before lines.
    columns = []
    for content in (features.points, features.lines):
        columns.append({name: cells.tolist() for name, cells in content.attributes.items()})
    return hashlib.sha256(json.dumps(columns).encode()).hexdigest() if any(columns) else None


def checksum_of_record(record: Mapping[str, Any]) -> str:
    """Return the SHA-256 of result.json's content, without checksums, whatever its layout."""
    # Sorted keys: the layout of the file is not part of its content.
    text = json.dumps({key: value for key, value in record.items() if key != SEALS},
                      sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def checksums_of(content: Mapping[str, Any], features: FeatureSet) -> Checksums:
    """Return the checksums of the content of result.json and of its features."""
    return Checksums(checksum_of_record(
        content), checksum_of_features(features), checksum_of_attributes(features))


@changes_said("result.with_({name}=VALUE) returns another.")
class Result(Glance, Record, frozen=True, kw_only=True, eq=False, dict=True, weakref=True):
    """What a run found: all that result.json holds, and the fits that it is of.

    Its attributes are those of the file, as docs/reference/result.md describes them: ``problem``,
    ``model``, ``selection``, ``rmse``, ``accuracy``, ``outliers``, ``notes`` and so on. RMSE are by
    role: ``result.rmse["independent"].total`` [px] is the accuracy, None without such points;
    "check" is none, where the search minimised it. `with_` returns a result with other values.

    Attributes
    ----------
    fit : Fit
        The fitted model, whose figures these are.
    final : Fit, optional
        Of a choice by the strategy "auto": the same structure fitted to all points, independent
        ones included. It is exported, and `project`, `sigma`, `locate` and `to_rpc` use it. All
        figures are those of `fit`; `final_fit` holds its own.
    features : FeatureSet
        What was measured; each point has the role it played.
    residuals : Residuals
        Of all features, as a table.
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

    # None of these is written; a struct wants names of its own for all that could be.
    elsewhere: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(CALLED_PROJECT, "Image positions are result.project(ground)."),
        **dict.fromkeys(CALLED_LOCATE, "Ground positions are result.locate(image, height)."),
        "score": "RMSE by roles are result.rmse, the accuracy at check points result.accuracy.",
        "coef_": "They are result.coefficients.", "intercept_": "It is in result.coefficients.",
        "params": "They are result.coefficients.",
        "crs": "It is result.features.crs.",
        "gcps": "Points are result.features.points.",
        "GetGCPs": "Points are result.features.points.",
        "GetProjection": "The CRS is result.features.crs.",
        "GetGeoTransform": "A result is a model, not a map; termsel.rectify writes one.",
        "df": "Its residuals are a table: result.residuals.to_pandas().",
        "print": "print(result.summary()) prints the summary.",
        "export": "termsel.export(result, FORMAT, PATH) writes it.",
        "rectify": "termsel.rectify(result, IMAGE, MAP, dem=DEM) writes a map.",
        "save": "termsel.write_result(result, FOLDER) writes it.",
        "write": "termsel.write_result(result, FOLDER) writes it.",
        "points": "Points are result.features.points.",
        "lines": "Lines are result.features.lines.",
        "to_pandas": "Its residuals are a table: result.residuals.to_pandas().",
        "rpc": "result.to_rpc() returns one.",
        "[]": "Its values are attributes, as result.rmse, result.accuracy, result.features."}
    fit: Fit = field(name="live_fit")
    final: Fit | None = field(name="live_final")
    features: FeatureSet
    residuals: Residuals
    files: Mapping[str, str]

    @classmethod
    def of(cls, record: Record, *, fit: Fit, features: FeatureSet, residuals: Residuals,
           final: Fit | None = None, files: Mapping[str, str] | None = None) -> Result:
        """Return the result with the values of a record, and with the fits that it describes.

        Parameters
        ----------
        record : Record
            Its checksums are left out: those of the files that are written are in
            `Result.record`.
        fit, final, features, residuals, files
            As the attributes of those names.

        Raises
        ------
        msgspec.ValidationError
            If a value of the record is out of its range.
        """
        # By way of JSON, so that it is the same when it is read again.
        content = structs.asdict(convert(as_plain_data(record), Record))
        content["checksums"] = None
        return cls(**content, fit=fit, final=final, features=features, residuals=residuals,
                   files=files or {})

    def with_(self, **changes: Any) -> Result:
        """Return a copy of the result with other values of some attributes, given by name.

        Examples
        --------
        >>> import termsel
        >>> result = termsel.run("poly-terms", seed=1, generations=2)
        >>> result.with_(notes=("Measured twice.",)).notes
        ('Measured twice.',)
        """
        return structs.replace(self, **changes)

    @cached_property
    def record(self) -> Record:
        """The record that result.json holds, with its checksums."""
        # The fields of a record alone: fits and features are in no file of JSON.
        fields = {name: getattr(self, name) for name in Record.__struct_fields__}
        record = Record(**fields)
        return structs.replace(record, checksums=checksums_of(as_plain_data(record), self.features))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of result.json, without its checksums."""
        # Checksums are of what is written: of a dictionary they would say nothing.
        content = as_plain_data(self.record)
        del content[SEALS]
        return content

    def to_json(self) -> str:
        """Return result.json as text: `to_dict` and its checksums."""
        return json.dumps(as_plain_data(self.record), indent=1) + "\n"

    @explains_arguments()
    def fit_of(self, member: Member) -> Fit:
        """Return the fit of a member of the front, or of the best selection of a size."""
        observations = observations_by_role(self.features)
        selected = member.selection
        # Genes of a member may have chosen other options of the model than the selection did.
        model = self.fit.model.with_parameters(selected.parameters)
        iterated = None if member.iterated is UNSET else member.iterated
        control = observations.control
        return fit_of_selection(
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
        return self.with_(features=replace(self.features, image_size=size),
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
        if self.final is None:
            if final:
                raise TermselError("this result has no fit to all points (--final)",
                                   hint="Leave --final out: only the automatic choice makes such a "
                                        "fit, where there are independent check points.")
            return self
        if final is False:
            return self.with_(final=None, final_fit=None, exports="selection")
        observations = observations_by_role(self.features)
        # The final fit also uses the independent points but for outliers. Points that were merged
        # with a twin count as used.
        in_use = set(observations.independent.ids) - {outlier.id for outlier in self.outliers}
        residuals = residuals_of(restrict_to_control(self.final, observations), observations,
                                 self.outliers,
                                 check_used=True, independent_used=in_use)
        # What is predicted for it, where anything is.
        of_final_fit = self.final_fit and self.final_fit.predicted
        return self.with_(fit=self.final, final=None, final_fit=None,
                          exports="selection", residuals=residuals,
                          predicted=of_final_fit or self.predicted,
                          **numbers_of(self.final))

    @property
    def exported(self) -> Fit:
        """The fit that is exported and that `project`, `sigma`, `locate` and `to_rpc` use.

        It is the final one if there is one; the figures of the result are those of `Result.fit`.
        """
        # The final fit has used all points: it is the better map, the other one the honest figure.
        return self.final or self.fit

    @explains_arguments(
        remark=lambda given, _image: given["self"].exported.remark_on(given["ground"]))
    def project(self, ground: ArrayLike) -> FloatArray:
        """Return where the exported fit sees ground points (see `termsel.Fit.project`)."""
        return self.exported.project(ground)

    @explains_arguments()
    def sigma(self, ground: ArrayLike, *, measured: bool = False) -> FloatArray:
        """Return the standard deviation of the error of `project` (see `termsel.Fit.sigma`).

        It includes the error that all places have in common, if that is known (`shared_sigma`).
        """
        # Independent errors: their squares add.
        own = self.exported.sigma(ground, measured=measured)
        return np.asarray(np.hypot(own, self.shared_sigma or 0.0))

    @explains_arguments(
        checked_within=("height",),
        remark=lambda given, ground: given["self"].exported.remark_on(ground))
    def locate(self, image: ArrayLike, height: ArrayLike | Surface) -> FloatArray:
        """Return the ground points seen at image points, by the exported fit.

        Of several places at which a ray meets a surface the first is returned: it hides the others.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [px].
        height : array_like, shape (n,), a number, or callable
            Heights, or what gives them for x and y, shape (n, 2), such as a DEM.

        Returns
        -------
        ndarray, shape (n, 3)
            X, Y and Z in the CRS of the control; NaN where the ray meets no ground.

        Raises
        ------
        TermselError
            If an array has another shape, and for a file that is not opened.
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

    @cached_property
    def view(self) -> View:
        """The view of the result that charts and pages read."""
        return View(self, self.fit, self.features, self.residuals,
                    lambda: [self.fit_of(member) for member in self.front])

    @property
    def plot(self) -> Plots:
        """Charts: ``result.plot.residuals()`` and so on return Altair charts."""
        return Plots(self.view)

    @explains_arguments()
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
        if path.suffix.lower() not in (".html", ".htm"):
            raise TermselError("a report is a page of HTML, and this name does not end in .html",
                               file=path, hint=f"Name it {path.with_suffix('.html').name}.")
        depicted = self
        picture = ""
        if image is not None:
            picture, size = make_thumbnail(image, self.features.image_size)
            depicted = self.of_image(size)
            warn_of_map(self.features, image)
        write_text(path, render_page(
            result_document(depicted.record, depicted.view, picture, further_sections(self))))

    @explains_arguments()
    def summary(self, *, verbose: bool = False) -> str:
        """Return the first screen as text: data, model, accuracy, outliers and a comparison.

        Parameters
        ----------
        verbose : bool
            Whether to return all of it, as summary.txt has it: every table, term and proof.
        """
        if not verbose:
            return text_of_blocks(first_screen(self))
        return text_of(result_document(self.record, further=further_sections(self)), titled=False)

    def next_step(self, folder: Path | str = "") -> str:
        """Return what comes next: a command, or what the next call of `termsel.run` should have.

        Parameters
        ----------
        folder : path-like
            Where the result was written; by default nowhere.
        """
        again = [_argument_of(name, value) for name, value in options_of_next_run(self).items()]
        command = f"run again with {', '.join(again)}" if again else ""
        return next_step_for_user(self, str(folder), command)

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        """Return a title and the rows, by their heads, by which a result shows itself."""
        counts = self.data.counts
        features = [count_in_words(n, noun) for n, noun in (
            (counts.control, "control point"), (counts.lines, "control line"),
            (counts.check, "selection point"), (counts.independent, "independent check point"))
            if n]
        # The strategy auto fits to the check points, too.
        used = len(self.selection.features) + counts.check * bool(self.strategy)
        left_out_ids = [outlier.id for outlier in self.outliers if outlier.excluded]
        title = f"{model_title(self)} ({self.model})" if self.strategy else model_title(self)
        return f"Result: {title}, {count_in_words(len(self.selection.terms), 'term')}", {
            "data": f"{self.data.source}; {', '.join(features)}",
            "fitted to": f"{used} {counts.word}" + (
                f"; exported: fitted to {len(self.final.control)}" if self.final else ""),
            "blunders left out": ", ".join(left_out_ids) or "none",
            "accuracy": accuracy_of(self),
            "see": "summary(), plot.residuals(), report('report.html')"}


def _argument_of(option: str, value: str) -> str:
    """Return an option of the command line as an argument of `termsel.run`."""
    if option == "--set":
        name, _, text = value.partition("=")
        return f"features=termsel.read(FILE, {name}={text!r})"
    name = option.removeprefix("--")
    return f"crs={value!r}" if name == "crs" else f"options={{{name!r}: {value!r}}}"


def require_result(value: object, verb: str) -> None:
    """Raise TermselError for what is no result in a call of ``termsel.verb(result, ...)``."""
    if isinstance(value, Result):
        return
    if isinstance(value, str | Path):
        raise TermselError(
            f"{str(value)!r} is the name of a folder or file, and {verb} takes a result",
            hint=f"termsel.{verb}(termsel.read_result({str(value)!r}), ...) reads it.")
    raise TermselError(f"{verb} takes a result, not an object of the type {type(value).__name__}",
                       hint="termsel.run and termsel.read_result return a result.")
