"""One case: a mutated file or a hostile option, what is done with it, and what must hold."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import termsel
from termsel.cli.main import cli
from termsel.core.errors import TermselError, make_printable
from termsel.data.features import FeatureSet
from termsel.formats.heights import with_heights
from termsel.plugins.registry import registry
from termsel.results import pictures
from termsel.results.pictures import draw_picture
from termsel.results.result import SEALS, checksum_of_record
from termsel.runs.request import DATA_OPTIONS
from termsel.simulate import read_geometry
from tests.fuzz import readers, surfaces
from tests.fuzz import seeds as formats
from tests.fuzz.mutate import NUMBERS, TEXTS, mutated
from tests.fuzz.seeds import Seed

SECONDS = 10.0
"""Time of the processor that a case may take; others on the machine do not count."""

MEMORY = 2 << 30
"""Bytes that a case may add to those of the process."""

_FAST = ("--strategy", "as-asked", "--solver", "all-terms", "--criterion", "press", "--set",
         "degree=1")


@cache
def seeds() -> tuple[Seed, ...]:
    """Return all valid files."""
    of_formats = formats.seeds()
    points = next(seed.content for seed in of_formats if seed.name == "points.csv")
    return (*of_formats, *surfaces.surfaces(points), *readers.reader_seeds())


@cache
def _drawn() -> tuple[Seed, ...]:
    """Return the files as often as they are to be used: one stands for all studies."""
    return (*seeds(), *[seed for seed in seeds() if seed.kind == "study"] * 3)


class TooSlow(BaseException):
    """A case took more than its time; no handler of termsel's catches it."""


@dataclass(frozen=True)
class Outcome:
    """How a case ended.

    Parameters
    ----------
    seed : int
    name : str
        The use and the file, or "options".
    code : int
        0 or 2; 1 where something was raised that no user can correct.
    fault : str
        What is wrong, "" for nothing.
    seconds : float
    """

    seed: int
    name: str
    code: int
    fault: str
    seconds: float


def run_case(seed: int) -> Outcome:
    """Run one case, in this process.

    Parameters
    ----------
    seed : int
        Tells the file, its mutations and its use; the same seed gives the same case.
    """
    random = Random(seed)
    # Begun outside of the limits, which V8 cannot keep.
    if pictures._drawing_helper()._child is None:
        draw_picture(_chart(), ".svg")
        readers.start_helper()
    chosen = None if random.random() < 0.15 else random.choice(_drawn())
    _prepare("points" if chosen is None else chosen.kind)
    start = time.process_time()
    with TemporaryDirectory() as name, warnings.catch_warnings(), _silent(), _limited():
        warnings.simplefilter("error", RuntimeWarning)
        folder = Path(name)
        if chosen is None:
            label, use = "options", lambda: _options(folder, random)
        else:
            path = _laid(chosen, folder, random)
            label, use = f"{chosen.kind}:{chosen.name}", lambda: _use_of(chosen.kind)(path, random)
        before = _contents(folder)
        code, fault = _ended(use)
        after = _contents(folder)
        lost = [file for file, content in before.items() if after.get(file) != content]
        if lost:
            fault = fault or f"changed or lost: {', '.join(lost)}"
        left = [file for file in after if code and file not in before]
        if left:
            fault = fault or f"left behind: {', '.join(left)}"
    return Outcome(seed, label, code, fault, time.process_time() - start)


def _chart() -> Any:
    import altair

    return altair.Chart(altair.Data(values=[])).mark_point()


def _laid(seed: Seed, folder: Path, random: Random) -> Path:
    """Write a mutated file and those next to it; return its path."""
    for name, content in seed.others:
        (folder / name).write_bytes(content)
    content = mutated(seed.content, random)
    if seed.name == "result.json" and random.random() < 0.7:
        content = _sealed(content)
    (folder / seed.name).write_bytes(content)
    return folder / seed.name


