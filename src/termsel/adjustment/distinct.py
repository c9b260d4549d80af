"""Twins in a population of masks."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.measurements.features import BoolArray, IntArray


@compiled
def distinct(columns: BoolArray, rows: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first occurrence of every distinct mask, and the number of each mask among these.

    It takes some hundredths of a solution's time, and a converging population is full of twins.
    """
    p, k, f = len(columns), columns.shape[1], rows.shape[1]
    words = np.zeros((p, k // 64 + f // 64 + 2), dtype=np.uint64)
    one = np.uint64(1)
    size = 4
    while size < 2 * p:
        size *= 2
    table = np.full(size, -1, dtype=np.intp)
    first, copies = np.empty(p, dtype=np.intp), np.empty(p, dtype=np.intp)
    n = 0
    for i in range(p):
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
        place = np.intp(key & np.uint64(size - 1))
        while table[place] >= 0 and not (words[first[table[place]]] == word).all():
            place = (place + 1) & (size - 1)
        if table[place] < 0:
            table[place] = n
            first[n] = i
            n += 1
        copies[i] = table[place]
    return first[:n], copies
