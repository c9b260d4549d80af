"""Matchers: two windows as arrays, and the places in them that look alike.

A package adds one by the hook `termsel_matchers`::

    from termsel import hookimpl
    from termsel_match.matchers import Matcher, Matches

    class Mine(Matcher):
        ...

    @hookimpl
    def termsel_matchers():
        return [Mine]
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel import Configurable
from termsel_match.images.rasters import FloatArray, Grey, Mask


@dataclass(frozen=True, eq=False)
class Window:
    """A part of a picture.

    Parameters
    ----------
    pixels : ndarray of float32, shape (lines, samples)
    known : ndarray of bool, same shape
        Where there are data; elsewhere pixels mean nothing.
    origin : tuple of float
        Line and sample of the first pixel in coordinates that both windows of a pair share [px].
    """

    pixels: Grey
    known: Mask
    origin: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Matches:
    """Places of two windows that look alike, the clearest first.

    Parameters
    ----------
    first, second : ndarray, shape (n, 2)
        Line and sample in either window; the centre of its first pixel is (0, 0) [px].
    score : ndarray, shape (n,)
        How alike they are, at most 1.
    sigma : ndarray, shape (n, 2), optional
        Standard deviations of line and sample of their difference [px].
    """

    first: FloatArray
    second: FloatArray
    score: FloatArray
    sigma: FloatArray | None = None

    def take(self, numbers: NDArray[np.intp]) -> Matches:
        """Return the matches of these numbers, in their order."""
        return Matches(self.first[numbers], self.second[numbers], self.score[numbers],
                       None if self.sigma is None else self.sigma[numbers])


def fault_of_matches(matcher: Matcher, value: Any, *_windows: Any) -> str | None:
    """Return what is wrong with the value that a matcher returned; None if nothing is.

    It is a clause that follows "match()" in a sentence, such as "returned int; expected Matches".
    """
    if not isinstance(value, Matches):
        return f"returned {type(value).__name__}; expected Matches"
    # The number of rows, -1 where the array has none: then every shape below is wrong.
    count = np.shape(value.first)[0] if np.ndim(value.first) else -1
    if matcher.places_exactly and value.sigma is None:
        return "returned no standard deviations, and the class says places_exactly"
    for name, shape in (("first", (count, 2)), ("second", (count, 2)), ("score", (count,)),
                        *((("sigma", (count, 2)),) if value.sigma is not None else ())):
        values = np.asarray(getattr(value, name))
        if values.shape != shape or values.dtype.kind not in "fi":
            return (f"returned {name} of shape {values.shape} and type {values.dtype}; expected "
                    f"numbers of shape {'(n, 2)' if count < 0 else shape}")
        if not np.isfinite(values).all():
            return f"returned {name} with values that are not finite"
    if (np.asarray(value.score) > 1 + 1e-6).any():
        return "returned scores above 1"
    if value.sigma is not None and (value.sigma <= 0).any():
        return "returned standard deviations that are not above 0"
    return None


class Matcher(Configurable, ABC):
    """Finds places of two windows that look alike.

    Both windows have the same scale and direction as far as the rough geometry is right, and the
    same place has about the same shared coordinates. Nobody asks that all matches are right.
    """

    kind = "matcher"
    suite: ClassVar[str] = "termsel_match.testing"
    """Module of the conformance suite that `termsel.testing.checks` runs."""

    guards: ClassVar[Mapping[str, Callable[..., str | None] | None]] = {"match": fault_of_matches}

    places_exactly: ClassVar[bool] = False
    """Whether its matches have their standard deviations. Others are placed to sub-pixel
    afterwards, by least squares of grey values, which must then be alike but for contrast and
    brightness."""

    @abstractmethod
    def match(self, first: Window, second: Window, search: float) -> Matches:
        """Return pairs of positions in two windows at which both look alike.

        Parameters
        ----------
        first : Window
            Window of the image that is to be georeferenced.
        second : Window
            Window of the reference, resampled as the image shows it; larger by the search.
        search : float
            Largest distance of two places that match, in shared coordinates [px].

        Returns
        -------
        Matches
            In order, the clearest first; as many as there are.
        """
