"""A reference image as the camera would see it, by a rough start."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from termsel import TermselError, open_dem
from termsel.toolkit.coordinates import plane_transformer
from termsel_match.images.masks import mask_from_ground
from termsel_match.images.positions import middle_in_words
from termsel_match.images.rasters import (
    FloatArray,
    Grey,
    GreyRaster,
    Mask,
    crs_of,
    open_picture,
    spread_pixels,
)
from termsel_match.images.starts import Heights, Start

_REFERENCE_MESH = 24
"""Distance of the pixels whose position in the reference is computed [px]; others are interpolated.
"""

COVERS = 33
"""Number of positions along either side of an image by which its overlap is judged."""

_EDGE_PLACES = 5
"""Number of positions along either side of a reference by which its part of the image is found."""

_SAME_SIZE = 1.5
"""Ratio of pixel sizes up to which the finer pixels are not averaged."""


class NotShown(TermselError):
    """Raised for a reference that does not show what the image shows."""


@dataclass(frozen=True, eq=False)
class ReferencePatch:
    """A part of the reference, resampled to pixels of the image.

    Parameters
    ----------
    pixels : ndarray of float32, shape (lines, samples)
        Brightness of the reference; 0 where it is not known.
    known : ndarray of bool, same shape
        Where it is known.
    mesh : ndarray, shape (2, a, b)
        Line and sample in the reference of every 24th pixel in either direction.
    """

    pixels: Grey
    known: Mask
    mesh: FloatArray

    def in_reference(self, positions: FloatArray) -> FloatArray:
        """Return line and sample in the reference, (n, 2), of positions (n, 2) in the patch."""
        in_mesh = np.asarray(positions).T / _REFERENCE_MESH
        return np.stack([map_coordinates(axis, in_mesh, order=1) for axis in self.mesh], axis=1)


@dataclass(frozen=True, eq=False)
class Reference:
    """A georeferenced image, as an image with a rough geometry would see it.

    Parameters
    ----------
    picture : GreyRaster
        Brightness of the georeferenced image.
    crs : str
        CRS of the georeferenced image.
    start : Start
        Rough geometry of the image that is to be matched.
    heights, map_heights : float or callable
        Heights of the ground, as functions of positions in the CRS of the start, and in that of the
        reference. Without a DEM, both are the height that the start states.
    to_map : pyproj.Transformer
        From the CRS of the start to that of the reference.
    """

    picture: GreyRaster
    crs: str
    start: Start
    heights: Heights
    map_heights: Heights
    to_map: Any

    def seen(self, image: FloatArray) -> FloatArray:
        """Return line and sample in the reference, (n, 2), of image positions (n, 2) [px].

        NaN where the start or the transformation of the CRS gives no position.
        """
        ground = self.start.locate(image, self.heights)
        x, y = self.to_map.transform(ground[:, 0], ground[:, 1])
        positions = _map_to_pixels(self.picture.raster.transform, np.asarray(x), np.asarray(y))
        positions[~np.isfinite(positions).all(axis=1)] = np.nan
        return positions

    def ground(self, positions: FloatArray) -> FloatArray:
        """Return ground coordinates, (n, 3), of positions (n, 2) in the reference [px].

        Heights are NaN without a DEM, and where the DEM has none.
        """
        # The geotransform counts from the corner of the first pixel, positions from its centre.
        x, y = self.picture.raster.transform @ (positions[:, 1] + 0.5, positions[:, 0] + 0.5)
        plane = np.column_stack([x, y])
        if callable(self.map_heights):
            heights = self.map_heights(plane)
        else:
            heights = np.full(len(plane), np.nan)
        return np.column_stack([plane, heights])

    def patch(self, first_line: int, first_sample: int, shape: tuple[int, int],
              step: int) -> ReferencePatch:
        """Return the reference as the image would show it in a window.

        Parameters
        ----------
        first_line, first_sample : int
            First line and sample of the window in the image [px].
        shape : tuple of int
            Lines and samples of the patch.
        step : int
            Pixels of the image that one pixel of the patch is, along either side.

        Returns
        -------
        ReferencePatch
            With no pixel known if the reference does not show the window.
        """
        lines, samples = (np.arange(0, -(-size // _REFERENCE_MESH) + 1) * _REFERENCE_MESH
                          for size in shape)
        nodes = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
        # A pixel of the patch is `step` pixels of the image: its centre is the middle of these.
        at_reference = self.seen((nodes + 0.5) * step - 0.5 + [first_line, first_sample])
        mesh = at_reference.T.reshape(2, len(lines), len(samples))
        empty = ReferencePatch(np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=bool), mesh)
        finite = np.isfinite(at_reference).all(axis=1)
        if not finite.any():
            return empty
        # If its pixels are finer than those of the patch, the reference is averaged first.
        size = max(1, round(_mesh_spacing(mesh) / _REFERENCE_MESH / _SAME_SIZE))
        # Some pixels more on each side, which cubic interpolation needs.
        low = np.floor(at_reference[finite].min(axis=0)).astype(int) - 4 * size
        extent = np.ceil(at_reference[finite].max(axis=0)).astype(int) + 4 * size - low
        high = np.minimum(low + extent, self.picture.size)
        low = np.maximum(low, 0)
        low -= low % size
        if (high - low < size).any():
            return empty
        top_left = low.tolist()
        extent = (high - low).tolist()
        pixels, is_known = self.picture.read(top_left[0], top_left[1], extent[0], extent[1], size)
        # Each pixel lies between four nodes of the mesh, in units of which it is interpolated.
        grid = np.stack(np.meshgrid(*(np.arange(n) / _REFERENCE_MESH for n in shape),
                                    indexing="ij"))
        at_pixels = [((map_coordinates(axis, grid, order=1) - start + 0.5) / size - 0.5
                  ).astype(np.float32) for axis, start in zip(mesh, low, strict=True)]
        is_finite = np.isfinite(at_pixels[0])
        # Where the start gives no position, one beyond the raster is taken, which is not known.
        at_pixels = [np.where(is_finite, axis, -9).astype(np.float32) for axis in at_pixels]
        seen_known = cv2.remap(is_known.astype(np.float32), at_pixels[1], at_pixels[0],
                               cv2.INTER_LINEAR)
        return ReferencePatch(cv2.remap(pixels, at_pixels[1], at_pixels[0], cv2.INTER_CUBIC),
                              # Only where all pixels that take part are known.
                              np.asarray(is_finite & (seen_known > 0.999)), mesh)

    def shown(self, picture: GreyRaster) -> Mask:
        """Return where both the image and the reference have data, shape (33, 33).

        Parameters
        ----------
        picture : GreyRaster
            The image, over which the 33 by 33 positions are spread evenly.
        """
        image = spread_pixels(picture.size, (COVERS, COVERS))
        has_both = np.ones(len(image), dtype=bool)
        for raster, positions in ((picture, image), (self.picture, self.seen(image))):
            has_both &= raster.known_at(positions)
        return has_both.reshape(COVERS, COVERS)

    def footprint(self, size: tuple[int, int]) -> tuple[int, int, int, int] | None:
        """Return the part of an image that the reference covers by the start; None if it has none.

        It has none, too, if the part is narrower than 24 px.

        Parameters
        ----------
        size : tuple of int
            Lines and samples of the image.

        Returns
        -------
        tuple of int
            Line and sample of its first pixel, lines and samples.
        """
        # Positions spread over the reference, its edges included, are projected into the image.
        ground = self.ground(spread_pixels(self.picture.size, (_EDGE_PLACES, _EDGE_PLACES)))
        x, y = self.to_map.transform(ground[:, 0], ground[:, 1], direction="INVERSE")
        plane = np.column_stack([x, y])
        if callable(self.heights):
            heights = self.heights(plane)
        else:
            heights = np.full(len(plane), self.heights)
        at_image = self.start.project(np.column_stack([plane, heights]))
        at_image = at_image[np.isfinite(at_image).all(axis=1)]
        if not len(at_image):
            return None
        low = np.maximum(np.floor(at_image.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(at_image.max(axis=0)).astype(int) + 1, size)
        if (high - low < _REFERENCE_MESH).any():
            return None
        (first_line, first_sample) = low.tolist()
        (lines, samples) = (high - low).tolist()
        return first_line, first_sample, lines, samples

    def bounds(self, crs: str) -> tuple[float, float, float, float]:
        """Return least x and y and largest x and y of the reference in a CRS."""
        from rasterio.warp import transform_bounds

        west, south, east, north = transform_bounds(self.crs, crs, *self.picture.raster.bounds)
        return west, south, east, north

    def reduction(self, size: tuple[int, int]) -> int:
        """Return how many pixels of the image make one of the size of the reference's, at least 1.

        Parameters
        ----------
        size : tuple of int
            Lines and samples of the image.
        """
        middle = np.array(size) / 2
        # The middle of the image, and positions 24 px below and to the right of it.
        at_reference = self.seen(middle + np.array([[0, 0], [_REFERENCE_MESH, 0],
                                                    [0, _REFERENCE_MESH]]))
        spacing = _mesh_spacing(at_reference[[0, 1, 0, 2]].T.reshape(2, 2, 2))
        return max(1, round(_REFERENCE_MESH / spacing / _SAME_SIZE))


def _mesh_spacing(mesh: FloatArray) -> float:
    """Return the median distance in the reference of neighbours of a mesh (2, a, b) [px].

    If no distance is known, it is 24 px, as if both images had pixels of one size.
    """
    along_lines, along_samples = (np.linalg.norm(np.diff(mesh, axis=axis), axis=0).ravel()
                                  for axis in (1, 2))
    distances = np.concatenate([along_lines, along_samples])
    distances = distances[np.isfinite(distances) & (distances > 0)]
    return float(np.median(distances)) if len(distances) else float(_REFERENCE_MESH)


def _map_to_pixels(transform: Any, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) of map coordinates (n,); (0, 0) is the first pixel's centre."""
    with np.errstate(invalid="ignore", over="ignore"):
        column, row = ~transform @ (x, y)
    return np.stack([row, column], axis=1) - 0.5


