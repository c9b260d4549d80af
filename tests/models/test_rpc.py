"""RPCs: read from every format, written, and evaluated as GDAL does."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from termsel.core.errors import TermselError
from termsel.data.features import FloatArray
from termsel.data.rpc import Rpc
from termsel.formats.pictures import Picture
from termsel.formats.rpc_files import (
    ERROR_NAMES,
    RPB_NAMES,
    read_rpc,
    rpb_text,
    rpc_items,
    rpc_txt_text,
)
from termsel.formats.vrt import vrt_text

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")

VENDOR_FORMATS = {".TXT", ".txt", ".RPB", ".rpc", ".XML", ".xml"}


def _rpc(folder: Path, name: str) -> Rpc:
    """Return one of the RPCs as the collection has it, offsets from the first pixel's centre."""
    entries = json.loads((folder / "rpc" / "all_rpc.json").read_text())
    entry = next(entry for entry in entries if entry["name"] == name)
    c = entry["rpc"]
    # The collection keeps the offsets as the file has them; in DIMAP they count from 1.
    first = 1 if "pleiades" in name and "right" not in name else 0
    return Rpc((c["LINE_OFF"] - first, c["SAMP_OFF"] - first), (c["LINE_SCALE"], c["SAMP_SCALE"]),
               (c["LONG_OFF"], c["LAT_OFF"], c["HEIGHT_OFF"]),
               (c["LONG_SCALE"], c["LAT_SCALE"], c["HEIGHT_SCALE"]),
               *(tuple(map(float, c[key])) for key in ("LINE_NUM", "LINE_DEN", "SAMP_NUM",
                                                       "SAMP_DEN")))


NAMES = (
    "ikonos_montevideo", "skysat_l1a", "planet_l1a", "planet_l1b", "pleiades_montevideo",
    "wv1_belgium", "wv3_lucknow", "wv3_jacksonville_crop", "enmap_yemen_band1",
    "enmap_yemen_band113", "enmap_yemen_band224", "pleiades_nice_a", "pleiades_nice_b",
    "pleiades_ventoux_left", "pleiades_ventoux_right", "wv3_sanfernando_30", "orbview3_russia",
    "kompsat_russia", "wv3_rome_sparse")


def _ground(rpc: Rpc, seed: int = 0) -> FloatArray:
    """Return 1,000 ground points in the image's box."""
    # A producer of two of these RPCs has scales of 1 degree, far beyond the image.
    share = np.random.default_rng(seed).uniform(-1.0, 1.0, (1000, 3))
    if rpc.ground_scale[0] == 1:
        share *= 0.005
    return np.asarray(share * rpc.ground_scale + rpc.ground_offset)


