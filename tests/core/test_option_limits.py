"""Numbers of options have upper limits: a typing error ends with a message and takes no memory."""

from __future__ import annotations

import pytest

from termsel.core.options import Option
from termsel.plugins.registry import registry
from termsel.runs.request import DATA_OPTIONS


def declared() -> dict[str, Option]:
    """Return the options of everything that is built in, with its name."""
    found = {f"data {option.name}": option for option in DATA_OPTIONS}
    for kind in ("problems", "models", "solvers", "criteria", "readers", "writers"):
        for entry in registry().entries(kind):
            options = entry.object.options if kind == "problems" else entry.object.declared_options
            found |= {f"{entry.name} {option.name}": option for option in options}
    return found


def test_every_number_has_an_upper_limit() -> None:
    numbers = {name: option for name, option in declared().items() if option.type in (int, float)}
    assert len(numbers) > 50
    assert [name for name, option in numbers.items() if option.maximum is None] == []


@pytest.mark.parametrize("words", [
    ("--solver", "ga", "--set", "tournament=1e9"), ("--solver", "ga", "--set", "elite=1e18"),
    ("--solver", "nsga2", "--set", "population=1000000"),
    ("--solver", "swap", "--set", "starts=1e300"),
    ("--solver", "swap", "--set", "starts=" + "9" * 5000),
    ("--criterion", "kfold", "--set", "repeats=1e9"), ("--set", "split=1e300"),
    ("--set", "min_features=1e30"), ("--seed", "1e300"), ("--seed", "9" * 5000),
    ("--evaluations", "9" * 40), ("--seconds", "1e300"), ("--seconds", "nan"),
    ("--seconds", "inf"), ("--generations", "9" * 40)], ids=lambda words: " ".join(words)[:60])
def test_more_is_refused(words: tuple[str, ...], call) -> None:
    done = call("run", "--problem", "owdis-points", *words)
    assert done.exit_code == 2
    assert "bug" not in done.stderr
    assert len(done.stderr) < 3000


def test_repeats_of_stability(call) -> None:
    assert call("stability", "--problem", "rfm-terms", "--repeats", "1000000000").exit_code == 2
