"""Runs in tests share what they found of features, which spares a fifth of the time of all."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from termsel.auto.memory import Memory

DATA = {"points": [1, 2, 3]}


def times_found(question: str) -> int:
    """Return how often two runs look for the answer to a question on equal features."""
    found: list[str] = []
    for data in (DATA, dict(DATA)):
        Memory().recall(question, data, lambda: found.append(question))
    return len(found)


def test_another_run_takes_what_was_found() -> None:
    assert times_found("of any test") == 1


def test_variables_and_folders_change_nothing_of_it(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ANY", "1")
    monkeypatch.chdir(tmp_path)
    assert times_found("with variables") == 1


def test_a_test_that_replaces_code_finds_everything_itself(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", time.sleep)
    assert times_found("with other code") == 2
