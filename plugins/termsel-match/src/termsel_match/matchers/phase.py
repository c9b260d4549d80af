"""Phase correlation.

References
----------
Kuglin, Hines 1975: The phase correlation image alignment method. Proceedings of the IEEE
Conference on Cybernetics and Society, 163-165.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft2, rfft2
from scipy.signal.windows import hann

from termsel_match.images.rasters import Grey
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.dense import (
    HALF_WINDOW,
    SHIFT_REACH,
    are_surroundings_known,
    common_shift,
    distinct_places,
    find_peak,
)


class Phase(Matcher):
    """Phase correlation: for images of the same contrast with few distinct places, such as fields.

    The shift of the window is found first, then that of 41 x 41 px around distinct places.

    References
    ----------
    Kuglin, Hines 1975, IEEE Conference on Cybernetics and Society, 163-165.
    """

    name = "phase"

    def match(self, first: Window, second: Window, search: float) -> Matches:
        """Return distinct places and where they are in the second (see `Matcher.match`).

        One shift for both windows comes first, then that of each place, as the peak of the phase
        correlation of two tapered patches. The order is by how far the next peak is below the best;
        places whose peak is beyond SHIFT_REACH are left out.
        """
        none = Matches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))
        expected = np.subtract(first.origin, second.origin)
        grey = _centre_grey(first)
        grey_second = _centre_grey(second)
        shift = common_shift(grey[None], grey_second[None], expected, search, whitened=True)
        if shift is None:
            return none
        positions = distinct_places(first)
        positions = positions[are_surroundings_known(positions + shift, second.known, HALF_WINDOW)]
        if not len(positions):
            return none
        steps = np.arange(-HALF_WINDOW, HALF_WINDOW + 1)
        # Tapered to zero at the edges, whose jumps would be structure of their own.
        taper = np.outer(hann(2 * HALF_WINDOW + 1), hann(2 * HALF_WINDOW + 1))
        moved = []
        clear = []
        score = []
        for position in positions.astype(int):
            at = position + shift.astype(int)
            a, b = (taper * (window - window.mean()) for window in (
                grey[np.ix_(position[0] + steps, position[1] + steps)],
                grey_second[np.ix_(at[0] + steps, at[1] + steps)]))
            # Phase correlation: the inverse transform of conj(A) B / |conj(A) B| has its peak at
            # the shift. 1e-9 is far below any frequency that a picture has, and divides by no 0.
            product = np.conj(rfft2(a)) * rfft2(b)
            surface = irfft2(product / np.maximum(np.abs(product), 1e-9), a.shape)
            away, best, next_best = find_peak(np.fft.fftshift(surface))
            moved.append(away)
            clear.append(next_best / best if best > 0 else 1.0)
            score.append(best)
        near = np.abs(moved).max(axis=1) <= SHIFT_REACH
        # The clearest first: the next peak is far below the best.
        order = np.argsort(clear, kind="stable")
        order = order[near[order]]
        return Matches(positions[order], (positions + shift + moved)[order], np.array(score)[order])


def _centre_grey(window: Window) -> Grey:
    """Return grey less its mean over known pixels, and 0 where it is unknown."""
    mean = window.pixels[window.known].mean() if window.known.any() else 0.0
    return np.where(window.known, window.pixels - mean, 0).astype(np.float32)
