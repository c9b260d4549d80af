"""Twins in a population of masks."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from termsel.adjustment.compiled import compiled
from termsel.measurements.features import BoolArray, IntArray


def distinct(columns: BoolArray, rows: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first occurrence of every distinct mask, and the number of each mask among these.

    It takes some hundredths of a solution's time, and a converging population is full of twins.
    """
    p, k, f = len(columns), columns.shape[1], rows.shape[1]
    # Bits of a mask in words; the table has at least twice as many places as masks.
    words = np.zeros((p, k // 64 + f // 64 + 2), dtype=np.uint64)
    table = np.full(1 << max(2, (2 * p - 1).bit_length()), -1, dtype=np.intp)
    first, copies = np.empty(p, dtype=np.intp), np.empty(p, dtype=np.intp)
    n = _distinct(columns, rows, words, table, first, copies)
    return first[:n], copies


@partial(compiled, _nrt=False)
def _distinct(columns: BoolArray, rows: BoolArray, words: NDArray[np.uint64], table: IntArray,
              first: IntArray, copies: IntArray) -> int:
    """Fill in what `distinct` returns, and return how many distinct masks there are."""
    k, f, last = columns.shape[1], rows.shape[1], len(table) - 1
    one = np.uint64(1)
    n = 0
    for i in range(len(words)):
        word = words[i]
        for j in range(k):
            word[j >> 6] = (word[j >> 6] << one) | np.uint64(columns[i, j])
        for j in range(f):
            w = k // 64 + 1 + (j >> 6)
            word[w] = (word[w] << one) | np.uint64(rows[i, j])
        # Fibonacci hashing: the upper bits of a product with 2^64 / golden ratio.
        key = np.uint64(0)
        for w in range(len(word)):
            key = (key ^ word[w]) * np.uint64(0x9E3779B97F4A7C15)
            key ^= key >> np.uint64(29)
        place = np.intp(key & np.uint64(last))
        while table[place] >= 0:  # linear probing: the table is never full
            twin = words[first[table[place]]]
            same = 0
            while same < len(word) and twin[same] == word[same]:
                same += 1
            if same == len(word):
                break
            place = (place + 1) & last
        if table[place] < 0:
            table[place] = n
            first[n] = i
            n += 1
        copies[i] = table[place]
    return n
