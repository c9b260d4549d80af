"""What a raster consists of, looked at before GDAL opens it, to the end of the chain.

A virtual raster names other files, and those may name others; overviews, masks and auxiliary XML
next to a file do so, too. Each of them must be a regular file of a format that may be opened (see
`termsel.core.files.drivers`), since GDAL would open it with any driver, and ask any server.
"""

from __future__ import annotations

import codecs
import gzip
import os
import posixpath
import re
import tarfile
import time
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePath, PurePosixPath
from xml.etree import ElementTree

from termsel.core.errors import TermselError, cut
from termsel.core.files.drivers import DRIVER_HINT, allowed_drivers, remote_allowed
from termsel.core.files.names import may_be_crs, refuse_grids, require_regular
from termsel.core.files.tiff import metadata_of_tiff

REMOTE_HINT = "If you trust it, add --allow-remote (in Python: with termsel.allow_remote())."

_REMOTE = re.compile(
    r"(/|%2f)vsi(curl|s3|gs|az|adls|oss|swift|hdfs|webhdfs)(_streaming)?([/?]|%2f|%3f)"
    r"|\b(https?|ftp|wss?)s?(:|%3a)/", re.IGNORECASE)
_ARCHIVE = re.compile(r"/vsi(zip|tar|gzip)/(.*)", re.DOTALL)
_CLOCK = 2_000_000_000
"""Nanoseconds within which some file systems give two changes of a folder the same time."""
_BASE = ":::BASE:::"
"""In front of the name of overviews: they are in the folder of the file that names them."""
_CONTAINERS = re.compile(r"[a-z][\w+.-]+:", re.IGNORECASE)
"""What begins names such as NETCDF:FILE:VARIABLE; a single letter is a drive of Windows."""
_SUBDATASET = re.compile(r"(?:GTIFF_DIR:(?:off:)?\d+|NITF_IM:\d+):(.+)", re.IGNORECASE | re.DOTALL)
"""Names of one image of a file that has several."""

_FILE_TAGS = frozenset(("sourcefilename", "sourcedataset", "sourcevrtfilename", "rpcdem", "dem",
                        "rpc_dem", "dempath", "cutlinedsname", "indexdataset"))
_FILE_KEYS = re.compile(r"(DATASET|FILE|FILENAME|DEM|SOURCE|URL)$", re.IGNORECASE)
"""Keys of metadata that name files; others may mention any address."""

_LARGEST_XML = 32 << 20  # bytes of a virtual raster, which has about 100,000 sources then
_DEEPEST = 16
_MOST_READS = 10_000  # readings of sources by nested virtual rasters, which multiply
_HEAD_BYTES = 4096
_LONGEST_NAME = 4096  # characters of a path that a system takes
_TEXTS = (".xml", ".txt", ".rpb", ".imd", ".pvl", ".prj", ".wld", ".hdr", ".tfw", ".att", ".eph",
          ".geo", ".til", ".tab", ".points")
"""Endings of texts that GDAL reads next to a raster."""

_MAGIC = (
    (b"II*\0", "GTiff"), (b"MM\0*", "GTiff"), (b"II+\0", "GTiff"), (b"MM\0+", "GTiff"),
    (b"\x89PNG\r\n", "PNG"), (b"\xff\xd8\xff", "JPEG"), (b"GIF8", "GIF"), (b"BM", "BMP"),
    (b"\0\0\0\x0cjP  ", "JP2OpenJPEG"), (b"\xff\x4f\xff\x51", "JP2OpenJPEG"),
    (b"EHFA_HEADER_TAG", "HFA"), (b"NITF", "NITF"), (b"NSIF", "NITF"))
_WITH_DOMAINS = tuple(mark for mark, driver in _MAGIC if driver == "JP2OpenJPEG")
_ASCII_GRID = re.compile(rb"\s*(ncols|nrows|[xy]ll(corner|center)|cellsize|d[xy]|nodata_value)\s",
                         re.IGNORECASE)
_SRTM = re.compile(r"[NS]\d\d[EW]\d{3}\w*(\.\w+)*\.(hgts?|raw)(\.zip)?", re.IGNORECASE)

