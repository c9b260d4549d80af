"""The problem owdis-block: which control and which ties are enough."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")


from termsel import TermselError
from termsel.testing import invoke
from termsel_block.joint import adjust
from termsel_block.selecting import OwdisBlock, _with_selection, _without_check, select
from termsel_block.simulated import simulate_block

BLOCK = simulate_block(3, n_ties=60, rpcs=True, control=(6, 6), check=8, independent=20,
                       seed=2).block


@pytest.fixture(scope="module")
def problem() -> OwdisBlock:
    return OwdisBlock(BLOCK, tie_candidates=30, most=12)


def test_auto_of_all_are_the_adjustment_itself() -> None:
    """With every tie and point the linearised step is none."""
    whole = OwdisBlock(BLOCK, tie_candidates=1000)
    everything = np.ones((1, whole.genome.size), bool)
    errors = whole._check_target
    assert whole.evaluate(everything).objectives[0, 0] == pytest.approx(
        np.sqrt(2 * (errors**2).mean()), rel=0.02)


def test_a_selection_is_scored_as_its_own_adjustment(problem: OwdisBlock) -> None:
    genes = np.zeros(problem.genome.size, bool)
    genes[[0, 3, 7, 10, *range(12, 36, 2)]] = True
    names = problem.decode(genes).features
    control = {tuple(name.split(":")[1:]) for name in names if name.startswith("control")}
    result = adjust(_with_selection(_without_check(BLOCK), control,  # type: ignore[arg-type]
                                    {name[4:] for name in names if name.startswith("tie")}))
    squares = []
    for i, image in enumerate(BLOCK.images):
        assert image.features is not None
        points = image.features.points.take(
            [role == "check" for role in image.features.points.roles])
        squares.append(((points.image - result.project(i, points.ground)) ** 2).sum(axis=1))
    # Its variances are its own, those of the linearised one are of the whole block.
    assert problem.evaluate(genes[None]).objectives[0, 0] == pytest.approx(
        np.sqrt(np.concatenate(squares).mean()), rel=0.25)


@pytest.mark.parametrize("solver", ["ga", "ica"])
def test_solvers_find_a_selection_that_independent_points_confirm(solver: str) -> None:
    found = select(BLOCK, solver=solver, evaluations=1200, most=14, tie_candidates=30)
    assert len(found.control) + len(found.ties) <= 14
    assert found.independent is not None
    assert found.independent_of_all is not None
    assert found.check < found.check_of_all * 1.3
    assert found.independent < 2.5 * found.independent_of_all


def test_exact_proves_what_swaps_find() -> None:
    exact = select(BLOCK, solver="exact", most=2, tie_candidates=6)
    swaps = select(BLOCK, solver="swap", evaluations=300, most=2, tie_candidates=6)
    assert exact.search.certificate is not None
    assert exact.search.certificate["optimal"]
    assert exact.check == pytest.approx(swaps.check, rel=1e-9)


def test_independent_points_take_no_part_in_the_selection() -> None:
    images = []
    for image in BLOCK.images:
        assert image.features is not None
        points = image.features.points
        away = np.where(np.array(points.roles) == "independent", 500.0, 0.0)
        images.append(replace(image, features=replace(image.features, points=replace(
            points, image=points.image + away[:, None]))))
    first, second = (select(block, solver="swap", evaluations=150, most=6, tie_candidates=12)
                     for block in (BLOCK, replace(BLOCK, images=tuple(images))))
    assert (first.control, first.ties) == (second.control, second.ties)


def test_without_check_points_nothing_is_selected() -> None:
    with pytest.raises(TermselError, match="role check"):
        OwdisBlock(simulate_block(3, n_ties=30, rpcs=True, seed=2, independent=5).block)


def test_the_command_writes_a_table(tmp_path: Path) -> None:
    place, table = tmp_path / "place", tmp_path / "enough.csv"
    assert invoke("block-example", place, "--check", 6).exit_code == 0
    named = invoke("block-select", place / "block.toml", "-o", tmp_path / "enough.ods")
    assert "this file is written as CSV, not as .ods. Name it enough.csv." in named.stderr
    asked = ["block-select", str(place / "block.toml"), "-o", str(table), "--most", "10",
             "--candidates", "20", "--evaluations", "100"]
    done = invoke(*asked, "--json")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record["problem"] == "owdis-block"
    rows = table.read_text().splitlines()
    assert len(rows) == 1 + len(record["control"]) + len(record["ties"]) <= 11
    again = invoke(*asked)
    assert again.exit_code == 2
    assert "--overwrite" in again.output
    bad = invoke(*asked, "--overwrite", "--solver", "gaa")
    assert bad.exit_code == 2
    assert "gaa" in bad.output
    assert table.read_text().splitlines() == rows
