"""Valid files of studies, pages, matching and plugins, and what is done with them."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np

import termsel
from termsel.core.errors import make_printable
from termsel.core.files.names import JOURNAL
from termsel.data.rasters import tiff_bytes
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import Registry
from termsel.studies.cells.folder import PLAN, study_progress
from termsel.studies.cells.journal import _seal_record as sealed_line
from termsel.studies.compare import plan_cells, requested_study
from termsel_studies.pages import study_as_latex, study_as_markdown
from termsel_studies.report import report
from tests.fuzz.seeds import Seed, result_files

Use = Callable[[Path, Random], int]

_STUDY = """title = "Two"
problems = ["poly-terms"]
solvers = ["random", {name = "swap", label = "b"}]
models = [{name = "poly2d", degree = 1}, "affine"]
criteria = ["press"]
seeds = 2
splits = [0, 1]
strategies = ["as-asked"]
measure = "check"
[[data]]
points = "*.csv"
crs = "EPSG:4979"
[budget]
evaluations = 40
timeout = 9.5
[options]
polish = false
"""

_METADATA = b"Metadata-Version: 2.1\nName: fuzzed-plugin\nVersion: 1.0\nRequires-Dist: termsel\n"
_ENTRY_POINTS = b"[console_scripts]\nfuzzed = fuzzed:main\n\n[termsel]\nfuzzed = fuzzed_plugin\n"
_MODULE = b'''"""A plugin."""
from termsel import Polynomial2D, hookimpl

class Fuzzed(Polynomial2D):
    """2-D polynomial."""
    name = "fuzzed"

@hookimpl
def termsel_models():
    return [Fuzzed]
'''


@cache
def _study_files() -> dict[str, bytes]:
    """Return journal and plan of a study, by name."""
    with TemporaryDirectory() as folder:
        termsel.compare(problems=["poly-terms"], solvers=["random", "nsga2"], seeds=2, out=folder,
                        title="Two", budget={"evaluations": 60},
                        options={"degree": 2, "polish": False})
        return {name: (Path(folder) / name).read_bytes() for name in (JOURNAL, PLAN)}


@cache
def _pictures() -> dict[str, bytes]:
    """Return an image, the map of its place, and lines on it, by name."""
    from rasterio.transform import from_origin

    rng = np.random.default_rng(5)
    pixels = np.kron(rng.integers(0, 255, (20, 20)), np.ones((6, 6))).astype(np.uint8)[None]
    ways = {"type": "FeatureCollection", "crs": {
        "type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32639"}}, "features": [
        {"type": "Feature", "properties": {"id": i}, "geometry": {"type": "LineString",
         "coordinates": [[500000 + 6 * i, 4000000], [500000 + 7 * i, 3999880]]}}
        for i in range(1, 16)]}
    start = "# crs: EPSG:32639\nid,line,sample,x,y,z\n" + "".join(
        f"S{i},{line},{sample},{500000.5 + sample},{3999999.5 - line},0\n"
        for i, (line, sample) in enumerate([(0, 0), (0, 110), (110, 0), (110, 110), (60, 40)]))
    return {"image.tif": tiff_bytes(pixels),
            "map.tif": tiff_bytes(pixels, crs="EPSG:32639",
                                  transform=from_origin(5e5, 4e6, 1, 1)),
            "ways.geojson": json.dumps(ways).encode(), "start.csv": start.encode()}


def surfaces(points: bytes) -> tuple[Seed, ...]:
    """Return a valid file of each of studies, pages, matching and plugins."""
    study, pictures = _study_files(), _pictures()
    plugin = {"METADATA": _METADATA, "entry_points.txt": _ENTRY_POINTS,
              "fuzzed_plugin.py": _MODULE}
    result = result_files()

    def others(files: dict[str, bytes], name: str) -> tuple[tuple[str, bytes], ...]:
        return tuple(item for item in files.items() if item[0] != name)

    return (
        Seed("study.toml", _STUDY.encode(), "study", (("points.csv", points),)),
        *(Seed(name, study[name], "journal", others(study, name)) for name in study),
        *(Seed("result.json", result["result.json"], use, others(result, "result.json"))
          for use in ("report", "plot")),
        *(Seed(name, pictures[name], "match", others(pictures, name)) for name in pictures),
        *(Seed(name, plugin[name], "plugin", others(plugin, name)) for name in plugin),
        *((Seed("session.jsonl", _session(), "session"),) if find_spec("termsel_app") else ()))


def _session() -> bytes:
    """Return the journal of a session of `termsel app`: its files, changes, undo and redo."""
    header = {"schema": "termsel-app-1", "image": None, "maps": [], "points": None, "lines": None,
              "rpc": None, "dem": None, "crs": "EPSG:32639", "size": [5000, 5000]}
    point = {"id": "P01", "kind": "point", "role": "", "image": [10.5, 20.25], "ground": None}
    whole = {**point, "role": "control", "ground": [270000.0, 3853000.0, None]}
    line = {"id": "L01", "kind": "line", "role": "", "image": [[1.0, 2.0], [3.0, 4.0]],
            "ground": [[270000.0, 3853000.0, 1.5], [270100.0, 3853100.0, None]]}
    entries = [header, {"change": [[None, point]]}, {"change": [[point, whole]]},
               {"change": [[None, line]]}, {"undo": True}, {"redo": True},
               {"change": [[whole, {**whole, "id": "new name"}]]}]
    return "".join(json.dumps(entry) + "\n" for entry in entries).encode()


def _study(path: Path, random: Random) -> int:
    """Plan a study; what it asks for may take days."""
    plan_cells(*requested_study(path, {}))
    return 0


def _journal(path: Path, random: Random) -> int:
    """Read a study, and write its tables and its page."""
    if path.name == JOURNAL and random.random() < 0.7:
        lines = []
        for line in path.read_bytes().splitlines(keepends=True):
            try:
                lines.append(sealed_line(json.loads(line)["record"]))
            except (ValueError, RecursionError, TypeError, KeyError):
                lines.append(line)
        again = path.parent / "again"
        again.mkdir()
        (again / PLAN).write_bytes((path.parent / PLAN).read_bytes())
        (again / JOURNAL).write_bytes(b"".join(lines))
        path = again / JOURNAL
    try:
        study = termsel.read_study(path.parent)
        study_progress(path.parent)
        study_as_markdown(study)
        study_as_latex(study)
        if random.random() < 0.3:
            report(study)
    finally:
        if path.parent.name == "again":
            for file in path.parent.iterdir():
                file.unlink()
            path.parent.rmdir()
    return 0


def _report(path: Path, random: Random) -> int:
    """Write the page of a result."""
    from tests.fuzz.cases import command

    with TemporaryDirectory() as folder:
        return command("report", path.parent, "-o", Path(folder) / "a.html")


def _plot(path: Path, random: Random) -> int:
    """Draw a result."""
    from tests.fuzz.cases import command

    with TemporaryDirectory() as folder:
        return command("plot", path.parent, random.choice((
            "residuals", "worst", "ground", "baselines", "terms")), "-o", Path(folder) / "a.svg")


def _match(path: Path, random: Random) -> int:
    """Match an image with a map or with lines; without a start, or from points."""
    from tests.fuzz.cases import command

    folder = path.parent
    lines = path.name == "ways.geojson" or random.random() < 0.3
    at = folder / "start.csv" if lines or path.name == "start.csv" else "none"
    with TemporaryDirectory() as name:
        out = ("-o", Path(name) / "a.csv", "--quiet", "--start", at)
        return command(
            "match-lines", folder / "image.tif", "--vectors", folder / "ways.geojson", *out
            ) if lines else command(
                "match-points", folder / "image.tif", "--reference", folder / "map.tif", *out,
                "--count", 12)


def _plugin(path: Path, random: Random) -> int:
    """Load a distribution, and ask it for what it has."""
    source = path.parent
    with TemporaryDirectory() as name:
        made = Path(name) / "fuzzed_plugin-1.0.dist-info"
        made.mkdir()
        for file in ("METADATA", "entry_points.txt"):
            (made / file).write_bytes((source / file).read_bytes())
        (Path(name) / "fuzzed_plugin.py").write_bytes((source / "fuzzed_plugin.py").read_bytes())
        known, modules, environ = list(sys.path), set(sys.modules), dict(os.environ)
        # The other plugins stand outside, as each case would ask them all again.
        sys.path[:] = [name, *(path for path in known if not path.endswith("site-packages"))]
        try:
            with redirect_stdout(io.StringIO()):
                registry = Registry()
                found = [fault for kind in KINDS for fault in registry.failures(kind)]
                known_models = registry.names("models")
        finally:
            sys.path[:] = known
            for module in set(sys.modules) - modules:
                if module.startswith("fuzzed"):
                    del sys.modules[module]
            os.environ.clear()
            os.environ.update(environ)
    assert "poly2d" in known_models
    texts = [str(fault) for fault in found]
    assert texts == list(map(make_printable, texts)), texts
    return 0


def _opened_session(path: Path, random: Random) -> int:
    """Open the session of a stranger; the process that judges its control has tests of its own."""
    from termsel_app import command, session

    worker, session.Worker = session.Worker, lambda *_: SimpleNamespace(
        ask=lambda _: None, close=lambda: None)
    try:
        given, folder = command.files_of_session(session.Files(str(path.parent)), None)
        with session.open_session(given, folder) as made:
            json.dumps(made.state(), allow_nan=False)
    finally:
        session.Worker = worker
    return 0


USES: dict[str, Use] = {"session": _opened_session, "study": _study, "journal": _journal,
                        "report": _report, "plot": _plot, "match": _match, "plugin": _plugin}
