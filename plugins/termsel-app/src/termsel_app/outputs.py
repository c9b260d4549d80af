"""What a session gives away: tables of control, and what commands of termsel make of it.

Each output has a name of its own in the folder of the session; a page chooses among these, and
names no file. The commands run as they do in a terminal, so that results are the same.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from termsel import TermselError
from termsel_app.control import ControlFeatures
from termsel_app.iiif import is_iiif
from termsel_app.quality import write_control_tables
from termsel_app.session import Files, Session, from_folder

RESULT = "result"
_SECONDS = 900
"""Longest time of a command."""


@dataclass(frozen=True)
class Output:
    """Something that can be saved.

    `names` are its files in the folder; `command` the command of termsel that makes them, in which
    {image}, {dem} and {map} stand for files; none for the tables of control alone.
    """

    label: str
    names: tuple[str, ...]
    command: tuple[str, ...] = ()
    needs_result: bool = True


OUTPUTS = {
    "map": Output("Map (cloud-optimised GeoTIFF)", ("map.tif",), (
        "rectify", RESULT, "{image}", "--output", "map.tif", "--overwrite")),
    "rpc": Output("RPC", ("image_RPC.TXT",), (
        "export", RESULT, "--to", "rpc-txt", "--output", "image_RPC.TXT", "--overwrite")),
    "report": Output("Report", ("report.html",), (
        "report", RESULT, "--output", "report.html", "--overwrite")),
    "points": Output("Points (CSV)", ("points.csv",), needs_result=False),
    "qgis-points": Output("QGIS .points", ("control.points",), (
        "export", RESULT, "--to", "qgis-points", "--output", "control.points", "--overwrite")),
    "gpkg": Output("GeoPackage", ("control.gpkg",), (
        "export", RESULT, "--to", "residuals-gpkg", "--output", "control.gpkg", "--overwrite")),
    "result": Output("Result folder", (RESULT,)),
    "annotation": Output("IIIF annotation", ("annotation.json",), (
        "export", RESULT, "--to", "georeference-annotation", "--output", "annotation.json",
        "--overwrite")),
}


def run_arguments(session: Session) -> list[str]:
    """Return the arguments of `termsel run` that repeat the session, called in its folder.

    Images of a server are left out: a run reads files.
    """
    features = session.control.features(session.places.crs)
    arguments = ["run"]
    if len(features.points):
        arguments += ["--points", "points.csv"]
    if len(features.lines):
        arguments += ["--lines", "lines.csv"]
    files = session.files
    folder = session.folder
    for option, name in (("--rpc", files.rpc), ("--dem", files.dem), ("--image", files.image)):
        if name is not None and not is_iiif(name):
            arguments += [option, from_folder(name, folder)]
    return [*arguments, "--out", RESULT, "--overwrite"]


def command_line(session: Session) -> str:
    """Return the line that repeats the session in a terminal: cd FOLDER && termsel run ..."""
    folder = shlex.quote(str(session.folder.absolute()))
    return f"cd {folder} && {shlex.join(['termsel', *run_arguments(session)])}"


def save(session: Session, name: str, image_id: object = None) -> list[Path]:
    """Write an output and return its files.

    An annotation is of the IIIF image with an id. Raises TermselError if there is no such output,
    or the command fails: with what it says.
    """
    output = OUTPUTS.get(name)
    if output is None:
        raise TermselError(f"there is no output {name!r}", hint=f"Choose {', '.join(OUTPUTS)}.")
    with session.lock:
        features = session.control.features(session.places.crs)
        arguments = run_arguments(session)
    files = [*write_control_tables(features, session.folder).values()]
    if output.needs_result:
        _update_result(session, arguments, files)
    if output.command:
        arguments = complete_command(output.command, session.files, session.folder)
        if name == "annotation":
            served = None if session.served is None else session.served.id
            arguments += _option_of_image(image_id or served)
        call(arguments, session.folder)
    if name == "points":
        return files
    return [session.folder / path for path in output.names]


def _update_result(session: Session, arguments: list[str], tables: Sequence[Path]) -> None:
    """Run the command that writes the folder of the result, if control or files have changed since.
    """
    control = tuple(table.read_bytes() for table in tables)
    made_from = (*arguments, *control, *_file_states(session))
    # A file within an archive, or on a server, may change unseen.
    if None in made_from or session.result_made_from != made_from:
        call(arguments, session.folder)
        session.result_made_from = (*arguments, *control, *_file_states(session))


def _file_states(session: Session) -> list[tuple[int, int] | None]:
    """Return time [ns] and size of each file that a result is made from, and of the result itself.

    None for a file that cannot be looked at.
    """
    files = session.files
    names = [name for name in (files.image, files.rpc, files.dem)
             if name is not None and not is_iiif(name)]
    states: list[tuple[int, int] | None] = []
    for path in (*map(Path, names), session.folder / RESULT / "result.json"):
        try:
            state = path.stat()
        except OSError:
            states.append(None)
        else:
            states.append((state.st_mtime_ns, state.st_size))
    return states


def _option_of_image(image_id: object) -> list[str]:
    """Return the option that names the IIIF image of an annotation.

    Raises TermselError if the id is no address.
    """
    if not isinstance(image_id, str) or not image_id.startswith(("http://", "https://")):
        raise TermselError("an annotation is of an IIIF image, and its id is not known",
                           hint="Type its address above, such as https://example.org/iiif/map1.")
    return ["--set", f"image_id={image_id}"]


def complete_command(command: Sequence[str], files: Files, folder: Path) -> list[str]:
    """Return a command with {image} replaced by the session's, and with its DEM for a map.

    Raises TermselError if the image is needed and is no file.
    """
    if "{image}" in command and (files.image is None or is_iiif(files.image)):
        raise TermselError("a map needs the image as a file, and this session has none",
                           hint="Start `termsel app IMAGE --points points.csv`.")
    arguments = [from_folder(str(files.image), folder) if argument == "{image}" else argument
                 for argument in command]
    if command[0] == "rectify" and files.dem is not None:
        arguments += ["--dem", from_folder(files.dem, folder)]
    return arguments


def call(arguments: Sequence[str], folder: Path) -> None:
    """Run a command of termsel in a folder; raises TermselError with what it says if it fails."""
    try:
        done = subprocess.run([sys.executable, "-P", "-m", "termsel", *arguments], cwd=folder,
                              capture_output=True, text=True, encoding="utf-8", errors="replace",
                              stdin=subprocess.DEVNULL, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        raise TermselError(f"termsel {arguments[0]} takes longer than {_SECONDS // 60} minutes",
                           hint="Run it in a terminal.") from None
    if done.returncode:
        error_lines = [line for line in done.stderr.strip().splitlines() if line.strip()]
        message = " ".join(line.strip() for line in error_lines[-4:]).removeprefix("Error: ")
        raise TermselError(message or f"termsel {arguments[0]} failed")


def control_count(control: ControlFeatures) -> int:
    """Return the number of features that have places in both image and ground."""
    return len(control.complete("point")) + len(control.complete("line"))
