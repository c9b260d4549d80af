"""Four neighbouring sheets of an old map, as scans: turned, on paper that has shrunk unevenly."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray

SHEETS = 4
SHEET_CRS = "EPSG:32639"
GRID_SPACING = 100.0  # m between the lines of the printed grid
FRAME = 1000.0, 800.0  # m, width and height of a sheet
SHEET_SIZE = (460, 560)  # px, lines and samples
_PIXEL = 2.0  # m
_PAPER_MARGIN = 30.0  # px from the corner of the scan to the frame
_WEST, _NORTH = 270_000.0, 3_854_000.0
_TURNS = (0.4, -1.1, 0.8, -0.3)  # degrees
_WARP = 1.2  # px by which the paper is out of shape
_CROSSINGS = 15
_SHEET_NOISE = 0.5  # px


def _sheet_corner(sheet: int) -> tuple[float, float]:
    """Return easting and northing of the north-western corner of a sheet [m]."""
    row, column = divmod(sheet, 2)
    return _WEST + column * FRAME[0], _NORTH - row * FRAME[1]


def _map_positions(sheet: int, image: FloatArray) -> FloatArray:
    """Return easting and northing [m] of pixels (line, sample), shape (n, 2)."""
    # Waves as long as the sheet, of another phase on each.
    phase = 2.0 * np.pi * (image / np.array(SHEET_SIZE) + 0.3 * sheet)
    line, sample = (image + _WARP * np.sin(phase[:, ::-1])).T
    turn = np.radians(_TURNS[sheet])
    right = _PIXEL * (sample - _PAPER_MARGIN)
    down = _PIXEL * (line - _PAPER_MARGIN)
    west, north = _sheet_corner(sheet)
    return np.column_stack([west + right * np.cos(turn) + down * np.sin(turn),
                            north + right * np.sin(turn) - down * np.cos(turn)])


def _scan_positions(sheet: int, ground: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) [px] of map positions (n, 2) on the scan of a sheet.

    It inverts `_map_positions` by iteration.
    """
    corner = np.array(_sheet_corner(sheet))
    offsets = np.column_stack([corner[1] - ground[:, 1], ground[:, 0] - corner[0]])
    image = offsets / _PIXEL + _PAPER_MARGIN
    # Turn and warp are small, so that each step leaves a few per cent of the error.
    for _ in range(12):
        missing = ground - _map_positions(sheet, image)
        image = image + np.column_stack([-missing[:, 1], missing[:, 0]]) / _PIXEL
    return image


def sheet_and_points(sheet: int) -> tuple[np.ndarray, FloatArray, FloatArray]:
    """Return the scan of a sheet, of bytes, and points measured at crossings of its grid.

    Returns
    -------
    pixels : ndarray of uint8, shape (lines, samples)
        The scan, in grey.
    ground : ndarray, shape (15, 2)
        Easting and northing of the points [m].
    image : ndarray, shape (15, 2)
        Line and sample of the points on the scan [px].
    """
    lines, samples = np.mgrid[:SHEET_SIZE[0], :SHEET_SIZE[1]]
    pixels = np.column_stack([lines.ravel(), samples.ravel()]).astype(float)
    west, north = _sheet_corner(sheet)
    # Metres from the upper left corner of the map, to the right and downwards.
    right, down = ((_map_positions(sheet, pixels) - (west, north)) * (1.0, -1.0)).T
    inside = (right >= 0) & (right <= FRAME[0]) & (down >= 0) & (down <= FRAME[1])
    fields = (np.floor(right / GRID_SPACING) + np.floor(down / GRID_SPACING)) % 2
    to_grid = np.minimum(np.abs(right - GRID_SPACING * np.round(right / GRID_SPACING)),
                         np.abs(down - GRID_SPACING * np.round(down / GRID_SPACING)))
    # Dark lines of the grid between fields of two shades; the margin of the paper is brighter.
    shades = np.where(to_grid < _PIXEL, 60, np.where(fields, 205, 225))
    scan = np.where(inside, shades, 240).reshape(SHEET_SIZE).astype(np.uint8)

    rng = np.random.default_rng(sheet)
    columns = np.arange(0, FRAME[0] + 1, GRID_SPACING)
    rows = np.arange(0, FRAME[1] + 1, GRID_SPACING)
    crossings = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    measured_crossings = crossings[rng.permutation(len(crossings))[:_CROSSINGS]]
    ground = np.array((west, north)) + measured_crossings * (1.0, -1.0)
    image = _scan_positions(sheet, ground) + rng.normal(0.0, _SHEET_NOISE, ground.shape)
    return scan, ground, image.round(3)