@contextmanager
def open_reference(path: Path | str, start: Start, dem: Path | str | None, size: tuple[int, int],
                   band: int | None = None, masks: Sequence[Path | str] = (),
                   ) -> Iterator[Reference]:
    """Open a georeferenced image and the heights of its area.

    Parameters
    ----------
    path : path-like
        The georeferenced image.
    start : Start
        Rough geometry of the image that is to be matched with it.
    dem : path-like, optional
        Raster of heights; without it, the height that the start states holds everywhere.
    size : tuple of int
        Lines and samples of the image that is to be matched.
    band : int, optional
        See `open_picture`.
    masks : sequence of path-like
        Files of polygons in which nothing is matched. Only those with a CRS count here.

    Yields
    ------
    Reference
        The georeferenced image with its heights; both are closed on leaving.

    Raises
    ------
    NotShown
        If the reference shows nothing of what the image shows by the start.
    TermselError
        If the georeferenced image has no CRS or no geotransform; if it or the DEM cannot be read;
        if the DEM covers nothing of the image, or the start gives no ground position for it.
    """
    with ExitStack() as stack:
        picture = stack.enter_context(open_picture(path, band))
        crs = crs_of(picture)
        picture = replace(picture, excluded=mask_from_ground(masks, crs, picture.raster.transform))
        heights: list[Heights] = []
        # Heights are needed in both CRSs: the start projects from one, the reference lies in the
        # other.
        for of_crs in (start.crs, crs):
            if dem is None:
                heights.append(start.height)
            else:
                heights.append(stack.enter_context(open_dem(Path(dem), of_crs)))
        try:
            to_map = plane_transformer(start.crs, crs)
        except TermselError as error:
            raise TermselError(f"the CRS of {start.description} cannot be transformed to that of "
                               f"this raster: {error.what}", file=path,
                               hint="Give a reference in a CRS of the Earth.") from error
        reference = Reference(picture, crs, start, heights[0], heights[1], to_map)
        _require_overlap(reference, size, dem)
        yield reference


