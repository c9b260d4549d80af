"""The bias of an RPC by control lines, in vector and in parametric form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

import termsel
from termsel import FeatureSet, Fit, LeastSquares, Lines, Points, Rpc, read_rpc
from termsel.toolkit import make_scaling
from termsel_rpc import RpcShift
from termsel_rpc.simulated import DATASET_NAME, RPC_FILE

FloatArray = NDArray[np.float64]

SHIFT = np.array([5.0, -3.0])


def ground_of(rpc: Rpc, count: int, seed: int) -> FloatArray:
    unit = np.random.default_rng(seed).uniform(-0.9, 0.9, (count, 3))
    return np.asarray(unit * rpc.ground_scale + rpc.ground_offset)


def fit_of(model: RpcShift, control: FeatureSet) -> Fit:
    used = np.ones(len(control), dtype=bool)
    return LeastSquares().fit(model, control, make_scaling(control),
                              np.ones(len(model.terms), dtype=bool), used)


def measured_lines(length: float, seed: int) -> tuple[FeatureSet, Points]:
    """Return a shifted image's lines, measured to 0.5 px over that share of them, and points."""
    rpc, rng = read_rpc(RPC_FILE), np.random.default_rng(seed)
    first = ground_of(rpc, 40, seed)
    run = rng.uniform(-0.05, 0.05, (40, 3)) * rpc.ground_scale  # so short that none is bent
    vertices = np.stack([first, first + run], axis=1)
    share = rng.uniform(0, 1 - length, (40, 1, 1)) + np.array([0.0, length])[None, :, None]
    places = vertices[:, :1] + share * (vertices[:, 1:] - vertices[:, :1])
    image = (rpc.project(places.reshape(-1, 3)) + SHIFT).reshape(40, 2, 2)
    lines = Lines(tuple(f"L{i}" for i in range(40)),
                  image + 0.5 * rng.standard_normal(image.shape), vertices)
    others = ground_of(rpc, 50, 100 + seed)
    return FeatureSet(lines=lines, crs="EPSG:4979"), Points(
        tuple(map(str, range(50))), rpc.project(others) + SHIFT, others)


def test_the_parametric_form_is_that_of_unknown_places_along_each_line() -> None:
    # The same unknowns by another program: the shift, and the place of each measured end.
    control, _ = measured_lines(0.3, 1)
    rpc, lines = read_rpc(RPC_FILE), control.lines
    fitted = fit_of(RpcShift(rpc=DATASET_NAME, line_form="parametric"), control)

    def left(x: FloatArray) -> FloatArray:
        places = lines.ground[:, :1] + x[2:].reshape(-1, 2, 1) * (
            lines.ground[:, 1:] - lines.ground[:, :1])
        seen = rpc.project(places.reshape(-1, 3)) + x[:2]
        return (seen - lines.image.reshape(-1, 2)).ravel()

    best = least_squares(left, np.concatenate([np.zeros(2), np.full(80, 0.5)]),
                         x_scale="jac", xtol=1e-14, ftol=1e-14).x
    vertices = lines.ground.reshape(-1, 3)
    shift = (fitted.project(vertices) - rpc.project(vertices)).mean(axis=0)
    assert shift == pytest.approx(best[:2], abs=1e-3)


def test_short_measured_pieces_of_long_lines_ask_for_the_parametric_form() -> None:
    missed: dict[str, list[float]] = {form: [] for form in ("vector", "parametric")}
    for seed in range(12):
        control, others = measured_lines(0.05, seed)
        for form, found in missed.items():
            fitted = fit_of(RpcShift(rpc=DATASET_NAME, line_form=form), control)
            away = fitted.project(others.ground) - others.image
            found.append(float(np.sqrt((away**2).sum(axis=1).mean())))
    assert np.median(missed["parametric"]) < 0.5
    assert np.median(missed["parametric"]) < np.median(missed["vector"])


def test_a_search_takes_the_parametric_form() -> None:
    result = termsel.run("owdis-lines", model="rpc-shift", solver="swap", seed=1, evaluations=100,
                         features=with_roles(), options={"rpc": DATASET_NAME,
                                                         "line_form": "parametric"})
    assert result.options.model["line_form"] == "parametric"
    check = result.rmse["check"]
    assert check is not None
    assert check.total < 1.0


def with_roles() -> FeatureSet:
    """Return lines as control, and check points."""
    control, others = measured_lines(0.3, 2)
    points = Points(others.ids, others.image, others.ground, None, ("check",) * len(others))
    return FeatureSet(points, control.lines, "EPSG:4979")
