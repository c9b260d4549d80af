"""A small simulated place, rendered once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

from numpy.typing import NDArray
from pyproj import Transformer

from termsel import Points, TermselError
from termsel.testing import invoke
from termsel_match.simulated.world import WORLD_CRS, World
from termsel_match.simulated.world_files import write_world


@dataclass(frozen=True)
class Place:
    """A rendered world and the folder of its files."""

    world: World
    folder: Path

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    def errors(self, points: Points, crs: str) -> NDArray[np.float64]:
        """Return the distances of measured points from where the exact camera sees them."""
        lonlat = self.geographic(points.ground, crs)
        return np.asarray(np.linalg.norm(points.image - self.world.camera.project(lonlat), axis=1))

    @staticmethod
    def geographic(ground: NDArray[np.float64], crs: str = WORLD_CRS) -> NDArray[np.float64]:
        """Return places in longitude, latitude and height."""
        to_wgs84 = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
        return np.column_stack([*to_wgs84.transform(ground[:, 0], ground[:, 1]), ground[:, 2]])


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    world = World(size=500, seed=3)
    folder = tmp_path_factory.mktemp("world") / "place"
    write_world(world, folder)
    return Place(world, folder)


@pytest.fixture
def altered(place: Place, tmp_path: Path) -> Callable[..., Path]:
    """Return what writes a raster of the place with other pixels or georeference."""
    import rasterio

    def alter(name: str, change: Callable[[Any], Any] = np.asarray, **profile: Any) -> Path:
        with rasterio.open(place / name) as raster:
            pixels, new = change(raster.read()), raster.profile | profile
        new |= {"count": pixels.shape[0], "height": pixels.shape[1], "width": pixels.shape[2],
                "dtype": pixels.dtype.name, "tiled": False}
        for key in ("blockxsize", "blockysize"):
            new.pop(key, None)
        with rasterio.open(tmp_path / name, "w", **new) as raster:
            raster.write(pixels)
        if name == "image.tif":
            (tmp_path / "image.RPB").write_bytes((place / "image.RPB").read_bytes())
        return tmp_path / name

    return alter


@pytest.fixture
def says() -> Callable[..., tuple[int, str]]:
    """Return what gives exit code and text of a command; 2 for a message to the user."""
    def run(*words: object) -> tuple[int, str]:
        done = invoke(*words)
        if isinstance(done.exception, TermselError):
            return 2, str(done.exception)
        assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
        return done.exit_code, done.output

    return run
