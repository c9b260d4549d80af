"""What a user asks a run for: options that `run` shares with commands of plugins."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from termsel.cli.completion import complete
from termsel.cli.messages import echo, say_written
from termsel.cli.options.shared import Command, progress_option, remote_option
from termsel.cli.report import REPORT
from termsel.cli.topics import Whole
from termsel.core.errors import TermselError
from termsel.core.files.endings import PAGES, RASTERS
from termsel.core.options import SEED

if TYPE_CHECKING:
    from termsel.data.features import FeatureSet
    from termsel.results.result import Result

COLUMNS_OPTION = click.option(
    "--columns", metavar="PAIRS",
    help="Which column of the table is which, by its name or number: line=Zeile,sample=4,x=2,y=3. "
         "Meanings are id, role, line, sample, x, y, z; of lines line1, sample1 and so on.")

_OPTIONS = (
    click.option("--problem", metavar="NAME", shell_complete=complete("problems"),
                 help="The problem to solve; see `termsel list problems`. By default the "
                      "strategy auto chooses a model; with --solver and the like the problem is "
                      "owdis-lines with lines, otherwise rfm-terms, or poly-terms without "
                      "heights."),
    click.option("--dataset", metavar="NAME", shell_complete=complete("datasets"),
                 help="A data set known by name; the problem's own by default."),
    click.option("--points", metavar="FILE", type=click.Path(path_type=Path),
                 help="Points, in any format of `termsel list readers`."),
    click.option("--lines", metavar="FILE", type=click.Path(path_type=Path),
                 help="Control lines, in any format of `termsel list readers`."),
    click.option("--areas", metavar="FILE", type=click.Path(path_type=Path),
                 help="Areas, by their corners: as lines along their edges, or as centroids if "
                      "points are the control; --set areas_as=boundary or centroid chooses."),
    click.option("--format", "formats", metavar="NAME", multiple=True,
                 shell_complete=complete("readers"),
                 help="Read the file in this format, whatever it looks like. With several files, "
                      "give one for each, in the order points, lines, areas."),
    COLUMNS_OPTION,
    click.option("--dem", metavar="FILE", type=click.Path(path_type=Path),
                 help="Raster of heights, for points and lines that have none."),
    click.option("--raster", metavar="FILE",
                 help="The image the points were measured in, for formats that need it."),
    click.option("--rpc", metavar="FILE", type=click.Path(path_type=Path),
                 help="The vendor's RPC, or the image with an RPC in its tags or beside it: auto "
                      "corrects it by one point or more (package termsel-rpc)."),
    click.option("--image", metavar="FILE", type=click.Path(path_type=Path),
                 help="The image: its size, and its RPC if it has one."),
    click.option("--image-lines", metavar="FILE",
                 help="Image lines id,line1,sample1,line2,sample2, for ground lines from a GIS."),
    click.option("--crs", metavar="CRS",
                 help="CRS of the ground coordinates: EPSG:4979 for longitude, latitude and "
                      "ellipsoidal height; `local` for plane coordinates without a CRS."),
    click.option("--candidates", metavar="FILE", type=click.Path(path_type=Path),
                 help="Projections that --crs auto chooses from for an old map, a CRS a line."),
    click.option("--fit-crs", metavar="CRS",
                 help="Coordinates the model is fitted in: geodetic, projected (UTM), geocentric, "
                      "polar (stereographic) or EPSG:n. auto takes the one of the first four that "
                      "predicts best."),
    click.option("--off", metavar="IDS", multiple=True,
                 help="Leave out these points and lines, such as P07,P12."),
    click.option("--role", metavar="ID=ROLE", multiple=True,
                 help="Role of a point, whatever the file says: control, check (a selection "
                      "point), independent (one that tests the result) or off. Several have commas "
                      "between them: P07=independent,P12=off; may be repeated."),
    click.option("--model", metavar="NAME", shell_complete=complete("models"),
                 help="Model to fit, with all its terms; with --solver or --problem, the model "
                      "whose terms are selected. See `termsel list models`."),
    click.option("--solver", metavar="NAME", shell_complete=complete("solvers"),
                 help="Solver; see `termsel list solvers`."),
    click.option("--then", metavar="NAME", shell_complete=complete("solvers"),
                 help="Solver of the second step, with --set steps=features-first or "
                      "terms-first."),
    click.option("--criterion", metavar="NAME", shell_complete=complete("criteria"),
                 help="Figure that the search minimises; see `termsel list criteria`."),
    click.option("--method", metavar="NAME", shell_complete=complete("methods"),
                 help="One method in place of the automatic choice; see `termsel list methods`."),
    click.option("--strategy", type=click.Choice(["auto", "as-asked"]),
                 help="`auto` chooses among conventional and regularised models by predicted "
                      "RMSE; `as-asked` runs the problem's solver. auto is the default for "
                      "rfm-terms, poly-terms, and without --problem, unless you name a model, a "
                      "method or a budget."),
    click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
                 help="An option of the problem, model, solver, criterion, data or file format; "
                      "may be repeated. `termsel describe NAME` lists them."),
    click.option("--seed", type=Whole(0, SEED), default=1, show_default=True,
                 help="Seed of the search; the same seed gives the same selection."),
    click.option("--generations", type=Whole(1, 10**12),
                 help="Stop after N generations beyond the first population."),
    click.option("--evaluations", type=Whole(1, 10**12),
                 help="Stop after N evaluations, those of a local refinement included; exact "
                      "stops by --seconds."),
    click.option("--seconds", type=click.FloatRange(0, 1e9, min_open=True),
                 help="Stop after S seconds."),
    click.option("--patience", type=Whole(1, 10**12),
                 help="Stop after N generations without a gain above --set tolerance."),
    click.option("--export", "exports", metavar="FORMAT", multiple=True,
                 shell_complete=complete("writers"),
                 help="Write the result to --out in this format too; may be repeated."),
    click.option("--report", "reports", is_flag=True,
                 help="Write the page report.html to --out too; see `termsel report`."),
    click.option("--overwrite", is_flag=True, help="Replace existing files in --out."),
    click.option("--json", "as_json", is_flag=True, help="Print JSON alone on stdout."),
    click.option("--quiet", is_flag=True, help="No progress bar; the summary is still printed."),
    progress_option,
)


def run_options(command: Command) -> Command:
    """Add the options of `RunOptions` to a command, but for ``--out``."""
    command = remote_option(command)
    # Decorators apply from the inside: reversed, help shows the options in the order of the list.
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


_OF_COMMAND = ("lines", "areas", "dem", "image", "crs", "problem", "dataset", "model",
               "solver", "criterion", "method", "strategy", "generations", "evaluations", "seconds",
               "patience", "out")
"""Options of the command that may be taken for one of --set."""


def _refuse_options_of_command(settings: Iterable[str]) -> None:
    """Raise TermselError for a setting that is an option of the command."""
    for setting in settings:
        key, _, value = setting.partition("=")
        if key in _OF_COMMAND:
            raise TermselError(f"{key} is an option by itself, not one of --set",
                               hint=f"Type --{key} {shlex.quote(value or 'VALUE')}.")


@dataclass(frozen=True)
class RunOptions:
    """What is asked for by the options of `run_options` and ``--out``; as click gives them.

    Raises TermselError for a setting without an equals sign, options that exclude each other, and
    options that say something of what is not given.
    """

    problem: str | None
    dataset: str | None
    points: Path | None
    lines: Path | None
    areas: Path | None
    formats: tuple[str, ...]
    dem: Path | None
    raster: str | None
    rpc: Path | None
    image: Path | None
    image_lines: str | None
    columns: str | None
    crs: str | None
    candidates: Path | None
    fit_crs: str | None
    off: tuple[str, ...]
    role: tuple[str, ...]
    model: str | None
    solver: str | None
    then: str | None
    criterion: str | None
    method: str | None
    strategy: str | None
    settings: tuple[str, ...]
    seed: int
    generations: int | None
    evaluations: int | None
    seconds: float | None
    patience: int | None
    out: Path | None
    exports: tuple[str, ...]
    reports: bool
    overwrite: bool
    as_json: bool
    quiet: bool
    # those of --set, with those that have an option of their own
    options: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        """Parse the settings, and check the options before any file is read.

        Raises TermselError for options that exclude each other or require another.
        """
        _refuse_options_of_command(self.settings)
        # The class is frozen; this one field follows from the others.
        object.__setattr__(self, "options", parse_settings(
            self.settings, fit_crs=self.fit_crs,
            projection_candidates=None if self.candidates is None else str(self.candidates),
            off=",".join(self.off) or None,
            role=",".join(self.role) or None, then=self.then))
        if self.dataset is not None and self.files:
            raise TermselError("--dataset cannot be combined with files",
                               hint="Give --dataset NAME, or --points FILE and --lines FILE.")
        if self.rpc is not None and not self.files:
            raise TermselError("an RPC alone has nothing to be corrected by", file=self.rpc,
                               hint="Give control points, too: termsel run --points FILE "
                                    f"--rpc {shlex.quote(str(self.rpc))}.")
        for name, value in self._options_of_files.items():
            if value and not self.files:
                raise TermselError(f"{name} requires --points or --lines",
                                   hint=f"Give --points FILE, or leave {name} out.")
        if self.solver == "exact" and (self.evaluations or self.generations):
            name = "evaluations" if self.evaluations else "generations"
            raise TermselError(f"--{name} does not bound exact, which decides on many subsets at "
                               "once",
                               hint="Give --seconds S, or leave it out: exact ends with the proof.")
        if self.problem is None and self.dataset is None and not self.files:
            raise TermselError("there is nothing to run",
                               hint="Give --points FILE or --lines FILE, or --problem NAME or "
                                    "--dataset NAME for simulated data.")
        if (self.exports or self.reports) and self.out is None:
            raise TermselError(f"--{'export' if self.exports else 'report'} requires --out",
                               hint="Give a folder: --out DIR.")

    @property
    def files(self) -> list[Path]:
        """Files of features."""
        return [path for path in (self.points, self.lines, self.areas) if path is not None]

    @property
    def _options_of_files(self) -> dict[str, Any]:
        return {"--format": self.formats, "--dem": self.dem, "--raster": self.raster,
                "--rpc": self.rpc, "--image": self.image, "--image-lines": self.image_lines,
                "--columns": self.columns, "--crs": self.crs}

    @property
    def reads(self) -> list[object]:
        """Everything that may be the name of a file that is read."""
        return [*self.files, self.dem, self.raster, self.rpc, self.image, self.image_lines,
                *self.options.values()]

    @property
    def source(self) -> str | None:
        """The files in one text, for the record; None without any."""
        # The file of image lines is data as well, whose checksum the record has.
        return ", ".join(str(path) for path in (*self.files, self.image_lines)
                         if path is not None) or None

    @property
    def budget(self) -> dict[str, Any]:
        """Seed and limits of a search."""
        return {"seed": self.seed, "generations": self.generations,
                "evaluations": self.evaluations, "seconds": self.seconds,
                "patience": self.patience}

    def further_files(self) -> tuple[dict[str, Path], Path | None]:
        """Return the files of ``--export`` in ``--out``, by format, and the page of ``--report``.

        The page is None if it is not asked for. Raises TermselError for an unknown format, if
        altair, which draws the page, is not installed, and for a file that may not be replaced.
        """
        if self.out is None or not (self.exports or self.reports):
            return {}, None
        from termsel.io.export import writer_of
        from termsel.io.replacing import require_replaceable
        from termsel.results.theme import require_altair

        # A format says how its files end; one that does not is named by its format.
        files = {to: self.out / f"result{writer_of(to).suffix or f'.{to}'}" for to in self.exports}
        written: list[Path] = []
        for to, file in files.items():
            written += writer_of(to).files(file)
        page = self.out / REPORT if self.reports else None
        if page is not None:
            require_altair()
            written.append(page)
        require_replaceable(written, reads=self.reads, overwrite=self.overwrite,
                            makes_folder=True)
        return files, page

    def write(self, result: Result, export_files: Mapping[str, Path], page: Path | None) -> None:
        """Write a result to the files of `further_files`, and say on stderr which were written."""
        from termsel.io.export import export

        for to, file in export_files.items():
            say_written(export(result, to, file, overwrite=self.overwrite))
        if page is not None:
            result.report(page, overwrite=self.overwrite)
            say_written([page])

    def read(self) -> tuple[FeatureSet | None, dict[str, str]]:
        """Return the features of the files, None without files, and the options for the run.

        Options under --set are those of reading, of the readers of these files or of the run. The
        first two are taken out here, as their names say what they are for. Raises TermselError for
        an option that is given twice or is misspelt, and for files that cannot be read.
        """
        from termsel.io.read import read, readers_of
        from termsel.plugins.registry import registry

        options = dict(self.options)
        # Areas of a problem that takes points alone are used as their centroids.
        if (self.areas is not None and self.problem is not None
                and registry().get("problems", self.problem).control == "points"):
            options.setdefault("areas_as", "centroid")
        if not self.files:
            return None, options
        self._require_correction()
        of_reading = take_reading(options)
        arguments = {"raster": self.raster, "image_lines": self.image_lines,
                     "columns": self.columns}
        accepted: set[str] = set()
        for reader in readers_of(self.files, self.formats):
            accepted |= {option.name for option in reader.declared_options}
        of_readers = {key: options.pop(key) for key in list(options) if key in accepted}
        for key in of_readers:
            if arguments.get(key) is not None:
                raise TermselError(f"{key} is given twice", hint="Give it once.")
        return read(self.points, self.lines, areas=self.areas, crs=self.crs, format=self.formats,
                    dem=self.dem, rpc=self.rpc, image=self.image,
                    off=options.get("off"), role=options.get("role"), **of_reading,
                    **{**arguments, **of_readers}), options

    def _require_correction(self) -> None:
        """Refuse --rpc where no installed package corrects an RPC, and nothing else uses it.

        A problem, model, method or solver that the user names may use it.
        """
        from termsel.plugins.registry import registry

        users = (self.problem, self.model, self.method, self.solver)
        if self.rpc is None or any(name is not None for name in users):
            return
        if missing := registry().missing("rpc-gcps"):
            raise TermselError(f"{self.rpc}: no installed package corrects an RPC", hint=missing)

    def command(self, problem: str, solver: str, criterion: str,
                settings: Mapping[str, str]) -> str:
        """Return a command that runs another search on the same data.

        It has the given problem, solver and criterion, the model and data of these options, and
        `settings` as the values of ``--set``.
        """
        from termsel.core.files.drivers import remote_allowed

        words = ["termsel", "run", "--problem", problem]
        # In the order in which a user would type them.
        data = {"--dataset": self.dataset, "--points": self.points, "--lines": self.lines,
                "--areas": self.areas, **self._options_of_files, "--model": self.model,
                "--solver": solver, "--criterion": criterion,
                "--set": tuple(f"{key}={value}" for key, value in settings.items())}
        for name, value in data.items():
            for option in value if isinstance(value, tuple) else [value]:
                words += [] if option is None else [name, str(option)]
        return shlex.join([*words, "--allow-remote"] if remote_allowed() else words)


_SCENES = {".dim"}
"""Endings of metadata that stand for the image of a scene."""
_RPCS = {".rpb", ".rpc"}
_COMMENTS = 20
"""Lines at the head of a table among which its header is looked for, below comments."""


def with_files(files: Sequence[Path], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments with each of `files`, given without an option, under the option for it.

    A file may be the image, the RPC, heights, lines or points. An image that is given without any
    points, lines, areas, data set or problem is also taken for the file of points, as it may hold
    some.

    Raises
    ------
    TermselError
        If two files are of one kind, or one is a page.
    """
    options = dict(arguments)
    for path in files:
        if path.suffix.lower() in PAGES:
            raise _page_error(path, is_report=bool(arguments["reports"]))
        kind = _kind_of(path)
        if kind == "image" and options["dem"] is None and _holds_heights(path):
            kind = "dem"
        if options[kind] is not None:
            raise _two_of_one_kind_error(kind, options[kind], path)
        options[kind] = path
    names = ("points", "lines", "areas", "dataset", "problem")
    if (options["image"] is not None and not any(options[name] for name in names)
            and arguments["image"] is None):
        options["points"] = options["image"]
    return options


