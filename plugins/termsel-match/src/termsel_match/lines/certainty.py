"""How well matched lines fix an image: in which directions, and whether by one vector alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import termsel
from termsel import FeatureSet, Fit, Lines, Points, TermselError
from termsel_match.images.starts import Start, transform_plane

_WEAK_RATIO = 3.0
"""Standard deviation along the lines, divided by that across, from which on they run in nearly one
direction."""

_HELD = 2.0
"""Standard deviation along the lines above which the start holds the image [px]."""

_ASKED = 60
"""Most vectors that are left out in turn, those with most lines first."""

UNCERTAIN = 1.0
"""Movement of the image without one vector above which the user is asked to check it [px]."""


@dataclass(frozen=True)
class Decisive:
    """The vector without which the image moves most.

    Parameters
    ----------
    vector : str
        Name of the vector.
    moved : float
        RMS movement of the lines in the image without it [px]; infinite if the other vectors do not
        determine the model.
    """

    vector: str
    moved: float

    def text(self) -> str:
        """Return a sentence on how far the image moves without the vector that counts most."""
        if self.moved <= UNCERTAIN:
            return (f"Without any one vector the image moves by at most {self.moved:.2f} px "
                    f"(vector {self.vector}).")
        if np.isfinite(self.moved):
            far = f"the image moves by {self.moved:.2f} px"
        else:
            far = "the lines do not determine the model"
        return (f"Uncertain: without vector {self.vector} {far}. Check that vector, or give more "
                "vectors.")


def fit_lines_or_hold_by_start(features: FeatureSet, model: str, options: Mapping[str, Any],
                               start: Start, search: float) -> tuple[FeatureSet, Fit]:
    """Return the features that a model of lines is fitted to, and its fit.

    If the lines alone do not fix the image, as one street does not, or do not determine the model,
    the start holds the image by four control points in its corners.

    Parameters
    ----------
    features : FeatureSet
        Lines, with standard deviations.
    model : str
        Name of the model.
    options : mapping
        Options of the model.
    start : Start
        Rough geometry of the image.
    search : float
        Largest distance of the truth from the start [px]. It is the standard deviation of the
        corners.

    Raises
    ------
    TermselError
        If the model cannot be fitted to lines and corners either.
    """
    (_across_them, along_them), _ = _sigma_across_and_along(features.lines)
    if along_them <= _HELD:
        try:
            return features, termsel.fit(features, model, **options)
        except TermselError:
            # Lines in one part of the image, for example, do not determine a drift.
            pass
    with_start = features.with_(points=_corner_points(features, start, search))
    return with_start, termsel.fit(with_start, model, **options)


def _corner_points(features: FeatureSet, start: Start, sigma: float) -> Points:
    """Return control points in the corners of the image, at the ground positions by the start.

    Their standard deviation in line and sample is `sigma` [px].
    """
    size = np.array(features.image_size) - 1
    image = size * np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    height = float(np.nanmean(features.lines.ground[..., 2]))
    ground_of_start = start.locate(image, height)
    ground = np.column_stack([transform_plane(ground_of_start[:, :2], start.crs, features.crs),
                              np.full(4, height)])
    return Points(tuple(f"start-{i}" for i in range(1, 5)), image, ground,
                  np.full((4, 2), sigma), ("control",) * 4)


def most_decisive_vector(features: FeatureSet, model: str, options: Mapping[str, Any]) -> Decisive:
    """Return the vector without which the image moves most.

    Parameters
    ----------
    features : FeatureSet
        The lines that agree, with the attribute `vector`, and the points that hold the image, if
        any.
    model : str
        Name of the model.
    options : mapping
        Options of the model.
    """
    lines = features.lines
    ground = lines.ground.reshape(-1, 3)
    vector_of = lines.attributes["vector"].astype(str)
    positions = termsel.fit(features, model, **options).project(ground)
    names, count = np.unique(vector_of, return_counts=True)
    # Without the only vector no line is left.
    if len(names) == 1:
        return Decisive(str(names[0]), float("inf"))
    moves = []
    for name in names[np.argsort(-count, kind="stable")[:_ASKED]]:
        other_lines = lines.take(vector_of != name)
        try:
            without = termsel.fit(features.with_(lines=other_lines), model,
                                  **options).project(ground)
        except TermselError:
            return Decisive(str(name), float("inf"))
        moved = float(np.sqrt(((without - positions) ** 2).sum(axis=1).mean()))
        moves.append(Decisive(str(name), moved))
    return max(moves, key=lambda decisive: decisive.moved)


def sentences_on_certainty(lines: Lines) -> str:
    """Return sentences on how well lines determine the position of the image.

    `lines` have standard deviations [px]. Lines that run in one direction leave a shift of the
    image along them open, and the sentences say in which direction that is.
    """
    (across_them, along_them), towards = _sigma_across_and_along(lines)
    if along_them < _WEAK_RATIO * across_them:
        return (f"The lines fix the position of the image in all directions: standard deviation "
                f"{along_them:.2f} px.")
    precision = f"only to {along_them:.2f} px"
    # So little is known from the lines that the start decides.
    if along_them > _HELD:
        precision = ("not at all" if along_them == float("inf")
                     else precision) + ": there the start holds it"
    return (f"The lines run in nearly one direction. Across it they fix the image to "
            f"{across_them:.2f} px, along it {precision}. It is at {towards:.0f} degrees from the "
            "direction of lines towards that of samples.")


def _sigma_across_and_along(lines: Lines) -> tuple[tuple[float, float], float]:
    """Return how well lines determine a shift of the image across most of them and along them.

    Returns
    -------
    deviations : tuple of float
        Standard deviations of the shift across most lines and along them [px]; the latter is
        infinite if all lines are parallel.
    towards : float
        Direction along them: the angle from the axis of lines towards that of samples, 0 to 180
        degrees.
    """
    assert lines.sigma is not None
    run = lines.image[:, 1] - lines.image[:, 0]
    # A line says where the image is across it: information sum(n n^T / sigma^2) of all normals n.
    normal = np.stack([-run[:, 1], run[:, 0]], axis=1) / np.linalg.norm(run, axis=1)[:, None]
    information = (normal[:, :, None] * normal[:, None] / lines.sigma[:, None, None] ** 2).sum(
        axis=0)
    (weak, strong), axes = np.linalg.eigh(information)
    # The weak direction is along most lines.
    along_them = float(1 / np.sqrt(weak)) if weak > 1e-9 * strong else float("inf")
    towards = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))) % 180
    return (float(1 / np.sqrt(strong)), along_them), towards
