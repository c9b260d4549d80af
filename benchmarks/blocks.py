"""Blocks of several images: accuracy, standard deviations and time, against the truth.

``python -m benchmarks.blocks --write`` makes docs/evidence/blocks.md. Blocks are those of
`termsel_block.simulated`; `--seeds` says how many of each kind. With `--kinds` it renews the rows
of these alone, and the text after the tables.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import block_rival
from benchmarks.block_bounds import bounds
from benchmarks.block_kinds import KINDS, OWN, Kind, drawn
from benchmarks.block_page import PAGE, VERDICT
from benchmarks.block_rival import fitted
from benchmarks.sets import ROOT, put
from termsel import Points, rpc_of, write_rpc
from termsel.core.threads import one_blas_thread
from termsel_block.accuracy import independent_points, predicted_errors, rms_length
from termsel_block.block import Block
from termsel_block.files.folders import image_result
from termsel_block.geometry.frame import FloatArray
from termsel_block.joint import BlockResult, adjust, heights_of
from termsel_block.shown.record import record_of, times_seen
from termsel_block.simulated import Simulated, simulate_block

SEED = 300
"""The first of the seeds, none of which took part in choosing a constant."""

_SINGLE = 6  # images of a block that are fitted alone, too: each takes seconds


@dataclass(frozen=True)
class Figures:
    """Figures of the images of one block; ratios are to the fit of the image alone."""

    without: tuple[float, ...]
    own: tuple[float, ...]
    ratio_without: tuple[float, ...]
    ratio_own: tuple[float, ...]
    bound_without: tuple[float, ...]
    bound_own: tuple[float, ...]
    to_bound: tuple[float, ...]
    inside: tuple[bool, ...]
    chi_square: float
    sigma_control: float
    seconds: float


@one_blas_thread
def figures_of(kind: Kind, seed: int) -> Figures:
    """Return the figures of a block. Its check points are not those that an image alone takes."""
    with drawn(kind, seed) as (simulated, block, bias, sigma):
        start = time.process_time()
        result = adjust(block)
        seconds = time.process_time() - start
        rng, inside = np.random.default_rng([seed, 9]), []
        six: dict[int, Points] = {}
        judging: dict[int, Points] = {}
        errors, limit = {}, {}
        for i in range(kind.images):
            points = independent_points(result, i)
            assert points is not None
            order = rng.permutation(len(points))
            judging[i] = points.take(order[OWN:])
            errors[i] = rms_length(judging[i].image - result.project(i, judging[i].ground))
            expected = predicted_errors(result, i)
            inside.append(expected.low <= errors[i] <= expected.high)
            six[i] = points.take(order[:OWN])
            if len(result.control[i]) == 2 * OWN:
                six[i] = _control(result, i)
        if kind.rpcs and kind.without_rpc is None:
            limit = bounds(simulated, result, bias, kind.drift, sigma, six, judging)
        covariance = result.adjusted.solved.covariance_of_ties()
    ratios: dict[bool, list[float]] = {True: [], False: []}
    ends: dict[bool, list[float]] = {True: [], False: []}
    for i in range(kind.images):
        has = len(result.control[i]) > 0
        if len(result.control[i]) not in (0, 2 * OWN):
            continue
        if i in limit:
            ends[has].append(limit[i].block / limit[i].six)
        if len(ratios[has]) < _SINGLE // 2:
            ratios[has].append(errors[i] / _alone(block, i, six[i], judging[i]))
    away = result.adjusted.state.ties - result.frame.local(simulated.ties)
    seen = times_seen(result) > 1
    chi = np.einsum("ti,tij,tj->t", away[seen], np.linalg.inv(covariance[seen]), away[seen])
    with_own = [len(known) > 0 for known in result.control]
    return Figures(
        tuple(errors[i] for i in errors if not with_own[i]),
        tuple(errors[i] for i in errors if with_own[i]), tuple(ratios[False]), tuple(ratios[True]),
        tuple(ends[False]), tuple(ends[True]), tuple(errors[i] / limit[i].block for i in limit),
        tuple(inside), float(chi.mean()) / 3, (sigma / result.adjusted.state.sigma_control) ** 2,
        seconds)


def _control(result: BlockResult, i: int) -> Points:
    """Return the control of an image."""
    features = result.block.images[i].features
    assert features is not None
    return features.points.take([role == "control" for role in features.points.roles])


def _alone(block: Block, i: int, points: Points, judging: Points) -> float:
    """Return the RMSE [px] of an image by its own points and the strategy auto."""
    return rms_length(np.asarray(fitted(block, i, points).errors(judging)))


def injected(seed: int) -> tuple[float, float]:
    """Return how far an injected shift and drift are missed, and GDAL misses the result [px]."""
    simulated = simulate_block(2, rpcs=True, control=(8, 8), bias=0.0, drift=0.0, noise=0.02,
                               seed=seed, independent=100)
    block = moved(simulated)
    result = adjust(block)
    points = independent_points(result, 1)
    assert points is not None
    image = simulated.block.images[1]
    assert image.rpc is not None
    at = image.rpc.project(points.ground)
    missed = result.project(1, points.ground) - at - _injection(at, simulated)
    refined = image_result(result, 1, record_of(result)).fit
    return float(np.hypot(*missed.T).max()), _by_gdal(rpc_of(refined).rpc, points.ground,
                                                      refined.project(points.ground))


def _injection(image: FloatArray, simulated: Simulated) -> FloatArray:
    rpc = simulated.block.images[1].rpc
    assert rpc is not None
    lines = (image[:, :1] - rpc.image_offset[0]) / abs(rpc.image_scale[0])
    return np.array([12.3, -7.1]) + lines * np.array([3.0, -2.0])


def moved(simulated: Simulated) -> Block:
    """Return the block with all measurements in the second image moved by a shift and a drift."""
    block, second = simulated.block, simulated.block.ties.image == 1
    place = block.ties.position.copy()
    place[second] += _injection(place[second], simulated)
    image = block.images[1]
    assert image.features is not None
    points = image.features.points
    points = replace(points, image=points.image + _injection(points.image, simulated))
    return replace(block, ties=replace(block.ties, position=place), images=(
        block.images[0], replace(image, features=replace(image.features, points=points))))


def _by_gdal(rpc: object, ground: FloatArray, expected: FloatArray) -> float:
    """Return the largest difference [px] to GDAL's transformer by the written RPC."""
    from rasterio.rpc import RPC
    from rasterio.transform import RPCTransformer

    from termsel import read_rpc

    with TemporaryDirectory() as folder:
        write_rpc(rpc, Path(folder) / "refined.RPB")  # type: ignore[arg-type]
        one = read_rpc(Path(folder) / "refined.RPB")
    tags = {"LINE_OFF": one.image_offset[0], "SAMP_OFF": one.image_offset[1],
            "LINE_SCALE": one.image_scale[0], "SAMP_SCALE": one.image_scale[1]}
    for number, name in enumerate(("LONG", "LAT", "HEIGHT")):
        tags[f"{name}_OFF"] = one.ground_offset[number]
        tags[f"{name}_SCALE"] = one.ground_scale[number]
    text = {name: repr(float(value)) for name, value in tags.items()}
    for name, values in (("LINE_NUM", one.line_numerator), ("LINE_DEN", one.line_denominator),
                         ("SAMP_NUM", one.sample_numerator), ("SAMP_DEN", one.sample_denominator)):
        text[f"{name}_COEFF"] = " ".join(repr(float(value)) for value in values)
    with RPCTransformer(RPC.from_gdal(text)) as transformer:
        lines, samples = transformer.rowcol(*ground.T, op=float)
    # GDAL counts from the corner of the first pixel, RPCs from its middle.
    return float(np.abs(np.column_stack([lines, samples]) - 0.5 - expected).max())


