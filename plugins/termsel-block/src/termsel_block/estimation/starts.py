"""Where an adjustment begins: images by their control, and ties by images that have begun."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from termsel import Rpc, TermselError
from termsel_block.estimation.equations import pairs
from termsel_block.estimation.steps import soft
from termsel_block.estimation.unknowns import Measured, State
from termsel_block.geometry.cameras import Camera, PolynomialCamera, RpcCamera
from termsel_block.geometry.control import OwnControl
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame, IntArray
from termsel_block.geometry.heights import Heights
from termsel_block.geometry.physical import LEAST, PhysicalCamera, PhysicalModel

LEAST_TIES = 6
"""Ties with known places from which an image without control and RPC gets its first model."""

_LEAST_ROWS = 8  # of control: four points give an affine model in space
_SEVERAL = 3
"""Ties that two images share from which on these alone tell whether an RPC is of another place."""
_ROUNDS = 12
_BENT = 3  # fits of a first model, whose perspective is that of the one before
_MET = 0.01  # m

Rays = tuple[Camera, FloatArray, IntArray, FloatArray]
"""A camera, its parameters, and the index and place of each point it sees."""


@dataclass(frozen=True, eq=False)
class Given:
    """One image before the adjustment: its name, ties, control, and its vendor's RPC if any."""

    name: str
    measured: Measured
    control: OwnControl
    rpc: Rpc | None
    groups: tuple[str, ...] = RpcCamera.COLUMNS
    physical: PhysicalModel | None = None


def start(images: Sequence[Given], count: int, frame: Frame, heights: Heights) -> State:
    """Return the start of a block.

    Images with an RPC begin with it, those with four control points with a polynomial of these, and
    the others with the places of their ties, as soon as enough are located by images that have
    begun.

    Parameters
    ----------
    images : sequence of Given
    count : int
        Number of ties.
    frame : Frame
    heights : Heights

    Raises
    ------
    TermselError
        Naming the images that nothing holds.
    """
    cameras: list[Camera | None] = [_own(image, frame) for image in images]
    parameters: list[FloatArray | None] = [
        _begun(camera, image.control.local, image.control.normal, image.control.value)
        if camera is not None else None
        for camera, image in zip(cameras, images, strict=True)]
    _refuse_elsewhere(images, cameras, count)
    ties = np.full((count, 3), np.nan)
    located = np.zeros(count, bool)
    while True:
        begun = [i for i, camera in enumerate(cameras) if camera is not None]
        ties, located = _located(images, cameras, parameters, begun, ties, located, heights)
        waiting = [i for i in range(len(images)) if cameras[i] is None]
        if not waiting:
            break
        best = max(waiting, key=lambda i: int(located[images[i].measured.tie].sum()))
        known = located[images[best].measured.tie]
        if known.sum() < LEAST_TIES:
            _refuse(images, waiting, located)
        cameras[best], parameters[best] = _by_ties(images[best], known, ties, frame)
    # What no two images see stays in the middle, so that all places are numbers.
    ties[~located] = np.median(ties[located], axis=0) if located.any() else 0.0
    everything = [camera for camera in cameras if camera is not None]
    state = State(everything, [p for p in parameters if p is not None], ties,
                  [np.square(camera.spread) for camera in everything])
    state.sigma_ties = state.sigma_control = max(_spread(images, state), 0.1)
    return state


def _own(image: Given, frame: Frame) -> Camera | None:
    """Return the camera of an image by its RPC or its control; None where it has neither."""
    if image.rpc is not None:
        return RpcCamera(image.rpc, frame, image.groups)
    if image.physical is not None:
        local, place = image.control.points()
        return image.physical.fitted(
            frame, local, place, image.name) if len(local) >= LEAST else None
    if len(image.control) < _LEAST_ROWS:
        return None
    measured = image.control.value[:, None] * image.control.normal
    place = measured[0::2] + measured[1::2]  # of points; of lines the foot of the line
    return _polynomial(image.control.local, place)


