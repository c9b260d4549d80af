"""The verb of this package: adjust a block, and judge it by what took no part."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from termsel import TermselError
from termsel.toolkit import count_in_words, one_blas_thread
from termsel_block.block import Block, BlockImage
from termsel_block.contradictions import (
    agrees_better,
    compare_ground_with_dem,
    gain_of_control,
    note_on_independent_heights,
    note_without,
    sensor_of,
    stated_sensors,
    without_sensor,
    without_wrong_sensor,
)
from termsel_block.estimation.adjustment import adjust_block
from termsel_block.estimation.starts import ImageInput, start
from termsel_block.estimation.unknowns import Adjusted, Measured
from termsel_block.geometry.cameras import Camera, groups_of
from termsel_block.geometry.control import OwnControl, control_equations, points_in_use
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame, IntArray
from termsel_block.geometry.heights import ControlHeights, Heights, Surface, open_surface
from termsel_block.geometry.physical import MAX_MISFIT_SHARE, PhysicalModel

log = logging.getLogger("termsel.block")

PHOTO = "frame"
"""Model of photos, of termsel-cameras."""

_PHOTO_MISFIT_RATIO = 0.5
"""Misfit of photos by that of polynomials from which on images without a model are photos."""

_CONTROL_MISFIT_RATIO = 3.0
"""Misfit of control by that of ties, 1 px at least, from which on polynomials are not the model."""

_TIES_CONTRADICT = "ties-contradict"
"""Code of the error of ties that agree no better than places at random."""

_LEFT_OUT = "the block is adjusted without it"
"""What is done about a DEM that the ties contradict."""

_DEM_MISFIT_RATIO = 2.0
"""Misfit of ties under a DEM by that without it, 1 px at least, from which on it is left out."""

_EXTENT_TIES = 8
"""Ties of an image from which on their extent shows that of the image."""


@dataclass(frozen=True, eq=False)
class BlockResult:
    """A block as adjusted, with the accuracy it has on points that took no part.

    Parameters
    ----------
    block : Block
    frame : Frame
    adjusted : Adjusted
    control : tuple of OwnControl
        Control of each image.
    """

    block: Block
    frame: Frame
    adjusted: Adjusted
    control: tuple[OwnControl, ...]

    @cached_property
    def covariances(self) -> list[FloatArray]:
        """Covariance of each image's parameters [px2]."""
        return self.adjusted.solved.image_covariances[:len(self.block.images)]

    @cached_property
    def ties(self) -> FloatArray:
        """Places of the ties in the CRS of the block, shape (t, 3)."""
        return self.frame.ground(self.adjusted.state.ties)

    @cached_property
    def sigma_ties(self) -> FloatArray:
        """Standard deviations of the ties' places [m], shape (t, 3)."""
        covariance = self.adjusted.solved.covariance_of_ties()
        return np.asarray(np.sqrt(np.maximum(np.einsum("tii->ti", covariance), 0.0)))

    def camera(self, i: int) -> Camera:
        """Return the model of an image."""
        return self.adjusted.state.cameras[i]

    def project(self, i: int, ground: FloatArray) -> FloatArray:
        """Return line and sample (n, 2) [px] of ground coordinates (n, 3) in an image."""
        return self.camera(i).project(self.adjusted.state.parameters[i], self.frame.local(ground))

    def sigma(self, i: int, ground: FloatArray) -> FloatArray:
        """Return the standard deviations (n, 2) [px] of computed line and sample."""
        rows = self.rows(i, self.frame.local(ground))
        return np.asarray(np.sqrt(np.einsum("nap,pq,naq->na", rows, self.covariances[i], rows)))

    def rows(self, i: int, local: FloatArray) -> FloatArray:
        """Return derivatives (n, 2, p) by an image's parameters at places of the frame."""
        return self.camera(i).jacobian(self.adjusted.state.parameters[i], local)


