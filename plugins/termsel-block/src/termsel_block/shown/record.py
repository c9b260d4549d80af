"""The record of a block: block.json, and the figures of summary and page."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import msgspec
import numpy as np

from termsel import Result
from termsel.toolkit import count_in_words, sentence_on_common_offset
from termsel.toolkit.models import RARE, Predicted
from termsel.toolkit.runs import rpc_without_record
from termsel_block.accuracy import errors_in_space, independent_points, predicted_errors, rms_length
from termsel_block.contradictions import doubts_of_models
from termsel_block.geometry.cameras import RpcCamera
from termsel_block.geometry.frame import IntArray
from termsel_block.joint import BlockResult

BLOCK_SCHEMA = "termsel-block-1"

_COARSE_PX = 2.0
"""Standard deviation of a tie [px] that is worth a doubt."""
_LARGE_CORRECTION = 50.0
"""Difference of a correction over an image [px]: vendors' RPCs drift by far less."""
_NAMED_IMAGES, _MIN_MOVE = 3, 1e-3
"""Images that are named, and how far one moves that has not settled [px]."""
_MIN_SHARE_IN_USE = 0.5
"""Share of an image's ties or control in use below which they are hardly all blunders."""
_MAX_HALF_RANGES = 2.0
"""Half ranges of an RPC's heights beyond which no ground is: vendors state them with a margin."""
_LARGE_DEM_OFFSET = 12.0
"""Metres that a DEM is off as a whole: geoid and ellipsoid are tens apart."""


class WrongTie(msgspec.Struct, frozen=True):
    """A measurement of a tie that was left out."""

    id: str
    image: str
    error: float
    """Distance from where the others see it, or where all its rays meet if none is used [px]."""
    any_ray: bool = False
    """Whether no measurement of the tie is used, as its images contradict one another: which one is
    wrong is not known, and that one is farther off than the distance says."""


class WrongControl(msgspec.Struct, frozen=True):
    """A point or line of the control that was left out."""

    id: str
    image: str
    error: float
    """Distance from the model [px]."""


class ImageRecord(msgspec.Struct, frozen=True):
    """One image of the block."""

    name: str
    model: str
    """Correction of the RPC: none, shift, drift, affine or smooth; "polynomial", or a model's name.
    """
    evidence: dict[str, float]
    """Logarithm of the Bayes factor of each part of the model that was weighed."""
    control: int
    """Points and lines of its own in use."""
    ties: int
    """Ties in use."""
    rmse_ties: float
    """RMSE of these ties [px]."""
    predicted: float
    """RMSE that points measured as the control will have [px]."""
    low: float
    high: float
    """The interval of that RMSE, of 90 %, for the independent points where there are some."""
    uncertainty: float
    """RMSE that points over the area of the ties will have [px]."""
    independent: float | None = None
    """RMSE of independent points [px], the accuracy: of a block that is written, by the images' own
    results."""
    n_independent: int = 0
    rpc: str | None = None
    """File of its RPC."""
    options: dict[str, str | int | float | bool] = {}
    """Options of its model."""


class SpaceRecord(msgspec.Struct, frozen=True):
    """RMSE of independent points that two images or more see, by intersection [m]."""

    east: float
    north: float
    up: float
    n: int


class BlockRecord(msgspec.Struct, frozen=True):
    """A block as adjusted."""

    schema: str
    crs: str
    images: list[ImageRecord]
    ties: int
    measurements: int
    sigma_ties: float
    """Standard deviation of a tie in line and in sample, from the adjustment [px]."""
    sigma_control: float
    """Standard deviation of control in line and in sample, from the adjustment [px]."""
    redundancy: float
    steps: int
    converged: bool
    datum: str
    """What holds the block on the ground."""
    parts: list[list[str]]
    """Images that ties join; one part where the block is one."""
    sigma_places: tuple[float, float, float]
    """Median standard deviation of the places of ties, east, north and up [m]."""
    wrong_ties: list[WrongTie]
    wrong_control: list[WrongControl]
    notes: list[str]
    independent: SpaceRecord | None = None


def block_schema() -> dict[str, Any]:
    """Return the JSON Schema of block.json."""
    return msgspec.json.schema(BlockRecord)


