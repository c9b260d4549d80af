"""How accurate a block can be at best, and six points can: the bound that no method is below.

With the variances of all errors known, unknowns and errors are normal and the posterior covariance
is the smallest mean square error there is (the Bayesian bound of Cramér and Rao, Van Trees 1968).
The block of simulated RPCs is linearised at the truth. Vendors' errors are a shift and a drift with
the standard deviations that were drawn; heights are those of a level ground, or of the DEM, with
their own roughness.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from termsel import Points, open_dem
from termsel_block.estimation.common import height_equations
from termsel_block.estimation.equations import TieRows, image_pairs, solve
from termsel_block.geometry.cameras import RpcCamera, groups_of
from termsel_block.geometry.frame import FloatArray
from termsel_block.geometry.heights import ControlHeights
from termsel_block.joint import BlockResult, heights_of
from termsel_block.simulated import Simulated

_UNSEEN = 1e4  # m


@dataclass(frozen=True)
class Bound:
    """RMSE [px] of points of an image, their noise included: by the block, and by six points."""

    block: float
    six: float


def bounds(simulated: Simulated, result: BlockResult, bias: float, drift: float, noise: float,
           own: dict[int, Points], judging: dict[int, Points]) -> dict[int, Bound]:
    """Return the bound of each image that has points of its own and check points."""
    block, frame = simulated.block, result.frame
    places, ties = frame.local(simulated.ties), block.ties
    spread = np.array([max(bias, 1e-3), max(drift, 1e-3)])
    seen, normal, right, cameras = [], [], [], []
    for i, image in enumerate(block.images):
        assert image.rpc is not None
        camera = RpcCamera(image.rpc, frame, groups_of("drift"))
        cameras.append(camera)
        tie = ties.tie[ties.image == i]
        zero = np.zeros(4)
        at = camera.project(zero, places[tie])
        seen.append(TieRows(tie, camera.jacobian(zero, places[tie]),
                            camera.slopes(zero, places[tie], at), np.zeros((len(tie), 2)),
                            np.full(len(tie), noise**-2)))
        known = result.control[i]
        columns = camera.first_order(known.local)[1]
        rows = (known.normal[:, :, None] * columns[:, None]).reshape(len(known), 4)
        normal.append(np.diag(np.tile(spread**-2, 2)) + rows.T @ rows / noise**2)
        right.append(np.zeros(4))
    with open_dem(block.dem, block.crs) if block.dem else nullcontext() as dem:
        ground = heights_of(block, frame, dem)
        # Ties and control lie at random, so that each height counts, as the adjustment dares not.
        known, rough = len(ground.control_heights.over), result.adjusted.roughness
        ground = replace(ground, sigma=rough, crowd=1.0, control_heights=ControlHeights())
        heights, of_offset, aim, of_ties, aim_of_ties = height_equations(ground, places)
        of_offset[0, 0] += known / rough**2
    solved = solve([*seen, heights], [*normal, of_offset], [*right, aim],
                   of_ties + np.eye(3) * _UNSEEN**-2, aim_of_ties,
                   image_pairs([part.tie for part in [*seen, heights]], len(places)))
    found = {}
    for i, points in own.items():
        columns = cameras[i].first_order(frame.local(judging[i].ground))[1]
        few = cameras[i].first_order(frame.local(points.ground))[1]
        alone = np.linalg.inv(np.diag(spread**-2) + few.T @ few / noise**2)
        found[i] = Bound(_rmse(columns, solved.image_covariances[i], noise),
                         _rmse(columns, np.kron(np.eye(2), alone), noise))
    return found


def _rmse(columns: FloatArray, covariance: FloatArray, noise: float) -> float:
    """Return the RMSE [px] of measured points whose model has parameters of a covariance."""
    m = columns.shape[1]
    square = sum(np.einsum("ni,ij,nj->n", columns, covariance[a * m:a * m + m, a * m:a * m + m],
                           columns) for a in range(2))
    return float(np.sqrt(np.mean(square) + 2 * noise**2))