def row(kind: Kind, found: list[Figures]) -> str:
    """Return a row of the table."""
    def every(name: str) -> FloatArray:
        return np.array([value for one in found for value in getattr(one, name)])

    def cell(values: FloatArray, most: bool = False) -> str:
        if not len(values):
            return ""
        return f"{np.median(values):.2f}" + (f" ({values.max():.2f})" if most else "")

    def end(name: str) -> str:
        return cell(every(name))
    to_bound = every("to_bound")
    near = f"{np.sqrt((to_bound**2).mean()):.2f}" if len(to_bound) else ""
    return (f"| {kind.name} | {len(found)} | {cell(every('without'))} | {cell(every('own'))} "
            f"| {end('bound_without')} | {cell(every('ratio_without'), True)} "
            f"| {end('bound_own')} | {cell(every('ratio_own'), True)} | {near} "
            f"| {np.mean([one.chi_square for one in found]):.2f} "
            f"| {np.mean([one.sigma_control for one in found]):.2f} "
            f"| {every('inside').mean():.0%} | {np.median([one.seconds for one in found]):.1f} |")


HEAD = """| block | blocks | px without control | px with control | without over six own: bound \
| reached | with over alone: bound | reached | RMSE to bound | chi-square, ties \
| chi-square, control | in 90 % | s |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""


def grown(counts: Iterable[int], n_ties: int) -> str:
    """Return rows of time and memory by the number of images."""
    import resource

    rows = ["| images | measurements of ties | s of CPU | ms a measurement | peak memory [GiB] |",
            "|---:|---:|---:|---:|---:|"]
    for n in counts:
        simulated = simulate_block(n, n_ties=n_ties, control=(6, *(0,) * 29) * (n // 30 + 1),
                                   rpcs=True, independent=1, seed=SEED)
        start = time.process_time()
        adjust(simulated.block)
        seconds = time.process_time() - start
        measured = len(simulated.block.ties.tie)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        rows.append(f"| {n} | {measured} | {seconds:.1f} | {1000 * seconds / measured:.2f} "
                    f"| {peak:.1f} |")
    return "\n".join(rows)


def by_scipy() -> str:
    """Return the times and the largest difference [px] to scipy.optimize.least_squares."""
    from scipy.optimize import least_squares
    from scipy.sparse import coo_matrix

    block = simulate_block(12, n_ties=200, control=(6,), rpcs=True, independent=1, seed=SEED).block
    block = replace(block, images=tuple(replace(one, model="affine") for one in block.images))
    start = time.process_time()
    result = adjust(block)
    ours = time.process_time() - start
    state, known, ties = result.adjusted.state, result.control, block.ties
    n, count = len(block.images), len(state.ties)
    rows, columns, first = [], [], 0
    spread = np.sqrt(np.concatenate(state.variances))
    sizes = [one.size for one in state.parameters]
    begin = np.cumsum([0, *sizes])
    for i in range(n):
        mine = ties.tie[ties.image == i]
        for height, places in ((2 * len(mine), np.repeat(mine, 2)), (len(known[i]), None)):
            at = first + np.arange(height)
            rows.append(np.repeat(at, sizes[i]))
            columns.append(np.tile(np.arange(begin[i], begin[i + 1]), height))
            if places is not None:
                rows.append(np.repeat(at, 3))
                columns.append((begin[-1] + 3 * places[:, None] + np.arange(3)).ravel())
            first += height
    rows.append(first + np.arange(begin[-1]))
    columns.append(np.arange(begin[-1]))
    # Heights as our adjustment has them at its end.
    ground = heights_of(block, result.frame, None)
    ground.offset, ground.sigma = result.adjusted.offset, result.adjusted.roughness
    rows.append(first + begin[-1] + np.repeat(np.arange(count), 3))
    columns.append(begin[-1] + np.arange(3 * count))
    row, column = np.concatenate(rows), np.concatenate(columns)
    shape = (first + begin[-1] + count, begin[-1] + 3 * count)
    sparsity = coo_matrix((np.ones(len(row)), (row, column)), shape=shape)

    def residuals(unknown: FloatArray) -> FloatArray:
        places = unknown[begin[-1]:].reshape(-1, 3)
        out = []
        for i in range(n):
            camera, own = state.cameras[i], unknown[begin[i]:begin[i + 1]]
            at = ties.image == i
            out.append(((ties.position[at] - camera.project(own, places[ties.tie[at]]))
                        / state.sigma_ties).ravel())
            if len(known[i]):
                computed = camera.project(own, known[i].local)
                out.append((known[i].value - (known[i].normal * computed).sum(axis=1))
                           / (state.sigma_control * known[i].sigma))
        seen = ground.tie_observations(places)
        return np.concatenate([*out, unknown[:begin[-1]] / spread,
                               np.sqrt(seen.weight) * seen.away])

    places = state.ties + np.random.default_rng(0).normal(0, 20, state.ties.shape)
    at = np.concatenate([np.zeros(begin[-1]), places.ravel()])
    start = time.process_time()
    found = least_squares(residuals, at, jac_sparsity=sparsity, x_scale="jac", method="trf",
                          max_nfev=200, ftol=1e-13, xtol=1e-13, gtol=1e-13)
    theirs = time.process_time() - start
    gap = max(float(np.abs(state.cameras[i].project(
        found.x[begin[i]:begin[i + 1]], known[0].local)
        - state.cameras[i].project(state.parameters[i], known[0].local)).max()) for i in range(n))
    ended = "it converges" if found.status > 0 else "it has not converged by then"
    return (f"On 12 images with {len(ties.tie)} measurements of ties the whole adjustment takes\n"
            f"{ours:.1f} s of CPU, with variances, weights and blunders. scipy's least_squares\n"
            f"(jac_sparsity, method trf) takes {theirs:.1f} s for {found.nfev} evaluations of the "
            f"plain\nleast squares with these variances; {ended}. At the control of the first\n"
            f"stack the images differ by {gap:.2f} px at most.")


def renewed(page: str, rows: Iterable[str]) -> str:
    """Return the page with these rows of the table of accuracy, and the verdict of today."""
    tables, heading, _ = page.partition(VERDICT.partition("\n")[0])
    lines = tables.splitlines()
    for one in rows:
        name = one.split("|")[1].strip()
        at = next(k for k, line in enumerate(lines) if line.startswith(f"| {name} |"))
        lines[at] = one
    assert heading
    return "\n".join([*lines, VERDICT])


def main() -> None:
    """Print or write the page, or rows of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--counts", type=int, nargs="*", default=[100, 300, 1000])
    parser.add_argument("--ties", type=int, default=1100)
    parser.add_argument("--kinds", nargs="*", help="kinds to renew; by default the whole page")
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    asked = parser.parse_args()
    rows = [HEAD]
    for kind in KINDS:
        if not asked.kinds or kind.name in asked.kinds:
            rows.append(row(kind, [figures_of(kind, SEED + seed) for seed in range(
                max(round(asked.seeds * kind.seeds), 1))]))
            print(rows[-1], flush=True)
    if asked.kinds:
        if asked.write:
            page = (ROOT / "docs" / "evidence" / "blocks.md").read_text(encoding="utf-8")
            put("blocks", renewed(page, rows[1:]), write=True)
        return
    plain = [block_rival.HEAD, *(
        block_rival.row(kind, [SEED + 50 + seed for seed in range(asked.seeds // 2)])
        for kind in KINDS if kind.name in block_rival.NAMES)]
    missed, gdal = np.max([injected(SEED + seed) for seed in range(3)], axis=0)
    put("blocks", PAGE.format(
        seeds=asked.seeds, table="\n".join(rows), plain="\n".join(plain), missed=missed, gdal=gdal,
        scipy=by_scipy(), scale=grown(asked.counts, asked.ties), verdict=VERDICT),
        write=asked.write)


if __name__ == "__main__":
    main()
