"""A row of each evidence page that one run makes, compared with a fresh run."""

import re
from pathlib import Path

import numpy as np
import pytest

import termsel
from benchmarks import gap, normalisation
from benchmarks.new_points import scene
from benchmarks.papers import akhoundi

PAGES = Path(__file__).parents[2] / "docs" / "evidence"


def row(page, pattern):
    """Return the cells of the first row of a page that a pattern finds."""
    found = re.search(rf"^\| ({pattern}.*) \|$", (PAGES / f"{page}.md").read_text(), re.MULTILINE)
    assert found is not None, f"{page}.md has no row {pattern!r}"
    return found[1].split(" | ")


def test_the_optimum_depends_on_the_origin_as_the_page_says():
    for number, (way, factor, shift) in enumerate(normalisation.WAYS):
        if number not in (0, 3):
            continue
        found = normalisation.optimum("poly-terms", "poly2d", {"degree": 4, "hierarchy": False},
                                      None, factor, shift)
        said = row("normalisation", re.escape(way))[1].split(";")[0]
        assert found[0] == pytest.approx(float(said), abs=1e-4)


def test_the_optimum_of_the_rfm_has_the_figures_of_the_page():
    task = termsel.prepare("rfm-terms", features=scene())
    names = list(task.problem.decode(np.ones(task.problem.genome.size, dtype=bool)).terms)
    result = termsel.assess(termsel.GivenGenes(np.isin(names, gap.OPTIMUM.split())), task)
    said = (PAGES / "gap-to-optimum.md").read_text()
    assert f"**The least selection RMSE is {result.rmse['check'].total:.4f} px**" in said
    said_of_new = row("gap-to-optimum", "the optimum")[1].split()[0]
    assert said_of_new == f"{result.rmse['independent'].total:.3f}"


@pytest.mark.slow_cases("frame-4")
@pytest.mark.parametrize("name", ["agile-1", "frame-4"])
def test_a_set_of_the_open_benchmark_has_the_figure_of_the_page(name):
    pytest.importorskip("termsel_bench")
    from termsel_bench.methods.base import AUTO
    from termsel_bench.protocol import Work, score_work

    said = float(row("benchmark", name)[2].split()[0])
    assert score_work(Work(AUTO, name)).rmse == pytest.approx(said, rel=0.01)


@pytest.mark.slow
def test_the_standard_ga_of_akhoundi_has_the_figures_of_the_page():
    pytest.importorskip("termsel_optimisers")
    runs = [akhoundi.one_run(None, 200, seed) for seed in range(1, akhoundi.RUNS + 1)]
    good = [one for one in runs if one.check < akhoundi.FAILED]
    cells = row("paper-akhoundi", "200")
    assert len(runs) - len(good) == int(cells[11])
    assert np.mean([one.check for one in good]) == pytest.approx(float(cells[7]), abs=0.006)
    assert np.mean([one.converged for one in good]) == pytest.approx(float(cells[9]), abs=0.06)
