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
from typing import Any, ClassVar, NamedTuple

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import parse_json, read_text, write_text
from termsel.toolkit.coordinates import horizontal_crs
from termsel.toolkit.files import IMAGE_NAME, image_of, is_number
from termsel_formats.points.common import CORNER, crs_or_blank, points_of
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
_COMMENT = re.compile(r"\s*(#|::|rem\b|//)", re.IGNORECASE)
_PROGRAM = re.compile(r"\bgdal")
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
        """Return the points of one command; of several, the option `image_name` chooses one.

        Raises TermselError, with the file, if there is no GCP, or no command of that name.
        """
        commands = _commands_by_name(path)
        image = image_of(path, commands, self.options["image_name"], "image_name=NAME")
        command = commands[image]
        table = []
        for matched in _OPTION.findall(command):
            # The height is the last number, and may be missing.
            sample, line, x, y, *height = (float(number) for number in matched if number)
            table.append((line - CORNER, sample - CORNER, x, y,
                          height[0] if height else np.nan))
        # Where a command does not state it, another command on the same points may.
        stated = _stated_crs(command) or _stated_crs(_text_with_joined_commands(path))
        return FeatureSet(points_of(path, [""] * len(table), table),
                          crs=stated[0] if len(stated) == 1 else "")

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options that choose each command with GCPs; {} if there is only one."""
        names = _commands_by_name(path)
        return {name: {"image_name": name} for name in names} if len(names) > 1 else {}


def _stated_crs(text: str) -> list[str]:
    """Return the CRSs that the options in a text state, each once; [] if none can be read."""
    stated = []
    for quoted, single, bare in _SRS.findall(text):
        # Within quotation marks a backslash may stand before a character, as before those of WKT.
        stated.append(crs_or_blank(re.sub(r"\\(.)", r"\1", quoted) or single or bare))
    return list(dict.fromkeys(filter(None, stated)))


def _text_with_joined_commands(path: Path) -> str:
    """Return the text of a script with each command on one line, and all GCPs in the form of -gcp.

    A file that holds rows of four or five numbers alone becomes a line with -gcp for each row.
    Raises TermselError if the file cannot be read.
    """
    text = read_text(path)
    # Allmaps exports rows of numbers without -gcp. No file is recognised by those: the user has to
    # say --format gdal-options.
    rows = [line.split() for line in text.splitlines() if line.strip()]
    if rows and all(len(row) in (4, 5) and all(map(is_number, row)) for row in rows):
        return "\n".join(f"-gcp {' '.join(row)}" for row in rows)
    # A line goes on after \ in a shell, after ^ in a batch file and after ` in PowerShell.
    joined = re.sub(r"[\\^`]\s*\n", " ", text)
    return _OPTION_WITH_COMMAS.sub(lambda option: f"-gcp {option[1].replace(',', ' ')}", joined)


def _commands_by_name(path: Path) -> dict[str, str]:
    """Return the commands of a script that have GCPs, by a name for each.

    The name is the first image file in a command, "" if it has none. Where an earlier command has
    that name, it is the next image file, which is the output, or else the first with a number.
    A file that calls no program of GDAL is an option file, and counts as one command; in a script,
    lines that call none are added to the command that has their name. Comments are left out.
    Raises TermselError if there is no GCP.
    """
    text = _text_with_joined_commands(path)
    lines = [line for line in text.splitlines() if not _COMMENT.match(line)]
    if not any(map(_PROGRAM.search, lines)):
        lines = [" ".join(lines)]
    commands: dict[str, str] = {}
    for line in filter(_OPTION.search, lines):
        files = _image_files(line)
        name = files[0] if files else ""
        # Two commands on one image have the points of two maps, so that they are kept apart.
        if name in commands and _PROGRAM.search(line):
            unused = [file for file in files[1:] if file not in commands]
            name = unused[0] if unused else f"{name} {len(commands) + 1}"
        commands[name] = f"{commands.get(name, '')} {line}"
    if not commands:
        raise TermselError("this file has no option -gcp with its numbers", file=path,
                           hint="It is -gcp pixel line easting northing [elevation].")
    return commands


def _image_files(command: str) -> list[str]:
    """Return the names, without folders, of the image files in a command, in their order."""
    # The numbers of -gcp are taken out first, as they are no files.
    paths = _IMAGE_FILE.findall(_OPTION.sub(" ", command))
    return [path.replace("\\", "/").rpartition("/")[2] for path in paths]


class GdalinfoText(Reader):
    """GCPs as gdalinfo prints them, as text or as JSON."""

    name = "gdalinfo"
    summary = "what gdalinfo or gdalinfo -json prints of an image with GCPs"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a list of GCPs that gdalinfo printed, as text or as JSON."""
        text = head.decode("utf-8", "replace")
        return _PRINTED.search(text) is not None or (
            text.lstrip("\ufeff \t\r\n").startswith("{") and '"gcpList"' in text
            and '"gcps"' in text)

    def read(self, path: Path) -> FeatureSet:
        """Return the points, with the size of the image and the CRS as far as they are printed.

        Raises TermselError, with the file, if there are no points.
        """
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
        return FeatureSet(points_of(path, ids, table), crs=crs_or_blank(crs), image_size=size)


class _PrintedGcps(NamedTuple):
    """GCPs as gdalinfo prints them.

    Each row is pixel, line, x, y and z, which is NaN if there is none. The CRS is "" and the size,
    lines and samples, None where they are not stated.
    """

    ids: list[str]
    rows: list[list[float]]
    crs: str
    size: tuple[int, int] | None


def _gcps_of_text(text: str) -> _PrintedGcps:
    """Return the GCPs in the text that gdalinfo prints; no rows if there are none."""
    gcps = _PRINTED.findall(text)
    size = _SIZE.search(text)
    crs = _PRINTED_CRS.search(text)
    rows = []
    for _, *numbers in gcps:
        rows.append([float(number) if number else np.nan for number in numbers])
    # gdalinfo prints samples first, and the WKT of a CRS over several lines.
    return _PrintedGcps([name for name, *_ in gcps], rows, " ".join(crs[1].split()) if crs else "",
                        (int(size[2]), int(size[1])) if size else None)


def _gcps_of_json(path: Path, text: str) -> _PrintedGcps:
    """Return the GCPs in what gdalinfo -json prints; no rows if its list is empty.

    Raises TermselError, with the file, if the text is no JSON with a list of GCPs.
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
    return _PrintedGcps(ids, rows, " ".join(crs.split()), lines_samples)



class GdalOptionsWriter(PointsWriter):
    """Control points without blunders as options of gdal_translate, for ``--optfile``.

    Independent check points are left out, as GDAL would fit to them.
    """

    name = "gdal-options"
    summary = "control without blunders as -gcp options, for gdal_translate --optfile FILE"
    suffix = "_gcps.txt"

    def write(self, result: Result, path: Path) -> None:
        """Write the CRS, and a line with the option -gcp for each control point without blunder.

        How many points there are, and which are left out, is logged. Raises TermselError if the
        result has no such point, or no CRS of the Earth.
        """
        self.require(result, path)
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