def _sealed(content: bytes) -> bytes:
    """Return a record with the checksum of what it now holds, so that more of it is read."""
    with contextlib.suppress(ValueError, RecursionError, TypeError, KeyError, AttributeError):
        record = json.loads(content)
        record[SEALS]["record"] = checksum_of_record(record)
        return json.dumps(record).encode()
    return content


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes()
            for path in folder.rglob("*") if path.is_file()}


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Log errors alone while the block runs; other tests look at what is logged."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """Limit time and memory while the block runs."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS,
                       (pages * resource.getpagesize() + MEMORY, limits[1]))

    def stop(*_: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        resource.setrlimit(resource.RLIMIT_AS, limits)


def _ended(use: Callable[[], int]) -> tuple[int, str]:
    """Return the exit code of a use, and what is wrong with how it ended."""
    try:
        code = use()
    except TermselError as error:
        text = str(error)
        is_shown = make_printable(text) == text and len(text) < 7500
        return 2, "" if is_shown else f"not shown: {text!r}"
    except TooSlow:
        return 1, f"more than {SECONDS:g} s"
    except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        where = "" if place is None else f" ({Path(place.tb_frame.f_code.co_filename).name}:" \
            f"{place.tb_lineno})"
        return 1, f"{type(error).__name__}: {str(error)[:200]}{where}"
    return code, "" if code in (0, 2) else f"exit code {code}"


def command(*words: object) -> int:
    """Run a command line in this process; return its exit code.

    Raises
    ------
    AssertionError
        If it shows a traceback or what a terminal would obey.
    """
    out, err = io.StringIO(), io.StringIO()
    logging.getLogger("termsel").handlers.clear()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), \
            warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # rasterio's own
        try:
            cli.main([str(word) for word in words], prog_name="termsel")
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    shown = out.getvalue() + err.getvalue()
    for found in ("Traceback", "Exception ignored"):
        assert found not in shown, shown[-500:]
    assert make_printable(shown) == shown, repr(shown[-500:])
    assert code != 2 or "Error: " in err.getvalue(), shown[-500:]
    return code


def _read(kind: str, path: Path, random: Random) -> int:
    """Read features, and sometimes run and read back the result."""
    known = "EPSG:4979" if path.suffix == ".gcp" else None  # that format states none
    crs = random.choice((known, known, "local", "EPSG:4979", random.choice(TEXTS)))
    features = termsel.read(**{kind: path}, crs=crs)
    if kind == "points" and random.random() < 0.06:
        out = path.parent / "out"
        code = command("run", "--problem", "poly-terms", "--points", path, *_FAST, "--quiet",
                       *(("--crs", crs) if crs else ()), "--out", out)
        if code == 0:
            assert set(termsel.read_result(out).features.ids) == set(features.ids)
            where = features.points.ids
            assert len(set(where)) == len(where)
        return code
    return 0


def _vector(path: Path, random: Random) -> int:
    termsel.read(lines=path, image_lines=path.parent / "image.csv",
                 format=random.choice(("vector-lines", ())))
    return 0


def _joined(path: Path, random: Random) -> int:
    termsel.read(lines=path.parent / "lines.gpkg", image_lines=path)
    return 0


def _dem(path: Path, random: Random) -> int:
    features = termsel.read(path.parent / "points.csv")
    ground = features.points.ground.copy()
    ground[:, 2] = float("nan")
    bare = FeatureSet(termsel.Points(features.points.ids, features.points.image, ground),
                      crs="EPSG:4326")
    with_heights(bare, path)
    return 0


def _rpc(path: Path, random: Random) -> int:
    termsel.read_rpc(path)
    return 0


def _geometry(path: Path, random: Random) -> int:
    read_geometry(path)
    return 0


def _result(path: Path, random: Random) -> int:
    """Read a result and use it."""
    if random.random() < 0.7:
        termsel.read_result(path.parent)
        return 0
    with TemporaryDirectory() as folder:
        return command("export", path.parent, "--to", "points-csv", "-o", Path(folder) / "a.csv")


def _project(path: Path, random: Random) -> int:
    return command("project", path.parent, "--points", path,
                   *(("--inverse",) if random.random() < 0.3 else ()))


_TO = ("rpc-vrt", "rpc-txt", "gcp-vrt", "gcp-grid-vrt", "geolocation-vrt")


