"""Blocks as files: complete or as before, and the places of ties for other programs."""

from __future__ import annotations

import json
import struct
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")


from termsel import Result, TermselError
from termsel.testing import invoke
from termsel_block.files import folders
from termsel_block.files.block_file import read_ties
from termsel_block.files.folders import write_block
from termsel_block.joint import BlockResult, adjust
from termsel_block.shown.record import record_of
from termsel_block.simulated import simulate_block

Written = tuple[BlockResult, list[Result], Path]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """An adjusted block, the results of its images, and where it is written."""
    result = adjust(simulate_block(3, rpcs=True, control=(4, 4), wrong=0.05, seed=1,
                                   independent=10).block)
    record = record_of(result)
    images = [folders.image_result(result, i, record) for i in range(3)]
    folder = tmp_path_factory.mktemp("block") / "adjusted"
    with pytest.MonkeyPatch.context() as patched:  # once is enough
        patched.setattr(folders, "image_result", lambda _, i, __: images[i])
        write_block(result, folder)
    return result, images, folder


@pytest.mark.slow
def test_a_failure_while_writing_changes_nothing(
        written: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result, images, _ = written
    monkeypatch.setattr(folders, "image_result", lambda _, i, __: images[i])
    write_block(result, tmp_path / "there")
    (tmp_path / "there" / result.block.images[0].name / "own.RPB").write_text("mine")

    def content() -> dict[str, bytes]:
        return {str(file.relative_to(tmp_path)): file.read_bytes()
                for file in tmp_path.rglob("*") if file.is_file()}

    def second(_: BlockResult, i: int, __: Any) -> Any:
        return images[i] if i < 2 else refused()

    rename = Path.rename

    def last(file: Path, target: Path) -> Path:
        return refused() if file.parent.name == "new" and file.name == "block.json" \
            else rename(file, target)

    before = content()
    for owner, name, fails in ((folders, "image_result", second), (Path, "rename", last)):
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, fails)
            for folder in ("there", "new/folder"):
                with pytest.raises(TermselError, match="cannot write the block: No space"):
                    write_block(result, tmp_path / folder, overwrite=True)
                assert content() == before
                assert not (tmp_path / "new").exists()
    write_block(result, tmp_path / "there", overwrite=True)
    assert content().keys() == before.keys()


def test_what_is_said_of_an_image_is_what_its_folder_holds(written: Written) -> None:
    result, images, folder = written
    record = json.loads((folder / "block.json").read_text())
    # The block's own model misses the points by a little more or less.
    assert [image.independent for image in record_of(result).images] != [
        image["independent"] for image in record["images"]]
    for image, own in zip(record["images"], images, strict=True):
        rmse = own.rmse["independent"]
        assert rmse is not None
        assert (image["independent"], image["n_independent"]) == (rmse.total, rmse.n)
        assert f"{rmse.total:.2f} ({rmse.n})" in (folder / "summary.txt").read_text()


def refused(*_: object) -> Any:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("suffix", ["gpkg", "las"])
def test_places_become_a_layer_or_a_point_cloud(
        written: Written, tmp_path: Path, suffix: str) -> None:
    adjusted, target = str(written[2]), tmp_path / f"places ü.{suffix}"
    if suffix == "las":
        pytest.importorskip("laspy")
    done = invoke("block-points", adjusted, "-o", target)
    assert done.exit_code == 0, done.output
    rows = [row.split(",") for row in (written[2] / "ties.csv").read_text().splitlines()[1:]]
    expected = np.array([row[1:] for row in rows], float)
    if suffix == "gpkg":
        import geopandas

        layer = geopandas.read_file(target)
        assert layer.crs.to_epsg() == 4326
        assert list(layer.id) == [row[0] for row in rows]
        found = np.column_stack([layer.geometry.x, layer.geometry.y, layer.geometry.z,
                                 layer.sigma_east, layer.sigma_north, layer.sigma_up, layer.images])
    else:
        import laspy  # type: ignore[import-not-found, import-untyped, unused-ignore]

        cloud = laspy.read(target)
        assert cloud.header.parse_crs().to_epsg() == 4326
        found = np.column_stack([cloud.x, cloud.y, cloud.z, *(
            cloud[name] for name in ("sigma_east", "sigma_north", "sigma_up", "images"))])
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=6e-9)
    np.testing.assert_allclose(found[:, 2:], expected[:, 2:], atol=6e-4, rtol=1e-6)
    again = invoke("block-points", adjusted, "-o", target)
    assert again.exit_code == 2
    assert "--overwrite" in again.output