def record_of(result: BlockResult) -> BlockRecord:
    """Return the record of a block: images, ties, blunders, figures and notes, as in block.json.

    `independent` is None without independent points that two images see, and `sigma_places` NaN
    without ties that two images see.
    """
    block = result.block
    ties = block.ties
    adjusted = result.adjusted
    images = [_image_record(result, i) for i in range(len(block.images))]
    parts = []
    for indices in connected_images(ties.tie, ties.image, len(block.images)):
        parts.append([block.images[i].name for i in indices])
    # A tie in a single image has no position of its own.
    east, north, up = np.median(result.sigma_ties[times_seen(result) > 1], axis=0).tolist()
    notes = [*block.notes, *doubts_about_block(result), *doubts_about_predictions(images)]
    space = errors_in_space(result)
    independent = None
    if space is not None:
        independent = SpaceRecord(space.east, space.north, space.up, space.n)
    return BlockRecord(
        schema=BLOCK_SCHEMA,
        crs=block.crs,
        images=images,
        ties=len(ties.names),
        measurements=len(ties.tie),
        sigma_ties=adjusted.state.sigma_ties,
        sigma_control=adjusted.state.sigma_control,
        redundancy=adjusted.freedom,
        steps=adjusted.steps,
        converged=adjusted.converged,
        datum=_datum_in_words(images),
        parts=parts,
        sigma_places=(east, north, up),
        wrong_ties=_rejected_ties(result),
        wrong_control=_rejected_control(result),
        notes=notes,
        independent=independent)


def record_as_written(record: BlockRecord, results: Sequence[Result]) -> BlockRecord:
    """Return a record with the RMSE of independent points by the images' own results.

    These are what is written and used: an image's own fit is that of the block but for its priors,
    and where these count, as for a camera, its points lie closer or farther. The notes follow.
    """
    images = []
    for image, result in zip(record.images, results, strict=True):
        rmse = result.rmse["independent"]
        if rmse is not None:
            image = msgspec.structs.replace(image, independent=rmse.total, n_independent=rmse.n)
        images.append(image)
    doubts = doubts_about_predictions(record.images)
    notes = [note for note in record.notes if note not in doubts]
    return msgspec.structs.replace(record, images=images,
                                   notes=[*notes, *doubts_about_predictions(images)])


def _advice_on_photos(result: BlockResult) -> str:
    """Return advice for photos that may be taken for images of a scanner; "" if none may be.

    Two images or more without an RPC and a model may be photos.
    """
    unknown = [image for image in result.block.images if image.rpc is None
               and image.model == "auto"]
    if len(unknown) < 2:
        return ""
    return (' If these are photos, state model = "frame" for each: polynomials are for images from '
            "space.")


def doubts_about_block(result: BlockResult) -> list[str]:
    """Return sentences with advice on what is unlikely of good data; [] if nothing is."""
    return [*_doubts_about_adjustment(result),
            *chain.from_iterable(_doubts_about_image(result, i)
                                 for i in range(len(result.block.images))),
            *_doubts_about_dem(result)]


def _doubts_about_adjustment(result: BlockResult) -> list[str]:
    """Return sentences on what is doubtful of the block as a whole; [] if nothing is.

    They are on RPCs without a record, coarse ties, an adjustment that did not converge, points with
    the role check, and models.
    """
    adjusted = result.adjusted
    notes = [f"Image {image.name}: {doubt}" for image in result.block.images
             if image.rpc is not None and (doubt := rpc_without_record(image.rpc))]
    if adjusted.state.sigma_ties > _COARSE_PX:
        notes.append(f"Ties agree to {adjusted.state.sigma_ties:.1f} px only, which is coarse for "
                    "measurements: check RPCs and ties, and that line and sample are not "
                    "exchanged." + _advice_on_photos(result))
    if not adjusted.converged:
        worst = [result.block.images[i].name for i in np.argsort(-adjusted.moved)[:_NAMED_IMAGES]
                 if adjusted.moved[i] > _MIN_MOVE]
        notes.append((f"Images that still moved in the last step: {', '.join(worst)}. Give them "
                     if worst else "The precision of ties and control did not settle. Give images "
                     ) + "more control points or ties, or a plainer model.")
    # In a single image such points select a model; an adjustment of a block selects none.
    n_check = sum(image.features.points.roles.count("check") for image in result.block.images
                  if image.features is not None)
    if n_check:
        notes.append(f"{count_in_words(n_check, 'observation')} with the role check "
                     f"{'is' if n_check == 1 else 'are'} adjusted as control: only block-select "
                     "selects. Points with the role independent assess.")
    return notes + doubts_of_models(result.block, adjusted)


