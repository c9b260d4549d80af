"""A result that is killed while it is written, at every change of the file system."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import termsel
from termsel.io.result_folder import read_result, write_result
from termsel.testing import example_results

# The child of a fork dies before its n-th change; the parent then reads what is there.
SCRIPT = """
import os, signal, sys
from pathlib import Path
from termsel.io.result_folder import claim_folder, read_result, write_result
from termsel.testing import example_results

old, new = example_results()[:2]
known = {old.to_json(): "old", new.to_json(): "new"}
top, fresh = Path(sys.argv[1]), sys.argv[2] == "fresh"
CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree"}

def write_until(folder, n):
    count = 0
    def hook(event, arguments):
        nonlocal count
        if event in CHANGES or (event == "open" and arguments[1] not in (None, "r", "rb")):
            count += 1
            if count > n:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(hook)
    write_result(new, folder)
    os._exit(0)

n = 0
while True:
    folder = top / str(n)
    folder.mkdir()
    (folder / "mine.txt").write_text("of the user")
    if not fresh:
        write_result(old, folder)
    pid = os.fork()
    if not pid:
        write_until(folder, n)
    killed = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGKILL
    try:
        print(known[read_result(folder).to_json()])
    except Exception as error:
        print("nothing" if "there is no result here" in str(error) else f"{n}: {error}")
    claim_folder(folder)
    write_result(old, folder)
    assert read_result(folder).to_json() == old.to_json()
    names = {path.name for path in folder.iterdir()} - {"points.csv", "lines.csv"}
    assert names == {"mine.txt", "result.json", "residuals.csv", "summary.txt"}, names
    n += 1
    if not killed:
        break
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("state", ["fresh", "old"])
def test_a_kill_leaves_the_earlier_result_or_the_new_one(state: str, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path), state],
                          capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    found = done.stdout.split("\n")[:-1]
    before = "nothing" if state == "fresh" else "old"
    assert set(found) == {before, "new"}, found
    assert found == sorted(found, key=[before, "new"].index)
    assert len(found) > 20


def test_a_result_that_cannot_be_encoded_leaves_the_earlier_one(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = example_results()[:2]
    write_result(old, tmp_path)

    def fails(self: termsel.Result) -> str:
        raise UnicodeEncodeError("utf-8", "x", 0, 1, "surrogates")

    monkeypatch.setattr(termsel.Result, "to_json", fails)
    with pytest.raises(UnicodeEncodeError):
        write_result(new, tmp_path)
    monkeypatch.undo()
    assert read_result(tmp_path).to_json() == old.to_json()
    assert not list(tmp_path.glob(".*"))
