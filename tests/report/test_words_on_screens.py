"""What runs print and write has no left-out word, from whatever parts it is put together."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from termsel.cli.main import cli
from tests.lint.words import left_out_words

WRITTEN = ("*.txt", "*.html", "*.svg", "*.json", "*.csv")
RUNS = {
    "auto": ("--points", "gcps.csv"),
    "few": ("--points", "images/image-3.csv"),
    "rpc": ("--points", "gcps.csv", "--rpc", "vendor.RPB"),
    "exact": ("--problem", "poly-terms", "--solver", "exact"),
    "lines": ("--problem", "owdis-lines", "--generations", "3"),
    "objectives": ("--problem", "owdis-lines", "--solver", "nsga2", "--generations", "3"),
}


@pytest.mark.slow_cases("lines", "exact", "rpc")
@pytest.mark.parametrize("asked", RUNS.values(), ids=RUNS)
def test_no_left_out_word_is_shown(
        asked: tuple[str, ...], example_files: Path, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(example_files)
    out = tmp_path / "result"
    run = CliRunner().invoke(cli, ["run", *asked, "--verbose", "--report", "--out", str(out)])
    assert run.exit_code == 0, run.output
    texts = {"screen": run.stdout + run.stderr,
             **{path.name: path.read_text(encoding="utf-8")
                for pattern in WRITTEN for path in out.glob(pattern)}}
    assert {"summary.txt", "report.html", "result.json"} <= set(texts)
    for name, text in texts.items():
        # Of a page what people read, and its charts: neither programs nor styles.
        read = re.sub(r"<(script|style)>.*?</\1>", "", text, flags=re.DOTALL)
        assert list(left_out_words(Path(name), read)) == []
