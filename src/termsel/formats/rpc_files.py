"""Read RPCs: RPB, _RPC.TXT, XML, JSON, YAML, VRT, and any raster GDAL knows."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, count_in_words
from termsel.core.files.atomic import write_text
from termsel.core.files.names import is_there
from termsel.data.features import FeatureSet
from termsel.data.fingerprints import is_cut, makers_of
from termsel.data.rasters import open_raster, without_siblings
from termsel.data.rpc import N_COEFFICIENTS, Rpc
from termsel.formats.base import error_in_file, read_data, read_head, read_text
from termsel.formats.encodings import BadText, decode_xml
from termsel.formats.rpc_control import (
    control_group,
    control_lines,
    mark_error,
    read_errors,
    with_control,
)
from termsel.formats.rpc_forms import (
    Items,
    largest_difference,
    rpc_of_result,
    rpc_of_tags,
    rpcs_of_tree,
    rpcs_of_xml,
    tree_of_json,
    tree_of_yaml,
)
from termsel.models.image_part import ImagePart

log = logging.getLogger(__name__)

RPB_NAMES = {
    "LINE_OFF": "lineOffset", "SAMP_OFF": "sampOffset", "LAT_OFF": "latOffset",
    "LONG_OFF": "longOffset", "HEIGHT_OFF": "heightOffset", "LINE_SCALE": "lineScale",
    "SAMP_SCALE": "sampScale", "LAT_SCALE": "latScale", "LONG_SCALE": "longScale",
    "HEIGHT_SCALE": "heightScale", "LINE_NUM_COEFF": "lineNumCoef",
    "LINE_DEN_COEFF": "lineDenCoef", "SAMP_NUM_COEFF": "sampNumCoef",
    "SAMP_DEN_COEFF": "sampDenCoef"}
"""What an RPB file calls the items of GDAL's RPC domain, in the order of the file."""

ERROR_NAMES = {"ERR_BIAS": "errBias", "ERR_RAND": "errRand"}

_UNKNOWN_ERRORS = ("", "nan", ".nan", "none", "null", "~", "n/a", "unknown")
"""How files state that an error is not known, in small letters; so does a negative number."""

KNOWN = ("RPB, _RPC.TXT, DIMAP XML, DigitalGlobe XML, EnMAP XML, JSON of rpcm or of the Data "
         "Fusion Contest 2019, Orthority YAML, VRT or .aux.xml with an RPC domain, or an image "
         "that has an RPC")

_OF_RESULT = '"termsel-result'
_OPENING = 1000  # characters in which JSON names its schema
_LISTED = 8  # names in a message
_INCOMPLETE = "The file is incomplete or damaged: get it again."

_BESIDE = (".RPB", ".rpb", "_RPC.TXT", "_rpc.txt")
"""Endings of the files of an RPC that GDAL finds next to an image, and termsel writes."""

_KEY = re.compile(r"^[ \t]*(\w+)[ \t]*[:=][ \t]*", re.MULTILINE)
_VALUE = re.compile(r"[^;\r\n]*")
_NUMBERS = re.compile(r"[^\s,();]+")


@explains_arguments()
def read_rpc(path: Path | str) -> Rpc:
    """Return the RPC of a file, whose format is recognised by its content.

    Parameters
    ----------
    path : path-like
        RPB, _RPC.TXT, DIMAP version 1 to 3, DigitalGlobe or EnMAP XML, JSON of rpcm, YAML of
        Orthority, VRT or PAM (.aux.xml), or an image with an RPC in its tags or in a file next to
        it, which GDAL reads (extra `gis`); or the result.json of a run that was given an RPC. In a
        file with several RPCs, FILE#NAME is the one of a band or an image. Without a name, that of
        the middle one of several bands is taken.

    Returns
    -------
    Rpc
        The coefficients, offsets and scales, and the name of the file.

    Raises
    ------
    TermselError
        If the file is in none of these formats, lacks an item, or has one that is not a number; if
        it has the RPCs of several images, and none is named.

    Examples
    --------
    >>> import tempfile, termsel
    >>> from pathlib import Path
    >>> from termsel.toolkit.files import write_example
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = Path(folder) / "files"
    ...     _ = write_example(files)
    ...     rpc = termsel.read_rpc(files / "vendor.RPB")
    >>> rpc.project([[48.5, 34.8, 1850.0]]).shape
    (1, 2)
    """
    path, name = _file_and_name(Path(path))
    head = read_head(path, f"Expected {KNOWN}.")
    try:
        rpc = _rpc_of_head(path, head, name)
        return rpc if rpc.source else replace(rpc, source=path.name)
    except TermselError as error:
        raise (error if error.file is not None else error_in_file(error, path)) from error