_FOREIGN = (
    (re.compile(rb"<mrf_meta", re.IGNORECASE), "MRF"),
    (re.compile(rb"<(gdal_wms|wms_)", re.IGNORECASE), "WMS"),
    (re.compile(rb"<wcs_gdal", re.IGNORECASE), "WCS"),
    (re.compile(rb"<gdal_wmts", re.IGNORECASE), "WMTS"),
    (re.compile(rb"<ogrvrt(datasource|layer)", re.IGNORECASE), "OGR_VRT"),
    (re.compile(rb"<gdaltileindexdataset", re.IGNORECASE), "GTI"),
    (re.compile(rb"<(wfs_capabilities|ogrwfsdatasource)", re.IGNORECASE), "WFS"),
    (re.compile(rb"<(\w+:)?product_observational", re.IGNORECASE), "PDS4"),
    (re.compile(rb"\A\s*\{[\s\S]*gdal_streamed_alg"), "GDALG"),
    (re.compile(rb"\A\s*\{[\s\S]*stac_version"), "STACIT"),
    (re.compile(rb"PDS_VERSION_ID"), "PDS"),
    # Raw pixels may begin with any text; these are labels that name the file of the pixels.
    (re.compile(rb"IsisCube"), "ISIS3"), (re.compile(rb"\^(QUBE|IMAGE)"), "PDS"),
    (re.compile(rb"OziExplorer Map Data File"), "MAP"), (re.compile(rb"numTiles\s*="), "TIL"),
    (re.compile(rb"\[Raw data\]", re.IGNORECASE), "FujiBAS"),
    (re.compile(rb"AuxilaryTarget"), "PAux"),
    (re.compile(rb"\A\s*datasetheader\s+begin", re.IGNORECASE), "ERS"),
    (re.compile(rb"\ASQLite format 3\0"), "GPKG"), (re.compile(rb"\ASIMPLE  ="), "FITS"),
    (re.compile(rb"\ACDF[\1\2\5]"), "netCDF"), (re.compile(rb"\A\x89HDF"), "HDF5"),
    (re.compile(rb"\A\x0e\x03\x13\x01"), "HDF4"), (re.compile(rb"\AGRIB"), "GRIB"),
    (re.compile(rb"\A%PDF"), "PDF"), (re.compile(rb"\APCIDSK"), "PCIDSK"))
"""Texts at the beginning of files of other drivers, of the more dangerous ones first."""


def refuse_foreign(path: Path | str) -> list[str]:
    """Raise TermselError for a raster of a driver that is off, or that names one, or a server.

    Parameters
    ----------
    path : path-like
        Also a name of GDAL such as ``/vsizip/maps.zip/map.tif``.

    Returns
    -------
    list of str
        The plain rasters that it consists of: itself, or all that a virtual raster leads to.

    Raises
    ------
    TermselError
        If the raster, a file next to it that GDAL would open, or a file that it names, to the end
        of the chain, is no regular file, of a driver that is off, or on a server; if virtual
        rasters are nested so deeply, or name so many sources, that reading them takes days.
    """
    chain = _Chain(str(path))
    chain.require(chain.start, "")
    return chain.plain


def is_single_file(path: Path | str) -> bool:
    """Return whether GDAL opens a raster from this file alone, and none that lies next to it.

    Returns False for a virtual raster, and for what is no file on the disk, such as one in an
    archive; True for a raster in memory.
    """
    # A file in memory was made by this process, which makes none next to it.
    if str(path).startswith("/vsimem/"):
        return True
    if not os.path.isfile(path):
        return False
    path = Path(path)
    with path.open("rb") as file:
        if _is_virtual(file.read(_HEAD_BYTES)):
            return False
    # Overviews, masks and auxiliary files belong to a raster by their name alone.
    return not any(_names_next_to(path))


