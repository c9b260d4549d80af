"""In folders of results nothing follows a link; only a name that the user types is followed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import termsel
from termsel import TermselError
from termsel.plugins.registry import registry
from tests.attacks.files import image

POINTS = "id,line,sample,x,y,z\n" + "".join(
    f"P{i},{(i * 37) % 50},{(i * 23) % 50},{(i * 23) % 50 / 100},{-((i * 37) % 50) / 100},0\n"
    for i in range(30))
STUDY = """problems = ["poly-terms"]
solvers = ["random"]
models = [{name = "poly2d", degree = 1}]
seeds = 1
[[data]]
points = "points.csv"
crs = "local"
[budget]
evaluations = 20
"""
NAMES = (".lock", "points.csv", "lines.csv", "residuals.csv", "summary.txt", "result.json",
         "certificate.json", ".termsel-pending", ".termsel-pending/points.csv", "deeper/a.csv")
OF_STUDIES = (".lock", "journal.jsonl", "plan.json", "study.csv", "study.parquet", "summary.md",
              "summary.tex", "report.html", "images", "images/a", "figures", "ioh", "figures/a.svg")


@pytest.fixture
def control(folder: Path) -> Path:
    (folder / "points.csv").write_text(POINTS)
    (folder / "study.toml").write_text(STUDY)
    return folder / "points.csv"


def linked(folder: Path, name: str, target: Path) -> Path:
    """Make a folder with a link in it."""
    place = folder / "out" / name
    place.parent.mkdir(parents=True)
    place.symlink_to(target)
    return folder / "out"


@pytest.mark.parametrize("target", ["kept.txt", "made.txt", "empty"])
@pytest.mark.parametrize("name", NAMES)
def test_results(name: str, target: str, control: Path, folder: Path, victim: Path) -> None:
    out = linked(folder, name, victim / target)
    with pytest.raises(TermselError, match=r"this is a link|replace this file|cannot write"):
        termsel.run("poly-terms", features=termsel.read(control, crs="local"), out=out,
                    options={"degree": 1}, evaluations=20, overwrite=True)


@pytest.mark.parametrize("name", OF_STUDIES)
def test_studies(name: str, control: Path, folder: Path, victim: Path) -> None:
    for number, target in enumerate(("kept.txt", "made.txt", "empty")):
        place = folder / str(number)
        place.mkdir()
        out = linked(place, name, victim / target)
        with pytest.raises(TermselError, match=r"this is a link|no journal of a study"):
            termsel.compare("study.toml", out=out)


def test_a_block(folder: Path, victim: Path, call) -> None:
    pytest.importorskip("termsel_block")
    assert call("block-example", "made", "--images", 3).exit_code == 0
    for number, name in enumerate((".lock", "block.json", "ties.csv", "summary.txt", "report.html",
                                   "a/points.csv")):
        place = folder / str(number)
        place.mkdir()
        out = linked(place, name, victim / "made.txt")
        done = call("block", "made/block.toml", "--out", out, "--overwrite")
        assert done.exit_code == 2
        assert "link" in done.stderr


def test_what_is_pending(control: Path, folder: Path, victim: Path) -> None:
    """Only the names of a result are taken from there."""
    pending = folder / "out" / ".termsel-pending"
    pending.mkdir(parents=True)
    (pending / "notes.md").write_text("from a stranger")
    (folder / "out" / "notes.md").write_text("mine")
    with pytest.raises(TermselError, match="not part of a result"):
        termsel.run("poly-terms", features=termsel.read(control, crs="local"), out=folder / "out",
                    options={"degree": 1}, evaluations=20)
    assert (folder / "out" / "notes.md").read_text() == "mine"


@pytest.mark.parametrize("name", ["result.json", "points.csv"])
def test_results_that_are_read(name: str, made_result: Path, folder: Path, victim: Path) -> None:
    (folder / "r").mkdir()
    for file in made_result.iterdir():
        (folder / "r" / file.name).write_bytes(file.read_bytes())
    (folder / "r" / name).unlink()
    (folder / "r" / name).symlink_to(made_result / name)
    with pytest.raises(TermselError, match="this is a link"):
        termsel.read_result(folder / "r")


def test_studies_that_are_read(folder: Path, victim: Path, call) -> None:
    for name in ("journal.jsonl", "plan.json", ".lock"):
        out = linked(folder / name, name, victim / "kept.txt")
        (out / "plan.json").touch()
        assert call("compare", "--status", out).exit_code == 2


def test_names_that_the_user_types_are_followed(control: Path, folder: Path, call) -> None:
    (folder / "elsewhere").mkdir()
    (folder / "out").symlink_to("elsewhere")
    (folder / "link.csv").symlink_to("points.csv")
    (folder / "page.html").symlink_to("elsewhere/page.html")
    done = call("run", "--problem", "poly-terms", "--points", "link.csv", "--crs", "local",
                "--set", "degree=1", "--evaluations", 20, "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert (folder / "elsewhere" / "result.json").is_file()
    assert call("report", "out", "-o", "page.html").exit_code == 0
    assert (folder / "elsewhere" / "page.html").is_file()


@pytest.mark.slow_cases("journal.jsonl", "points.csv")
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes by name")
@pytest.mark.parametrize("name", [".lock", "journal.jsonl", "result.json", "points.csv"])
def test_pipes(name: str, control: Path, folder: Path, typed) -> None:
    (folder / "out").mkdir()
    os.mkfifo(folder / "out" / name)
    done = typed("run", "--problem", "poly-terms", "--points", control, "--crs", "local",
                 "--set", "degree=1", "--evaluations", 20, "--out", "out", "--overwrite")
    assert done.returncode == 2
    assert typed("report", "out", "-o", "a.html").returncode == 2


def test_hidden_folders_of_a_project_are_left_alone(control: Path, folder: Path) -> None:
    # A virtual environment has links; results go next to it.
    project = folder / "project"
    environment = project / ".venv" / "bin"
    environment.mkdir(parents=True)
    (environment / "python").symlink_to("/usr/bin/python3")
    features = termsel.read(control, crs="local")
    termsel.run("poly-terms", features=features, model="affine", solver="all-terms", out=project)
    assert (project / "result.json").is_file()


def test_outputs_whose_names_nobody_typed(made_result: Path, folder: Path, victim: Path,
                                          call) -> None:
    """Of the page of a result, of a second file, of a table by default, of a session."""
    (folder / "r").mkdir()
    for file in made_result.iterdir():
        (folder / "r" / file.name).write_bytes(file.read_bytes())
    (folder / "r" / "report.html").symlink_to(victim / "made.html")
    assert "this is a link" in call("report", "r").stderr
    assert "this is a link" in call("report", "r", "--overwrite").stderr
    if "micmac-xml" in registry().names("writers"):
        (folder / "a-S2D.xml").symlink_to(victim / "made-too.xml")
        (folder / "a-S3D.xml").symlink_to(victim / "made.xml")
        done = call("export", "r", "--to", "micmac-xml", "--output", "a-S2D.xml")
        assert "this is a link" in done.stderr


def test_tables_of_matching_by_default(folder: Path, victim: Path, call) -> None:
    pytest.importorskip("termsel_match")
    pytest.importorskip("rasterio")
    image(folder / "a.tif")
    (folder / "candidates.csv").symlink_to(victim / "made.csv")
    (folder / "lines.csv").symlink_to(victim / "made.csv")
    (folder / "roads.geojson").write_text("{}")
    for words in (("match-points", "a.tif", "--reference", "a.tif"),
                  ("match-lines", "a.tif", "--vectors", "roads.geojson")):
        assert "this is a link" in call(*words).stderr
