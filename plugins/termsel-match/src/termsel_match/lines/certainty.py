"""How well matched lines fix an image: in which directions, and whether by one vector alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import termsel
from termsel import FeatureSet, Fit, Lines, Points, TermselError
from termsel_match.images.rasters import FloatArray
from termsel_match.images.starts import Start, turned

_WEAK = 3.0  # ratio of standard deviations across and along
_HELD = 2.0  # px along the lines, beyond which the start holds the image
_ASKED = 60  # vectors that are tried in turn, those with most lines
_STRETCHES, _FEWEST = 8, 4  # of vectors, that are left out together
_PAIRS = 3  # of halves of them
UNCERTAIN = 1.0  # px by which the image may move without one vector


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
        """Return what a user must know of it."""
        if self.moved <= UNCERTAIN:
            return (f"Without any one vector the image moves by at most {self.moved:.2f} px "
                    f"(vector {self.vector}).")
        far = f"the image moves by {self.moved:.2f} px" if np.isfinite(self.moved) else \
            "the lines do not determine the model"
        return (f"Uncertain: without vector {self.vector} {far}. Check that vector, or give more "
                "vectors.")


def fitted_to(features: FeatureSet, model: str, options: Mapping[str, Any], start: Start,
              search: float) -> tuple[FeatureSet, Fit]:
    """Return what a model of lines is fitted to, and the model.

    Where the lines alone do not fix the image, as one street does not, the start does: with four
    places in the corners of the image whose standard deviation is the search.

    Parameters
    ----------
    features : FeatureSet
        Lines, with standard deviations.
    model : str
    options : mapping
        Options of the model.
    start : Start
    search : float
        Largest distance of the truth from the start [px].
    """
    if _across_and_along(features.lines)[0][1] <= _HELD:
        try:
            return features, termsel.fit(features, model, **options)
        except TermselError:  # for example no drift from lines in one place
            pass
    size = np.array(features.image_size) - 1
    image = size * np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    height = float(np.nanmean(features.lines.ground[..., 2]))
    known = start.locate(image, height)
    ground = np.column_stack([turned(known[:, :2], start.crs, features.crs), np.full(4, height)])
    points = Points(tuple(f"start-{i}" for i in range(1, 5)), image, ground,
                    np.full((4, 2), search), ("control",) * 4)
    held = features.with_(points=points)
    return held, termsel.fit(held, model, **options)


def most_decisive(features: FeatureSet, model: str, options: Mapping[str, Any]) -> Decisive:
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
    ground, of = lines.ground.reshape(-1, 3), lines.attributes["vector"].astype(str)
    seen = termsel.fit(features, model, **options).project(ground)
    names, count = np.unique(of, return_counts=True)
    if len(names) == 1:
        return Decisive(str(names[0]), float("inf"))
    moves = []
    for name in names[np.argsort(-count, kind="stable")[:_ASKED]]:
        rest = lines.take(of != name)
        try:
            without = termsel.fit(features.with_(lines=rest), model, **options).project(ground)
        except TermselError:
            return Decisive(str(name), float("inf"))
        moved = float(np.sqrt(((without - seen) ** 2).sum(axis=1).mean()))
        moves.append(Decisive(str(name), moved))
    return max(moves, key=lambda decisive: decisive.moved)


def left_by_tracing(lines: Lines, seen: FloatArray, selected: Callable[[Lines], Fit], seed: int,
                    ) -> float:
    """Return the standard deviation that errors of the vectors leave in the image [px].

    Errors of tracing are common to a whole stretch of a vector, so that its pieces do not average
    them out; and lines are selected that agree, which hides how far the others are off. So half
    of the stretches is left out, and selection and fit are repeated with the candidates of the
    others. The squares by which the image moves then are as large as the variance (delete-half
    jackknife); the median of the halves is taken.

    Parameters
    ----------
    lines : Lines
        All candidates, with the attribute `vector`.
    seen : ndarray, shape (m, 2)
        Where the model sees the vertices of all candidates [px].
    selected : callable
        Returns the model that some candidates call for.
    seed : int
        Draws the halves.

    Returns
    -------
    float
        NaN if there are fewer than four stretches, or fewer than half of the halves determine the
        model.

    References
    ----------
    Shao, Wu 1989: A general theory for jackknife variance estimation. Annals of Statistics 17,
    1176-1197.
    """
    stretch = _stretches(lines)
    count = int(stretch.max()) + 1
    if count < _FEWEST:
        return float("nan")
    ground, rng = lines.ground.reshape(-1, 3), np.random.default_rng([seed, 6])
    moves = []
    for _ in range(_PAIRS):
        half = np.isin(stretch, rng.permutation(count)[:count // 2])
        for mine in (half, ~half):  # each stretch is in as many
            with suppress(TermselError):
                moves.append(((selected(lines.take(mine)).project(ground) - seen) ** 2).sum(axis=1))
    # Some halves hardly determine the model, which says nothing of the whole.
    each = np.array(moves).mean(axis=1) if len(moves) >= _PAIRS else np.array([np.nan])
    return float(np.sqrt(np.median(each)))


def _stretches(lines: Lines) -> NDArray[np.intp]:
    """Return which stretch each piece is of: vectors, or parts of them where they are few."""
    of = lines.attributes["vector"].astype(str)
    names, vector = np.unique(of, return_inverse=True)
    parts = max(1, -(-_STRETCHES // len(names)))
    if parts == 1:
        # Many vectors: each counts, in groups that are about as many as are tried.
        return np.asarray(np.unique(vector.ravel() % _ASKED, return_inverse=True)[1].ravel())
    stretch = np.empty(len(of), dtype=np.intp)
    for number in range(len(names)):
        own = np.flatnonzero(vector.ravel() == number)
        stretch[own] = number * parts + np.arange(len(own)) * parts // len(own)
    return np.asarray(np.unique(stretch, return_inverse=True)[1].ravel())


def undetermined(lines: Lines) -> str:
    """Return in words how well lines fix the image, across them and along."""
    (across, along), towards = _across_and_along(lines)
    if along < _WEAK * across:
        return (f"The lines fix the position of the image in all directions: standard deviation "
                f"{along:.2f} px.")
    known = f"only to {along:.2f} px"
    if along > _HELD:
        known = ("not at all" if along == float("inf") else known) + ": there the start holds it"
    return (f"The lines run in nearly one direction. Across it they fix the image to "
            f"{across:.2f} px, along it {known}. It is at {towards:.0f} degrees from the "
            "direction of lines towards that of samples.")


def _across_and_along(lines: Lines) -> tuple[tuple[float, float], float]:
    """Return standard deviations across most lines and along [px], and where along is [deg]."""
    assert lines.sigma is not None
    run = lines.image[:, 1] - lines.image[:, 0]
    normal = np.stack([-run[:, 1], run[:, 0]], axis=1) / np.linalg.norm(run, axis=1)[:, None]
    information = (normal[:, :, None] * normal[:, None] / lines.sigma[:, None, None] ** 2).sum(
        axis=0)
    (weak, strong), axes = np.linalg.eigh(information)
    along = float(1 / np.sqrt(weak)) if weak > 1e-9 * strong else float("inf")
    towards = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))) % 180
    return (float(1 / np.sqrt(strong)), along), towards
