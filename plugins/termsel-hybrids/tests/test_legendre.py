"""Rational functions of Legendre polynomials: their columns, and what they have in common with rfm.
"""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel.testing import Check, checks
from termsel_hybrids import RationalLegendre

ORDERS = [{"order": 3}, {"order": 2, "denominators": "shared", "ridge": 0.0},
          {"order": 2, "denominators": "none"}]


@pytest.mark.parametrize("check", checks(RationalLegendre, options=ORDERS),
                         ids=lambda one: one.name)
def test_conforms(check: Check) -> None:
    check.run()


def test_columns_are_orthogonal_over_the_interval_and_have_their_names() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(4)  # exact up to degree 7
    grid = np.stack([axis.ravel() for axis in np.meshgrid(nodes, nodes, nodes)], axis=1)
    volume = np.prod(np.meshgrid(weights, weights, weights), axis=0).ravel()
    model = RationalLegendre(order=3)
    columns = model.blocks(grid).line
    gram = columns.T @ (volume[:, None] * columns)
    assert gram == pytest.approx(np.diag(np.diag(gram)), abs=1e-12)
    x, y, z = grid.T
    place = {name.removeprefix("line.num:"): i for i, name in enumerate(model.terms[:20])}
    assert columns[:, place["X2Y"]] == pytest.approx((1.5 * x**2 - 0.5) * y)
    assert columns[:, place["Z3"]] == pytest.approx(2.5 * z**3 - 1.5 * z)


def test_polynomials_of_all_terms_are_those_of_monomials() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    points = scene.points
    options = {"order": 2, "denominators": "none"}
    mine, plain = (termsel.fit(scene, model(**options)).project(points.ground)
                   for model in (RationalLegendre, termsel.RationalFunctions))
    assert mine == pytest.approx(plain, abs=1e-6)


def test_a_search_takes_it_and_its_rpc_is_the_model() -> None:
    result = termsel.run("rfm-terms", model="rfm-legendre", options={"order": 2},
                         solver="swap", seed=1, evaluations=400)
    points = result.features.points
    rpc = result.to_rpc()
    seen = result.project(points.ground)
    assert np.abs(rpc.project(points.ground) - seen).max() < 0.1
