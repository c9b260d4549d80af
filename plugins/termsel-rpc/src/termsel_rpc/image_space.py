"""Bias correction of an RPC in image space."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel import Equations, FeatureSet, Option, Rpc, Term, TermselError, read_rpc
from termsel_rpc.parametric import line_equations
from termsel_rpc.refinement import FloatArray, Refinement
from termsel_rpc.simulated import DATASET_NAME, RPC_FILE

RPC = Option("rpc", "", "Required: the RPC to refine, as a file in any form that termsel reads, or "
                        f"{DATASET_NAME} for that of the embedded data set. A result contains the "
                        "RPC itself.")

LINE_FORM = Option("line_form", "vector", "Equations of control lines: vector, the ground "
                   "vertices lie on the image line; parametric, each measured end lies at an "
                   "unknown position along the projected ground line.",
                   choices=("vector", "parametric"))

_AXES = ("line", "sample")

_GRID_SIZE, _EDGE_MARGIN, _MAX_DIFFERENCE = 12, 0.1, 0.01
"""Points along each edge of the grid by which another RPC is fitted, the share of the image by
which the grid goes beyond its edges, and the largest difference that is accepted [px]."""


class RpcShift(Refinement):
    """Vendor's RPC, shifted in the image: 2 terms.

    With (l, s) the RPC position of a ground point, image = (l + a0, s + b0). Every refinement of
    an RPC adds a polynomial of that position to it, so that the terms enter linearly:

        rpc-shift     1            2 terms
        rpc-drift     1, l         4 terms
        rpc-affine    1, l, s      6 terms

    for line and for sample each. Terms are called line.bias:1, sample.bias:line and so on. Like
    all coefficients they are in scaled units: constants times the image scale are in px, at the
    middle of the control; the others are in px per px.

    References
    ----------
    Grodecki, Dial 2003: Block adjustment of high-resolution satellite images described by
    rational polynomials. PE&RS 69(1), 59-68: image offsets as a polynomial of line and sample.
    Hanley, Fraser 2004: Sensor orientation for high-resolution satellite imagery: further
    insights into bias-compensated RPCs. ISPRS Archives XXXV-B1: shift, shift and drift, and
    affine as the sets to choose from. They correct measured positions; here those of the RPC
    are corrected, so that points can be projected. The papers' equations could not be
    consulted in full. In termsel both axes drift with the line, along which time runs; in
    Orthority each axis drifts with its own coordinate. `rpc-affine` contains both.
    Teo 2013: Line-based rational function model for high-resolution satellite imagery: the bias of
    an RPC by control lines, in a vector and a parametric form. A summary alone could be consulted;
    the equations of `line_form` are termsel's own.
    """

    name = "rpc-shift"
    declared_options: ClassVar[tuple[Option, ...]] = (RPC, LINE_FORM)
    columns: ClassVar[tuple[str, ...]] = ("1",)

    def __init__(self, **options: Any) -> None:
        """Take the options, and read the RPC that the option `rpc` names, if it names one.

        From then on the option is the RPC itself, as JSON; only that of the embedded data set stays
        a name. Raises TermselError for unknown options, and for an RPC that cannot be read.
        """
        super().__init__(**options)
        # The name of the data set, the JSON of a result, or a file.
        stated = self.options["rpc"]
        self._rpc = None
        self._file = stated
        if stated == DATASET_NAME:
            self._rpc = read_rpc(RPC_FILE)
        elif stated.startswith("{"):
            self._rpc, self._file = _rpc_from_record(stated)
        elif stated:
            self._rpc = read_rpc(stated)
            self._file = Path(stated).name
            # A result must be readable without the vendor's file.
            self.options["rpc"] = json.dumps(asdict(self._rpc))

    @property
    def rpc(self) -> Rpc:
        """The RPC as delivered.

        Raises
        ------
        TermselError
            If the option `rpc` names none.
        """
        if self._rpc is None:
            raise TermselError(f"model {self.name!r} requires the RPC to refine",
                               hint=f"Give its file with --rpc FILE. --set rpc={DATASET_NAME} is "
                                    "that of the embedded data set.")
        return self._rpc

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms: image axis and column, such as "line.bias:sample"."""
        return tuple(_name(axis, column) for axis, column in product(_AXES, self.columns))

    @property
    def axis(self) -> NDArray[np.intp]:
        """Image axis of each term: 0 line, 1 sample."""
        return np.repeat(np.arange(2), len(self.columns))

    @property
    def source(self) -> str:
        """The RPC and its file, for messages."""
        return f"the RPC {self._file}"

    def footprint(self) -> FloatArray:
        """Return the least, then the greatest longitude and latitude [deg] of the RPC, (2, 2)."""
        middle = self.rpc.ground_offset[:2]
        half_extent = np.abs(self.rpc.ground_scale[:2])
        return np.stack([middle - half_extent, middle + half_extent])

    def first_order(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scaled image positions (n, 2) by the RPC, and the terms' columns (n, 2, k).

        `ground` (n, 3) is scaled; a column is what a term of 1 adds to line and sample.
        """
        geographic = self.geographic(ground)
        assert self.scaling is not None  # otherwise `geographic` has raised an error
        image = self.scaling.image(self.rpc.project(geographic))
        values = {"1": np.ones(len(image)), "line": image[:, 0], "sample": image[:, 1]}
        columns = np.stack([values[name] for name in self.columns], axis=1)
        # The same columns for both axes, each with its own terms: a block diagonal of two.
        both_axes = np.einsum("ab,nc->nabc", np.eye(2), columns)
        return image, both_axes.reshape(len(image), 2, len(self.terms))

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and lines (see `Refinement.equations`)."""
        return (self.linearised(features, np.zeros(len(self.terms)))
                or super().equations(features))

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return the equations about a solution (k,) if lines are in parametric form.

        None if they are not, or if there are no lines: then the equations are linear already.
        """
        if not len(features.lines) or self.options.get("line_form") != "parametric":
            return None

        image, columns = self.known(features.lines.ground.reshape(-1, 3))
        A, b = line_equations(features, (image + columns @ coefficients).reshape(-1, 2, 2),
                              columns.reshape(-1, 2, 2, len(self.terms)))
        vector = super().equations(features)
        # Rows of points stay as they are; those of lines are replaced by the parametric form.
        points = slice(0, 2 * len(features.points))
        return Equations(np.concatenate([vector.A[points], A]),
                         np.concatenate([vector.b[points], b + A @ coefficients]), vector.feature)

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions, shape (..., n, 2): those of the RPC, corrected."""
        image, columns = self.known(ground)
        return np.asarray(image + np.einsum("nak,...k->...na", columns, coefficients))

    def as_rpc(self, coefficients: FloatArray) -> Rpc | None:
        """Return the RPC with the correction (k,); None if no RPC comes near it.

        It is exact unless one axis depends on the other, and their denominators differ.
        """
        # Offsets and scales take a shift and the effect of an axis on itself; numerators take that
        # of the other axis.
        assert self.scaling is not None
        values = dict(zip(self.terms, coefficients.tolist(), strict=True))
        constant = np.array([values[_name(axis, "1")] for axis in _AXES])
        linear = np.eye(2)
        for i, j in product(range(2), repeat=2):
            linear[i, j] += values.get(_name(_AXES[i], _AXES[j]), 0.0)
        rpc = self.rpc
        # Positions are scaled about the middle of the control, those of the RPC about its offset.
        middle = np.array(self.scaling.image_offset)
        offset = (middle + self.scaling.image_scale * constant
                  + linear @ (np.array(rpc.image_offset) - middle))
        refined = replace(rpc, image_offset=tuple(offset), error_bias=None)
        # [px] by a quotient of line or sample of 1.
        scale = linear * rpc.image_scale
        if not (linear * (1 - np.eye(2))).any():
            return replace(refined, image_scale=tuple(np.diag(scale)))
        if rpc.line_denominator != rpc.sample_denominator:
            return _absorb_denominators(rpc, linear, refined)
        # With one denominator, linear functions of both quotients are quotients, too.
        numerators = np.array([rpc.line_numerator, rpc.sample_numerator])
        line, sample = scale / np.array(rpc.image_scale)[:, None] @ numerators
        return replace(refined, line_numerator=tuple(line), sample_numerator=tuple(sample))


def _absorb_denominators(rpc: Rpc, linear: FloatArray, shifted: Rpc) -> Rpc | None:
    """Return an RPC with the denominators of `rpc` that has a linear function of its positions.

    `linear` (2, 2) multiplies the offsets from the middle of the image; `shifted` is `rpc` with the
    image offset of the function. Numerators are fitted over the image. None if the result differs
    by more than `_MAX_DIFFERENCE` somewhere in it, or if too little of it has ground positions.
    """
    half_size = np.array(rpc.image_scale)

    def grid_points(across: int) -> tuple[FloatArray, FloatArray]:
        """Return ground points (n, 3) of a grid over the image, and their image offsets (n, 2).

        The offsets are those after the linear function. The grid has `across` points along line,
        sample and height; those that the RPC cannot locate are left out.
        """
        steps = np.linspace(-1.0, 1.0, across)
        unit = np.stack([axis.ravel() for axis in np.meshgrid(steps, steps, steps)], axis=1)
        offsets = unit[:, :2] * half_size * (1.0 + _EDGE_MARGIN)
        ground = rpc.locate(offsets + rpc.image_offset,
                            unit[:, 2] * rpc.ground_scale[2] + rpc.ground_offset[2])
        is_finite = np.isfinite(ground).all(axis=1)
        return ground[is_finite], offsets[is_finite] @ linear.T

    ground, targets = grid_points(_GRID_SIZE)
    columns = _numerator_columns(rpc, ground)
    if len(ground) < 4 * len(columns.T):
        return None
    numerators = []
    for axis, denominator in enumerate((rpc.line_denominator, rpc.sample_denominator)):
        # P / D is linear in P: the columns are monomials divided by the denominator, in px.
        weights = half_size[axis] / (columns @ denominator)
        numerators.append(tuple(np.linalg.lstsq(
            columns * weights[:, None], targets[:, axis], rcond=None)[0]))
    refined = replace(shifted, line_numerator=numerators[0], sample_numerator=numerators[1])
    # It must agree between the points of the fit, too.
    between, targets_between = grid_points(_GRID_SIZE - 1)
    differences = np.abs(refined.project(between) - shifted.image_offset - targets_between)
    return refined if differences.size and differences.max() <= _MAX_DIFFERENCE else None


def _numerator_columns(rpc: Rpc, ground: FloatArray) -> FloatArray:
    """Return the 20 monomials of an RPC, (n, 20), at longitude, latitude and height (n, 3)."""
    constant = tuple(np.eye(1, 20)[0])
    # With a denominator of 1 the line is the numerator, here one monomial at a time.
    polynomial = replace(
        rpc, image_offset=(0.0, 0.0), image_scale=(1.0, 1.0), line_denominator=constant)
    columns = [replace(polynomial, line_numerator=tuple(row)).project(ground)[:, 0]
               for row in np.eye(20)]
    return np.stack(columns, axis=1)


def _name(axis: str, column: str) -> str:
    """Return the name of the bias of an axis in a column of the RPC."""
    return str(Term(axis, "bias", column))


def _rpc_from_record(text: str) -> tuple[Rpc, str]:
    """Return an RPC and the name of its file, or "that is given", from the JSON of a result.

    Raises TermselError if the text is no such RPC.
    """
    try:
        values: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value
                                  for name, value in json.loads(text).items()}
        # 0.2 wrote "file".
        file = str(values.pop("file", values.get("source", "")))
        return Rpc(**{**values, "source": file}), file or "that is given"
    except (AttributeError, RecursionError, TypeError, ValueError) as error:
        raise TermselError(f"option 'rpc' is not the RPC of a result: {error}",
                           hint="Give the file of an RPC with --set rpc=FILE.") from error


class RpcDrift(RpcShift):
    """Vendor's RPC with a shift and a drift along the lines: 4 terms.

    With (l, s) the RPC position of a ground point, image = (l + a0 + a1 l, s + b0 + b1 l): lines
    are imaged one after the other, so that a drift of attitude over time acts along the lines.

    References
    ----------
    As `rpc-shift`.
    """

    name = "rpc-drift"
    columns = ("1", "line")


class RpcAffine(RpcShift):
    """Vendor's RPC with an affine correction in the image: 6 terms.

    With (l, s) the RPC position of a ground point, image = (l + a0 + a1 l + a2 s, s + b0 + b1 l +
    b2 s).

    References
    ----------
    As `rpc-shift`.
    """

    name = "rpc-affine"
    columns = ("1", "line", "sample")