def _page_error(path: Path, is_report: bool) -> TermselError:
    """Return the error for a page among the files of a run; `is_report` if --report was given."""
    if is_report:
        return TermselError("this is the name of a page, and a run reads points, lines, images "
                            "and RPCs", file=path,
                            hint="--report takes no name: it writes report.html into the folder "
                                 "of --out.")
    ending = path.suffix.lower()
    return TermselError(f"termsel reads no points from a file {ending}", file=path,
                        hint="If it has a table of points, save that as CSV or XLSX, and give that "
                             "file. If it has an image, save that as TIFF or PNG.")


def _two_of_one_kind_error(kind: str, first: Path, second: Path) -> TermselError:
    """Return the error for two files of one kind.

    Its remedy is for a likely reason: a folder, a file given twice, a name with a blank that was
    not quoted, an id that was taken for a file, or points of several images. Else it is to name
    what each file is.
    """
    for path in (first, second):
        if path.is_dir():
            return TermselError("this is a folder, and a run takes files", file=path,
                                hint="Give the file of points within it, and the result a folder "
                                     "of its own: --out DIR.")
    if first == second:
        return TermselError(f"{first} is given twice", hint="Give it once.")
    unquoted = f"{first} {second}"
    if Path(unquoted).exists():
        return TermselError(f"{first} and {second} do not exist, but {unquoted!r} does",
                            hint="A name with blanks needs quotation marks: "
                                 f"{shlex.quote(unquoted)}.")
    for path in (first, second):
        # A second id after --off, such as --off P1 P2, looks like a file.
        if not path.exists() and not path.suffix and "/" not in str(path):
            return TermselError("this file does not exist", file=path,
                                hint="If it is an id, write ids with commas and without blanks: "
                                     f"--off ID,{path}. Otherwise check the name and the folder.")
    hint = "Name each file: --points FILE, --lines FILE, --image FILE, --rpc FILE, --dem FILE."
    if kind == "points":
        hint = ("Points of one image: join them in one table. Points of two images: termsel "
                f"compare --points {shlex.quote(str(first))} {shlex.quote(str(second))} --out DIR.")
    return TermselError(f"{first} and {second} are both {kind}, and a run takes one file of "
                        f"{kind}" if kind in ("points", "lines") else
                        f"{first} and {second} are both taken for the {kind}", hint=hint)


