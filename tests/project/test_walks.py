"""How far it is from what a user gives to what is done with it (`python -m tests.walks`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.walks import chromosome_to_fitness, model_to_fit, option_to_use, table_to_summary


@pytest.mark.slow
def test_walks_grow_no_longer(tmp_path: Path) -> None:
    option = option_to_use(tmp_path)
    assert len(option.functions) <= 60
    assert list(option.holders) == ["RunOptions", "GeneticAlgorithm"]
    assert len(chromosome_to_fitness().functions) <= 30
    assert len(model_to_fit().functions) <= 73
    table = table_to_summary(tmp_path)
    assert len(table.functions) <= 910
    assert len(table.modules) <= 122
