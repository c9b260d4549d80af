"""Terms as values: names there and back, their order, their parents."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import termsel
from termsel import Term
from termsel.models.terms import AXES
from termsel.plugins.registry import Registry, registry

powers = st.integers(0, 12)
monomials = st.builds(Term, st.sampled_from(AXES), st.sampled_from(["numerator", "denominator"]),
                      st.tuples(powers, powers, powers))


@pytest.mark.parametrize(("term", "name"), [
    (Term("line", "numerator", (2, 1, 0)), "line.num:X2Y"),
    (Term("sample", "denominator", (1, 1, 0)), "sample.den:XY"),
    (Term("both", "denominator", (0, 0, 1)), "den:Z"),
    (Term("line", "numerator", (0, 0, 0)), "line.num:1"),
    (Term("sample", "numerator", (0, 0, 12)), "sample.num:Z12"),
    (Term("line", "numerator", "17"), "line.num:17"),
    (Term("sample", "bias", "line"), "sample.bias:line"),
    (Term("both", "", "roll"), "roll"),
    (Term("line", "", (1, 0, 0)), "line.X")])
def test_a_term_and_its_name(term: Term, name: str) -> None:
    assert str(term) == name
    assert Term.parse(name) == term


@given(monomials)
def test_every_monomial_comes_back_from_its_name(term: Term) -> None:
    assert Term.parse(str(term)) == term
    assert len({str(term), str(term.shared)}) == (1 if term.axis == "both" else 2)


@given(st.text("XYZ0123:.numdeli ") | st.text())
def test_any_name_is_that_of_a_term(name: str) -> None:
    spelled_out = any(f"{part}:" in name for part in ("numerator", "denominator"))
    assert spelled_out or str(Term.parse(name)) == name


@given(monomials)
def test_order_and_parents_are_those_of_the_monomial(term: Term) -> None:
    assert term.order == sum(term.exponents)
    divisors = [e for e in product(*(range(power + 1) for power in term.exponents))
                if sum(e) == term.order - 1]
    assert sorted(parent.exponents for parent in term.parents) == sorted(divisors)
    assert all((parent.axis, parent.part) == (term.axis, term.part) for parent in term.parents)


@pytest.mark.parametrize("label", ["", "3", "X1", "X0", "YX", "XX", "x", "X-2", "10", "line",
                                   "X2 ", "\n"])
def test_what_is_no_monomial_is_a_label_without_order_or_parents(label: str) -> None:
    term = Term("line", "numerator", label)
    assert (term.exponents, term.column, term.order, term.parents) == (label, label, 0, ())


def test_terms_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="axis 'row' of a term is not one of line, sample, both"):
        Term("row", "numerator", (1, 0, 0))
    for exponents in ((1, 0), (1, 0, -1)):
        with pytest.raises(ValueError, match="not three numbers >= 0"):
            Term("line", "numerator", exponents)  # type: ignore[arg-type]  # what is refused


# The terms cos and sin of helmert2d switch X and Y together.
@pytest.mark.parametrize("entry", [entry for entry in Registry([]).entries("models")
                                   if entry.name != "helmert2d"],
                         ids=lambda entry: entry.name)
def test_built_in_models_name_monomials(entry) -> None:
    model = entry.object()
    terms = [Term.parse(name) for name in model.terms]
    assert [AXES.index(term.axis) for term in terms] == model.axis.tolist()
    assert all(isinstance(term.exponents, tuple) for term in terms)
    assert not any(term.is_denominator and term.order == 0 for term in terms)


class Numbered(termsel.RationalModel):
    """Columns that have no names."""

    name = "numbered-demo"

    def blocks(self, ground: np.ndarray) -> termsel.Blocks:
        one = np.column_stack([np.ones(len(ground)), ground])
        return termsel.Blocks(line=one, sample=one, shared_denominator=ground)


def test_numbered_columns_keep_their_names() -> None:
    assert Numbered().terms == (
        *(f"line.num:{i}" for i in range(4)), *(f"sample.num:{i}" for i in range(4)),
        *(f"den:{i}" for i in range(3)))


class Own(termsel.SensorModel):
    """An affine model that defines its terms as text alone, as plugins do."""

    name = "own-demo"
    terms = ("line.row:1", "line.row:X", "line.row:Y", "line.row:XY", "sample.row:1",
             "sample.row:X", "sample.row:Y", "sample.row:XY")
    axis = np.repeat([0, 1], 4)

    def _columns(self, ground: np.ndarray) -> np.ndarray:
        x, y = ground[:, 0], ground[:, 1]
        columns = np.column_stack([np.ones(len(x)), x, y, x * y])
        return np.einsum("ab,nc->nabc", np.eye(2), columns).reshape(len(x), 2, 8)

    def equations(self, features: termsel.FeatureSet) -> termsel.Equations:
        return termsel.image_equations(
            features, self._columns(features.points.ground),
            self._columns(features.lines.ground.reshape(-1, 3)))

    def project(self, coefficients: np.ndarray, ground: np.ndarray) -> np.ndarray:
        return np.einsum("nak,...k->...na", self._columns(ground), coefficients)


def test_names_of_a_plugin_have_a_hierarchy_and_shared_genes() -> None:
    scene = termsel.prepare("poly-terms")
    task = scene.problem.inputs
    inputs = termsel.ProblemData(Own(), task.control, task.check, task.pixels, task.criterion,
                            {"hierarchy": True, "force_on": "XY"})
    each = termsel.SelectionProblem(inputs, terms=True, features=False)
    assert each.decode(each.genome.on[None]).terms == ("line.row:XY", "sample.row:XY")
    lacking = np.array([name.endswith((":1", ":XY")) for name in Own.terms])
    assert each.evaluate(lacking[None]).violation == 4  # X and Y, of line and of sample
    shared = termsel.SelectionProblem(inputs, terms=True, features=False, mask="shared")
    assert shared.genome.labels == ("row:1", "row:X", "row:Y", "row:XY")


@pytest.mark.parametrize(("name", "options", "degree"), [
    ("poly2d", {"degree": 3}, 3), ("poly3d", {"degree": 2}, 2), ("affine", {}, 1),
    ("poly3d-by-axis", {"degree": 4}, 4), ("rfm", {}, None), ("dlt3d", {}, None)])
def test_the_degree_of_a_polynomial(name: str, options: dict, degree: int | None) -> None:
    assert registry().get("models", name)(**options).polynomial_degree == degree


def test_the_double_sum_of_the_papers() -> None:
    """Valadan Zoej et al. 2002, eq. 6, in its order."""
    model = termsel.Polynomial2D(degree=2, powers="each")
    names = [name.split(":")[1] for name in model.terms if name.startswith("line")]
    assert names == ["1", "X", "Y", "XY", "X2", "Y2", "X2Y", "XY2", "X2Y2"]
    assert len(termsel.Polynomial2D(degree=3, powers="each").terms) == 2 * 16
    assert len(termsel.Polynomial2D(degree=4).terms) == 2 * 15
