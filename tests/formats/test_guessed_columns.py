"""Tables that do not name their columns: no reading without a word, and every guess is called one.

Forty tables: the four or five columns permuted, in degrees and metres, with and without heights,
with ids, flags and constants. The true reading is always among those shown.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.formats.readers.json_records import PointsJson
from termsel.testing import check

N = 9
_rng = np.random.default_rng(11)
SAMPLE = np.round(_rng.uniform(0, 3000, N), 1)
LINE = np.round(_rng.uniform(0, 2000, N), 1)
METRES = {"x": np.round(400000 + 2 * SAMPLE + _rng.normal(0, 1, N), 2),
          "y": np.round(5000000 - 2 * LINE + _rng.normal(0, 1, N), 2)}
DEGREES = {"x": np.round(-71.2 + 2e-5 * SAMPLE, 7), "y": np.round(42.4 - 2e-5 * LINE, 7)}
COLUMNS = {"sample": SAMPLE, "line": LINE, "z": np.round(_rng.uniform(200, 260, N), 1),
           "flag": np.array([1, 1, 0] * 3), "count": np.arange(1, N + 1), "zero": np.zeros(N)}
ORDERS = ("sample line x y", "line sample x y", "x y sample line", "x y line sample",
          "y x sample line", "y x line sample", "sample line y x", "line sample y x",
          "count sample line x y", "count x y sample line", "count y x line sample",
          "sample line x y z", "x y z sample line", "y x z line sample", "line sample x y z",
          "count x y z sample line", "sample line x y flag", "x y sample line flag",
          "count sample line x y zero", "sample line x y z flag")
TABLES = [(order, kind) for order in ORDERS for kind in ("metres", "degrees")]


def test_lines_that_may_count_upwards_are_said(tmp_path: Path) -> None:
    table = np.column_stack([SAMPLE, 2000.0 - LINE, METRES["x"], METRES["y"]])
    np.savetxt(tmp_path / "links.txt", table, fmt="%.2f")
    with pytest.raises(TermselError, match="first point would be line") as caught:
        termsel.read(tmp_path / "links.txt", crs="EPSG:32619")
    # Read so, they are no mirror image; but most programs write samples first.
    assert caught.value.guesses[0] == "line=1,sample=2,x=3,y=4"
    assert ("count upwards from the lower edge: columns='line=2,sample=1,x=3,y=4' "
            "image_origin='bottom-left") in str(caught.value)


def test_a_column_of_zeros_is_no_flag_and_a_name_of_an_image_no_id(tmp_path: Path) -> None:
    columns = (METRES["x"], METRES["y"], SAMPLE, LINE)
    rows = [" ".join([f"img_{i}.jpg 0", *(f"{cell:.2f}" for cell in cells)])
            for i, cells in enumerate(zip(*columns, strict=True))]
    (tmp_path / "table.txt").write_text("\n".join(rows))
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(tmp_path / "table.txt", crs="EPSG:32619")
    for guess in caught.value.guesses:
        assert not {"id", "enabled"} & {pair.partition("=")[0] for pair in guess.split(",")}


@pytest.mark.parametrize(("order", "kind"), TABLES)
def test_every_guess_is_called_a_guess(order: str, kind: str, tmp_path: Path) -> None:
    known = COLUMNS | (METRES if kind == "metres" else DEGREES)
    names = order.split()
    rows = zip(*(known[name].tolist() for name in names), strict=True)
    path = tmp_path / "table.txt"
    path.write_text("\n".join(" ".join(f"{value:.10g}" for value in row) for row in rows))
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(path, crs="EPSG:32619" if kind == "metres" else "EPSG:4326")
    error = caught.value
    assert error.guesses
    assert error.options["--columns"] == error.guesses[0]
    true = {f"{name}={names.index(name) + 1}" for name in ("line", "sample", "x", "y")}
    shown = [true <= set(guess.split(",")) for guess in error.guesses]
    assert any(shown), (error.guesses, true)
    assert f"sample {known['sample'][0]:.10g}" in str(error)
    for guess in error.guesses:  # a flag is no height, nor is a column of zeros
        for name in ("flag", "zero"):
            if name in names:
                assert f"z={names.index(name) + 1}" not in guess.split(",")


def test_pixels_next_to_degrees_are_read(tmp_path: Path) -> None:
    """Tables of MapWarper: x and y are pixels where lon and lat stand next to them."""
    (tmp_path / "a.csv").write_text("id,map_id,x,y,lat,lon\n1,52,1145,825,53.38,-2.90\n"
                                    "2,52,1028,857,53.39,-2.91\n3,52,905,977,53.37,-2.92\n")
    points = termsel.read(tmp_path / "a.csv", crs="EPSG:4326").points
    assert points.image.tolist() == [[825, 1145], [857, 1028], [977, 905]]
    assert points.ground[:, :2].tolist() == [[-2.90, 53.38], [-2.91, 53.39], [-2.92, 53.37]]
    (tmp_path / "b.csv").write_text("id,x,y,lon,lat\n1,448000.5,5262000,8.3,47.5\n"
                                    "2,448100,5262900,8.31,47.51\n")
    with pytest.raises(TermselError, match="x and y are no pixels, and there are no other"):
        termsel.read(tmp_path / "b.csv", crs="EPSG:4326")


def test_primed_columns_of_the_image_are_offered(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id;x;y;h;x';y'\n1;497304.75;3999053.32;270.74;142.70;1825.92\n"
                    "2;498002.82;4002512.51;740.22;799.44;143.78\n")
    with pytest.raises(TermselError, match="x' and y' look like pixels") as caught:
        termsel.read(path, crs="EPSG:32631")
    (columns,) = re.findall('columns="(.*)"', str(caught.value))
    points = termsel.read(path, crs="EPSG:32631", columns=columns).points
    assert points.image.tolist() == [[1825.92, 142.70], [143.78, 799.44]]
    assert points.ground[0].tolist() == [497304.75, 3999053.32, 270.74]


def test_the_crs_in_a_first_line_is_no_header(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(
        "+proj=utm +zone=33 +ellps=WGS84 +datum=WGS84 +units=m +no_defs\n" + "".join(
            f"gcp{i} {x:.2f} {y:.2f} {z} {sample} {line}\n" for i, (x, y, z, sample, line)
            in enumerate(zip(METRES["x"], METRES["y"], COLUMNS["z"], SAMPLE, LINE, strict=True))))
    with pytest.raises(TermselError, match="its first line is the CRS EPSG:32633") as caught:
        termsel.read(tmp_path / "a.txt")
    assert caught.value.guesses[0] == "id=1,line=6,sample=5,x=2,y=3,z=4"
    # The command that is shown runs: the line counts as a comment.
    read = termsel.read(tmp_path / "a.txt", columns=caught.value.guesses[0])
    assert read.crs == "EPSG:32633"
    assert len(read.points) == N


@pytest.mark.parametrize(("first_line", "crs"), [
    ("WGS84 UTM 33N", "EPSG:32633"), ("UTM zone 33N, WGS84", ""), ("32633", "")])
def test_only_a_crs_that_is_known_is_taken_from_a_first_line(tmp_path: Path, first_line: str,
                                                             crs: str) -> None:
    # A number may count the points, as in tables of other programs.
    path = tmp_path / "a.txt"
    path.write_text(f"{first_line}\n" + "".join(
        f"g{i} {x} {y} {sample} {line}\n" for i, (x, y, sample, line)
        in enumerate(zip(METRES["x"], METRES["y"], SAMPLE, LINE, strict=True))))
    read = termsel.read(path, columns="id=1,x=2,y=3,sample=4,line=5",
                        crs="EPSG:32633" if not crs else None)
    assert read.crs == "EPSG:32633"
    assert len(read.points) == N


def test_a_title_of_several_lines_is_called_so(tmp_path: Path,
                                               caplog: pytest.LogCaptureFixture) -> None:
    rows = zip(SAMPLE, LINE, METRES["x"], METRES["y"], strict=True)
    path = tmp_path / "a.csv"
    path.write_text("points of\nJune\n" + "".join(
        ",".join(map(str, row)) + "\n" for row in rows))
    with caplog.at_level("INFO"):
        termsel.read(path, crs="local", columns="sample=1,line=2,x=3,y=4")
    assert "2 lines above the points left out as a title: points of June" in caplog.text


def test_a_title_is_no_row_and_a_repeated_text_no_id(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("points of June\n" + "".join(
        f"photo.jpg {sample} {line} {x} {y} G{i} 1.0\n" for i, (sample, line, x, y) in enumerate(
            zip(SAMPLE, LINE, METRES["x"], METRES["y"], strict=True))))
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(path, crs="EPSG:32619")
    assert caught.value.guesses[0] == "id=6,enabled=7,line=3,sample=2,x=4,y=5"
    for guess in caught.value.guesses:
        assert len(termsel.read(path, crs="local", columns=guess).points) == N


SCORES = np.round(_rng.uniform(0.2, 1.0, N), 4)
RESIDUALS = np.round(_rng.normal(0.0, 1.0, (2, N)), 3)
HEADED = {
    # Names of the ground and of the image beside plain x and y, in many tongues and manners.
    "X,Y,E,N": ("sample line x y", True), "lat,lng,x,y": ("y x sample line", True),
    "name,X,Y,Z,x,y": ("count x y z sample line", False), "x,y,x,y": ("sample line x y", False),
    "x,y,x.1,y.1": ("sample line x y", False), "x,y,map x,map y": ("sample line x y", False),
    "Long,Lat,Col,Lin": ("x y sample line", True), "u,v,X,Y": ("sample line x y", False),
    "A,B,C,D": ("sample line x y", False), ",0,1,2,3": ("count sample line x y", False),
    "0,1,2,3": ("sample line x y", False), "a,b,c,d,score": ("sample line x y score", False),
    "a,b,score,c,d": ("x y score sample line", False),
    "h,east,north,c1,c2": ("z x y sample line", False),
    "p,q,r,s,dx,dy": ("sample line x y dx dy", False)}
"""Headers with the columns below them, and whether they tell all of these."""


@pytest.mark.parametrize("header", HEADED)
def test_misleading_headers_never_give_a_wrong_reading_in_silence(header: str,
                                                                  tmp_path: Path) -> None:
    order, is_told = HEADED[header]
    known = COLUMNS | METRES | {"score": SCORES, "dx": RESIDUALS[0], "dy": RESIDUALS[1]}
    names = order.split()
    rows = zip(*(known[name].tolist() for name in names), strict=True)
    path = tmp_path / "table.csv"
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]))
    crs = "local" if "lat" in header.lower() else "EPSG:32619"
    if is_told:
        readings = [termsel.read(path, crs=crs)]
    else:
        with pytest.raises(TermselError) as caught:
            termsel.read(path, crs=crs)
        # All that is shown can be read, or nothing was found.
        readings = [termsel.read(path, crs=crs, columns=guess) for guess in caught.value.guesses]
        assert readings
    right = []
    for features in readings:
        points = features.points
        right.append(points.image.tolist() == np.column_stack([LINE, SAMPLE]).tolist()
                     and points.ground[:, :2].tolist() == np.column_stack(
                         [METRES["x"], METRES["y"]]).tolist())
        assert np.isnan(points.ground[:, 2]).all() or (points.ground[:, 2] == COLUMNS["z"]).all()
    assert right[0] or (header == "u,v,X,Y" and any(right))


def test_lines_upwards_are_part_of_the_command(tmp_path: Path, call: Callable[..., Any]) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id,a,b,c,d\n" + "".join(f"G{i},{sample},{-line},{x},{y}\n" for i, (
        sample, line, x, y) in enumerate(zip(SAMPLE, LINE, METRES["x"], METRES["y"],
                                             strict=True))))
    shown = call("run", "--points", path, "--crs", "EPSG:32619").stderr
    command = shown.partition("A guess, to check: termsel ")[2]
    assert "--set image_origin=y-up" in command
    done = call(*shlex.split(command), "--quiet")
    assert done.exit_code == 0, done.stderr


def test_no_guess_puts_map_coordinates_into_an_image(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("".join(f"{sample} {x} {line} {y}\n" for sample, line, x, y in zip(
        SAMPLE, LINE, METRES["x"], METRES["y"], strict=True)))
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(path, crs="EPSG:32619")
    assert caught.value.guesses == ["line=3,sample=1,x=2,y=4"]


ROUGH = np.round(_rng.uniform(2, 40, N))
DATES = np.array([20190300 + day for day in range(3, 3 + N)])
EASTING, NORTHING = (METRES[axis] for axis in "xy")
BESIDE = COLUMNS | METRES | {"lon": DEGREES["x"], "lat": DEGREES["y"], "few": ROUGH, "date": DATES}


def shown_for(folder: Path, header: str, order: str, crs: str) -> TermselError:
    """Return the error of a table, all of whose guesses can be read; `header` may be ""."""
    path = folder / "table.csv"
    rows = zip(*(BESIDE[name].tolist() for name in order.split()), strict=True)
    path.write_text("\n".join([*filter(None, [header]), *(
        ",".join(f"{value:.10g}" for value in row) for row in rows)]))
    with pytest.raises(TermselError) as caught:
        termsel.read(path, crs=crs)
    for guess in caught.value.guesses:
        assert len(termsel.read(path, crs=crs, columns=guess).points) == N
    return caught.value


@pytest.mark.parametrize("crs", ["EPSG:32619", "EPSG:4326"])
@pytest.mark.parametrize(("header", "order"), [
    ("Easting,Latitude,Northing,Longitude,row,col", "x lat y lon line sample"),
    ("Breite,col,Ostwert,Hochwert,row,Länge", "lat sample x y line lon"),
    ("y,x,Easting,Northing,Longitude,Latitude", "line sample x y lon lat"),
    ("lat,y,N,x,E,lon", "lat line y sample x lon")])
def test_two_pairs_of_the_ground_are_never_mixed(header: str, order: str, crs: str,
                                                 tmp_path: Path) -> None:
    guess, *others = shown_for(tmp_path, header, order, crs).guesses
    name_of = dict(zip(order.split(), header.split(","), strict=True))
    axes = ("x", "y") if crs == "EPSG:32619" else ("lon", "lat")
    expected = {f"{meaning}={name_of[name]}" for meaning, name in zip(
        ("line", "sample", "x", "y"), ("line", "sample", *axes), strict=True)}
    assert set(guess.split(",")) == expected
    assert not others


@pytest.mark.parametrize(("order", "crs"), [
    ("lat sample line lon z", "EPSG:4326"), ("lat sample lon line", "EPSG:4326"),
    ("lon z line sample lat", "EPSG:4326"), ("x sample y line z", "EPSG:32619"),
    ("z x line sample y flag", "EPSG:32619"), ("line lat sample count lon", "EPSG:4326")])
def test_ranges_tell_the_ground_where_pairs_are_apart(order: str, crs: str,
                                                      tmp_path: Path) -> None:
    names = order.split()
    guesses = shown_for(tmp_path, "", order, crs).guesses
    x, y = ("lon", "lat") if crs == "EPSG:4326" else ("x", "y")
    true = {f"{meaning}={names.index(name) + 1}" for meaning, name in (
        ("line", "line"), ("sample", "sample"), ("x", x), ("y", y))}
    assert any(true <= set(guess.split(",")) for guess in guesses), guesses


@pytest.mark.parametrize(("header", "order"), [
    ("a,b,c,d,e,f,g", "x line y sample flag count z"), ("a,b,c,d,e", "sample line x y flag"),
    ("nr,a,b,c,d,e,f,g,h", "count zero sample line zero x y z flag"),
    ("D,E,F,G,H", "flag sample line x y")])
def test_letters_that_count_the_columns_are_no_names(header: str, order: str,
                                                     tmp_path: Path) -> None:
    names = header.split(",")
    error = shown_for(tmp_path, header, order, "EPSG:32619")
    true = {f"{meaning}={names[order.split().index(meaning)]}"
            for meaning in ("line", "sample", "x", "y")}
    assert any(true <= set(guess.split(",")) for guess in error.guesses), error.guesses
    flag = names[order.split().index("flag")]
    for guess in error.guesses:
        assert {pair for pair in guess.split(",") if pair.endswith(f"={flag}")} <= {
            f"enabled={flag}"}


@pytest.mark.parametrize(("header", "order"), [
    ("fid,foo,img_row,bar,img_col", "count x line y sample"),
    ("row,date,col,id,p,q", "line date sample count x y"),
    ("y_px,x_px,p,q,n_images", "line sample x y few"),
    ("col,row,p,q,number of rays", "sample line x y few"),
    ("A1,B1,row,col,seen", "x y line sample date"), ("k,A1,row,col,B1", "count x line sample y")])
def test_numbering_dates_and_counts_are_no_heights(header: str, order: str,
                                                   tmp_path: Path) -> None:
    guesses = shown_for(tmp_path, header, order, "EPSG:32619").guesses
    assert guesses
    assert not any("z=" in guess for guess in guesses)


def test_names_of_x_and_y_that_are_exchanged_give_a_guess_that_runs(tmp_path: Path) -> None:
    header = "lat,Northing,Easting,lon,x_px,y_px"
    error = shown_for(tmp_path, header, "lon x y lat sample line", "EPSG:32619")
    assert error.guesses == ["line=y_px,sample=x_px,x=Northing,y=Easting"]
    assert f"x {METRES['x'][0]:.10g}, y {METRES['y'][0]:.10g}" in str(error)


@pytest.mark.parametrize(("header", "order"), [
    ("Breite,x_px,y_px,east,Länge,n,north", "lat sample line x lon count y"),
    ("n,Latitud,Longitud,row,col,Este,Norte", "count lat lon line sample x y")])
def test_a_column_n_beside_other_northings_numbers_the_points(header: str, order: str,
                                                              tmp_path: Path) -> None:
    for crs in ("EPSG:32619", "EPSG:4326"):
        for guess in shown_for(tmp_path, header, order, crs).guesses:
            assert "y=n" not in guess.split(",")


@pytest.mark.parametrize("first", [0, 1, 1950])
def test_a_row_that_counts_the_columns_is_no_point(first: int, tmp_path: Path) -> None:
    order = "sample line x y zero"
    header = ",".join(str(first + i) for i in range(5))
    error = shown_for(tmp_path, header, order, "EPSG:32619")
    assert f"sample {SAMPLE[0]:.10g}" in str(error)
    assert "line=2,sample=1,x=3,y=4" in error.guesses


RECORDS = [{"id": 9, "map_id": 4, "x": 1145, "y": 825, "lat": "53.38", "lon": "-2.90"},
           {"id": 10, "map_id": 4, "x": 1028, "y": 857, "lat": "53.39", "lon": "-2.91"}]


def test_the_reader_of_json_conforms() -> None:
    records = [{"id": "a", "line": 1.5, "sample": 2.5, "x": 8.1, "y": 47.1, "z": 400.0},
               {"id": "b", "line": 10.5, "sample": 20.5, "x": 8.2, "y": 47.2, "z": 410.0}]
    expected = FeatureSet(Points(("a", "b"), np.array([[1.5, 2.5], [10.5, 20.5]]),
                                 np.array([[8.1, 47.1, 400.0], [8.2, 47.2, 410.0]])), crs="")
    check(PointsJson(), content=json.dumps(records).encode(), expected=expected, filename="a.json")


@pytest.mark.parametrize("tree", [
    RECORDS, {"stat": "ok", "items": RECORDS},
    {"data": [{"id": record["id"], "type": "gcps", "attributes": record} for record in RECORDS]}])
def test_lists_of_mapwarper_in_json_are_read(tree: object, tmp_path: Path) -> None:
    (tmp_path / "gcps.json").write_text(json.dumps(tree))
    points = termsel.read(tmp_path / "gcps.json", crs="EPSG:4326").points
    assert points.ids == ("9", "10")
    assert points.image.tolist() == [[825, 1145], [857, 1028]]
    assert points.ground[:, :2].tolist() == [[-2.90, 53.38], [-2.91, 53.39]]


@pytest.mark.parametrize("indent", [None, 1])
def test_the_images_of_a_list_in_json_are_parts(tmp_path: Path, indent: int | None) -> None:
    records = [{"image": "AB"[i % 2], "line": float(LINE[i]), "sample": float(SAMPLE[i]),
                "x": METRES["x"][i], "y": METRES["y"][i]} for i in range(N)]
    path = tmp_path / "images.json"
    path.write_text(json.dumps(records, indent=indent))
    with pytest.raises(TermselError, match=r"points of the images A \(5\), B \(4\), with") as error:
        termsel.read(path, crs="EPSG:32633")
    # What the error proposes works: each image is a part of the file.
    assert "fit each with termsel compare" in (error.value.hint or "")
    assert PointsJson().parts(path) == {"A": {"image_name": "A"}, "B": {"image_name": "B"}}
    assert len(PointsJson(image_name="B").read(path).points) == N // 2
    with pytest.raises(TermselError, match="no image 'C' is in this file: the file has points of"):
        PointsJson(image_name="C").read(path)


@pytest.mark.parametrize("name", ["line", "x"])
def test_a_column_known_by_its_name_may_hold_no_number(tmp_path: Path, name: str) -> None:
    cells = {"line": LINE, "sample": SAMPLE, "x": METRES["x"], "c2": METRES["y"]}
    rows = [{key: str(column[i]) for key, column in cells.items()} for i in range(N)]
    rows[3][name] = "n/a"
    path = tmp_path / "a.csv"
    path.write_text("\n".join([",".join(cells), *(",".join(row.values()) for row in rows)]))
    with pytest.raises(TermselError):
        termsel.read(path, crs="EPSG:32633")


def test_the_command_line_shows_all_guesses(tmp_path: Path, call: Callable[..., Any]) -> None:
    path = tmp_path / "a.txt"
    path.write_text("".join(f"{sample} {line} {x} {y}\n" for sample, line, x, y in zip(
        SAMPLE, LINE, DEGREES["x"], DEGREES["y"], strict=True)))
    shown = call("run", "--points", path, "--crs", "EPSG:4326").stderr
    assert "Ready to run" not in shown
    assert "Guess 1 of 2, to check: termsel run" in shown
    assert "Guess 2 of 2, to check: termsel run" in shown


@pytest.mark.parametrize(("header", "order", "kind"), [
    ("a,b,c,d,e", "y x z line sample", "metres"), ("a,b,c,d,e", "sample line x y z", "metres"),
    ("A,B,C,D,E", "line sample y x zero", "degrees"),
    ("lat_px,lon_px,lat,lon", "line sample y x", "degrees"),
    ("line,line2,east,east2", "line sample x y", "metres")])
def test_names_that_mislead_do_not_hide_the_true_reading(
        header: str, order: str, kind: str, tmp_path: Path) -> None:
    known = COLUMNS | (METRES if kind == "metres" else DEGREES)
    names = order.split()
    columns = header.split(",")
    path = tmp_path / "table.csv"
    path.write_text("\n".join([header, *(",".join(f"{value:.10g}" for value in row) for row in zip(
        *(known[name].tolist() for name in names), strict=True))]))
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(path, crs="EPSG:32619" if kind == "metres" else "EPSG:4326")
    true = {f"{name}={column}" for name, column in zip(names, columns, strict=True)
            if name not in ("z", "zero")}
    assert any(true <= set(guess.split(",")) for guess in caught.value.guesses)


def test_columns_called_x_and_y_are_not_taken_for_lines_and_samples(tmp_path: Path) -> None:
    rows = [f"{7 + 5 * i},{115 + 3 * i * i % 50},{10 + i},{135 + 7 * i % 11}" for i in range(8)]
    table = tmp_path / "pairs.csv"
    table.write_text("\n".join(["x_left.jpg,y_left.jpg,x_right.jpg,y_right.jpg", *rows]) + "\n")
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(table)
    assert caught.value.guesses[:1] == [
        "line=y_left.jpg,sample=x_left.jpg,x=x_right.jpg,y=y_right.jpg"]


@pytest.mark.parametrize(("header", "meanings", "guess"), [
    ("kp0_x,kp0_y,lon,lat,score", "sample line x y score",
     "line=kp0_y,sample=kp0_x,x=lon,y=lat"),
    ("X_src,Y_src,X_tgt,Y_tgt,rms", "sample line x y score",
     "line=Y_src,sample=X_src,x=X_tgt,y=Y_tgt"),
    ("mkpts0_x,mkpts0_y,mkpts1_x,mkpts1_y,mconf", "sample line sample2 line2 score",
     "line=mkpts0_y,sample=mkpts0_x,x=mkpts1_x,y=mkpts1_y"),
    ("图上X,图上Y,A,B", "sample line x y", "line=图上Y,sample=图上X,x=A,y=B"),
    ("col_a,row_a,col_b,row_b", "sample line sample2 line2",
     "line=row_a,sample=col_a,x=col_b,y=row_b")])
def test_names_say_which_axis_a_column_runs_along(header: str, meanings: str, guess: str,
                                                  tmp_path: Path) -> None:
    columns = COLUMNS | METRES | {
        "score": np.linspace(0.3, 0.9, N), "sample2": np.round(SAMPLE * 0.5 + 7, 1),
        "line2": np.round(LINE * 0.5 + 3, 1)}
    path = tmp_path / "table.csv"
    rows = zip(*(columns[name].tolist() for name in meanings.split()), strict=True)
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]))
    with pytest.raises(TermselError) as error:
        termsel.read(path, crs="EPSG:32633")
    assert error.value.guesses[0] == guess


def test_a_fifth_column_of_small_numbers_may_be_residuals(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    residuals = np.round(_rng.normal(0, 0.6, N), 2)
    rows = zip(*(column.tolist() for column in (SAMPLE, LINE, *METRES.values(), residuals)),
               strict=True)
    path.write_text("\n".join(" ".join(map(str, row)) for row in rows))
    with pytest.raises(TermselError) as error:
        termsel.read(path, crs="EPSG:32633")
    assert error.value.guesses == ["line=2,sample=1,x=3,y=4,z=5", "line=2,sample=1,x=3,y=4"]


@pytest.mark.parametrize(("header", "options", "message"), [
    ("x_km,y_km,z,line,sample", {"z_unit": "metre"}, "x is in kilometres by the name of its "
     "column, and EPSG:2263 is in US survey feet"),
    ("x,y,z_km,line,sample", {"z_unit": "us-ft"}, "z_unit says US survey feet"),
    ("x,y,z_km,line,sample", {"z_unit": "crs"}, "z_unit says US survey feet"),
    ("x,y,z_km,line,sample", {}, "")])
def test_kilometres_are_no_thousands_of_feet(
        header: str, options: dict[str, str], message: str, tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    path = tmp_path / "table.csv"
    path.write_text(f"{header}\n300001,60001,0.5,1,2\n300101,60501,0.25,3,4\n")
    if message:
        with pytest.raises(termsel.TermselError, match=message):
            termsel.read(path, crs="EPSG:2263", **options)
    else:
        read = termsel.read(path, crs="EPSG:2263")
        assert read.z_unit == "metres, as its column is in kilometres by its name"
        assert read.points.ground[:, 2].tolist() == [500.0, 250.0]


@pytest.mark.parametrize("header", ["E [km],N [km],H (km),row,col", "x_km,y_km,z_km,line,sample"])
def test_columns_in_kilometres_by_their_names_are_read_in_metres(
        header: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "termsel")
    path = tmp_path / "table.csv"
    ground = np.column_stack([*METRES.values(), COLUMNS["z"]])
    rows = np.column_stack([ground / 1000, LINE, SAMPLE]).tolist()
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]))
    points = termsel.read(path, crs="EPSG:32633").points
    assert np.abs(points.ground - ground).max() < 1e-6
    name = header.split(",")[0]
    assert f"Note: {name} is in kilometres by its name, and is multiplied by 1,000." \
        in caplog.messages


@pytest.mark.parametrize(("name", "unit"), [("z [ft]", "ft"), ("elevation_ft", "ft"),
                                            ("H (feet)", "ft"), ("height_us-ft", "us-ft")])
def test_heights_in_feet_by_their_name_are_metres_on_the_ground(
        name: str, unit: str, tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    path = tmp_path / "table.csv"
    path.write_text(f"x,y,{name},line,sample\n500000,5200000,1000,1,2\n500900,5200600,2000,3,4\n")
    read = termsel.read(path, crs="EPSG:32633")
    assert read.z_unit.endswith("by the name of its column")
    height = pyproj.Transformer.from_crs(read.crs, "EPSG:4979",
                                         always_xy=True).transform(500000, 5200000, 1000)[2]
    assert height == pytest.approx(1000 * {"ft": 0.3048, "us-ft": 1200 / 3937}[unit], abs=1e-6)
    with pytest.raises(termsel.TermselError, match="by the name of its column, and z_unit says"):
        termsel.read(path, crs="EPSG:32633", z_unit="metre")


@pytest.mark.parametrize(("unit", "size"), [("gon", 0.9), ("grads", 0.9), ("rad", 180 / np.pi)])
def test_angles_in_another_unit_by_their_name_are_degrees(
        unit: str, size: float, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    rows = [[10.25 + 0.01 * i, 48.5 - 0.01 * i * i, 5 * i, 7 * i * i] for i in range(4)]
    path.write_text("\n".join([f"lon ({unit}),lat ({unit}),line,sample", *(
        f"{lon / size!r},{lat / size!r},{line},{sample}" for lon, lat, line, sample in rows)]))
    ground = termsel.read(path, crs="EPSG:4326").points.ground
    np.testing.assert_allclose(ground[:, :2], np.array(rows)[:, :2], atol=1e-12)
    with pytest.raises(termsel.TermselError, match=r"x is in (gons|radians) by the name"):
        termsel.read(path, crs="EPSG:32633")


def test_x_in_feet_by_its_name_is_no_easting_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("x [ft],y [ft],line,sample\n980000,200000,1,2\n980900,200600,3,4\n")
    assert len(termsel.read(path, crs="EPSG:2263").points) == 2
    with pytest.raises(termsel.TermselError, match="x is in feet by the name of its column, and"):
        termsel.read(path, crs="EPSG:32618")


def test_a_coordinate_of_a_map_is_no_height_though_three_rows_fit_anything(tmp_path: Path) -> None:
    (tmp_path / "marks.txt").write_text("272692.3 3851114 1563 507.8 484.2 A g1\n"
                                        "273424.5 3851096 1555 580.6 474.6 A g2\n"
                                        "272000.5 3852096 1600 280.6 374.6 B g1\n")
    with pytest.raises(TermselError) as caught:
        termsel.read(tmp_path / "marks.txt", crs="EPSG:32639")
    assert caught.value.guesses[0] == "line=5,sample=4,x=1,y=2,z=3"
    assert not any("z=1" in guess or "z=2" in guess for guess in caught.value.guesses)
