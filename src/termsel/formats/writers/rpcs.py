"""Results as RPC files, each read back and compared before it takes its place."""

from __future__ import annotations

import logging
from abc import abstractmethod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np

from termsel.errors import TermselError
from termsel.formats.atomic import atomic_path, write_bytes, write_text
from termsel.formats.base import Writer
from termsel.formats.rasters import empty_tiff, open_raster, require_rasterio
from termsel.formats.rpc_files import read_rpc, rpb_text, rpc_items, rpc_txt_text
from termsel.formats.vrt import IMAGE, picture_for, vrt_text
from termsel.measurements.crs import LOCAL, normalise
from termsel.models.rpc import Rpc
from termsel.options import Option
from termsel.results.result import Result

log = logging.getLogger(__name__)

AGREED = 1e-6
"""Pixels by which GDAL's use of a written RPC may differ from termsel's."""

_SIDECAR = Option("image", None, "The image the file is for: GDAL is asked whether it takes this "
                                 "RPC for it.")


class RpcWriter(Writer):
    """Common to the forms of RPC files."""

    def accepts(self, result: Result) -> bool:
        """Return True if the ground coordinates are in a CRS."""
        return normalise(result.fit.control.crs) != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the RPC of a result, once GDAL or termsel has read it back.

        Raises
        ------
        TermselError
            As `termsel.models.rpc_fit.rpc_of`; if what is read back is another RPC; if the file
            cannot be written.
        """
        image = self.options["image"]
        if image is not None:
            result = result.of_image(picture_for(result, image).size)
        rpc = result.to_rpc()
        text = self.text(rpc, result, path)
        with atomic_path(path) as temporary:
            temporary.write_bytes(text.encode("utf-8"))
            require_read_back(rpc, text, self.suffix)
        self.written(rpc, path)

    @abstractmethod
    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the content of the file."""

    def written(self, rpc: Rpc, path: Path) -> None:
        """Say where GDAL does not take the file that was written."""
        image = self.options["image"]
        vendors = [beside for ending in (".RPB", ".rpb") if self.suffix == "_RPC.TXT"
                   for beside in [path.with_name(_stem(path, self.suffix) + ending)]
                   if beside.exists()]
        if vendors:
            log.warning("Warning: GDAL takes the RPC of %s rather than that of %s. Move it away, "
                        "or write a VRT: --to rpc-vrt.", vendors[0].name, path.name)
        elif image is not None:
            with open_raster(image) as raster:
                taken = raster.tags(ns="RPC")
            if not taken or read_rpc(Path(image)) != rpc:
                stem = Path(image).stem
                log.warning("Warning: GDAL does not take this RPC for %s; a file of higher "
                            "priority may lie beside it, or this one is not called %s. --to "
                            "rpc-vrt writes a file that needs neither.", image,
                            Path(image).with_name(stem + self.suffix))


class Rpb(RpcWriter):
    """RPC as the file IMAGE.RPB beside an image, which GDAL prefers to all others."""

    name = "rpb"
    summary = "RPC as IMAGE.RPB, which GDAL, QGIS and OTB use for IMAGE.tif beside it"
    suffix = ".RPB"
    declared_options: ClassVar[tuple[Option, ...]] = (_SIDECAR,)

    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the text of an RPB file."""
        return rpb_text(rpc)


class RpcTxt(RpcWriter):
    """RPC as the file IMAGE_RPC.TXT beside an image, which GDAL uses if there is no RPB."""

    name = "rpc-txt"
    summary = "RPC as IMAGE_RPC.TXT, which GDAL, QGIS and OTB use for IMAGE.tif beside it"
    suffix = "_RPC.TXT"
    declared_options: ClassVar[tuple[Option, ...]] = (_SIDECAR,)

    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the text of a _RPC.TXT file."""
        return rpc_txt_text(rpc)


class RpcVrt(RpcWriter):
    """RPC in a virtual raster of an image, whatever vendor's files lie beside that."""

    name = "rpc-vrt"
    summary = "RPC in a VRT of the image, whatever vendor files lie beside it"
    suffix = "_rpc.vrt"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE,)

    def text(self, rpc: Rpc, result: Result, path: Path) -> str:
        """Return the text of a VRT."""
        return vrt_text(picture_for(result, self.options["image"]), path.parent,
                        domains={"RPC": rpc_items(rpc)})

    def written(self, rpc: Rpc, path: Path) -> None:
        """Say nothing: a VRT's own RPC comes first."""


def require_read_back(rpc: Rpc, text: str, suffix: str) -> None:
    """Refuse text that is not read back as the RPC it was made from.

    Parameters
    ----------
    rpc : Rpc
    text : str
        Content of a file.
    suffix : str
        What its name ends with.

    Raises
    ------
    TermselError
        If termsel reads another RPC, or GDAL, where rasterio is installed, cannot use it or
        projects 1,000 ground points elsewhere by more than AGREED.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"scene{suffix}"
        write_text(path, text)
        if read_rpc(path) != rpc:
            raise TermselError("the RPC that was written is not what is read back",
                               hint="This is a fault of termsel; please report it.")
        try:
            require_rasterio()
        except TermselError:
            log.info("The RPC was read back by termsel; without rasterio GDAL was not asked.")
            return
        image = path
        if path.suffix.lower() != ".vrt":
            # GDAL looks for such files beside some kinds of images only.
            image = Path(folder) / "scene.tif"
            write_bytes(image, empty_tiff())
        _require_same_by_gdal(rpc, image)


def _require_same_by_gdal(rpc: Rpc, image: Path) -> None:
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import RasterioError
    from rasterio.transform import RPCTransformer

    share = np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 3))
    ground = share * rpc.ground_scale + rpc.ground_offset
    with np.errstate(all="ignore"):
        ours = rpc.project(ground)
    # Near a pole, far outside the image, nothing can be compared.
    seen = (np.abs(ours - rpc.image_offset) <= 3 * np.abs(rpc.image_scale)).all(axis=1)
    try:
        with open_raster(image) as raster, RPCTransformer(raster.rpcs) as transformer:
            rows, columns = transformer.rowcol(*ground[seen].T, op=np.asarray)
    except (RasterioError, CPLE_BaseError, ValueError) as error:
        raise TermselError(f"GDAL cannot use this RPC: {error}",
                           hint="A model whose line or sample does not depend on the ground "
                                "position cannot be inverted.") from error
    # GDAL counts from the corner of the upper-left pixel.
    apart = np.abs(np.column_stack([rows, columns]) - 0.5 - ours[seen])
    if not seen.any() or not (apart <= AGREED).all():
        raise TermselError(
            f"GDAL projects by this RPC up to {apart.max(initial=np.inf):.3g} px elsewhere",
            hint="The model is not fit for use near the edges of its ground: choose a plainer one.")


def _stem(path: Path, suffix: str) -> str:
    return path.name[:-len(suffix)] if path.name.upper().endswith(suffix.upper()) else path.stem