@one_blas_thread
def adjust(block: Block, *, progress: Callable[[float], None] | None = None) -> BlockResult:
    """Adjust images, their control and their ties together.

    Parameters
    ----------
    block : Block
        Images, control and ties, as `read_block` returns them.
    progress : callable, optional
        Called with the share that is done.

    Returns
    -------
    BlockResult
        The model of each image, the ties on the ground, and their accuracy.

    Raises
    ------
    TermselError
        If an image is not determined, if an RPC or the ties contradict the rest, or if there is
        neither control nor an RPC. The error names the images.

    Notes
    -----
    An image whose sensor is contradicted is adjusted as one of an unknown sensor. The block of the
    result then has it without that option, and says so in its notes.

    Examples
    --------
    >>> from termsel.testing import invoke
    >>> from termsel_block import adjust, read_block
    >>> written = invoke("block-example", "scene")  # three images, of which one has no control
    >>> adjusted = adjust(read_block("scene/block.toml"))
    >>> len(adjusted.block.images)
    3
    """
    frame = Frame.at(_frame_positions(block), block.crs)
    result = _adjust_with_fit_dem(block, frame, progress)
    right_sensors: set[str] = set()
    freed_blocks: dict[str, BlockResult] = {}
    # Each round frees the sensor that is contradicted most, or finds that it is right.
    while (contradicted := without_wrong_sensor(
            result.block, result.adjusted, right_sensors)) is not None:
        freed_block, worst = contradicted
        try:
            freed = _adjust_as_stated(freed_block, frame, progress)
        except TermselError:
            # Without its sensor the image is not determined: nothing changes, and it counts as
            # right.
            freed = result
        if agrees_better(result.adjusted, freed.adjusted, worst):
            result = freed
            # The other blocks were adjusted with the sensor that is left out now.
            freed_blocks = {}
        else:
            sensor = sensor_of(result.block, worst)
            right_sensors.add(sensor)
            freed_blocks[sensor] = freed
    return _with_notes_on_dem(
        _as_photos_if_better(_without_harmful_sensors(result, freed_blocks, progress), progress))


def _adjust_with_fit_dem(block: Block, frame: Frame,
                         progress: Callable[[float], None] | None) -> BlockResult:
    """Return the block as adjusted with its DEM, or without a DEM that its ties contradict.

    In the latter case a note is added. Raises TermselError if the ties contradict one another
    without the DEM, too, or if the block cannot be adjusted.
    """
    try:
        return _adjust_as_stated(block, frame, progress)
    except TermselError as error:
        if error.code != _TIES_CONTRADICT or block.dem is None:
            raise
        free = _adjust_as_stated(replace(block, dem=None), frame, progress)
    _, note = _ground_on_dem(free, block.dem)
    return _with_note(free, note.format(_LEFT_OUT) if note else (
        f"The ties contradict the DEM, and {_LEFT_OUT}: check its heights and their unit."))


def _with_note(result: BlockResult, note: str) -> BlockResult:
    """Return the result with one note more in its block."""
    block = result.block
    return replace(result, block=replace(block, notes=(*block.notes, note)))


def _ground_on_dem(free: BlockResult, path: Path) -> tuple[float, str]:
    """Return the height of the ground above a DEM [m], and a note (see `compare_ground_with_dem`).

    `free` is the block as adjusted without the DEM in the file `path`.
    """
    with open_surface(path, free.block.crs) as dem:
        return compare_ground_with_dem(free.ties, free.frame, free.adjusted, dem)


