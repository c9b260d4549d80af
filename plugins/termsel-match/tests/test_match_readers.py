"""Readers of matches of other programs."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

from termsel import FeatureSet, Points, TermselError, read
from termsel.testing import check, checks
from termsel_match.asp import AspMatches
from termsel_match.images.starts import Start, start_by_points
from termsel_match.points.readers import ArosicsTable, MatchesCsv

# As GeoPandas saves the table: with an index, the geometry as text, and all columns.
AROSICS = """,geometry,POINT_ID,X_IM,Y_IM,X_MAP,Y_MAP,REF_BADDATA,X_WIN_SIZE,Y_WIN_SIZE,X_SHIFT_PX,\
Y_SHIFT_PX,X_SHIFT_M,Y_SHIFT_M,ABS_SHIFT,ANGLE,SSIM_BEFORE,SSIM_AFTER,SSIM_IMPROVED,RELIABILITY,\
LAST_ERR,L1_OUTLIER,L2_OUTLIER,L3_OUTLIER,OUTLIER
0,POINT (439000 5228000),7,100,200,439000.0,5228000.0,False,256,256,1.5,1.0,3.0,-2.0,3.606,304,0.7,\
0.9,True,88.1,,False,False,False,False
1,POINT (439400 5228000),8,300,200,439400.0,5228000.0,False,-9999,-9999,-9999,-9999,-9999,-9999,\
-9999,-9999,-9999,-9999,-9999,-9999,"RuntimeError('Poor match, no shift.')",-9999,-9999,-9999,-9999
2,POINT (439400 5227600),9,300,400,439400.0,5227600.0,False,256,256,9.5,1.0,19.0,-2.0,19.1,276,0.5,\
0.6,True,31.0,,True,True,True,True
"""
ASP = """2 2
20.5 10.25 20 10 0.1 1.0 0.5 1 0 0 0
40.0 30.0 40 30 0.1 1.0 0.5 1 0 0 0
5.0 6.0 5 6 0.1 1.0 0.5 1 0 0 0
7.0 9.0 7 9 0.1 1.0 0.5 1 0 0 0
"""


def _binary(width: str) -> bytes:
    """Return the matches of ASP as VisionWorkbench writes them: records without gaps."""
    records = [line.split() for line in ASP.splitlines()[1:]]
    return struct.pack("<2Q", 2, 2) + b"".join(struct.pack(
        f"<2f2i3f?2IQ3{width}", float(x), float(y), int(ix), int(iy), 0.1, 1, 0.5, True, 0, 0, 3,
        0.1, 0.2, 0.3) for x, y, ix, iy, *_ in records)


MATCHES = """id,image_line,image_sample,reference_line,reference_sample,sigma
a,10.25,20.5,6,5,0.2
b,30,40,9,7,0.3
"""


CHECKS = checks(ArosicsTable, content=AROSICS.encode(), expected=FeatureSet(Points(
    ("A7", "A9"), np.array([[199.5, 99.5], [399.5, 299.5]]),
    np.array([[439003, 5227998, np.nan], [439419, 5227598, np.nan]]), None, ("", "off")),
    crs=""), filename="tie_points.csv")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_conforms(check: Any) -> None:
    check.run()


@pytest.mark.parametrize(("reader", "content"), [
    (AspMatches, ASP.encode()), (AspMatches, _binary("f")), (AspMatches, _binary("d")),
    (MatchesCsv, MATCHES.encode())], ids=["asp", "asp-binary", "asp-binary-64", "csv"])
def test_conforms_with_its_reference(place: Any, reader: Any, content: bytes) -> None:
    west, north = place.world.corner
    points = Points(("a", "b") if reader is MatchesCsv else ("M001", "M002"),
                    np.array([[10.25, 20.5], [30, 40]]),
                    np.array([[west + 5.5, north - 6.5, np.nan],
                              [west + 7.5, north - 9.5, np.nan]]),
                    np.array([[0.2, 0.2], [0.3, 0.3]]) if reader is MatchesCsv else None)
    check(reader(reference=str(place / "ortho.tif")), content=content,
          expected=FeatureSet(points, crs="EPSG:32633"))


@pytest.fixture
def file(tmp_path: Path) -> Any:
    def write(text: str) -> Path:
        (tmp_path / "matches.txt").write_text(text)
        return tmp_path / "matches.txt"

    return write


def test_arosics_shifts_the_map_and_counts_from_the_corner(file: Any) -> None:
    features = read(file(AROSICS), crs="EPSG:32633")
    assert features.points.ids == ("A7", "A9")
    assert features.points.roles == ("", "off")
    assert features.points.image.tolist() == [[199.5, 99.5], [399.5, 299.5]]
    assert features.points.ground[:, :2].tolist() == [[439003, 5227998], [439419, 5227598]]


@pytest.mark.parametrize("text", [ASP, MATCHES], ids=["asp", "csv"])
def test_pixels_of_the_reference_become_coordinates(place: Any, file: Any, text: str) -> None:
    features = read(file(text), reference=str(place / "ortho.tif"), dem=place / "dem.tif")
    west, north = place.world.corner
    assert features.points.image.tolist() == [[10.25, 20.5], [30, 40]]
    assert np.allclose(features.points.ground[:, :2],
                       [[west + 5.5, north - 6.5], [west + 7.5, north - 9.5]])
    assert np.isfinite(features.points.ground[:, 2]).all()
    assert features.crs == "EPSG:32633"


def test_other_names_of_columns_are_recognised(place: Any, file: Any) -> None:
    features = read(file("x1,y1,x2,y2\n20.5,10.25,5,6\n"), reference=str(place / "ortho.tif"))
    assert features.points.image.tolist() == [[10.25, 20.5]]
    table = "id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2\na,1,2,3,4,5,6,7,8,9,1\n"
    assert not MatchesCsv().sniff(Path("lines.csv"), table.encode())


@pytest.mark.parametrize(("text", "format", "reason"), [
    (MATCHES, None, "the reference is needed"),
    (MATCHES.replace("30", "thirty"), None, "line 3, column 'image_line': 'thirty' is not"),
    (ASP.replace("2 2\n", "3 3\n"), "asp-match", "announces 3 matches"),
    (ASP.replace("7.0 9.0", "seven 9.0"), None, "line 5: this row is not an interest point"),
    (AROSICS.replace("7,100,200", "7,x,200"), None, "line 2, column 'X_IM': 'x' is not a number"),
    ("POINT_ID,X_IM\n1,2\n", "arosics-csv", "no column Y_IM"),
    ("", "matches-csv", "empty"),
    (MATCHES + "9" * 200_000, None, "line 4: this row cannot be read"),
    (ASP.replace("2 2\n", f"{'9' * 5000} {'9' * 5000}\n"), "asp-match", "announces 999"),
], ids=range(9))
def test_what_is_wrong_is_said_with_its_place(file: Any, text: str, format: str | None,
                                              reason: str) -> None:
    with pytest.raises(TermselError) as caught:
        read(file(text), crs="EPSG:32633", format=format or ())
    assert reason in str(caught.value)


@pytest.mark.parametrize(("height", "said"), [
    (1740.0, "1,132 m above the heights that the RPC of image.tif is made for (median 1,740 m, "
             "432 to 608 m); feet and metres?"),
    (290.0, "142 m below the heights that the RPC of image.tif is made for (median 290 m, "
            "432 to 608 m); geoid and ellipsoid?"), (580.0, ""), (400.0, "")])
def test_a_dem_is_held_against_the_heights_of_an_rpc(
        tmp_path: Path, height: float, said: str, caplog: pytest.LogCaptureFixture) -> None:
    with rasterio.open(tmp_path / "dem.tif", "w", driver="GTiff", width=5, height=5, count=1,
                       dtype="float64", crs="EPSG:4326",
                       transform=rasterio.transform.from_origin(9.0, 45.1, 0.02, 0.02)) as raster:
        raster.write(np.full((5, 5), height), 1)
    start = Start("the RPC of image.tif", "EPSG:4979", 520.0, lambda ground: ground[:, :2],
                  lambda image, _: image, heights=(432.0, 608.0),
                  places=np.array([[9.03, 45.03], [9.05, 45.05], [20.0, 45.0]]))
    start.warn_if_dem_contradicts(tmp_path / "dem.tif")
    assert said in caplog.text
    assert bool(said) == bool(caplog.text)


@pytest.mark.parametrize(("above", "said"), [(-48.6, "below the control"), (0.3, "")])
def test_a_dem_is_held_against_the_control_of_the_start(
        tmp_path: Path, above: float, said: str, caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(1)
    lonlat = np.column_stack([rng.uniform(9.01, 9.09, 8), rng.uniform(45.01, 45.09, 8)])
    heights = 300 + 4000 * (lonlat[:, 0] - 9.0)
    row, column = np.mgrid[:100, :100] + 0.5
    values = 300 + 4000 * 0.001 * column + above + 0 * row
    with rasterio.open(tmp_path / "dem.tif", "w", driver="GTiff", width=100, height=100, count=1,
                       dtype="float64", crs="EPSG:4326",
                       transform=rasterio.transform.from_origin(9.0, 45.1, 0.001, 0.001)) as raster:
        raster.write(values, 1)
    ground = np.column_stack([lonlat, heights])
    image = (lonlat - [9.0, 45.0])[:, ::-1] * 1e4
    features = FeatureSet(Points(tuple("abcdefgh"), image, ground), crs="EPSG:4979")
    start = start_by_points(features, "the points")
    start.warn_if_dem_contradicts(tmp_path / "dem.tif")
    assert said in caplog.text
    assert bool(said) == ("geoid and ellipsoid?" in caplog.text)


def test_a_reference_says_what_its_pixels_are(file: Any, tmp_path: Path) -> None:
    with rasterio.open(tmp_path / "wide.tif", "w", driver="GTiff", width=400_000, height=4, count=1,
                       dtype="uint8", crs="EPSG:32632",
                       transform=rasterio.transform.from_origin(6e5, 5e6, 1.0, 1.0)):
        pass
    header = "x0,y0,x1,y1,confidence\n20.5,10.25,"
    wide = str(tmp_path / "wide.tif")
    features = read(file(f"{header}300000.0,2.0,0.9\n"), reference=wide)
    assert features.points.ground[0, 0] == pytest.approx(6e5 + 300000.5)
    with pytest.raises(TermselError, match=r"beyond the reference wide\.tif"):
        read(file(f"{header}616287.6,5179799.8,0.9\n"), reference=wide)


def test_second_places_on_the_ground_are_read_as_points(file: Any) -> None:
    path = file("x0,y0,x1,y1,confidence\n20.5,10.25,616287.6,5179799.8,0.9\n")
    with pytest.raises(TermselError, match="x1 and y1 are beyond any image") as error:
        read(path)
    assert "columns='sample=x0,line=y0,x=x1,y=y1'" in str(error.value)


def test_a_match_outside_the_image_is_left_out_with_its_line(
        place: Any, file: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    image = tmp_path / "image.tif"
    with rasterio.open(image, "w", driver="GTiff", height=40, width=40, count=1,
                       dtype="uint8") as raster:
        raster.write(np.ones((1, 40, 40), dtype=np.uint8))
    rows = [f"{i},{2 * i},{i},{i + 1}" for i in range(1, 13)]
    header = "image_line,image_sample,reference_line,reference_sample"
    rows[4] = "15.1,-21.2,7,7"
    table = file("\n".join([header, *rows]))
    with caplog.at_level("WARNING", "termsel.match"):
        features = read(table, reference=str(place / "ortho.tif"), image=image)
    assert len(features) == 11
    assert "M005" not in features.ids
    assert "1 of 12 matches is outside the image and left out: line 6 of the file." in caplog.text
    # Of another image many are outside, and that is no slip of a matcher.
    table = file("\n".join([header, *rows[4:7]]))
    with pytest.raises(TermselError, match="before the first pixel"):
        read(table, reference=str(place / "ortho.tif"), image=image)
