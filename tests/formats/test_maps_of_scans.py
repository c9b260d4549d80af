"""Maps of scans of every kind: colours, holes, what lies outside, and gdalwarp beside them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rasterio")

import rasterio
from rasterio.enums import ColorInterp, MaskFlags

import termsel
from termsel.data.thumbnail import make_thumbnail
from tests import scans

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")

RED_GREEN_BLUE_INK = {0: (200, 30, 20, 255), 1: (20, 200, 30, 255), 2: (30, 20, 200, 255),
                      3: (0, 0, 0, 255)}
INDICES = (scans.noise() // 85).astype(np.uint8)
RGB = scans.noise(3)
ALPHA = np.where(scans.half(), 255, 0).astype(np.uint8)[None]
HALF_ALPHA = scans.noise(1, 3, 5)
RGBA = np.concatenate([RGB, HALF_ALPHA])
HEIGHTS = scans.noise().astype(np.float32) / 7


def kind(name: str, folder: Path) -> Path:
    """Return an image of a kind."""
    path = folder / f"{name}.tif"
    table, rgb = {"table": RED_GREEN_BLUE_INK}, {"photometric": "RGB", "alpha": "YES"}
    makers: dict[str, Callable[[], Path]] = {
        "palette": lambda: scans.write(path, INDICES, **table),
        "palette-nodata": lambda: scans.write(path, INDICES, nodata=3, **table),
        "palette-mask": lambda: scans.write(path, INDICES, mask=scans.half(), **table),
        "palette-4-bit": lambda: scans.write(path, INDICES, nbits=4, **table),
        "palette-16-bit": lambda: scans.write(path, INDICES.astype(np.uint16), **table),
        "palette-alpha": lambda: scans.write(path, np.concatenate([INDICES, ALPHA]), **table,
                                             colours=("palette", "alpha")),
        "bit-white": lambda: scans.write(path, INDICES % 2, nbits=1, photometric="MINISWHITE"),
        "bit-black": lambda: scans.write(path, INDICES % 2, nbits=1),
        "grey": lambda: scans.write(path, scans.noise()),
        "grey-nodata": lambda: scans.write(path, scans.noise(), nodata=0),
        "grey-mask-next-to-it": lambda: scans.write(path, scans.noise(), mask=scans.half(),
                                                    inside=False),
        "grey-alpha": lambda: scans.write(path, np.concatenate([scans.noise(), HALF_ALPHA]),
                                          alpha="YES"),
        "rgb": lambda: scans.write(path, RGB),
        "rgb-nodata": lambda: scans.write(path, RGB, nodata=0),
        "rgb-mask": lambda: scans.write(path, RGB, mask=scans.half()),
        "rgb-mask-and-nodata": lambda: scans.write(path, RGB, mask=scans.half(), inside=False,
                                                   nodata=0),
        "rgba": lambda: scans.write(path, RGBA, **rgb),
        "rgba-16-bit": lambda: scans.write(path, RGBA.astype(np.uint16) * 257, **rgb),
        "infrared": lambda: scans.write(path, RGB, colours=("nir", "red", "green")),
        "five-bands": lambda: scans.write(path, scans.noise(5)),
        "16-bit": lambda: scans.write(path, scans.noise(3).astype(np.uint16) * 200),
        "16-bit-signed-nodata": lambda: scans.write(path, scans.noise().astype(np.int16) - 100,
                                                    nodata=-100),
        "32-bit": lambda: scans.write(path, scans.noise().astype(np.int32) * 100_000),
        "float": lambda: scans.write(path, HEIGHTS),
        "float-nodata": lambda: scans.write(path, HEIGHTS, nodata=0),
        "float-mask": lambda: scans.write(path, HEIGHTS, mask=scans.half()),
        "complex": lambda: scans.write(path, (HEIGHTS + 1j * HEIGHTS[:, ::-1]).astype(
            np.complex64)),
    }
    return makers[name]()


KINDS = [
    "palette", "palette-nodata", "palette-mask", "palette-4-bit", "palette-16-bit", "palette-alpha",
    "bit-white", "bit-black", "grey", "grey-nodata", "grey-mask-next-to-it", "grey-alpha", "rgb",
    "rgb-nodata", "rgb-mask", "rgb-mask-and-nodata", "rgba", "rgba-16-bit", "infrared",
    "five-bands", "16-bit", "16-bit-signed-nodata", "32-bit", "float", "float-nodata", "float-mask",
    "complex"]


@pytest.mark.skipif(not scans.has_gdalwarp(), reason="requires the program gdalwarp")
@pytest.mark.parametrize("name", KINDS)
def test_a_map_is_that_of_gdalwarp_with_an_alpha_band(name: str, tmp_path: Path) -> None:
    image = kind(name, tmp_path)
    category = name.startswith(("palette", "bit"))
    resampling = "nearest" if category else "bilinear"
    made = scans.rectified(image)
    expected = scans.gdalwarped(image, made, resampling)
    with rasterio.open(image) as source, rasterio.open(made) as raster:
        assert raster.colorinterp == source.colorinterp
        assert raster.dtypes == source.dtypes
        pixels, shown = raster.read(), raster.dataset_mask() > 0
        if source.colorinterp[0] == ColorInterp.palette:
            assert {value: colour[:3] for value, colour in raster.colormap(1).items()
                    if value in RED_GREEN_BLUE_INK and value in source.colormap(1)} == {
                        value: colour[:3] for value, colour in source.colormap(1).items()
                        if value in RED_GREEN_BLUE_INK}
            bits = [file.tags(1, ns="IMAGE_STRUCTURE").get("NBITS") for file in (source, raster)]
            assert bits in ([None, None], ["1", "2"], ["4", "4"])
    outside = np.real(expected[-1]) == 0
    assert (shown == ~outside).all()
    # Two versions of GDAL find places by an RPC to within a thousandth of a pixel.
    span = np.abs(expected[:, shown]).max()
    tolerance = 0.0 if category else max(1.0 if pixels.dtype == np.uint8 else 0.0, 5e-4 * span)
    assert np.abs(pixels[:, shown] - expected[:len(pixels), shown].astype(pixels.dtype)
                  .astype(complex if pixels.dtype.kind == "c" else float)).max() <= tolerance


@pytest.mark.parametrize("resampling", ["nearest", "bilinear"])
def test_a_complex_map_large_enough_for_overviews_is_made(resampling: str, tmp_path: Path) -> None:
    """GDAL reduces complex pixels by no cubic convolution, and nobody asked for one."""
    made = scans.rectified(kind("complex", tmp_path), resolution=0.3, resampling=resampling)
    with rasterio.open(made) as raster:
        assert raster.overviews(1)
        assert raster.dtypes == ("complex64",)
        assert np.isfinite(raster.read()).any()


@pytest.mark.skipif(not scans.has_gdalwarp(), reason="requires the program gdalwarp")
def test_a_band_without_data_where_others_have_some_stays_empty_there_by_cubic(
        tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    pixels = rng.integers(100, 20_000, (6, *scans.SIZE)).astype(np.uint16)
    pixels[rng.uniform(size=pixels.shape) < 0.1] = 7
    image = scans.write(tmp_path / "six.tif", pixels, nodata=7)
    made = scans.rectified(image, resampling="cubic")
    own, expected = (scans.gdalwarped(image, made, resampling)[:6]
                     for resampling in ("nearest", "cubic"))
    with rasterio.open(made) as raster:
        warped, shown = raster.read(), raster.dataset_mask() > 0
    empty = shown & (own == 0)  # gdalwarp has 0 there, which no pixel of the image has
    assert (warped[empty] == 7).all()
    # There the warper divides by sums of weights near zero.
    assert expected[empty].max() > 60_000
    assert np.abs(warped.astype(float) - expected)[~empty & shown].max() < 10


@pytest.mark.parametrize("name", ["rgb", "grey", "16-bit", "five-bands"])
def test_ink_of_value_zero_is_no_hole_and_a_mask_says_what_lies_outside(
        name: str, tmp_path: Path) -> None:
    with rasterio.open(scans.rectified(kind(name, tmp_path))) as raster:
        assert raster.nodata is None
        assert MaskFlags.per_dataset in raster.mask_flag_enums[0]
        shown, pixels = raster.dataset_mask() > 0, raster.read(1)
    assert shown[50:-50, 60:-60].all()
    assert not shown[0].any()
    assert (pixels[shown] == 0).sum() > 20
    assert [path.name for path in tmp_path.glob("*_map*")] == [f"{name}_map.tif"]


@pytest.mark.parametrize(("name", "index"), [
    ("palette", 4), ("palette-mask", 4), ("palette-4-bit", 4), ("palette-16-bit", 4),
    ("bit-white", 2), ("bit-black", 2), ("palette-nodata", 3)])
def test_with_a_colour_table_an_index_that_is_not_used_lies_outside(
        name: str, index: int, tmp_path: Path) -> None:
    with rasterio.open(scans.rectified(kind(name, tmp_path))) as raster:
        assert raster.nodata == index
        shown, pixels = raster.dataset_mask() > 0, raster.read(1)
        assert raster.colormap(1)[0][:3] in ((200, 30, 20), (255, 255, 255), (0, 0, 0))
    assert (pixels[~shown] == index).all()
    assert set(np.unique(pixels[shown])) == set(range(min(index, 4)))


def test_a_colour_table_that_is_all_in_use_has_a_mask(tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).permutation(
        np.resize(np.arange(256), scans.SIZE[0] * scans.SIZE[1])).astype(np.uint8)
    table = {value: (value, 255 - value, 7, 255) for value in range(256)}
    image = scans.write(tmp_path / "full.tif", pixels.reshape(1, *scans.SIZE), table=table)
    with rasterio.open(scans.rectified(image)) as raster:
        assert raster.nodata is None
        assert MaskFlags.per_dataset in raster.mask_flag_enums[0]
        assert raster.colormap(1) == table


@pytest.mark.parametrize("name", ["rgb-mask", "rgba", "float-mask", "grey-nodata"])
@pytest.mark.parametrize("resampling", ["bilinear", "cubic", "average"])
def test_what_is_hidden_in_the_image_does_not_bleed(
        name: str, resampling: str, tmp_path: Path) -> None:
    image = kind(name, tmp_path)
    with rasterio.open(image) as raster:
        pixels = raster.read()
        hidden = raster.dataset_mask() == 0
        hidden |= pixels[0] == 0 if name == "grey-nodata" else False
    colours = slice(0, 3 if name == "rgba" else len(pixels))
    pixels[colours] = 77
    pixels[colours, hidden] = 0 if name == "grey-nodata" else 200
    options = {"nodata": 0} if name == "grey-nodata" else {}
    mask = None if name in ("rgba", "grey-nodata") else ~hidden
    flat = scans.write(tmp_path / "flat.tif", pixels, mask=mask, **options,
                       **({"photometric": "RGB", "alpha": "YES"} if name == "rgba" else {}))
    with rasterio.open(scans.rectified(flat, resampling=resampling)) as raster:
        shown = raster.dataset_mask() > 0
        assert np.allclose(raster.read()[colours, shown], 77, atol=1e-3)


def test_colours_are_resampled_instead_of_indices_where_pixels_are_to_be_mixed(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    image = kind("palette", tmp_path)
    colours = np.array([RED_GREEN_BLUE_INK[value][:3] for value in range(4)], dtype=np.uint8)
    same = scans.write(tmp_path / "colours.tif", np.moveaxis(colours[INDICES[0]], -1, 0))
    with rasterio.open(scans.rectified(image, resampling="bilinear")) as raster, \
            rasterio.open(scans.rectified(same, resampling="bilinear")) as expected:
        assert raster.colorinterp == expected.colorinterp
        assert (raster.read() == expected.read()).all()
        assert (raster.dataset_mask() == expected.dataset_mask()).all()
    assert "the map has the colours of the image's table instead of its indices" in caplog.text


def test_bits_become_grey_where_pixels_are_to_be_mixed(tmp_path: Path) -> None:
    with rasterio.open(scans.rectified(kind("bit-white", tmp_path), resampling="average")) as grey:
        assert grey.colorinterp == (ColorInterp.gray,)
        assert len(np.unique(grey.read(1))) > 20


CLASSES = """<PAMDataset><PAMRasterBand band="1">{}</PAMRasterBand></PAMDataset>"""


@pytest.mark.parametrize("sidecar", [
    "<CategoryNames><Category>sea</Category><Category>land</Category></CategoryNames>",
    '<GDALRasterAttributeTable tableType="thematic"></GDALRasterAttributeTable>',
    '<Metadata><MDI key="LAYER_TYPE">thematic</MDI></Metadata>'])
def test_classes_are_resampled_by_nearest_and_never_mixed(sidecar: str, tmp_path: Path) -> None:
    image = scans.write(tmp_path / "classes.tif", INDICES * 50)
    image.with_name("classes.tif.aux.xml").write_text(CLASSES.format(sidecar))
    with rasterio.open(scans.rectified(image)) as raster:
        shown = raster.dataset_mask() > 0
        assert set(np.unique(raster.read(1)[shown])) == {0, 50, 100, 150}
    with pytest.raises(termsel.TermselError, match="are classes, which cubic would mix"):
        scans.rectified(image, resampling="cubic")


def test_a_histogram_makes_no_classes(tmp_path: Path) -> None:
    image = scans.write(tmp_path / "grey.tif", INDICES * 50)
    image.with_name("grey.tif.aux.xml").write_text(CLASSES.format(
        '<GDALRasterAttributeTable tableType="athematic"></GDALRasterAttributeTable>'))
    with rasterio.open(scans.rectified(image)) as raster:
        assert len(np.unique(raster.read(1))) > 20


def test_a_value_that_is_asked_for_is_where_the_map_shows_nothing(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with rasterio.open(scans.rectified(kind("rgb", tmp_path), nodata=255)) as raster:
        assert raster.nodata == 255
        pixels, shown = raster.read(), raster.dataset_mask() > 0
    assert (pixels[:, 0] == 255).all()
    assert (pixels[:, 50:-50, 60:-60] < 255).all()  # white is moved by the least step
    assert (pixels == 254).any()
    assert shown[50:-50, 60:-60].all()
    # The scenes have one height of the ground, which is said.
    assert not [record for record in caplog.records if record.levelname == "WARNING"
                and "the ground is taken as level" not in record.getMessage()]
    with rasterio.open(scans.rectified(kind("palette", tmp_path), nodata=3)) as raster:
        assert raster.nodata == 3
    assert "px of the map have the value 3 of nodata in the image itself" in caplog.text
    with rasterio.open(scans.rectified(kind("rgba", tmp_path), nodata=255)) as raster:
        assert raster.nodata is None
        assert (raster.read()[:3, 0] == 255).all()
        assert (raster.read(4)[0] == 0).all()
    with pytest.raises(termsel.TermselError, match="uint8 cannot have the value 256"):
        scans.rectified(kind("rgb", tmp_path), nodata=256)


def test_bands_with_different_values_for_no_data_have_a_mask(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    image = kind("rgb", tmp_path)
    virtual = tmp_path / "bands.vrt"
    rasterio.shutil.copy(image, virtual, driver="VRT")
    text = virtual.read_text()
    for band, value in ((1, 0), (2, 255), (3, 0)):
        text = re.sub(f'(<VRTRasterBand[^>]*band="{band}"[^>]*>)',
                      rf"\1<NoDataValue>{value}</NoDataValue>", text)
    virtual.write_text(text)
    with rasterio.open(virtual) as raster:
        assert raster.nodatavals == (0, 255, 0)
    made = scans.rectified(virtual, resampling="nearest")
    with rasterio.open(made) as raster:
        assert raster.nodata is None
        pixels, shown = raster.read(), raster.dataset_mask() > 0
    with rasterio.open(scans.rectified(image, resampling="nearest")) as raster:
        values, inside = raster.read(), raster.dataset_mask() > 0
    empty = (values[0] == 0) & (values[1] == 255) & (values[2] == 0)
    assert empty[inside].any()
    assert (shown == (inside & ~empty)).all()
    assert (pixels[:, shown] == values[:, shown]).all()
    assert "have different nodata values" in caplog.text


def test_an_alpha_band_that_comes_first_counts_and_a_further_one_is_kept(tmp_path: Path) -> None:
    first = scans.write(tmp_path / "first.tif", np.concatenate([ALPHA, RGB]),
                        colours=("alpha", "red", "green", "blue"))
    last = scans.write(tmp_path / "last.tif", np.concatenate([RGB, ALPHA]), photometric="RGB",
                       alpha="YES")
    with rasterio.open(scans.rectified(first)) as raster, \
            rasterio.open(scans.rectified(last)) as usual:
        assert raster.colorinterp[0] == ColorInterp.alpha
        assert (raster.read([2, 3, 4, 1]) == usual.read()).all()
        assert ((raster.dataset_mask() > 0) == (usual.dataset_mask() > 0)).all()
    colours = ("red", "green", "blue", "alpha", "alpha")
    two = scans.write(tmp_path / "two.tif", np.concatenate([RGB, HALF_ALPHA, ALPHA]),
                      colours=colours)
    with rasterio.open(scans.rectified(two)) as raster:
        assert [colour.name for colour in raster.colorinterp] == list(colours)
        assert set(np.unique(raster.read_masks(1))) == {0, 255}


def test_transparent_colours_of_a_table_stay_so(tmp_path: Path) -> None:
    image = tmp_path / "palette.vrt"
    rasterio.shutil.copy(kind("palette", tmp_path), image, driver="VRT")
    ink = '<Entry c1="0" c2="0" c3="0" c4="255" />'
    for alpha, expected in (("0", ["palette"]), ("100", ["red", "green", "blue", "alpha"])):
        part = tmp_path / f"alpha{alpha}.vrt"
        part.write_text(image.read_text().replace(ink, ink.replace("255", alpha), 1))
        with rasterio.open(scans.rectified(part)) as raster:
            assert [colour.name for colour in raster.colorinterp] == expected
            shown = raster.dataset_mask() > 0
            if alpha == "0":
                assert 3 not in raster.read(1)[shown]
            else:
                assert set(np.unique(raster.read(4))) == {0, 100, 255}


def test_what_an_image_says_of_its_bands_stays(tmp_path: Path) -> None:
    image = kind("16-bit", tmp_path)
    with rasterio.open(image, "r+") as raster:
        raster.set_band_description(2, "red edge & more")
        raster.set_band_unit(2, "W/m2")
        raster.scales, raster.offsets = (1.0, 0.02, 1.0), (0.0, -5.0, 0.0)
    with rasterio.open(scans.rectified(image)) as raster:
        assert raster.descriptions == (None, "red edge & more", None)
        assert raster.units[1] == "W/m2"
        assert (raster.scales[1], raster.offsets[1]) == (0.02, -5.0)
        assert raster.tags()["AREA_OR_POINT"] == "Area"


@pytest.mark.parametrize("writer", ["geolocation-vrt", "gcp-vrt", "rpc-vrt"])
def test_virtual_rasters_keep_tables_and_masks(writer: str, tmp_path: Path) -> None:
    image = kind("palette-mask", tmp_path)
    made = tmp_path / "scene.vrt"
    termsel.export(scans.result(), writer, made, image=str(image))
    with rasterio.open(made) as raster, rasterio.open(image) as source:
        assert raster.colormap(1)[2] == source.colormap(1)[2]
        assert (raster.read() == source.read()).all()
        assert (raster.dataset_mask() == source.dataset_mask()).all()


def test_a_small_picture_of_indices_shows_their_colours(tmp_path: Path) -> None:
    import base64

    bits = np.zeros((1, *scans.SIZE), dtype=np.uint8)
    bits[:, :, : scans.SIZE[1] // 2] = 1  # ink, with the colour table of white paper
    image = scans.write(tmp_path / "sheet.tif", bits, nbits=1, photometric="MINISWHITE")
    content = base64.b64decode(make_thumbnail(image)[0].partition(",")[2])
    with rasterio.MemoryFile(content) as file, file.open() as raster:
        grey = raster.read(1).astype(float)
    assert grey[:, :50].mean() < grey[:, 70:].mean() - 100
