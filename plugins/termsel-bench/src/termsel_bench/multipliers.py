"""Multipliers of the bound that certificates have, found in floating-point numbers.

The theorem is in docs/explanation/certificates.md. Whether multipliers prove what they seem to is
for `termsel.check` to say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]

# Share by which a bound must exceed what it proves, because of rounding.
SLACK = 1e-6
# Weight of the fact on t, as in the checker.
_FACT_WEIGHT = 1 / 16
# Multipliers at which the search begins, times (tau |r|)^2.
_START_MULTIPLIERS = (0.6, 2.0, 8.0)
# Weight of the determinant, which keeps the ellipsoid small in all directions.
_BARRIER = 0.3
# Most Newton steps at one node.
_NEWTON_STEPS = 8
# Least root of a pivot; below it rounding leaves no digits.
_MIN_PIVOT = 1e-6


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns and target of an axis with those in use removed: one row each, the target's last."""

    # (n + 1, m).
    control: FloatArray
    # (n + 1, c), over the root of the limit.
    errors: FloatArray
    # (n + 1, c); (n + 1, 0) without any.
    denominators: FloatArray
    # (n,): the number of each column.
    names: tuple[int, ...]
    # (c + 1,): limits of the denominators and of t.
    upper: FloatArray
    # (n,): multipliers that are good for a start.
    alphas: FloatArray | None

    def without(self, i: int) -> Columns:
        """Return the columns but for column i, which no selection below has."""
        return replace(self, control=np.delete(self.control, i, 0),
                       errors=np.delete(self.errors, i, 0),
                       denominators=np.delete(self.denominators, i, 0),
                       names=self.names[:i] + self.names[i + 1:],
                       alphas=None if self.alphas is None else np.delete(self.alphas, i))

    def projected_off(self, i: int) -> Columns:
        """Return the other columns, projected off column i, which is in use.

        Multipliers stay, as they are still good for a start.
        """
        a = self.control[i]
        square = float(a @ a)
        # Each row r becomes r - (r a' / a a') a; errors and denominators change by the same
        # multiple of row i.
        multiples = self.control @ a / square if square > 0 else np.zeros(len(self.control))
        return replace(self, control=self.control - np.outer(multiples, a),
                       errors=self.errors - np.outer(multiples, self.errors[i]),
                       denominators=self.denominators - np.outer(multiples, self.denominators[i])
                       ).without(i)


@dataclass(frozen=True, eq=False)
class Bound:
    """What some multipliers prove of columns."""

    # (n,).
    alphas: FloatArray
    # The least value of z'Qz where s'z = 1.
    minimum: float
    # L^-1 of Q = L L'.
    inverse: FloatArray
    # L^-1 s.
    h: FloatArray

    @property
    def closes(self) -> bool:
        """Whether no selection is below the limit: it would have at most 1 and the share of t."""
        return self.minimum > (1.0 + _FACT_WEIGHT) * (1.0 + SLACK)

    def largest(self, columns: Columns) -> FloatArray:
        """Return limits of the c denominators, and of t last, that no selection exceeds, (c + 1,).

        They hold for all selections whose error is below the limit, as far as this bound shows.
        """
        forms = np.vstack([columns.denominators.T, np.append(np.zeros(len(columns.names)), -1.0)])
        rows = forms @ self.inverse.T
        # In the ellipsoid z' Q z <= 1 + weight with s'z = 1, a linear form is at most its value at
        # the minimum plus the root of the room above the minimum times the form's square there.
        along_h = rows @ self.h * self.minimum
        squares = (rows**2).sum(axis=1)
        across = np.maximum(0.0, squares - along_h**2 / self.minimum) + SLACK * squares
        room = max(0.0, 1.0 + _FACT_WEIGHT - self.minimum) + SLACK
        return np.asarray(along_h + np.sqrt(room * across))


@dataclass(frozen=True, eq=False)
class _Form:
    """The quadratic form Q of columns, but for the multipliers."""

    # (n + 1, n + 1).
    base: FloatArray
    # (n + 1, n + 1): products in the control rows.
    gram: FloatArray
    # (n + 1,).
    s: FloatArray

    def bound(self, alphas: FloatArray) -> Bound | None:
        """Return the bound that multipliers (n,) prove.

        None if the form Q with these multipliers is not positive definite, or hardly so.
        """
        # Q_ij = base_ij + (alpha_i + alpha_j) / 2 gram_ij, where t has the multiplier 0.
        pairs = np.append(alphas, 0.0)
        form = self.base + (pairs[:, None] + pairs) / 2 * self.gram
        diagonal = np.diag(form)
        if not (diagonal > 0.0).all():
            return None
        # Columns differ in size, so that the form is scaled to a diagonal of ones.
        lengths = np.sqrt(diagonal)
        try:
            triangle = np.linalg.cholesky(form / np.outer(lengths, lengths))
        except np.linalg.LinAlgError:
            return None
        if np.diag(triangle).min() < _MIN_PIVOT:
            return None
        inverse = np.linalg.inv(triangle) / lengths
        h = inverse @ self.s
        # The least value of z^T Q z where s^T z = 1 is 1 / (s^T Q^-1 s), and h = L^-1 s.
        return Bound(alphas, float(1.0 / (h @ h)), inverse, h)


