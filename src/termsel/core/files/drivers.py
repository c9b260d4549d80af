"""Which drivers of GDAL may open a file, and the settings under which they do.

Some of GDAL's drivers write while they read, run what a file says, or read other files as raw
bytes. So a list names those that may open what a user gives; all others are off until the user
names them. A file never does.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

from termsel.core.errors import TermselError

RASTER_DRIVERS = ("VRT", "GTiff", "COG", "HFA", "AAIGrid", "PNG", "JPEG", "GIF", "BMP",
                  "JP2OpenJPEG", "JP2KAK", "JP2ECW", "JP2MrSID", "JPEG2000", "WEBP", "ENVI", "EHdr",
                  "NITF", "DTED", "SRTMHGT")
"""Open rasters: of each, a file is pixels and text alone, or names rasters of these drivers."""

VECTOR_DRIVERS = ("GPKG", "ESRI Shapefile", "FlatGeobuf", "GeoJSON", "GeoJSONSeq", "KML", "LIBKML",
                  "GML", "GPX")
"""Open vector files, in a process of their own (see `termsel.core.files.apart`)."""

WORKING_DRIVERS = ("MEM", "Memory")
"""Needed for arrays in memory; they open no file."""

_OFF = """
ACE2, ADBC, ADRG, AIG, AIVector, ARG, AVCBin, AVCE00, AirSAR, AmigoCloud, Arrow, BAG, BIGGIF, BLX,
BSB, BT, BYN, CAD, CALS, CEOS, COASP, COSAR, CPG, CSV, CSW, CTG, CTable2, Carto, Cloudant,
CouchDB, DAAS, DB2ODBC, DDS, DERIVED, DGN, DGNv8, DIMAP, DIPEx, DOQ1, DOQ2, DWG, DXF, ECRGTOC,
ECW, EDIGEO, EEDA, EEDAI, EIR, ELAS, ENVISAT, ERS, ESAT, ESRIC, ESRIJSON, EXR, Elasticsearch,
FAST, FIT, FITS, FileGDB, FujiBAS, GDALG, GFF, GMLAS, GML-AS, GMT, GNMDatabase, GNMFile, GPSBabel,
GPSTrackMaker, GRASS, GRASSASCIIGrid, GRIB, GS7BG, GSAG, GSBG, GSC, GTFS, GTI, GTX, GXF, GenBin,
GeoRSS, Geoconcept, GeoRaster, HANA, HDF4, HDF4Image, HDF5, HDF5Image, HEIF, HF2, HTF, HTTP, IDA,
IDB, ILWIS, INGR, IRIS, ISCE, ISG, ISIS2, ISIS3, Idrisi, Interlis 1, Interlis 2, JAXAPALSAR, JDEM,
JML, JPEGLS, JPEGXL, JPIPKAK, JSONFG, KEA, KMLSUPEROVERLAY, KRO, L1B, LAN, LCP, LOSLAS, LVBAG,
Leveller, LIBERTIFF, MAP, MBTiles, MFF, MFF2, MG4Lidar, MRF, MSGN, MSG, MSSQLSpatial, MVT, MapInfo
File, MapML, MiraMonRaster, MiraMonVector, MongoDB, MongoDBv3, MrSID, MySQL, NAS, NDF, NGSGEOID,
NGW, NOAA_B, NSIDCbin, NTv1, NTv2, NULL, NWT_GRC, NWT_GRD, Netezza, OAPIF, OCI, ODBC, ODS, OGCAPI,
OGDI, OGR_GMT, OGR_OGDI, OGR_PDS, OGR_SDTS, OGR_VRT, OSM, OZI, OpenAir, OpenFileGDB, PAux, PCIDSK,
PCRaster, PDF, PDS, PDS4, PGDUMP, PGeo, PLMOSAIC, PLSCENES, PMTiles, PNM, PRF, Parquet,
PostGISRaster, PostgreSQL, R, RASDAMAN, RCM, RDA, RDB, REC, RIK, RMF, ROI_PAC, RPFTOC, RRASTER,
RS2, RST, Rasterlite, S102, S104, S111, S57, SAFE, SAGA, SAR_CEOS, SDE, SDTS, SEGUKOOA, SEGY,
SENTINEL2, SGI, SIGDEM, SNAP_TIFF, SNODAS, SOSI, SQLite, SRP, STACIT, STACTA, SUA, SVG, SXF,
Selafin, TDM, TGA, TIGER, TIL, TileDB, TopoJSON, TSX, Terragen, UK .NTF, USGSDEM, VDV, VFK, VICAR,
WAsP, WCS, WFS, WFS3, WMS, WMTS, Walk, XLS, XLSX, XODR, XPM, XPlane, XYZ, ZMap, Zarr, georaster,
netCDF
"""
_OTHERS = tuple(" ".join(name.split()) for name in _OFF.split(","))

NO_PROXY_EXISTS = "refused://allow-remote"
"""A proxy of no known kind: curl fails before it opens a connection."""

_NO_REQUESTS = {
    "GDAL_HTTP_PROXY": NO_PROXY_EXISTS, "GDAL_HTTPS_PROXY": NO_PROXY_EXISTS,
    "GDAL_HTTP_MAX_RETRY": "0",
    # A name can undo the proxies: /vsicurl?proxy=&url=. This no name can undo.
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "/vsicurl/none"}
"""Options of GDAL under which it makes no request."""

_HARMLESS = {
    "GDAL_VRT_ENABLE_RAWRASTERBAND": "NO", "GDAL_VRT_ENABLE_PYTHON": "NO",
    "GDAL_VRT_RAWRASTERBAND_ALLOWED_SOURCE": "SIBLING_OR_CHILD_OF_VRT_PATH",
    "GDAL_MEM_ENABLE_OPEN": "NO", "GDAL_ENABLE_WMS_CACHE": "NO", "GML_DOWNLOAD_SCHEMA": "NO",
    "GML_SKIP_RESOLVE_ELEMS": "ALL", "OGR_SQLITE_LIST_VIRTUAL_OGR": "NO",
    "GDAL_DISABLE_OPENCL": "YES"}
"""Options under which files name no raw bytes, no code and no memory."""

PROGRAM_ENVIRONMENT = {
    "http_proxy": NO_PROXY_EXISTS, "https_proxy": NO_PROXY_EXISTS, "all_proxy": NO_PROXY_EXISTS,
    "HTTPS_PROXY": NO_PROXY_EXISTS, "ALL_PROXY": NO_PROXY_EXISTS}
"""Variables by which other programs make no request either."""

_extra: ContextVar[tuple[str, ...]] = ContextVar("extra", default=())
_remote: ContextVar[bool] = ContextVar("remote", default=False)

DRIVER_HINT = ("If you trust the file and all that it names, add --allow-driver {name} (in Python: "
               "with termsel.allow_driver({name!r})).")


@contextmanager
def allow_driver(*names: str) -> Iterator[None]:
    """Let further drivers of GDAL open files while the block runs, as ``--allow-driver`` does.

    Only for files that you trust: some drivers write files, run programs, or read any file that a
    file names.

    Parameters
    ----------
    *names : str
        As GDAL calls them, such as "netCDF" or "MRF".

    Yields
    ------
    None
        Nothing: the drivers are allowed until the block is left.

    Raises
    ------
    TermselError
        If GDAL has no driver of such a name.

    Examples
    --------
    >>> import termsel
    >>> with termsel.allow_driver("GIF"):
    ...     pass  # read files here that you trust
    """
    # GDAL takes names in any case; the list has them as it writes them.
    all_drivers = (*RASTER_DRIVERS, *VECTOR_DRIVERS, *WORKING_DRIVERS, *_OTHERS)
    driver_names = {name.casefold(): name for name in all_drivers}
    for name in names:
        if name.casefold() not in driver_names:
            raise TermselError(f"GDAL has no driver {name!r}",
                               hint="gdalinfo --formats lists their names.")
    # In addition to those of a block around this one.
    token = _extra.set((*_extra.get(), *(driver_names[name.casefold()] for name in names)))
    try:
        yield
    finally:
        _extra.reset(token)


@contextmanager
def allow_remote() -> Iterator[None]:
    """Allow sources on servers while the block runs.

    Without it, no file that is read as raster or vector data makes GDAL send a request.

    Yields
    ------
    None
        Nothing: servers are allowed until the block is left.

    Examples
    --------
    >>> import termsel
    >>> with termsel.allow_remote():
    ...     pass  # read sources on servers here
    """
    token = _remote.set(True)
    try:
        yield
    finally:
        _remote.reset(token)


def remote_allowed() -> bool:
    """Return True where sources on servers are allowed."""
    return _remote.get()


def allowed_drivers() -> tuple[str, ...]:
    """Return the drivers that the user has named."""
    return _extra.get()


def raster_drivers() -> tuple[str, ...]:
    """Return the drivers that may open a raster."""
    remote = ("HTTP",) if remote_allowed() else ()
    return (*RASTER_DRIVERS, *remote, *allowed_drivers())


def vector_drivers() -> tuple[str, ...]:
    """Return the drivers that may open a vector file."""
    return (*VECTOR_DRIVERS, *allowed_drivers())


def gdal_options() -> dict[str, str]:
    """Return the options of GDAL under which a stranger's file is opened."""
    return dict(_HARMLESS) if remote_allowed() else {**_HARMLESS, **_NO_REQUESTS}


