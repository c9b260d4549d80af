"""From a raw image to a map: candidates, selection, judgement, rectification."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from termsel import (
    FeatureSet,
    TermselError,
    read_result,
    read_rpc,
    rectify,
    write_points_csv,
)
from termsel.files.atomic import write_text
from termsel_match.points import Candidates, match_points
from termsel_match.rounds import Matched, iterate_lines, rms_distance
from termsel_match.selection import AGREEING, Selected, select_points, with_lines
from termsel_match.starts import Start
from termsel_match.vectors import read_vectors

CANDIDATES, REPORT, RESULT = "candidates.csv", "report.txt", "result"

_SEARCH = 12.0  # px for lines, from the model of the points
_LEAST_INDEPENDENT = 5  # candidates that agree; of fewer the RMSE says little
_LEAST_COVERED = 0.4  # part of the image


@dataclass(frozen=True, eq=False)
class Georeferenced:
    """What came of an image.

    Parameters
    ----------
    candidates : Candidates
    selected : Selected
    accept : float
        Largest accepted RMSE [px].
    reasons : tuple of str
        Why the result is not good enough; empty where it is.
    lines : Matched, optional
        The lines that are control too.
    unused : str
        Why vectors that were given are not used.
    """

    candidates: Candidates
    selected: Selected
    accept: float
    reasons: tuple[str, ...]
    lines: Matched | None = None
    unused: str = ""

    def text(self) -> str:
        """Return the report."""
        chosen, points = self.selected, self.candidates.points
        agree = chosen.agrees
        lines = [
            f"Start: {self.candidates.start}",
            f"Candidates: {len(points)} in {self.candidates.cells.get('found', 0)} of "
            f"{sum(self.candidates.cells.values())} cells of the image",
            f"Agreeing within {chosen.limit:.2f} px: {int((agree & ~chosen.independent).sum())} of "
            f"{int((~chosen.independent).sum())} candidates for control and check",
            f"Model: {chosen.result.model}, fitted to the "
            f"{chosen.result.features.points.roles.count('control')} for control",
            f"Covered by them: {100 * chosen.covered:.0f} % of the image",
            f"Independent candidates: {int((agree & chosen.independent).sum())} of "
            f"{int(chosen.independent.sum())} agree, with an RMSE of {chosen.rmse:.2f} px",
            f"Median error of all of them, right or wrong: {chosen.median:.2f} px; accepted: "
            f"{self.accept:g} px",
            AGREEING]
        if self.lines is not None:
            last = self.lines.rounds[-1]
            lines.append(f"Lines: {last.agreeing} of {last.pieces} straight pieces of vectors "
                         f"agree, with an RMS distance of {_lines_away(chosen):.2f} px")
        if self.unused:
            lines.append(f"Lines are not used, the map is by points alone: {self.unused}")
        if self.reasons:
            lines += ["Not good enough:", *(f"  {reason}" for reason in self.reasons)]
        return "\n".join(lines) + "\n"


def georeference(
    image: Path | str,
    reference: Path | str,
    output: Path | str,
    *,
    dem: Path | str,
    start: Path | str | None = None,
    vectors: Path | str | None = None,
    accept: float = 2.0,
    folder: Path | str | None = None,
    seed: int = 1,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
    **matching: Any,
) -> Georeferenced:
    """Make a map of an image, if the result is good enough.

    An RPC is refined by a shift and a drift (`rpc-drift`), also that of a result. Without one, the
    model is an affine transformation of the ground coordinates. Where the vectors cannot be used,
    the map is by points alone.

    Parameters
    ----------
    image, reference, dem, start
        As for `match_points`.
    vectors : path-like, optional
        Lines of a map, such as roads. The bands of the image that agree with them are control
        together with the points.
    output : path-like
        The map, a cloud-optimised GeoTIFF. It is written only if the result is good enough.
    accept : float
        Largest accepted median error of all independent candidates, right or wrong, and RMSE of
        those that agree [px].
    folder : path-like, optional
        For candidates, result and report.
    seed : int
        Of the selection.
    overwrite : bool
        Whether the map may replace a file.
    progress : callable, optional
        Called with the fraction of the matching that is done.
    **matching
        Further arguments of `match_points`.

    Returns
    -------
    Georeferenced

    Raises
    ------
    TermselError
        As `match_points`; or if too few candidates agree.

    Notes
    -----
    P.K. Konugurthi et al., PE&RS 82(5), 2016, 377-388: matching, selection by a GA, and the
    decision by the error that is accepted. That at least half of the independent candidates must
    have it, and the limit of the part of the image that they cover, are termsel's.
    """
    if vectors is not None:
        read_vectors(Path(vectors))  # what is wrong with them is said before the matching
    model, options = model_for(start, Path(image))
    if model == "rpc-drift" and find_spec("termsel_rpc") is None:
        raise TermselError("an image with an RPC requires the package termsel-rpc, which is not "
                           "installed", file=image,
                           hint="In a clone of termsel: pip install ./plugins/termsel-rpc.")
    candidates = match_points(image, reference, dem=dem, start=start, progress=progress, **matching)
    features = FeatureSet(candidates.points, crs=candidates.crs, image_size=candidates.image_size)
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
        write_points_csv(candidates.points, Path(folder) / CANDIDATES, candidates.crs)
    result_folder = None if folder is None else Path(folder) / RESULT
    selected = select_points(features, model, options, seed=seed, out=result_folder)
    lines, unused = None, ""
    if vectors is not None:
        at = Start("the model of the points", candidates.crs, 0.0, selected.result.project,
                   selected.result.locate)
        try:
            lines = iterate_lines(image, vectors, model, options, dem=dem, start=at,
                                  search=_SEARCH, band=matching.get("band"), seed=seed)
            selected = with_lines(selected, lines.features, model, options, seed=seed,
                                  out=result_folder)
        except TermselError as error:  # the points suffice
            lines, unused = None, error.what
    done = Georeferenced(candidates, selected, accept, reasons(selected, accept), lines, unused)
    if folder is not None:
        write_text(Path(folder) / REPORT, done.text())
    if not done.reasons:
        rectify(selected.result, image, output, dem=dem, overwrite=overwrite)
    return done


def model_for(start: Path | str | None, image: Path) -> tuple[str, dict[str, Any]]:
    """Return the model by what there is to refine, and its options."""
    path = image if start is None else Path(start)
    if path.is_dir():  # a result, which keeps its RPC as it was
        options = read_result(path).options["model"]
        return ("rpc-drift", {"rpc": options["rpc"]}) if "rpc" in options else ("affine", {})
    with suppress(TermselError):  # a start of another kind, which match_points has read
        if path.is_file():
            read_rpc(path)
            return "rpc-drift", {"rpc": str(path)}
    return "affine", {}


def _lines_away(selected: Selected) -> float:
    """Return the RMS distance of the lines from the model of points and lines [px]."""
    return rms_distance(selected.result.fit, selected.result.features.lines)


def reasons(selected: Selected, accept: float) -> tuple[str, ...]:
    """Return why a result is not good enough."""
    refusals = []
    there, agree = int(selected.independent.sum()), int(
        (selected.agrees & selected.independent).sum())
    if agree < _LEAST_INDEPENDENT:
        refusals.append(f"Only {agree} of {there} independent candidates agree with the model; at "
                        f"least {_LEAST_INDEPENDENT} must.")
    if selected.median > accept:
        refusals.append("Half of the independent candidates are more than "
                        f"{selected.median:.2f} px from the model; accepted are {accept:g} px.")
    if selected.rmse > accept:
        refusals.append(f"The RMSE of those that agree is {selected.rmse:.2f} px; accepted are "
                        f"{accept:g} px.")
    if selected.covered < _LEAST_COVERED:
        refusals.append(f"The candidates that agree cover {100 * selected.covered:.0f} % of the "
                        f"image; at least {100 * _LEAST_COVERED:.0f} % must be.")
    return tuple(refusals)