def may_name_more(path: str) -> bool:
    """Return whether the metadata in a plain raster can name further files, such as overviews.

    Only TIFF and JPEG 2000 have metadata of such a kind. True where that cannot be told.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD_BYTES)
            if head.startswith(_WITH_DOMAINS):
                return True
            # Both byte orders of TIFF; any other plain format has no metadata that name files.
            if not head.startswith((b"II", b"MM")):
                return False
            metadata = metadata_of_tiff(file)
    except OSError:  # in an archive
        return True
    # Such metadata are of a domain, an attribute that GDAL's XML takes in any case.
    return metadata is None or b"domain" in metadata.lower()


def refuse_named(path: Path | str, names: Iterator[str]) -> None:
    """Refuse a raster some of whose metadata name such files: overviews or arrays of places."""
    chain = _Chain(str(path))
    folder = os.path.dirname(chain.start)
    for name in names:
        chain.require_each(name.strip(), folder)


def foreign_format(head: bytes) -> str:
    """Return the driver of which a file seems to be by its first bytes; "" if none is known."""
    return next((name for mark, name in _FOREIGN if mark.search(head[:_HEAD_BYTES])), "")


def refused_format_error(path: object, head: bytes, of: object = None) -> TermselError:
    """Return the error for a file that GDAL is not let open as a raster, with what to do about it.

    Drivers that read code, other files or databases are off (see `RASTER_DRIVERS`), and GDAL itself
    would only say that the file is in no supported format. The first bytes of the file, `head`, say
    what it is, and with a known format the hint names the driver to allow. `of` is the file that
    refers to it, where the user named that one.
    """
    name = foreign_format(head)
    code = ""
    # A path of more than 100 characters would make the hint hard to read.
    hint = f"Convert it: gdal_translate {path if len(str(path)) < 100 else 'FILE'} map.tif."
    if head.startswith(_DATABASE):
        # A GeoPackage may hold vectors or a raster.
        reason = "this is a GeoPackage or another database, and termsel opens no raster in one"
        hint = ("If it holds vectors, give an image in its place: lines of a map are for termsel "
                f"match-lines --vectors. If it holds a raster: {hint[len('Convert it: '):]}")
    elif head.startswith(_ZIP):
        reason = "this is a zip archive, and no raster is found in it"
        hint = "Unpack it, and give the raster. One within is named so: FILE.zip/PLACE.tif."
    elif name:
        reason = f"this is a raster of the format {name}, which termsel does not open"
        hint = f"{hint} {DRIVER_HINT.format(name=name)}"
    elif not head:
        reason = "the file is empty, expected a raster"
        hint = "Copy or download it again."
    elif is_text(head) or head.lstrip().startswith(b"{"):
        reason = "this is a file of text, not a raster"
        code = "text"
        hint = ("Give a raster, such as a GeoTIFF; if this is a table of points, or an RPC, give "
                "it as such.")
    else:
        reason = "this is no raster of a format that termsel opens"
        hint = f"If a GIS shows it, convert it: {hint[len('Convert it: '):]}"
    if of is not None and str(of) != str(path):
        return TermselError(f"it refers to {cut(str(path), 100)!r}: {reason}", file=of, hint=hint,
                            code=code)
    return TermselError(reason, file=path, hint=hint, code=code)


_ZIP = b"PK\x03\x04"

_DATABASE = b"SQLite format 3\0"


def is_text(head: bytes) -> bool:
    """Return whether the first bytes of a file are text without markup: a table, or words."""
    try:
        # The last character may be cut.
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(head[:_HEAD_BYTES])
    except UnicodeDecodeError:
        return False
    return "\0" not in text and text.strip()[:1] not in ("", "<", "{")


@dataclass
class _Chain:
    """The files of one raster; `start` is its name, which messages give.

    `reads` counts, for each file that was looked at, the sources that reading it reads; `plain`
    has those that are no virtual rasters.
    """

    start: str
    reads: dict[str, int] = field(default_factory=dict)
    plain: list[str] = field(default_factory=list)
    elements: int = 0

    def error(self, message: str, hint: str | None = None) -> TermselError:
        return TermselError(message, file=self.start, hint=hint)

    def require_each(self, name: str, folder: str, depth: int = 0) -> int:
        """Require a file that another one names, and return how many sources it reads.

        A relative name is tried from `folder`, that of the file that names it, and from the current
        one. `depth` counts the files up to it. Raises TermselError as `require` does.
        """
        name = name.strip()
        if name.startswith(_BASE):
            name = os.path.normpath(os.path.join(folder, name.removeprefix(_BASE)))
            return self.require(name, name, depth)
        # GDAL tries a relative name next to the file that has it first, then in the current
        # folder; each that exists may be the one it opens.
        candidates = [name]
        if (folder and not os.path.isabs(name) and not _CONTAINERS.match(name)
                and name[:1] not in "<{"):
            candidates = [os.path.join(folder, name), name]
            existing = [path for path in candidates
                        if _is_in_archive(path) or os.path.lexists(path)]
            candidates = existing or candidates[:1]
        return max(self.require(path, name, depth) for path in dict.fromkeys(candidates))

    def require(self, name: str, stated: str, depth: int = 0) -> int:
        """Require that a file and all it refers to may be opened; return how many sources it reads.

        A virtual raster names files, which may name further ones, anything on the disk or on a
        server. `name` is as GDAL would open it, `stated` as the file before it in the chain has it,
        for messages; `depth` counts the files up to it. Raises TermselError for remote sources,
        unless these are allowed, for drivers that are off, and for chains that never end or
        multiply.
        """
        if name in self.reads:
            return self.reads[name]
        if depth > _DEEPEST:
            raise self.error("its virtual rasters are nested too deeply",
                             "Convert it: gdal_translate FILE map.tif.")
        # Set before the descent: a file that names itself ends here, with one read.
        self.reads[name] = 1
        if _REMOTE.search(name):
            if remote_allowed():
                return 1
            raise self.error(f"this refers to the remote source {cut(stated or name, 100)!r}, "
                             "which is refused", REMOTE_HINT)
        # GDAL takes each of these texts where it takes the name of a file.
        if name.lstrip()[:1] == "<":
            self.reads[name] = self._require_named_in_text(name, "", depth)
        elif name.lstrip()[:1] == "{":
            raise refused_format_error(name, name.encode(), self.start)
        elif name.casefold().startswith("vrt://"):
            self.reads[name] = self.require(name[6:].partition("?")[0], stated, depth + 1)
        elif subdataset := _SUBDATASET.fullmatch(name):
            self.reads[name] = self.require(subdataset[1], stated, depth + 1)
        elif _ARCHIVE.match(name):
            self.reads[name] = self._require_archive(name, depth)
        elif name.startswith("/vsi"):
            # The user may give such a name; a file may not.
            if depth or not name.startswith(("/vsi7z/", "/vsirar/", "/vsimem/")):
                raise self.error(f"it refers to {cut(name, 100)!r}, which termsel does not open",
                                 "Save the raster as a single file: gdal_translate.")
        elif os.path.lexists(name):
            self.reads[name] = self._require_file(name, depth)
        elif _CONTAINERS.match(name):
            self._require_allowed(name)
        return self.reads[name]

    def _require_allowed(self, name: str) -> None:
        """Raise TermselError for a name such as NETCDF:FILE:VARIABLE unless the driver is allowed.
        """
        # GDAL compares prefixes without regard to case. None of the drivers that are on by default
        # needs such a name, so that only those count that the user has allowed.
        prefix = name.partition(":")[0].casefold()
        if not any(driver.casefold() == prefix for driver in allowed_drivers()):
            raise self.error(f"it refers to {cut(name, 100)!r}, which termsel does not open",
                             DRIVER_HINT.format(name=name.partition(":")[0]))

    def _require_file(self, name: str, depth: int) -> int:
        """Require a file on the disk, its neighbours and the files that it names.

        Returns how many sources it reads: 1 for a plain raster, and for one that cannot be read, of
        which GDAL says why. Raises TermselError for a folder, pipe or device.
        """
        path = Path(name)
        if path.is_dir():
            raise self.error(f"it refers to the folder {cut(name, 100)!r}" if depth else
                             "this is a folder, expected a raster", "Give a file.")
        require_regular(path, self.start)
        # Before the file itself: GDAL opens a mask or an overview even of a plain raster.
        self._require_neighbours(path, depth)
        try:
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
                if not _is_virtual(head):
                    self._require_known(path, head)
                    self.plain.append(name)
                    return 1
                # One byte more than the limit shows that there is more.
                content = head + file.read(_LARGEST_XML + 1 - len(head))
        except OSError:
            return 1
        return self._require_named_in_text(self._decode_xml(content, name), os.path.dirname(name),
                                           depth)

    def _require_known(self, path: Path, head: bytes) -> None:
        """Raise TermselError for a file of a driver that is off.

        A file whose first bytes show no driver passes if it is of a format of `RASTER_DRIVERS`, or
        if the user has allowed any further driver, as files of that one may begin in any way.
        """
        driver = foreign_format(head)
        if driver:
            is_allowed = driver in allowed_drivers()
        else:
            is_allowed = bool(allowed_drivers()) or _is_known(path, head)
        if is_allowed:
            return
        raise refused_format_error(path, head, self.start)

    def _require_neighbours(self, path: Path, depth: int) -> None:
        """Require the overviews, masks and auxiliary files that GDAL would open as well.

        Raises TermselError for one that is not regular, or is XML of more than `_LARGEST_XML`
        bytes.
        """
        for entry in _names_next_to(path):
            name = entry.casefold()
            neighbour = path.parent / entry
            # These are rasters themselves, with neighbours of their own.
            if name.endswith((".ovr", ".msk", ".aux", ".rrd")):
                self.require(str(neighbour), entry, depth + 1)
            elif not neighbour.is_dir():
                require_regular(neighbour, self.start)
                if name.endswith(_TEXTS) and neighbour.stat().st_size > _LARGEST_XML:
                    raise self._too_large_error(str(neighbour))
            if name.endswith(".aux.xml"):
                self._require_auxiliary_xml(neighbour, depth)
        for entry in _special_entries(str(path.parent)):
            require_regular(path.parent / entry, self.start)

    def _require_auxiliary_xml(self, path: Path, depth: int) -> None:
        """Require the files that an .aux.xml names; none if it cannot be read or is empty."""
        try:
            with path.open("rb") as file:
                content = file.read(_LARGEST_XML + 1)
        except OSError:  # then GDAL cannot read it either
            return
        if content.strip():
            self._require_named_in_text(self._decode_xml(content, str(path)), str(path.parent),
                                        depth, expected="")

    def _decode_xml(self, content: bytes, name: str) -> str:
        """Return the text of XML; TermselError for what is not UTF-8, or is too long."""
        if len(content) > _LARGEST_XML:
            raise self._too_large_error(name)
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise self.error("this raster has text that is not UTF-8",
                             "Save the file, or the file beside it, with the encoding UTF-8."
                             ) from None

    def _require_archive(self, name: str, depth: int) -> int:
        """Require a file in an archive on this disk, and return how many sources are read.

        Raises TermselError where the archive has no such file.
        """
        archive, member = _archive_and_member(name)
        if archive is None:
            return 1  # GDAL says that there is none
        require_regular(archive, self.start)
        self._require_members_near(name, archive, member, depth)
        content = _read_archive_member(name, archive, member)
        if content is None:
            raise self.error(f"there is no raster {cut(name, 100)!r}", "Check the name.")
        if _is_virtual(content[:_HEAD_BYTES]):
            folder = str(PurePosixPath(name).parent)
            return self._require_named_in_text(self._decode_xml(content, name), folder, depth)
        self._require_known(Path(member or archive.name), content[:_HEAD_BYTES])
        self.plain.append(name)
        return 1

    def _require_members_near(self, name: str, archive: Path, member: str, depth: int) -> None:
        """Require every file that GDAL would open beside a file of an archive.

        `name` is how GDAL calls the file, `archive` the archive on the disk, and `member` the file
        in it, "" for its only one. GDAL opens overviews, masks and auxiliary XML beside a raster
        without being asked, in an archive as on the disk, and these may name further sources.

        Raises TermselError for an archive that has two files of one name, and as `require` does.
        """
        members = _list_archive(name, archive)
        if members is None:  # a single file, next to which are those of the disk
            self._require_neighbours(archive, depth)
            return
        if len(set(members)) < len(members):
            raise self.error(f"{archive.name} has two files of one name",
                             "Unpack it, and give the raster.")
        raster = PurePosixPath(member or members[0] if members else "")
        prefix = name.removesuffix(member).rstrip("/") if member else name
        beginnings = _neighbour_beginnings(raster)
        for other_member in map(PurePosixPath, members):
            lower_name = other_member.name.casefold()
            if (other_member == raster or other_member.parent != raster.parent
                    or not lower_name.startswith(beginnings)):
                continue
            if lower_name.endswith((".ovr", ".msk", ".aux", ".rrd")):
                self.require(f"{prefix}/{other_member}", str(other_member), depth + 1)
            elif lower_name.endswith(".aux.xml"):
                content = _read_archive_member(name, archive, str(other_member)) or b""
                folder = str(PurePosixPath(f"{prefix}/{other_member}").parent)
                if content.strip():
                    self._require_named_in_text(self._decode_xml(content, str(other_member)),
                                                folder, depth, expected="")

    def _require_named_in_text(self, text: str, folder: str, depth: int,
                               expected: str = "vrtdataset") -> int:
        """Require all that a virtual raster or auxiliary XML names, and return its reads.

        Reads are the pixels of sources that are read for one pixel of the raster. `text` is the
        XML, `folder` that of its file, from which relative names count, and `expected` the name of
        its root; "" takes any. Raises TermselError for code of Python, entities and grids of PROJ,
        which GDAL would run or open, and for sources that multiply.
        """
        # Entities can expand to any size, and name files.
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise self._not_plain_error()
        try:
            root = ElementTree.fromstring(text.lstrip())
        except (ElementTree.ParseError, ValueError):
            raise self._not_plain_error() from None
        if expected and root.tag.casefold() != expected:
            raise refused_format_error(self.start, text.encode()[:_HEAD_BYTES])
        self._refuse_code(root)
        for element in root.iter():
            # Any element and option may have a CRS or an operation.
            for stated in (element.text or "", *element.attrib.values()):
                if may_be_crs(stated):
                    refuse_grids(stated, self.start)
        sources = [name.strip() for name in _possible_raster_names(root, folder)]
        self.elements += len(sources)
        # A source that reads ten others costs ten reads wherever it is named.
        reads = sum(self.require_each(name, folder, depth + 1) for name in sources)
        # A large mosaic has many sources, each read about once; nested ones multiply.
        if reads > max(_MOST_READS, 5 * self.elements):
            raise self.error("its virtual rasters multiply: a pixel is read from "
                             f"{reads:,} sources",
                             "Convert one of them to a plain raster: gdal_translate.")
        # A virtual raster without sources costs a read, too.
        return max(reads, 1)

    def _refuse_code(self, root: ElementTree.Element) -> None:
        """Raise TermselError for a virtual raster with code of Python, or of raw bytes.

        Raw bytes may be those of any file.
        """
        for element in root.iter():
            kinds = [value.casefold() for key, value in element.items()
                     if key.rpartition("}")[2].casefold() == "subclass"]
            if "vrtrawrasterband" in kinds:
                raise self.error("a virtual raster of raw bytes (VRTRawRasterBand) is not opened",
                                 "Convert it: gdal_translate FILE map.tif.")
            language = (element.text or "").strip()
            if (element.tag.rpartition("}")[2].casefold() == "pixelfunctionlanguage"
                    and language.casefold() == "python"):
                raise self.error("a virtual raster with code in Python is not opened",
                                 "Convert it: gdal_translate FILE map.tif.")

    def _too_large_error(self, name: str) -> TermselError:
        return self.error(f"{cut(name, 100)} has more than {_LARGEST_XML >> 20} MiB of text",
                          "Convert it: gdal_translate FILE map.tif.")

    def _not_plain_error(self) -> TermselError:
        """Return the error for XML that is not well-formed, as GDAL alone might read it."""
        return self.error("the XML of this raster, or of a file that it names, is not well-formed",
                          "Write it again by gdal_translate or gdalbuildvrt.")


def _neighbour_beginnings(raster: PurePath) -> tuple[str, ...]:
    """Return how names of files begin that GDAL opens with a raster: "map.tif.", "map_", ..."""
    beginnings = []
    for stem in (raster.name, raster.stem):
        beginnings += [f"{stem}.".casefold(), f"{stem}_".casefold()]
    return tuple(beginnings)


def _names_next_to(path: Path) -> Iterator[str]:
    """Yield the names of files in a raster's folder that are its name with another ending."""
    beginnings = _neighbour_beginnings(path)
    for entry in _list_folder(str(path.parent)):
        # Without regard to case, as GDAL tries both, and some file systems do not distinguish them.
        if entry.casefold().startswith(beginnings) and entry != path.name:
            yield entry