def _as_photos_if_better(result: BlockResult,
                         progress: Callable[[float], None] | None) -> BlockResult:
    """Return the result, or that with images of no stated model as photos if it fits far better.

    A note says so, or that control contradicts the polynomials. The result is returned as it is if
    all images have an RPC or a model.
    """
    # Polynomials are for images from space. They miss points of photos by a hundred px, where their
    # posterior, which takes the model for true, predicts some tens.
    block = result.block
    unstated = [image.name for image in block.images if image.rpc is None and image.model == "auto"]
    if not unstated:
        return result
    images = tuple(replace(image, model=PHOTO) if image.name in unstated else image
                   for image in block.images)
    try:
        photos = _adjust_as_stated(replace(block, images=images), result.frame, progress)
    except TermselError as error:
        # There are too few points, these are no photos, or termsel-cameras is not installed.
        log.debug("not adjusted as photos: %s", error)
        photos = result
    before = _block_misfit(result.adjusted)
    after = _block_misfit(photos.adjusted)
    is_one = len(unstated) == 1
    have = (f"{count_in_words(len(unstated), 'image')} {'has' if is_one else 'have'} no RPC and "
            "no model")
    if photos.adjusted.converged and after < _PHOTO_MISFIT_RATIO * before:
        note = (f"{have}, and {'is' if is_one else 'are'} taken for photos (model "
                f"{PHOTO}): control and ties agree to {after:.2g} px, by polynomials to "
                f"{before:.2g} px.")
        return replace(photos, block=replace(photos.block, notes=(*block.notes, note)))
    state = result.adjusted.state
    if state.sigma_control > _CONTROL_MISFIT_RATIO * max(state.sigma_ties, 1.0):
        note = (f"{have}: control is {state.sigma_control:.2g} px off their polynomials, where "
                f"ties agree to {state.sigma_ties:.2g} px. The errors of places may be several "
                f"times what is predicted. State the model, such as {PHOTO} for photos.")
        return replace(result, block=replace(block, notes=(*block.notes, note)))
    return result


def _block_misfit(adjusted: Adjusted) -> float:
    """Return the standard deviation of control or of ties in a block [px], whichever is larger."""
    return max(adjusted.state.sigma_control, adjusted.state.sigma_ties)


def _without_harmful_sensors(result: BlockResult, freed_blocks: dict[str, BlockResult],
                             progress: Callable[[float], None] | None) -> BlockResult:
    """Return the result without the sensors that make the ground rough or contradict control.

    In each round the block is adjusted without each stated sensor, and the one is left out without
    which control is predicted best, until none is better left out. A note of the block says which.
    `freed_blocks` has results without a sensor that are known already.
    """
    # A sensor that is nearly right may fit its own images well, while the ground bends instead.
    while True:
        best: BlockResult | None = None
        best_gain = -np.inf
        for sensor in stated_sensors(result.block):
            without = without_sensor(result.block, sensor)
            try:
                freed = freed_blocks.get(sensor) or _adjust_as_stated(
                    without, result.frame, progress
                )
            except TermselError:
                # Without this sensor an image is not determined.
                continue
            note = note_without(result.block, sensor, result.adjusted, freed.adjusted)
            gain = gain_of_control(result.adjusted, freed.adjusted)
            if note and gain > best_gain:
                best = replace(freed, block=replace(without, notes=(*without.notes, note)))
                best_gain = gain
        if best is None:
            return result
        result = best
        freed_blocks = {}


def _with_notes_on_dem(result: BlockResult) -> BlockResult:
    """Return the result with notes on what contradicts its DEM, adjusted again if RPCs do.

    It is returned as it is without a DEM, and if control states heights, which the block follows
    (see `Heights`).
    """
    _, stated, _ = _control_positions(result.block)
    if result.block.dem is None or stated.any():
        return result
    with open_surface(result.block.dem, result.block.crs) as dem:
        independent_note = note_on_independent_heights(result.block, result.frame, dem)
    if not any(map(len, result.control)):
        result = _doubt_dem(result, result.block.dem)
    return _with_note(result, independent_note) if independent_note else result