def _doubts_about_image(result: BlockResult, i: int) -> list[str]:
    """Return sentences on what is doubtful of the i-th image: its ties, control and RPC.

    [] if nothing is.
    """
    adjusted = result.adjusted
    image = result.block.images[i]
    notes = []
    used = adjusted.state.in_use[i]
    if len(used) and used.mean() < _MIN_SHARE_IN_USE:
        notes.append(f"{(~used).sum()} of {len(used)} ties of {image.name} were left out: check "
                     "its model, and whether the ties are of this image.")
    control = adjusted.state.control_in_use[i]
    if len(control) and control.mean() < _MIN_SHARE_IN_USE:
        notes.append(f"{(~control).sum() / len(control):.0%} of the control of {image.name} was "
                     "rejected: check its coordinates and heights, and those of the DEM if there "
                     "is one.")
    camera = result.camera(i)
    if not isinstance(camera, RpcCamera):
        return notes
    if len(control):
        heights = result.frame.geodetic(result.control[i].local)[:, 2]
        above_mean = heights - camera.rpc.ground_offset[2]
        least = float(np.abs(above_mean).min())
        # The scale of an RPC's heights is half of their range.
        if least > _MAX_HALF_RANGES * abs(camera.rpc.ground_scale[2]):
            notes.append(f"The control of {image.name} is {least:.0f} m or more "
                         f"{'above' if above_mean[0] > 0 else 'below'} the mean height of its "
                         "RPC: check the unit of its heights and what they refer to.")
    ties = adjusted.state.ties[result.block.ties.tie[result.block.ties.image == i]]
    if len(ties):
        # A shift is the same all over the image, and shows nothing, however large it is.
        correction = camera.correction(adjusted.state.parameters[i], ties)
        difference = np.ptp(correction, axis=0).max()
        if difference > _LARGE_CORRECTION:
            notes.append(f"The correction of the RPC of {image.name} differs by "
                         f"{difference:.0f} px over the image: is it of another image?")
    return notes


def _doubts_about_dem(result: BlockResult) -> list[str]:
    """Return a doubt about the heights of a DEM that control contradicts; [] without control."""
    offset = result.adjusted.offset
    # Without control RPCs alone contradict a DEM, for which `joint` adjusts a block without it.
    if (result.block.dem is None or not any(map(len, result.control))
            or abs(offset) <= _LARGE_DEM_OFFSET):
        return []
    return [sentence_on_common_offset(-offset, "the ground", "by control and ties")]


def doubts_about_predictions(images: Sequence[ImageRecord]) -> list[str]:
    """Return a sentence on the images whose independent points are beyond their interval.

    [] if chance explains all of them.
    """
    # Errors that control, ties and DEM have in common are in no residual, and so in no interval.
    assessed = [image for image in images if image.independent is not None]
    beyond = []
    for image in assessed:
        predicted = Predicted(image.predicted, image.low, image.high)
        measured = image.independent or 0.0
        # Of many images some are beyond by chance.
        if measured > image.high and predicted.chance_beyond(measured) < RARE / len(assessed):
            beyond.append(f"{image.name} {measured:.2f} px instead of {image.low:.2f} to "
                          f"{image.high:.2f} px")
    if not beyond:
        return []
    named = ", ".join(beyond[:_NAMED_IMAGES])
    further = f", {len(beyond) - _NAMED_IMAGES} more" if len(beyond) > _NAMED_IMAGES else ""
    return [f"Independent check points contradict what is predicted ({named}{further}): they, or "
            "control and DEM, may be off as a whole. Check what their coordinates and heights "
            "refer to, and in what unit they are."]