def _possible_raster_names(root: ElementTree.Element, folder: str) -> Iterator[str]:
    """Yield every text and attribute of a virtual raster that can be the name of a raster.

    `folder` is that of the virtual raster, from which names may be relative. Metadata are free text
    that may look like a name, so that of them only items with the key of a file count.
    """
    waiting = [root]
    while waiting:
        element = waiting.pop()
        tag = element.tag.rpartition("}")[2].casefold()
        text = (element.text or "").strip()
        if tag == "metadata":
            for item in element.iter():
                if _FILE_KEYS.search(item.get("key", "")) and item.text and item.text.strip():
                    yield item.text
            continue
        if text and (tag in _FILE_TAGS or _may_be_name(text, folder)):
            yield text
        # A schema location is an address that nobody opens.
        yield from (value for key, value in element.items()
                    if not key.endswith("schemaLocation") and _may_be_name(value, folder))
        waiting += element


def _may_be_name(text: str, folder: str) -> bool:
    """Return whether GDAL could open a text as the name of a file, an address, or a raster itself.

    Texts of XML and JSON may be rasters: GDAL opens a virtual one whose text stands in place of its
    name.
    """
    # These have no limit of length: texts of rasters, names of GDAL and addresses on servers.
    start = text.lstrip()
    if start.startswith(("<", "{", "/vsi")) or _REMOTE.match(start):
        return True
    # No file system has longer names. Numbers are no names, though a file may be called 1.
    if len(text) > _LONGEST_NAME or "\0" in text or re.fullmatch(r"[-+.\d,\seE]*", text):
        return False
    # Pipes and devices are such names, too: GDAL would wait for them.
    return any(os.path.exists(path) and not os.path.isdir(path)
               for path in (text, os.path.join(folder, text)))


