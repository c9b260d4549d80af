"""What a block says against what it was given: sensors of images, and heights without control."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from termsel.toolkit import sentence_on_common_offset
from termsel.toolkit.files import dem_difference
from termsel_block.block import Block, BlockImage
from termsel_block.estimation.unknowns import Adjusted
from termsel_block.geometry.frame import FloatArray, Frame
from termsel_block.geometry.heights import DEM_OFFSET_SIGMA, Surface
from termsel_block.geometry.physical import Contradiction, PhysicalCamera

MIN_CHANCE = 1e-4
"""Probability below which what is known of a model's terms is not true of the image."""

_FAR_SIGMAS, _UNSEEN_SIGMA = 3.0, 1e3
"""Standard deviations from which on the ground is not that of the DEM, and that of a tie whose
height no rays show [m]."""

_ROUGHNESS_RATIO = 1.1
"""Ratio of the ground's roughness with a sensor to that with an unknown one, from which on the
sensor is wrong. With right ones it is 1.01 at most with six points in each of two images. With
three it is more in two of eleven blocks, which are 84 and 43 px off with the right sensor, and 14
and 7 px without.
"""

_MUCH_MORE_PROBABLE = float(np.log(1e4))
"""Logarithm of the factor from which on control is far more probable by one sensor than another."""

_SENSOR = "sensor"
"""Option that names what is known; without it the model knows least."""


def without_wrong_sensor(block: Block, adjusted: Adjusted,
                         right: Collection[str]) -> tuple[Block, int] | None:
    """Return the block without the sensor that its measurements contradict most.

    The second value is the number of the image that contradicts it most. The sensor is taken from
    all images that state it, and a note is added to the block. Sensors in `right` stay. None if no
    other is contradicted.
    """
    # A sensor is one claim: where it is wrong in some images, ties bend the others, too.
    contradictions = contradictions_of(adjusted)
    sensors = {i: sensor_of(block, i) for i in contradictions}
    suspects = {i: contradiction for i, contradiction in contradictions.items() if sensors[i]
                and sensors[i] not in right}
    worst = max(suspects, key=lambda i: suspects[i].severity, default=None)
    if worst is None:
        return None
    sensor = sensors[worst]
    name = _sensor_in_words(block, sensors[worst])
    named_images = [f"{block.images[i].name}{_terms_in_words(contradiction)}"
                    for i, contradiction in suspects.items() if sensors[i] == sensor]
    n_images = sum(sensor_of(block, i) == sensor for i in range(len(block.images)))
    note = (f"Points and ties of {', '.join(named_images)} contradict the sensor {name!r}. "
            + ("The image is adjusted as one of an unknown sensor." if n_images == 1 else
               f"The {n_images} images that state it are adjusted as those of an unknown sensor."))
    without = without_sensor(block, sensor)
    return replace(without, notes=(*without.notes, note)), worst


def stated_sensors(block: Block) -> list[str]:
    """Return the sensors that images state, each once, in the order of the images; [] if none does.
    """
    return list(dict.fromkeys(filter(None, (sensor_of(block, i) for i in range(
        len(block.images))))))


def without_sensor(block: Block, sensor: str) -> Block:
    """Return the block with images of this sensor as images of an unknown one; others stay."""
    return replace(block, images=tuple(
        _image_without_sensor(image) if sensor_of(block, i) == sensor else image
        for i, image in enumerate(block.images)))


def note_without(block: Block, sensor: str, before: Adjusted, after: Adjusted) -> str:
    """Return a note that a sensor makes the ground rough or contradicts control; "" if it does not.

    It is "" if one of the adjustments did not converge. A rough ground does not count if control is
    far more probable with the sensor.

    Parameters
    ----------
    block : Block
        With the sensor.
    before, after : Adjusted
        The block with the sensor, and with an unknown one.
    """
    if not before.converged or not after.converged:
        return ""
    # Only images that state this sensor are named.
    images = [image.name for i, image in enumerate(block.images) if sensor_of(block, i) == sensor]
    named = f"With the sensor {_sensor_in_words(block, sensor)!r} of {', '.join(images)}"
    if (before.roughness >= _ROUGHNESS_RATIO * after.roughness
            and gain_of_control(before, after) > -_MUCH_MORE_PROBABLE):
        return (f"{named} the ground is {before.roughness:.0f} m rough, with an unknown one "
                f"{after.roughness:.0f} m. The unknown one is taken.")
    if gain_of_control(before, after) > _MUCH_MORE_PROBABLE:
        return (f"{named} the block predicts its own control points far worse than with an "
                "unknown one. The unknown one is taken.")
    return ""


def gain_of_control(before: Adjusted, after: Adjusted) -> float:
    """Return the logarithm of the ratio of the control's density after to that before.

    Each feature is predicted by all others; those that are not predicted in both are left out.
    """
    return sum(after.score[feature] - before.score[feature]
               for feature in before.score if feature in after.score)


def _image_without_sensor(image: BlockImage) -> BlockImage:
    """Return an image without what is known of its sensor."""
    return replace(image, options={
        name: value for name, value in image.options.items() if name != _SENSOR})


def sensor_of(block: Block, i: int) -> str:
    """Return the sensor of an image: its file, or its name in small letters; "" without one."""
    stated = _stated_sensor(block.images[i])
    return stated if Path(stated).is_file() else stated.casefold()


def _stated_sensor(image: BlockImage) -> str:
    """Return the sensor of an image as its options name it; "" without one."""
    return str(image.options.get(_SENSOR) or "")


