"""No command replaces a file that it reads, or another without permission."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio

import termsel
from termsel.io.rectify import rectify
from termsel.io.replacing import require_replaceable
from termsel.io.result_folder import write_result
from termsel.testing import example_results

Call = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a result, an image, a DEM, a VRT of the image, and tables."""
    top = tmp_path_factory.mktemp("made")
    (top / "r").mkdir()
    result = example_results()[0]
    assert result.features.image_size is not None
    write_result(result, top / "r")
    lines, samples = result.features.image_size
    with rasterio.open(top / "s.tif", "w", driver="GTiff", width=samples, height=lines, count=1,
                       dtype="uint8", sparse_ok=True):
        pass
    with rasterio.open(top / "dem.tif", "w", driver="GTiff", width=4, height=4, count=1,
                       dtype="float32", crs="EPSG:4326",
                       transform=rasterio.transform.from_bounds(7, 46.8, 8, 47.4, 4, 4)) as dem:
        dem.write(np.full((1, 4, 4), 500.0, dtype=np.float32))
    (top / "s.vrt").write_text(
        f'<VRTDataset rasterXSize="{samples}" rasterYSize="{lines}"><VRTRasterBand dataType="Byte" '
        'band="1"><SimpleSource><SourceFilename relativeToVRT="1">s.tif</SourceFilename>'
        "</SimpleSource></VRTRasterBand></VRTDataset>")
    (top / "t.csv").write_text("id,x,y,z\na,7.5,47.1,500\n")
    (top / "i.csv").write_text("id,line,sample\na,1,2\n")
    table = (top / "r" / "points.csv").read_bytes()
    (top / "d").mkdir()
    for name in ("residuals.csv", "points.csv", "stability.json", "result.points"):
        (top / "d" / name).write_bytes(table)
    return top


RUN = "run --problem rfm-terms --strategy as-asked --solver all-terms --out d"
READ_AND_WRITTEN = {
    "points": (f"{RUN} --points d/residuals.csv", "d/residuals.csv"),
    "points kept with the result": (f"{RUN} --points d/points.csv", "d/points.csv"),
    "points and an export": (f"{RUN} --points d/result.points --format points-csv "
                             "--export qgis-points", "d/result.points"),
    "points of stability": ("stability --problem rfm-terms --points d/stability.json "
                            "--format points-csv --out d --repeats 2", "d/stability.json"),
    "points of another result": (RUN.replace("--out d", "--out r") + " --points r/points.csv",
                                 "r/points.csv"),
    "image": ("export r --to rpc-vrt -o s.tif --image s.tif --overwrite", "s.tif"),
    "source of the image": ("export r --to rpc-vrt -o s.tif --image s.vrt --overwrite", "s.tif"),
    "heights": ("export r --to geolocation-vrt -o dem.tif --dem dem.tif --overwrite", "dem.tif"),
    "second file of an export": ("export r --to geolocation-vrt -o dem.vrt --dem dem_xy.tif "
                                 "--image s.tif --overwrite", "dem_xy.tif"),
    "record": ("export r --to points-csv -o r/result.json --overwrite", "r/result.json"),
    "points of the result": ("export r --to points-csv -o r/points.csv --overwrite",
                             "r/points.csv"),
    "image of a map": ("rectify r s.tif --height 500 -o s.tif --overwrite", "s.tif"),
    "heights of a map": ("rectify r s.tif --dem dem.tif -o dem.tif --overwrite", "dem.tif"),
    "table to project": ("project r --points t.csv -o t.csv --overwrite", "t.csv"),
    "heights to project": ("project r --points i.csv --inverse --dem dem.tif -o dem.tif "
                           "--overwrite", "dem.tif"),
    "candidates of a plan": ("plan r -n 1 --candidates t.csv -o t.csv --overwrite", "t.csv"),
    "result to project": ("project r --points t.csv -o r/summary.txt --overwrite",
                          "r/summary.txt"),
}