def _file_and_name(path: Path) -> tuple[Path, str]:
    """Return the file of FILE#NAME, and the name; "" if there is a file of the whole name."""
    stem, sign, name = path.name.rpartition("#")
    if not sign or not stem or path.exists():
        return path, ""
    return path.with_name(stem), name


def has_rpc(image: Path | str) -> bool:
    """Return whether GDAL finds an RPC of an image, inside it or next to it."""
    with open_raster(image) as raster:
        return bool(raster.tags(ns="RPC"))


def read_delivered_rpc(image: Path | str) -> Rpc | None:
    """Return the RPC that an image came with, inside it or next to it; None if it has none.

    An RPC that termsel fitted to control points, and that was exported next to the image, is not
    returned: the points that it was fitted to would seem to test it. The vendor's RPC that it hides
    is returned in its place, None if it hides none, and a warning is logged.

    Raises
    ------
    TermselError
        If the RPC that GDAL finds cannot be read.
    """
    if not has_rpc(image):
        return None
    rpc = read_rpc(image)
    if not rpc.control_count:
        return rpc
    path = Path(image)
    rpc_by_name = {file.name: file_rpc for file, file_rpc in _rpcs_beside(path)}
    exported_name = next((name for name, file_rpc in rpc_by_name.items()
                          if file_rpc.control_count and file_rpc == rpc), path.name)
    # The vendor's RPC may also be in the tags of the image itself.
    rpc_by_name.update(_rpc_within(path))
    delivered = next((file_rpc for file_rpc in rpc_by_name.values()
                      if not file_rpc.control_count), None)
    if delivered is None:
        advice = f" To use it with other points: --rpc {path.with_name(exported_name)}"
    else:
        advice = f" That of {delivered.source} is used."
    log.warning("Note: the RPC of %s was fitted by termsel to %s, and is not used as the "
                "vendor's.%s", exported_name, count_in_words(rpc.control_count, "control feature"),
                advice)
    return delivered


def _rpcs_beside(image: Path) -> Iterator[tuple[Path, Rpc]]:
    """Yield (path, RPC) of each file next to an image in which GDAL looks for its RPC.

    Files that are not there are left out, and so are those that cannot be read, without a message.
    """
    for ending in _BESIDE:
        path = image.with_name(image.stem + ending)
        if is_there(path):
            with suppress(TermselError):
                yield path, read_rpc(path)


def _rpc_within(image: Path) -> dict[str, Rpc]:
    """Return the RPC in the tags of an image itself, by the name of the image; {} without one."""
    with suppress(TermselError), without_siblings():
        return {image.name: read_rpc(image)}
    return {}


def size_with_rpc(rpc: Any) -> tuple[int, int] | None:
    """Return lines and samples of an image that is given for its RPC; None for any other file.

    `rpc` is what a user gives for an RPC: a file, FILE#NAME, or an `Rpc`, for which None comes
    back, too.
    """
    if not isinstance(rpc, Path | str):
        return None
    path, _ = _file_and_name(Path(rpc))
    head = read_head(path, f"Expected {KNOWN}.")
    if b"\0" not in head:
        return None
    with open_raster(path) as raster:
        return int(raster.height), int(raster.width)


def with_rpc(features: FeatureSet, rpc: Rpc | Path | str,
             image_part: ImagePart | None = None) -> FeatureSet:
    """Return features with the RPC of their image, and with its size where `rpc` is an image.

    The size stays as it is where the features state one. Where their image is an `image_part` of
    the one that the RPC is for, the RPC becomes that of the part, and the size stays, too.
    """
    if isinstance(rpc, Rpc):
        return replace(features, rpc=rpc if image_part is None else image_part.rpc(rpc))
    path, _ = _file_and_name(Path(rpc))
    size = features.image_size
    full_rpc = read_rpc(rpc)
    # A run itself tells features that the RPC was fitted to: no note is needed for these.
    if full_rpc.control_count and not makers_of(full_rpc, features):
        note_use(full_rpc)
    if image_part is not None:
        return replace(features, rpc=image_part.rpc(full_rpc))
    return replace(features, rpc=full_rpc, image_size=size or size_with_rpc(path))