def _form_of(columns: Columns) -> _Form:
    """Return the quadratic form of columns, which multipliers have to keep positive definite.

    It is the sum of the squared errors of check points, each over the limit of its denominator.
    """
    c = columns.errors.shape[1]
    n = len(columns.names)
    # Errors of each check point over the limit of its denominator.
    weighted = columns.errors / columns.upper[:c]
    base = weighted @ weighted.T
    s = np.append(np.zeros(n), -1.0)
    # The fact on t, weighed as in the checker.
    if columns.denominators.shape[1]:
        base[n, n] += _FACT_WEIGHT / columns.upper[c]**2
        s = columns.denominators.sum(axis=1)
    return _Form(base, columns.control @ columns.control.T, s)


def best_bound(columns: Columns, *, tune: bool = True) -> Bound | None:
    """Return the bound of columns by the best multipliers that a few steps find.

    Without `tune` the multipliers of the columns are taken, if they have any. None if no
    multipliers keep the form positive definite.
    """
    form = _form_of(columns)
    n = len(columns.names)
    starts = [] if columns.alphas is None else [columns.alphas]
    if tune or not starts:
        scale = columns.upper[-1]**2 * form.gram[n, n]
        starts += [
            np.full(n, weight / scale if scale > 0.0 else 0.0) for weight in _START_MULTIPLIERS
        ]
    bounds = [bound for bound in map(form.bound, starts) if bound is not None]
    best = max(bounds, key=lambda bound: bound.minimum, default=None)
    if best is None or not tune or not n or form.gram[n, n] <= 0.0:
        return best
    return _tune_bound(form, best)


def _tune_bound(form: _Form, at: Bound) -> Bound:
    """Return a bound of a larger minimum, by Newton's method from the bound `at`, if there is one.

    What is maximised is the minimum plus a barrier, log det Q, both of which are concave in the
    multipliers. Where the minimum is taken, at z with s'z = 1, its derivative by alpha_j is z'N_j z
    = x_j a_j'Az.
    """
    n = len(at.alphas)
    for _ in range(_NEWTON_STEPS):
        if at.closes:
            break
        inverse = at.inverse.T @ at.inverse
        # The minimum z = Q^-1 s / (s^T Q^-1 s).
        z = at.minimum * (at.inverse.T @ at.h)
        products = form.gram @ z
        weight = _BARRIER * at.minimum / (n + 1)
        # The vectors N_j z, as columns.
        derivatives = (np.diag(products)[:, :n] + form.gram[:, :n] * z[:n]) / 2
        inverse_gram = inverse @ form.gram
        # The gradient by the multipliers, and minus the second derivatives, both with the barrier.
        slope = z[:n] * products[:n] + weight * np.diag(inverse_gram)[:n]
        bend = (2.0 * derivatives.T @ (inverse - np.outer(z, z) / at.minimum) @ derivatives
                + weight / 2 * (inverse_gram[:n, :n] * inverse_gram[:n, :n].T
                                + inverse[:n, :n] * (form.gram @ inverse_gram)[:n, :n]))
        try:
            # A small number on the diagonal keeps the system regular if multipliers depend on each
            # other.
            step = np.linalg.solve(bend + 1e-12 * np.trace(bend) / n * np.eye(n), slope)
        except np.linalg.LinAlgError:
            break
        higher = _higher_bound(form, at, step, weight)
        if higher is None:
            break
        gain = higher.minimum - at.minimum
        at = higher
        if gain < 0.01 * at.minimum:
            break
    return at


def _higher_bound(form: _Form, at: Bound, step: FloatArray, weight: float) -> Bound | None:
    """Return the bound after a step (n,) of the multipliers, halved until its objective is higher.

    `weight` is that of the barrier in the objective. None if no step down to a hundredth of the
    whole makes it higher.
    """
    height = _barrier_objective(at, weight)
    size = 1.0
    while size > 0.01:
        bound = form.bound(at.alphas + size * step)
        if bound is not None and _barrier_objective(bound, weight) > height:
            return bound
        size = size / 2
    return None


def _barrier_objective(bound: Bound, weight: float) -> float:
    """Return the objective that is maximised: the minimum plus `weight` times log det Q."""
    # Q = L L', so that log det Q = -2 log det L^-1.
    return bound.minimum - 2.0 * weight * float(np.log(np.abs(np.diag(bound.inverse))).sum())
