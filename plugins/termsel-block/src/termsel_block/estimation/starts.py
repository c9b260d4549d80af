"""Where an adjustment begins: images by their control, and ties by images that have begun."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from termsel import Rpc, TermselError
from termsel_block.estimation.equations import image_pairs
from termsel_block.estimation.steps import soft_weights
from termsel_block.estimation.unknowns import BlockUnknowns, Measured
from termsel_block.geometry.cameras import Camera, LinearCamera, PolynomialCamera, RpcCamera
from termsel_block.geometry.control import OwnControl
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame, IntArray
from termsel_block.geometry.heights import Heights
from termsel_block.geometry.physical import MIN_CONTROL_POINTS, PhysicalCamera, PhysicalModel

LEAST_TIES = 6
"""Ties with known places from which an image without control and RPC gets its first model."""

# Equations of control: those of four points, which determine an affine model in space.
_MIN_ROWS = 8
_ENOUGH_TIES = 3
"""Ties that two images share from which on these alone show whether an RPC is of another place."""
_REWEIGHTINGS = 12  # of robust estimates, all of which are made
_MAX_STEPS = 12
# Fits of a first model; each takes its perspective from the fit before.
_PERSPECTIVE_FITS = 3
# Largest step of a tie's position after which the intersection ends [m].
_CONVERGED_M = 0.01

Rays = tuple[Camera, FloatArray, IntArray, FloatArray]
"""A camera, its parameters, and the index and place of each point it sees."""

Started = dict[int, tuple[Camera, FloatArray]]
"""Camera and parameters of the images that have begun, by number."""


@dataclass(frozen=True, eq=False)
class ImageInput:
    """One image before the adjustment: its name, ties, control, and its vendor's RPC if any."""

    name: str
    measured: Measured
    control: OwnControl
    rpc: Rpc | None
    columns: tuple[str, ...] = RpcCamera.COLUMNS
    physical: PhysicalModel | None = None


def start(images: Sequence[ImageInput], count: int, frame: Frame,
          heights: Heights) -> BlockUnknowns:
    """Return the unknowns with which the adjustment of a block begins.

    Images with an RPC begin with it. Those with enough control points begin with a model fitted to
    these, a polynomial unless a model of the sensor is given. The others follow one by one, by ties
    that images before them locate.

    Parameters
    ----------
    images : sequence of ImageInput
        Their models, control and ties.
    count : int
        Number of ties.
    frame : Frame
        The local frame of the block.
    heights : Heights
        What is known of the heights of ties.

    Returns
    -------
    BlockUnknowns
        Cameras, their parameters and the positions of ties. A tie that no two images see is put in
        the middle of the others.

    Raises
    ------
    TermselError
        If an RPC is of another area than control or ties, or if too little control and ties
        determine an image; it names the images.
    """
    started: Started = {}
    for i, image in enumerate(images):
        camera = _camera_by_own_data(image, frame)
        if camera is not None:
            control = image.control
            started[i] = camera, _first_parameters(camera, control.local, control.normal,
                                                   control.value)
    _refuse_rpcs_of_other_areas(images, started, count)
    ties = np.full((count, 3), np.nan)
    located = np.zeros(count, bool)
    # Each round begins one image: the one that sees most ties whose positions are known.
    while True:
        ties, located = _locate_ties(images, started, ties, located, heights)
        waiting = [i for i in range(len(images)) if i not in started]
        if not waiting:
            break
        best = max(waiting, key=lambda i: int(located[images[i].measured.tie].sum()))
        is_located = located[images[best].measured.tie]
        if is_located.sum() < LEAST_TIES:
            _refuse_undetermined_images(images, waiting, located)
        started[best] = _camera_by_ties(images[best], is_located, ties, frame)
    # All positions must be numbers, also those of ties that no two images see.
    ties[~located] = np.median(ties[located], axis=0) if located.any() else 0.0
    cameras = [started[i][0] for i in range(len(images))]
    state = BlockUnknowns(cameras, [started[i][1] for i in range(len(images))], ties,
                          [np.square(camera.prior_sigma) for camera in cameras])
    # Ties and control begin with one standard deviation, that of all residuals.
    state.sigma_ties = state.sigma_control = max(_residual_spread(images, state), 0.1)
    return state