def note_use(rpc: Rpc) -> None:
    """Say that an RPC which termsel fitted is used as a vendor's."""
    log.warning("Note: the RPC of %s was fitted by termsel to %s, and is used as a vendor's, "
                "as it is named.%s", rpc.source, count_in_words(
                    rpc.control_count, "control feature"),
                " Only some of them are recognised: none of them may be given with it."
                if is_cut(rpc) else "")


def _rpc_of_head(path: Path, head: bytes, rpc_name: str) -> Rpc:
    """Return the RPC of a file, which may be of any known form.

    Parameters
    ----------
    path : Path
    head : bytes
        How the file begins, which tells an image from XML and from text.
    rpc_name : str
        Which of several RPCs in one file to take; "" for the only one.

    Raises
    ------
    TermselError
        If there is no RPC, if one has bad numbers, or if `rpc_name` does not choose one of several.
    """
    if b"\0" in head:
        items, items_of_bands, metadata = _rpc_items_of_image(path)
        if not items and not items_of_bands:
            raise TermselError("this image has no RPC that GDAL finds", file=path,
                               hint="Give the file of its RPC, or leave it out: without one the "
                                    f"points alone are fitted. Files of RPCs are {KNOWN}.")
        if items and not rpc_name:
            return _with_control_beside(with_control(from_items(items), metadata), path)
        return _choose_rpc(items_of_bands, rpc_name, bands=True)
    if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
        return _rpc_from_xml(path, rpc_name)
    text = read_text(path)
    entries = {name: (value, line) for name, value, line in _parse_entries(text)}
    gdal_names = {rpb: name for name, rpb in (RPB_NAMES | ERROR_NAMES).items()}
    # Names of an .RPB become those of GDAL, which a _RPC.TXT has.
    items = {}
    for name, (value, line) in entries.items():
        item = gdal_names.get(name, name)
        states_number = item.startswith((*RPB_NAMES, *ERROR_NAMES))
        if states_number and not (item in ERROR_NAMES and _is_unknown(value)):
            for number in (_NUMBERS.findall(value) if "(" in value else value.split()[:1]):
                _number_of_item(number, name, line)
        if states_number:
            items[item] = value
    if items.keys() & (RPB_NAMES.keys() | {"LINE_NUM_COEFF_1"}):
        values = {name: value for name, (value, _) in entries.items()}
        return with_control(from_items(items), values)
    is_json = text.lstrip()[:1] in ("{", "[")
    tree = tree_of_json(text) if is_json else tree_of_yaml(text)
    if (result_rpc := rpc_of_result(tree)) is not None:
        return result_rpc
    if is_json and _OF_RESULT in text[:_OPENING]:
        raise TermselError(
            "this is the record of a termsel result, whose run was given no RPC", file=path,
            hint=f"termsel export {path.parent} --to rpb --output scene.RPB writes one that its "
                 "points were fitted to: these cannot correct or test it.")
    nested = rpcs_of_tree(tree)
    if not nested:
        raise _error_for_unknown_form(path, text)
    return _choose_rpc(nested, rpc_name)


def _with_control_beside(rpc: Rpc, image: Path) -> Rpc:
    """Return the RPC of an image with the control that the file next to it names, if it has one.

    GDAL passes on the numbers of such a file alone, which say no more than how many there are.
    """
    if rpc.control_digests:
        return rpc
    equal_rpcs = (rpc_beside for _, rpc_beside in _rpcs_beside(image)
                  if rpc_beside == rpc and rpc_beside.control_digests)
    return next(equal_rpcs, rpc)


def _rpc_items_of_image(path: Path) -> tuple[dict[str, str], dict[str, Items], dict[str, str]]:
    """Return the items of an image's RPC, those of each band's RPC by its number, and metadata.

    Bands without an RPC are left out; items are empty where the image has none as a whole.
    """
    items_of_bands = {}
    with open_raster(path) as raster:
        for number in range(1, raster.count + 1):
            items = rpc_of_tags(raster.tags(number, ns="RPC")) or rpc_of_tags(raster.tags(number))
            if items:
                items_of_bands[str(number)] = items
        return raster.tags(ns="RPC"), items_of_bands, raster.tags()


_SAME_PLACE = 1e-3
"""Difference of the RPCs of bands [px] that comes from rounded digits."""


