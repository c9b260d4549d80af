"""Check a certificate of `exact` by integers alone: ``python -m termsel.check FILE``.

Nothing of the solver is used. All numbers of the file are binary fractions, so that they are exact
here; only the quotients of an elimination are rounded, and its test allows for that. The
theorem and its proof are in docs/explanation/certificates.md, whose names this module has: a vector
z = (x, -t) has the rows A z of the control points, E z of the errors and D z of the denominators of
the check points.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from hashlib import sha256
from math import comb, isfinite
from pathlib import Path
from typing import Any

__all__ = ["SCHEMA", "Refused", "check", "checksum"]

SCHEMA = "termsel-certificate-1"
_ONE = 1 << 256  # a matrix that is to be positive definite is in units of its inverse
_KAPPA = 1 << 160  # weight of the squared normal equations; any is valid, a large one proves most
_MOST = 64  # columns of an axis


class Refused(Exception):
    """The certificate proves nothing; the message says where and why."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the file that is named; return 0 if it proves its claim, else 2."""
    names = sys.argv[1:] if arguments is None else list(arguments)
    if len(names) != 1 or names[0].startswith("-"):
        print("usage: python -m termsel.check FILE", file=sys.stderr)
        return 2
    try:
        lines, open_ = check(names[0])
    except Refused as error:
        print(f"{names[0]}: refused: {error}", file=sys.stderr)
        return 2
    print("\n".join(lines))
    if open_:
        print(f"{names[0]}: {open_:,} selections are left open, so that the optimum is not proven",
              file=sys.stderr)
    return 2 if open_ else 0


def check(path: str | Path) -> tuple[list[str], int]:
    """Return what a certificate proves, in lines, and the number of selections it leaves open.

    Raises Refused for a file that is no certificate, was changed, or has a step that does not hold.
    """
    try:
        return _checked(json.loads(Path(path).read_bytes()))
    except OSError as error:
        raise Refused(f"cannot be read ({error.strerror})") from error
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError,
            OverflowError, RecursionError) as error:
        raise Refused(f"is not a certificate of the form {SCHEMA} ({error!r:.80})") from error


def _checked(content: Any) -> tuple[list[str], int]:
    stated = content.pop("sha256")
    if content["schema"] != SCHEMA or stated != checksum(content):
        raise Refused("the checksum is not that of the content; write it again")
    axes = [_Axis(one) for one in content["axes"]]
    rows, lines, open_, total = 0, [], 0, Fraction(0)
    for axis in axes:
        value = axis.score(axis.selection)
        if value is None or not axis.limit <= value:
            raise Refused(f"axis {axis.name}: the selection does not have the score")
        if value * (1 - Fraction(1, 10**8)) > axis.limit:
            raise Refused(f"axis {axis.name}: the limit is too far below the selection's score")
        decided, left, steps = axis.proven()
        rows, total, open_ = axis.checks, total + value * axis.pixels**2, open_ + left
        lines.append(f"axis {axis.name}: {decided:,} selections of up to {axis.room} of "
                     f"{axis.k} terms are decided by {steps:,} steps, {left:,} are open")
    lines.append(f"check RMSE of the selection: {float(total / rows) ** 0.5:.6f} px")
    if not open_:
        lines.append("no selection has a check RMSE below "
                     f"{float(sum(a.limit * a.pixels**2 for a in axes) / rows) ** 0.5:.6f} px")
    return lines, open_


def checksum(content: Any) -> str:
    """Return the checksum of a certificate without its own."""
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _exact(values: Sequence[float]) -> list[Fraction]:
    if not all(type(value) in (float, int) and isfinite(value) for value in values):
        raise ValueError("a number is not finite")
    return [Fraction(value) for value in values]


