"""Images of a batch held against each other: those that lie elsewhere, and those that are mirrored.

Where axes are exchanged, one image hardly shows it; the others of its batch do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.core.errors import count_in_words, first_names_in_words
from termsel.data.coordinates.earth import (
    degrees_of,
    find_swapped_axes,
    is_mirrored,
    position_in_words,
)
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray

MAJORITY_SHARE = 2 / 3
"""Share of the images from which on they are those that the others are held against."""

NEAREST, FARTHEST = 1.0, 20.0
"""Distance of a group's next image [deg] beyond which it is elsewhere, at least and at most."""

SCATTER = 20.0
"""Times the distance between neighbours of a batch that is such a distance."""

DIGITS, PLACES = 2, 3000
"""Decimals of a place [deg] that are looked at, and most places that are held against each other.
"""

ELSEWHERE = "are coordinates and CRS right?"
"""What is asked of images far from the others where nothing more is known."""

Place = tuple[float, float]
"""Longitude and latitude [deg]."""


@dataclass(frozen=True)
class Batch:
    """What the images of a batch say of each other.

    Attributes
    ----------
    sentences : tuple of str
        On the batch, with the names of the images that stand out.
    doubts : mapping
        Sentences on each of these images, by its name.
    """

    sentences: tuple[str, ...]
    doubts: Mapping[str, tuple[str, ...]]


def location_figures(features: FeatureSet) -> dict[str, Any]:
    """Return where an image is, as figures for its entry in the journal.

    `place` is the longitude and latitude [deg] of the median of its features, `exchanged` the same
    if x and y are exchanged, `mirrored` whether the image is a mirror image of the ground; each is
    None where nothing shows. `doubt` is a sentence on axes that look swapped, "" if none do.
    """
    ground = features.ground_vertices()
    # Both orders, so that an exchange of x and y can be told.
    return {"place": degrees_of(features.crs, ground) if len(ground) else None,
            "exchanged": degrees_of(features.crs, ground[:, [1, 0, 2]]) if len(ground) else None,
            "mirrored": is_mirrored(features), "doubt": find_swapped_axes(features)}


def batch_of(settings: Mapping[str, Mapping[str, Any]]) -> Batch:
    """Return the sentences and doubts that images of a batch raise about each other.

    `settings` are the figures of `location_figures` of each image, by its name.
    """
    sentences: list[str] = []
    doubts: dict[str, list[str]] = {}
    for sentence, images in (*_far_image_sentences(settings), *_note_on_mirrored(settings)):
        sentences.append(f"{sentence}: {first_names_in_words(list(images))}.")
        for name, doubt in images.items():
            doubts.setdefault(name, []).append(doubt)
    return Batch(tuple(sentences), {name: tuple(texts) for name, texts in doubts.items()})


def _far_image_sentences(
        settings: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, dict[str, str]]]:
    """Return sentences on images far from most others, each with the doubt about every image.

    A batch is usually of one area, so that an image somewhere else has a wrong CRS, exchanged axes
    or another sign. Images are grouped by their distances; where one group has most of them, each
    other group gets a sentence with the likely reason, and each of its images the doubt. Without a
    clear majority, with fewer than three images whose place is known, and with more than `PLACES`
    places nothing is said.
    """
    placed_images = {name: setting for name, setting in settings.items() if setting.get("place")}
    # Of two images nobody can say which one is elsewhere.
    if len(placed_images) < 3:
        return []
    names = list(placed_images)
    # Images at one place are looked at once: batches may have very many.
    positions, place_of_image, images_at_place = np.unique(
        np.round([placed_images[name]["place"] for name in names], DIGITS), axis=0,
        return_inverse=True, return_counts=True)
    if len(positions) > PLACES:
        return []
    # Great-circle angles, so that poles and the 180 degree meridian need no care.
    distances = _angles_between(positions, positions)
    reach = _reach_of_group(distances)
    groups = _linked_groups(distances <= reach)
    largest_group = max(groups, key=lambda group: images_at_place[group].sum())
    largest_count = int(images_at_place[largest_group].sum())
    # Without a clear majority there is no place that the others should be at.
    if largest_count < 2 or largest_count < MAJORITY_SHARE * len(names):
        return []
    usual_place = position_in_words(_middle_of_places(positions[largest_group]))
    sentences = []
    for group in groups:
        if group is largest_group:
            continue
        members = np.flatnonzero(np.isin(place_of_image.ravel(), group)).tolist()
        # One question where all images of the group have the same likely cause.
        guesses = [_question_on_fault(placed_images[names[i]], positions[largest_group], reach)
                   for i in members]
        question = guesses[0] if len(set(guesses)) == 1 else ELSEWHERE
        doubts = {}
        for i, guess in zip(members, guesses, strict=True):
            own_place = position_in_words(placed_images[names[i]]["place"])
            doubts[names[i]] = (f"Near {own_place}, while {largest_count} other images of the "
                                f"batch are near {usual_place}: {guess}")
        group_place = position_in_words(_middle_of_places(positions[group]))
        sentences.append((f"{largest_count} images are near {usual_place}, {len(members)} near "
                          f"{group_place} ({question})", doubts))
    return sentences