def _camera_by_own_data(image: ImageInput, frame: Frame) -> Camera | None:
    """Return the camera of an image by its RPC, or else by its control; None if that is too little.

    A camera by an RPC, and a polynomial, has no fitted parameters yet.
    """
    if image.rpc is not None:
        # The adjustment corrects the RPC by the control.
        return RpcCamera(image.rpc, frame, image.columns)
    if image.physical is not None:
        local, position = image.control.points()
        return image.physical.fitted(
            frame, local, position, image.name) if len(local) >= MIN_CONTROL_POINTS else None
    if len(image.control) < _MIN_ROWS:
        return None
    # Each feature has two rows, normal . position = value. Those of a point are along line and
    # sample, so that their vectors add up to its position; of a line's vertex it is a point nearby,
    # which is enough to scale a polynomial.
    measured = image.control.value[:, None] * image.control.normal
    position = measured[0::2] + measured[1::2]
    return _empty_polynomial(image.control.local, position)


def _refuse_rpcs_of_other_areas(images: Sequence[ImageInput], started: Started, count: int) -> None:
    """Raise TermselError for RPCs of another area than the image's control or its ties.

    `count` is the number of ties. The error names the images.
    """
    ground_of_ties: dict[int, FloatArray] = {}
    for i, (camera, _) in started.items():
        if not isinstance(camera, RpcCamera):
            continue
        image = images[i]
        _refuse_rpc_far_from_control(image, camera)
        # Where the RPC puts the ties on the ground, at its mean height.
        position = image.measured.position
        ground_of_ties[i] = np.column_stack([np.ones(len(position)), position]) @ _affine_inverse(
            camera, np.zeros(len(camera.groups)))
    far_images = Counter[int]()
    near_images = Counter[int]()
    ties_far = Counter[int]()
    ties_near = Counter[int]()
    for i, j, rows, other_rows in image_pairs([image.measured.tie for image in images], count):
        if i in ground_of_ties and j in ground_of_ties and i != j:
            half_width = max(float(started[k][0].area()[1].max()) for k in (i, j))
            # Both images put their common ties on the ground: are they in different areas?
            distances = np.abs(ground_of_ties[i][rows] - ground_of_ties[j][other_rows])
            is_far = np.median(distances) > 2 * half_width
            (ties_far if is_far else ties_near).update({i: len(rows), j: len(rows)})
            if len(rows) >= _ENOUGH_TIES:
                (far_images if is_far else near_images).update((i, j))
    # An RPC of another area is far from most images that share ties with it, while each of these is
    # far from it alone. If no pair shares enough ties, most ties of an image must be far: a few
    # among many that agree are left to the search for blunders.
    refused = [i for i in far_images if far_images[i] > near_images[i]] or [
        i for i in ties_far if ties_far[i] >= ties_near[i]]
    if refused:
        names = ", ".join(repr(images[i].name) for i in sorted(refused)[:5])
        raise TermselError(f"the ties of {names} are far from the positions that the RPCs of "
                           "other images give",
                           hint="One of these RPCs is of another image, or the ties are wrong.")


def _refuse_rpc_far_from_control(image: ImageInput, camera: RpcCamera) -> None:
    """Raise TermselError if half of the control is far from where the RPC puts it in the image.

    Far is more than the longer side of the image.
    """
    control = image.control
    if not len(control):
        return
    computed = camera.project(np.zeros(len(camera.groups)), control.local)
    distances = np.abs(control.value - (control.normal * computed).sum(axis=1))
    # The scale of an RPC is half of its image.
    if np.median(distances) > 2 * max(np.abs(camera.rpc.image_scale)):
        raise TermselError(f"the RPC of image {image.name!r} is of another area than its "
                           f"control: half of it is {np.median(distances):,.0f} px away or more",
                           hint="Give the RPC of this image; x must be longitude or easting.")


def _empty_polynomial(local: FloatArray, image: FloatArray) -> PolynomialCamera:
    """Return a polynomial without parameters, scaled to the extent of some points.

    `local` (n, 3) are their ground positions [m], `image` (n, 2) their lines and samples.
    """
    low = local.min(axis=0)
    high = local.max(axis=0)
    image_low = image.min(axis=0)
    image_high = image.max(axis=0)
    # Half an extent is 1 m or 1 px at least, as positions are divided by it.
    return PolynomialCamera((low + high) / 2, max(float((high - low)[:2].max()) / 2, 1.0),
                            max(float((image_high - image_low).max()) / 2, 1.0),
                            (image_low + image_high) / 2)


