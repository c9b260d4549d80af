"""Rotations as vectors: the axis, as long as the angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def vector_of(rotation: FloatArray) -> FloatArray:
    """Return the axis of a rotation (3, 3) times its angle, from 0 to pi [rad].

    The way is by the quaternion, of which the largest component is found first, as others are
    divided by it (Shepperd 1978, J. Guid. Control 1(3)).
    """
    trace = float(np.trace(rotation))
    # 4 q_i^2 is 1 - trace + 2 R_ii for the vector's components and 1 + trace for the scalar q_3:
    # the order of these is that of R_ii and the trace.
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
    # q and -q are one rotation; that with q_3 >= 0 has the angle up to pi.
    q /= np.linalg.norm(q) * (1.0 if q[3] >= 0.0 else -1.0)
    # q = (axis sin(angle / 2), cos(angle / 2)).
    sine = float(np.linalg.norm(q[:3]))
    angle = 2.0 * np.arctan2(sine, q[3])
    return np.asarray(q[:3] * (angle / sine if sine > 0.0 else 2.0))
