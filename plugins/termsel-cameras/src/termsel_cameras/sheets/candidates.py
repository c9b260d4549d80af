"""Projections that an old map may have been drawn in, by its place and its century."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from termsel import FeatureSet, TermselError
from termsel.toolkit import FloatArray, read_text
from termsel.toolkit.coordinates import normalise, to_wgs84
from termsel_cameras.roles import without_independent

MAX_CANDIDATES = 60
"""Candidates of a file: each takes as long as a choice of the model."""

WIDE, NEAR_GREENWICH = 120.0, 30.0
"""Range of longitudes [deg] from which on a map may be one of the world, and longitude of its
middle up to which its middle meridian is Greenwich's."""


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
    """Return the projections in which a map may have been drawn.

    `ground` (n, 2) are longitudes and latitudes [deg] of the map, which give the parameters: the
    middle meridian and parallel, and standard parallels a sixth of the extent within the map (a
    rule of Kavraisky's). With a `century` they are those that were used then (Snyder 1993,
    Flattening the Earth), otherwise all.
    """
    west, south = ground.min(axis=0)
    east, north = ground.max(axis=0)
    # Longitudes may go on beyond 180 degrees, and are brought back.
    lon = ((west + east) / 2.0 + 180.0) % 360.0 - 180.0
    lat = (south + north) / 2.0
    # A conic projection requires two parallels that differ, which a map of one latitude has not.
    sixth = max((north - south) / 6.0, 1e-3)
    first_parallel = lat - 2.0 * sixth
    second_parallel = lat + 2.0 * sixth
    earth = "+datum=WGS84 +units=m +no_defs"
    # Parameters of projections with a meridian, with a centre, and with two parallels.
    meridian = f"+lon_0={lon:.5f} {earth}"
    centre = f"+lat_0={lat:.5f} {meridian}"
    conic = f"+lat_1={first_parallel:.5f} +lat_2={second_parallel:.5f} {centre}"
    zone = int((lon + 180.0) // 6.0) + 1
    projections = [
        Projection("equirectangular", f"+proj=eqc +lat_ts={lat:.5f} {meridian}"),
        Projection("plate carree", f"+proj=eqc +lat_ts=0 {meridian}", last=18),
        Projection("Mercator", f"+proj=merc {meridian}"),
        Projection("sinusoidal", f"+proj=sinu {meridian}", last=19),
        Projection("Bonne", f"+proj=bonne +lat_1={lat:.5f} {meridian}", first=18, last=20),
        Projection("Cassini", f"+proj=cass {centre}", first=18, last=20),
        Projection("equidistant conic", f"+proj=eqdc {conic}", first=18, last=20),
        Projection("polyconic", f"+proj=poly {centre}", first=19, last=20),
        Projection("Albers", f"+proj=aea {conic}", first=19),
        Projection("Lambert conformal conic", f"+proj=lcc {conic}", first=19),
        Projection("stereographic", f"+proj=sterea {centre}", first=19),
        Projection("Lambert azimuthal", f"+proj=laea {centre}", first=19),
        Projection("azimuthal equidistant", f"+proj=aeqd {centre}"),
        Projection("transverse Mercator", f"+proj=tmerc {centre}", first=19),
        Projection(f"UTM {zone}{'S' if lat < 0 else 'N'}",
                   f"EPSG:32{7 if lat < 0 else 6}{zone:02d}", first=20)]
    if east - west >= WIDE:
        # Control is seldom at both edges, and most maps of the world have Greenwich in the middle.
        middle = f"+lon_0={0.0 if abs(lon) <= NEAR_GREENWICH else lon:.5f} {earth}"
        projections += [Projection("Mollweide", f"+proj=moll {middle}", first=19),
                        Projection("Winkel tripel", f"+proj=wintri {middle}", first=20),
                        Projection("Robinson", f"+proj=robin {middle}", first=20)]
    return [projection for projection in projections if century is None
            or projection.first <= century <= projection.last]


def projections_of_file(path: Path | str) -> list[Projection]:
    """Return the projections of a file: a CRS a line, with its name after a #.

    Raises
    ------
    TermselError
        If it cannot be read, if it has no projection or more than `MAX_CANDIDATES`, or if a line
        is no CRS.
    """
    projections = []
    # A line without a CRS is blank or a comment.
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


def candidates_of(sheets: list[FeatureSet], file: str | None,
                  century: int | None) -> list[Projection]:
    """Return the projections to choose from: those in `file`, or by the sheets and the century."""
    if file is not None:
        return projections_of_file(file)
    return candidate_projections(corners_of_sheets(sheets), century)


def corners_of_sheets(sheets: list[FeatureSet]) -> FloatArray:
    """Return the south-western and north-eastern corner of all sheets (2, 2).

    Rows are longitude and latitude on WGS84 [deg]. Across 180 degrees the eastern longitude is
    larger than that. Independent points take no part, as the corners decide what is tried.

    Raises
    ------
    TermselError
        If no sheet has features that take part.
    """
    vertices = []
    for sheet in map(without_independent, sheets):
        ground = sheet.ground_vertices().copy()
        ground[:, 2] = 0.0
        vertices.append(to_wgs84(sheet.crs)(ground)[:, :2])
    degrees = np.concatenate(vertices)
    if not len(degrees):
        raise TermselError("no map has control points, which show what projections to try",
                           hint="Measure control points, or state the projection.")
    # All longitudes are brought to within half a turn of the first.
    first = degrees[0, 0]
    degrees[:, 0] = first + (degrees[:, 0] - first + 180.0) % 360.0 - 180.0
    return np.stack([degrees.min(axis=0), degrees.max(axis=0)])