def skipped_drivers() -> str:
    """Return the drivers that are off, as the variable GDAL_SKIP takes them."""
    # Both kinds, as a process has one list of drivers.
    working = {*raster_drivers(), *vector_drivers(), *WORKING_DRIVERS}
    return ",".join(name for name in (*_OTHERS, *VECTOR_DRIVERS, *RASTER_DRIVERS)
                    if name not in working)


def program_environment(before: Mapping[str, str]) -> dict[str, str]:
    """Return the variables under which another program opens a stranger's file by its GDAL.

    They are those in `before`, with others that refuse drivers and requests as termsel does.
    """
    # A host in no_proxy would be asked without the proxy that refuses all requests.
    environment = {key: value for key, value in before.items()
                   if key.casefold() != "no_proxy"} | gdal_options() | {
        "GDAL_SKIP": skipped_drivers()}
    return environment if remote_allowed() else environment | PROGRAM_ENVIRONMENT


@contextmanager
def without_proxy_exceptions() -> Iterator[None]:
    """Take out the variables by which curl asks some hosts without a proxy, during a block.

    All threads of the process do without them. Nothing is changed where servers are allowed.
    """
    if remote_allowed():
        yield
        return
    lifted = {key: os.environ.pop(key) for key in ("no_proxy", "NO_PROXY") if key in os.environ}
    try:
        yield
    finally:
        os.environ.update(lifted)


