"""Files made to keep a pattern busy are read, or refused, in a time that grows with their size."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import termsel
from termsel.core.errors import TermselError
from termsel_formats.points.envi import EnviPoints

LIMIT = 10.0
"""Seconds of the processor, which other processes do not lengthen. Each file here takes a few
hundredths; patterns that try every length at every place took 20 s to minutes."""

ROW = "id,line,sample,x,y,z\nP1,1,2,3,4,5\n"


@pytest.mark.parametrize("text", [
    ";\n" * 24_000, ";" * 48_000 + "\n", "; ENVI" * 8_000 + "\n", "; ENVI Point" * 8_000 + "\n",
    ";" + "Image " * 8_000 + "\n", "; Image" + " " * 48_000 + "\n", " \n" * 24_000 + ";"])
def test_the_sniffer_of_envi(text: str) -> None:
    start = time.process_time()
    assert not EnviPoints().sniff(Path("x"), text.encode())
    assert time.process_time() - start < LIMIT


@pytest.mark.parametrize("text", [
    "a=(\n" * 100_000, "a=(" * 133_000, "a = (1,\n" * 50_000 + ")", "a=1;\n" * 100_000,
    "a" * 400_000, "\t" * 400_000, "a" + " " * 400_000, "a:\n" * 130_000])
def test_rpcs(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.RPB"
    path.write_text(text)
    start = time.process_time()
    with pytest.raises(TermselError):
        termsel.read_rpc(path)
    assert time.process_time() - start < LIMIT


@pytest.mark.parametrize("text", [
    "# crs:" + " " * 60_000 + "\n" + ROW, "#" + " " * 60_000 + "\n" + ROW,
    "# crs" + " " * 60_000 + "\n" + ROW, "# crs:" + " \v" * 30_000 + "\n" + ROW,
    "; projection info = {" * 20_000 + "\n1 2 3 4\n"])
def test_tables(text: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    form = "envi-pts" if text.startswith(";") else "points-csv"
    start = time.process_time()
    assert len(termsel.read(path, crs="local", format=form).points) == 1
    assert time.process_time() - start < LIMIT


def test_a_crs_with_blanks_around_it_is_declared(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("#  CRS =   EPSG:4326  \n" + ROW)
    assert termsel.read(path).crs == "EPSG:4326"
