"""Simulated blocks: scanners that see one place from several sides, and what a user has of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel import FeatureSet, Points, Rpc, fit, rpc_of
from termsel.simulate import Angle, Pushbroom, pushbroom_at
from termsel_block.block import Block, BlockImage, Ties
from termsel_block.geometry.frame import BoolArray, FloatArray, IntArray

LON, LAT = 48.5, 34.8
_DEGREE_METRES = 111_320.0
# Stacks one below the other; then the next strip begins.
_STACKS_PER_STRIP = 20
# Distance from one stack to the next, in widths of an image.
_STACK_STEP = 0.6

VIEWS = (18.0, 20.0), (4.0, 95.0), (22.0, 170.0)
"""Angle off nadir and azimuth [degrees] of the three images of a stack."""

# Mean height of the ground [m].
_MEAN_HEIGHT = 1700.0


@dataclass(frozen=True)
class Hills:
    """The ground: how high its hills are, and where."""

    relief: float = 1.0
    phases: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


HILLS = Hills()


@dataclass(frozen=True)
class _Extent:
    """The ground [m] and the image [lines and samples] of an image, and the hills of the block."""

    width: float
    size: int
    hills: Hills


@dataclass(frozen=True, eq=False)
class Simulated:
    """A block, and the truth of it: exact scanners and the places of the ties."""

    block: Block
    sensors: tuple[Pushbroom, ...]
    ties: FloatArray


def simulate_block(
    n_images: int = 3,
    *,
    n_ties: int = 200,
    control: tuple[int, ...] = (6, 6, 0),
    rpcs: bool = False,
    bias: float = 20.0,
    drift: float = 2.0,
    jitter: tuple[float, ...] = (),
    noise: float = 0.4,
    wrong: float = 0.0,
    independent: int = 60,
    check: int = 0,
    size: int = 12000,
    gsd: float = 2.5,
    views: tuple[tuple[float, float], ...] = VIEWS,
    hills: Hills = HILLS,
    vendor_height: float = 0.0,
    bend: float = 2.0,
    seed: int = 0,
) -> Simulated:
    """Return a block of images of one strip of hilly ground.

    Images follow one another in twos or threes that see the same ground from other directions, and
    each overlaps the next along the strip.

    Parameters
    ----------
    n_images : int
        How many images there are.
    n_ties : int
        Ties of each image, about.
    control : tuple of int
        Control points of the first images; the others have none. Those of a stack are the same.
    rpcs : bool
        Whether each image has a vendor's RPC.
    bias, drift : float
        Standard deviations of the RPC's shift, and of its drift over half an image [px].
    jitter : tuple of float
        Amplitudes of a sine along the lines of the first images, of 2 to 5 periods an image, which
        the RPC lacks [px].
    noise : float
        Standard deviation of all measurements in the image [px].
    wrong : float
        Share of ties with one wrong measurement, 5 to 60 px off.
    independent : int
        Points of each image that only judge.
    check : int
        Further ones that judge a selection.
    size, gsd : int and float
        Lines and samples of each image, and pixels on the ground [m].
    views : tuple of (float, float)
        Angle off nadir and azimuth of the images of a stack, about [degrees].
    hills : Hills
        The ground.
    vendor_height : float
        What the vendor takes the mean height of the ground for, less what it is [m].
    bend : float
        Standard deviation of what the attitude bends half an image by, quadratic in time [px].
    seed : int
        Of all random numbers.
    """
    rng = np.random.default_rng(seed)
    true_sensors = [_exact_scanner(i, size, gsd, views, bend, rng) for i in range(n_images)]
    # Jitter is drawn from generators of its own, so that the rest stays the same without it.
    sensors = [_with_jitter(sensor, jitter[i], size, np.random.default_rng([seed, 2, i]))
               if i < len(jitter) else sensor for i, sensor in enumerate(true_sensors)]
    width = size * gsd
    extent = _Extent(width, size, hills)
    ground, image, index = _observe_ties(sensors, n_images, n_ties, extent, rng)
    measured_at = image + rng.normal(0, noise, image.shape)
    count = len(ground)
    # Blunders have a generator of their own, so that the rest of the block is the same without
    # them.
    blunder_rng = np.random.default_rng([seed, 1])
    for tie in np.flatnonzero(blunder_rng.random(count) < wrong):
        row = blunder_rng.choice(np.flatnonzero(index[:, 0] == tie))
        direction = blunder_rng.uniform(0, 2 * np.pi)
        measured_at[row] += blunder_rng.uniform(5, 60) * np.array(
            [np.sin(direction), np.cos(direction)])
    ties = Ties(tuple(f"T{i}" for i in range(count)), index[:, 0], index[:, 1], measured_at)
    images = []
    # The three images of a stack share control, so that it has the most that any of them has.
    stack_control = [max(control[k:k + 3], default=0) for k in range(0, n_images, 3)]
    known_ground, stack = _draw_known_points(sensors, stack_control, independent + check, width,
                                             hills, rng)
    for i, sensor in enumerate(sensors):
        n = control[i] if i < len(control) else 0
        is_control = stack >= 0
        # An image has the first n control points of its stack, and all independent points.
        use = ~is_control | ((stack == i // 3) & (_rank_in_stack(stack) < n))
        points = _measured_points(sensor, (known_ground, use, is_control), noise, size, rng)
        # The first of the independent points judge a selection instead.
        judging = np.flatnonzero([role == "independent" for role in points.roles])
        roles = np.array(points.roles, object)
        roles[judging[:check]] = "check"
        points = replace(points, roles=tuple(roles.tolist()))
        rpc = _vendor_rpc(true_sensors[i], bias, drift, size, vendor_height, rng) if rpcs else None
        images.append(BlockImage(f"I{i + 1}", FeatureSet(
            points, crs="EPSG:4979", image_size=(size, size)), rpc, size=(size, size)))
    return Simulated(Block("EPSG:4979", tuple(images), ties), tuple(sensors), ground)


def ground_heights(lonlat: FloatArray, hills: Hills = HILLS) -> FloatArray:
    """Return the heights of the simulated ground [m] at longitudes and latitudes (n, 2)."""
    east = (lonlat[:, 0] - LON) * _DEGREE_METRES * np.cos(np.radians(LAT)) / 1000
    north = (lonlat[:, 1] - LAT) * _DEGREE_METRES / 1000
    a, b, c, d = hills.phases
    return np.asarray(_MEAN_HEIGHT + hills.relief * (
        180 * np.sin(east / 3.1 + a) * np.cos(north / 4.3 + b)
        + 60 * np.sin(east / 1.1 + 1 + c) + 40 * np.cos(north / 0.9 + d)))


def _middle_of_stack(stack: int, width: float) -> tuple[float, float]:
    """Return longitude and latitude of the ground that a stack of three images sees."""
    column, row = divmod(stack, _STACKS_PER_STRIP)
    step = _STACK_STEP * width / _DEGREE_METRES
    return LON + column * step / np.cos(np.radians(LAT)), LAT - row * step


def _exact_scanner(i: int, size: int, gsd: float, views: Sequence[tuple[float, float]],
                   bend: float, rng: np.random.Generator) -> Pushbroom:
    """Return the true scanner of the i-th image, with random rates and accelerations of attitude.

    The image has `size` lines and samples of `gsd` [m]. Angles vary about `views`, pairs of
    off-nadir angle and azimuth [deg]; `bend` is the standard deviation of the effect of the
    acceleration at the end of the image [px].
    """
    middle = _middle_of_stack(i // 3, size * gsd)
    angle = views[i % len(views)][0] + rng.uniform(-3, 3)
    azimuth = views[i % len(views)][1] + rng.uniform(-10, 10)
    sensor = pushbroom_at(
        middle[0] + rng.normal(0, 0.03) * size * gsd / _DEGREE_METRES, middle[1],
        height=_MEAN_HEIGHT, off_nadir=angle, look_azimuth=azimuth, gsd=gsd,
        image_size=(size, size),
        altitude=680e3, inclination=98.1)
    ifov = sensor.ifov
    # Time from the middle of the image to its end [s].
    end = size * sensor.line_period / 2

    def with_drift(angle: Angle) -> Angle:
        """Return an angle with a random rate and acceleration added."""
        constant = angle.drift[0] if angle.drift else 0.0
        rate = angle.drift[1] if len(angle.drift) > 1 else 0.0
        return Angle((constant, rate + rng.normal(0, 4) * ifov / end,
                      rng.normal(0, bend) * ifov / end**2))
    return replace(sensor, roll=with_drift(sensor.roll), pitch=with_drift(sensor.pitch))


def _with_jitter(sensor: Pushbroom, amplitude: float, size: int,
                 rng: np.random.Generator) -> Pushbroom:
    """Return a scanner with jitter of roll and pitch, a sine each of `amplitude` [px]."""
    duration = size * sensor.line_period

    def with_sine(angle: Angle) -> Angle:
        """Return an angle with a sine of 2 to 5 periods over the image added."""
        return replace(angle, jitter=(*angle.jitter, (
            amplitude * sensor.ifov, rng.uniform(2, 5) / duration, rng.uniform(0, 2 * np.pi))))

    return replace(sensor, roll=with_sine(sensor.roll), pitch=with_sine(sensor.pitch))


def _observe_ties(sensors: list[Pushbroom], n: int, n_ties: int, extent: _Extent,
                  rng: np.random.Generator) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the ground of ties (t, 3), and of measurements line and sample (m, 2), and indices.

    Indices (m, 2) are the numbers of tie and image. All ties are seen in two images or more; each
    image sees about `n_ties`. Positions in the image are exact.
    """
    grounds: list[FloatArray] = []
    images = []
    indices = []
    count = 0
    width = extent.width
    size = extent.size
    hills = extent.hills
    middles = np.array([_middle_of_stack(i // 3, width) for i in range(n)])
    reach = 1.2 * width / _DEGREE_METRES
    for stack in range((n + 2) // 3):
        lon, lat = middles[3 * stack]
        n_candidates = max(n_ties // 4, 1) if n > 3 else n_ties
        east = (rng.uniform(-0.55, 0.55, n_candidates) * width / _DEGREE_METRES
                / np.cos(np.radians(LAT)))
        north = rng.uniform(-0.55, 0.55, n_candidates) * width / _DEGREE_METRES
        xy = np.column_stack([lon + east, lat + north])
        ground = np.column_stack([xy, ground_heights(xy, hills)])
        rows = []
        # Images of other stacks see the ground, too, as each overlaps the next.
        near = (np.abs(middles[:, 1] - lat) < reach) & (
            np.abs(middles[:, 0] - lon) * np.cos(np.radians(LAT)) < reach)
        for i in np.flatnonzero(near):
            image = sensors[i].project(ground)
            # Nine of ten that are inside are measured, as clouds and trees hide some.
            inside = np.flatnonzero(((image >= 0) & (image <= size - 1)).all(axis=1)
                                    & (rng.random(n_candidates) < 0.9))
            rows += [(t, i, *image[t]) for t in inside]
        measurements = np.array(rows).reshape(-1, 4)
        n_images = np.bincount(measurements[:, 0].astype(int), minlength=n_candidates)
        keep = np.flatnonzero(n_images > 1)
        # Ties that two images see are numbered after those of earlier stacks; others are dropped.
        new_number = np.full(n_candidates, -1)
        new_number[keep] = count + np.arange(len(keep))
        measurements = measurements[new_number[measurements[:, 0].astype(int)] >= 0]
        grounds.append(ground[keep])
        images.append(measurements[:, 2:])
        indices.append(np.column_stack([new_number[measurements[:, 0].astype(int)],
                                        measurements[:, 1]]))
        count += len(keep)
    return (np.concatenate(grounds), np.concatenate(images),
            np.concatenate(indices).astype(np.intp))


def _draw_known_points(sensors: list[Pushbroom], control: list[int], independent: int, width: float,
                       hills: Hills, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """Return the ground (n, 3) of control and of independent points, and the stack of each (n,).

    `control` has the number of control points of each stack. Independent points, as many for each
    stack as `independent`, are spread over all stacks; their stack is -1.
    """
    stacks = (len(sensors) + 2) // 3
    half_width = 0.46 * width / _DEGREE_METRES
    control_stack = np.repeat(np.arange(len(control)), control)
    stack_of = np.concatenate([control_stack, rng.choice(stacks, independent * stacks)])
    middle = np.array([_middle_of_stack(int(stack), width) for stack in stack_of]).reshape(-1, 2)
    offset = rng.uniform(-half_width, half_width, middle.shape) / [np.cos(np.radians(LAT)), 1.0]
    return (np.column_stack([middle + offset, ground_heights(middle + offset, hills)]),
            np.concatenate([control_stack, np.full(independent * stacks, -1)]).astype(np.intp))


def _rank_in_stack(stack: IntArray) -> IntArray:
    """Return the number of each place within its stack, from 0."""
    return np.array([int((stack[:k] == number).sum()) for k, number in enumerate(stack)], np.intp)


def _measured_points(sensor: Pushbroom, known: tuple[FloatArray, BoolArray, BoolArray],
                     noise: float, size: int, rng: np.random.Generator) -> Points:
    """Return the points in use that an image sees, measured with `noise` [px].

    `known` are the ground (n, 3), which of it is in use (n,), and which is control (n,); the others
    are independent points.
    """
    ground, use, is_control = known
    image = sensor.project(ground)
    inside = use & ((image >= 0) & (image <= size - 1)).all(axis=1)
    image = image + rng.normal(0, noise, image.shape)
    rows = np.flatnonzero(inside)
    return Points(tuple(f"{'G' if is_control[k] else 'Q'}{k}" for k in rows), image[rows],
                  ground[rows], roles=tuple(
                      "control" if is_control[k] else "independent" for k in rows))


def _vendor_rpc(sensor: Pushbroom, bias: float, drift: float, size: int, height_offset: float,
                rng: np.random.Generator) -> Rpc:
    """Return the RPC of a scanner with errors of attitude, as its vendor makes it.

    `bias` and `drift` are the standard deviations of the errors [px], the latter at the end of the
    image of `size` lines and samples. `height_offset` is the mean height of the ground that the
    vendor assumes, less the true one [m]: it moves the heights at which the RPC is fitted.
    """
    # Time from the middle of the image to its end [s].
    end = size * sensor.line_period / 2

    def with_errors(angle: Angle) -> Angle:
        """Return an angle whose constant and rate have random errors."""
        values = (*angle.drift, 0.0, 0.0, 0.0)[:3]
        return Angle((values[0] + rng.normal(0, bias) * sensor.ifov,
                      values[1] + rng.normal(0, drift) * sensor.ifov / end, values[2]))

    wrong_sensor = replace(sensor, roll=with_errors(sensor.roll), pitch=with_errors(sensor.pitch))
    # A vendor fits its RPC to a grid in the image at several heights: 13 x 13 x 5 positions,
    # over 400 m above and below the mean. Hills of relief 1 are 280 m high at most.
    steps = np.linspace(0, size - 1, 13)
    heights = _MEAN_HEIGHT + height_offset + np.linspace(-400, 400, 5)
    grid = np.stack(np.meshgrid(steps, steps, heights), axis=-1).reshape(-1, 3)
    ground = np.column_stack([wrong_sensor.locate(grid[:, :2], grid[:, 2]), grid[:, 2]])
    points = Points(tuple(map(str, range(len(grid)))), grid[:, :2], ground)
    control = FeatureSet(points, crs="EPSG:4979", image_size=(size, size))
    return rpc_of(fit(control, "rfm")).rpc.as_delivered()
