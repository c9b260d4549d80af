"""Feature sets from a file of points and one of lines."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Lines, Points
from termsel.formats.base import Reader
from termsel.io.read import read_features
from tests.csv_texts import LINES, POINTS, READERS, A, L, put

DATA = Path(os.environ.get("TERMSEL_DATA", Path(__file__).parents[3] / "shared" / "data"))


def test_points_and_lines_together(tmp_path: Path) -> None:
    p, q = put(tmp_path, POINTS + A, "p.csv"), put(tmp_path, LINES + L, "l.csv")
    features = read_features(p, q, crs="epsg:4979", readers=READERS)
    assert features.crs == "EPSG:4979"
    assert features.ids == ("a", "l")
    assert read_features(None, q, crs="local", readers=READERS).ids == ("l",)


def test_crs_comes_from_either_file_or_the_user(tmp_path: Path) -> None:
    p = put(tmp_path, POINTS + A, "p.csv")
    q = put(tmp_path, "# crs: EPSG:4326\n" + LINES + L, "l.csv")
    assert read_features(p, q, crs=None, readers=READERS).crs == "EPSG:4326"
    # The user may say what the heights are.
    assert read_features(p, q, crs="EPSG:4979", readers=READERS).crs == "EPSG:4979"


def test_crs_not_known_or_contradicted(tmp_path: Path) -> None:
    p = put(tmp_path, POINTS + A, "p.csv")
    q = put(tmp_path, "# crs: EPSG:4979\n" + LINES + L, "l.csv")
    r = put(tmp_path, "# crs: EPSG:4326\n" + POINTS + A, "r.csv")
    for files, crs, words in [
            ((p, None), None, "EPSG:4979 (longitude, latitude, ellipsoidal height)"),
            ((p, None), None, "EPSG:32631"), ((p, None), None, "local"),
            ((p, None), "WGS 1984 9", "unknown CRS"),
            ((p, q), "EPSG:32631", "declares the CRS EPSG:4979, but --crs says EPSG:32631"),
            ((p, q), "local", "declares the CRS EPSG:4979, but --crs says local"),
            ((r, q), None, f"declares the CRS EPSG:4979, but {r} says EPSG:4326"),
            ((p, None), "EPSG:32631", "look like degrees")]:
        with pytest.raises(TermselError) as caught:
            read_features(*files, crs=crs, readers=READERS)
        assert words in str(caught.value)
        assert crs == "WGS 1984 9" or str(tmp_path) in str(caught.value)


def test_coordinates_that_cannot_be_name_their_file(tmp_path: Path) -> None:
    p = put(tmp_path, POINTS + A, "p.csv")
    q = put(tmp_path, LINES + L.replace("44.1", "144.1"), "l.csv")
    with pytest.raises(TermselError, match=r"l\.csv, line 2, column 'y2': 'l' with x = 5"):
        read_features(p, q, crs="EPSG:4979", readers=READERS)


def test_features_of_the_other_kind(tmp_path: Path) -> None:
    class Both(Reader):
        name = "both"
        summary = "points and lines"

        def sniff(self, path: Path, head: bytes) -> bool:
            return head == b"both"

        def read(self, path: Path) -> FeatureSet:
            one = Points(("p",), [[1, 2]], [[3, 4, 5]])
            two = Lines(("l",), [[[1, 2], [3, 4]]], [[[1, 2, 3], [4, 5, 6]]])
            return FeatureSet(one, two, crs="", image_size=(10, 20))

    readers = [*READERS, Both]
    p, both = put(tmp_path, POINTS + A, "p.csv"), put(tmp_path, "both", "both")
    features = read_features(both, both, crs="local", readers=readers)
    assert features.ids == ("p", "l")
    assert features.image_size == (10, 20)
    with pytest.raises(TermselError, match="the file also has lines"):
        read_features(both, None, crs="local", readers=readers)
    with pytest.raises(TermselError, match="It has points: give it with --points"):
        read_features(None, p, crs="local", readers=readers)
    with pytest.raises(TermselError, match="--points FILE"):
        read_features(None, None, crs="local", readers=readers)


def test_one_id_in_both_files(tmp_path: Path) -> None:
    p, q = put(tmp_path, POINTS + A, "p.csv"), put(tmp_path, LINES + "a" + L[1:], "l.csv")
    with pytest.raises(TermselError, match="'a' is the id of a point and of a line"):
        read_features(p, q, crs="local", readers=READERS)


real = sorted(DATA.glob("*/meta.json"))


@pytest.mark.skipif(not real, reason="no real data here")
@pytest.mark.parametrize("meta", real, ids=lambda path: path.parent.name)
def test_real_data(meta: Path) -> None:
    facts = json.loads(meta.read_text(encoding="utf-8"))
    p, q = meta.with_name("points.csv"), meta.with_name("lines.csv")
    features = read_features(p, q if q.exists() else None, crs=facts["crs"].split(" ")[0],
                             readers=READERS)
    assert len(features.points) == facts["npoints"]
    assert len(features.lines) == facts.get("nlines", 0)
