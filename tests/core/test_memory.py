"""What features say is found once, for all runs on them in one process; freed memory is kept."""

from __future__ import annotations

import platform
import subprocess
import sys
from dataclasses import replace
from typing import Any

import pytest

import termsel
from termsel.auto import memory
from termsel.auto.blunders import find_blunders
from termsel.auto.memory import remembered
from termsel.auto.portfolio import Portfolio
from termsel.core.errors import TermselError
from termsel.data.control import Control
from termsel.data.features import FeatureSet


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> FeatureSet:
    monkeypatch.setattr(memory, "_known", {})
    return termsel.simulate_scene("spot-isfahan", n_lines=0)


def again(features: FeatureSet, shift: float = 0.0) -> Control:
    """Return other features with the same values, or with other ones."""
    points = features.points
    return Control.of(features.with_(points=replace(points, image=points.image + shift)))


def test_equal_features_with_equal_candidates_are_looked_at_once(scene: FeatureSet) -> None:
    calls = []

    def found(what: str, control: Control, portfolio: Portfolio) -> int:
        return remembered(what, control, portfolio, lambda: calls.append(what) or len(calls))

    assert [found("this", again(scene), Portfolio()) for _ in range(2)] == [1, 1]
    assert found("that", again(scene), Portfolio()) == 2
    assert found("this", again(scene, 1e-9), Portfolio()) == 3
    assert found("this", again(scene), Portfolio(Portfolio().candidates[1:])) == 4
    assert found("this", replace(again(scene), heights=False), Portfolio()) == 5
    assert found("this", again(scene), Portfolio()) == 1


def test_where_a_candidate_failed_it_is_asked_again(scene: FeatureSet) -> None:
    """What it lacked, as a file, may be there by now."""
    calls: list[int] = []
    for _ in range(2):
        portfolio = Portfolio()

        def fail(portfolio: Portfolio = portfolio) -> None:
            calls.append(1)
            portfolio.faults["affine"] = TermselError("it failed")

        remembered("this", again(scene), portfolio, fail)
    assert calls == [1, 1]


def test_nobody_changes_what_is_remembered(scene: FeatureSet) -> None:
    suspects = find_blunders(again(scene))
    with pytest.raises(ValueError, match="read-only"):
        suspects.blunders[:] = True
    assert not find_blunders(again(scene)).blunders.any()


def test_the_last_used_are_kept(scene: FeatureSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "KEPT", 5)
    calls: list[int] = []
    for i in (0, *range(memory.KEPT), 0, memory.KEPT, 0, 1):
        remembered(i, again(scene), Portfolio(), lambda i=i: calls.append(i))
    assert calls == [*range(memory.KEPT + 1), 1]


def test_what_cannot_be_compared_is_looked_at_every_time(scene: FeatureSet) -> None:
    known: Any = type("Local", (), {})()
    calls: list[int] = []
    for _ in range(2):
        remembered("this", Control.of(replace(scene, rpc=known)), Portfolio(),
                   lambda: calls.append(1))
    assert calls == [1, 1]


def test_another_run_on_the_same_features_tells_as_much(scene: FeatureSet) -> None:
    told: list[list[Any]] = [[], []]
    runs = [termsel.run("poly-terms", features=scene, strategy="auto",
                        observers=[lambda seen, of=of: of.append((seen.evaluations, seen.share))])
            for of in told]
    assert told[0] == told[1]
    assert len(told[0]) > 20
    same = [{key: one for key, one in run.to_dict().items() if key not in ("seconds", "checksum")}
            for run in runs]
    assert same[0] == same[1]


FREED = """
import resource
import numpy as np
import termsel

points = termsel.simulate_scene("ikonos-hamedan", roles=(6, 0, 0), n_lines=0)
termsel.run(features=points)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(25):
    [np.ones(1 << 17) for _ in range(4)]
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries differ")
def test_memory_that_a_run_frees_is_used_again() -> None:
    """Where the system takes it back, each of 256 pages is a fault for each of 100 arrays."""
    done = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 100 * 256 / 4
