"""Twins in a population of masks."""

from __future__ import annotations

import numpy as np

from termsel.data.features import BoolArray, IntArray


def distinct(columns: BoolArray, rows: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first occurrence of every distinct mask, and the number of each mask among these.

    It takes some hundredths of a solution's time, and a converging population is full of twins.
    """
    bits = np.packbits(np.concatenate([columns, rows], axis=1), axis=1)
    masks = bits.view(f"V{bits.shape[1]}")[:, 0].tolist()
    numbers = np.arange(len(masks))
    if len(set(masks)) == len(masks):
        return numbers, numbers
    # of the first one
    first_numbers = dict(zip(reversed(masks), reversed(numbers.tolist()), strict=True))
    first = np.fromiter(map(first_numbers.__getitem__, masks), np.intp, len(masks))
    is_first = first == numbers
    return numbers[is_first], (np.cumsum(is_first) - 1)[first]