def _is_virtual(head: bytes) -> bool:
    """Return whether the head of a file may be that of a virtual raster: XML of GDAL's own."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    # Any number of blanks may be in front of it.
    return bool(head) and (not text or text[:1] == b"<") and not foreign_format(text)


def _is_known(path: Path, head: bytes) -> bool:
    """Return whether a file is of a format of `RASTER_DRIVERS`, other than a virtual raster."""
    if (head.startswith(tuple(magic for magic, _ in _MAGIC)) or _ASCII_GRID.match(head)
            or (head[:4] == b"RIFF" and head[8:12] == b"WEBP")):
        return True
    if any(head[start:start + 4] == b"UHL1" for start in (0, 80, 160)):  # DTED
        return True
    if _SRTM.fullmatch(path.name):
        return True
    # Raw pixels are known by the header next to them.
    headers = (path.with_suffix(".hdr"), Path(f"{path}.hdr"), path.with_suffix(".HDR"))
    return (head.lstrip()[:1] not in (b"<", b"{") and any(map(os.path.isfile, headers))
            and not os.path.islink(path))


@cache  # many files are sought in one folder
def _cached_entries(folder: str, changed: int) -> tuple[str, ...]:  # noqa: ARG001 (a key alone)
    """Return the names in a folder; () if it cannot be read. `changed` renews the cache."""
    try:
        return tuple(os.listdir(folder))
    except OSError:
        return ()


def _special_entries(folder: str) -> Iterator[str]:
    """Yield the pipes and devices in a folder that have the names of such texts."""
    for entry in _list_folder(folder):
        if entry.casefold().endswith(_TEXTS):
            path = os.path.join(folder, entry)
            if not os.path.isfile(path) and not os.path.isdir(path) and os.path.exists(path):
                yield entry


def _list_folder(folder: str) -> tuple[str, ...]:
    """Return the names in a folder; none if it cannot be read.

    They are kept until the folder changes.
    """
    folder = folder or "."
    try:
        changed = os.stat(folder).st_mtime_ns
    except OSError:
        return ()
    # Another file may come within the same tick of the clock, and leave the time as it is.
    if abs(time.time_ns() - changed) < _CLOCK:
        return tuple(os.listdir(folder))
    return _cached_entries(os.path.realpath(folder), changed)


def _is_in_archive(name: str) -> bool:
    """Return whether GDAL's name of a file is that of a member of an archive or of a server."""
    return name.startswith("/vsi")