def _by_gdal(path: Path, ground: FloatArray) -> FloatArray:
    """Return line and sample by GDAL, counted as in termsel."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import RPCTransformer

    with rasterio.open(path) as raster, RPCTransformer(raster.rpcs) as transformer:
        rows, columns = transformer.rowcol(*ground.T, op=np.asarray)
    return np.column_stack([rows, columns]) - 0.5


def _as_rpb(rpc: Rpc, folder: Path) -> tuple[Path, Path]:
    (folder / "scene.RPB").write_text(rpb_text(rpc))
    return folder / "scene.RPB", _empty_image(folder / "scene.tif")


def _as_txt(rpc: Rpc, folder: Path) -> tuple[Path, Path]:
    (folder / "scene_RPC.TXT").write_text(rpc_txt_text(rpc))
    return folder / "scene_RPC.TXT", _empty_image(folder / "scene.tif")


def _as_vrt(rpc: Rpc, folder: Path) -> tuple[Path, Path]:
    path = folder / "scene.vrt"
    path.write_text(vrt_text(Picture((8, 8)), folder, domains={"RPC": rpc_items(rpc)}))
    return path, path


def _as_tag(rpc: Rpc, folder: Path) -> tuple[Path, Path]:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.rpc import RPC

    path = _empty_image(folder / "scene.tif")
    with rasterio.open(path, "r+") as raster:
        raster.rpcs = RPC.from_gdal(rpc_items(rpc))
    return path, path


def _empty_image(path: Path) -> Path:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(path, "w", driver="GTiff", width=8, height=8, count=1, dtype="uint8"):
        pass
    return path


FORMS = {"rpb": _as_rpb, "rpc-txt": _as_txt, "vrt": _as_vrt}


@pytest.mark.parametrize("name", NAMES)
def test_every_rpc_in_every_form_is_gdals(name: str, data_folder: Path, tmp_path: Path) -> None:
    rpc = _rpc(data_folder, name)
    ground = _ground(rpc)
    ours = rpc.project(ground)
    for form, write in FORMS.items():
        folder = tmp_path / form
        folder.mkdir()
        path, image = write(rpc, folder)
        assert read_rpc(path) == rpc
        assert np.abs(_by_gdal(image, ground) - ours).max() < 1e-6, form
    # A GeoTIFF's tag keeps 15 digits.
    path, _ = _as_tag(rpc, tmp_path)
    assert np.abs(read_rpc(path).project(ground) - ours).max() < 1e-6


def _originals(folder: Path) -> Iterator[tuple[str, Path]]:
    for entry in json.loads((folder / "rpc" / "all_rpc.json").read_text()):
        path = folder / "rpc" / (entry["original"] or "-")
        if path.suffix in VENDOR_FORMATS and not path.name.startswith("enmap"):
            yield entry["name"], path


def test_vendors_files(data_folder: Path) -> None:
    found = dict(_originals(data_folder))
    assert len(found) == 13
    for name, path in found.items():
        vendor = read_rpc(path)
        assert replace(vendor, error_bias=None, error_random=None) == _rpc(data_folder, name)


def test_dimap_is_gdals(data_folder: Path, tmp_path: Path) -> None:
    """GDAL finds the RPC file of a product by the names its producer gives."""
    original = dict(_originals(data_folder))["pleiades_nice_a"]
    rpc = read_rpc(original)
    (tmp_path / "RPC_PHR1A.XML").write_bytes(original.read_bytes())
    (tmp_path / "DIM_PHR1A.XML").write_text("<Dimap_Document/>")
    image = _empty_image(tmp_path / "IMG_PHR1A_R1C1.TIF")
    ground = _ground(rpc)
    assert np.abs(_by_gdal(image, ground) - rpc.project(ground)).max() < 1e-6


DIMAP_3 = """<?xml version="1.0" encoding="UTF-8"?>
<Dimap_Document><Metadata_Identification>
<METADATA_FORMAT version="3.0.0">DIMAP</METADATA_FORMAT></Metadata_Identification>
<Rational_Function_Model><Global_RFM>
<ImagetoGround_Values>{wrong}</ImagetoGround_Values>
<GroundtoImage_Values>{right}</GroundtoImage_Values>
<RFM_Validity><ImagetoGround_Validity_Domain><FIRST_ROW>0.5</FIRST_ROW><FIRST_COL>0.5</FIRST_COL>
</ImagetoGround_Validity_Domain>
<LONG_SCALE>0.1</LONG_SCALE><LONG_OFF>7</LONG_OFF><LAT_SCALE>0.1</LAT_SCALE><LAT_OFF>43</LAT_OFF>
<HEIGHT_SCALE>500</HEIGHT_SCALE><HEIGHT_OFF>600</HEIGHT_OFF>
<SAMP_SCALE>5000</SAMP_SCALE><SAMP_OFF>5000.5</SAMP_OFF>
<LINE_SCALE>6000</LINE_SCALE><LINE_OFF>6000.5</LINE_OFF>
</RFM_Validity></Global_RFM></Rational_Function_Model></Dimap_Document>
"""


def test_dimap_version_3_counts_from_its_first_column(tmp_path: Path) -> None:
    def values(factor: float) -> str:
        return "".join(f"<{key}_{i}>{factor if i == second else int(i == 1 and 'DEN' in key)}"
                       f"</{key}_{i}>"
                       for key, second in (("SAMP_NUM_COEFF", 2), ("SAMP_DEN_COEFF", 0),
                                           ("LINE_NUM_COEFF", 3), ("LINE_DEN_COEFF", 0))
                       for i in range(1, 21))

    path = tmp_path / "RPC.XML"
    path.write_text(DIMAP_3.format(wrong=values(7.0), right=values(1.0)))
    assert np.allclose(read_rpc(path).project([[7.0, 43.0, 600.0], [7.1, 43.1, 0.0]]),
                       [[6000.0, 5000.0], [12000.0, 10000.0]])
    path.write_text(path.read_text().replace("<FIRST_COL>0.5</FIRST_COL>", ""))
    with pytest.raises(TermselError, match="does not state the first column of its image"):
        read_rpc(path)


def _simple(**other: object) -> Rpc:
    """Return an RPC whose line and sample are -latitude and longitude, scaled."""
    one, lon, lat = ((0.0,) * i + (1.0,) + (0.0,) * (19 - i) for i in range(3))
    return replace(Rpc((100.0, 200.0), (50.0, 40.0), (10.0, 20.0, 300.0), (0.5, 0.25, 100.0),
                       tuple(-c for c in lat), one, lon, one), **other)


def test_by_hand() -> None:
    assert _simple().project([[10.5, 19.75, 0.0]]).tolist() == [[150.0, 240.0]]


def test_longitudes_of_either_side_of_the_date_line_are_one_place() -> None:
    rpc = _simple(ground_offset=(179.9, 20.0, 300.0))
    assert np.allclose(rpc.project([[-179.9, 20.0, 0.0]]), rpc.project([[180.1, 20.0, 0.0]]))
    slope = (1.0, 0.5) + (0.0,) * 18
    poles = replace(rpc, line_denominator=slope, sample_denominator=slope)
    for longitude in (-179.9, 180.1):  # X = 0.2 / 0.5
        below = poles.denominators(np.array([[longitude, 20.0, 0.0]]))
        np.testing.assert_allclose(below, [[1.2, 1.2]], rtol=1e-9)


@pytest.mark.parametrize(("values", "message"), [
    ({"error_bias": np.inf}, "the RPC's error bias is not finite"),
    ({"error_random": np.nan}, "the RPC's error random is not finite"),
    ({"image_offset": (1.0, 2.0, 3.0)}, "the image offset of the RPC has 3 values, expected 2"),
    ({"ground_scale": (1.0, 2.0)}, "the ground scale of the RPC has 2 values, expected 3")])
def test_values_of_an_rpc_are_finite_and_as_many_as_stated(
        values: dict[str, object], message: str) -> None:
    with pytest.raises(TermselError, match=message):
        _simple(**values)


@pytest.mark.parametrize("form", ["RPC.TXT", "RPB", "XML", "EnMAP", "PAM", "JSON", "YAML"])
@pytest.mark.parametrize("error", ["nan", ".nan", ".NaN", "NaN", "null", "None", "~", "N/A", "",
                                   "-1"])
def test_an_error_that_is_not_known_is_none(error: str, form: str, tmp_path: Path) -> None:
    path = tmp_path / "rpc"
    path.write_text(with_error_bias(form, error))
    assert read_rpc(path).error_bias is None
    path.write_text(with_error_bias(form, "2.5"))
    assert read_rpc(path).error_bias == 2.5


def test_an_error_that_json_states_as_nan_is_none(tmp_path: Path) -> None:
    path = tmp_path / "rpc.json"
    for error in (float("nan"), None):
        path.write_text(json.dumps({**rpc_items(some_rpc()), "ERR_BIAS": error}))
        assert read_rpc(path).error_bias is None


def with_error_bias(form: str, error: str) -> str:
    """Return an RPC in a form of files, with the text of its error bias."""
    items = {**rpc_items(some_rpc()), "ERR_BIAS": error}
    if form == "RPC.TXT":
        return rpc_txt_text(some_rpc()).replace("ERR_BIAS: -1.0", f"ERR_BIAS: {error}")
    if form == "RPB":
        return rpb_text(some_rpc()).replace("errBias = -1.0", f"errBias = {error}")
    if form == "XML":
        names = {name: rpb.upper() for name, rpb in (RPB_NAMES | ERROR_NAMES).items()}
        return "<isd>" + "".join(f"<{names[name]}>{value}</{names[name]}>"
                                 for name, value in items.items() if name in names) + "</isd>"
    if form == "EnMAP":
        return enmap(500.0).replace("<bandID number='1'>",
                                    f"<bandID number='1'><ERR_BIAS>{error}</ERR_BIAS>", 1)
    if form == "PAM":
        entries = "".join(f"<MDI key='{name}'>{value}</MDI>" for name, value in items.items())
        return f"<PAMDataset><Metadata domain='RPC'>{entries}</Metadata></PAMDataset>"
    if form == "JSON":
        return json.dumps(items)
    return orthority("a.tif").replace("    rpc:\n", f"    rpc:\n        err_bias: {error}\n")


@given(st.floats(0.01, 0.2), st.integers(0, 10**6))
def test_rays_meet_the_heights_they_are_seen_at(curvature: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = _simple()
    rpc = replace(base, **{name: tuple(np.array(getattr(base, name)) + curvature * np.append(
        0.0, rng.uniform(-0.1, 0.1, 19))) for name in (
            "line_numerator", "line_denominator", "sample_numerator", "sample_denominator")})
    ground = rng.uniform(-1.0, 1.0, (50, 3)) * rpc.ground_scale + rpc.ground_offset
    back = rpc.locate(rpc.project(ground), ground[:, 2])
    assert np.abs(back - ground).max() < 1e-9


def _oblique() -> Rpc:
    """Return an RPC that looks from the side: 100 m of height are 100 px."""
    height = (0.0, 0.0, 0.0, 2.0) + (0.0,) * 16
    base = _simple()
    return replace(base, line_numerator=tuple(map(sum, zip(base.line_numerator, height,
                                                           strict=True))))


@pytest.mark.parametrize("surface", [
    lambda xy: 300.0 + 80.0 * np.sin(40.0 * xy[:, 1]) * np.cos(30.0 * xy[:, 0]),
    lambda xy: 300.0 + 150.0 * np.abs(xy[:, 1] - 20.0),
    lambda xy: 250.0 + 90.0 * (xy[:, 1] > 20.0)], ids=["hills", "ridge", "cliff"])
def test_rays_meet_terrain(surface: Callable[[FloatArray], FloatArray]) -> None:
    rpc = _oblique()
    image = np.random.default_rng(1).uniform([80.0, 190.0], [120.0, 210.0], (300, 2))
    found = rpc.locate(image, surface)
    met = np.isfinite(found).all(axis=1)
    assert met.mean() > 0.7  # some rays meet the cliff's face, where there is no height
    assert np.abs(rpc.project(found[met]) - image[met]).max() < 1e-6
    assert np.abs(surface(found[met, :2]) - found[met, 2]).max() < 1e-3


def test_rays_that_miss_have_no_place() -> None:
    found = _oblique().locate([[100.0, 200.0]], lambda xy: np.full(len(xy), np.nan))
    assert np.isnan(found).all()


@pytest.mark.parametrize(("text", "message"), [
    ("", "the file is empty"),
    ("id,line,sample\n1,2,3\n", "this file has no RPC"),
    ("LINE_OFF: 12,5\n", "line 1: LINE_OFF is '12,5', which is not a number. Write a decimal"),
    (rpc_txt_text(_simple())[:900], "the RPC lacks LINE_DEN_COEFF_"),
    (rpc_txt_text(_simple()).replace("HEIGHT_SCALE: 100.0", "HEIGHT_SCALE: 0"),
     "the scale of height of the RPC is 0"),
    (rpc_txt_text(_simple()).replace("SAMP_OFF: 200.0", "SAMP_OFF: nan"), "is not finite"),
    (rpc_txt_text(_simple()).replace("SAMP_OFF: 200.0", "SAMP_OFF:"), "lacks SAMP_OFF"),
    (rpb_text(_simple())[:150], "the RPC lacks"),
    (rpb_text(_simple()).partition(")")[0], "the file breaks off within lineNumCoef. Fetch it"),
    (rpb_text(_simple()).replace("\t1.0,\n", "", 1), "LINE_DEN_COEFF has 19 numbers"),
    ("<Dimap_Document><Global", "this XML cannot be read"),
    ("<Dimap_Document></Dimap_Document>", "has no Global_RFM"),
    ("<VRTDataset/>", "<VRTDataset> has no RPC")])
def test_faults_are_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "fault.txt"
    path.write_text(text)
    with pytest.raises(TermselError) as caught:
        read_rpc(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("change", [
    lambda data: data.replace(b"\n", b"\r\n"), lambda data: b"\xef\xbb\xbf" + data,
    lambda data: data + b"\n\n", lambda data: data.replace(b"200.0", b"  +0200.0E+00 pixels")])
@pytest.mark.parametrize("write", [rpb_text, rpc_txt_text])
def test_what_editors_and_vendors_make_of_it(
        change: Callable[[bytes], bytes], write: Callable[[Rpc], str], tmp_path: Path) -> None:
    path = tmp_path / "rpc"
    path.write_bytes(change(write(_simple()).encode()))
    assert read_rpc(path) == _simple()


def test_other_encodings(tmp_path: Path) -> None:
    path = tmp_path / "rpc"
    path.write_text(rpc_txt_text(_simple()), encoding="utf-16")
    assert read_rpc(path) == _simple()
    path.write_bytes(rpc_txt_text(_simple()).encode() + b" 5\xb0")
    assert read_rpc(path) == _simple()
    path.write_bytes(rpc_txt_text(_simple()).encode() + b"\x81")
    with pytest.raises(TermselError, match="not UTF-8"):
        read_rpc(path)


def test_an_image_without_rpc_and_one_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="has no RPC"):
        read_rpc(_empty_image(tmp_path / "a.tif"))
    (tmp_path / "b.tif").write_bytes((tmp_path / "a.tif").read_bytes()[:60])
    with pytest.raises(TermselError, match="GDAL cannot read"):
        read_rpc(tmp_path / "b.tif")


WHOLE = [rpb_text(_simple()).encode(), rpc_txt_text(_simple()).encode(),
         vrt_text(Picture((8, 8)), Path(), domains={"RPC": rpc_items(_simple())}).encode(),
         DIMAP_3.format(wrong="", right="").encode()]


@given(st.sampled_from(WHOLE), st.integers(0, 3000), st.integers(0, 40),
       st.binary(max_size=20) | st.text("0123456789.,;:=()<>/eE-+_ \n\tLINE_OFF", max_size=20).map(
           str.encode))
def test_whatever_is_cut_out_and_put_in_the_message_is_one(
        whole: bytes, place: int, gone: int, put: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rpc"
        path.write_bytes(whole[:place] + put + whole[place + gone:])
        try:
            rpc = read_rpc(path)
        except TermselError as error:
            assert str(path) in str(error)  # noqa: PT017
        else:
            assert np.isfinite(rpc.line_numerator).all()


numbers = st.floats(-1e6, 1e6, allow_nan=False)
twenty = st.tuples(*[numbers] * 20)


@given(st.builds(
    Rpc, st.tuples(numbers, numbers), st.tuples(*[st.floats(1e-3, 1e6)] * 2),
    st.tuples(numbers, numbers, numbers), st.tuples(*[st.floats(1e-3, 1e6)] * 3),
    twenty, twenty.filter(any), twenty, twenty.filter(any), st.none() | st.floats(0, 1e3),
    st.none() | st.floats(0, 1e3)))
def test_text_keeps_every_digit(rpc: Rpc) -> None:
    with TemporaryDirectory() as folder:
        for write in (rpb_text, rpc_txt_text):
            path = Path(folder) / "rpc"
            path.write_text(write(rpc))
            assert read_rpc(path) == rpc


OTHER_FORMS = {
    "METADATA.XML": "<level_X><specific><RPC><bandID number='1'><ROW_OFF>511.5</ROW_OFF><COL_OFF>"
                    "499</COL_OFF><LAT_OFF>48</LAT_OFF></bandID></RPC></specific></level_X>",
    "JAX_004.json": '{"img": "JAX_004.tif", "rpc": {"rowOffset": 1, "colNum": [1, 2]}}',
    "rpc_param.yaml": "qb2.tif:\n  cam_type: rpc\n  rpc:\n    height_off: 14\n    line_off: 4\n",
    "scene.geom": "line_den_coeff_00:  1\nlat_off:  30.2\n"}


@pytest.mark.parametrize("name", OTHER_FORMS)
def test_an_rpc_in_a_form_that_is_not_read_is_not_denied(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(OTHER_FORMS[name])
    with pytest.raises(TermselError, match="in a form that termsel does not read") as caught:
        read_rpc(path)
    assert "has no RPC" not in str(caught.value)
    assert "_RPC.TXT" in str(caught.value)


def some_rpc(line: float = 500.0) -> Rpc:
    rng = np.random.default_rng(3)
    numerators = rng.normal(0.0, 1e-4, (2, 20))
    numerators[0, 2] = -1.0
    numerators[1, 1] = 1.0
    denominators = rng.normal(0.0, 1e-6, (2, 20))
    denominators[:, 0] = 1.0
    (a, c), (b, d) = numerators.tolist(), denominators.tolist()
    return Rpc((line, 400.25), (510.0, 410.0), (11.0, 48.0, 600.0), (0.2, 0.15, 500.0),
               tuple(a), tuple(b), tuple(c), tuple(d))


def named_numbers(rpc: Rpc, words: dict[str, str], *, numbered: str = "") -> dict[str, object]:
    """Return the numbers of an RPC by the names of another program."""
    items = rpc_items(rpc)
    found: dict[str, object] = {}
    for name, word in words.items():
        numbers = [float(text) for text in items[name].split()]
        if numbered and len(numbers) > 1:
            found |= {f"{word}{numbered}{i}": number for i, number in enumerate(numbers, 1)}
        else:
            found[word] = numbers if len(numbers) > 1 else numbers[0]
    return found


GDAL_NAMES = [name for name in rpc_items(some_rpc()) if not name.startswith("ERR")]
ROWS = {name: name.replace("LINE", "ROW").replace("SAMP", "COL").replace("COEFF", "COEF")
        for name in GDAL_NAMES}
RPCM = {name: name.lower().replace("line", "row").replace("samp", "col").replace("_coeff", "")
        .replace("_off", "_offset").replace("long", "lon").replace("height", "alt")
        for name in GDAL_NAMES}
VISSAT = {name: (head := word.split("_"))[0] + "".join(part.capitalize() for part in head[1:])
          for name, word in RPCM.items()}


def enmap(*lines: float) -> str:
    bands = "".join(
        f"<bandID number='{number}'>" + "".join(
            f"<{name}>{value!r}</{name}>" for name, value in named_numbers(
                some_rpc(line), ROWS, numbered="_").items()) + "</bandID>"
        for number, line in enumerate(lines, 1))
    return (f"<level_X><product><navigation><RPC>{bands}</RPC></navigation></product>"
            "<specific><bandCharacterisation><bandID number='1'><GainOfBand>1</GainOfBand></bandID>"
            "</bandCharacterisation></specific></level_X>")


def orthority(*names: str) -> str:
    numbers = named_numbers(some_rpc(), {name: name.lower() for name in GDAL_NAMES})
    text = "# RPC parameters\n"
    for name in names:
        text += f"{name}:\n    im_size: [990, 1650]\n    rpc:\n"
        for key, value in numbers.items():
            cells = str(value)
            middle = cells.find(", ", len(cells) // 2)
            if middle > 0:
                cells = f"{cells[:middle + 1]}\n            {cells[middle + 2:]}"
            text += f"        {key}: {cells}\n"
    return text


NESTED = {
    "METADATA.XML": enmap(500.0),
    "JAX_004.json": json.dumps({"img": "JAX_004.tif", "width": 2048, "rpc": named_numbers(
        some_rpc(), RPCM)}),
    "metas.json": json.dumps({"a.tif": {"rpc": named_numbers(some_rpc(), VISSAT)}}),
    "gdal.json": json.dumps(rpc_items(some_rpc())),
    "rpc_param.yaml": orthority("qb2_basic1b.tif"),
    "unknown_errors.yaml": orthority("a.tif").replace(
        "    rpc:\n", "    rpc:\n        err_bias: null\n"),
    "unknown_errors.json": json.dumps({**rpc_items(some_rpc()), "ERR_BIAS": None}),
    "items_a_line.yaml": re.sub(r"\[([^\]]{100,})\]", lambda values: "".join(
        f"\n        - {value.strip()}" for value in values[1].split(",")), orthority("a.tif"))}


@pytest.mark.parametrize("name", NESTED)
def test_nested_files_are_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(NESTED[name])
    assert replace(read_rpc(path), source="") == replace(some_rpc(), source="")


def test_of_an_rpc_a_band_that_in_the_middle_is_taken_and_said(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "METADATA.XML"
    path.write_text(enmap(500.0, 500.25, 500.75))
    assert read_rpc(path).image_offset[0] == 500.25
    assert "an RPC for each of 3 bands. That of band 2 is taken" in caplog.text
    assert "up to 0.5 px" in caplog.text
    assert read_rpc(f"{path}#3").image_offset[0] == 500.75
    with pytest.raises(TermselError, match="no RPC of '9', but of the bands 1, 2, 3"):
        read_rpc(f"{path}#9")


def test_of_rpcs_of_several_images_one_must_be_named(tmp_path: Path) -> None:
    path = tmp_path / "rpc_param.yaml"
    path.write_text(orthority("a.tif", "b.tif"))
    with pytest.raises(TermselError, match=r"RPCs of the images a\.tif, b\.tif") as caught:
        read_rpc(path)
    assert "FILE#a.tif" in str(caught.value)
    assert read_rpc(f"{path}#b.tif").image_offset == (500.0, 400.25)


def test_an_rpc_in_the_tags_of_each_band_is_read(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", width=20, height=10, count=2,
                       dtype="uint8") as raster:
        for band, line in ((1, 500.0), (2, 501.0)):
            raster.update_tags(band, **rpc_items(some_rpc(line)))
    assert read_rpc(path).image_offset[0] == 501.0
    assert read_rpc(f"{path}#1").image_offset[0] == 500.0


@pytest.mark.parametrize("text", [
    "a" + " " * 300_000 + "b", "a: [\n" + "1,\n" * 100_000, "a:\n" * 50_000, "[" * 90_000,
    "".join(f"{' ' * i}a:\n" for i in range(600))])
def test_hostile_text_is_refused_at_once(text: str, tmp_path: Path) -> None:
    path = tmp_path / "rpc.yaml"
    path.write_text(text)
    started = process_time()
    with pytest.raises(TermselError):
        read_rpc(path)
    assert process_time() - started < 5.0
