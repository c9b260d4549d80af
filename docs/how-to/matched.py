"""Make the picture of docs/how-to/match.md: roads over an image, before and after.

    python docs/how-to/matched.py
"""

from __future__ import annotations

import tempfile
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from pyproj import Transformer

import termsel
from termsel import FeatureSet
from termsel_match.judgement.selection import select_points
from termsel_match.points.candidates import match_points
from termsel_match.simulated.world import WORLD_CRS, World
from termsel_match.simulated.world_files import write_world

PICTURE = Path(__file__).parents[1] / "_static/matched.png"
SIZE = 600
# Blue, green, red, of Okabe and Ito's colours, which differ for colour-blind eyes too.
BLUE, VERMILION, YELLOW = (233, 180, 86), (0, 94, 213), (66, 228, 240)


def main() -> None:
    """Write PICTURE."""
    with tempfile.TemporaryDirectory() as folder:
        world, place = World(size=SIZE), Path(folder) / "place"
        write_world(world, place)
        with termsel.open_raster(place / "image.tif") as raster:
            grey = np.clip(raster.read(1) / 7, 0, 255).astype(np.uint8)
        found = match_points(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif")
        features = FeatureSet(found.points, crs=found.crs, image_size=found.image_size)
        selected = select_points(features, "rpc-drift", {"rpc": str(place / "image.RPB")})
        with termsel.open_dem(place / "dem.tif", WORLD_CRS) as dem:
            roads = [np.column_stack([dense, dem(dense)]) for dense in map(_dense, world.vectors())]
        to_wgs84 = Transformer.from_crs(WORLD_CRS, "EPSG:4326", always_xy=True)

        def delivered(ground: np.ndarray) -> np.ndarray:
            lon, lat = to_wgs84.transform(ground[:, 0], ground[:, 1])
            return world.rpc.project(np.column_stack([lon, lat, ground[:, 2]]))

        pictures = []
        for project in (delivered, selected.result.project):
            picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
            for road in roads:
                seen = project(road[np.isfinite(road[:, 2])])
                cv2.polylines(picture, [_drawn(seen)], False, YELLOW, 1, cv2.LINE_AA, 4)
            pictures.append(picture)
        for place_, right in zip(found.points.image, selected.agrees, strict=True):
            if right:
                cv2.circle(pictures[1], _drawn(place_[None])[0], 5 << 4, BLUE, 2, cv2.LINE_AA, 4)
            else:
                cv2.drawMarker(pictures[1], np.round(place_[::-1]).astype(int).tolist(), VERMILION,
                               cv2.MARKER_TILTED_CROSS, 14, 3, cv2.LINE_AA)
        gap = np.full((SIZE, 12, 3), 255, dtype=np.uint8)
        cv2.imwrite(str(PICTURE), np.concatenate([pictures[0], gap, pictures[1]], axis=1),
                    [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _dense(road: np.ndarray) -> np.ndarray:
    """Return a road with a vertex every 20th part of each piece."""
    share = np.linspace(0, 1, 20)[:, None]
    return np.concatenate([start + share * (end - start)
                           for start, end in pairwise(road)])


def _drawn(image: np.ndarray) -> np.ndarray:
    """Return line and sample as OpenCV draws: x, y in sixteenths."""
    return np.round(image[:, ::-1] * 16).astype(np.int32)


if __name__ == "__main__":
    main()
