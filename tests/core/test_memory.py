"""What features say is found once, for all runs on them in one process; freed memory is kept."""

from __future__ import annotations

import platform
import subprocess
import sys
from dataclasses import replace
from typing import Any

import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.auto.blunders import find_blunders
from termsel.auto.memory import Memory
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData


@pytest.fixture
def scene() -> FeatureSet:
    return termsel.simulate_scene("spot-isfahan", n_lines=0)


def again(features: FeatureSet, shift: float = 0.0) -> FitData:
    """Return other features with the same values, or with other ones."""
    points = features.points
    return FitData.of(features.with_(points=replace(points, image=points.image + shift)))


def test_equal_features_with_equal_methods_are_looked_at_once(scene: FeatureSet) -> None:
    calls: list[str] = []
    memory = Memory(max_answers=20)

    def count_of(question: str, data: FitData, auto: Auto) -> Any:
        return auto.recall(question, data, lambda: calls.append(question) or len(calls))

    auto = Auto(memory=memory)
    assert [count_of("this", again(scene), auto) for _ in range(2)] == [1, 1]
    assert count_of("that", again(scene), auto) == 2
    assert count_of("this", again(scene, 1e-9), auto) == 3
    assert count_of("this", again(scene), Auto(methods=auto.methods[1:], memory=memory)) == 4
    assert count_of("this", replace(again(scene), heights=False), auto) == 5
    assert count_of("this", again(scene), Auto(memory=memory)) == 1
    assert count_of("this", again(scene), Auto(memory=Memory(max_answers=20))) == 6


def test_where_a_method_failed_it_is_asked_again(scene: FeatureSet) -> None:
    """What it lacked, as a file, may be there by now."""
    calls: list[int] = []
    memory = Memory(max_answers=20)
    for _ in range(2):
        auto = Auto(memory=memory)

        def fail(auto: Auto = auto) -> None:
            calls.append(1)
            auto.faults["affine"] = TermselError("it failed")

        auto.recall("this", again(scene), fail)
    assert calls == [1, 1]


def test_nobody_changes_what_is_remembered(scene: FeatureSet) -> None:
    auto = Auto()
    suspects = find_blunders(again(scene), auto)
    with pytest.raises(ValueError, match="read-only"):
        suspects.blunders[:] = True
    assert not find_blunders(again(scene), auto).blunders.any()


def test_the_last_used_are_kept(scene: FeatureSet) -> None:
    memory = Memory(max_answers=5)
    calls: list[int] = []
    for i in (0, *range(5), 0, 5, 0, 1):
        memory.recall(i, again(scene), lambda i=i: calls.append(i))
    assert calls == [*range(6), 1]


def test_what_cannot_be_compared_is_looked_at_every_time(scene: FeatureSet) -> None:
    known: Any = type("Local", (), {})()
    calls: list[int] = []
    memory = Memory(max_answers=20)
    for _ in range(2):
        memory.recall("this", FitData.of(replace(scene, rpc=known)), lambda: calls.append(1))
    assert calls == [1, 1]


def test_a_change_that_is_taken_back_is_answered_as_at_first_sight() -> None:
    """Moved, dropped and taken back: each state has the answer that it has by itself."""
    first = termsel.simulate_scene("ikonos-hamedan", seed=2, roles=(6, 0, 2), n_lines=0)
    image = first.points.image.copy()
    image[1] += 2.0
    moved = first.with_(points=replace(first.points, image=image))
    memory = Memory()
    answers = []
    for features in (first, moved, first):
        answer = termsel.run(features=features, memory=memory).to_dict()
        answers.append({key: part for key, part in answer.items() if key != "seconds"})
    alone = termsel.run(features=moved).to_dict()
    assert answers[0] == answers[2] != answers[1]
    assert answers[1] == {key: part for key, part in alone.items() if key != "seconds"}


def test_equal_features_are_fitted_once(scene: FeatureSet) -> None:
    memory = Memory()
    method = next(method for method in Auto().methods if method.name == "affine")
    fitted = memory.fit(method, again(scene))
    assert memory.fit(method, again(scene)) is fitted
    assert memory.fit(method, again(scene, 1e-9)) is not fitted


def test_another_run_on_the_same_features_tells_as_much(scene: FeatureSet) -> None:
    told: list[list[Any]] = [[], []]
    memory = Memory(max_answers=20)
    runs = [termsel.run("poly-terms", features=scene, strategy="auto", memory=memory,
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
