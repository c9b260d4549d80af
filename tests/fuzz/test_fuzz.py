"""Four hundred cases of the fuzz suite, and hypothesis where it can shrink what it finds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

if sys.platform != "linux":
    pytest.skip("limits memory as Linux does", allow_module_level=True)

import termsel
from termsel.core.errors import TermselError, make_printable
from termsel.core.options import Option
from tests.fuzz import cases
from tests.fuzz.mutate import NUMBERS, TEXTS, mutated

for name in ("rasterio", "pyogrio", "shapely", "altair", "vl_convert", "termsel_match"):
    pytest.importorskip(name)

ROOT = Path(__file__).parents[2]
CHUNK = 50


@pytest.mark.slow_cases("0", "2", "3")
@pytest.mark.parametrize("first", range(4))
def test_what_is_not_mutated_is_read(first: int) -> None:
    for seed in cases.seeds()[first::4]:
        cases.used_as_it_is(seed)


@pytest.mark.slow_cases("100", "150", "200", "250", "300", "350", "50")
@pytest.mark.parametrize("first", range(0, 400, CHUNK))
def test_mutated_files_and_hostile_options(first: int) -> None:
    found = [cases.run_case(seed) for seed in range(first, first + CHUNK)]
    assert [outcome for outcome in found if outcome.fault] == []


@pytest.mark.slow
@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_tables_of_any_cells(data: st.DataObject) -> None:
    cell = st.sampled_from([*NUMBERS, *TEXTS]) | st.text(max_size=5) | st.floats().map(repr)
    rows = data.draw(st.lists(st.lists(cell, min_size=6, max_size=6), min_size=1, max_size=5))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        path.write_bytes(("id,line,sample,x,y,z\n" + "\n".join(map(",".join, rows))
                          ).encode("utf-8", "surrogatepass"))
        try:
            points = termsel.read(path, crs="local", format="points-csv").points
        except TermselError as error:
            assert make_printable(str(error)) == str(error)  # noqa: PT017 - both ends are right
            return
        termsel.write_points_csv(points, path)
        assert termsel.read(path, crs="local").points.ids == points.ids


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([*NUMBERS, *TEXTS]) | st.integers() | st.floats() | st.text() | st.booleans()
       | st.none(), st.sampled_from([int, float, bool, str]))
@example("9" * 5000, int)
def test_options_take_a_value_or_refuse_it(value: object, kind: type) -> None:
    option = Option("x", kind(1), "", kind, *((0, 10) if kind in (int, float) else ()))
    try:
        parsed = option.parse(value)
    except TermselError as error:
        assert len(str(error)) < 3000  # noqa: PT017 - both ends are right
    else:
        assert isinstance(parsed, kind)
        assert kind not in (int, float) or 0 <= parsed <= 10


@pytest.mark.slow_cases("1")
@pytest.mark.parametrize("number", range(2))
def test_whole_commands(number: int, tmp_path: Path) -> None:
    """A command in a process of its own, as the console shows it."""
    random = Random(number)
    seed = [seed for seed in cases.seeds() if seed.kind == "points"][number * 3]
    (tmp_path / seed.name).write_bytes(mutated(seed.content, random))
    done = subprocess.run(
        [sys.executable, "-m", "termsel", "run", "--problem", "poly-terms", "--points", seed.name,
         "--solver", "all-terms", "--set", "degree=1", "--out", "out"], cwd=tmp_path,
        capture_output=True, text=True, timeout=60, check=False, env={**os.environ})
    assert done.returncode in (0, 2), done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_at_fault_is_found(monkeypatch, tmp_path: Path) -> None:
    """The suite sees a fault, a lost file, and what takes too much time or memory."""
    def lose(path: Path, random: Random) -> int:
        path.unlink()
        return 0

    def endless(path: Path, random: Random) -> int:
        while True:
            pass

    def greedy(path: Path, random: Random) -> int:
        return len(bytearray(cases.MEMORY * 2))

    for seed in range(4):  # prepared with what is right
        cases.run_case(seed)
    monkeypatch.setattr(cases, "SECONDS", 0.2)
    for use, fault in ((lose, "changed or lost"), (endless, "more than 0.2 s"),
                       (greedy, "MemoryError"), (lambda *_: 1, "exit code 1"),
                       (lambda *_: 1 // 0, "ZeroDivisionError")):
        monkeypatch.setattr(cases, "USES", dict.fromkeys(cases.USES, use))
        assert any(fault in cases.run_case(seed).fault for seed in range(4)), fault


@pytest.mark.slow
def test_the_long_run_from_the_command_line() -> None:
    done = subprocess.run([sys.executable, "-m", "tests.fuzz", "--cases", "5", "--first", "5000"],
                          cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    kinds, sums = done.stdout.splitlines()
    assert sum(int(one.split()[1]) for one in kinds.split(", ")) == 5
    assert sums.startswith("5 cases in ")
