"""Results as RPC files, each read back and compared before it is put in place."""

from __future__ import annotations

import logging
from abc import abstractmethod
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.atomic import (
    atomic_path,
    private_folder,
    utf8_bytes,
    write_bytes,
    write_text,
)
from termsel.core.files.names import is_there
from termsel.core.files.reasons import reason_of
from termsel.core.options import Option
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import LOCAL, normalise, to_wgs84
from termsel.data.coordinates.metres import height_unit
from termsel.data.rasters import empty_tiff, open_raster, require_rasterio
from termsel.data.rpc import Rpc
from termsel.formats.base import Writer
from termsel.formats.deviation import places_of, say_deviation
from termsel.formats.heights import note_on_ellipsoid, pixels_by
from termsel.formats.rpc_control import control_items
from termsel.formats.rpc_files import read_rpc, rpb_text, rpc_items, rpc_txt_text
from termsel.formats.vertical import UNDECLARED
from termsel.formats.vrt import IMAGE, picture_for, vrt_text
from termsel.results.result import Result

log = logging.getLogger(__name__)

AGREED = 1e-6
"""Largest difference between GDAL's and termsel's use of a written RPC [px]."""

STEP_OF_HEIGHT = 10.0
"""Difference of heights whose effect is said where their datum is not known [m]."""

_FOR_OTB = {"METADATATYPE": "GE"}
"""What GDAL says of an image with a _RPC.TXT; OTB looks for an RPC where it is said."""

_SIDECAR = Option("image", None, "The image for which the file is written; termsel checks that "
                                 "GDAL uses this RPC for it.")


_HEIGHTS = Option("heights", None, "Least and largest height of the ground that the RPC is for, "
                                   "such as 0,4000; by default those of the control.")


class RpcWriter(Writer):
    """Base of the writers of RPC files."""

    needs = ("a model of ground coordinates in a CRS, which an RPC can follow; pyproj "
             "(termsel[gis]) unless the CRS is EPSG:4979 or EPSG:4326")

    def accepts(self, result: Result) -> bool:
        """Return True if the ground coordinates are in a CRS."""
        return normalise(result.fit.control.crs) != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the RPC of a result, after it was read back and found the same.

        Image sizes and heights are the user's or the control's, since an RPC holds within its box
        alone. The file is private until it has been read back as the same RPC. Then the log says
        how far it deviates from the model. Raises TermselError where the RPC cannot follow the
        model.
        """
        image = self.options["image"]
        if image is not None:
            # An RPC is scaled to the size of its image, which files of points do not state.
            result = result.of_image(picture_for(result, image).size)
        heights = self._height_range()
        rpc = result.to_rpc(heights)
        text = self.text(rpc, result, path)
        with atomic_path(path) as temporary:
            temporary.write_bytes(utf8_bytes(text))
            require_read_back(rpc, text, self.suffix)
        self.warn_if_unused(rpc, path)
        sampled = places_of(result.fit, heights)
        with np.errstate(all="ignore"):
            image = rpc.project(to_wgs84(result.fit.control.crs)(sampled))
        _warn_of_unknown_datum(result)
        say_deviation(self.name, result.fit, sampled, image,
                      ", over the image and "
                      + ("the heights of the control" if heights is None else
                         f"heights from {heights[0]:g} to {heights[1]:g}"))

    def _height_range(self) -> tuple[float, float] | None:
        """Return the least and the largest height of the option `heights`; None if it is not given.

        Raises TermselError if these are no two numbers in this order.
        """
        text = self.options["heights"]
        if text is None:
            return None
        try:
            low, high = map(float, str(text).split(","))
        except ValueError:
            low = np.nan
            high = np.nan
        if not (np.isfinite([low, high]).all() and low <= high):
            raise TermselError(f"option 'heights' cannot be {text!r}",
                               hint="Give the least and the largest height, such as "
                                    "heights=0,4000.", name="heights")
        return low, high

    @abstractmethod
    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the content of the file."""

    def warn_if_unused(self, rpc: Rpc, path: Path) -> None:
        """Warn if GDAL does not use the file that was written.

        An RPB beside the image, or a name that is not the image's, makes GDAL ignore the file
        without a word: the user would rectify by another RPC than the one just written.
        """
        image = self.options["image"]
        vendors = []
        # GDAL looks for an RPB first, and takes it.
        if self.suffix == "_RPC.TXT":
            candidates = [path.with_name(_file_stem(path, self.suffix) + ending)
                          for ending in (".RPB", ".rpb")]
            vendors = [candidate for candidate in candidates if is_there(candidate)]
        if vendors:
            log.warning("Warning: GDAL uses the RPC of %s and not that of %s. Move the former "
                        "away, or write a VRT with %s.", vendors[0].name, path.name,
                        Remedy("to", "rpc-vrt"))
        elif image is not None:
            with open_raster(image) as raster:
                rpc_in_use = raster.tags(ns="RPC")
            # GDAL's tags show whether it uses any; termsel's own reader shows which.
            if not rpc_in_use or read_rpc(Path(image)) != rpc:
                stem = Path(image).stem
                log.warning("Warning: GDAL does not use this RPC for %s. A file beside it has "
                            "priority, or this file is not named %s. %s avoids both.", image,
                            Path(image).with_name(stem + self.suffix), Remedy("to", "rpc-vrt"))