def _refuse_elsewhere(images: Sequence[Given], cameras: Sequence[Camera | None], count: int,
                      ) -> None:
    """Refuse RPCs of another place than the image's control, or than its ties by other images.

    Raises
    ------
    TermselError
        Naming the images.
    """
    placed: dict[int, FloatArray] = {}
    for i, (image, camera) in enumerate(zip(images, cameras, strict=True)):
        if not isinstance(camera, RpcCamera):
            continue
        known = image.control
        if len(known):
            computed = camera.first_order(known.local)[0]
            away = np.abs(known.value - (known.normal * computed).sum(axis=1))
            if np.median(away) > 2 * max(np.abs(camera.rpc.image_scale)):
                raise TermselError(f"the RPC of image {image.name!r} is of another place than its "
                                   f"control: half of it is {np.median(away):.3g} px away or more",
                                   hint="Give the RPC of this image; x must be longitude or "
                                        "easting.")
        place = image.measured.place
        placed[i] = np.column_stack([np.ones(len(place)), place]) @ _inverse(
            camera, np.zeros((len(camera.groups), 2)))
    apart = Counter[int]()
    near = Counter[int]()
    apart_ties = Counter[int]()
    near_ties = Counter[int]()
    for i, j, rows, others in pairs([image.measured.tie for image in images], count):
        if i in placed and j in placed and i != j:
            widths = [camera.area()[1].max() for k in (i, j) if (camera := cameras[k]) is not None]
            far = np.median(np.abs(placed[i][rows] - placed[j][others])) > 2 * max(widths)
            (apart_ties if far else near_ties).update({i: len(rows), j: len(rows)})
            if len(rows) >= _SEVERAL:
                (apart if far else near).update((i, j))
    # One RPC of another place is apart from most images that share ties, and those from it alone.
    # A tie or two, among many that agree, are left to the search for blunders.
    named = [i for i in apart if apart[i] > near[i]] or [
        i for i in apart_ties if apart_ties[i] >= near_ties[i]]
    if named:
        names = ", ".join(repr(images[i].name) for i in sorted(named)[:5])
        raise TermselError(f"the ties of {names} are not where the RPCs of other images see "
                           "them",
                           hint="One of these RPCs is of another image, or the ties are wrong.")


def _polynomial(local: FloatArray, image: FloatArray) -> PolynomialCamera:
    """Return the polynomial whose coordinates fit an area of ground and image."""
    low = local.min(axis=0)
    high = local.max(axis=0)
    least = image.min(axis=0)
    most = image.max(axis=0)
    return PolynomialCamera((low + high) / 2, max(float((high - low)[:2].max()) / 2, 1.0),
                            max(float((most - least).max()) / 2, 1.0), (least + most) / 2)


def _begun(camera: Camera, local: FloatArray, normal: FloatArray, value: FloatArray) -> FloatArray:
    """Return the parameters that a camera begins with."""
    if isinstance(camera, PhysicalCamera):
        return camera.first
    return _fitted(camera, local, normal, value)


def _fitted(camera: Camera, local: FloatArray, normal: FloatArray, value: FloatArray,
            ) -> FloatArray:
    """Return parameters by rows of known places (see `OwnControl`) and priors, robustly."""
    parameters = np.zeros((len(camera.groups), 2))
    if not len(value):
        return parameters
    image, columns = camera.first_order(local)
    rows = (normal[:, :, None] * columns[:, None]).reshape(len(value), -1)
    for _ in range(_BENT):
        known = image + camera.perspective(parameters, local)
        aim = value - (normal * known).sum(axis=1)
        parameters = _ridge(rows, aim, np.tile(np.square(camera.spread), 2)).reshape(2, -1).T
    return parameters


def _by_ties(image: Given, known: BoolArray, ties: FloatArray, frame: Frame,
             ) -> tuple[Camera, FloatArray]:
    """Return the model of an image that sees ties whose places are known."""
    local = ties[image.measured.tie[known]]
    place = image.measured.place[known]
    camera = _polynomial(local, place) if image.physical is None else \
        image.physical.fitted(frame, local, place, image.name)
    return camera, _begun(camera, np.repeat(local, 2, axis=0),
                          np.tile(np.eye(2), (len(local), 1)), place.ravel())


def _ridge(rows: FloatArray, aim: FloatArray, variances: FloatArray) -> FloatArray:
    """Return robust estimates under independent priors."""
    weight = np.ones(len(aim))
    found: FloatArray = np.zeros(rows.shape[1])
    for _ in range(_ROUNDS):
        normal = (rows * weight[:, None]).T @ rows + np.diag(1 / variances)
        found = np.asarray(np.linalg.solve(normal, (rows * weight[:, None]).T @ aim))
        residual = aim - rows @ found
        scale = max(1.4826 * float(np.median(np.abs(residual))), 0.3)
        weight = soft(residual / scale) / max(scale, 1.0) ** 2
    return np.asarray(found)