class _Axis:
    """One axis: the system, what is claimed of it, and the tree that proves it."""

    def __init__(self, given: dict[str, Any]) -> None:
        self.name, self.nodes = str(given["axis"]), iter(given["nodes"])
        self.k, self.room = len(given["terms"]), int(given["room"])
        if not 0 < self.k <= _MOST or not 0 <= self.room <= self.k:
            raise ValueError("terms")
        self.limit, self.margin, self.pixels = _exact(
            [given["limit"], given["margin"], given["pixels"]])
        a, e, d = (self._rows(given[key]) for key in ("control", "errors", "denominators"))
        self.checks, self.rational = len(e), bool(d)
        if not self.limit > 0 or not e or (d and (len(d) != len(e) or not self.margin > 0)) or any(
                row[-1] != -1 for row in d):
            raise ValueError("limit, margin, errors or denominators")
        # Integers, by a power of two for each of the three blocks; E and D have one in common.
        self.a, self.unit_a = _integers(a)
        both, self.unit = _integers(e + d)
        self.e, self.d = both[:len(e)], both[len(e):]
        self.gram = [[sum(row[i] * row[j] for row in self.a) for j in range(self.k + 1)]
                     for i in range(self.k + 1)]
        self.selection = [int(j) for j in given["selection"]]
        self.forced = frozenset(int(j) for j in given["forced"])
        if self.unit**2 > _ONE or self.unit_a**4 > _KAPPA * _ONE:
            raise ValueError("numbers of too many binary places")
        # The constraint s'z = 1: the sum of all denominators; without any, t = 1.
        self.s = [sum(column) for column in zip(*self.d, strict=True)] if d else \
            [0] * self.k + [-self.unit]
        if len(set(self.selection)) != len(self.selection) or not (
                self.forced <= set(self.selection) <= set(range(self.k))
                and len(self.selection) <= self.room):
            raise ValueError("selection")

    def _rows(self, given: Sequence[Sequence[float]]) -> list[list[Fraction]]:
        rows = [_exact(row) for row in given]
        if any(len(row) != self.k + 1 for row in rows):
            raise ValueError("a row has not one value for each term and the target")
        return rows

    def proven(self) -> tuple[int, int, int]:
        """Walk the tree; return the selections decided and left open, and the number of steps."""
        rest = [j for j in range(self.k) if j not in self.forced]
        # No denominator is above the sum of all, and t is below 1 / (c margin).
        upper = [Fraction(1)] * self.checks + [
            1 / (self.margin * self.checks) if self.rational else Fraction(1)]
        counts = [0, 0, 0]
        todo = [(sorted(self.forced), rest, upper)]
        while todo:
            counts[2] += 1
            try:
                todo += reversed(list(self._step(next(self.nodes), *todo.pop(), counts)))
            except StopIteration:
                raise Refused(f"axis {self.name}: the tree ends before step {counts[2]}") from None
            except Refused as error:
                raise Refused(f"axis {self.name}, step {counts[2]}: {error}") from None
        if next(self.nodes, None) is not None:
            raise Refused(f"axis {self.name}: the tree goes on after all is decided")
        return counts[0], counts[1], counts[2]

    def _step(self, node: Sequence[Any], used: list[int], rest: list[int], upper: list[Fraction],
              counts: list[int]) -> Iterator[tuple[list[int], list[int], list[Fraction]]]:
        """Check one node, count the selections that it closes, and yield its children."""
        left = self.room - len(used)
        inside = sum(comb(len(rest), n) for n in range(min(left, len(rest)) + 1))
        what, *values = node
        if what == "split":
            (j,) = values
            others = [i for i in rest if i != j]
            if len(others) != len(rest) - 1:
                raise Refused("a split is by a term that is not open")
            yield used, others, upper
            if left > 0:
                yield [*used, j], others, upper
        elif what == "limits":
            share, sphere, claims = values
            lower, columns = list(upper), [*used, *rest, self.k]
            matrix = self._matrix(used, rest, upper, share, sphere)
            for k, value, weight in claims:
                u, rho = _exact([value, weight])
                if not u > 0 or not _is_positive(self._with(matrix, columns, k, u, rho)):
                    raise Refused(f"limit {k} does not hold")
                lower[k] = min(lower[k], u)
            yield used, rest, lower
        elif what == "closed":
            share, sphere, *pole = values
            matrix = self._matrix(used, rest, upper, share, sphere)
            if pole:  # no denominator may be negative
                k, rho = pole
                matrix = self._with(matrix, [*used, *rest, self.k], k, Fraction(0), *_exact([rho]))
            if not _is_positive(matrix):
                raise Refused("a selection may be better: the matrix is not positive definite")
            counts[0] += inside
        elif what == "one":
            if left and rest:
                raise Refused("a single selection was claimed, but terms are open")
            value = self.score(used)
            if value is not None and value < self.limit:
                raise Refused("a selection is better than the limit")
            counts[0] += 1
        elif what == "open":
            counts[1] += inside
        else:
            raise Refused(f"there is no step {what!r:.20}")

    def _matrix(self, used: list[int], rest: list[int], upper: list[Fraction], share: float,
                sphere: float) -> list[list[int]]:
        """Return the lower half of the theorem's matrix M, by used and open columns and target.

        Where it is positive definite, no selection of this node is below the limit.
        """
        beta, alpha = _exact([share, sphere])
        if not 0 <= beta <= 1 or (beta and not self.rational):
            raise ValueError("a multiplier")
        columns, square = [*used, *rest, self.k], self.unit**2
        # Smaller weights than those of the file prove as well; all else is exact.
        weights = [_floor((1 - beta) / (self.limit * u**2 * square)) for u in upper[:-1]]
        half, normal = _floor(alpha / (2 * self.unit_a**2)), _KAPPA * _ONE // self.unit_a**4
        matrix = []
        for p, i in enumerate(columns):
            row = []
            for j in columns[:p + 1]:
                total = sum(w * e[i] * e[j] for w, e in zip(weights, self.e, strict=True))
                if j < self.k:  # N: of each term's column with A z, half on both sides
                    total += half * self.gram[i][j] * (2 if i < self.k else 1)
                total += normal * sum(self.gram[m][i] * self.gram[m][j] for m in used)
                row.append(total - _ONE // square * self.s[i] * self.s[j])
            matrix.append(row)
        matrix[-1][-1] += _floor(beta / upper[-1]**2)
        return matrix

    def _with(self, matrix: list[list[int]], columns: list[int], k: int, u: Fraction,
              rho: Fraction) -> list[list[int]]:
        """Return M + rho (s g' + g s'), g = u s - a, which proves that a'z is not above u.

        That is D_k z, or t for k = c. With u = 0 it is that a'z would have to be negative.
        """
        if not (self.rational and type(k) is int and 0 <= k <= self.checks and rho >= 0):
            raise ValueError("a multiplier")
        a = self.d[k] if k < self.checks else [0] * self.k + [-self.unit]
        scale, s = _floor(rho / (self.unit**2 * u.denominator)), [self.s[j] for j in columns]
        g = [scale * (u.numerator * self.s[j] - u.denominator * a[j]) for j in columns]
        return [[value + s[p] * g[q] + g[p] * s[q] for q, value in enumerate(row)]
                for p, row in enumerate(matrix)]

    def score(self, used: Sequence[int]) -> Fraction | None:
        """Return the score of one selection, None if it has none: rounded down, hence a bound."""
        x, det = _solved([[self.gram[i][j] for j in used] for i in used],
                         [self.gram[i][self.k] for i in used])
        if det == 0:
            return None
        total = 0
        for m in range(self.checks):
            error = self.e[m][-1] * det - sum(
                self.e[m][j] * v for j, v in zip(used, x, strict=True))
            below = self.unit * det
            if self.rational:
                below = sum(self.d[m][j] * v for j, v in zip(used, x, strict=True)) + below
                if below < self.margin * self.unit * det:
                    return None
            total += error * error * _ONE // (below * below)
        return Fraction(total, _ONE)


def _floor(value: Fraction) -> int:
    """Return a fraction in units of the last binary place, rounded down."""
    return value.numerator * _ONE // value.denominator


def _integers(rows: list[list[Fraction]]) -> tuple[list[list[int]], int]:
    """Return rows of binary fractions as integers, and the unit they were multiplied by."""
    unit = max((value.denominator for row in rows for value in row), default=1)
    return [[int(value * unit) for value in row] for row in rows], unit


def _is_positive(lower: list[list[int]]) -> bool:
    """Return whether a symmetric matrix is positive definite; False if that is too close to tell.

    By elimination. Each of n quotients in one place is off by less than 1, so that what is
    eliminated is the matrix but for one of norm below n^2, which the diagonal pays for.
    """
    n = len(lower)
    for i in range(n):
        lower[i][i] -= n * n
    for k in range(n):
        pivot = lower[k][k]
        if pivot <= 0:
            return False
        for i in range(k + 1, n):
            ratio = lower[i][k]
            if ratio:
                for j in range(k + 1, i + 1):
                    lower[i][j] -= ratio * lower[j][k] // pivot
    return True


def _solved(matrix: list[list[int]], target: list[int]) -> tuple[list[int], int]:
    """Return x and d > 0 with matrix x = d target, by elimination without fractions (Bareiss).

    The matrix is one of inner products; d is 0 if it is singular.
    """
    n, last = len(matrix), 1
    rows = [[*row, value] for row, value in zip(matrix, target, strict=True)]
    for k in range(n):
        if rows[k][k] == 0:  # inner products: a zero pivot is a dependent column
            return [], 0
        for i in range(n):
            if i != k:
                rows[i] = [(rows[k][k] * rows[i][j] - rows[i][k] * rows[k][j]) // last
                           for j in range(n + 1)]
        last = rows[k][k]
    return [row[n] for row in rows], last
