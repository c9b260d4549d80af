"""The command that makes every evidence page: it resumes, and says what made each."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.kept import resumed
from benchmarks.pages import BY_HAND, PAGES, make
from benchmarks.sets import ROOT


def test_pages_are_made_once_a_commit_and_after_an_interruption(tmp_path: Path) -> None:
    state = tmp_path / "made-by.json"
    ran: list[str] = []

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


def test_a_page_that_resumes_keeps_its_cases_by_commit(tmp_path: Path) -> None:
    ran: list[list[str]] = []
    make(["few-points"], "abc1234", tmp_path / "made-by.json", ran.append)
    assert "build/evidence/few-points-abc1234.jsonl" in ran[0]


def test_cases_that_are_kept_are_not_made_again(tmp_path: Path) -> None:
    file, jobs = tmp_path / "new" / "kept.jsonl", [(2.0, 3.0), (4.0, 0.5)]
    assert resumed(pow, jobs[:1], 1, file) == [8.0]
    with file.open("a") as kept:  # a run that was stopped while it wrote
        kept.write('[[4.0, 0.')
    assert resumed(pow, jobs, 1, file) == [8.0, 2.0]
    file.write_text(file.read_text().replace("8.0]", "9.0]"))
    assert resumed(pow, jobs[::-1], 1, file) == [2.0, 9.0]
    assert resumed(pow, jobs, 1, None) == [8.0, 2.0]


@pytest.mark.parametrize("page", PAGES)
def test_each_page_has_its_script(page: str) -> None:
    assert (ROOT / "docs" / "evidence" / f"{page}.md").is_file()
    assert (ROOT / "benchmarks" / f"{PAGES[page][0]}.py").is_file()


def test_every_page_is_made_or_said_to_be_made_by_hand() -> None:
    pages = [page.stem for page in (ROOT / "docs" / "evidence").glob("*.md")]
    assert sorted(pages) == sorted([*PAGES, *BY_HAND])
