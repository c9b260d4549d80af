"""How well matched lines fix an image: in which directions, and whether by one vector alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import termsel
from termsel import FeatureSet, Fit, Lines, Points, TermselError
from termsel_match.images.starts import Start, transform_plane

# Ratio of standard deviations across and along.
_WEAK_RATIO = 3.0
# Px along the lines, beyond which the start holds the image.
_HELD = 2.0
# Vectors that are tried in turn, those with most lines.
_ASKED = 60
# Px by which the image may move without one vector.
UNCERTAIN = 1.0


@dataclass(frozen=True)
class Decisive:
    """The vector without which the image moves most.

    Parameters
    ----------
    vector : str
    moved : float
        Rms by which the lines move in the image [px]; infinite where the others do not determine
        the model.
    """

    vector: str
    moved: float

    def text(self) -> str:
        """Return a sentence on how far the image moves without the one vector that counts most."""
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
    """Return what a model of lines is fitted to, and the model.

    Where the lines alone do not fix the image, as one street does not, or the model cannot be
    fitted to them, the start holds it by four points in the corners of the image.

    Parameters
    ----------
    features : FeatureSet
        Lines, with standard deviations.
    model : str
    options : mapping
        Options of the model.
    start : Start
    search : float
        Largest distance of the truth from the start [px], the standard deviation of the corners.

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
            # For example no drift from lines in one place.
            pass
    with_start = features.with_(points=_corner_points(features, start, search))
    return with_start, termsel.fit(with_start, model, **options)


def _corner_points(features: FeatureSet, start: Start, sigma: float) -> Points:
    """Return control in the corners of the image, where the start sees them, good to sigma [px]."""
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
        The lines that agree, with the attribute `vector`, and points that hold them, if any.
    model : str
    options : mapping
        Options of the model.
    """
    lines = features.lines
    ground = lines.ground.reshape(-1, 3)
    of = lines.attributes["vector"].astype(str)
    positions = termsel.fit(features, model, **options).project(ground)
    names, count = np.unique(of, return_counts=True)
    # Without the only vector nothing is left to fit.
    if len(names) == 1:
        return Decisive(str(names[0]), float("inf"))
    moves = []
    for name in names[np.argsort(-count, kind="stable")[:_ASKED]]:
        other_lines = lines.take(of != name)
        try:
            without = termsel.fit(features.with_(lines=other_lines), model,
                                  **options).project(ground)
        except TermselError:
            return Decisive(str(name), float("inf"))
        moved = float(np.sqrt(((without - positions) ** 2).sum(axis=1).mean()))
        moves.append(Decisive(str(name), moved))
    return max(moves, key=lambda decisive: decisive.moved)


def sentences_on_certainty(lines: Lines) -> str:
    """Return sentences on how well lines fix the image, across them and along [px]."""
    (across_them, along_them), towards = _sigma_across_and_along(lines)
    if along_them < _WEAK_RATIO * across_them:
        return (f"The lines fix the position of the image in all directions: standard deviation "
                f"{along_them:.2f} px.")
    precision = f"only to {along_them:.2f} px"
    if along_them > _HELD:
        precision = ("not at all" if along_them == float("inf")
                     else precision) + ": there the start holds it"
    return (f"The lines run in nearly one direction. Across it they fix the image to "
            f"{across_them:.2f} px, along it {precision}. It is at {towards:.0f} degrees from the "
            "direction of lines towards that of samples.")


def _sigma_across_and_along(lines: Lines) -> tuple[tuple[float, float], float]:
    """Return standard deviations [px] across most lines and along them, and the direction along.

    The direction is from that of lines towards that of samples [deg]; along may be infinite.
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