def _sensor_in_words(block: Block, sensor: str) -> str:
    """Return a sensor as the first image that has it names it; of a file without its folders."""
    return next(Path(_stated_sensor(image)).name for i, image in enumerate(block.images)
                if sensor_of(block, i) == sensor)


def agrees_better(before: Adjusted, after: Adjusted, i: int) -> bool:
    """Return whether the block agrees better with the i-th image after a sensor was left out.

    It does if the image contradicts its model half as much or less, or its model states nothing
    that could be contradicted, or if control is predicted far better. If it does not, the sensor
    is right, and turns faster than the model takes scanners to.
    """
    contradiction_before = _contradiction_of(before, i)
    contradiction_after = _contradiction_of(after, i)
    # By chance alone the severity changes by a few per cent.
    return (gain_of_control(before, after) > _MUCH_MORE_PROBABLE or contradiction_before is None
            or contradiction_after is None
            or contradiction_after.severity < contradiction_before.severity / 2)


def contradictions_of(adjusted: Adjusted) -> dict[int, Contradiction]:
    """Return the contradictions of images to their models, by number of the image.

    They are those that would be chance with a probability below `MIN_CHANCE`.
    """
    contradictions = ((i, _contradiction_of(adjusted, i))
                      for i in range(len(adjusted.state.cameras)))
    return {i: contradiction for i, contradiction in contradictions if contradiction is not None
            and contradiction.chance < MIN_CHANCE}


def _contradiction_of(adjusted: Adjusted, i: int) -> Contradiction | None:
    """Return how far an image's terms are from their priors; None if its model states none."""
    camera = adjusted.state.cameras[i]
    # The priors of corrections of RPCs and polynomials are first guesses, which state nothing.
    if not isinstance(camera, PhysicalCamera):
        return None
    # By the priors as stated, before `loosen` lets them scatter as they do.
    return camera.contradicted(*adjusted.by_priors[i])


def doubts_of_models(block: Block, adjusted: Adjusted) -> list[str]:
    """Return a sentence for each image whose model is contradicted and yet in use; [] if none is.
    """
    return [f"Points and ties of {block.images[i].name} contradict what the model "
            f"{block.images[i].model!r} knows of cameras{_terms_in_words(contradiction)}. Its "
            "errors may be larger than is predicted: compare with auto."
            for i, contradiction in contradictions_of(adjusted).items()]


IN_FEET = "are the heights of the DEM in feet? gdal_edit.py -units ft states that of its band."
"""Advice on a DEM that agrees with the ground if its heights are in feet."""


def compare_ground_with_dem(
        ground: FloatArray, frame: Frame, adjusted: Adjusted, dem: Surface) -> tuple[float, str]:
    """Return the median height of ties above a DEM [m], and a note on it.

    The note has "{}" where the caller says what is done about it, before an advice. It is "" if the
    difference may be chance. Without a tie on the DEM the difference is 0.

    Parameters
    ----------
    ground : ndarray, shape (t, 3)
        Positions of the ties in the CRS of the block.
    frame : Frame
        The local frame of the block.
    adjusted : Adjusted
        The block as adjusted without the DEM.
    dem : Surface
        Heights of the DEM at positions in the CRS of the block.
    """
    above_dem = frame.heights(ground) - dem(ground[:, :2])
    variance = adjusted.solved.covariance_of_ties()[:, 2, 2]
    # Ties off the raster have no height of the DEM, those of parallel rays none of their own.
    is_known = np.isfinite(above_dem) & (variance < _UNSEEN_SIGMA**2)
    if not is_known.any():
        return 0.0, ""
    # Errors of the ties' heights are common to a block, so that those of the median do not average
    # out.
    median = float(np.median(above_dem[is_known]))
    sigma = float(np.sqrt(np.median(variance[is_known])))
    # The variance of the difference is that of the ties and of a DEM that is off as usual.
    if abs(median) < _FAR_SIGMAS * np.hypot(sigma, DEM_OFFSET_SIGMA):
        return median, ""
    direction = "above" if median > 0 else "below"
    heights = frame.heights(ground)
    difference = dem_difference(heights[is_known], (heights - above_dem)[is_known])
    in_feet = difference is not None and difference.in_feet
    advice = IN_FEET if in_feet else "check what its heights refer to, or give control."
    note = (f"Without the DEM the ground is {abs(median):.0f} m {direction} it by the RPCs, with a "
            f"standard deviation of {sigma:.0f} m, and {{}}: {advice}")
    return median, note


def note_on_independent_heights(block: Block, frame: Frame, dem: Surface) -> str:
    """Return a note on the difference of a DEM to the heights of independent points.

    "" if it may be chance, or there are no such heights. Heights from the DEM itself do not count.
    """
    grounds = [np.empty((0, 3))]
    for image in block.images:
        if image.features is not None:
            points = image.features.points
            grounds.append(points.ground[[role == "independent" and name not in image.of_dem
                                          for name, role in zip(points.ids, points.roles,
                                                                strict=True)]])
    # Several images may see a point, which counts once.
    ground = np.unique(np.concatenate(grounds), axis=0)
    difference = dem_difference(frame.heights(ground), dem(ground[:, :2]))
    if difference is None or not difference.contradicts:
        return ""
    return sentence_on_common_offset(
        difference.above, "the independent check points", difference.evidence,
        cause=IN_FEET if difference.in_feet else "")


def _terms_in_words(contradiction: Contradiction) -> str:
    """Return the terms that contradict, such as " (roll 4.1 standard deviations)"; "" for none."""
    if not contradiction.terms:
        return ""
    return f" ({', '.join(contradiction.terms)} standard deviations)"
