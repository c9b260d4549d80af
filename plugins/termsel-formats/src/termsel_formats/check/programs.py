"""All programs that are installed, asked for one raster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from termsel import TermselError
from termsel_formats.check import gdal, otb, qgis, raster
from termsel_formats.check.base import NoAnswer, Taken

Ask = Callable[[Path, gdal.Header], Taken | None]

__all__ = ["Answers", "Taken", "taken_by"]


@dataclass(frozen=True)
class Answers:
    """What programs take from a raster.

    Parameters
    ----------
    taken : tuple of Taken
    absent : tuple of str
        Programs that are not installed.
    failed : tuple of str
        What programs say that cannot read it.
    """

    taken: tuple[Taken, ...]
    absent: tuple[str, ...]
    failed: tuple[str, ...]


def taken_by(path: Path | str) -> Answers:
    """Return what the installed ones of GDAL, rasterio, QGIS and OTB take from a raster.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Answers

    Raises
    ------
    TermselError
        If no program can read it.
    """
    path = Path(path)
    known: list[Taken] = []
    absent = []
    failed = []
    try:
        known += raster.taken(path)
        found = gdal.header(path)
    except NoAnswer as error:
        found = None
        failed = [str(error)]
    if found is None:
        return Answers(tuple(known), () if failed else ("GDAL (gdalinfo, gdaltransform)",),
                       tuple(failed))
    for name, ask in (("GDAL", gdal.taken), ("QGIS", _one(qgis.taken)), ("OTB", _one(otb.taken))):
        try:
            more = list(ask(path, found))
        except NoAnswer as error:
            failed.append(str(error))
            continue
        known += more
        if not more:
            absent.append(name)
    if not known:
        raise TermselError("no program can read this raster", file=path, hint="; ".join(failed))
    return Answers(tuple(known), tuple(absent), tuple(failed))


def _one(ask: Ask) -> Callable[[Path, gdal.Header], Iterator[Taken]]:
    def asked(path: Path, found: gdal.Header) -> Iterator[Taken]:
        one = ask(path, found)
        if one is not None:
            yield one

    return asked
