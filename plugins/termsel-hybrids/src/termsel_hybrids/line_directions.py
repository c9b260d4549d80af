"""Line-based transformation models: directions of lines, and points for what these leave open."""

from __future__ import annotations

from abc import abstractmethod
from itertools import product

import numpy as np
from numpy.typing import NDArray

from termsel import Equations, FeatureSet, SensorModel, line_normals
from termsel.toolkit.coordinates import is_geographic

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

_DEGREE_METRES = 111_320.0
"""Length of a degree of latitude [m]."""
_NEWTON_STEPS = 6
"""Steps from the nearest rotation; Gauss-Newton needs few, as residuals are small."""


class LineDirections(SensorModel):
    """A parallel projection: lines give equations of their directions alone.

    Let V be the unit vector of a line on the ground and n the unit normal of the line in the image.
    A parallel projection with the 2x3 matrix M maps directions to directions,

        v = s M V,     with a scale s of the line's own, as v is a unit vector too.

    As n v = 0, the scale drops out: n M V = 0, one equation of each line. It holds whatever piece
    of the line was measured. Nothing in it shows translation or scale: that takes points, two or
    more. Every line has two rows in termsel: here they are equal halves of one equation, so that
    the redundancy counts it twice.
    """

    @abstractmethod
    def _columns(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the derivatives of line and sample by each term at places (n, 3), shape (n, 2, k).
        """

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations:
        """Return the equations about a solution `coefficients` (k,) (see `SensorModel.linearised`).

        Rows are in image units: that of a line is divided by the deviation of a direction that two
        measured ends determine, for a model that maps the ground at about the size of the image.
        """
        points = features.points
        lines = features.lines
        rows = self._columns(coefficients, points.ground)
        # b = measured - predicted + J x0, so that the unknown of the equations is x itself.
        b = points.image - self.project(coefficients, points.ground) + rows @ coefficients
        weights_of_points, weights_of_lines = _row_weights(features)
        vertices = lines.ground.reshape(-1, 3)
        normal, _ = line_normals(lines)
        image = self.project(coefficients, vertices).reshape(-1, 2, 2)
        ends = self._columns(coefficients, vertices).reshape(len(lines), 2, 2, rows.shape[2])
        directions = np.einsum("ia,iak->ik", normal, ends[:, 1] - ends[:, 0])
        predicted_distances = np.einsum("ia,ia->i", normal, image[:, 1] - image[:, 0])
        # The deviation of a direction is sqrt(2) over the length of the line in the image. The
        # other sqrt(2) halves the equation into two equal rows.
        weight = _line_lengths(lines.image) / 2 / _line_lengths(lines.ground * self._units)
        weight = weight * weights_of_lines
        rows_of_points = rows.reshape(2 * len(points), rows.shape[2]) * weights_of_points[:, None]
        b_of_lines = (directions @ coefficients - predicted_distances) * weight
        return Equations(
            np.concatenate([rows_of_points, np.repeat(directions * weight[:, None], 2, axis=0)]),
            np.concatenate([b.ravel() * weights_of_points, np.repeat(b_of_lines, 2)]),
            np.repeat(features.feature, 2))

    @property
    def _units(self) -> FloatArray:
        """Factors that bring scaled X, Y and Z to one unit, shape (3,); the larger of X and Y is 1.

        Without a scaling all are 1.
        """
        if self.scaling is None:
            return np.ones(3)
        units = np.array(self.scaling.ground_scale, dtype=float)
        crs = self.scaling.fit_crs or self.crs
        if crs and is_geographic(crs):
            # The latitude is rounded to a tenth of a degree, so that fits to parts of the control
            # have the same units.
            latitude = np.radians(round(self.scaling.ground_offset[1], 1))
            units[:2] *= _DEGREE_METRES * np.array([np.cos(latitude), 1.0])
        return np.asarray(units / units[:2].max())


class LineAffine(LineDirections):
    """Affine line-based transformation model: 8 terms.

    Line and sample are affine functions of X, Y, Z. Control lines determine the six coefficients of
    these up to one scale, by their directions alone; two points or more determine the scale and
    both translations. Points are control as well with ``--set mixed=true``.

    `affine` takes more from the same lines: their places too. So this model serves to compare with,
    and where places of lines are uncertain and their directions are not.

    References
    ----------
    Shaker 2004: The line based transformation model (LBTM). ISPRS Archives XXXV-B3: affine and
    conformal relations between unit vectors of conjugate lines; translations from a control point.
    A summary alone could be consulted. That the scale of each line is eliminated, so that one
    equation is left of it, the scale from points, and the weights are termsel's own.
    """

    name = "lbtm-affine"

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms, as those of `affine`."""
        return tuple(f"{axis}.num:{name}" for axis, name in product(("line", "sample"), "1XYZ"))

    @property
    def axis(self) -> IntArray:
        """Image axis of each term."""
        return np.repeat(np.arange(2), 4)

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and of directions of lines, which are linear already."""
        return self.linearised(features, np.zeros(8))

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points (see `SensorModel.project`)."""
        return np.asarray(np.einsum("nak,...k->...na", self._columns(coefficients, ground),
                                    coefficients))

    def _columns(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the derivatives (n, 2, 8) of line and sample by the coefficients."""
        monomials = np.column_stack([np.ones(len(ground)), ground])
        columns_by_axis = np.einsum("ab,nk->nabk", np.eye(2), monomials)
        return np.asarray(columns_by_axis.reshape(len(ground), 2, 8))


class LineConformal(LineDirections):
    """Conformal line-based transformation model: a turn in space, one scale, and a shift; 6 terms.

    With the ground in one unit, sample = s + a G and line = l - b G. Here a and b are two rows of
    one rotation matrix times one scale: orthogonal, and of one length. They are written by a
    quaternion q, whose square is the scale, so that no angle is singular. A mirrored image is that
    of the ground seen from below, so that it is none of its own. Longitude and latitude are brought
    to metres at the middle of the control; else X, Y and Z are taken to have one unit.

    References
    ----------
    Shaker 2004, as `lbtm-affine`. The quaternion and the solution, Gauss-Newton from the nearest
    rotation to the affine model, are termsel's own.
    """

    name = "lbtm-conformal"

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return "line.num:1", "sample.num:1", "q0", "q1", "q2", "q3"

    @property
    def axis(self) -> IntArray:
        """Image axis of each term: the rotation acts on both."""
        return np.array([0, 1, 2, 2, 2, 2], dtype=np.intp)

    def start(self, features: FeatureSet) -> FloatArray:
        """Return a solution (6,): `_NEWTON_STEPS` steps of Gauss-Newton from the affine model.

        A conformal model is an affine one whose two rows are orthogonal and of one length. The
        steps begin at the pair of such rows nearest to those of the affine model: U V' of their
        singular value decomposition.
        """
        if self.scaling is not None:
            equations = LineAffine().prepared(self.scaling, self.crs).equations(features)
        else:
            equations = LineAffine().equations(features)
        # Terms of an affine model: a constant and the factors of X, Y and Z, for line and sample.
        affine = np.linalg.lstsq(equations.A, equations.b, rcond=1e-9)[0].reshape(2, 4)
        line, sample = affine[:, 1:] / self._units
        left_vectors, sizes, right_vectors = np.linalg.svd(
            np.stack([sample, -line]), full_matrices=False
        )
        a, b = left_vectors @ right_vectors
        rotation = _quaternion_of(np.stack([a, b, np.cross(a, b)]))
        solution = np.array([*affine[:, 0], *rotation * np.sqrt(sizes.mean())])
        for _ in range(_NEWTON_STEPS):
            equations_there = self.linearised(features, solution)
            solution = np.linalg.lstsq(equations_there.A, equations_there.b, rcond=1e-9)[0]
        return solution

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations about the solution of `start`."""
        return self.linearised(features, self.start(features))

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points (see `SensorModel.project`)."""
        # Rows of the matrix are quadratic forms in q, so each is half its derivative times q.
        rows = _rotation_derivatives(coefficients[..., 2:], self._units * ground) / 2
        rotated = np.einsum("...nak,...k->...na", rows, coefficients[..., 2:])
        return np.asarray(coefficients[..., None, :2] + rotated)

    def _columns(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the derivatives (n, 2, 6) of line and sample by shift and quaternion."""
        shift = np.broadcast_to(np.eye(2), (len(ground), 2, 2))
        return np.concatenate([shift,
                               _rotation_derivatives(coefficients[2:],
                                                     self._units * ground)], axis=2)


def _rotation_derivatives(q: FloatArray, ground: FloatArray) -> FloatArray:
    """Return the derivatives of line and sample by a quaternion, shape (..., n, 2, 4).

    The quaternions have the shape (..., 4), the ground positions in one unit (n, 3).
    """
    w, i, j, k = np.moveaxis(q, -1, 0)[..., None]
    # Rows of the rotation matrix of q are quadratic in q: their derivatives are linear.
    x, y, z = ground.T
    sample = (w * x - k * y + j * z, i * x + j * y + k * z, -j * x + i * y + w * z,
              -k * x - w * y + i * z)
    up = (k * x + w * y - i * z, j * x - i * y - w * z, i * x + j * y + k * z,
          w * x - k * y + j * z)
    return np.asarray(2 * np.stack([-np.stack(up, axis=-1), np.stack(sample, axis=-1)], axis=-2))


def _quaternion_of(rotation: FloatArray) -> FloatArray:
    """Return the unit quaternion (4,) of a rotation matrix (3, 3).

    It is the eigenvector of the largest eigenvalue of Davenport's matrix, which is 3 for a
    rotation. Its sign is arbitrary.
    """
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0],
                     rotation[1, 0] - rotation[0, 1]])
    matrix = np.empty((4, 4))
    matrix[0, 0] = np.trace(rotation)
    matrix[0, 1:] = matrix[1:, 0] = skew
    matrix[1:, 1:] = rotation + rotation.T - np.trace(rotation) * np.eye(3)
    return np.asarray(np.linalg.eigh(matrix)[1][:, -1])


def _row_weights(features: FeatureSet) -> tuple[FloatArray, FloatArray]:
    """Return the weights of the rows of points, shape (2 points,), and of lines, shape (lines,).

    A weight is the median of all standard deviations stated, over the one of the row. Points or
    lines without standard deviations have weights of 1.
    """
    sigmas = features.points.sigma, features.lines.sigma
    stated = [sigma.ravel() for sigma in sigmas if sigma is not None]
    unit = float(np.median(np.concatenate(stated))) if stated else 1.0
    return (np.ones(2 * len(features.points)) if sigmas[0] is None else unit / sigmas[0].ravel(),
            np.ones(len(features.lines)) if sigmas[1] is None else unit / sigmas[1])


def _line_lengths(lines: FloatArray) -> FloatArray:
    """Return the distance between both ends of each line (n, 2, d), shape (n,)."""
    return np.asarray(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1))
