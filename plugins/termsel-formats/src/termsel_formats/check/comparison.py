"""How far what programs take from a file is from the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from termsel import Result, TermselError
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import (
    EARTH,
    LOCAL,
    body_of,
    horizontal_crs,
    offsets_in_metres,
    transformation_between,
)
from termsel_formats.check.base import NoAnswer, Taken
from termsel_formats.check.gdal import border_places
from termsel_formats.check.programs import Answers, taken_by_programs
from termsel_formats.check.raster import is_map_of_termsel, size_of
from termsel_formats.check.sidecars import raster_of

# Positions along either side of the image at which programs are compared with the model.
_PLACES_ACROSS = 15


@dataclass(frozen=True)
class Apart:
    """Distances from the model.

    Parameters
    ----------
    rms, largest : float
        In the image [px].
    metres : float or None
        The largest on the ground [m]; None in coordinates without a unit.
    line, sample : float
        Where the largest is.
    lacking : int
        Positions that the program does not transform, or whose ground the model cannot project.
    """

    rms: float
    largest: float
    metres: float | None
    line: float
    sample: float
    lacking: int


@dataclass(frozen=True)
class Deviation:
    """What a program takes from a file, and how far that is from the model.

    Parameters
    ----------
    program, transformation, crs : str
        What the program is called, and what it takes, as in `Taken`.
    by_default : bool
        Whether the program takes it without being told.
    at_points, over_image : Apart or None
        None where the program takes no transformation, or does not answer.
    said : str
        What the program says where it does not answer.
    """

    program: str
    transformation: str
    crs: str
    by_default: bool
    at_points: Apart | None = None
    over_image: Apart | None = None
    said: str = ""


def compare_programs(path: Path | str, result: Result | None = None, *, final: bool | None = None,
                     ) -> tuple[tuple[Deviation, ...], Answers]:
    """Return what programs take from a raster or a file next to it, and how far that is off.

    Positions are compared at the heights of the points, and over the image at the middle height of
    the control.

    Parameters
    ----------
    path : path-like
        A raster, or a file that goes with one, such as a world file or an RPC.
    result : Result, optional
        The model. Without it there are no distances.
    final : bool, optional
        As for `termsel.export`.

    Returns
    -------
    deviations : tuple of Deviation
        Of each transformation that a program takes, the distances from the model [px].
    answers : Answers
        As of `taken_by_programs`.

    Raises
    ------
    TermselError
        If no program can read the file, or no image is known that it goes with.

    Examples
    --------
    >>> import termsel
    >>> from termsel.testing import invoke
    >>> from termsel_formats import compare_programs
    >>> written = invoke("example", "files")
    >>> result = termsel.run("poly-terms", features=termsel.read("files/gcps.csv"),
    ...                      evaluations=200, options={"degree": 2})
    >>> deviations, answers = compare_programs("files/ortho.tif", result)
    >>> deviations[0].program.partition(" ")[0], deviations[0].transformation
    ('rasterio', 'affine transformation')
    """
    result = None if result is None else result.as_exported(final)
    with raster_of(Path(path), result) as raster:
        answers = taken_by_programs(raster)
        if result is None:
            return tuple(Deviation(answer.program, answer.transformation, answer.crs,
                                   answer.by_default) for answer in answers.taken), answers
        # A map of the image, whose pixels are others, would be off by its whole size.
        if is_map_of_termsel(raster):
            raise TermselError(
                "this is a map that termsel made, and its pixels are not those of the image",
                file=Path(path), hint="Give the image, or a file that was exported for it. How "
                "accurate the map is stands in its tags, and in the summary of the result.")
        size = size_of(raster)
        size_of_result = result.features.image_size
        if size_of_result is not None and tuple(size_of_result) != size:
            raise TermselError(
                f"this raster has {size[0]} lines and {size[1]} samples, and the image of the "
                f"result {size_of_result[0]} and {size_of_result[1]}", file=Path(path),
                hint="Give the image or an export of it; a map has different pixels.")
        return tuple(_deviation_of(answer, result, size) for answer in answers.taken), answers


def _deviation_of(answer: Taken, result: Result, size: tuple[int, int]) -> Deviation:
    """Return the deviation of a program's transformation from the model.

    It is that at the points and over the image, which has `size` lines and samples. If the program
    has no transformation there are no distances, and if it does not answer `said` says so.
    """
    deviation = Deviation(answer.program, answer.transformation, answer.crs, answer.by_default)
    if answer.places is None:
        return deviation
    points = result.features.points.ground
    points = points[np.isfinite(points[:, :2]).all(axis=1)]
    shares = np.linspace(0.0, 1.0, _PLACES_ACROSS)
    inside = np.stack(np.meshgrid(shares, shares, indexing="ij"), axis=-1).reshape(-1, 2)
    # Positions count from the centre of the first pixel: the image begins half a pixel before it.
    image = np.concatenate([inside * size - 0.5, border_places(size)])
    # The middle height of the control, for pixels of which no height is known.
    level = float(result.fit.ground_box()[0][2])
    try:
        if len(points):
            at_points = _distances_from_model(answer, result, result.project(points), points, level)
        else:
            at_points = None
        over_image = _distances_from_model(
            answer, result, image, result.locate(image, level), level)
    except (NoAnswer, TermselError) as error:
        return replace(deviation, said=error.what)
    return replace(deviation, at_points=at_points, over_image=over_image)


def _distances_from_model(answer: Taken, result: Result, image: FloatArray, ground: FloatArray,
                          level: float) -> Apart | None:
    """Return how far a program's ground positions are from the model's.

    `image` (n, 2) are lines and samples [px], and `ground` (n, 3) are the model's positions of the
    same pixels, in the CRS of the result. Heights that are not known are taken to be `level` [m],
    and rows without a position are left out. None if no position can be compared.
    """
    assert answer.places is not None
    is_known = np.isfinite(image).all(axis=1) & np.isfinite(ground[:, :2]).all(axis=1)
    image = image[is_known]
    ground = ground[is_known].copy()
    ground[:, 2] = np.where(np.isnan(ground[:, 2]), level, ground[:, 2])
    crs = result.features.crs
    # The RPCs that programs take count heights from the ellipsoid.
    if crs != LOCAL and body_of(crs) == EARTH:
        heights = transformation_between(crs, "EPSG:4979")(ground)[:, 2]
    else:
        heights = ground[:, 2]
    xy = answer.places(image, heights)
    # A program may answer in another CRS, such as degrees for an RPC.
    if answer.crs and crs != LOCAL:
        xy = transformation_between(horizontal_crs(answer.crs), horizontal_crs(crs), strict=False)(
            np.column_stack([xy, np.zeros(len(xy))]))[:, :2]
    program_ground = np.column_stack([xy, ground[:, 2]])
    # In px: the model's image position of the ground position that the program gives to a pixel.
    pixels = np.linalg.norm(result.project(program_ground) - image, axis=1)
    comparable = np.isfinite(pixels)
    if not comparable.any():
        return None
    # No distance is negative, so that positions without one are never the worst.
    worst = int(np.argmax(np.where(comparable, pixels, -1.0)))
    metres = offsets_in_metres(
        crs, ground[comparable], (program_ground - ground)[comparable, :2])
    line, sample = image[worst].tolist()
    return Apart(float(np.sqrt((pixels[comparable] ** 2).mean())), float(pixels[worst]),
                 None if metres is None else float(np.hypot(*metres.T).max()), line, sample,
                 int((~comparable).sum()))
