"""Projections that an old map may have been drawn in, by its place and its century."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from termsel import TermselError
from termsel.toolkit import FloatArray, read_text
from termsel.toolkit.coordinates import normalise

MAX_CANDIDATES = 60
"""Candidates of a file: each takes as long as a choice of the model."""


@dataclass(frozen=True)
class Projection:
    """A projection that may be a map's.

    Parameters
    ----------
    name : str
    crs : str
        EPSG:n or a string of PROJ.
    first, last : int
        Centuries in which maps were drawn in it.
    """

    name: str
    crs: str
    first: int = 16
    last: int = 21


def candidate_projections(ground: FloatArray, century: int | None = None) -> list[Projection]:
    """Return the projections of maps of a place, longitudes and latitudes (n, 2) [deg].

    Their parameters are those of the place: the middle meridian and parallel, and standard
    parallels a sixth of the extent within it (a rule of Kavraisky's). Of a century those that were
    used then (Snyder 1993, Flattening the Earth).
    """
    west, south = ground.min(axis=0)
    east, north = ground.max(axis=0)
    # Back to -180 to 180: longitudes may go on beyond the meridian.
    lon = ((west + east) / 2.0 + 180.0) % 360.0 - 180.0
    lat = (south + north) / 2.0
    # Of a single place the extent is 0, and both parallels would be one.
    sixth = max((north - south) / 6.0, 1e-3)
    first_parallel = lat - 2.0 * sixth
    second_parallel = lat + 2.0 * sixth
    earth = "+datum=WGS84 +units=m +no_defs"
    at = f"+lon_0={lon:.5f}"
    conic = (f"+lat_1={first_parallel:.5f} +lat_2={second_parallel:.5f} +lat_0={lat:.5f} "
             f"{at} {earth}")
    around = f"+lat_0={lat:.5f} {at} {earth}"
    zone = int((lon + 180.0) // 6.0) + 1
    projections = [
        Projection("equirectangular", f"+proj=eqc +lat_ts={lat:.5f} {at} {earth}"),
        Projection("plate carree", f"+proj=eqc +lat_ts=0 {at} {earth}", last=18),
        Projection("Mercator", f"+proj=merc {at} {earth}"),
        Projection("sinusoidal", f"+proj=sinu {at} {earth}", last=19),
        Projection("Bonne", f"+proj=bonne +lat_1={lat:.5f} {at} {earth}", first=18, last=20),
        Projection("Cassini", f"+proj=cass {around}", first=18, last=20),
        Projection("equidistant conic", f"+proj=eqdc {conic}", first=18, last=20),
        Projection("polyconic", f"+proj=poly {around}", first=19, last=20),
        Projection("Albers", f"+proj=aea {conic}", first=19),
        Projection("Lambert conformal conic", f"+proj=lcc {conic}", first=19),
        Projection("stereographic", f"+proj=sterea {around}", first=19),
        Projection("Lambert azimuthal", f"+proj=laea {around}", first=19),
        Projection("azimuthal equidistant", f"+proj=aeqd {around}"),
        Projection("transverse Mercator", f"+proj=tmerc {around}", first=19),
        Projection(f"UTM {zone}{'S' if lat < 0 else 'N'}",
                   f"EPSG:32{7 if lat < 0 else 6}{zone:02d}", first=20)]
    return [projection for projection in projections if century is None
            or projection.first <= century <= projection.last]


def projections_of_file(path: Path | str) -> list[Projection]:
    """Return the projections of a file: a CRS a line, with its name after a #.

    Raises
    ------
    TermselError
        If it cannot be read, names none or too many, or one that is no CRS.
    """
    projections = []
    for number, line in enumerate(read_text(Path(path)).splitlines(), 1):
        crs, _, name = line.partition("#")
        if not crs.strip():
            continue
        try:
            normalise(crs.strip())
        except TermselError as error:
            raise TermselError(error.what, file=path, line=number, hint=error.hint) from error
        projections.append(Projection(name.strip() or crs.strip(), crs.strip()))
    if not 0 < len(projections) <= MAX_CANDIDATES:
        raise TermselError(f"there are {len(projections)} projections in this file", file=path,
                           hint=f"Give 1 to {MAX_CANDIDATES}, a CRS a line: "
                                "EPSG:27572  # Lambert II.")
    return projections
