"""World files (.tfw, .pgw, .jgw, .wld): the affine map of an image in six lines.

The last two numbers are where the centre of the first pixel is, which is termsel's origin too.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, Result, TermselError, open_raster
from termsel.toolkit import FloatArray, Remedy, read_text, say_deviation, write_text
from termsel.toolkit.coordinates import LOCAL, horizontal_crs
from termsel.toolkit.files import places_of
from termsel.toolkit.models import refuse_sky
from termsel_formats.points.written import PointsWriter

log = logging.getLogger("termsel.formats")

# Fewest positions of the model to which the affine map is fitted.
_LEAST_POSITIONS = 9
_ENDINGS = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".jp2", ".bmp", ".gif", ".img", ".bil")


class WorldFile(Reader):
    """The affine map of a world file as five points: the corners of the image, and its middle.

    The image must be next to it, with the same name, or be named; it shows how large it is.
    """

    name = "world-file"
    summary = "world file (.tfw, .wld, ...) as points at the corners; --set image=FILE if apart"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("image", None, "The image; by default the one beside it with the same name."),)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for six lines of one number each."""
        try:
            return len([float(line) for line in head.split()]) == 6 and head.count(b"\n") >= 5
        except ValueError:
            return False

    def read(self, path: Path) -> FeatureSet:
        """Return the centres of the image's corner pixels and its middle as points.

        Raises TermselError, with file and line, for what is no world file, and if there is no image
        to show the size.
        """
        numbers = []
        for i, line in enumerate(read_text(path).splitlines(), 1):
            try:
                numbers += [float(line)] if line.strip() else []
            except ValueError:
                raise TermselError(f"{line.strip()!r:.40} is not a number", file=path, line=i,
                                   hint="A world file has six lines of one number.") from None
            if numbers and not np.isfinite(numbers[-1]):
                raise TermselError(f"{line.strip()!r:.40} is not a finite number", file=path,
                                   line=i, hint="A world file has six lines of one finite number.")
        if len(numbers) != 6:
            raise TermselError(f"this world file has {len(numbers)} numbers", file=path,
                               hint="A world file has six lines of one finite number.")
        with open_raster(self._image_of(path)) as raster:
            size = raster.shape
            crs = raster.crs
        lines = size[0] - 1.0
        samples = size[1] - 1.0
        image = np.array([[0, 0], [0, samples], [lines, 0], [lines, samples],
                          [lines / 2, samples / 2]])
        # x = A column + B row + C, y = D column + E row + F, in the order A, D, B, E, C, F, for the
        # centre of the upper-left pixel.
        a, d, b, e, c, f = numbers
        ground = image @ [[b, e], [a, d]] + [c, f]
        return FeatureSet(
            Points(("upper left", "upper right", "lower left", "lower right", "middle"), image,
                   np.column_stack([ground, np.full(5, np.nan)])),
            crs=_crs_name(crs), image_size=size)

    def _image_of(self, path: Path) -> Path:
        """Return the image that the option `image` names, or else the one beside the world file.

        Raises TermselError if there is none.
        """
        stated = self.options["image"]
        if stated is not None:
            if not Path(stated).is_file():
                raise TermselError("this image does not exist", file=stated,
                                   hint="Name it with --set image=FILE.")
            return Path(stated)
        for ending in _ENDINGS:
            if path.with_suffix(ending).is_file():
                return path.with_suffix(ending)
        raise TermselError("there is no image beside this world file", file=path,
                           hint="Name it with --set image=FILE.")


def _crs_name(crs: Any) -> str:
    """Return the CRS of a raster as EPSG:n, as WKT without such a number, "" for None."""
    if not crs:
        return ""
    epsg = crs.to_epsg()
    return f"EPSG:{epsg}" if epsg else crs.to_wkt()


class WorldFileWriter(PointsWriter):
    """The affine map nearest to the model, as a world file.

    How far it is from the model is said; where a model bends, that is far. A world file does not
    name its CRS, which is that of the result without heights.
    """

    name = "world-file"
    summary = "the affine map nearest to the model, as a world file (.tfw, .pgw, .wld)"
    needs = "a model that has places on the ground"
    suffix = ".tfw"

    def accepts(self, result: Result) -> bool:
        """Return True for any result."""
        return True

    def write(self, result: Result, path: Path) -> None:
        """Write the six numbers of the affine map that is nearest to the model by least squares.

        Its deviation from the model [px] is logged. Raises TermselError for a model of the sky,
        if the model has too few ground positions for an affine map, or they lie on a line, and if
        the nearest map would put the whole image on a line.
        """
        fitted = result.fit
        refuse_sky(fitted, "an affine map")
        ground = places_of(fitted)
        # The model cannot be inverted over the image: the control is where it is known.
        if len(ground) < _LEAST_POSITIONS:
            ground = fitted.control.points.ground
        image = fitted.project(ground)
        finite = np.isfinite(image).all(axis=1)
        design = np.column_stack([np.ones(finite.sum()), image[finite, 1], image[finite, 0]])
        if np.linalg.matrix_rank(design) < 3:
            raise TermselError("the model gives no ground positions for most of the image",
                               file=path, hint="Fit a simpler model, such as "
                                               f"{Remedy('model', 'affine')}.")
        # Ground coordinates are large next to the extent of the image: counted from their middle,
        # they keep their digits.
        middle = ground[finite, :2].mean(axis=0)
        (x, y), (right_x, right_y), (down_x, down_y) = np.linalg.lstsq(
            design, ground[finite, :2] - middle, rcond=None)[0].tolist()
        numbers = (right_x, right_y, down_x, down_y, x + middle[0], y + middle[1])
        # Without an inverse the map would put the whole image on a line.
        matrix = np.array([[down_x, right_x], [down_y, right_y]])
        if np.linalg.matrix_rank(matrix) < 2:
            raise TermselError("no affine map comes near the model", file=path,
                               hint="Export the points instead, such as "
                                    f"{Remedy('to', 'gcp-vrt')}.")
        write_text(path, "".join(f"{float(number)!r}\n" for number in numbers))
        say_deviation(self.name, fitted, ground, _ground_to_image(ground, numbers, matrix))
        crs = result.features.crs
        log.info("A world file does not name its CRS. It is %s.",
                 "that of plane coordinates" if crs == LOCAL else horizontal_crs(crs))


def _ground_to_image(
        ground: FloatArray, numbers: tuple[float, ...], matrix: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) of ground positions (n, 2 or 3) by the map of a world file.

    `numbers` are those of the file, the last two being x and y of the first pixel; `matrix` (2, 2)
    has the derivatives of x and y by line and sample.
    """
    return np.asarray(np.linalg.solve(matrix, (ground[:, :2] - numbers[4:]).T).T)
