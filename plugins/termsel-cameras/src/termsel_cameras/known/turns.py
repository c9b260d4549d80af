"""Rotations as vectors: the axis, as long as the angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def vector_of(rotation: FloatArray) -> FloatArray:
    """Return the vector of a rotation (3, 3).

    By way of the quaternion whose largest part is found first, as the others then are sure, too
    (Shepperd 1978, J. Guid. Control 1(3)).
    """
    trace = float(np.trace(rotation))
    # 4 q_i^2 - 1 of the four components, but for the trace: the largest is divided by.
    candidates = np.append(np.diag(rotation), trace)
    i = int(np.argmax(candidates))
    q = np.empty(4)
    if i == 3:
        q[3] = 1.0 + trace
        q[:3] = [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0],
                 rotation[1, 0] - rotation[0, 1]]
    else:
        j = (i + 1) % 3
        k = (i + 2) % 3
        q[i] = 1.0 - trace + 2.0 * rotation[i, i]
        q[j] = rotation[j, i] + rotation[i, j]
        q[k] = rotation[k, i] + rotation[i, k]
        q[3] = rotation[k, j] - rotation[j, k]
    q /= np.linalg.norm(q) * (1.0 if q[3] >= 0.0 else -1.0)
    # q = (axis sin(angle / 2), cos(angle / 2)).
    sine = float(np.linalg.norm(q[:3]))
    angle = 2.0 * np.arctan2(sine, q[3])
    return np.asarray(q[:3] * (angle / sine if sine > 0.0 else 2.0))