def _archive_and_member(name: str) -> tuple[Path | None, str]:
    """Return the archive of a name such as /vsizip/maps.zip/map.tif, and the name in it.

    The archive is None if there is no such file, and the name "" if none is given.
    """
    match = _ARCHIVE.match(name)
    path_and_member = match[2] if match else ""
    # GDAL takes /vsizip/{ARCHIVE}/MEMBER as well, for archives of any ending.
    if path_and_member.startswith("{"):
        archive, _, member = path_and_member[1:].partition("}")
        return (Path(archive) if os.path.isfile(archive) else None), member.lstrip("/")
    # The longest beginning of the name that is a file is the archive, as GDAL looks for it.
    full = PurePosixPath(path_and_member)
    for candidate in (full, *full.parents):
        if os.path.isfile(candidate):
            member = str(full.relative_to(candidate)) if candidate != full else ""
            return Path(candidate), member
    return None, ""


def _list_archive(name: str, archive: Path) -> list[str] | None:
    """Return the files in an archive as GDAL calls them, [] if it cannot be read.

    Returns None where `name` stands for one compressed file, which is no archive.
    """
    if name.startswith("/vsigzip/"):
        return None
    try:
        if name.startswith("/vsitar/"):
            with tarfile.open(archive) as files:
                names = [entry.name for entry in files if not entry.isdir()]
        else:
            with zipfile.ZipFile(archive) as packed:
                names = [entry for entry in packed.namelist() if not entry.endswith("/")]
    except (OSError, EOFError, ValueError, zlib.error, NotImplementedError, RuntimeError,
            tarfile.TarError, zipfile.BadZipFile):
        return []
    return [posixpath.normpath(entry.replace("\\", "/")).lstrip("/") for entry in names]


def _read_archive_member(name: str, archive: Path, member: str) -> bytes | None:
    """Return the beginning of a file in an archive; of a virtual raster all, up to `_LARGEST_XML`.

    Without the name of a `member` the only file of the archive is read. Returns None if the archive
    cannot be read, has no such file, or has several and no name is given.
    """
    try:
        if name.startswith("/vsigzip/"):
            with gzip.open(archive) as file:
                return file.read(_LARGEST_XML + 1)
        if name.startswith("/vsitar/"):
            with tarfile.open(archive) as files:
                names = [member] if member else files.getnames()
                opened = files.extractfile(names[0]) if len(names) == 1 else None
                return None if opened is None else opened.read(_LARGEST_XML + 1)
        with zipfile.ZipFile(archive) as packed:
            names = [member] if member else packed.namelist()
            # GDAL opens an archive without the name of a member only if it has just one.
            if len(names) != 1:
                return None
            with packed.open(names[0]) as file:
                head = file.read(_HEAD_BYTES)
                return head + file.read(_LARGEST_XML) if _is_virtual(head) else head
    except (OSError, EOFError, KeyError, ValueError, zlib.error, NotImplementedError, RuntimeError,
            tarfile.TarError, zipfile.BadZipFile):
        return None