@pytest.mark.parametrize(("command", "kept"), READ_AND_WRITTEN.values(), ids=READ_AND_WRITTEN)
def test_no_command_replaces_a_file_that_it_reads(
        command: str, kept: str, made: Path, tmp_path: Path, call: Call,
        monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    if "dem_xy" in command:
        os.rename("dem.tif", "dem_xy.tif")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    done = call(*command.split())
    assert done.exit_code == 2, done.stderr
    assert f"Error: {kept}: this command reads this file" in done.stderr
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_the_functions_refuse_too(made: Path, tmp_path: Path) -> None:
    image = shutil.copy(made / "s.tif", tmp_path)
    result = example_results()[0]
    with pytest.raises(termsel.TermselError, match="this command reads this file"):
        termsel.export(result, "rpc-vrt", image, image=image, overwrite=True)
    with pytest.raises(termsel.TermselError, match="this command reads this file"):
        rectify(result, image, image, height=500.0, overwrite=True)


def _relative(file: Path) -> Path:
    return file.parent / ".." / file.parent.name / "." / file.name


def _symlink(file: Path) -> Path:
    link = file.with_name("link")
    link.symlink_to(file.name)
    return link


def _link_of_a_link(file: Path) -> Path:
    (file.parent / "folder").symlink_to(file.parent, target_is_directory=True)
    return file.parent / "folder" / _symlink(file).name


def _hard_link(file: Path) -> Path:
    link = file.with_name("hard")
    link.hardlink_to(file)
    return link


SPELLINGS = {function.__name__[1:]: function
             for function in (_relative, _symlink, _link_of_a_link, _hard_link)}


@pytest.mark.parametrize("spelling", SPELLINGS.values(), ids=SPELLINGS)
@pytest.mark.parametrize("written", [True, False])
def test_a_file_is_known_by_any_spelling(spelling: Callable[[Path], Path], written: bool,
                                         made: Path, tmp_path: Path, call: Call) -> None:
    table = tmp_path / "t.csv"
    shutil.copy(made / "t.csv", table)
    other = spelling(table)
    points, output = (table, other) if written else (other, table)
    done = call("project", made / "r", "--points", points, "-o", output, "--overwrite")
    assert done.exit_code == 2
    assert "this command reads this file, as" in done.stderr
    assert table.read_bytes() == (made / "t.csv").read_bytes()


def test_a_file_in_another_case_is_known_where_the_disk_ignores_it(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # As a disk without cases answers.
    stat = Path.stat
    (tmp_path / "t.csv").write_text("x")
    monkeypatch.setattr(Path, "stat", lambda path, **how: stat(
        path.with_name(path.name.lower()), **how))
    with pytest.raises(Exception, match=r"T\.CSV: this command reads this file, as .*t\.csv"):
        require_replaceable([tmp_path / "T.CSV"], reads=[tmp_path / "t.csv"], overwrite=True)


WRITTEN = {
    "export": "export r --to points-csv -o mine",
    "second file of an export": "export r --to geolocation-vrt --set step=500 -o mine.vrt",
    "rectify": "rectify r s.tif --height 500 -o mine",
    "project": "project r --points t.csv -o mine",
}


@pytest.mark.parametrize("command", WRITTEN.values(), ids=WRITTEN)
def test_nothing_is_replaced_without_permission(command: str, made: Path, tmp_path: Path,
                                                call: Call, monkeypatch: pytest.MonkeyPatch,
                                                ) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    mine = Path("mine_xy.tif" if "geolocation" in command else "mine")
    mine.write_text("mine")
    done = call(*command.split())
    assert done.exit_code == 2
    assert f"Error: {mine}: this file already exists" in done.stderr
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("name", ["points.csv", "lines.csv", "residuals.csv", "summary.txt"])
def test_a_result_replaces_only_what_is_of_a_result(name: str, tmp_path: Path, call: Call) -> None:
    (tmp_path / name).write_text("mine")
    done = call("run", "--problem", "poly-terms", "--solver", "all-terms", "--out", tmp_path)
    assert done.exit_code == 2
    assert "would replace this file, which is not part of a result" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_values_that_are_no_files_do_not_matter(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text("mine")
    reads = [None, 3, "x" * 5000, tmp_path / "missing", tmp_path]
    require_replaceable([mine], reads=reads, overwrite=True)
    require_replaceable([tmp_path / "new"], reads=reads)
