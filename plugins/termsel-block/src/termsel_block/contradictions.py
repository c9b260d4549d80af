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
from termsel_block.geometry.heights import OFF, Surface
from termsel_block.geometry.physical import Contradiction, PhysicalCamera

CONTRADICTED_BELOW = 1e-4
"""Probability below which what is known of a model's terms is not true of the image."""

_FAR_SIGMAS, _UNSEEN_SIGMA = 3.0, 1e3
"""Standard deviations from which on the ground is not that of the DEM, and that of a tie whose
height no rays show [m]."""

_OVER_FREE = 1.1
"""Times that the ground is rougher than by an unknown sensor, from which on its sensor is wrong.

By right ones it is 1.01 at most with six points in each of two images. With three it is more
in two of eleven blocks, which are 84 and 43 px off with the right sensor, and 14 and 7 px without.
"""

_FAR_BETTER = float(np.log(1e4))
"""Logarithm of the factor from which on control is far more probable by one sensor than another."""

_SENSOR = "sensor"
"""Option that names what is known; without it the model knows least."""


def without_wrong_sensor(block: Block, adjusted: Adjusted,
                         right: Collection[str]) -> tuple[Block, int] | None:
    """Return the block without the sensor that its measurements contradict most; None if none.

    One sensor at a time, in all images that state it: it is one claim, and where it is wrong in
    some the ties bend others, too. With it the number of the image that contradicts most. Sensors
    that are right stay.
    """
    contradictions = contradictions_of(adjusted)
    sensors = {i: sensor_of(block, i) for i in contradictions}
    suspects = {i: contradiction for i, contradiction in contradictions.items() if sensors[i]
                and sensors[i] not in right}
    # The worst image decides which sensor goes; all images that state it go with it.
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
    """Return that a sensor bends the ground or contradicts control; empty where it does not.

    What did not converge says nothing. Nor does the ground where control is far more probable with
    the sensor.

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
    if (before.roughness >= _OVER_FREE * after.roughness
            # A rough ground weighs nothing against control that is far more probable with the
            # sensor.
            and gain_of_control(before, after) > -_FAR_BETTER):
        return (f"{named} the ground is {before.roughness:.0f} m rough, with an unknown one "
                f"{after.roughness:.0f} m. The unknown one is taken.")
    if gain_of_control(before, after) > _FAR_BETTER:
        return (f"{named} the block predicts its own control points far worse than with an "
                "unknown one. The unknown one is taken.")
    return ""


def gain_of_control(before: Adjusted, after: Adjusted) -> float:
    """Return the logarithm of how much more probable control is by all the others than before.

    Of the features that the others predict in both.
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
    """Return whether an image contradicts its model far less, or control is predicted far better.

    If it does not, its sensor is right, and it turns faster than the model takes scanners to.
    """
    contradiction_before = _contradiction_of(before, i)
    contradiction_after = _contradiction_of(after, i)
    # Half the mean square is far less: by chance alone it changes by a few per cent.
    return (gain_of_control(before, after) > _FAR_BETTER or contradiction_before is None
            or contradiction_after is None
            or contradiction_after.severity < contradiction_before.severity / 2)


def contradictions_of(adjusted: Adjusted) -> dict[int, Contradiction]:
    """Return how far each image contradicts its model, by number; only those beyond chance.

    Beyond chance: by less than the probability `CONTRADICTED_BELOW`. Empty if no image does.
    """
    contradictions = ((i, _contradiction_of(adjusted, i))
                      for i in range(len(adjusted.state.cameras)))
    return {i: contradiction for i, contradiction in contradictions if contradiction is not None
            and contradiction.chance < CONTRADICTED_BELOW}


def _contradiction_of(adjusted: Adjusted, i: int) -> Contradiction | None:
    """Return how far an image's terms are from their priors; None if its model states none."""
    camera = adjusted.state.cameras[i]
    # Corrections of RPCs and polynomials have first guesses for priors, which nothing contradicts.
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
    """Return by how much the ground as adjusted without a DEM is off it [m], and that in words.

    What is said ends with its advice, before which "{}" stands for what is done about it. It is
    empty where the difference may be chance.

    Parameters
    ----------
    ground : ndarray, shape (t, 3)
        Places of the ties in the CRS of the block.
    frame : Frame
    adjusted : Adjusted
        The block without the DEM.
    """
    # How much higher the ties are than the DEM at the same place.
    over = frame.heights(ground) - dem(ground[:, :2])
    variance = adjusted.solved.covariance_of_ties()[:, 2, 2]
    # Ties off the raster have no height, and those of parallel rays none that says anything.
    is_known = np.isfinite(over) & (variance < _UNSEEN_SIGMA**2)
    if not is_known.any():
        return 0.0, ""
    # What the ties of a block are off by they have in common.
    middle = float(np.median(over[is_known]))
    sigma = float(np.sqrt(np.median(variance[is_known])))
    # The DEM may be off by OFF as a matter of course, and the ties by sigma: sqrt(sigma^2 + OFF^2).
    if abs(middle) < _FAR_SIGMAS * np.hypot(sigma, OFF):
        return middle, ""
    direction = "above" if middle > 0 else "below"
    heights = frame.heights(ground)
    difference = dem_difference(heights[is_known], (heights - over)[is_known])
    in_feet = difference is not None and difference.in_feet
    advice = IN_FEET if in_feet else "check what its heights refer to, or give control."
    note = (f"Without the DEM the ground is {abs(middle):.0f} m {direction} it by the RPCs, with a "
            f"standard deviation of {sigma:.0f} m, and {{}}: {advice}")
    return middle, note


def note_on_independent_heights(block: Block, frame: Frame, dem: Surface) -> str:
    """Return how far a DEM is off the heights that independent points state.

    Empty where that may be chance. Nothing else shows it where control has its heights from the
    DEM, too.
    """
    grounds = [np.empty((0, 3))]
    for image in block.images:
        if image.features is not None:
            points = image.features.points
            grounds.append(points.ground[[role == "independent" and name not in image.of_dem
                                          for name, role in zip(points.ids, points.roles,
                                                                strict=True)]])
    # Images see the same points.
    ground = np.unique(np.concatenate(grounds), axis=0)
    difference = dem_difference(frame.heights(ground), dem(ground[:, :2]))
    if difference is None or not difference.contradicts:
        return ""
    return sentence_on_common_offset(
        difference.above, "the independent check points", difference.evidence,
        cause=IN_FEET if difference.in_feet else "")


def _terms_in_words(contradiction: Contradiction) -> str:
    """Return which terms are off by how much, such as " (roll 4.1 standard deviations)".

    "" for none.
    """
    if not contradiction.terms:
        return ""
    return f" ({', '.join(contradiction.terms)} standard deviations)"