@pytest.mark.parametrize(("folder", "target", "message"), [
    ("none", "a.gpkg", "there is no block in this folder"),
    ("adjusted", "a.txt", "no known format"),
    ("adjusted", "no/a.gpkg", "no/a.gpkg"), ("adjusted", "adjusted", "no known format"),
    ("adjusted", "a.laz", "lazrs")])
def test_places_that_cannot_be_written_are_refused(
        written: Written, tmp_path: Path, folder: str, target: str, message: str) -> None:
    if target == "a.laz" and (not find_spec("laspy") or find_spec("lazrs")):
        pytest.skip("LAZ can be written")
    done = invoke("block-points", written[2].parent / folder, "-o",
                  tmp_path / target)
    assert done.exit_code == 2
    assert message in done.output
    assert "Traceback" not in done.output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("binary", [True, False])
def test_match_files_of_asp_are_ties(tmp_path: Path, binary: bool) -> None:
    """Pairs that share a place of an image become one tie of three images."""
    pytest.importorskip("termsel_match")
    places = {"A": [(10.0, 20.0), (30.0, 40.0)], "B": [(11.0, 21.0), (31.5, 41.0)],
              "C": [(12.0, 22.0)]}

    def written(name: str, left: list[tuple[float, float]],
                right: list[tuple[float, float]]) -> Path:
        file = tmp_path / name
        both = [*left, *right]
        if binary:
            content = struct.pack("<2Q", len(left), len(right)) + b"".join(
                struct.pack("<2f2i3f?2IQ", x, y, int(x), int(y), 0, 1, 1, True, 0, 0, 0)
                for y, x in both)
            file.write_bytes(content)
        else:
            file.write_text(f"{len(left)} {len(right)}\n" + "".join(
                f"{x} {y} {int(x)} {int(y)} 0 1 1 1 0 0 0\n" for y, x in both))
        return file

    end = ".match" if binary else ".txt"
    files = [written(f"run-A__B{end}", places["A"], places["B"]),
             written(f"run-B__C{end}", places["B"][:1], places["C"])]
    ties, notes = read_ties(files, ["A", "B", "C"])
    assert not notes
    assert sorted(np.bincount(ties.tie).tolist()) == [2, 3]
    three = ties.tie == int(np.argmax(np.bincount(ties.tie)))
    assert {(int(i), *map(float, p)) for i, p in zip(
        ties.image[three], ties.position[three], strict=True)} == {
        (0, 10.0, 20.0), (1, 11.0, 21.0), (2, 12.0, 22.0)}
    with pytest.raises(TermselError, match="states no two images"):
        read_ties(files, ["A", "C"])
    far = written(f"run-A__C{end}", [(1.0, 2.0), (3.0, 2e7)], places["A"])
    with pytest.raises(TermselError, match=r"2e\+07 is no sample of an image") as raised:
        read_ties([far], ["A", "C"])
    assert raised.value.file == far
    table = tmp_path / "ties.csv"  # with a name that the second file has given
    table.write_text("id,image,line,sample\nasp-A-30.0-40.0,A,1,2\n")
    with pytest.raises(TermselError, match=f"line 2 of .*run-A__B{end}"):
        read_ties([*files, table], ["A", "B", "C"])
