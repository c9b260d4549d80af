"""The command `termsel app`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from termsel import TermselError
from termsel.toolkit import echo, make_folder, refuse_link, remote_option, show_messages

if TYPE_CHECKING:
    from termsel_app.session import Files

_FILE = click.Path(path_type=Path)
EXAMPLE = "termsel-example"
"""Where the files of the example are written."""


@click.command()
@click.argument("image", metavar="[IMAGE|DIR]", required=False)
@click.option("--map", "maps", metavar="FILE", multiple=True,
              help="A georeferenced raster or a vector file, shown beside the image; or tiles by "
                   "their address, with {x}, {y} and {z}, which are fetched from there. May be "
                   "repeated.")
@click.option("--points", metavar="FILE", type=_FILE,
              help="Points to begin with, in any format of `termsel list readers`.")
@click.option("--lines", metavar="FILE", type=_FILE,
              help="Control lines, in any format of `termsel list readers`.")
@click.option("--rpc", metavar="FILE", type=_FILE, help="The vendor's RPC of the image, which the "
                                                        "points correct.")
@click.option("--dem", metavar="FILE", type=_FILE, help="Raster of heights, for points on the map.")
@click.option("--crs", metavar="CRS",
              help="CRS of the ground coordinates: EPSG:n, or `local`. By default that of the "
                   "points, else of the first map.")
@click.option("--out", "folder", metavar="DIR", type=_FILE,
              help="Folder of the session and of all that is saved. By default the image's name "
                   "with -control, in the current folder.")
@click.option("--port", metavar="N", type=click.IntRange(0, 65535), default=0, show_default=True,
              help="Port of the page; 0 for one that is free.")
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
@click.option("--example", is_flag=True, help="Show the scene of the tutorial, in a new folder "
                                              f"{EXAMPLE}.")
@remote_option
def app(image: str | None, maps: tuple[str, ...], points: Path | None, lines: Path | None,
        rpc: Path | None, dem: Path | None, crs: str | None, folder: Path | None, port: int,
        no_browser: bool, example: bool) -> None:
    """Collect control points in the browser, with their quality at every click.

    IMAGE is the image to georeference, or with --allow-remote the address of the info.json of an
    IIIF image; DIR goes on with a session, or shows a result that a run wrote. The page is for this
    machine alone. Ctrl-C ends it; every change is saved at once, and the same command goes on where
    it ended.

    \b
    Examples:
      termsel app --example
      termsel app scan.tif --map ortho.tif
      termsel app scan.tif --map roads.gpkg --crs EPSG:25832
      termsel app scene.tif --map ortho.tif --rpc scene.RPB --dem dem.tif
      termsel app scan.tif --crs EPSG:4326 --points control.csv
    """
    show_messages()

    from termsel.toolkit.files import allowed_drivers, remote_allowed
    from termsel_app.page_files import require_page
    from termsel_app.server import serve
    from termsel_app.session import Files, open_session

    require_page()
    files = Files(image, maps, _path_text(points), _path_text(lines), _path_text(rpc),
                  _path_text(dem), crs)
    if example:
        files, folder = example_files(files, folder)
    elif image is None:
        raise TermselError("no image is given",
                           hint="Give an image: termsel app scan.tif --map ortho.tif. Or look at "
                                "the example: termsel app --example.")
    else:
        files, folder = files_of_session(files, folder)
    with open_session(files, folder, remote=remote_allowed(),
                      drivers=allowed_drivers()) as session:

        def announce_page(address: str, first_address: str) -> None:
            """Print the page's address, and open it in the browser unless that is not wanted."""
            echo(f"The page is at {address}")
            echo(f"Saved in {folder}; Ctrl-C ends it.", err=True)
            if not no_browser:
                webbrowser.open(first_address)

        try:
            serve(session, port, announce_page)
        except KeyboardInterrupt:
            echo(f"\nEnded. All changes are saved in {folder}; the same command goes on.",
                 err=True)


def _path_text(path: Path | None) -> str | None:
    """Return a path as text; None stays None."""
    return None if path is None else str(path)


def files_of_session(files: Files, folder: Path | None) -> tuple[Files, Path]:
    """Return the files of a session and the folder of its journal.

    `files.image` is the first argument of the command: an image or its IIIF address, the folder of
    a session, or that of a result. A session goes on with its own files and the new maps. Without
    `folder`, it stays in its folder; that of a result begins beside the result in NAME-control, and
    that of an image in NAME-control in the current folder. Raises TermselError for another folder.
    """
    from dataclasses import replace

    from termsel_app.iiif import is_iiif
    from termsel_app.journal import JOURNAL_NAME, header_of
    from termsel_app.session import Files

    path = Path(files.image or "")
    if is_iiif(files.image):
        return files, folder or default_folder(f"{path.parent.name or 'image'}-control")
    if not path.is_dir():
        return files, folder or default_folder(f"{path.stem or 'image'}-control")
    if (path / JOURNAL_NAME).exists():
        # The journal lists no maps of servers, so that those are always given anew.
        before = Files.of_header(header_of(path), path)
        return replace(before, maps=before.maps + files.maps), folder or path
    if (path / "result.json").exists():
        beside = path.with_name(f"{path.name}-control")
        return files_of_result(path, files), folder or default_folder(beside)
    raise TermselError("this folder contains neither a session nor a result", file=path,
                       hint="Give an image, or the folder that `termsel app` or `termsel run "
                            "--out` wrote.")


def default_folder(name: Path | str) -> Path:
    """Return a name as the path of a session's folder, for a name that the user did not type.

    Raises TermselError if it is a symbolic link, which somebody else may have laid there.
    """
    folder = Path(name)
    refuse_link(folder)
    return folder


def files_of_result(folder: Path, files: Files) -> Files:
    """Return `files` with the points, lines and CRS of the result in a folder.

    There is no image, but the size of that of the result, if it is known. Maps, RPC and DEM stay.
    Raises TermselError if the result cannot be read.
    """
    from dataclasses import replace

    from termsel import read_result

    features = read_result(folder).features
    names = {kind: str(folder / f"{kind}.csv") for kind in ("points", "lines")
             if (folder / f"{kind}.csv").exists()}
    return replace(files, image=None, points=names.get("points"), lines=names.get("lines"),
                   crs=features.crs, size=features.image_size)


def example_files(files_given: Files, folder: Path | None) -> tuple[Files, Path]:
    """Write the files of the tutorial, unless they are there; return them and the session's folder.

    The files are `files_given` with image, map, DEM and CRS of the tutorial's scene.
    """
    from dataclasses import replace

    from termsel.toolkit.files import write_example

    session_folder = folder or default_folder(EXAMPLE)
    if not (session_folder / "files").exists():
        make_folder(session_folder)
        write_example(session_folder / "files")
    files = session_folder / "files"
    return replace(files_given, image=str(files / "scene.tif"), maps=(str(files / "ortho.tif"),),
                   dem=str(files / "dem.tif"), crs="EPSG:4979"), session_folder
