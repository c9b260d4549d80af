"""What a session can save: tables of control, and what commands of termsel make of them.

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

    `names` are its files in the folder. `command` are the arguments of termsel that make them, in
    which "{image}" stands for the image; () if the tables of control or the result are all.
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

    An image on a server is left out, as a run reads files.
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
    """Write the output of a name in `OUTPUTS`, and return the paths of its files.

    `image_id` is the address of the IIIF image that an annotation is of; by default that of the
    session's image on a server. Raises TermselError if there is no such output, what it needs is
    missing, or a command fails.
    """
    output = OUTPUTS.get(name)
    if output is None:
        raise TermselError(f"there is no output {name!r}", hint=f"Choose {', '.join(OUTPUTS)}.")
    with session.lock:
        features = session.control.features(session.places.crs)
        arguments = run_arguments(session)
    files = [*write_control_tables(features, session.folder).values()]
    # Commands read the tables and the result of the folder, so those come first.
    if output.needs_result:
        _update_result(session, arguments, files)
    if output.command:
        arguments = complete_command(output.command, session.files, session.folder)
        if name == "annotation":
            served = None if session.served is None else session.served.id
            arguments += _image_id_option(image_id or served)
        run_command(arguments, session.folder)
    if name == "points":
        return files
    return [session.folder / path for path in output.names]


def _update_result(session: Session, arguments: list[str], tables: Sequence[Path]) -> None:
    """Run the command that writes the folder of the result, unless nothing has changed since then.

    What counts are the arguments, the content of the tables, and time and size of the files.
    """
    control = tuple(table.read_bytes() for table in tables)
    made_from = (*arguments, *control, *_file_states(session))
    # None is a file within an archive or on a server, which may change unseen.
    if None in made_from or session.result_made_from != made_from:
        run_command(arguments, session.folder)
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


def _image_id_option(image_id: object) -> list[str]:
    """Return the two arguments that name the IIIF image of an annotation.

    Raises TermselError if the id is no address of http or https.
    """
    if not isinstance(image_id, str) or not image_id.startswith(("http://", "https://")):
        raise TermselError("an annotation is of an IIIF image, and its id is not known",
                           hint="Type its address above, such as https://example.org/iiif/map1.")
    return ["--set", f"image_id={image_id}"]


def complete_command(command: Sequence[str], files: Files, folder: Path) -> list[str]:
    """Return the arguments of a command with the session's image in place of "{image}".

    `rectify` gets the DEM of the session, if it has one. Names are as seen from `folder`. Raises
    TermselError if the image is needed and is no file.
    """
    if "{image}" in command and (files.image is None or is_iiif(files.image)):
        raise TermselError("a map needs the image as a file, and this session has none",
                           hint="Start `termsel app IMAGE --points points.csv`.")
    arguments = [from_folder(str(files.image), folder) if argument == "{image}" else argument
                 for argument in command]
    if command[0] == "rectify" and files.dem is not None:
        arguments += ["--dem", from_folder(files.dem, folder)]
    return arguments


def run_command(arguments: Sequence[str], folder: Path) -> None:
    """Run a command of termsel in a folder, in a process of its own.

    Raises TermselError with the last lines of its messages if it fails, and if it takes longer than
    `_SECONDS`.
    """
    try:
        done = subprocess.run([sys.executable, "-P", "-m", "termsel", *arguments], cwd=folder,
                              capture_output=True, text=True, encoding="utf-8", errors="replace",
                              stdin=subprocess.DEVNULL, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        raise TermselError(f"termsel {arguments[0]} takes longer than {_SECONDS // 60} minutes",
                           hint="Run it in a terminal.") from None
    # Warnings come before the message of an error, which has four lines at most.
    if done.returncode:
        error_lines = [line for line in done.stderr.strip().splitlines() if line.strip()]
        message = " ".join(line.strip() for line in error_lines[-4:]).removeprefix("Error: ")
        raise TermselError(message or f"termsel {arguments[0]} failed")


def n_complete_features(control: ControlFeatures) -> int:
    """Return how many features have a place in both image and ground (`ControlFeatures.complete`).
    """
    return len(control.complete("point")) + len(control.complete("line"))