def _question_on_fault(setting: Mapping[str, Any], group: FloatArray, reach: float) -> str:
    """Return a question on the likely fault in the coordinates of an image far from the others.

    `group` (n, 2) has longitude and latitude [deg] of the places of the others, and `reach` [deg]
    is the distance up to which a place belongs to them.
    """
    lon, lat = setting["place"]
    exchanged = setting.get("exchanged")
    if exchanged and _angles_between(np.array([exchanged]), group).min() <= reach:
        return "are x and y swapped?"
    # Where a sign of longitude, latitude or both would put the image.
    turned = np.array([[-lon, lat], [lon, -lat], [-lon, -lat]])
    if (_angles_between(turned, group).min(axis=1) <= reach).any():
        return "is a sign wrong?"
    return ELSEWHERE


def _note_on_mirrored(
    settings: Mapping[str, Mapping[str, Any]],
) -> list[tuple[str, dict[str, str]]]:
    """Return a sentence on the few images that are mirrored where most are not, or the reverse.

    With it comes the doubt about each of these images, by name. Where there is no clear majority,
    the sentence is on those that are mirrored. The list has this one pair, and none where all
    images are alike.
    """
    is_mirrored_image = {name: bool(setting["mirrored"]) for name, setting in settings.items()
                         if setting.get("mirrored") is not None}
    are_most_mirrored = sum(is_mirrored_image.values()) * 2 > len(is_mirrored_image)
    odd = [name for name, mirrored in is_mirrored_image.items() if mirrored != are_most_mirrored]
    usual_count = len(is_mirrored_image) - len(odd)
    if not odd:
        return []
    # Without a clear majority nobody can say which of both is wrong.
    if usual_count < 2 or usual_count < MAJORITY_SHARE * len(is_mirrored_image):
        return [_sentence_on_some_mirrored(is_mirrored_image)]
    if are_most_mirrored:
        verb = "is no mirror image" if len(odd) == 1 else "are no mirror images"
    else:
        verb = "is a mirror image" if len(odd) == 1 else "are mirror images"
    statement = f"{count_in_words(len(odd), 'image')} {verb} of the ground"
    question = "are x and y exchanged there, or line and sample?"
    doubt = (f"{'No m' if are_most_mirrored else 'M'}irror image of the ground, unlike "
             f"{count_in_words(usual_count, 'other')} of the batch: are x and y exchanged, or "
             "line and sample?")
    return [(f"{statement}, unlike the other {usual_count} ({question})",
             dict.fromkeys(odd, doubt))]


def _sentence_on_some_mirrored(is_mirrored_image: Mapping[str, bool]) -> tuple[str, dict[str, str]]:
    """Return the sentence where about as many images are mirrored as are not, with the doubts."""
    mirrored = [name for name, is_one in is_mirrored_image.items() if is_one]
    total = len(is_mirrored_image)
    verb = "is a mirror image" if len(mirrored) == 1 else "are mirror images"
    question = "are x and y exchanged, or line and sample?"
    count_of_others = count_in_words(total - len(mirrored), "other")
    doubt = f"Mirror image of the ground, unlike {count_of_others} of the batch: {question}"
    return (f"{len(mirrored)} of {total} images {verb} of the ground, the others are not "
            f"({question})", dict.fromkeys(mirrored, doubt))


def _angles_between(first_positions: FloatArray, second_positions: FloatArray) -> FloatArray:
    """Return the angles [deg], (n, m), between places (n, 2) and (m, 2), longitude and latitude."""
    first = _unit_directions(first_positions)
    second = _unit_directions(second_positions)
    # angle = 2 arcsin(chord / 2) of unit vectors, exact for small angles.
    chords = np.linalg.norm(first[:, None] - second[None], axis=2)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(chords / 2.0, 1.0))))


def _unit_directions(positions: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3) to places (n, 2) that are longitude and latitude [deg]."""
    lon, lat = np.radians(positions).T
    return np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def _middle_of_places(positions: FloatArray) -> Place:
    """Return the middle of places (n, 2) [deg], where the sum of their unit vectors points."""
    x, y, z = _unit_directions(positions).sum(axis=0)
    # The z component shows the latitude, the horizontal ones the longitude.
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


def _reach_of_group(distances: FloatArray) -> float:
    """Return the distance beyond which a place no longer belongs to its neighbours [deg]."""
    if len(distances) < 2:
        return NEAREST
    # Of each position the distance to its next one, itself left out.
    nearest = np.where(np.eye(len(distances), dtype=bool), np.inf, distances).min(axis=1)
    return float(np.clip(SCATTER * np.median(nearest), NEAREST, FARTHEST))


def _linked_groups(linked: BoolArray) -> list[IntArray]:
    """Return the groups of places that are linked directly or through other places.

    `linked` (n, n) says which are linked directly; a group is an array of indices of places.
    """
    groups = []
    free = np.ones(len(linked), dtype=bool)
    while free.any():
        # A chain of images is one group: neighbours of neighbours join it until there are none.
        joining = np.array([free.argmax()])
        group = np.zeros(len(linked), dtype=bool)
        while len(joining):
            group[joining] = True
            joining = np.flatnonzero(linked[joining].any(axis=0) & ~group)
        groups.append(np.flatnonzero(group))
        free &= ~group
    return groups
