"""The benchmark on the workers of a dask scheduler, and published results that are repeated."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("termsel_bench", reason="termsel-bench is not installed: "
                    "pip install -e plugins/termsel-bench")

from termsel import TermselError
from termsel_bench.methods.base import Method
from termsel_bench.protocol import score_all
from termsel_bench.submitted import check, read_submitted


@pytest.mark.slow
def test_workers_of_a_scheduler_give_the_scores_of_this_process() -> None:
    distributed = pytest.importorskip("distributed")
    methods = [Method("model", "affine"), Method("peer", "gdal-polynomial")]
    names = ["frame-1", "old-map-1"]
    alone = list(score_all(methods, names))
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False,
                                  dashboard_address=None) as cluster:
        shared = list(score_all(methods, names, scheduler=cluster.scheduler_address))
    assert [(one.set_name, one.method, one.rmse, one.low, one.high) for one in shared] == \
        [(one.set_name, one.method, one.rmse, one.low, one.high) for one in alone]
    assert all(one.rmse > 0 for one in shared)


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_named() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(TermselError, match="does not answer"):
        list(score_all([Method("model", "affine")], ["frame-1"], scheduler="tcp://127.0.0.1:1"))


@pytest.mark.slow_cases("auto.json")
@pytest.mark.parametrize("name", ["gdal-polynomial.json", "gdal-tps.json", "auto.json"])
def test_published_results_are_confirmed_by_recomputation(name: str) -> None:
    folder = Path(__file__).parents[1] / "results"
    (one,) = [found for found in read_submitted(folder) if found.path.name == name]
    if name.startswith("gdal"):
        pytest.importorskip("rasterio")
    checked = check(one, "frame-4")
    assert (checked.repeated, checked.refuted) == (1, ())
