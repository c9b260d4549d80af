"""Whose turn it is to compile."""

from __future__ import annotations

import errno
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from termsel.core.errors import TermselError
from termsel.core.files import lock
from termsel.core.files.lock import end_turn, lock_folder, take_turn

numba = pytest.importorskip("numba")


def untypable(value: Any) -> Any:
    return value.nothing_has_this()


def waits(_seconds: float) -> None:
    raise AssertionError("it waits")


@pytest.mark.skipif(sys.platform == "win32", reason="locks of POSIX")
def test_where_nothing_can_be_locked_nobody_waits(tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(lock.fcntl, "flock", refuse)
    monkeypatch.setattr(time, "sleep", waits)
    assert take_turn(tmp_path / "kernel.lock", 60.0) is None
    with pytest.raises(TermselError, match="No locks available"), lock_folder(tmp_path):
        pass


def test_another_one_waits_until_the_turn_ends(tmp_path: Path,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    mine = take_turn(tmp_path / "kernel.lock", 60.0)
    assert mine is not None
    assert take_turn(tmp_path / "kernel.lock", 0.01) is None
    monkeypatch.setattr(time, "sleep", lambda _: end_turn(mine))
    other = take_turn(tmp_path / "kernel.lock", 60.0)
    assert other is not None
    end_turn(other)


def test_what_cannot_be_compiled_keeps_no_turn(tmp_path: Path,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    from termsel.adjustment.dispatchers import dispatcher_of

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    dispatcher = dispatcher_of(untypable, {})
    with pytest.raises(numba.TypingError):
        dispatcher(1.0)
    assert dispatcher._cache._turn is None
    assert not list(tmp_path.rglob("*.lock"))
