"""Draw the picture of the tutorial, from an actual run: python docs/tutorial/rectified.py

termsel selects terms on the points of `termsel example`, and the image is resampled to a map.
Left the image, right the map. Needs the extra `gis`. The tests use the functions below.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rasterio
from pyproj import Transformer
from rasterio.errors import NotGeoreferencedWarning
from scipy.ndimage import gaussian_filter

import termsel
from termsel.io.example import write_example
from termsel.simulate.example import GSD, MAP_CRS, ground_of_corners

TARGET = Path(__file__).parents[1] / "_static" / "rectified.png"
GROUND = 252, 252, 250  # reads alike on light and dark pages


def corners_true(path: Path) -> np.ndarray:
    """Return line and sample of the corners in a map, shape (n, 2)."""
    with rasterio.open(path) as raster:
        turn = Transformer.from_crs("EPSG:4326", raster.crs, always_xy=True)
        x, y = turn.transform(*ground_of_corners()[:, :2].T)
        sample, line = ~raster.transform @ (np.asarray(x), np.asarray(y))
    return np.column_stack([line, sample]) - 0.5


def corners_found(path: Path) -> np.ndarray:
    """Return where corners are in a map: saddles of its brightness near where they belong."""
    with rasterio.open(path) as raster:
        bright = gaussian_filter(raster.read(1).astype(float), 1.5)
    offset = np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-5, 6), indexing="ij"),
                      -1).reshape(-1, 2)
    found = []
    for place in corners_true(path):
        here = place.copy()
        for _ in range(6):
            middle = np.rint(here).astype(int)
            u, v = offset.T
            columns = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
            values = bright[middle[0] + u, middle[1] + v]
            _, gu, gv, uu, uv, vv = np.linalg.lstsq(columns, values, rcond=None)[0]
            here = middle - np.linalg.solve([[2 * uu, uv], [uv, 2 * vv]], [gu, gv])
        found.append(here)
    return np.array(found)


def _panel(path: Path, marks: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Return a raster in grey, shape (lines, samples, 3), with a cross at each mark."""
    with rasterio.open(path) as raster:
        grey, nodata = raster.read(1), raster.nodata
    # Without the noise of the pixels the file is a tenth as large.
    panel = np.repeat((np.rint(grey / 32.0) * 32.0).astype(np.uint8)[..., None], 3, axis=2)
    if nodata is not None:
        panel[grey == nodata] = GROUND
    for line, sample in np.rint(marks).astype(int):
        panel[line, sample - 4:sample + 5] = colour
        panel[line - 4:line + 5, sample] = colour
    return panel


def draw(scene: Path, rectified_map: Path, measured: np.ndarray) -> np.ndarray:
    """Return image and map side by side, shape (3, lines, samples).

    Parameters
    ----------
    scene, rectified_map : Path
    measured : ndarray, shape (n, 2)
        Line and sample of the points the model was fitted to.
    """
    panels = [_panel(scene, measured, (209, 36, 47)),
              _panel(rectified_map, corners_true(rectified_map), (11, 122, 117))]
    height = max(panel.shape[0] for panel in panels)
    columns = []
    for panel in panels:
        above = (height - panel.shape[0]) // 2
        below = height - panel.shape[0] - above
        columns.append(np.pad(panel.astype(int) + 1, ((above, below), (8, 8), (0, 0))))
    whole = np.concatenate(columns, axis=1) - 1
    whole[(whole < 0).all(axis=2)] = GROUND
    return np.moveaxis(whole.astype(np.uint8), -1, 0)


@dataclass(frozen=True)
class Rectified:
    """The tutorial's result and map, and how far corners are from their true positions [px]."""

    result: termsel.Result
    map: Path
    distances: np.ndarray

    @property
    def fitted(self) -> np.ndarray:
        """Whether each point was used in the fit, shape (n,)."""
        used = [residual.id for residual in self.result.residuals if residual.used]
        return np.isin(self.result.features.points.ids, used)

    @property
    def figures(self) -> dict[str, str]:
        """The figures that captions of the picture state."""
        return {"points": str(self.fitted.sum()), "corners": str(len(self.distances)),
                "largest": f"{self.distances.max():.2f}",
                "rms": f"{np.sqrt((self.distances**2).mean()):.2f}"}


def rectified(folder: Path) -> Rectified:
    """Follow the tutorial with the example files in a folder."""
    result = termsel.run("rfm-terms", features=termsel.read(folder / "gcps.csv")).as_exported()
    path = folder / "map.tif"
    termsel.rectify(result, folder / "scene.tif", path, dem=folder / "dem.tif",
                    crs=MAP_CRS, resolution=GSD)
    distances = np.linalg.norm(corners_found(path) - corners_true(path), axis=1)
    return Rectified(result, path, distances)


def main() -> None:
    """Follow the tutorial and write the picture."""
    with TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        folder = Path(name) / "files"
        write_example(folder)
        made = rectified(folder)
        picture = draw(folder / "scene.tif", made.map,
                       made.result.features.points.image[made.fitted])
        with rasterio.open(TARGET, "w", driver="PNG", height=picture.shape[1],
                           width=picture.shape[2], count=3, dtype="uint8", zlevel=9) as raster:
            raster.write(picture)
    print(made.figures, file=sys.stderr)


if __name__ == "__main__":
    main()