def _warn_of_unknown_datum(result: Result) -> None:
    """Warn where heights of the control are from a raster that does not state their datum."""
    heights = result.features.heights
    if not heights.endswith(UNDECLARED):
        return
    if note := note_on_ellipsoid(result.features, result.project):
        log.warning("Warning: %s", note)
        return
    # How far geoid and ellipsoid are apart there is not known: the effect is told by the step.
    step = STEP_OF_HEIGHT / height_unit(result.features.crs)
    pixels = pixels_by(step, result.features, result.project)
    log.warning("Warning: %s. An RPC takes ellipsoidal heights: if these are above a geoid, the "
                "RPC is wrong by %.2g px for each %.0f m between the two. State the datum in the "
                "CRS of the raster, such as EPSG:4326+5773 for EGM96, and run again.",
                heights, pixels, STEP_OF_HEIGHT)


class Rpb(RpcWriter):
    """RPC as the file IMAGE.RPB next to an image, which GDAL prefers to all others."""

    name = "rpb"
    summary = "RPC as IMAGE.RPB, which GDAL and QGIS use for IMAGE.tif beside it"
    suffix = ".RPB"
    declared_options: ClassVar[tuple[Option, ...]] = (_SIDECAR, _HEIGHTS)

    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the text of an RPB file."""
        return rpb_text(rpc)


class RpcTxt(RpcWriter):
    """RPC as the file IMAGE_RPC.TXT next to an image, which GDAL uses if there is no RPB."""

    name = "rpc-txt"
    summary = "RPC as IMAGE_RPC.TXT, which GDAL, QGIS and OTB use for IMAGE.tif beside it"
    suffix = "_RPC.TXT"
    declared_options: ClassVar[tuple[Option, ...]] = (_SIDECAR, _HEIGHTS)

    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the text of a _RPC.TXT file."""
        return rpc_txt_text(rpc)


class RpcVrt(RpcWriter):
    """RPC in a virtual raster of an image, whatever vendor files are next to it."""

    name = "rpc-vrt"
    summary = "RPC in a VRT of the image, whatever vendor files are beside it"
    needs = RpcWriter.needs + "; --image for a VRT that has pixels"
    suffix = "_rpc.vrt"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE, _HEIGHTS)

    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the text of a VRT."""
        return vrt_text(picture_for(result, self.options["image"]), path.parent,
                        domains={"": _FOR_OTB | control_items(rpc), "RPC": rpc_items(rpc)})

    def warn_if_unused(self, rpc: Rpc, path: Path) -> None:
        """Do nothing: GDAL always uses a VRT's own RPC."""


def require_read_back(rpc: Rpc, text: str, suffix: str) -> None:
    """Raise TermselError for the content of a file from which termsel or GDAL takes another RPC.

    `text` is written as the file of a scene beside a tiny image, where GDAL finds it by `suffix`.
    Termsel must read the same numbers, and GDAL project to the same positions. Without rasterio a
    log says that GDAL was not asked.
    """
    with private_folder() as folder:
        path = folder / f"scene{suffix}"
        write_text(path, text)
        read_back = read_rpc(path)
        if read_back != rpc or read_back.control_digests != rpc.control_digests:
            raise TermselError("the RPC that is read back differs from the one that was written",
                               hint="This is a bug in termsel; please report it.")
        try:
            require_rasterio()
        except TermselError:
            log.info("The RPC was read back by termsel, but not by GDAL, as rasterio is not "
                     "installed.")
            return
        image = path
        if path.suffix.lower() != ".vrt":
            # GDAL looks for such files next to some kinds of images only.
            image = folder / "scene.tif"
            write_bytes(image, empty_tiff())
        _require_same_by_gdal(rpc, image)


def _require_same_by_gdal(rpc: Rpc, image: Path) -> None:
    """Raise TermselError for an RPC with which GDAL projects to other positions than termsel.

    GDAL reads the file `image` before anybody relies on it, as it rounds, clamps and iterates in
    its own way. Of 1,000 places all over the box of the RPC those near the image are compared. The
    error has the largest difference [px], or why GDAL cannot use the RPC.
    """
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import RasterioError
    from rasterio.transform import RPCTransformer

    # With a fixed seed, so that a file passes each time or never.
    share = np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 3))
    ground = share * rpc.ground_scale + rpc.ground_offset
    with np.errstate(all="ignore"):
        ours = rpc.project(ground)
    # Near a pole, far outside the image, nothing can be compared.
    near_image = (np.abs(ours - rpc.image_offset) <= 3 * np.abs(rpc.image_scale)).all(axis=1)
    try:
        with open_raster(image) as raster:
            rpcs = raster.rpcs
        with RPCTransformer(rpcs) as transformer:
            rows, columns = transformer.rowcol(*ground[near_image].T, op=np.asarray)
    except (RasterioError, CPLE_BaseError, ValueError) as error:
        raise TermselError(f"GDAL cannot use this RPC: {reason_of(error, image)}",
                           hint="A model cannot be inverted if its line or sample does not depend "
                                "on the ground position.") from error
    # GDAL counts from the corner of the upper-left pixel.
    difference = np.abs(np.column_stack([rows, columns]) - 0.5 - ours[near_image])
    if not near_image.any() or not (difference <= AGREED).all():
        worst = difference.max() if difference.size else np.inf
        raise TermselError(
            f"GDAL's projection by this RPC differs by up to {worst:.3g} px",
            hint="The model is unusable near the edges of its ground: choose a simpler one.")


def _file_stem(path: Path, suffix: str) -> str:
    """Return the name of a file without a suffix of several parts, such as _RPC.TXT."""
    return path.name[:-len(suffix)] if path.name.upper().endswith(suffix.upper()) else path.stem
