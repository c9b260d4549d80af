"""Output that cannot be written or shown: closed, full, or in a narrow encoding."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from termsel.io.result_folder import write_result
from termsel.testing import example_results

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs a shell of POSIX")

PROJECT = "project r --points t.csv"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("streams")
    (top / "r").mkdir()
    write_result(example_results()[0], top / "r")
    (top / "t.csv").write_text("id,x,y,z\nSüd,7.5,47.1,500\n", encoding="utf-8")
    return top


def shell(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["/bin/sh", "-c", command.replace("termsel", f"'{sys.executable}' -m termsel")],
        cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=False,
        encoding="utf-8", timeout=120)


STREAMS = {
    "full": ("termsel list models > /dev/full", 2, "cannot write to stdout: No space left"),
    "full, help": ("termsel --help > /dev/full", 2, "cannot write to stdout: No space left"),
    "full, table": (f"termsel {PROJECT} > /dev/full", 2, "cannot write to stdout: No space left"),
    "closed": ("termsel list models >&-", 2, "cannot write to stdout: Bad file descriptor"),
    "closed, nothing printed": (f"termsel {PROJECT} -o new.csv --overwrite >&- && grep Süd new.csv",
                                0, "Written: new.csv"),
    "stderr full": (f"termsel {PROJECT} -o new.csv --overwrite 2> /dev/full", 0, ""),
    "stderr full, refused": ("termsel list nothing 2> /dev/full", 2, ""),
    "all closed": ("termsel list models <&- >&- 2>&-", 2, ""),
    "reader gone": ("termsel list models | true", 0, ""),
}


@pytest.mark.slow_cases(
    "all closed", "closed", "closed, nothing printed", "full", "full, table", "reader gone",
    "stderr full")
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize(("command", "code", "message"), STREAMS.values(), ids=STREAMS)
def test_output_that_cannot_be_written(command: str, code: int, message: str, folder: Path,
                                       ) -> None:
    done = shell(command, folder)
    assert done.returncode == code, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.slow
def test_no_file_takes_the_place_of_a_closed_stream(folder: Path) -> None:
    done = shell(f"termsel {PROJECT} -o new.csv --overwrite <&- >&- 2>&-; cat new.csv", folder)
    assert done.stdout.startswith("# crs: EPSG:4979\nid,line,sample")
    assert len(done.stdout.splitlines()) == 3


ASCII = {"PYTHONIOENCODING": "ascii"}


@pytest.mark.slow
def test_text_that_stdout_cannot_show_is_escaped(folder: Path) -> None:
    (folder / "日.csv").write_bytes((folder / "r" / "points.csv").read_bytes())
    done = shell("termsel run --problem poly-terms --solver all-terms --set degree=1 "
                 "--points 日.csv --crs EPSG:4979", folder, PYTHONIOENCODING="latin-1")
    assert done.returncode == 0, done.stderr
    assert r"\u65e5.csv" in done.stdout


JSON = """
from termsel.__main__ import open_streams
from termsel.cli.tables import print_json
open_streams()
print_json({"id": "Süd"})
"""


@pytest.mark.parametrize(("encoding", "text"), [("utf-8", "Süd"), ("ascii", r"S\u00fcd")])
def test_json_is_json_in_any_encoding(encoding: str, text: str) -> None:
    done = subprocess.run([sys.executable, "-c", JSON], capture_output=True, check=True,
                          env={**os.environ, "PYTHONIOENCODING": encoding})
    assert text in done.stdout.decode()
    assert json.loads(done.stdout) == {"id": "Süd"}


@pytest.mark.slow
def test_a_table_is_not_changed_by_an_encoding(folder: Path) -> None:
    done = shell(f"termsel {PROJECT}", folder, **ASCII)
    assert done.returncode == 2
    assert not done.stdout
    assert "the encoding of stdout, ascii, does not have all characters" in done.stderr
    assert "Süd" in shell(f"termsel {PROJECT}", folder, PYTHONIOENCODING="utf-8").stdout
