"""Models whose line and sample are quotients of linear forms."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from typing import Any, ClassVar, TypeAlias

import numpy as np

from termsel.adjustment.control_views import view_of_control
from termsel.adjustment.equations import (
    Equations,
    approximate_image,
    image_equations,
    line_normals,
    weights_of,
)
from termsel.adjustment.iterated import Quotients, solve_least_distances
from termsel.adjustment.leave_out import IndependentPart, solve_parts
from termsel.core.isolation.arrays import difference_from_shape, difference_from_type
from termsel.core.isolation.calls import Check
from termsel.core.isolation.faults import fault_of_method
from termsel.core.options import Option
from termsel.data.coordinates.crs import is_geocentric
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray, Points
from termsel.data.monomials import RPC00B, Exponents, evaluate_monomials, monomial_name
from termsel.models.base import BOTH, LINE, SAMPLE, SensorModel
from termsel.models.terms import AXES, Term


@dataclass(frozen=True, eq=False)
class Blocks:
    """Columns of numerators and denominators at ground points.

    Parameters
    ----------
    line, sample : ndarray, shape (n, columns)
        Columns of the numerators.
    line_denominator, sample_denominator : ndarray, shape (n, columns), optional
        Columns of the denominators without their leading 1.
    shared_denominator : ndarray, shape (n, columns), optional
        Columns of a denominator that both axes share, without its leading 1.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> columns = np.ones((4, 1))
    >>> termsel.Blocks(line=columns, sample=columns).line.shape
    (4, 1)
    """

    line: FloatArray
    sample: FloatArray
    line_denominator: FloatArray | None = None
    sample_denominator: FloatArray | None = None
    shared_denominator: FloatArray | None = None


Columns: TypeAlias = dict[str, tuple[slice, FloatArray]]
"""Of each block the terms and their columns at some places, shape (n, columns)."""

# In the order of the terms: block, and image axis and part of its terms.
_LAYOUT = (
    ("line", LINE, "numerator"),
    ("line_denominator", LINE, "denominator"),
    ("sample", SAMPLE, "numerator"),
    ("sample_denominator", SAMPLE, "denominator"),
    ("shared_denominator", BOTH, "denominator"),
)


def _blocks_fault(_model: RationalModel, value: Any, ground: FloatArray) -> str | None:
    """Return how the columns of a model are at fault; None if they are not."""
    return difference_from_type(value, Blocks) or next(filter(None, (
        difference_from_shape(columns, (len(ground), -1), verb=f"returned as {name}")
        for name, columns in vars(value).items() if columns is not None
        or name in ("line", "sample"))), None)


def _column_names_fault(_model: RationalModel, value: Any, _block: str) -> str | None:
    """Return how names of columns are at fault; None if they are not, or are left to be numbered.
    """
    if value is None:
        return None
    # A text would be taken for as many names as it has letters.
    if not isinstance(value, tuple | list):
        return difference_from_type(value, tuple)
    nameless = [name for name in value if not isinstance(name, str) or not name]
    return f"returned {nameless[0]!r:.100} as a name; expected text" if nameless else None


class RationalModel(SensorModel):
    """A model whose line and sample are each a quotient of two linear forms.

    With numerator columns n, denominator columns d and coefficients a, c: line = n a /
    (1 + d c), sample likewise. Subclasses give the columns in `blocks`; equations of points
    and lines, projection and fast evaluation follow.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> class Plane(termsel.RationalModel):
    ...     "Line and sample linear in X and Y."
    ...     name = "plane-demo"
    ...
    ...     def blocks(self, ground):  # (n, 3), scaled to [-1, 1]
    ...         columns = np.column_stack([np.ones(len(ground)), ground[:, :2]])
    ...         return termsel.Blocks(line=columns, sample=columns)
    >>> len(Plane().terms)
    6
    """

    guards: ClassVar[Mapping[str, Check | None]] = {"blocks": _blocks_fault,
                                                    "column_names": _column_names_fault}

    @abstractmethod
    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the columns at scaled ground points.

        Parameters
        ----------
        ground : ndarray, shape (n, 3)
            Scaled.
        """

    def column_names(self, block: str) -> tuple[str, ...] | None:
        """Return names of a block's columns, or None to have them numbered.

        Parameters
        ----------
        block : str
            A field of `Blocks`, such as "line_denominator".
        """
        return None

    @cached_property
    def _layout(self) -> tuple[tuple[str, slice, int, tuple[str, ...]], ...]:
        """Return the name of each block, its columns among the terms, its axis and its term names.

        Blocks of numerators and denominators stand in one row of terms, in the order of `_LAYOUT`,
        without those that the model does not have.
        Raises PluginFault for a model that names more or fewer columns than it has, or two alike.
        """
        # The columns at any one place show how many there are.
        sample = self.blocks(np.zeros((1, 3)))
        layout = []
        start = 0
        for block, axis, part in _LAYOUT:
            columns = getattr(sample, block)
            if columns is None or not columns.shape[1]:
                continue
            width = columns.shape[1]
            # Columns without names are numbered.
            names = self.column_names(block) or tuple(str(i) for i in range(width))
            if len(names) != width:
                raise fault_of_method(self, "column_names",
                                      f"names {len(names)} of {width} columns of {block!r}")
            if len(set(names)) < width:
                raise fault_of_method(self, "column_names",
                                      f"gives two columns of {block!r} one name")
            layout.append((block, slice(start, start + width), axis,
                           tuple(str(Term(AXES[axis], part, name)) for name in names)))
            start += width
        return tuple(layout)

    @cached_property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms: block and column, such as "line.den:XY"."""
        return tuple(chain.from_iterable(names for *_, names in self._layout))

    @property
    def axis(self) -> IntArray:
        """Image axis of each term, (k,): 0 line, 1 sample, 2 both."""
        return np.concatenate([np.full(len(names), axis, dtype=np.intp)
                               for _, _, axis, names in self._layout])

    def _columns(self, ground: FloatArray) -> Columns:
        """Return the columns of each block at places (n, 3), with their slice among the terms.

        Raises PluginFault for a model that has another number of columns at other places.
        """
        blocks = self.blocks(ground)
        columns_by_block = {}
        for block, span, _, names in self._layout:
            columns = np.asarray(getattr(blocks, block), dtype=np.float64)
            if columns.shape[1] != len(names):
                raise fault_of_method(self, "blocks", (
                    f"returned {columns.shape[1]} columns of {block!r} at {len(ground)} places, "
                    f"and {len(names)} at one; expected as many at any places"))
            columns_by_block[block] = (span, columns)
        return columns_by_block

    def _axis_rows(self, columns_by_block: Columns, image: FloatArray) -> FloatArray:
        """Return rows over all terms for line and sample of n places, shape (n, 2, k).

        From l (1 + d c) = n a follows n a - l d c = l: the denominator's columns enter
        multiplied by minus the image coordinate, which is measured or approximate.
        """
        rows = np.zeros((len(image), 2, len(self.terms)))
        for block, (span, columns) in columns_by_block.items():
            if block in ("line", "line_denominator", "shared_denominator"):
                rows[:, LINE, span] = columns if block == "line" else -image[:, :1] * columns
            if block in ("sample", "sample_denominator", "shared_denominator"):
                rows[:, SAMPLE, span] = columns if block == "sample" else -image[:, 1:] * columns
        return rows

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and of lines.

        A point gives one row for its line and one for its sample. A control line gives
        one row for each of its ground vertices G, which must lie on the image line:
        nl l(G) + ns s(G) = rho, with unit normal (nl, ns) and offset rho of the image line
        in Hesse form. This is linear for polynomials; with a shared denominator it becomes
        linear when multiplied by it. With separate denominators the products of image
        coordinate and denominator need the image position of the vertex. It is taken from
        `approximate_image`: this is a Gauss-Newton step from that polynomial to the least
        squares of distances in the image. A fit iterates from there by `linearised`.
        (With the measured offset across the image line the coefficients would be biased, as
        rows and right-hand side then share its error.)

        Rows are weighted by `row_weights`.

        The vector form follows from the requirement that conjugate lines coincide. It is
        termsel's own: the published line equations of line-based RFMs (Teo 2013; Yavari et al.
        2018) could not be consulted.
        """
        points = features.points
        lines = features.lines
        if not len(lines):
            image = np.empty((0, 2))
        elif self.exact_for_lines:
            # The place along the image line cancels.
            # Each image line once, in Hesse form: n . (line, sample) = rho.
            normal, rho = line_normals(lines)
            image = np.repeat(normal * rho[:, None], 2, axis=0)
        else:
            # The image of a vertex by a polynomial through the control, as its place along the line
            # is not measured.
            image = approximate_image(features, heights=self.uses_height)
        of_vertices = np.empty((0, 2, len(self.terms)))
        if len(lines):
            of_vertices = self._axis_rows(self._columns(lines.ground.reshape(-1, 3)), image)
        return image_equations(features,
                               self._axis_rows(self._columns(points.ground), points.image),
                               of_vertices, heights=self.uses_height)

    @property
    def weighted(self) -> bool:
        """True if every adjustment goes on to the least squares of distances in the image."""
        return False

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return the equations of points and lines about the `coefficients` (k,) of a solution.

        They are those of one step of Gauss-Newton. There are such equations for lines with separate
        denominators, and for all features of a model that is `weighted`. In all other cases None
        keeps the linear equations that the literature solves: points alone, and lines with
        polynomials or a shared denominator.
        """
        if not self.weighted and (not len(features.lines) or self.exact_for_lines):
            return None
        systems = []
        vertices = features.lines.ground.reshape(-1, 3)
        for ground in (features.points.ground, vertices) if len(vertices) else (
                features.points.ground,):
            columns = self._columns(ground)
            below = self._denominators(coefficients, columns)
            assert below is not None
            # With f = n a / (1 + d c): df = (n da - f d dc) / (1 + d c), and J x = f / (1 + d c).
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                image = self._axis_forms(coefficients, columns, "line", "sample") / below
                systems += [self._axis_rows(columns, image) / below[..., None],
                            image - image / below]
        if not len(vertices):
            systems += [np.empty((0, 2, len(self.terms))), np.empty((0, 2))]
        return image_equations(features, *systems[::2], *systems[1::2], heights=self.uses_height)

    @property
    def first_terms(self) -> BoolArray | None:
        """Numerators, (k,), where the model is `weighted`, else None."""
        return np.array([not Term.parse(name).is_denominator
                         for name in self.terms]) if self.weighted else None

    def least_distances(self, points: Points, systems: tuple[IndependentPart, ...],
                        terms: BoolArray, used: BoolArray | None) -> FloatArray:
        """Return the coefficients (p, k) of the least squares of distances in the image.

        They are of p selections of `terms` (p, k), with points in use as in `used` (p, n), by
        default all. `systems` are the linear equations. Their solution for the `first_terms`, if
        the model names some, is where the search begins.
        """
        n_terms = terms.shape[1]
        is_in_use = np.ones((len(terms), len(points)), dtype=bool) if used is None else used
        columns = self._columns(points.ground)
        # Rows of line and sample in turn, over all terms. Images of 0 leave out the columns of
        # denominators, and with images of -1 they come as they are, next to those of numerators.
        numerators = self._axis_rows(columns, np.zeros_like(points.image)).reshape(-1, n_terms)
        all_columns = self._axis_rows(columns, -np.ones_like(points.image)).reshape(-1, n_terms)
        # Points that are not in use have no weight; each has two rows.
        weights = np.where(np.repeat(is_in_use, 2, axis=1), weights_of(points).ravel(), 0.0)
        first = self.first_terms
        start, _ = solve_parts(systems, terms if first is None else terms & first, used)
        quotients = Quotients(numerators, all_columns - numerators, points.image.ravel(), weights)
        return solve_least_distances(quotients, systems, terms, start)

    @property
    def exact_for_lines(self) -> bool:
        """True where the equations of lines are linear."""
        return not {block for block, *_ in self._layout} & {"line_denominator",
                                                            "sample_denominator"}

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points (see `SensorModel.project`)."""
        columns = self._columns(ground)
        image = self._axis_forms(coefficients, columns, "line", "sample")
        below = self._denominators(coefficients, columns)
        if below is not None:
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                image /= below
        return image

    def denominators(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray | None:
        """Return 1 + d c for line and sample, shape (..., n, 2), or None."""
        return self._denominators(coefficients, self._columns(ground))

    def _denominators(self, coefficients: FloatArray, columns: Columns) -> FloatArray | None:
        """Return denominators (..., n, 2) of line and sample; None if the model has none.

        `coefficients` (..., k) are those of all terms, `columns` what `_columns` returns of n
        places.
        """
        if not columns.keys() & {"line_denominator", "sample_denominator", "shared_denominator"}:
            return None
        # A denominator is 1 + d c, its own or that of both axes.
        below = 1.0 + self._axis_forms(coefficients, columns, "line_denominator",
                                       "sample_denominator")
        if "shared_denominator" in columns:
            span, block = columns["shared_denominator"]
            below += (coefficients[..., span] @ block.T)[..., None]
        return below

    @staticmethod
    def _axis_forms(coefficients: FloatArray, columns: Columns, *names: str) -> FloatArray:
        """Return the linear forms of a line block and a sample block, shape (..., n, 2).

        `names` are those of the two blocks; `coefficients` and `columns` are as for
        `_denominators`. A block that the model does not have has the form 0.
        """
        n = len(next(iter(columns.values()))[1])
        # One axis may have a block that the other one has not: its form is 0 there.
        forms = np.zeros((*coefficients.shape[:-1], n, 2))
        for axis, name in enumerate(names):
            if name in columns:
                span, block = columns[name]
                forms[..., axis] = coefficients[..., span] @ block.T
        return forms


class MonomialModel(RationalModel):
    """A model of the same monomials for line and sample, with or without denominators."""

    @property
    @abstractmethod
    def exponents(self) -> Exponents:
        """Exponents of X, Y, Z of each column, of denominators with the constant first."""

    @property
    def divides(self) -> str:
        """Whether axes have "separate" denominators, a "shared" one, or "none"."""
        return "none"

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials as numerators, and without the constant as denominators."""
        # The constant of a denominator is fixed to 1, so its column is left out.
        above = evaluate_monomials(ground, self.exponents)
        separate, shared = (above[:, 1:] if self.divides == kind else None
                            for kind in ("separate", "shared"))
        return Blocks(above, above, separate, separate, shared)

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names."""
        # In the order of the exponents, as `blocks` has the columns.
        names = tuple(monomial_name(e) for e in self.exponents)
        return names[1:] if block.endswith("denominator") else names


# Poles: places in the scene where a denominator is too small.
#
# What an image cannot show, as it lies below or behind the camera, does not count: there even the
# denominator of a right model of an oblique photograph is zero or less.

POLE_MARGIN = 0.1
"""Least value of a denominator over the scene; vendor RPCs stay within some hundredths of 1."""

SHORTER = 0.25
"""Least value of a denominator, by the least one of an oblique view at a control point."""

LARGEST_SHORTFALL = 1e9
"""Largest shortfall of a denominator; finite, so that it can be compared."""

GUARDED = 100
"""Features at which denominators are tested, next to the grid. Polynomials of third order have
no room for a pole between so many."""

_GRID = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, n) for n in (5, 5, 3)]), -1).reshape(-1, 3)