def _first_parameters(camera: Camera, local: FloatArray, normal: FloatArray,
                      value: FloatArray) -> FloatArray:
    """Return the parameters (p,) with which a camera begins.

    A camera of a sensor's model has them already; others are fitted to equations of points whose
    ground positions are known: `local`, `normal` and `value` as in `_fit_parameters`.
    """
    if isinstance(camera, PhysicalCamera):
        return camera.start
    assert isinstance(camera, LinearCamera)
    return _fit_parameters(camera, local, normal, value)


def _fit_parameters(camera: LinearCamera, local: FloatArray, normal: FloatArray, value: FloatArray,
                    ) -> FloatArray:
    """Return robust estimates (p,) of parameters under their priors; zeros without equations.

    Equation i says that `normal[i]` (2,) times line and sample of the ground position `local[i]`
    (3,) is `value[i]` (see `OwnControl`).
    """
    parameters = np.zeros(len(camera.groups))
    if not len(value):
        return parameters
    image, columns = camera.first_order(local)
    # Rows of line and sample by all parameters, in the direction in which each is measured.
    rows = (normal[:, :, None] * columns[:, None]).reshape(len(value), -1)
    # Perspective depends on the parameters of the fit before, so that a few fits are needed.
    for _ in range(_PERSPECTIVE_FITS):
        without_parameters = image + camera.perspective(parameters, local)
        aim = value - (normal * without_parameters).sum(axis=1)
        parameters = _robust_ridge(rows, aim, np.square(camera.prior_sigma))
    return parameters


def _camera_by_ties(image: ImageInput, is_located: BoolArray, ties: FloatArray, frame: Frame,
                    ) -> tuple[Camera, FloatArray]:
    """Return the camera of an image and its parameters (p,), fitted to its located ties.

    `is_located` marks those among the ties that the image sees; `ties` (t, 3) are the positions of
    all. The camera is a polynomial unless a model of the sensor is given.
    """
    local = ties[image.measured.tie[is_located]]
    position = image.measured.position[is_located]
    camera: Camera
    if image.physical is None:
        camera = _empty_polynomial(local, position)
    else:
        camera = image.physical.fitted(frame, local, position, image.name)
    # Two equations of each tie: of its line and of its sample.
    return camera, _first_parameters(camera, np.repeat(local, 2, axis=0),
                                     np.tile(np.eye(2), (len(local), 1)), position.ravel())


def _robust_ridge(rows: FloatArray, aim: FloatArray, variances: FloatArray) -> FloatArray:
    """Return robust estimates x (p,) of `rows` x = `aim` [px] under independent priors.

    The priors have zero means and the variances `variances` (p,).
    """
    weight = np.ones(len(aim))
    estimates: FloatArray = np.zeros(rows.shape[1])
    for _ in range(_REWEIGHTINGS):
        # Normal equations of weighted least squares under priors: (A^T P A + V^-1) x = A^T P b.
        normal = (rows * weight[:, None]).T @ rows + np.diag(1 / variances)
        estimates = np.asarray(np.linalg.solve(normal, (rows * weight[:, None]).T @ aim))
        residual = aim - rows @ estimates
        # A robust standard deviation, which is not taken to be below 0.3 px: a few rows may fit
        # exactly. Below 1 px it does not add weight against the priors.
        scale = max(1.4826 * float(np.median(np.abs(residual))), 0.3)
        weight = soft_weights(residual / scale) / max(scale, 1.0) ** 2
    return np.asarray(estimates)


def _locate_ties(images: Sequence[ImageInput], started: Started, ties: FloatArray,
                 located: BoolArray, heights: Heights) -> tuple[FloatArray, BoolArray]:
    """Return the positions (t, 3) of all ties, and whether two started images see each (t,).

    Those that two images see are where the rays of all images meet; others keep the position that
    they have in `ties`.
    """
    # A first position is the mean of those by affine maps of the images, at their middle heights.
    count = np.zeros(len(ties))
    total = np.zeros((len(ties), 3))
    for i, (camera, parameters) in sorted(started.items()):
        measured = images[i].measured
        inverse = _affine_inverse(camera, parameters)
        plan = np.column_stack([np.ones(len(measured.tie)), measured.position]) @ inverse
        middle_height = np.full(len(plan), camera.area()[0][2])
        np.add.at(total, measured.tie, np.column_stack([plan, middle_height]))
        np.add.at(count, measured.tie, 1)
    is_seen = count > 1
    # Ties that have a position keep it, as a better start than the affine maps.
    fresh = is_seen & ~located
    ties = ties.copy()
    ties[fresh] = total[fresh] / count[fresh, None]
    # Ties that two images see are numbered anew, as `intersect` takes no others.
    rows = np.flatnonzero(is_seen)
    new_number = np.full(len(ties), -1)
    new_number[rows] = np.arange(len(rows))
    rays = []
    for i, (camera, parameters) in sorted(started.items()):
        measured = images[i].measured
        use = is_seen[measured.tie]
        rays.append((camera, parameters, new_number[measured.tie[use]], measured.position[use]))
    ties[rows] = intersect(ties[rows], rays, heights)
    return ties, is_seen