def _doubt_dem(result: BlockResult, path: Path) -> BlockResult:
    """Return the result of a block without control, with a note on its DEM.

    If the RPCs contradict the DEM, the block is adjusted again with an offset of the DEM that is as
    uncertain as both differ. If ties agree far less with it than without the DEM, the DEM is left
    out.
    """
    # Without control the RPCs follow the DEM: only a block without it shows whether they agree.
    block = result.block
    try:
        free = _adjust_as_stated(replace(block, dem=None), result.frame, None)
    except TermselError:
        # The DEM alone determines the heights, so that nothing can contradict it.
        return _with_note(result, _height_errors(result))
    offset, note = _ground_on_dem(free, path)
    if not note:
        return _with_note(result, _height_errors(result))
    try:
        doubted = _adjust_as_stated(block, result.frame, None, doubt=abs(offset))
    except TermselError as error:
        log.debug("not adjusted under the DEM: %s", error)
        return _with_note(free, note.format(_LEFT_OUT))
    ties_agree = (doubted.adjusted.state.sigma_ties
                  < _DEM_MISFIT_RATIO * max(free.adjusted.state.sigma_ties, 1.0))
    if doubted.adjusted.converged and ties_agree:
        return _with_note(doubted, note.format("the DEM is taken to be as far off"))
    return _with_note(free, note.format(_LEFT_OUT))


def _height_errors(result: BlockResult) -> str:
    """Return a sentence on the errors of images by 100 m of the DEM, which no interval includes."""
    tie_rows = result.adjusted.solved.tie_rows[:len(result.block.images)]
    px_of_100_m = [100 * float(np.median(np.hypot(*rows.slopes[:, :, 2].T))) for rows in tie_rows
                   if len(rows.tie)]
    return ("Without control the heights are the DEM's. For each 100 m that it is off, images are "
            f"up to {max(px_of_100_m):.2g} px off, which intervals do not include.")


def _adjust_as_stated(block: Block, frame: Frame, progress: Callable[[float], None] | None,
                      doubt: float = 0.0) -> BlockResult:
    """Return the block as adjusted with the models that it states.

    `doubt` [m] is the standard deviation of the DEM's offset if that is more than the usual one.
    Raises TermselError if an image is not determined, or if data contradict one another.
    """
    with ExitStack() as files:
        dem = files.enter_context(open_surface(block.dem, block.crs)) if block.dem else None

        inputs = []
        for i, image in enumerate(block.images):
            in_image = block.ties.image == i
            inputs.append(ImageInput(
                image.name, Measured(block.ties.tie[in_image], block.ties.position[in_image]),
                control_equations(image.features, frame), image.rpc,
                *_correction_columns(image)))
        heights = replace(heights_of(block, frame, dem), doubt=doubt)
        state = start(inputs, len(block.ties.names), frame, heights)
        adjusted = adjust_block(
            state, [image.measured for image in inputs], [image.control for image in inputs],
            heights, progress=progress, fixed=[image.model != "auto" for image in block.images])
    _refuse_contradiction(adjusted, inputs)
    return BlockResult(block, frame, adjusted, tuple(image.control for image in inputs))


def _correction_columns(image: BlockImage) -> tuple[tuple[str, ...], PhysicalModel | None]:
    """Return the columns that correct an image's RPC, and its physical model.

    With the model `auto`, or an RPC, there are columns and no physical model, else the opposite.
    """
    if image.model == "auto":
        return groups_of("affine"), None
    return (groups_of(image.model), None) if image.rpc is not None else (
        (), PhysicalModel(image.model, image.options))


def _refuse_contradiction(adjusted: Adjusted, inputs: list[ImageInput]) -> None:
    """Raise TermselError if ties agree no better than places at random would."""
    extents = [np.ptp(image.measured.position, axis=0).max() for image in inputs
               if len(image.measured.tie) >= _EXTENT_TIES]
    # Positions at random differ by about a third of the image; real ties by a pixel or so.
    sigma = adjusted.state.sigma_ties
    if extents and sigma > MAX_MISFIT_SHARE * np.median(extents):
        raise TermselError(f"the ties contradict one another: they differ by {sigma:.3g} px",
                           code=_TIES_CONTRADICT,
                           hint="Check that an id is the same point in all images, and that line "
                                "and sample are not exchanged.")


