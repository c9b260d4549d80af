"""All programs that are installed, asked for one raster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from termsel_formats.check import gdal, otb, qgis, raster
from termsel_formats.check.base import NoAnswer, Taken

Ask = Callable[[Path, gdal.Header], Taken | None]

__all__ = ["Answers", "Taken", "taken_by_programs"]


@dataclass(frozen=True)
class Answers:
    """What programs take from a raster.

    Parameters
    ----------
    taken : tuple of Taken
        What each program takes by default, and with options.
    absent : tuple of str
        Programs that are not installed.
    failed : tuple of str
        What programs say that cannot read it.
    """

    taken: tuple[Taken, ...]
    absent: tuple[str, ...]
    failed: tuple[str, ...]


def taken_by_programs(path: Path | str) -> Answers:
    """Return what rasterio, GDAL, QGIS and OTB take from a raster.

    All but rasterio are asked as far as they are installed. QGIS and OTB are asked only if GDAL's
    command line is installed and reads the raster; else they are named neither among the absent nor
    among those that failed.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Answers
        What each program takes, and which programs are not installed or failed.

    Raises
    ------
    TermselError
        If rasterio is not installed or cannot read it.

    Examples
    --------
    >>> from termsel.testing import invoke
    >>> from termsel_formats import taken_by_programs
    >>> written = invoke("example", "files")
    >>> answers = taken_by_programs("files/ortho.tif")
    >>> answers.taken[0].program.partition(" ")[0], answers.taken[0].transformation
    ('rasterio', 'affine transformation')
    """
    path = Path(path)
    answers: list[Taken] = []
    absent = []
    failed = []
    # rasterio is a library with a GDAL of its own, which may differ from that of the command line.
    try:
        answers += raster.taken_by_rasterio(path)
        raster_header = gdal.read_gdalinfo(path)
    except NoAnswer as error:
        raster_header = None
        failed = [str(error)]
    if raster_header is None:
        return Answers(tuple(answers), () if failed else ("GDAL (gdalinfo, gdaltransform)",),
                       tuple(failed))
    programs = (("GDAL", gdal.taken_by_gdal), ("QGIS", _as_iterator(qgis.taken_by_qgis)),
                ("OTB", _as_iterator(otb.taken_by_otb)))
    for name, ask in programs:
        try:
            program_answers = list(ask(path, raster_header))
        except NoAnswer as error:
            failed.append(str(error))
            continue
        answers += program_answers
        if not program_answers:
            absent.append(name)
    return Answers(tuple(answers), tuple(absent), tuple(failed))


def _as_iterator(ask: Ask) -> Callable[[Path, gdal.Header], Iterator[Taken]]:
    """Return a function that yields what `ask` returns, or nothing if that is None.

    GDAL has several answers, and other programs have one or none: so all can be asked alike.
    """
    def answers_of(path: Path, raster_header: gdal.Header) -> Iterator[Taken]:
        answer = ask(path, raster_header)
        if answer is not None:
            yield answer

    return answers_of