def pole_margin(control: FeatureSet) -> float:
    """Return the least value that denominators must have, of models of scaled control.

    It is POLE_MARGIN, or less where control supports an oblique view, whose nearest point is so
    much nearer to the camera than the middle.
    """
    view = view_of_control(control)
    return POLE_MARGIN if view is None else min(POLE_MARGIN, SHORTER * view.depth)


@lru_cache(maxsize=8)  # each model of a comparison asks for those of the same features
def guard_points(control: FeatureSet, check: Points, wider: float = 1.0) -> FloatArray:
    """Return scaled ground points, (g, 3), at which denominators must stay positive.

    They are the features themselves, of very many an even choice, and a grid over the box around
    them; all are moved apart by the factor `wider` about the middle of the box. In an oblique view
    points that are not in front of the camera are left out.
    """
    vertices = np.concatenate([control.ground_vertices(), check.ground])
    axes = np.eye(3)
    # X, Y, Z are not along the ground: the box is turned to the features.
    if control.fit_crs and is_geocentric(control.fit_crs):
        axes = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2].T
    # The grid spans the box around all features along these axes.
    low = (vertices @ axes).min(axis=0)
    high = (vertices @ axes).max(axis=0)
    if len(vertices) > GUARDED:
        even = np.linspace(0, len(vertices) - 1, GUARDED).astype(int)
        vertices = vertices[spatial_order(vertices[:, :2])[even]]
    grid = (low + high) / 2 + _GRID * (high - low) / 2
    # Back from the turned axes to X, Y, Z.
    guard = np.concatenate([vertices, grid @ axes.T])
    if wider != 1.0:
        middle = (guard.max(axis=0) + guard.min(axis=0)) / 2
        guard = middle + wider * (guard - middle)
    view = view_of_control(control)
    if view is not None:
        guard = np.concatenate([vertices, guard[view.shows(guard)]])
    guard.setflags(write=False)  # all who ask for the same ones share them
    return guard