def _choose_rpc(items_of: Mapping[str, Items], name: str, *, bands: bool = False) -> Rpc:
    """Return the RPC of a name; without a name the only one, or of several bands the middle one.

    `items_of` are the items of each RPC by its name. A warning says where bands differ. Raises
    TermselError for an unknown name, and for RPCs of several images without a name.
    """
    names = list(items_of)
    listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
    kind = "bands" if bands else "images"
    if name and name not in items_of:
        raise TermselError(f"the file has no RPC of {name!r}, but of the {kind} {listed}",
                           hint="Name one of these after FILE#.")
    if name or len(names) == 1:
        return from_items(items_of[name or names[0]])
    if not bands:
        raise TermselError(f"the file has RPCs of the images {listed}",
                           hint=f"Name one after the file, such as FILE#{names[0]}.")
    rpcs = {band: from_items(items) for band, items in items_of.items()}
    middle = names[len(names) // 2]
    difference = largest_difference(rpcs, middle)
    # Bands that see the same place need no choice.
    if difference > _SAME_PLACE:
        log.warning("Note: the file has an RPC for each of %d bands. That of band %s is taken; "
                    "others see places up to %.2g px from there. FILE#BAND takes another.",
                    len(rpcs), middle, difference)
    return rpcs[middle]


def _error_for_unknown_form(path: Path, text: str, root: str = "") -> TermselError:
    """Return the error for a file in which no RPC is read: it may have one in another form."""
    kind = f"this XML <{root}>" if root else "this file"
    # Some names of an RPC are in the text if it is one of an unknown form.
    if not _TRACES.search(text):
        return TermselError(f"{kind} has no RPC in a form that termsel reads", file=path,
                            hint=f"Expected {KNOWN}.")
    return TermselError(
        f"{kind} seems to have an RPC in a form that termsel does not read", file=path,
        hint=f"Expected {KNOWN}. Write its numbers as one of these, such as _RPC.TXT.")


_TRACES = re.compile(
    r"\brpc(?:00)?[ab]?\b|rational[ _-]?(?:poly|func)|(?:line|row|samp|col)\w{0,8}_?num|"
    r"(?:lat|lon|long|height|row|line|samp|col)_?(?:off|scale)", re.IGNORECASE)
"""What little else than an RPC has."""


def _parse_entries(text: str) -> Iterator[tuple[str, str, int]]:
    """Yield name, value and line of the entries of an RPB or a _RPC.TXT.

    The text is gone through once, however many lines or parentheses it has.
    """
    last_parenthesis = text.rfind(")")
    line = 1
    entry_start = 0
    value_end = 0
    while name := _KEY.search(text, value_end):
        line += text.count("\n", entry_start, name.start(1))
        entry_start = name.start(1)
        # Values follow "=" or ":"; those in parentheses may span lines.
        if text.startswith("(", name.end()) and name.end() < last_parenthesis:
            value_end = text.index(")", name.end()) + 1
        else:
            value = _VALUE.match(text, name.end())
            value_end = value.end() if value else name.end()
        yield name[1], text[name.end():value_end], line


def from_items(items: Mapping[str, str]) -> Rpc:
    """Return the RPC of items of GDAL's RPC domain, such as LINE_OFF.

    Coefficients are in LINE_NUM_COEFF with 20 numbers or in LINE_NUM_COEFF_1 and so on. Units after
    numbers are ignored. Raises TermselError for items that are missing or not numbers.
    """
    def number_of(name: str) -> float:
        """Return the number of an item; TermselError where it is missing or no number."""
        words = items.get(name, "").split()
        if not words:
            raise TermselError(f"the RPC lacks {name}", hint=_INCOMPLETE)
        return _number_of_item(words[0], name)

    def coefficients_of(name: str) -> tuple[float, ...]:
        """Return the 20 coefficients of one polynomial, from one item or from an item for each.

        Raises TermselError where there are more or fewer.
        """
        if name not in items:
            return tuple(number_of(f"{name}_{i + 1}") for i in range(N_COEFFICIENTS))
        # Parentheses are around the lists of an RPB.
        if "(" in items[name] and ")" not in items[name]:
            raise TermselError(f"the file breaks off within {RPB_NAMES.get(name, name)}",
                               hint="Fetch it again.")
        numbers = tuple(_number_of_item(text, name) for text in _NUMBERS.findall(items[name]))
        if len(numbers) != N_COEFFICIENTS:
            raise TermselError(f"{name} has {len(numbers)} numbers, expected {N_COEFFICIENTS}",
                               hint=_INCOMPLETE)
        return numbers

    # Errors are no part of the model, and vendors leave them out or blank.
    bias, random, count = read_errors(*(
        None if _is_unknown(items.get(name, "")) else number_of(name) for name in ERROR_NAMES))
    return Rpc(
        image_offset=(number_of("LINE_OFF"), number_of("SAMP_OFF")),
        image_scale=(number_of("LINE_SCALE"), number_of("SAMP_SCALE")),
        ground_offset=(number_of("LONG_OFF"), number_of("LAT_OFF"), number_of("HEIGHT_OFF")),
        ground_scale=(number_of("LONG_SCALE"), number_of("LAT_SCALE"), number_of("HEIGHT_SCALE")),
        line_numerator=coefficients_of("LINE_NUM_COEFF"),
        line_denominator=coefficients_of("LINE_DEN_COEFF"),
        sample_numerator=coefficients_of("SAMP_NUM_COEFF"),
        sample_denominator=coefficients_of("SAMP_DEN_COEFF"),
        error_bias=_error_or_none(bias), error_random=_error_or_none(random), control_count=count)


def _is_unknown(error: str) -> bool:
    """Return whether the text of an error says that it is not known."""
    return error.strip(" \t\r\n\"'").casefold() in _UNKNOWN_ERRORS


def _error_or_none(error: float | None) -> float | None:
    """Return a stated error; None for NaN or a negative one, which stand for an unknown one."""
    return error if error is not None and error >= 0.0 else None


def _number_of_item(text: str, name: str, line: int | None = None) -> float:
    """Return a text as a number.

    Raises TermselError, with the name of the item and its line, for a text that is none.
    """
    # Python alone reads 1_000 as a number.
    try:
        return float(text.replace("_", "?"))
    except ValueError:
        if "," in text:
            hint = "Write a decimal point."
        else:
            hint = "Give the file as the vendor delivered it."
        raise TermselError(f"{name} is {text!r}, which is not a number", line=line,
                           hint=hint) from None


def _rpc_from_xml(path: Path, name: str) -> Rpc:
    """Return the RPC of XML by GDAL or a vendor.

    GDAL writes a PAM file (.aux.xml) without a declaration, DigitalGlobe an .XML with the names of
    an RPB, Airbus and others DIMAP; some files have an RPC for each band, of which `name` chooses
    one. Raises TermselError for XML that is damaged or in no known form, with its line.
    """
    content = read_data(path)
    try:
        text = decode_xml(content, path)
    except BadText:
        # GDAL writes names of files with any bytes, and declares nothing.
        text = content.decode("utf-8-sig", errors="replace")
    try:
        root = ElementTree.fromstring(text.lstrip())
    except ElementTree.ParseError as error:
        raise TermselError(f"this XML cannot be read: {error}", file=path,
                           line=error.position[0], hint=_INCOMPLETE) from error
    if root.tag == "Dimap_Document":
        return _rpc_from_dimap(root)
    if items_of_bands := rpcs_of_xml(root):
        return _choose_rpc(items_of_bands, name, bands=True)
    # A PAM file has the RPC as a domain of metadata; the default domain may name its control.
    items: dict[str, str] = {}
    metadata: dict[str, str] = {}
    for domain in root.iter("Metadata"):
        entries = {item.get("key", ""): item.text or "" for item in domain.iter("MDI")}
        if domain.get("domain") == "RPC":
            items |= entries
        elif not domain.get("domain"):
            metadata |= entries
    if not items:
        digital_globe = {rpb.upper(): name for name, rpb in (RPB_NAMES | ERROR_NAMES).items()}
        items = {digital_globe[name]: text for name, text in _entry_texts(root)
                 if name in digital_globe}
    if not items:
        raise _error_for_unknown_form(path, text, root.tag)
    return with_control(from_items(items), metadata)


def _rpc_from_dimap(root: ElementTree.Element) -> Rpc:
    """Return the RPC from ground to image of a DIMAP file, as GDAL takes it.

    DIMAP counts image coordinates from 1 (in version 3 from a first column that the file states),
    and the RPC here from 0, so both offsets are shifted. Its errors are of another definition and
    are left out. Raises TermselError for a file without the model from ground to image.
    """
    model = root.find(".//Global_RFM")
    domain = root.find(".//RFM_Validity")
    if model is None or domain is None:
        raise TermselError("this DIMAP file has no Global_RFM with RFM_Validity",
                           hint="The RPC of an image is in the file RPC_*.XML beside it.")
    # The centre of the first pixel is (1, 1) in versions 1 and 2. Version 3 states its first
    # column, and GDAL subtracts it from both offsets.
    ground_to_image = model.find("GroundtoImage_Values")
    first_column = "1"
    if ground_to_image is None:
        ground_to_image = model.find("Inverse_Model")
    else:
        first_column = domain.findtext(".//ImagetoGround_Validity_Domain/FIRST_COL", "")
    if ground_to_image is None:
        raise TermselError("this DIMAP file has no model from ground to image",
                           hint="Expected Inverse_Model or GroundtoImage_Values in Global_RFM.")
    if not first_column:
        raise TermselError("this DIMAP file does not state the first column of its image",
                           hint="Expected FIRST_COL in ImagetoGround_Validity_Domain, as in the "
                                "RPC_*.XML that came with the image.")
    items = dict(_entry_texts(domain)) | dict(_entry_texts(ground_to_image))
    origin = _number_of_item(first_column, "FIRST_COL")
    for name in ("LINE_OFF", "SAMP_OFF"):
        if name in items:
            items[name] = repr(_number_of_item(items[name].strip(), name) - origin)
    return from_items({name: text for name, text in items.items() if name not in ERROR_NAMES})


def _entry_texts(element: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Yield tag and text of all elements that have a text."""
    for descendant in element.iter():
        if descendant.text and descendant.text.strip():
            yield descendant.tag, descendant.text


_UNKNOWN = -1.0  # what GDAL and vendors write for an error that is not known


@explains_arguments()
def write_rpc(rpc: Rpc, path: Path | str) -> None:
    """Write an RPC as an RPB file, from which `read_rpc` reads the same RPC.

    Parameters
    ----------
    rpc : Rpc
        As `read_rpc` or `rpc_of` returns it.
    path : path-like
        GDAL finds the RPC of image.tif in image.RPB next to it.

    Returns
    -------
    None

    Raises
    ------
    TermselError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile, termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("ikonos-hamedan"), "poly3d", degree=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     termsel.write_rpc(termsel.rpc_of(fitted).rpc, f"{folder}/scene.RPB")
    ...     type(termsel.read_rpc(f"{folder}/scene.RPB")).__name__
    'Rpc'
    """
    write_text(path, rpb_text(rpc))


def rpb_text(rpc: Rpc) -> str:
    """Return the text of an RPB file; numbers keep all their digits."""
    # Some readers look for these keys, which vendors write.
    lines = ['satId = "";', 'bandId = "";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    for name, value in _values_by_gdal_name(rpc).items():
        rpb = (ERROR_NAMES | RPB_NAMES)[name]
        if isinstance(value, tuple):
            numbers = ",\n".join(f"\t\t\t{number!r}" for number in value)
            lines.append(f"\t{rpb} = (\n{numbers});")
        else:
            lines.append(f"\t{rpb} = {value!r};")
    return "\n".join([*lines, "END_GROUP = IMAGE", *control_group(rpc), "END;", ""])


def rpc_txt_text(rpc: Rpc) -> str:
    """Return the text of a _RPC.TXT file; numbers keep all their digits."""
    lines = []
    for name, value in _values_by_gdal_name(rpc).items():
        if isinstance(value, tuple):
            lines += [f"{name}_{i}: {number!r}" for i, number in enumerate(value, 1)]
        else:
            lines.append(f"{name}: {value!r}")
    return "\n".join([*lines, *control_lines(rpc), ""])


def rpc_items(rpc: Rpc) -> dict[str, str]:
    """Return the items of GDAL's RPC domain, as in a VRT; numbers keep all their digits."""
    return {name: " ".join(map(repr, value)) if isinstance(value, tuple) else repr(value)
            for name, value in _values_by_gdal_name(rpc).items()}


def _values_by_gdal_name(rpc: Rpc) -> dict[str, float | tuple[float, ...]]:
    """Return the numbers of an RPC by GDAL's names, in the order of `ERROR_NAMES` and `RPB_NAMES`.

    In that order latitude comes before longitude. Errors that are not known are `_UNKNOWN`, and
    have the mark of the control that the RPC was fitted to.
    """
    (line, sample) = rpc.image_offset
    (line_scale, sample_scale) = rpc.image_scale
    (lon, lat, height) = rpc.ground_offset
    (lon_scale, lat_scale, height_scale) = rpc.ground_scale
    values = (line, sample, lat, lon, height, line_scale, sample_scale, lat_scale, lon_scale,
              height_scale, rpc.line_numerator, rpc.line_denominator, rpc.sample_numerator,
              rpc.sample_denominator)
    errors = (mark_error(_UNKNOWN if error is None else error, rpc.control_count)
              for error in (rpc.error_bias, rpc.error_random))
    return dict(zip((*ERROR_NAMES, *RPB_NAMES), (*errors, *values), strict=True))