def _frame_positions(block: Block) -> FloatArray:
    """Return the ground positions (n, 3) about whose middle the frame is, in the block's CRS.

    They are those of all points, whatever their role, of the ends of lines and of the middles of
    RPCs. Raises TermselError if no image has control in use or an RPC.
    """
    features_of_images = [image.features for image in block.images if image.features is not None]
    grounds = [features.points.ground for features in features_of_images]
    grounds += [features.lines.ground.reshape(-1, 3) for features in features_of_images]
    ground = np.concatenate([np.empty((0, 3)), *grounds])
    # Independent points take no part in the adjustment, so that they determine nothing.
    has_control = any(len(points_in_use(features)) or len(features.lines)
                      for features in features_of_images)
    middles = _middles_of_rpcs(block)
    if not has_control and not len(middles):
        raise TermselError("no image of the block has control or an RPC",
                           hint="Give at least one image points, lines or an RPC.")
    return np.concatenate([ground, middles])


def _middles_of_rpcs(block: Block) -> FloatArray:
    """Return the middles (k, 3) of the areas of RPCs, in the CRS of the block; none without RPCs.
    """
    from termsel.toolkit.coordinates import transformation_between

    middles = [image.rpc.ground_offset for image in block.images if image.rpc is not None]
    if not middles:
        return np.empty((0, 3))
    return transformation_between("EPSG:4979", block.crs)(np.array(middles))


def heights_of(block: Block, frame: Frame, dem: Surface | None) -> Heights:
    """Return what is known of heights beforehand, by RPCs or control, and by the DEM if any.

    The mean height is that of the RPCs, or of control if there is no RPC.
    """
    control, stated, of_rows = _control_positions(block)
    control_heights = frame.heights(control)
    rpcs = [image.rpc for image in block.images if image.rpc is not None]
    if rpcs:
        mean = float(frame.heights(_middles_of_rpcs(block)).mean())
        spread = float(np.max([abs(rpc.ground_scale[2]) for rpc in rpcs]))
    else:
        mean = float(control_heights.mean())
        spread = max(3 * float(control_heights.std()), 100.0)
    over = control_heights - (mean if dem is None else dem(control[:, :2]))
    # Off its raster a DEM has no height, and heights that are from the DEM show nothing of it.
    is_usable = np.isfinite(over) & stated
    # The usable heights are numbered anew, and the others are -1; the last entry keeps -1.
    new_number = np.append(np.where(is_usable, np.cumsum(is_usable) - 1, -1), -1)
    crowd = np.median(np.bincount(block.ties.image, minlength=len(block.images)))
    return Heights(frame, mean, spread, dem, ControlHeights(
        over[is_usable], tuple(new_number[rows] for rows in of_rows)), float(crowd))


def _control_positions(block: Block) -> tuple[FloatArray, BoolArray, list[IntArray]]:
    """Return the positions (k, 3) of all control, which of them state a height, and row indices.

    The indices are, for each image, the numbers among the k of the positions of its rows (see
    `control_equations`). Heights from the DEM are not stated.
    """
    tables = [np.empty((0, 4))]
    rows = []
    count = 0
    for image in block.images:
        if image.features is None:
            rows.append(np.empty(0, np.intp))
            continue
        points = points_in_use(image.features)
        lines = image.features.lines
        ground = np.concatenate([points.ground, lines.ground.reshape(-1, 3)])
        ids = [*points.ids, *np.repeat(lines.ids, 2).tolist()]
        tables.append(np.column_stack([ground, [name not in image.of_dem for name in ids]]))
        numbers = count + np.arange(len(ground))
        # As in `control_equations`: two rows of a point, one of each vertex of a line.
        rows.append(np.concatenate([np.repeat(numbers[:len(points)], 2), numbers[len(points):]]))
        count += len(ground)
    # Control that several images see counts once.
    unique_control, index = np.unique(np.concatenate(tables), axis=0, return_inverse=True)
    return unique_control[:, :3], unique_control[:, 3] > 0, [index.ravel()[row] for row in rows]