def _holds_heights(path: Path) -> bool:
    """Return whether a raster looks like heights rather than like an image, and say so."""
    from termsel.formats.heights import looks_like_heights

    if not looks_like_heights(path):
        return False
    echo(f"Note: {path} is read as heights (--dem): one georeferenced band of signed or decimal "
         "numbers. If it is the image, give it with --image.", err=True)
    return True


def _kind_of(path: Path) -> str:
    """Return the name of the option that a file is for: "image", "rpc", "lines" or "points".

    Images and RPCs are known by their names, lines by the header of their table. Whatever else it
    is, and what cannot be read, is for "points", whose reader says what is wrong with it.
    """
    from termsel.formats.base import read_head

    suffix = path.suffix.lower()
    if suffix in RASTERS | _SCENES:
        return "image"
    if suffix in _RPCS or path.stem.lower().endswith("_rpc"):
        return "rpc"
    try:
        head = read_head(path, "")
    except TermselError:
        return "points"
    first_lines = head.decode("utf-8", "replace").lower().splitlines()[:_COMMENTS]
    # Comments, such as that of the CRS, come before the header.
    header = next((line for line in first_lines if line[:1] != "#"), "")
    return "lines" if "line1" in header else "points"


def parse_settings(settings: tuple[str, ...], **named: str | None) -> dict[str, str]:
    """Return the options of ``--set KEY=VALUE``, with those for which a command has an option.

    Parameters
    ----------
    settings : tuple of str
        The values of ``--set``.
    **named : str or None
        The values of the command's own options; None where one is not given.

    Raises
    ------
    TermselError
        For a setting that is not of the form KEY=VALUE, for a key that is given twice, and where a
        setting and the command's own option differ.
    """
    options: dict[str, str] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise TermselError(f"--set {setting!r} is not of the form KEY=VALUE",
                               hint="For example --set population=300.")
        if key.strip() in options:
            raise TermselError(f"--set {key.strip()} is given twice", hint="Give it once.")
        options[key.strip()] = value.strip()
    for key, stated in named.items():
        if stated is not None and options.setdefault(key, stated) != stated:
            raise TermselError(f"{key} is given twice", hint="Give it once.")
    return options


def take_reading(settings: dict[str, str]) -> dict[str, str]:
    """Take the options of reading out of those of ``--set``, and return them.

    Parameters
    ----------
    settings : dict of str to str
        It keeps all others.

    Raises
    ------
    TermselError
        For an option that is left and begins as one of reading does, such as camera_fokal.
    """
    # Without --set nothing need be imported to know these options.
    if not settings:
        return {}
    from termsel.io.read import read_options, refuse_misspelt

    of_reading = {option.name: settings.pop(option.name) for option in read_options()
                  if option.name in settings}
    refuse_misspelt(settings)
    return of_reading
