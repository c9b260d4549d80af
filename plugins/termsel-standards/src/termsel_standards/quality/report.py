"""What a report on the quality of a georeference states, whatever its encoding.

References
----------
ISO 19157:2013, Geographic information, data quality; the measures are those of its annex D.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from termsel import Option, Result, TermselError
from termsel.toolkit import as_plain_data, require_regular
from termsel.toolkit.coordinates import LOCAL, horizontal_crs
from termsel.toolkit.files import Prediction, prediction_of
from termsel_standards.outline import bounds_of, outline_of
from termsel_standards.statement import MIN_REDUCED

RMSEP = "47"
"""Identifier of the root mean square error of planimetry among the measures of ISO 19157."""

# Bytes of a file that are read at once.
_CHUNK_BYTES = 1 << 20

QUALITY_OPTIONS = (
    Option("title", "", "Title of the image; by default the name of the file of points."),
    Option("organisation", "", "Who answers for the data; by default not stated."),
    Option("image", None, "The image; its checksum is stated with the files."))
"""Options of every format of the report."""


@dataclass(frozen=True)
class Measure:
    """A figure of the accuracy.

    Parameters
    ----------
    name, description : str
    value : float
    unit : str
        "m" on the ground, "px" in the image.
    identifier : str
        Among the measures of ISO 19157, annex D; "" for one that is not among them.
    """

    name: str
    description: str
    value: float
    unit: str
    identifier: str = ""


@dataclass(frozen=True)
class QualitySource:
    """What the georeference was made from.

    Parameters
    ----------
    name, description : str
    sha256 : str
    """

    name: str
    description: str
    sha256: str


@dataclass(frozen=True)
class Quality:
    """Content of a report on the quality of a georeference.

    Parameters
    ----------
    title, organisation : str
    made : str
        When the report was made, such as 2024-05-31T10:20:30Z.
    crs : str
        CRS of the ground coordinates.
    bounds : tuple of float
        Of the image on the ground: longitudes of the west and east, latitudes of the south and
        north [degrees].
    measures : tuple of Measure
        Accuracy on independent points; where there are none, as it was predicted.
    statements : tuple of str
        What standards let one say, or why they do not; why there are no measures.
    check_points, control_features : int
    predicted : bool
        Whether the measures are predicted: then there was no independent test.
    method, lineage : str
    sources : tuple of QualitySource
    software : dict
        Names and versions.
    parameters : dict
        Settings of the run.
    """

    title: str
    organisation: str
    made: str
    crs: str
    bounds: tuple[float, float, float, float]
    measures: tuple[Measure, ...]
    statements: tuple[str, ...]
    check_points: int
    control_features: int
    predicted: bool
    method: str
    lineage: str
    sources: tuple[QualitySource, ...]
    software: dict[str, str]
    parameters: dict[str, str]


def require_earth(result: Result) -> None:
    """Raise TermselError unless the ground coordinates have a CRS of the Earth."""
    if result.features.crs == LOCAL:
        raise TermselError("a quality report requires a CRS of the Earth",
                           hint="State the CRS of the ground coordinates when you run termsel.")


def quality_of(result: Result, title: str = "", organisation: str = "",
               image: Path | str | None = None) -> Quality:
    """Return the content of the report on a result.

    Parameters
    ----------
    result : Result
        Its accuracy is that of the run: an exported fit may have used the independent points.
    title, organisation : str
        Of the product, and of who is responsible for it.
    image : path-like, optional
        The image, whose checksum is stated.

    Returns
    -------
    Quality
        With measures of the independent points; without such points with those that are predicted,
        if any.

    Raises
    ------
    TermselError
        If the ground coordinates have no CRS of the Earth, or the image cannot be read.
    """
    require_earth(result)
    # ISO and FGDC take bounds in degrees.
    west, south, east, north = bounds_of(outline_of(result))
    counts = result.data.counts
    terms = result.selection
    # With these settings the run can be repeated.
    settings = {"problem": result.problem, "model": result.model, "solver": result.solver,
                "criterion": result.criterion, "seed": str(result.seed),
                "terms": " ".join(terms.terms),
                **{f"options of the {name}": json.dumps(value, sort_keys=True)
                   for name, value in as_plain_data(result.options).items() if value}}
    sources = [QualitySource(result.data.source,
                             "GCP observations; the checksum is that of ids, coordinates, roles, "
                             "standard deviations and CRS as read", result.data.sha256)]
    if image is not None:
        sources.append(QualitySource(_name_as_text(image), "the image", file_sha256(Path(image))))
    software = dict(result.versions)
    for plugin in result.plugins.values():
        software[plugin.name] = plugin.version
    expected = prediction_of(result)
    prediction = expected if result.accuracy is None else None
    if result.accuracy is not None:
        method = ("Positions that the model computes for independent points are compared with "
                  "their surveyed positions, at the surveyed heights. No choice has used these "
                  "points.")
    elif prediction is not None:
        method = f"No test by independent points: the accuracy is predicted {prediction.method}."
    else:
        method = "There was no test by independent points."
    return Quality(
        title=title or Path(result.data.source).stem or "scene", organisation=organisation,
        made=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        crs=horizontal_crs(result.features.crs), bounds=(west, east, south, north),
        measures=_tested_measures(result) if prediction is None
        else _predicted_measures(prediction),
        statements=_standard_statements(result, expected),
        check_points=result.accuracy.image.n if result.accuracy else 0,
        control_features=counts.control,
        predicted=prediction is not None, method=method,
        lineage=f"Georeferenced by termsel: the model {result.model} with {len(terms.terms)} "
                f"terms, selected by {result.solver}, was fitted to {counts.control} control "
                "features.",
        sources=tuple(sources), software=software, parameters=settings)


def _tested_measures(result: Result) -> tuple[Measure, ...]:
    """Return the figures of the independent points, on the ground first; () without such points.

    On the ground there are none if the errors are not known in metres; the figure of NSSDA needs
    enough points.
    """
    if result.accuracy is None:
        return ()
    image = result.accuracy.image
    ground = result.accuracy.ground
    measures = []
    if ground is not None:
        # Annex D of ISO 19157 has the first of these alone, whose identifier is RMSEP.
        measures = [
            Measure("root mean square error of planimetry", "root of the mean of the squares of "
                    "the distances from the surveyed positions", ground.total, "m", RMSEP),
            Measure("root mean square error in x", "of the errors to the east", ground.x, "m"),
            Measure("root mean square error in y", "of the errors to the north", ground.y, "m"),
            Measure("CE90", "distance that 90 % of the check points do not exceed", ground.ce90,
                    "m"),
            Measure("maximum error", "the largest distance", ground.maximum, "m")]
    if result.accuracy.nssda.value is not None:
        measures.append(Measure("NSSDA horizontal accuracy", "at 95 % confidence, by "
                                "FGDC-STD-007.3-1998", result.accuracy.nssda.value, "m"))
    return (*measures, Measure("root mean square error in the image", "root of the mean of the "
                               "squares of the distances from the measured positions", image.total,
                               "px"))


def _predicted_measures(prediction: Prediction) -> tuple[Measure, ...]:
    """Return the RMSE on the ground, if it is known, and in the image that are predicted.

    Their names and descriptions say that they are predicted, and give their intervals.
    """
    source = f"predicted {prediction.method}, with a {100 * prediction.level:g} % interval"
    measures = []
    if prediction.metres is not None:
        rmse, low, high = prediction.metres
        measures.append(Measure("predicted root mean square error of planimetry",
                                f"{source} from {low:.3g} to {high:.3g} m; no independent test",
                                rmse, "m"))
    return (*measures, Measure(
        "predicted root mean square error in the image", f"{source} from {prediction.low:.3g} to "
        f"{prediction.high:.3g} px; no independent test", prediction.rmse, "px"))


def _standard_statements(result: Result, prediction: Prediction | None) -> tuple[str, ...]:
    """Return the statements of ASPRS and NSSDA, or why they are not made.

    If there are too few independent points or none, the predicted accuracy follows or stands alone;
    where nothing is known, one sentence says so.
    """
    accuracy = result.accuracy
    if accuracy is None:
        if prediction is None:
            return ("The accuracy is not known, as the result has no independent points",)
        return (prediction.sentence,)
    statements = [f"{name}: not stated: {figure.reason}" for name, figure in (
        ("ASPRS", accuracy.asprs), ("NSSDA", accuracy.nssda)) if figure.value is None]
    if accuracy.nssda.value is not None:
        statements.append(f"Tested {accuracy.nssda.value:.3g} meters horizontal accuracy at 95% "
                          "confidence level")
    # No standard has a statement on a test by so few points, and the prediction is surer.
    if prediction is not None and accuracy.image.n < MIN_REDUCED:
        statements.append(prediction.sentence)
    if accuracy.ground is None:
        statements.append("The errors on the ground are not known in metres")
    return tuple(statements)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of the content of a file, as 64 hexadecimal digits.

    Raises TermselError if the file cannot be read, or is no regular file.
    """
    digest = hashlib.sha256()
    try:
        # The reading of device files and pipes might never end.
        require_regular(path)
        # Images may be larger than memory.
        with path.open("rb") as file:
            while block := file.read(_CHUNK_BYTES):
                digest.update(block)
    except OSError as error:
        raise TermselError(f"cannot read this file: {error.strerror or error}",
                           file=path, hint="Give a file that you may read.") from error
    return digest.hexdigest()


def decimal_text(value: float) -> str:
    """Return a number without an exponent, to nine significant digits."""
    return np.format_float_positional(value, 9, fractional=False, trim="0")


def _name_as_text(path: str | Path) -> str:
    """Return the name of a file without its folder; bytes that are not UTF-8 become escapes."""
    return Path(path).name.encode("utf-8", errors="backslashreplace").decode()
