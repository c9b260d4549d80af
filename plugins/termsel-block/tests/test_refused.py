"""What is wrong with the files of a block is said, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")

from termsel import TermselError, read
from termsel.testing import invoke
from termsel_block.example import write_example
from termsel_block.files.block_file import read_block
from termsel_block.files.folders import require_free_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("block") / "place"
    write_example(made)
    return made


@pytest.mark.parametrize(("edit", "message"), [
    (('"B"', '"A"'), "2 images are called 'A'"),
    (('name = "B"', 'name = "Q"'), "the block has no image 'B'"),
    (('"ties.csv"', '"none.csv"'), "this file of ties does not exist"),
    (("rpc =", "rcp ="), "unknown key 'rcp' of image number 1. Did you mean 'rpc'? Known: name, "),
    (("[[image]]", "[[images]]"), "unknown key 'images' of a block. Did you mean 'image'? Known: "),
    (("rpc =", "rcp ="), "bad.toml, line "),
    (('crs = "EPSG:4979"', 'solvers = ["ga"]'), "Run it by termsel compare"),
    (('"B.RPB"', '"ties.csv"'), "this file has no RPC"),
    (('name = "C"', 'name = "../C"'), "cannot be the name of an image"),
    (('crs = "EPSG:4979"', 'crs = "EPSG:32639"'), "the block says EPSG:32639"),
    (('crs = "EPSG:4979"', 'crs = "local"'), "'A' has an RPC, which needs geographic coordinates"),
    (('points = "A_points.csv"', 'points = "A.RPB"'), "Name the RPC as rpc of the image"),
    (('ties = "ties.csv"', "ties = []"), "names no file of ties"),
    (('crs = "EPSG:4979"', "crs = "), "this is not TOML"),
    (('crs = "EPSG:4979"', f"crs = {'[' * 5000}"), "keys or numbers have no end"),
    (('crs = "EPSG:4979"', f"crs{'.a' * 5000} = 1"), "keys or numbers have no end"),
    (('crs = "EPSG:4979"', f"crs = {'9' * 20000}"), "keys or numbers have no end"),
    (('name = "B"', f'name = "B"\noptions = {{degree = {"9" * 300}}}'), "more than 64 bits"),
    (('name = "B"', 'name = "B"\nimage = "b\\u0000.tif"'), "has a NUL character"),
    (('crs = "EPSG:4979"', ""), "the block has no CRS. Add that of its points as the first "
     'line, such as crs = "EPSG:4979".'),
    (('crs = "EPSG:4979"', "crs = 4979"), "crs is a whole number, expected text in quotes"),
    (('name = "B"', "name = 2"), "name of image number 2 is a whole number, expected text"),
    (('rpc = "B.RPB"', 'options = "x"'), "options of image number 2 is text in quotes, expected"),
    (('name = "B"', 'model = "auto"'), "image number 2 lacks 'name'"),
    (('name = "B"', 'name = " "'), "cannot be the name of an image"),
    (('name = "B"', f'name = "{"B" * 101}"'), "and at most 100 bytes"),
    (('name = "B"', f'name = "{"é" * 51}"'), "and at most 100 bytes"),
    (('name = "B"', 'name = "a"'), "images 'A' and 'a' would share one folder"),
    (("[[image]]", "[image]"), "[image] stands where [[image]] should"),
    (('rpc = "C.RPB"', 'rpc = "C.RPB"\nmodel = "cubic"'), "has the model 'cubic'"),
])
def test_what_is_wrong_is_said_and_nothing_written(
        folder: Path, edit: tuple[str, str], message: str) -> None:
    bad = folder / "bad.toml"
    bad.write_text((folder / "block.toml").read_text().replace(*edit))
    done = invoke("block", bad, "--out", folder / "new", "--quiet")
    assert done.exit_code == 2
    assert message in done.output
    assert "Traceback" not in done.output
    assert not (folder / "new").exists()


@pytest.fixture
def with_list(folder: Path, tmp_path: Path) -> Path:
    """A block whose control of all images is one list of OpenDroneMap."""
    pytest.importorskip("termsel_formats")
    rows = ["EPSG:4979"]
    for name in "AB":
        points = read(folder / f"{name}_points.csv", crs="EPSG:4979").points
        rows += [f"{x!r} {y!r} {z!r} {sample!r} {line!r} {name}.tif {point}"
                 for point, (line, sample), (x, y, z) in zip(
                     points.ids, points.image.tolist(), points.ground.tolist(), strict=True)]
    (tmp_path / "gcp_list.txt").write_text("\n".join(rows))
    for file in folder.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    stated = (folder / "block.toml").read_text()
    for name in "AB":
        stated = stated.replace(f"{name}_points.csv", "gcp_list.txt")
    (tmp_path / "block.toml").write_text(stated)
    return tmp_path / "block.toml"


def test_a_list_of_several_images_is_the_control_of_each(folder: Path, with_list: Path) -> None:
    of_tables = read_block(folder / "block.toml")
    for image, expected in zip(read_block(with_list).images, of_tables.images, strict=True):
        if expected.features is not None:
            assert image.features is not None
            np.testing.assert_array_equal(image.features.points.image,
                                          expected.features.points.image)


def test_an_image_that_a_list_has_no_points_of_is_named(with_list: Path) -> None:
    text = with_list.read_text().replace("C_points.csv", "gcp_list.txt")
    with_list.write_text(text)
    with pytest.raises(TermselError, match=r"such as A\.tif, B\.tif, and none of 'C'"):
        read_block(with_list)


@pytest.mark.parametrize(("name", "content"), [
    ("ties.csv", b"id,x\n\xff\xfe,1\n"), ("block.json", b"\xff{}"), ("block.json", b"[" * 9999),
    ("ties.csv", b"id,x\nT1,\x00\n"), ("ties.csv", b"id\n\nT1\n")])
def test_places_of_damaged_files_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / "block.json").write_bytes(b"{}")
    (tmp_path / "ties.csv").write_bytes(b"id\n")
    (tmp_path / name).write_bytes(content)
    done = invoke("block-points", tmp_path, "-o", tmp_path / "places.gpkg")
    assert done.exit_code == 2, done.output
    assert name in done.output
    assert not (tmp_path / "places.gpkg").exists()


@pytest.mark.parametrize(("row", "message"), [
    ("X1,A,nan,3", "'nan' is not a number"), ("X1,A,5", "has 3 cells"),
    ("X1,A,5,5,6,5", "has 6 cells"), ("X1,A,9999999,4", "and the others are within"),
    ("X1,A,3,1e300", r"1e\+300 is no sample of an image"),
    ("T0,A,1,2", "measured twice in image 'A'")])
def test_a_table_of_ties_names_line_and_column(folder: Path, row: str, message: str) -> None:
    (folder / "bad.csv").write_text((folder / "ties.csv").read_text() + row + "\n")
    (folder / "bad.toml").write_text(
        (folder / "block.toml").read_text().replace("ties.csv", "bad.csv"))
    with pytest.raises(TermselError, match=message) as raised:
        read_block(folder / "bad.toml")
    assert raised.value.line == len((folder / "ties.csv").read_text().splitlines()) + 1


@pytest.mark.parametrize(("place", "message"), [
    (",1.5,2.5", "all 3 ties of image 'A' are at one position in it"),
    (",{k}1.5,2.5", "images 'A' and 'B' have all 3 common ties at the same positions")])
def test_a_copy_of_an_image_is_refused(folder: Path, place: str, message: str) -> None:
    (folder / "copy.csv").write_text("id,image,line,sample\n" + "".join(
        f"{k},{name}{place.format(k=k)}\n" for k in range(3) for name in "AB"))
    stated = (folder / "block.toml").read_text().replace("ties.csv", "copy.csv")
    (folder / "copy.toml").write_text(stated[:stated.index('[[image]]\nname = "C"')])
    with pytest.raises(TermselError, match=message):
        read_block(folder / "copy.toml")


def test_a_folder_leads_to_the_file_of_its_block(tmp_path: Path) -> None:
    invoke("block-example", tmp_path / "scene")
    assert "Give " + str(tmp_path / "scene" / "block.toml") in invoke(
        "block", tmp_path / "scene").output
    assert "termsel block-example DIR writes" in invoke("block", tmp_path).output


def test_an_image_with_the_name_of_a_file_of_the_block_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TermselError, match=r"'Block\.json' cannot be the name of an image"):
        require_free_folder(tmp_path / "new", ["A", "Block.json"], overwrite=False)


def test_ties_in_one_image_are_left_out(folder: Path) -> None:
    (folder / "more.csv").write_text("id,image,line,sample\nlone,A,1,2\n")
    (folder / "more.toml").write_text((folder / "block.toml").read_text().replace(
        '"ties.csv"', '["ties.csv", "more.csv"]'))
    block = read_block(folder / "more.toml")
    assert "lone" not in block.ties.names
    assert "1 tie is in one image alone" in block.notes[0]


def test_an_image_that_nothing_joins_is_named(folder: Path) -> None:
    rows = (folder / "ties.csv").read_text().splitlines()
    (folder / "two.csv").write_text("\n".join(row for row in rows if ",C," not in row) + "\n")
    (folder / "alone.toml").write_text(
        (folder / "block.toml").read_text().replace("ties.csv", "two.csv"))
    with pytest.raises(TermselError, match="'C' has 0 ties and 0 control features"):
        read_block(folder / "alone.toml")


def test_the_package_that_rpcs_require_is_asked_for_at_once(
        folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel_block.files.block_file.find_spec", {}.get)
    with pytest.raises(TermselError, match=r"pip install \./plugins/termsel-rpc"):
        read_block(folder / "block.toml")