_RASTERS = (".tif", ".tiff", ".vrt", ".jp2", ".img", ".png", ".jpg")
"""Extensions of the files in a folder that are taken for images."""


def references_of(named: Path | str) -> list[Path]:
    """Return the files of a reference: a file itself, or the images in a folder, sorted by name.

    Raises
    ------
    TermselError
        If a folder has no image.
    """
    path = Path(named)
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in _RASTERS)
    if not files:
        raise TermselError("this folder has no image", file=path,
                           hint=f"Give one with georeferenced images ({', '.join(_RASTERS)}).")
    return files


def _require_overlap(reference: Reference, size: tuple[int, int], dem: Path | str | None) -> None:
    """Raise NotShown if the reference shows nothing of an image.

    `size` has the lines and samples of the image. Raises TermselError if the DEM covers none of the
    image, or if the start has no ground position for it.
    """
    at_reference = reference.seen(spread_pixels(size, (COVERS, COVERS)))
    # The way to the reference is by the start, with heights of the DEM: NaN where either fails.
    is_finite = np.isfinite(at_reference).all(axis=1)
    if not is_finite.any():
        by = reference.start.description
        if dem is None:
            raise TermselError(f"{by} has no ground position for the image",
                               hint="Give another --start, with the RPC or some points of this "
                                    "image.")
        raise TermselError(f"the DEM does not cover the image, which by {by} is at "
                           f"{_position_of_image(reference.start, size)}", file=dem,
                           hint="Give a DEM of that area; if the place is wrong, another --start.")
    last = np.array(reference.picture.size) - 1
    inside = is_finite & ((at_reference >= 0) & (at_reference <= last)).all(axis=1)
    if not inside.any():
        raise NotShown(
            f"the reference does not show the image: it is at {_position_of_picture(reference)}, "
            f"the image by {reference.start.description} at "
            f"{_position_of_image(reference.start, size)}",
            file=reference.picture.path,
            hint="Give a reference of that place; if the place is wrong, another --start.")


def _position_of_image(start: Start, size: tuple[int, int]) -> str:
    """Return where an image of lines and samples is by a start, in words."""
    ground = start.locate(spread_pixels(size, (2, 2)), start.height)
    return middle_in_words(ground[:, :2], start.crs)


def _position_of_picture(reference: Reference) -> str:
    """Return where the middle of a reference is, in words."""
    lines, samples = reference.picture.size
    middle = reference.picture.raster.transform @ (samples / 2, lines / 2)
    return middle_in_words(np.array([middle], dtype=float), reference.crs)