_own_process = False


def claim_process() -> None:
    """Say that this process is termsel's own, so that drivers may be off for all its code."""
    global _own_process
    _own_process = True


def drivers_are_off() -> bool:
    """Return whether GDAL has only the drivers of the lists in this process."""
    return _own_process


@contextmanager
def keep_own_drivers_only() -> Iterator[None]:
    """Turn the drivers that termsel does not use off for good, if GDAL is loaded in the block.

    Its cache is limited to 256 MB, unless GDAL_CACHEMAX says otherwise; that variable stays set.
    Both are done in processes of termsel; in a program or notebook of the user GDAL stays as it is.
    """
    if not _own_process:
        yield
        return
    # GDAL reads these variables once, when it registers its drivers.
    before = {key: os.environ.get(key) for key in ("GDAL_SKIP", "OGR_SKIP", "GDAL_CACHEMAX")}
    os.environ["GDAL_SKIP"] = os.environ["OGR_SKIP"] = skipped_drivers()
    # In MB; by default GDAL takes a twentieth of the machine's memory.
    os.environ.setdefault("GDAL_CACHEMAX", "256")
    try:
        yield
    finally:
        for key, value in before.items():
            # GDAL reads this one when it first opens a raster, after the block.
            if key == "GDAL_CACHEMAX":
                continue
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
