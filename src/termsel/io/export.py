"""Write a result in a format known by name."""

from __future__ import annotations

import logging
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from termsel.core.arguments import explains_arguments
from termsel.core.display.quiet import quiet_logger
from termsel.core.errors import ON_SUCCESS, PENDING, TermselError, rounded_size_text
from termsel.core.files.atomic import private_folder
from termsel.core.files.names import is_there, refuse_link
from termsel.core.remedies import Remedy
from termsel.data.coordinates.earth import note_on_turned
from termsel.formats.vrt import IMAGE, picture_for
from termsel.io.replacing import require_replaceable
from termsel.plugins.registry import registry
from termsel.results.result import Result, require_result
from termsel.results.verdict import does_nothing_fit, misfit_in_words, size_of_errors

if TYPE_CHECKING:
    from termsel.formats.base import Writer

log = logging.getLogger(__name__)


def writer_of(to: str, **options: Any) -> Writer:
    """Return the writer of a format, without options that only other formats have."""
    writer: type[Writer] = registry().get("writers", to)
    # An option of --image, say, is given to all formats, of which few have it.
    return writer(**{key: value for key, value in options.items()
                     if key not in _options_of_other_formats(writer)})


def _options_of_other_formats(writer: type[Writer]) -> set[str]:
    """Return the options that other formats have and this one has not."""
    of_all: set[str] = set()
    for entry in registry().entries("writers"):
        of_all |= {option.name for option in entry.object.declared_options}
    return of_all - {option.name for option in writer.declared_options}


def as_exported(result: Result, final: bool | None) -> Result:
    """Return the result with the fit that is exported (see `Result.as_exported`).

    With `final` True that is the fit to all points, with False the other one, and with None the fit
    to all points if there is one. Which fit it is, and a warning if it does not fit the points, are
    logged when the export has succeeded.
    """
    if does_nothing_fit(result):
        log.warning("Warning: %s. The RMSE is %s px, and what is made of this result is as far "
                    "off.", misfit_in_words(result), rounded_size_text(size_of_errors(result)),
                    extra={PENDING: ON_SUCCESS})
    if result.final is not None and final is False:
        log.info("Used: the fit without the independent check points.",
                 extra={PENDING: ON_SUCCESS})
    elif result.final is not None:
        control = result.final.control
        log.info("Used: the fit to all %d %s. The accuracy that the run states is of the fit "
                 "without the independent check points; --no-final uses that one.", len(control),
                 control.word, extra={PENDING: ON_SUCCESS})
    return result.as_exported(final)


def _files_left_alone(writer: Writer, result: Result, path: Path) -> list[Path]:
    """Return the further files of an export to `path` that have the content they would get.

    Writers of several files write that of `path` last, which is not there yet. So an export that
    was killed leaves such files, and can be repeated; a file of other content is somebody's own.
    """
    siblings = [file for file in writer.files(path) if file != path and is_there(file)]
    if not siblings:
        return []
    with private_folder() as folder, quiet_logger("termsel", logging.CRITICAL):
        writer.write(result, folder / path.name)
        return [file for file in siblings if file.is_file() and (folder / file.name).is_file()
                and file.read_bytes() == (folder / file.name).read_bytes()]


@explains_arguments(checked_within=("result",))
def export(result: Result, to: str, path: Path | str, *, overwrite: bool = False,
           final: bool | None = None, **options: Any) -> tuple[Path, ...]:
    """Write a result in a format known by name.

    Parameters
    ----------
    result : Result
        As `termsel.run` or `termsel.read_result` returns it.
    to : str
        The name of a format that ``termsel list writers`` shows.
    path : path-like
    overwrite : bool
        Whether an existing file may be replaced, such as a vendor's RPC.
    final : bool, optional
        Whether to export the fit to all points, independent ones included (`Result.final`); by
        default if there is one.
    **options
        Options of the writer, such as `image`. Those that only other formats have are ignored
        with a note, so that one call suits several formats.

    Returns
    -------
    tuple of pathlib.Path
        The files that were written.

    Raises
    ------
    TermselError
        If there is no such format or option, the format cannot hold this result, the file
        exists and may not be replaced, is read itself, or cannot be written.

    Examples
    --------
    >>> import tempfile, termsel
    >>> result = termsel.run("poly-terms", seed=1, generations=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.name for path in termsel.export(result, "points-csv", f"{folder}/points.csv")]
    ['points.csv']
    """
    require_result(result, "export")
    path = Path(path)
    result = as_exported(result, final)
    if registry().known("writers", to) is None and registry().known("writers", str(path)):
        raise TermselError(f"{to!r} is no format to write",
                           hint=f"The format comes first: termsel.export(result, {str(path)!r}, "
                                f"{to!r}).")
    writer = writer_of(to, **options)
    ignored = sorted(options.keys() & _options_of_other_formats(type(writer)))
    if "image" in ignored and options["image"] and Path(options["image"]).is_file():
        # Another image than that of the features is refused whatever the format.
        picture_for(result, options["image"])
    for key in ignored:
        near = get_close_matches(key, [option.name for option in type(writer).declared_options])
        question = f" Did you mean {near[0]}?" if near else ""
        log.info("Note: the format %s has no option %s, which is ignored.%s", to, key, question)
    if not writer.accepts(result):
        suitable = ", ".join(entry.name for entry in registry().entries("writers")
                             if entry.object().accepts(result))
        needs = f"It needs {writer.needs}. " if writer.needs else ""
        raise TermselError(f"the format {to} cannot hold this result",
                           hint=f"{needs}Formats that do: {suitable}.")
    known = result.fit.model.known_image()
    if known is not None and known.lines is not None:
        log.warning("Warning: %s. What a program makes of other lines by the file is wrong.",
                    known.sentence())
    if mirrored := note_on_turned(result.features):
        log.warning("Warning: %s", mirrored)
    # Files that an export which was killed has left may be replaced without being asked for.
    files = set(writer.files(path))
    if not overwrite and not is_there(path):
        files -= set(_files_left_alone(writer, result, path))
    require_replaceable(files, reads=writer.options.values(), overwrite=overwrite, beside=False)
    # A link is followed only under the name that the user typed.
    for file in files - {path}:
        refuse_link(file)
    writer.write(result, path)
    if IMAGE in writer.declared_options and writer.options["image"] is None:
        log.warning("Warning: %s has no pixels: give the image with %s.", path.name,
                    Remedy("image", "FILE"))
    return tuple(file for file in writer.files(path) if file.exists())
