"""Kernels of thin-plate splines, around all points or around knots among many."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray

AT_ONCE = 2000
"""Places whose kernels are held in memory."""

KNOTS = 1000
"""Most points that have a kernel each, and knots of more. As many for some of the points as for
all, lest what some predict look better than what all do."""

JITTER = 1e-10
"""Part of the field's variance that is none: that of close points, or of affine functions."""


class Spans:
    """The columns that span a field: kernels around all points, or around knots among many."""

    def __init__(self, places: FloatArray, whole: bool) -> None:
        many = len(places) > KNOTS and not whole
        self.knots = spread_out(places, KNOTS) if many else places
        self.root = spline_root(self.knots) if many else None
        here = np.column_stack([np.ones(len(self.knots)), self.knots])
        self._affine = None if self.root is None else np.linalg.pinv(here) @ (
            kernel(self.knots, self.knots) @ self.root)

    def __call__(self, places: FloatArray) -> FloatArray:
        """Return the columns at places, shape (m, k)."""
        if self.root is None:
            return kernel(places, self.knots)
        there = np.column_stack([np.ones(len(places)), places])
        return np.asarray(kernel(places, self.knots) @ self.root - there @ self._affine)

    def coefficients(self, places: FloatArray, w: FloatArray) -> FloatArray:
        """Return the coefficients of the columns by the kernels' weights (n, 2) at the points."""
        return w if self.root is None else np.asarray(sum(
            self(places[some]).T @ w[some] for some in parts(len(places))))

    def variance(self, there: FloatArray, columns: FloatArray, lead: FloatArray,
                 places: FloatArray, smoothing: float, w: FloatArray) -> FloatArray:
        """Return the variance at places (m, 2) by that of the field, shape (m,).

        The affine columns there are (m, 3), those of the points (n, 3); `w` are their weights.
        """
        (n, f) = lead.shape
        apart = self(there)
        if self.root is None:
            # Universal kriging: the kernel at distance 0, which is 0, less right' system^-1 right.
            system = np.zeros((n + f, n + f))
            system[:n, :n] = kernel(places, places) + np.diag(smoothing / w**2)
            system[:n, n:] = lead
            system[n:, :n] = lead.T
            right = np.concatenate([apart, columns], axis=1)
            return np.asarray(-(right * np.linalg.solve(system, right.T).T).sum(axis=1))
        rows = np.concatenate([columns, apart], axis=1)
        normal = np.diag(np.r_[np.zeros(f), np.full(apart.shape[1], smoothing)])
        for some in parts(n):
            one = np.concatenate([lead[some], self(places[some])], axis=1) * w[some, None]
            normal += one.T @ one
        beyond = own_variance(there, self.knots) - (apart**2).sum(axis=1)
        return np.asarray(smoothing * (rows * np.linalg.solve(normal, rows.T).T).sum(axis=1)
                          + np.maximum(beyond, 0.0))


def parts(n: int) -> list[slice]:
    """Return all of n places, so many at once."""
    return [slice(start, start + AT_ONCE) for start in range(0, n, AT_ONCE)]


def kernel(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return r^2 log r of the distances r between places, shape (len(a), len(b))."""
    square = squared_distances(a, b)
    return np.asarray(square * np.log(np.where(square > 0.0, square, 1.0)) / 2)


def squared_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the squared distances between places in the plane, shape (len(a), len(b))."""
    # That of scipy.spatial would be the only part of it that most runs import.
    square, across = (np.subtract.outer(a[:, i], b[:, i]) for i in range(2))
    square *= square
    square += np.square(across, out=across)
    return square


def left_by_affine(places: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the kernels around knots, less what an affine function fits at these, (m, k)."""
    there, here = (np.column_stack([np.ones(len(one)), one]) for one in (places, knots))
    return np.asarray(kernel(places, knots) - there @ (np.linalg.pinv(here) @ kernel(knots, knots)))


def own_variance(places: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the variance at places of what the affine function that fits the knots leaves."""
    there, here = (np.column_stack([np.ones(len(one)), one]) for one in (places, knots))
    fitted = there @ np.linalg.pinv(here)
    return np.asarray((fitted * (fitted @ kernel(knots, knots)
                                 - 2 * kernel(places, knots))).sum(axis=1))


def spline_root(knots: FloatArray) -> FloatArray:
    """Return what makes coefficients of the kernels uncorrelated, of one variance, shape (k, c)."""
    here = np.column_stack([np.ones(len(knots)), knots])
    rest = np.eye(len(knots)) - here @ np.linalg.pinv(here)
    among = kernel(knots, knots)
    values, vectors = np.linalg.eigh(rest @ among @ rest)
    # What affine functions fit has no variance but rounding.
    some = values > JITTER * max(values.max(), np.abs(among).max())
    return np.asarray(rest @ (vectors[:, some] / np.sqrt(values[some])))


def spread_out(places: FloatArray, count: int) -> FloatArray:
    """Return the places, of more than a count that are far apart, whatever their order."""
    if len(places) <= count:
        return places
    # From the place nearest to the middle, always the place farthest from those taken.
    taken = [int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    columns = np.ascontiguousarray(places.T)
    apart = np.full(len(places), np.inf)
    while len(taken) < count:
        line, sample = columns - columns[:, taken[-1:]]
        apart = np.minimum(apart, line * line + sample * sample)
        taken.append(int(apart.argmax()))
    return places[taken]