def _image(path: Path, random: Random) -> int:
    """Rectify an image, or export with it."""
    folder = path.parent
    if random.random() < 0.5:
        ground = random.choice((("--height", 250), ("--dem", folder / "heights.tif")))
        return command("rectify", folder, path, *ground, "-o", folder / "map.tif", "--quiet")
    return command("export", folder, "--to", random.choice(_TO), "--image", path, "-o",
                   folder / "a_RPC.TXT")


def _surface(path: Path, random: Random) -> int:
    """Use a raster of heights with a model that needs them."""
    folder = path.parent
    image = ("--image", folder / "image.tif")
    way = random.random()
    if way < 0.4:
        return command("rectify", folder, image[1], "--dem", path, "-o", folder / "map.tif",
                       "--quiet")
    if way < 0.7:
        return command("export", folder, "--to", "geolocation-vrt", *image, "--dem", path, "-o",
                       folder / "a.vrt")
    return command("project", folder, "--points", folder / "points.csv", "--inverse", "--dem",
                   path)


def _declared() -> list[str]:
    kinds = ("models", "solvers", "criteria", "readers", "writers")
    return sorted({option.name for kind in kinds for entry in registry().entries(kind)
                   for option in entry.object.declared_options}
                  | {option.name for option in DATA_OPTIONS})


def _passable(word: str) -> bool:
    """Return whether a shell can pass a word on."""
    try:
        return b"\0" not in os.fsencode(word)
    except UnicodeEncodeError:
        return False


def _options(folder: Path, random: Random) -> int:
    """Run a small task with hostile options."""
    points = next(seed.content for seed in seeds() if seed.name == "points.csv")
    (folder.parent / folder.name / "p.csv").write_bytes(points)
    words: list[object] = ["run", "--problem", "poly-terms", "--points", folder / "p.csv",
                           "--quiet", *_FAST[:-2]]
    settings = {"degree": "1"}
    for _ in range(random.choice((1, 1, 2))):
        settings[random.choice(_declared())] = random.choice((*NUMBERS, *TEXTS))
    for key, value in settings.items():
        words += ["--set", f"{key}={value}"]
    if random.random() < 0.4:
        option = random.choice(("--seed", "--evaluations", "--seconds", "--generations", "--crs",
                                "--fit-crs", "--model", "--solver", "--criterion", "--format",
                                "--dataset", "--dem", "--raster", "--image-lines", "--problem"))
        words += [option, random.choice((*NUMBERS, *TEXTS))]
    words = [word for word in words if _passable(str(word))]
    code = command(*words)
    (folder / "p.csv").unlink()
    return code


USES: dict[str, Callable[[Path, Random], int]] = {
    "points": lambda path, random: _read("points", path, random),
    "lines": lambda path, random: _read("lines", path, random),
    "areas": lambda path, random: _read("areas", path, random),
    "vector": _vector, "joined": _joined, "dem": _dem, "rpc": _rpc, "geometry": _geometry,
    "result": _result, "project": _project, "image": _image, "surface": _surface, **surfaces.USES}
"""What is done with a file, by the kind of its seed."""


def _use_of(kind: str) -> Callable[[Path, Random], int]:
    return USES[kind] if kind in USES else readers.reader_uses()[kind]


class _Fixed(Random):
    """Takes the first of all choices."""

    def __init__(self, share: float) -> None:
        super().__init__(0)
        self.share = share

    def random(self) -> float:
        return self.share

    def choice(self, sequence: Sequence[Any]) -> Any:
        return sequence[0]


def used_as_it_is(seed: Seed) -> None:
    """Use a valid file without mutations, both ways; AssertionError where it is refused."""
    for random in (_Fixed(0.0), _Fixed(0.9)):
        with TemporaryDirectory() as name:
            for file, content in (*seed.others, (seed.name, seed.content)):
                (Path(name) / file).write_bytes(content)
            code = _use_of(seed.kind)(Path(name) / seed.name, random)
            assert code == 0, (seed.name, random.random())


@cache
def _prepare(kind: str) -> None:
    """Import and make once what all cases of a kind use, so that none pays for it."""
    used_as_it_is(next(seed for seed in seeds() if seed.kind == kind))


def unseen() -> None:
    """Keep what libraries in C print off the terminal."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.__stderr__.fileno())
