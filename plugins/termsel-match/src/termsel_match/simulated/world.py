"""A simulated world: an image by an exact scanner, and all that georeferences it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer
from scipy.interpolate import RectBivariateSpline

from termsel import FeatureSet, Points, Rpc, TermselError, fit, rpc_of
from termsel.simulate import Angle, Pushbroom, Terrain, pushbroom_at
from termsel_match.simulated.scenery import Bytes, FloatArray, Scenery, simulate_scenery

Shakes = tuple[tuple[tuple[float, float, float], ...], ...]

WORLD_CRS = "EPSG:32633"
# Px along either side of an image.
SMALLEST_WORLD, LARGEST_WORLD = 200, 4000

_LON, _LAT = 14.2, 47.2
# Mean height of the ground and size of its hills [m].
_HEIGHT, _RELIEF = 520.0, 35.0
# Houses [m].
_TALLEST = 11.0
# Step of height along a ray that may meet a house [m].
_RAY_STEP = 0.6
# Px between rays that are computed; those between are interpolated by splines.
_RAY_MESH = 16
# Lines rendered at once.
_RENDERED_LINES = 200
# Cells of the ground along a pixel.
_CELLS_PER_PIXEL = 2
# Ground beyond the image on either side, as a share of its extent.
_MARGIN = 0.12
# Metres between the heights that are interpolated.
_TERRAIN = 4.0
SPACING = 2 * _TERRAIN
"""Distance of the heights of the DEM [m]."""
# Standard deviation of the noise of the image, whose values have 11 bits.
_NOISE = 10.0


@dataclass(frozen=True, eq=False)
class World:
    """A place, a scanner that takes an image of it, and what a vendor says of that image.

    Everything is drawn from the seed. Ground coordinates of `camera` are WGS84 longitude,
    latitude [deg] and height [m]; those of the plane are EPSG:32633.

    Parameters
    ----------
    size : int
        Lines and samples of the image [px].
    seed : int
    gsd : float
        Size of a pixel on the ground [m].
    off : float
        Distance of the vendor's RPC from the truth in the middle of the image [px].
    off_nadir : float
        Angle of the view from the vertical [deg].
    jitter : float
        Amplitude of a fast motion of the attitude that the vendor does not know [px].

    Raises
    ------
    TermselError
        For a size that is not within `SMALLEST_WORLD` and `LARGEST_WORLD`, a distance that is not
        0 to 200, or a negative seed.
    """

    size: int = 1000
    seed: int = 1
    gsd: float = 1.0
    off: float = 30.0
    off_nadir: float = 12.0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        if not SMALLEST_WORLD <= self.size <= LARGEST_WORLD:
            raise TermselError(f"a world cannot have an image of {self.size} px",
                               hint=f"Give a size of {SMALLEST_WORLD} to {LARGEST_WORLD} px.")
        if not 0 <= self.off <= 200:
            raise TermselError(f"the RPC of a world cannot be {self.off:g} px off",
                               hint="Give a distance of 0 to 200 px.")
        if self.seed < 0:
            raise TermselError(f"the seed is {self.seed}",
                               hint="Give a whole number of at least 0.")

    def _rng(self, stream: int) -> np.random.Generator:
        """Return the generator of a stream of random numbers: each thing is drawn from its own."""
        return np.random.default_rng([self.seed, stream])

    @property
    def side(self) -> float:
        """Side of the square of ground [m]."""
        return float(np.ceil(self.size * self.gsd * (1 + 2 * _MARGIN)))

    @property
    def cell(self) -> float:
        """Size of a cell of the scenery [m]."""
        return self.gsd / _CELLS_PER_PIXEL

    @property
    def corner(self) -> FloatArray:
        """Easting and northing of the upper-left corner of the ground [m]."""
        east, north = _to_plane().transform(_LON, _LAT)
        return np.round(np.array([east - self.side / 2, north + self.side / 2]))

    @cached_property
    def camera(self) -> Pushbroom:
        """The exact pushbroom scanner: an orbit, and angles that drift and shake.

        Roll and pitch each have a drift and a slow vibration of about 0.1 px; with `jitter`, they
        have a quicker one of that many px as well.
        """
        steady = pushbroom_at(
            _LON, _LAT, height=_HEIGHT, off_nadir=self.off_nadir, look_azimuth=70.0, gsd=self.gsd,
            image_size=(self.size, self.size), altitude=681e3, inclination=98.1)
        end = steady.centre[0] * steady.line_period
        shake: Shakes = (((0.12 * steady.ifov, 1.1 / end, 0.4),),
                         ((0.15 * steady.ifov, 0.8 / end, 2.0),))
        if self.jitter:
            # A vibration of either angle that no RPC has.
            size = self.jitter * steady.ifov
            shake = ((*shake[0], (size, 2.0 / end, 1.0)), (*shake[1], (0.8 * size, 1.6 / end, 0.3)))
        return replace(
            steady, roll=Angle((*steady.roll.drift, 0.8 * steady.ifov / end), shake[0]),
            pitch=Angle((*steady.pitch.drift, -0.6 * steady.ifov / end), shake[1]))

    @cached_property
    def rpc(self) -> Rpc:
        """The vendor's RPC: that of a scanner whose attitude is wrong and drifts.

        It is `off` px wrong in the middle of the image, in a random direction, and knows none of
        the fast motions of the attitude.
        """
        rng = self._rng(1)
        true = self.camera
        direction = rng.uniform(0, 2 * np.pi)
        # Of roll and pitch each: 3 to 8 % of the offset is added up to the first and last line, as
        # the errors of vendors are nearly a shift of the image. Termsel's own choice.
        share = rng.choice([-1, 1], 2) * rng.uniform(0.03, 0.08, 2)
        offset = self.off * true.ifov * np.array([np.sin(direction), np.cos(direction)])
        drift = self.off * true.ifov * share / (true.centre[0] * true.line_period)
        roll, pitch = (Angle((angle.drift[0] + float(constant), float(slope)))
                       for angle, constant, slope in zip((true.roll, true.pitch), offset, drift,
                                                         strict=True))
        nominal = replace(true, roll=roll, pitch=pitch)
        # An RPC is fitted to a grid in the image at several heights, as vendors do: 405 places
        # for the 20 coefficients an axis of cubic polynomials, over more heights than the terrain
        # has.
        steps = np.linspace(0, self.size - 1, 9)
        grid = np.stack(np.meshgrid(steps, steps, _HEIGHT + 2.5 * _RELIEF * np.linspace(-1, 1, 5)),
                        axis=-1).reshape(-1, 3)
        ground = np.column_stack([nominal.locate(grid[:, :2], grid[:, 2]), grid[:, 2]])
        control = FeatureSet(Points(tuple(map(str, range(len(grid)))), grid[:, :2], ground),
                             crs="EPSG:4979", image_size=(self.size, self.size))
        return rpc_of(fit(control, "poly3d", degree=3)).rpc.as_delivered()

    @cached_property
    def terrain(self) -> Terrain:
        """The ground: a function of longitude and latitude that returns heights [m].

        It is a slope with three hills and six waves in random directions, whose lengths are 0.5
        to 1.4 times half the side of the ground.
        """
        rng = self._rng(2)
        half = np.degrees(self.side / 2 / 6.371e6)
        waves = 2 * np.pi / rng.uniform(0.5, 1.4, 6)
        turns = rng.uniform(0, 2 * np.pi, 6)
        relief = np.column_stack([np.full(6, 0.12 * _RELIEF), waves * np.cos(turns),
                                  waves * np.sin(turns), rng.uniform(0, 2 * np.pi, 6)])
        hills = [(rise, float(rng.uniform(-0.6, 0.6)), float(rng.uniform(-0.6, 0.6)), 0.6)
                 for rise in (1.0, -0.8, 0.6)]
        half_widths = (float(half / np.cos(np.radians(_LAT))), float(half))
        waves_of_relief = tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in relief)
        return Terrain(_LON, _LAT, half_widths, _HEIGHT, _RELIEF, (0.3, -0.2), hills=tuple(hills),
                       relief=waves_of_relief)

    @cached_property
    def heights(self) -> FloatArray:
        """Terrain every 4 m of the square, rows to the south from its corner on [m]."""
        steps = np.arange(0.0, self.side + 2 * _TERRAIN, _TERRAIN)
        east, south = np.meshgrid(steps, steps)
        lon, lat = _to_plane().transform(self.corner[0] + east.ravel(),
                                         self.corner[1] - south.ravel(), direction="INVERSE")
        return self.terrain(np.column_stack([lon, lat])).reshape(east.shape)

    @cached_property
    def ground(self) -> Scenery:
        """What is on the ground."""
        return simulate_scenery(
            self._rng(3), self.side, self.cell, (np.array([-0.9, -0.5]), np.array([0.6, -0.9]))
        )

    def image(self) -> NDArray[np.uint16]:
        """Return the image of the satellite (lines, samples), with grey values of 11 bits.

        Each pixel shows what its ray meets first, a house or the terrain. Noise and a floor of grey
        are added, so that matching is no easier than in real images.
        """
        day = self._lit_brightness(0)
        low = float(self.heights.min()) - 1
        high = float(self.heights.max()) + _TALLEST + 1
        at_low = self._ray_mesh(low)
        at_high = self._ray_mesh(high)
        rows = []
        for top in range(0, self.size, _RENDERED_LINES):
            lines = np.arange(top, min(top + _RENDERED_LINES, self.size), dtype=np.float64)
            start, end = (_interpolate_rays(mesh, lines, self.size) for mesh in (at_low, at_high))
            # A ray is straight between the lowest ground and the tallest roof.
            cells = self._cells_met(start, (end - start) / (high - low), low)
            rows.append(cv2.remap(day, *cells, cv2.INTER_LINEAR))
        bright = np.concatenate(rows).astype(np.float32)
        noise = self._rng(4).standard_normal(bright.shape, dtype=np.float32) * _NOISE
        return np.clip(np.round(150 + 6 * bright + noise), 1, 2047).astype(np.uint16)

    def ortho(self) -> Bytes:
        """Return the orthoimage of the other day, of the whole square, 8 bits."""
        bright = self._lit_brightness(1).astype(np.float32)
        n = len(bright) // _CELLS_PER_PIXEL
        mean = cv2.resize(bright[:n * _CELLS_PER_PIXEL, :n * _CELLS_PER_PIXEL], (n, n),
                          interpolation=cv2.INTER_AREA)
        # A linear stretch to 8 bits, as orthophotos have, with noise of its own.
        noise = self._rng(5).standard_normal(mean.shape, dtype=np.float32) * 3
        return np.asarray(np.clip(np.round(25 + 0.8 * mean + noise), 1, 255), dtype=np.uint8)

    def dem(self) -> FloatArray:
        """Return the heights [m] every `SPACING`, with an error of 0.3 m RMS; rows go south."""
        return np.asarray(self.heights[::2, ::2]
                          + self._rng(6).normal(0, 0.3, self.heights[::2, ::2].shape))

    def independent(self, count: int = 200) -> Points:
        """Return ground points all over the image, with lines and samples by the exact scanner.

        Their x and y are in the plane of `WORLD_CRS` [m]; they have the role independent.
        """
        image = self._rng(7).uniform(0.02, 0.98, (count, 2)) * (self.size - 1)
        height = np.full(count, _HEIGHT)
        # A ray meets the terrain where its height is that of the ground: slopes are gentle.
        for _ in range(12):
            lonlat = self.camera.locate(image, height)
            height = self.terrain(lonlat)
        east, north = _to_plane().transform(*lonlat.T)
        image = self.camera.project(np.column_stack([lonlat, height]))
        return Points(tuple(f"T{i + 1:03d}" for i in range(count)), image,
                      np.column_stack([east, north, height]), None, ("independent",) * count)

    def vectors(self) -> list[FloatArray]:
        """Return the roads of a map, shape (n, 2) each: of 20, three are missing, three moved.

        Moved ones are 3 to 8 m aside; vertices of all have an error of 0.2 m.
        """
        rng = self._rng(8)
        mapped = []
        # Of each 20 roads 0 to 2 are missing, and 3 to 5 are moved.
        fates = rng.permutation(np.tile(np.arange(20), len(self.ground.roads) // 20 + 1))
        for road, fate in zip(self.ground.roads, fates, strict=False):
            if fate < 3:
                continue
            vertices = road.vertices + rng.normal(0, 0.2, road.vertices.shape)
            if fate < 6:
                turn = rng.uniform(0, 2 * np.pi)
                vertices = vertices + rng.uniform(3, 8) * np.array([np.cos(turn), np.sin(turn)])
            mapped.append(self.corner + vertices * [1, -1])
        return mapped

    def _lit_brightness(self, day: int) -> Bytes:
        """Return the brightness on a day (0 or 1), lit by its sun and blurred as the optics see it.
        """
        bright = self.ground.days[day]
        south, east = np.gradient(self.heights, _TERRAIN)
        slope = (-0.7, 0.5) if day == 0 else (0.6, 0.4)
        # Brighter towards the sun, darker away from it.
        lit = np.clip(1 + slope[0] * east + slope[1] * south, 0.4, 1.8).astype(np.float32)
        n = len(bright)
        step = _TERRAIN / self.cell
        cells = (np.arange(n, dtype=np.float32) + 0.5) / np.float32(step)
        lit_image = np.empty_like(bright)
        for top in range(0, n, 1024):
            at = np.meshgrid(cells, cells[top:top + 1024])
            lit_image[top:top + 1024] = np.clip(
                bright[top:top + 1024] * cv2.remap(lit, *at, cv2.INTER_LINEAR), 0, 255)
        return np.asarray(cv2.GaussianBlur(lit_image, (0, 0), 0.5 * _CELLS_PER_PIXEL),
                          dtype=np.uint8)

    def _ray_mesh(self, height: float) -> tuple[FloatArray, FloatArray]:
        """Return where a mesh of rays reaches a height: east and south of the corner [m]."""
        steps = _mesh_positions(self.size)
        image = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        east, north = _to_plane().transform(*self.camera.locate(image, height).T)
        shape = len(steps), len(steps)
        return ((np.asarray(east) - self.corner[0]).reshape(shape),
                (self.corner[1] - np.asarray(north)).reshape(shape))

    def _cells_met(self, start: FloatArray, rise: FloatArray, low: float,
                   ) -> list[NDArray[np.float32]]:
        """Return the columns and rows of the cells where rays meet houses or terrain.

        Rays are straight between `low` and the top: start + rise (height - low), (2, rows, n).
        """
        terrain = self.heights.astype(np.float32)

        def surface(height: FloatArray) -> FloatArray:
            east, south = start + rise * (height - low)
            return np.asarray(cv2.remap(terrain, (east / _TERRAIN).astype(np.float32),
                                        (south / _TERRAIN).astype(np.float32), cv2.INTER_LINEAR))

        height = np.full(start.shape[1:], _HEIGHT)
        # Slopes are gentle: each round leaves a tenth of the error.
        for _ in range(8):
            height = surface(height)
        base = height
        # From the tallest house down to the terrain: the first cell that is high enough.
        free = np.ones(base.shape, dtype=bool)
        for above in np.arange(_TALLEST, 0, -_RAY_STEP):
            at = self._to_cells(start + rise * (base + above - low))
            tall = cv2.remap(self.ground.buildings, *at, cv2.INTER_NEAREST)
            hit = free & (tall >= 10 * above)
            height = np.where(hit, base + above, height)
            free &= ~hit
        return self._to_cells(start + rise * (height - low))

    def _to_cells(self, metres: FloatArray) -> list[NDArray[np.float32]]:
        """Return east and south of the corner [m] as columns and rows of cells."""
        return [(axis / self.cell - 0.5).astype(np.float32) for axis in metres]


def _mesh_positions(size: int) -> FloatArray:
    """Return the lines or samples of the nodes of a mesh that covers `size` pixels and more."""
    return np.arange(-2, -(-size // _RAY_MESH) + 3, dtype=np.float64) * _RAY_MESH


def _interpolate_rays(
        mesh: tuple[FloatArray, FloatArray], lines: FloatArray, size: int) -> FloatArray:
    """Return a mesh of rays interpolated at all samples of lines, shape (2, lines, samples)."""
    steps = _mesh_positions(size)
    samples = np.arange(size)
    return np.stack([RectBivariateSpline(steps, steps, axis)(lines, samples) for axis in mesh])


def _to_plane() -> Transformer:
    """Return the transformer from longitude and latitude to the plane of the world."""
    return Transformer.from_crs("EPSG:4326", WORLD_CRS, always_xy=True)
