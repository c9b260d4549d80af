"""GCPs in text of GDAL: options and scripts with ``-gcp``, and what gdalinfo prints.

``-gcp pixel line easting northing [elevation]`` stands in option files (``--optfile``), in scripts
of gdal_translate and gdal_edit, and in those that Allmaps exports; ``-a_srs`` there states the CRS.
`gdalinfo` prints the same points as text and, with ``-json``, as JSON. Pixels and lines count from
the outer corner of the first pixel.

References
----------
GDAL, manuals of gdal_translate (``-gcp``) and gdalinfo, and the schema gdalinfo_output.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import parse_json, read_text, write_text
from termsel.toolkit.coordinates import horizontal_crs, normalise
from termsel.toolkit.files import IMAGE_NAME, image_of, is_number
from termsel_formats.points.common import CORNER, points_of
from termsel_formats.points.written import (
    PointsWriter,
    points_for_others,
    require_points,
    say_checked,
)

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUOTED = rf"""["']?({_NUMBER})["']?"""
_OPTION = re.compile(rf"-gcp\s+{_QUOTED}\s+{_QUOTED}\s+{_QUOTED}\s+{_QUOTED}(?:\s+{_QUOTED})?"
                     r"""(?=[\s"')]|$)""")
# The commands of GDAL 3.11 and later have --gcp pixel,line,easting,northing[,elevation].
_OPTION_WITH_COMMAS = re.compile(rf"--gcp[\s=]+[\"']?({_NUMBER}(?:,{_NUMBER}){{3,4}})[\"']?")
_SRS = re.compile(r"-(?:a_srs|gcp_srs|s_srs|-crs|-src-crs|-input-crs)[\s=]+"
                  r"""(?:"((?:\\.|[^"\\])*)"|'([^']*)'|(\S+))""")
_IMAGE_FILE = re.compile(
    r"""(?:^|\s)["']?([^\s"'<>|]+\.(?:tiff?|jpe?g|jp2|png|vrt|img|bmp|gif))["']?"""
    r"(?=\s|$)", re.IGNORECASE)
_PRINTED = re.compile(
    rf"GCP\[\s*\d+\]:\s*Id=(.*?),\s*Info=[^\n]*\n\s*\(({_NUMBER}),({_NUMBER})\)\s*->\s*"
    rf"\(({_NUMBER}),({_NUMBER})(?:,({_NUMBER}))?\)")
_SIZE = re.compile(r"^Size is (\d{1,9}), (\d{1,9})", re.MULTILINE)
_PRINTED_CRS = re.compile(r"^GCP Projection =\s*\n(.*?)^(?:Data axis|GCP\[)",
                          re.MULTILINE | re.DOTALL)


class GdalOptions(Reader):
    """GCPs given to GDAL as options: an option file, or one command of a script."""

    name = "gdal-options"
    summary = "options and scripts of GDAL with -gcp pixel line x y [z], also of Allmaps"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_NAME,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for text with the option -gcp and its numbers."""
        text = head.decode("utf-8", "replace")
        return b"\0" not in head and any(
            option.search(text) for option in (_OPTION, _OPTION_WITH_COMMAS))

    def read(self, path: Path) -> FeatureSet:
        """Return the points of one image; errors name the file."""
        commands = _commands_by_image(path)
        image = image_of(path, commands, self.options["image_name"], "image_name=NAME")
        command = commands[image]
        table = []
        for matched in _OPTION.findall(command):
            # The height is the last number, and may be missing.
            sample, line, x, y, *height = (float(number) for number in matched if number)
            table.append((line - CORNER, sample - CORNER, x, y,
                          height[0] if height else np.nan))
        # Where a command does not state it, another command on the same points may.
        stated = _stated_crs(command) or _stated_crs(_join_commands(path))
        return FeatureSet(points_of(path, [""] * len(table), table),
                          crs=stated[0] if len(stated) == 1 else "")

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options for each image of a script; {} if there is only one."""
        images = _commands_by_image(path)
        return {image: {"image_name": image} for image in images} if len(images) > 1 else {}


def _stated_crs(text: str) -> list[str]:
    """Return the CRSs that options state of GCPs, each once; [] if none can be read."""
    stated = []
    for quoted, single, bare in _SRS.findall(text):
        stated.append(_crs_or_blank(re.sub(r"\\(.)", r"\1", quoted) or single or bare))
    return list(dict.fromkeys(filter(None, stated)))


def _join_commands(path: Path) -> str:
    """Return the text of a script with each command on one line, and GCPs as -gcp has them."""
    text = read_text(path)
    # Allmaps writes the numbers alone, which --format gdal-options shows.
    rows = [line.split() for line in text.splitlines() if line.strip()]
    if rows and all(len(row) in (4, 5) and all(map(is_number, row)) for row in rows):
        return "\n".join(f"-gcp {' '.join(row)}" for row in rows)
    joined = re.sub(r"[\\^`]\s*\n", " ", text)
    return _OPTION_WITH_COMMAS.sub(lambda option: f"-gcp {option[1].replace(',', ' ')}", joined)


def _commands_by_image(path: Path) -> dict[str, str]:
    """Return the text of each command with GCPs, by the image that it names, "" for none.

    Where commands before it name the same image, it goes by its output, or by a number.

    A script has a command a line, but for lines that end with a backslash or, on Windows, with ^;
    an option file has no command, and an option a line.
    """
    command_lines = [line for line in _join_commands(path).splitlines() if not re.match(
        r"\s*(#|::|rem\b|//)", line, re.IGNORECASE)]
    if not any(re.search(r"\bgdal", line) for line in command_lines):
        command_lines = [" ".join(command_lines)]
    commands: dict[str, str] = {}
    for line in command_lines:
        if not _OPTION.search(line):
            continue
        files = [name.replace("\\", "/").rpartition("/")[2]
                 for name in _IMAGE_FILE.findall(_OPTION.sub(" ", line))]
        image = files[0] if files else ""
        # Each command has the points of a map of its own; an image may have several.
        if image in commands and re.search(r"\bgdal", line):
            unused = [name for name in files[1:] if name not in commands]
            image = unused[0] if unused else f"{image} {len(commands) + 1}"
        commands[image] = f"{commands.get(image, '')} {line}"
    if not commands:
        raise TermselError("this file has no option -gcp with its numbers", file=path,
                           hint="It is -gcp pixel line easting northing [elevation].")
    return commands


class GdalinfoText(Reader):
    """GCPs as gdalinfo prints them, as text or as JSON."""

    name = "gdalinfo"
    summary = "what gdalinfo or gdalinfo -json prints of an image with GCPs"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for what gdalinfo prints of GCPs."""
        # JSON and text of the same program; either may be saved.
        text = head.decode("utf-8", "replace")
        return _PRINTED.search(text) is not None or (
            text.lstrip("\ufeff \t\r\n").startswith("{") and '"gcpList"' in text
            and '"gcps"' in text)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name the file."""
        text = read_text(path)
        if text.lstrip().startswith("{"):
            ids, rows, crs, size = _gcps_of_json(path, text)
        else:
            ids, rows, crs, size = _gcps_of_text(text)
        if not rows:
            raise TermselError("gdalinfo shows no ground control points here", file=path,
                               hint="Give what it prints of an image that has some.")
        # GDAL counts from the corner of the first pixel.
        table = [(line - CORNER, sample - CORNER, *ground) for sample, line, *ground in rows]
        return FeatureSet(points_of(path, ids, table), crs=_crs_or_blank(crs), image_size=size)


_Printed = tuple[list[str], list[list[float]], str, tuple[int, int] | None]


def _gcps_of_text(text: str) -> _Printed:
    """Return ids, numbers, CRS ("" if none) and size (None if not stated) of what gdalinfo prints.
    """
    gcps = _PRINTED.findall(text)
    size = _SIZE.search(text)
    crs = _PRINTED_CRS.search(text)
    rows = []
    for _, *numbers in gcps:
        rows.append([float(number) if number else np.nan for number in numbers])
    return ([name for name, *_ in gcps], rows, " ".join(crs[1].split()) if crs else "",
            (int(size[2]), int(size[1])) if size else None)


def _gcps_of_json(path: Path, text: str) -> _Printed:
    """Return ids, numbers, CRS ("" if none) and size (None if not stated) of gdalinfo -json.

    Raises TermselError if the content is no such list.
    """
    hint = "Write it again with gdalinfo -json."
    try:
        content = parse_json(text, hint)
        gcps = content["gcps"]
        rows = []
        for gcp in gcps["gcpList"]:
            rows.append([float(gcp[key]) if key in gcp else np.nan
                         for key in ("pixel", "line", "x", "y", "z")])
        ids = [str(gcp.get("id", "")) for gcp in gcps["gcpList"]]
        crs = str((gcps.get("coordinateSystem") or {}).get("wkt", ""))
        size = content.get("size")
        lines_samples = (int(size[1]), int(size[0])) if size else None
    except TermselError as error:
        # The reader of JSON does not know the file.
        error.file = path
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise TermselError(f"this is no list of GCPs of gdalinfo: {type(error).__name__} {error}",
                           file=path, hint=hint) from error
    return ids, rows, " ".join(crs.split()), lines_samples


def _crs_or_blank(crs: str) -> str:
    """Return a CRS in its normal form; "" if it cannot be read."""
    try:
        return normalise(crs)
    except TermselError:
        return ""


class GdalOptionsWriter(PointsWriter):
    """Control points without blunders as options of gdal_translate, for ``--optfile``.

    Independent check points are left out, as GDAL would fit to them.
    """

    name = "gdal-options"
    summary = "control without blunders as -gcp options, for gdal_translate --optfile FILE"
    suffix = "_gcps.txt"

    def write(self, result: Result, path: Path) -> None:
        """Write the CRS, and a line with the option -gcp for each point of control."""
        self.require(result, path)
        # GDAL would take check points as control.
        checked = points_for_others(result).without_checks()
        require_points(checked, path, self.needs)
        # A WKT has quotation marks of its own; GDAL knows no others.
        crs = horizontal_crs(result.features.crs).replace('"', '\\"')
        rows = [f'-a_srs "{crs}"']
        for (line, sample), (x, y, z) in zip(checked.points.image.tolist(),
                                             checked.points.ground.tolist(), strict=True):
            height = "" if np.isnan(z) else f" {z!r}"
            rows.append(f"-gcp {sample + CORNER!r} {line + CORNER!r} {x!r} {y!r}{height}")
        write_text(path, "\n".join([*rows, ""]))
        say_checked(self.name, checked)
