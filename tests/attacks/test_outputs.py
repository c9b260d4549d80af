"""No file names an output: neither a study, nor results of the benchmark, nor an option at all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli

pytest.importorskip("termsel_bench", reason="certificates come with termsel-bench")

KEPT = "This stays as it is.\n"


@pytest.fixture
def victim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "kept.txt"
    path.write_text(KEPT)
    return path


def _refused(victim: Path, *arguments: str) -> str:
    done = CliRunner().invoke(cli, list(arguments))
    assert done.exit_code == 2, done.output
    assert victim.read_text() == KEPT
    return done.output


@pytest.mark.parametrize("key", ["certificate", '"solver.certificate"'])
@pytest.mark.parametrize("value", ["FILE", "yes"])
def test_a_study_names_no_certificate(victim: Path, key: str, value: str) -> None:
    Path("study.toml").write_text(
        'problems = ["poly-terms"]\nsolvers = ["exact"]\n[options]\n'
        f'{key} = "{value.replace("FILE", victim.as_posix())}"\n[budget]\nevaluations = 100\n')
    for run in (["--dry-run"], ["--out", "out"]):
        text = _refused(victim, "compare", "study.toml", *run)
        assert "a file may not set the option 'certificate'" in text
    assert not Path("out").exists()


def test_results_of_the_benchmark_name_none(victim: Path) -> None:
    from termsel_bench.scenes.catalogue import frozen_checksums

    Path("results").mkdir()
    Path("results/x.json").write_text(json.dumps({
        "schema": "termsel-bench-1", "method": {
            "kind": "solver", "name": "exact", "problem": "poly-terms",
            "options": {"certificate": str(victim)}},
        "sets": {"frame-1": {"sha256": frozen_checksums()["frame-1.csv"], "rmse": 1.0}}}))
    assert "may not set the option 'certificate'" in _refused(victim, "bench", "--check", "results")


def test_what_is_typed_names_none_either(victim: Path) -> None:
    text = _refused(victim, "run", "--problem", "poly-terms", "--solver", "exact",
                    "--set", f"certificate={victim}", "--out", "out")
    assert "Accepted: true | false" in text


def test_a_certificate_is_checked_by_the_command_of_files(victim: Path) -> None:
    pytest.importorskip("termsel_formats")
    termsel.run("poly-terms", solver="exact", options={"certificate": True, "degree": 2},
                out="out")
    done = CliRunner().invoke(cli, ["check", "out/certificate.json"])
    assert done.exit_code == 0, done.output
    record = json.loads(Path("out/result.json").read_text())
    assert done.output.splitlines()[0].endswith(f"SHA-256 {record['data']['sha256']}:")
    file = Path("out/certificate.json")
    file.write_text(file.read_text().replace('"forced": []', '"forced": [0]', 1))
    done = CliRunner().invoke(cli, ["check", "out/certificate.json"])
    assert done.exit_code == 2
    assert "the checksum is not that of the content" in done.output