def intersect(start: FloatArray, rays: Sequence[Rays], heights: Heights | None = None,
              ) -> FloatArray:
    """Return the positions (t, 3) [m] where the rays of images meet, by least squares.

    The iteration begins at `start` (t, 3). `rays` has for each image its camera, its parameters,
    the numbers of its ties (n,) and their line and sample (n, 2). With `heights`, what is known of
    the heights counts, too. A tie whose rays are parallel stays near its start.
    """
    ties = start.copy()
    for _ in range(_MAX_STEPS):
        # Known heights determine the direction along rays that are nearly parallel.
        normal, right = ((np.zeros((len(ties), 3, 3)), np.zeros((len(ties), 3)))
                         if heights is None else heights.equations(ties))
        for camera, mean, tie, position in rays:
            computed = camera.project(mean, ties[tie])
            # Least squares of one step: residuals of all rays over derivatives by the position.
            slopes = camera.slopes(mean, ties[tie], computed)
            np.add.at(normal, tie, np.einsum("nai,naj->nij", slopes, slopes))
            np.add.at(right, tie, np.einsum("nai,na->ni", slopes, position - computed))
        # Parallel rays leave the equations singular; so small a ridge moves no other tie.
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        ties += step
        if np.abs(step).max(initial=0.0) < _CONVERGED_M:
            break
    return ties


def _affine_inverse(camera: Camera, parameters: FloatArray) -> FloatArray:
    """Return the affine map (3, 2) from 1, line and sample to the ground [m] at the middle height.

    It is the least-squares map over a grid of 5 by 5 points of the camera's area.
    """
    centre, half_extent = camera.area()
    steps = np.linspace(-1, 1, 5)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    local = np.column_stack([centre[:2] + grid * half_extent, np.full(len(grid), centre[2])])
    image = camera.project(parameters, local)
    return np.asarray(np.linalg.lstsq(
        np.column_stack([np.ones(len(image)), image]), local[:, :2], rcond=None)[0])


def _residual_spread(images: Sequence[ImageInput], state: BlockUnknowns) -> float:
    """Return a robust standard deviation [px] of all ties' residuals; 1 without images."""
    residuals = [
        image.measured.position - camera.project(parameters, state.ties[image.measured.tie])
        for image, camera, parameters in zip(
            images, state.cameras, state.parameters, strict=True)]
    # 1.4826 times the median of absolute residuals is the standard deviation of normal ones.
    return 1.4826 * float(np.median(np.abs(np.concatenate(residuals)))) if residuals else 1.0


def _refuse_undetermined_images(images: Sequence[ImageInput], waiting: Sequence[int],
                                located: BoolArray) -> None:
    """Raise the TermselError that some images of a block cannot be oriented.

    It names up to five of the images whose indices are `waiting`, with the control and the ties
    that each has.
    `located` (t,) says of which ties other images give the ground position.
    """
    # A control feature has two rows, one for either direction.
    descriptions = [
        f"{images[i].name!r} ({len(images[i].control) // 2} control features, "
        f"{int(located[images[i].measured.tie].sum())} ties whose ground positions other images "
        "give)" for i in waiting[:5]]
    further = f" and {len(waiting) - 5} more" if len(waiting) > 5 else ""
    plural = "s" if len(waiting) > 1 else ""
    raise TermselError(
        f"the image{plural} {', '.join(descriptions)}{further} cannot be oriented",
        hint=f"Give each an RPC, four control points ({MIN_CONTROL_POINTS} for a model of its "
             f"sensor), or {LEAST_TIES} ties that two images with control or RPC see.")
