"""Check a certificate of `exact` by integers alone: ``termsel check certificate.json``.

Also ``python -P -m termsel.check FILE``, or this file by itself. It prints the whole theorem, and
only then what of it is proved: a certificate of few columns, or with some forced, is as true as one
of all, but says less.

Nothing of the solver is used. All numbers of the file are binary fractions, so that they are exact
here; only an elimination is rounded, and its result allows for that. The theorem and its proof are
in docs/explanation/certificates.md, whose names this module has: a vector z = (x, -t) has the rows
A z of the control points, E z of the errors and D z of the denominators of the check points.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from hashlib import sha256
from itertools import chain
from math import comb, isfinite, isqrt
from operator import mul
from pathlib import Path
from typing import Any

__all__ = ["CERTIFICATE_SCHEMA", "UPPER", "Axis", "Node", "Refused", "check", "checksum",
           "is_certificate",
           "main", "require_together"]

CERTIFICATE_SCHEMA = "termsel-certificate-2"
_ONE = 1 << 256  # the quadratic form is in units of its inverse
_PLACES = 128  # binary places of what is eliminated
UPPER = 1 << 64  # limits are in units of its inverse
_KAPPA = 1 << 100  # weight of the squared normal equations; any is valid, a large one proves most
_SHARE = 16  # the fact on t has the weight 1 / 16
_MOST = 64  # columns of an axis
_LARGEST = 1 << 28  # bytes of a file; trees of 50,000 steps have a tenth
_LONGEST = 60  # characters of a name
_HEAD = 200  # bytes that distinguish a certificate from other files


class Refused(Exception):
    """The certificate proves nothing; the message says where and why."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the file that the one argument names; return 0 if it proves its claim, else 2.

    What it claims, and what is proved of that, is printed; on stderr why it is refused, or how many
    selections are left open. `arguments` are by default those of the command line.
    """
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
    """Return what a certificate proves, in lines, and how many selections stay open.

    Raises Refused for a file that cannot be read, is no certificate, was changed, or has a step
    that does not hold.
    """
    try:
        return _proven_lines(json.loads(_read_certificate(Path(path))))
    except OSError as error:
        raise Refused(f"cannot be read ({error.strerror})") from error
    # The file may be anything: whatever its content breaks on the way, it is no certificate.
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError,
            OverflowError, RecursionError) as error:
        raise Refused(f"is not a certificate of the form {CERTIFICATE_SCHEMA} "
                      f"({error!r:.80})") from error


def _read_certificate(path: Path) -> bytes:
    """Return the bytes of a regular file that is not too large for a certificate.

    Raises Refused where there is no regular file, or one of more than `_LARGEST` bytes.
    """
    if not path.is_file():
        raise Refused("is no file, or no regular one" if path.exists() else "there is no such file")
    if path.stat().st_size > _LARGEST:
        raise Refused(f"is larger than {_LARGEST:,} bytes, and no certificate is")
    return path.read_bytes()


def is_certificate(path: str | Path) -> bool:
    """Return whether a file says that it is a certificate, of this or another form."""
    try:
        if not Path(path).is_file():
            return False
        with Path(path).open("rb") as file:
            return b'"termsel-certificate-' in file.read(_HEAD)
    except OSError:
        return False


def _proven_lines(content: Any) -> tuple[list[str], int]:
    """Return the lines that say what a certificate proves, and how many selections stay open.

    The certificate says of which data it is, what its selection scores on each axis and which parts
    of the tree of selections are excluded, and why; all of it is computed again here in whole
    numbers and fractions, by no code of the search. `content` loses its checksum. Raises Refused
    for a certificate that has been changed, or that does not prove its claim.
    """
    stated = content.pop("sha256")
    if content["schema"] != CERTIFICATE_SCHEMA:
        raise Refused(f"it is a {content['schema']!r:.40}, not a {CERTIFICATE_SCHEMA}; write it "
                      "again")
    if stated != checksum(content):
        raise Refused("the checksum is not that of the content; write it again")
    axes = [Axis(axis_content) for axis_content in content["axes"]]
    require_together(axes)
    # RMSE^2 = pixels^2 / points times the sum of the axes' scores.
    share = axes[0].pixels**2 / axes[0].checks  # of a sum of scores in a squared RMSE
    lines = _claim_lines(content, axes)
    lines.append("What is proved of it:")
    open_ = 0
    total = Fraction(0)
    for axis in axes:
        value = axis.score(axis.selection)
        if value is None or not axis.limit <= value:
            raise Refused(f"axis {axis.name}: the selection does not have the score")
        # The score is rounded down, by less than a unit at each check point.
        if value + Fraction(axis.checks, _ONE) > axis.limit * (1 + Fraction(1, 10**8)):
            raise Refused(f"axis {axis.name}: the limit is too far below the selection's score")
        decided, undecided, steps = axis.verify()
        total = total + value
        open_ = open_ + undecided
        lines.append(f"axis {axis.name}: {decided:,} selections of up to {axis.room} of "
                     f"{axis.k} terms are enumerated or excluded in {steps:,} steps, "
                     f"{undecided:,} are open")
    restriction = f" in {axes[0].name}, of this axis alone" if len(axes) == 1 else ""
    lines.append(f"RMSE at the selection points: {float(total * share) ** 0.5:.6f} px{restriction}")
    if not open_:
        lines.append("no selection has an RMSE there below "
                     f"{float(sum(a.limit for a in axes) * share) ** 0.5:.6f} px{restriction}")
    return lines, open_


def _claim_lines(content: dict[str, Any], axes: Sequence[Axis]) -> list[str]:
    """Return the claim in lines: its data, columns and selections, and its limits.

    The reader sees what is claimed before what is proven: the data by their checksum, the terms on
    offer, those that every selection has, how many it may have, and the limit. Raises ValueError
    for a checksum that is none.
    """
    stated = content.get("data")
    if stated is not None and not (type(stated) is str and stated.isalnum() and len(stated) == 64):
        raise ValueError("a checksum of data")
    lines = ["What is claimed, of the data with the SHA-256 "
             f"{stated or 'that the certificate does not state'}:"]
    for axis, axis_content in zip(axes, content["axes"], strict=True):
        # Who has the equations can compute this checksum of them, and compare.
        system = checksum({key: axis_content[key] for key in ("control", "errors", "denominators")})
        lines += [
            f"axis {axis.name}: {len(axis.a)} equations of the control and {axis.checks} "
            f"selection points, whose numbers have the SHA-256 {system}",
            f"  terms, {axis.k}: {', '.join(axis.terms)}",
            f"  columns forced into every selection, {len(axis.forced)}: "
            f"{', '.join(axis.terms[j] for j in sorted(axis.forced)) or 'none'}",
            f"  room: at most {axis.room} terms in a selection",
            f"  margin: denominators at the selection points are at least {float(axis.margin):.6g}"
            if axis.rational else "  margin: none, as there are no denominators",
            f"  limit of the sum of squared errors: {float(axis.limit):.12g}, of pixels of "
            f"{float(axis.pixels):.6g}",
            f"  the selection, {len(axis.selection)}: "
            f"{', '.join(axis.terms[j] for j in axis.selection) or 'none'}"]
    lines.append("No feasible selection of these terms has a sum of squared errors below the "
                 "limit.")
    return lines


def require_together(axes: Sequence[Axis]) -> None:
    """Raise Refused unless axes are of one image: only then may their scores be added."""
    if not axes or len({axis.name for axis in axes}) < len(axes):
        raise Refused("an axis is there twice, or none is")
    if len({(axis.checks, axis.pixels) for axis in axes}) > 1:
        raise Refused("the axes have not the same number of selection points and pixels")


def checksum(content: Any) -> str:
    """Return the checksum of a certificate without its own."""
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _name(term: Any) -> str:
    """Return the name of a term, which is printed; ValueError for none of printable characters."""
    if type(term) is not str or not 0 < len(term) <= _LONGEST or not term.isprintable():
        raise ValueError("a term without a name of printable characters")
    return term


def _as_fraction(values: Sequence[float]) -> list[Fraction]:
    """Return finite numbers as exact fractions; raises ValueError for any other."""
    if not all(type(value) in (float, int) and isfinite(value) for value in values):
        raise ValueError("a number is not finite")
    return [Fraction(value) for value in values]


@dataclass(frozen=True, eq=False)
class Node:
    """All selections that have the used columns, and of the others some of `rest` alone."""

    used: tuple[int, ...]
    rest: tuple[int, ...]
    upper: tuple[int, ...]  # limits of the denominators and of t, in units of 1 / UPPER
    columns: tuple[int, ...]  # used and rest in the order of the form, then the target
    form: list[list[int]]  # lower half: weighted squares of the errors and of normal equations


class Axis:
    """One axis: the system, what is claimed of it, and the tree that proves it.

    Given are an axis of a certificate's content. Raises ValueError and the like for what is none.
    """

    def __init__(self, content: dict[str, Any]) -> None:
        """Read an axis of a certificate's content; ValueError and the like for what is none."""
        self.name = content["axis"]
        self.nodes = iter(content["nodes"])
        if self.name not in ("line", "sample"):  # it is printed
            raise ValueError("an axis that is neither line nor sample")
        self.terms = [_name(term) for term in content["terms"]]
        self.k = len(self.terms)
        self.room = int(content["room"])
        if not 0 < self.k <= _MOST or not 0 <= self.room <= self.k:
            raise ValueError(f"terms: not 1 to {_MOST}, or no such room")
        self.limit, self.margin, self.pixels = _as_fraction(
            [content["limit"], content["margin"], content["pixels"]])
        a, e, d = (self._parse_rows(content[key]) for key in ("control", "errors", "denominators"))
        self.checks = len(e)
        self.rational = bool(d)
        if not e or not min(self.limit, self.pixels) > 0 or (d and (
                len(d) != len(e) or not self.margin > 0)) or any(row[-1] != -1 for row in d):
            raise ValueError("limit, margin, pixels, errors or denominators")
        # Integers, by a power of two for each of the three blocks; E and D have one in common.
        self.a, self.unit_a = _to_integers(a)
        rows, self.unit = _to_integers(e + d)
        self.e = rows[:len(e)]
        self.d = rows[len(e):]
        self.by_column = list(zip(*self.e, strict=True))
        # A'A of the terms and the target.
        columns_of_a = list(zip(*self.a, strict=True)) or [()] * (self.k + 1)
        self.gram = []
        for column in columns_of_a:
            self.gram.append([sum(map(mul, column, other)) for other in columns_of_a])
        self.normal = _KAPPA * _ONE // self.unit_a**4
        self.selection = [int(j) for j in content["selection"]]
        self.forced = frozenset(int(j) for j in content["forced"])
        if self.unit**2 > _ONE or not self.normal:
            raise ValueError("numbers of too many binary places")
        # The constraint s'z = 1: the sum of all denominators; without any, t = 1. Below it D and t.
        t = [0] * self.k + [-self.unit]
        total = list(map(sum, zip(*self.d, strict=True))) if d else t
        self.lines = []
        for line in [total, *self.d, t]:
            self.lines.append([(value << _PLACES) // self.unit for value in line])
        if len(set(self.selection)) != len(self.selection) or not (
                self.forced <= set(self.selection) <= set(range(self.k))
                and len(self.selection) <= self.room):
            raise ValueError("selection")

    def _parse_rows(self, values: Sequence[Sequence[float]]) -> list[list[Fraction]]:
        """Return rows as exact fractions; raises ValueError if one has not k + 1 values."""
        rows = [_as_fraction(row) for row in values]
        if any(len(row) != self.k + 1 for row in rows):
            raise ValueError("a row has not one value for each term and the target")
        return rows

    def verify(self) -> tuple[int, int, int]:
        """Check every step; return the selections decided and left open, and the number of steps.

        For one call only, as the steps are used up. Raises Refused, with the axis, for a step that
        does not hold (with its number), and for a tree that ends too early or goes on after all is
        decided or left open. What a malformed step raises (ValueError, TypeError) passes.
        """
        counts = [0, 0]  # selections decided, and left open
        # A stack instead of recursion; the first child is on top, as in the order of the steps.
        todo = [self.root()]
        n_steps = 0
        for n_steps, step in enumerate(self.nodes, 1):
            if not todo:
                raise Refused(f"axis {self.name}: the tree goes on after all is decided")
            try:
                children = self._check_step(todo.pop(), counts, *step)
            except Refused as error:
                raise Refused(f"axis {self.name}, step {n_steps}: {error}") from None
            todo += reversed(children)
        if todo:
            raise Refused(f"axis {self.name}: the tree ends before step {n_steps + 1}")
        return counts[0], counts[1], n_steps

    def _check_step(self, node: Node, counts: list[int], step: Any, *values: Any) -> list[Node]:
        """Check one step, count the selections that it decides, and return the remaining nodes.

        Raises Refused if the step proves nothing.
        """
        # How many more columns a selection of this node can have, and how many such selections
        # there are.
        room = min(self.room - len(node.used), len(node.rest))
        inside = sum(comb(len(node.rest), n) for n in range(room + 1))
        if step == "split":
            return self.halves(node, *values)
        if step == "limits":
            return [self.limited(node, *values)]
        if step == "closed":
            if not self.is_closed(node, *values):
                raise Refused("a selection may be better: the bound does not close")
            counts[0] += inside
        elif step == "one":
            if room:
                raise Refused("a single selection was claimed, but terms are open")
            value = self.score(node.used)
            if value is not None and value < self.limit:
                raise Refused("a selection is better than the limit")
            counts[0] += 1
        elif step == "open":
            counts[1] += inside
        else:
            raise Refused(f"there is no step {step!r:.20}")
        return []

    def root(self) -> Node:
        """Return the node of all selections."""
        # No denominator is above the sum of all, and t is below 1 / (c margin).
        largest_t = 1 / (self.margin * self.checks) if self.rational else Fraction(1)
        upper = (*[UPPER] * self.checks, -(-largest_t.numerator * UPPER // largest_t.denominator))
        size = range(self.k + 1)
        node = Node((), tuple(range(self.k)), upper, tuple(size), [[0] * (i + 1) for i in size])
        node = self._with_higher_weights(node, [self._integer_weight(u) for u in upper[:-1]])
        for j in sorted(self.forced):
            node = self._branch_using(node, j)
        return node

    def halves(self, node: Node, j: int) -> list[Node]:
        """Return the node without an open column and, if there is room, the node that uses it.

        Raises Refused where column j is not open.
        """
        if type(j) is not int or j not in node.rest:
            raise Refused("a split is by a term that is not open")
        # Without the column its row and its column of the lower half go.
        p = node.columns.index(j)
        open_columns = tuple(i for i in node.rest if i != j)
        fewer = [row if i < p else row[:p] + row[p + 1:]
                 for i, row in enumerate(node.form) if i != p]
        without = replace(node, rest=open_columns, form=fewer,
                          columns=node.columns[:p] + node.columns[p + 1:])
        return [without, self._branch_using(node, j)] if len(node.used) < self.room else [without]

    def _branch_using(self, node: Node, j: int) -> Node:
        """Return the selections that use column j: the square of its normal equation is 0."""
        # Row j of A'A times z is zero for the least-squares z, so its square may be added with any
        # weight.
        row = [self.gram[j][i] for i in node.columns]
        form = []
        for old, gram in zip(node.form, row, strict=True):
            weight = self.normal * gram
            form.append([value + weight * entry for value, entry in zip(old, row, strict=False)])
        return replace(node, used=(*node.used, j), rest=tuple(i for i in node.rest if i != j),
                       form=form)

    def _integer_weight(self, upper: int) -> int:
        """Return 1 / (L u^2), rounded down, for the squares of the integers of the errors."""
        return (_ONE * UPPER**2 * self.limit.denominator
                // (self.limit.numerator * self.unit**2 * upper**2))

    def _with_higher_weights(self, node: Node, weights: Sequence[int]) -> Node:
        """Return a node with higher weights of the errors."""
        errors = [self.by_column[j] for j in node.columns]
        form = []
        # To entry i, j of the form come the products of the errors' columns i and j, weighted.
        for row, column in zip(node.form, errors, strict=True):
            weighted = tuple(map(mul, weights, column))
            form.append([value + sum(map(mul, weighted, other))
                         for value, other in zip(row, errors, strict=False)])
        return replace(node, form=form)

    def limited(self, node: Node, spheres: Any) -> Node:
        """Return a node with limits as low as the multipliers alpha prove them.

        Raises Refused if they prove nothing.
        """
        extent = self._extent_of_lines(node, spheres, range(1, len(self.lines)))
        if extent is None or extent[0] or not self.rational:
            raise Refused("the limits have no proof")
        # Limits only ever fall, and stay positive.
        upper = [max(1, min(old, new)) for old, new in zip(node.upper, extent[1], strict=True)]
        added = [self._integer_weight(new) - self._integer_weight(old)
                 for new, old in zip(upper[:-1], node.upper[:-1], strict=True)]
        return replace(self._with_higher_weights(node, added), upper=tuple(upper))

    def is_closed(self, node: Node, spheres: Any, k: int | None = None) -> bool:
        """Return whether no selection of a node is below the limit.

        That is because of its score, or because denominator k would have to be negative.

        Raises ValueError where there is no denominator k.
        """
        if k is not None and not (self.rational and type(k) is int and 0 <= k < self.checks):
            raise ValueError("a denominator")
        extent = self._extent_of_lines(node, spheres, [] if k is None else [k + 1])
        return extent is not None and (extent[0] or min(extent[1], default=0) < 0)

    def _extent_of_lines(self, node: Node, spheres: Any,
                         lines: Sequence[int]) -> tuple[bool, list[int]] | None:
        """Return whether s'z = 1 is out of reach, and else the largest values of some `lines`.

        These are in units of 1 / UPPER, rounded up. `spheres` are the certificate's multipliers of
        the columns in `node.rest`: a list with one for each, or a number for all. They may be
        wrong: whatever they are, what is returned is proven. Returns None if they prove nothing.
        Raises ValueError for a multiplier that is no finite number.
        """
        if type(spheres) is not list:
            spheres = [spheres] * len(node.rest)
        scale = Fraction(_ONE, 2 * self.unit_a**2)
        half = dict(zip(node.rest,
                        (_floor_of_binary(alpha * scale) for alpha in _as_fraction(spheres)),
                        strict=True))
        alphas = [half.get(i, 0) for i in node.columns]
        n = len(node.columns)
        h = (n + 2) * (2 * n + 1)  # above the norm of all that is rounded
        drop = _ONE.bit_length() - 1 - _PLACES
        rows = []
        for p, (i, alpha) in enumerate(zip(node.columns, alphas, strict=True)):
            gram = self.gram[i]
            rows.append([(value + (alpha + alpha_j) * gram[j]) >> drop for value, alpha_j, j in zip(
                node.form[p], alphas, node.columns, strict=False)])
            rows[p][p] -= h
        if self.rational:
            rows[-1][-1] += (UPPER**2 << _PLACES) // (_SHARE * node.upper[-1]**2)
        for at in [0, *lines]:
            rows.append([self.lines[at][j] for j in node.columns] + [0] * (1 + (at > 0)))
        remainder = _schur_complement(rows, n)
        if remainder is None:
            return None
        # C of the theorem, by the last rows. Times 1 + beta, z'Qz is at most 1.
        unit_of_beta = (1 << _PLACES) * _SHARE // (_SHARE + self.rational)
        ss = h + 1 - remainder[0][0]
        if ss < unit_of_beta:
            return True, []
        largest = []
        for sa, aa in remainder[1:]:
            # The largest value of a line over the ellipsoid cut by s'z = 1, from the last rows; the
            # root is rounded up.
            det = ss * (h + 1 - aa) - sa * sa
            root = isqrt(max(0, det * (ss - unit_of_beta) // unit_of_beta + 1)) + 1
            largest.append(-((sa - root) * UPPER // ss))
        return False, largest

    def score(self, used: Sequence[int]) -> Fraction | None:
        """Return the score of the columns `used`, rounded down, hence a bound; None if it has none.

        It has none if the columns are linearly dependent, or a denominator is below the margin.
        """
        # The normal equations of the selection, exactly: x / det are its coefficients.
        matrix = []
        for i in used:
            matrix.append([self.gram[i][j] for j in used])
        x, det = _solve_exactly(matrix, [self.gram[i][self.k] for i in used])
        if det == 0:
            return None
        total = 0
        for m in range(self.checks):
            # The score is the sum over m of ((e_mk - sum_j e_mj x_j) / (1 + sum_j d_mj x_j))^2.
            # Both are multiplied by unit and det, so that all stays in integers.
            error = self.e[m][-1] * det - sum(
                self.e[m][j] * v for j, v in zip(used, x, strict=True))
            denominator = self.unit * det
            if self.rational:
                denominator += sum(self.d[m][j] * v for j, v in zip(used, x, strict=True))
                if denominator < self.margin * self.unit * det:
                    return None
            total += error * error * _ONE // (denominator * denominator)
        return Fraction(total, _ONE)


def _floor_of_binary(value: Fraction) -> int:
    """Return the largest whole number that is not above a fraction."""
    return value.numerator // value.denominator


def _schur_complement(rows: list[list[int]], n: int) -> list[list[int]] | None:
    """Return B - S' inv(A) S of a symmetric matrix (A S; S' B); None for a pivot below 1.

    Of A, shape (n, n), the rows are the lower triangle. Below it are rows of S' and of B, of which
    no others are needed than the first column and the diagonal:

        a11
        a21 a22
        s11 s12 b11
        s21 s22 b21 b22
        s31 s32 b31 b33

    so that the first row returned is (c11,), each other one (ci1, cii). Columns are eliminated one
    after the other, in fixed point. Each of the n updates of an entry rounds down twice, a ratio
    and its product, by less than 1 each in the entry's unit: it is off by less than 2.
    """
    bits = max(value.bit_length() for value in chain.from_iterable(rows))
    for k in range(n):
        pivot, *firsts = [row[0] for row in rows]
        # An entry that outgrows the first ones has lost the places that the bound counts on.
        if pivot <= 0 or max(map(int.bit_length, firsts)) > bits:
            return None
        rows_left_of_a = n - k - 1
        # What a row of B has in its first column is updated by the first row below A.
        column = firsts[:rows_left_of_a + 1]
        updated = []
        for i, (first, row) in enumerate(zip(firsts, rows[1:], strict=True)):
            # A fixed-point ratio with as many binary places as the largest entry has.
            ratio = (first << bits) // pivot
            # The diagonal of a row of B is updated by the row itself.
            factors = column if i <= rows_left_of_a else [*column, first]
            updated.append([value - (ratio * factor >> bits)
                            for value, factor in zip(row[1:], factors, strict=False)])
        rows = updated
    return rows


def _to_integers(rows: list[list[Fraction]]) -> tuple[list[list[int]], int]:
    """Return rows of binary fractions as integers, and the unit they were multiplied by."""
    # Denominators are powers of two, so the largest is a multiple of all.
    unit = max((value.denominator for value in chain.from_iterable(rows)), default=1)
    integers = []
    for row in rows:
        integers.append([int(value * unit) for value in row])
    return integers, unit


def _solve_exactly(matrix: list[list[int]], target: list[int]) -> tuple[list[int], int]:
    """Return x and d > 0 with matrix x = d target, by elimination without fractions (Bareiss).

    The matrix is one of inner products; d is 0 if it is singular.
    """
    n = len(matrix)
    last = 1
    # Bareiss: every division is exact, as entries are minors of the matrix.
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


if __name__ == "__main__":  # by itself: the package around it needs others
    sys.exit(main())