def _image_record(result: BlockResult, i: int) -> ImageRecord:
    """Return the record of the image with the index `i`.

    Without independent check points their RMSE is None, and their number 0.
    """
    image = result.block.images[i]
    state = result.adjusted.state
    used = state.in_use[i]
    expected = predicted_errors(result, i)
    points = independent_points(result, i)
    residuals = result.adjusted.residuals[i][used]
    # A feature has a row for each of its measurements, and counts once.
    control = set(np.array(result.control[i].feature)[state.control_in_use[i]].tolist())
    independent = None
    if points is not None:
        independent = rms_length(points.image - result.project(i, points.ground))
    return ImageRecord(
        name=image.name, model=correction_of(result, i),
        evidence=dict(result.adjusted.evidence[i]), control=len(control), ties=int(used.sum()),
        rmse_ties=rms_length(residuals) if len(residuals) else 0.0, predicted=expected.rmse,
        low=expected.low, high=expected.high,
        uncertainty=predicted_errors(result, i, anywhere=True).rmse, independent=independent,
        n_independent=0 if points is None else len(points),
        rpc=None if image.rpc_file is None else image.rpc_file.name, options=dict(image.options))


def correction_of(result: BlockResult, i: int) -> str:
    """Return the model of an image in one word.

    It is the largest correction of an RPC that is kept, "none" if none is, "polynomial", or the
    name of a model.
    """
    camera = result.camera(i)
    if not isinstance(camera, RpcCamera):
        name = result.block.images[i].model
        return "polynomial" if name == "auto" else name
    return camera.groups[-1] if camera.groups else "none"


def _datum_in_words(images: Sequence[ImageRecord]) -> str:
    """Return words on what defines the position of the block on the ground: control, or RPCs."""
    features = sum(image.control for image in images)
    if not features:
        return ("the vendor's RPCs, as there is no control: the absolute accuracy is theirs, and "
                "predicted figures include only their spread")
    holding = sum(image.control > 0 for image in images)
    return f"{features} GCP observations in {holding} of {len(images)} images"


def _rejected_ties(result: BlockResult) -> list[WrongTie]:
    """Return the measurements of ties that the adjustment rejected, the largest error first.

    Errors are distances in the image [px]. Each says whether the tie is in use nowhere.
    """
    wrong_ties = []
    ties = result.block.ties
    seen = times_seen(result)
    for i, (residual, used) in enumerate(zip(
            result.adjusted.residuals, result.adjusted.state.in_use, strict=True)):
        names = ties.tie[ties.image == i]
        wrong_ties += [WrongTie(ties.names[names[k]], result.block.images[i].name,
                                float(np.hypot(*residual[k])), bool(seen[names[k]] == 0))
                       for k in np.flatnonzero(~used)]
    return sorted(wrong_ties, key=lambda wrong: -wrong.error)


def _rejected_control(result: BlockResult) -> list[WrongControl]:
    """Return the control features that the adjustment rejected, the largest error [px] first.

    A feature that several images see is one for each image that rejected it.
    """
    wrong_control = []
    for i, (control, residual, used) in enumerate(zip(
            result.control, result.adjusted.of_control, result.adjusted.state.control_in_use,
            strict=True)):
        errors: dict[str, float] = {}
        for k in np.flatnonzero(~used):
            name = control.feature[k]
            # The error of a feature is the root of the sum of squares of its two rows.
            errors[name] = float(np.hypot(errors.get(name, 0.0), residual[k]))
        wrong_control += [WrongControl(name, result.block.images[i].name, error)
                          for name, error in errors.items()]
    return sorted(wrong_control, key=lambda wrong: -wrong.error)


def times_seen(result: BlockResult) -> IntArray:
    """Return the number of images (t,) in which each tie is in use; below two it has no place."""
    ties = result.block.ties
    count = np.zeros(len(ties.names), int)
    for i, used in enumerate(result.adjusted.state.in_use):
        np.add.at(count, ties.tie[ties.image == i], used)
    return count


def connected_images(tie: Any, image: Any, count: int) -> list[list[int]]:
    """Return the groups of images that ties join, directly or by others, as lists of numbers.

    `tie` and `image` (n,) are those of each measurement, of which there is one at least; `count` is
    the number of images. An image without ties is a group by itself.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ties = int(tie.max()) + 1
    # The nodes of the graph are images and ties, and its edges measurements.
    graph = coo_matrix((np.ones(len(tie)), (image, count + tie)), shape=(count + ties,) * 2)
    _, component = connected_components(graph, directed=False)
    component = component[:count]
    return [np.flatnonzero(component == k).tolist() for k in dict.fromkeys(component.tolist())]
