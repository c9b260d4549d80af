"""The command that makes every evidence page: it resumes, and says what made each."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.pages import PAGES, make
from benchmarks.sets import ROOT


def test_pages_are_made_once_a_commit_and_after_an_interruption(tmp_path: Path) -> None:
    state, ran = tmp_path / "made-by.json", []

    def runs(command: list[str]) -> None:
        if len(ran) == 1:
            ran.append("interrupted")
            raise KeyboardInterrupt
        ran.append(" ".join(command))

    wanted = ["normalisation", "plan"]
    with pytest.raises(KeyboardInterrupt):
        make(wanted, "abc1234", state, runs)
    assert list(json.loads(state.read_text())) == ["normalisation"]
    make(wanted, "abc1234", state, runs)
    assert ran == ["python -m benchmarks.normalisation --write", "interrupted",
                   "python -m benchmarks.plan --processes 2 --write"]
    made = json.loads(state.read_text())
    assert {one["commit"] for one in made.values()} == {"abc1234"}
    make(wanted, "def5678", state, runs)
    assert len(ran) == 5


@pytest.mark.parametrize("page", PAGES)
def test_each_page_has_its_script(page: str) -> None:
    assert (ROOT / "docs" / "evidence" / f"{page}.md").is_file()
    assert (ROOT / "benchmarks" / f"{PAGES[page][0]}.py").is_file()
