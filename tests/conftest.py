"""What all tests share."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import distributions
from itertools import count
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

HERE = Path(__file__).resolve()

_PLURAL_OF_ONE = re.compile(
    r"(?<![\d.,:=/-])(?<!of )(?<!to )(?<!than )\b1 (?:[a-z]+ ){0,2}?"
    r"(?:points|lines|images|photos|maps|sheets|features|terms|files|rows|columns|places|"
    r"positions|models|methods|evaluations|subsets|"
    r"selections|outliers|steps|seeds|runs|ties|cases)\b(?! of)")
"""A plural after the number 1, as in "1 check points"; not "1 of 2 points"."""


@pytest.fixture(autouse=True)
def _no_plural_of_one() -> Iterator[None]:
    """Fail where a command prints the number 1 with a plural: `count_in_words` writes both."""
    # Not by the fixture monkeypatch, which keeps runs from sharing what they found of features.
    if "termsel.cli.messages" not in sys.modules:
        yield
        return
    messages = sys.modules["termsel.cli.messages"]
    plain = messages.make_printable
    found: list[str] = []

    def looked_at(text: str, *further: Any, **named: Any) -> str:
        found.extend(match[0] for match in _PLURAL_OF_ONE.finditer(text))
        return plain(text, *further, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(messages, "make_printable", looked_at)
        yield
    assert not found, f"printed: {found}"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let time pass by a millisecond whenever termsel looks, however busy the machine is."""
    looks = count()
    monkeypatch.setattr(time, "perf_counter", lambda: next(looks) / 1000)


@pytest.fixture(scope="module")
def bounds_of_few() -> Iterator[None]:
    """Decide few subsets by bounds, too, which are for many."""
    from termsel.selection.best_subsets import score_systems  # only now, as it imports numpy

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(score_systems, "WALKED", 0)
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real data that are not part of the project; tests that need them are skipped without."""
    folder = Path(os.environ.get("TERMSEL_DATA", HERE.parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real data are not here; set TERMSEL_DATA to their folder")
    return folder


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that installs a plugin package in a folder of its own."""
    monkeypatch.syspath_prepend(tmp_path)

    def package(distribution: str, code: str, name: str | None = None,
                version: str = "1.0") -> None:
        module = distribution.replace("-", "_")
        monkeypatch.delitem(sys.modules, module, raising=False)
        (tmp_path / f"{module}.py").write_text(dedent(code))
        info = tmp_path / f"{module}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(
            f"[termsel]\n{name or module} = {module}\n")

    return package


@pytest.fixture
def registry(tmp_path: Path) -> Callable[[], Any]:
    """Return a function that makes a registry of what was installed."""
    from termsel.plugins.registry import Registry  # only now, as it imports numpy

    return lambda: Registry(
        [point for found in distributions(path=[str(tmp_path)]) for point in found.entry_points])


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Return a function that makes one package the only plugin of this process, for a while."""
    from termsel.plugins.registry import registry as of_process

    def restrict(distribution: str) -> None:
        monkeypatch.setenv("TERMSEL_PLUGINS", distribution)
        of_process.cache_clear()

    yield restrict
    of_process.cache_clear()
