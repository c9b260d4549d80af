"""Captions state the figures of their pictures, and those of one picture state the same."""

from __future__ import annotations

import importlib
import re
import shutil
from collections import defaultdict
from pathlib import Path

import pytest

import termsel

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PICTURE = re.compile(
    r"(?:^```{image} \S*?|^!\[[^]]*\]\(\S*?)_static/([\w.-]+).*?^\*(?!\*)(.+?)(?<!\*)\*$",
    re.MULTILINE | re.DOTALL)
FIGURES = {"points": r"\b(\d+)\s+(?:control\s+)?points\b", "corners": r"\ball\s+(\d+)\s+corners",
           "largest": r"at\s+most\s+([\d.]+)\s+px", "rms": r"([\d.]+)\s+px\s+RMS"}


def captions() -> dict[str, list[tuple[Path, str]]]:
    """Return the captions of each picture, with their pages."""
    found = defaultdict(list)
    for page in PAGES:
        for picture, caption in PICTURE.findall(page.read_text(encoding="utf-8")):
            found[picture].append((page, caption))
    return found


def stated(caption: str) -> dict[str, str]:
    """Return the figures that a caption states, by their kind."""
    matches = {kind: re.search(pattern, caption, re.IGNORECASE)
               for kind, pattern in FIGURES.items()}
    return {kind: match[1] for kind, match in matches.items() if match}


def test_captions_of_one_picture_state_the_same_figures() -> None:
    several = {picture: found for picture, found in captions().items() if len(found) > 1}
    assert "rectified.png" in several
    for picture, found in several.items():
        figures: dict[str, str] = {}
        for page, caption in found:
            for kind, value in stated(caption).items():
                assert figures.setdefault(kind, value) == value, f"{picture} on {page.name}: {kind}"


def test_sizes_of_blunders_in_pictures_are_explained_on_their_pages() -> None:
    gallery = ROOT / "docs" / "how-to" / "gallery"
    shown = 0
    for page in gallery.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for picture in re.findall(r"{image} (pictures/\S+)", text):
            drawn = (gallery / picture).read_text(encoding="utf-8")
            for size in re.findall(r">([\d.]+ px), [a-z ]*blunder<", drawn):
                assert size in text, f"{picture} shows {size}, {page.name} does not"
                shown += 1
    assert shown


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_captions_state_what_the_tutorial_computes(
        example_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rasterio")
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "tutorial"))
    folder = shutil.copytree(example_files, tmp_path / "files")
    computed = importlib.import_module("rectified").rectified(folder).figures
    for page, caption in captions()["rectified.png"]:
        for kind, value in stated(caption).items():
            assert computed[kind] == value, f"{page.name}: {kind}"


@pytest.mark.slow
def test_captions_of_the_strategy_auto_state_what_runs_compute(example_files: Path) -> None:
    found = {picture: caption for picture, pages in captions().items() for _, caption in pages}
    result = termsel.run(features=termsel.read(example_files / "points.csv"))
    fitted = sum(residual.role != "independent" for residual in result.residuals)
    assert f"The candidates for the {fitted} points of `points.csv`" in " ".join(
        found["auto-candidates.svg"].split())
    assert result.strategy.chosen == "regularised-cubic"
    assert "The regularised cubic polynomial was chosen" in " ".join(
        found["auto-candidates.svg"].split())
    image = termsel.run(features=termsel.read(example_files / "images" / "image-3.csv"))
    assert [outlier.excluded for outlier in image.outliers] == [True]
    assert "The test named the point with the red ring" in " ".join(
        found["auto-outliers.svg"].split())
