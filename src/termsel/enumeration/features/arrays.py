"""Arrays for the walk over all selections of features."""

from __future__ import annotations

from typing import Any, NamedTuple

from termsel.measurements.features import FloatArray, IntArray


class Rows(NamedTuple):
    """The rows of n features in each of several independent parts.

    Parameters
    ----------
    design : ndarray, shape (parts, rows, k)
    target : ndarray, shape (parts, rows)
    start : ndarray of int, shape (parts, n + 1)
        Where the rows of each feature begin.
    columns, needed : ndarray of int, shape (parts,)
        Unknowns of each part, and the fewest equations of a selection.
    single : ndarray of bool, shape (parts,)
        Whether each feature has one row.
    bits : ndarray of uint64, shape (n, words)
        Mask of each feature.
    """

    design: FloatArray
    target: FloatArray
    start: IntArray
    columns: IntArray
    needed: IntArray
    single: Any
    bits: Any


class Levels(NamedTuple):
    """What is known of the selection at every depth; row 0 of the first three is given.

    Parameters
    ----------
    normal, right : ndarray, shape (depths, parts, k, k) and (depths, parts, k)
    equations : ndarray of int, shape (depths, parts)
        How many of features.
    h, q : ndarray, shape (depths, parts, rows, rows)
        Upper triangles.
    own_h, own_q, e, g : ndarray, shape (depths, parts, rows)
        The diagonals of h and q; misfits; and their counterpart.
    square : ndarray, shape (depths, parts)
        y'y.
    """

    normal: FloatArray
    right: FloatArray
    equations: IntArray
    h: FloatArray
    q: FloatArray
    own_h: FloatArray
    own_q: FloatArray
    e: FloatArray
    g: FloatArray
    square: FloatArray


class Space(NamedTuple):
    """Work space.

    Parameters
    ----------
    factor, inverse : ndarray, shape (parts, k, k)
    y : ndarray, shape (parts, k)
    w : ndarray, shape (rows, k)
    rows, share, half : ndarray, shape (most rows of a feature, rows)
        Of the feature that enters: products h, these over 1 + h, and q less half of its change.
    e, g : ndarray, shape (rows,)
    small_h, small_q : ndarray, shape (most rows of a feature, most rows of a feature)
    small : ndarray, shape (4, most rows of a feature)
    total : ndarray, shape (n,)
        y'y with each feature as the next.
    """

    factor: FloatArray
    inverse: FloatArray
    y: FloatArray
    w: FloatArray
    rows: FloatArray
    share: FloatArray
    half: FloatArray
    e: FloatArray
    g: FloatArray
    small_h: FloatArray
    small_q: FloatArray
    small: FloatArray
    total: FloatArray