def _located(images: Sequence[Given], cameras: Sequence[Camera | None],
             parameters: Sequence[FloatArray | None], begun: Sequence[int], ties: FloatArray,
             located: BoolArray, heights: Heights) -> tuple[FloatArray, BoolArray]:
    """Return the places of ties seen by two or more images that have models."""
    count = np.zeros(len(ties))
    total = np.zeros((len(ties), 3))
    for i in begun:
        camera = cameras[i]
        mine = images[i].measured
        assert camera is not None
        inverse = _inverse(camera, parameters[i])
        at = np.column_stack([np.ones(len(mine.tie)), mine.place]) @ inverse
        np.add.at(total, mine.tie, np.column_stack([at, np.full(len(at), camera.area()[0][2])]))
        np.add.at(count, mine.tie, 1)
    seen = count > 1
    fresh = seen & ~located
    ties = ties.copy()
    ties[fresh] = total[fresh] / count[fresh, None]
    rays = []
    for i in begun:
        camera = cameras[i]
        mine = images[i].measured
        mean = parameters[i]
        assert camera is not None
        assert mean is not None
        use = seen[mine.tie]
        rays.append((camera, mean, mine.tie[use], mine.place[use]))
    rows = np.flatnonzero(seen)
    renamed = np.full(len(ties), -1)
    renamed[rows] = np.arange(len(rows))
    ties[rows] = intersect(ties[rows], [(camera, mean, renamed[tie], place)
                                    for camera, mean, tie, place in rays], heights)
    return ties, seen


def intersect(start: FloatArray, rays: Sequence[Rays], heights: Heights | None = None,
              ) -> FloatArray:
    """Return where the rays of images meet, by least squares, from a start (t, 3) [m]."""
    ties = start.copy()
    for _ in range(_ROUNDS):
        normal, right = ((np.zeros((len(ties), 3, 3)), np.zeros((len(ties), 3)))
                         if heights is None else heights.equations(ties))
        for camera, mean, tie, place in rays:
            computed = camera.project(mean, ties[tie])
            slopes = camera.slopes(mean, ties[tie], computed)
            np.add.at(normal, tie, np.einsum("nai,naj->nij", slopes, slopes))
            np.add.at(right, tie, np.einsum("nai,na->ni", slopes, place - computed))
        # Rays that are parallel meet nowhere: such a place stays near its start.
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        ties += step
        if np.abs(step).max(initial=0.0) < _MET:
            break
    return ties


def _inverse(camera: Camera, parameters: FloatArray | None) -> FloatArray:
    """Return the affine map (3, 2) from line and sample to a place at the middle height."""
    centre, half = camera.area()
    steps = np.linspace(-1, 1, 5)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    local = np.column_stack([centre[:2] + grid * half, np.full(len(grid), centre[2])])
    assert parameters is not None
    image = camera.project(parameters, local)
    return np.asarray(np.linalg.lstsq(
        np.column_stack([np.ones(len(image)), image]), local[:, :2], rcond=None)[0])


def _spread(images: Sequence[Given], state: State) -> float:
    """Return a robust standard deviation of all residuals at the start [px]."""
    away = [part.measured.place - camera.project(parameters, state.ties[part.measured.tie])
            for part, camera, parameters in zip(
                images, state.cameras, state.parameters, strict=True)]
    return 1.4826 * float(np.median(np.abs(np.concatenate(away)))) if away else 1.0


def _refuse(images: Sequence[Given], waiting: Sequence[int], located: BoolArray) -> None:
    """Refuse images that nothing holds, by name and with what each has."""
    named = [f"{images[i].name!r} ({len(images[i].control) // 2} control features, "
             f"{int(located[images[i].measured.tie].sum())} ties whose places other images give)"
             for i in waiting[:5]]
    more = f" and {len(waiting) - 5} more" if len(waiting) > 5 else ""
    raise TermselError(
        f"nothing holds the image{'s' * (len(waiting) > 1)} {', '.join(named)}{more}",
        hint=f"Give each an RPC, four control points ({LEAST} for a model of its sensor), or "
             f"{LEAST_TIES} ties that two images with control or RPC see.")
