"""The same data on every processor: embedded scenes are read, and examples have the same bytes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.simulate.kept import kept_features

OTHER = {"OPENBLAS_CORETYPE": "Prescott"}
"""Linear algebra as on another processor, where OpenBLAS has a choice."""


def _on_another(code: str, **more: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          env={**os.environ, **OTHER, **more})
    return done.stdout


def _sums() -> str:
    from termsel.plugins.registry import registry
    from termsel.results.result import checksum_of_features

    return "".join(f"{entry.name} {checksum_of_features(entry.object.load())}\n"
                   for entry in registry().entries("datasets"))


def test_data_sets_have_the_same_bits_on_another_processor() -> None:
    here = _sums()
    assert len(here.splitlines()) >= 5
    assert _on_another("from tests.project.test_processors import _sums; print(_sums(), end='')",
                       PYTHONPATH=str(Path(__file__).parents[2])) == here


@pytest.mark.parametrize("name", ["ikonos-hamedan", "spot-isfahan", "irs1c-mashad"])
def test_data_sets_that_are_kept_are_those_that_are_simulated(name: str) -> None:
    kept, computed = kept_features("termsel.simulate", name), termsel.simulate_scene(name)
    for one, other in ((kept.points, computed.points), (kept.lines, computed.lines)):
        assert one.ids == other.ids
        np.testing.assert_allclose(one.image, other.image, rtol=0, atol=1e-5)
        np.testing.assert_allclose(one.ground, other.ground, rtol=0, atol=1e-4)
    assert kept.points.roles == computed.points.roles
    assert (kept.crs, kept.image_size, kept.noise, kept.rpc) == (
        computed.crs, computed.image_size, computed.noise, computed.rpc)


def test_the_example_has_the_same_bytes_on_another_processor(
        tmp_path: Path, example_files: Path) -> None:
    pytest.importorskip("rasterio")
    _on_another("import sys; from pathlib import Path\n"
                "from termsel.io.example import write_example\n"
                f"write_example(Path({str(tmp_path / 'there')!r}))")
    there = tmp_path / "there"
    names = sorted(path.relative_to(there) for path in there.rglob("*.*"))
    assert len(names) > 20
    for name in names:
        assert (example_files / name).read_bytes() == (there / name).read_bytes(), name


@pytest.mark.slow
def test_a_study_goes_on_on_another_processor(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    study = tmp_path / "study.toml"
    study.write_text('problems = ["poly-terms", "rfm-terms", "owdis-lines"]\n'
                     'solvers = ["random"]\nbudget = {evaluations = 20}\n')
    _on_another(f"import termsel; termsel.compare({str(study)!r}, out={str(tmp_path / 'out')!r})")
    before = (tmp_path / "out" / "journal.jsonl").read_text().splitlines()
    termsel.compare(study, out=tmp_path / "out")
    assert (tmp_path / "out" / "journal.jsonl").read_text().splitlines() == before
    assert "run again" not in caplog.text