def pole_violation(model: SensorModel, coefficients: FloatArray, ground: FloatArray,
                   margin: float = POLE_MARGIN) -> FloatArray:
    """Return how far denominators fall below a margin, shape (p,), at most LARGEST_SHORTFALL.

    0 is safe, and is returned for a model without denominators. `coefficients` (p, k) are p sets,
    and `ground` (n, 3) the scaled places at which denominators are computed.
    """
    below = model.denominators(coefficients, ground)
    if below is None:
        return np.zeros(len(coefficients))
    # A denominator that is not a number is as bad as can be.
    smallest = np.nan_to_num(below, nan=-LARGEST_SHORTFALL).min(axis=(1, 2))
    return np.asarray(np.clip(margin - smallest, 0.0, LARGEST_SHORTFALL))


# The rational function model.

_TERMS_OF_ORDER = {1: 4, 2: 10, 3: 20}


RIDGE = 0.01
"""Control lines hardly determine what numerators and denominators have in common, which then grows
to poles. With errors of 1 px in an image of 10 000 px this is a standard deviation of 0.002 for a
coefficient. Those of satellites are smaller. One of 0.3, as of a photograph, loses 0.0002 with
fifty equations. A DLT is determined by lines without it."""


class RationalFunctions(MonomialModel):
    """Rational function model: line and sample as quotients of 3-D polynomials.

    The denominators' constants are fixed to 1, so that order 3 with separate denominators
    has 78 terms. The equations are linearised by multiplication with the denominator, as is
    usual in terrain-dependent RFM.

    Regularisation is that of Tao and Hu 2001: a constant on the diagonal of the normal equations.
    It applies to denominators alone. Numerators of satellite images have large coefficients, which
    it would bias. Its default is termsel's own.

    References
    ----------
    Akhoundi Khezrabad et al. 2020, eq. 1; order of monomials: RPC00B. Tao and Hu 2001,
    PE&RS 67(12), for regularisation.

    Examples
    --------
    >>> import termsel
    >>> model = termsel.RationalFunctions(order=3, denominators="separate")
    >>> len(model.terms)
    78
    """

    name = "rfm"
    declared_options = (
        Option("order", 3, "Order of the polynomials: 4, 10 or 20 monomials each.", int, 1, 3),
        Option("denominators", "separate",
               "Whether line and sample have separate denominators, share one, or have none.",
               choices=("separate", "shared", "none")),
        Option("ridge", None, "Weight of pseudo-observations that the coefficients of denominators "
               f"are zero, in scaled coordinates; 0 for none. By default {RIDGE} with control "
               "lines, but none for a DLT (order 1, shared) or for points alone.",
               float, 0.0, 1e6),
        Option("weighted", False, "Divide the equations by the denominators and iterate, to the "
               "least squares of distances in the image: each fit, and with control points each "
               "selection that a search judges by selection points.", bool),
    )

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of the numerators' monomials."""
        return RPC00B[:_TERMS_OF_ORDER[self.options["order"]]]

    @property
    def divides(self) -> str:
        """Whether line and sample have denominators, separate or shared."""
        return str(self.options["denominators"])

    @property
    def weighted(self) -> bool:
        """Whether adjustments are iterated, of points too."""
        return bool(self.options["weighted"]) and self.divides != "none"

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and lines (see `RationalModel.equations`)."""
        return replace(super().equations(features), prior=self._prior_weights(features))

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return them about a solution, with the prior (see `RationalModel.linearised`)."""
        equations = super().linearised(features, coefficients)
        return equations and replace(equations, prior=self._prior_weights(features))

    def _prior_weights(self, features: FeatureSet) -> FloatArray | None:
        """Return the weights (k,) that hold the terms of denominators near 0.

        Returns None where these terms are not held.
        """
        ridge = self.options["ridge"]
        if ridge is None:
            # A DLT has so few denominators that lines determine them.
            is_dlt = self.options["order"] == 1 and self.exact_for_lines
            ridge = RIDGE if len(features.lines) and not is_dlt else 0.0
        # Pseudo-observations sqrt(ridge) c = 0 add `ridge` to the diagonal of the normal equations.
        below = np.array([Term.parse(name).is_denominator for name in self.terms])
        return np.sqrt(ridge) * below if ridge and below.any() else None
