"""Refinement of a vendor's RPC or rigorous model by selected control points, as a plugin.

References
----------
Konugurthi, Kune, Nooka, Sarma 2016: Autonomous ortho-rectification of very high resolution
imagery using SIFT and genetic algorithm. PE&RS 82(5), 377-388.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING

from termsel import DatasetSpec, hookimpl
from termsel.simulate import kept_features
from termsel_rpc.correction import CORRECTIONS
from termsel_rpc.image_space import RpcAffine, RpcDrift, RpcShift
from termsel_rpc.jitter import CANDIDATE as JITTERED
from termsel_rpc.jitter import RpcJitter
from termsel_rpc.konugurthi import RECIPE as KONUGURTHI
from termsel_rpc.konugurthi import E50PerArea
from termsel_rpc.local import CANDIDATE as LOCAL
from termsel_rpc.local import RpcField
from termsel_rpc.problem import RECIPE, Ce90
from termsel_rpc.rigorous import PushbroomRefine
from termsel_rpc.simulated import DATASET_NAME, MATCHES, simulate_candidates, simulate_matches

if TYPE_CHECKING:
    from termsel import Criterion, Method, Recipe, SensorModel

__all__ = ["Ce90", "E50PerArea", "PushbroomRefine", "RpcAffine", "RpcDrift",
           "RpcField", "RpcJitter", "RpcShift", "simulate_candidates", "simulate_matches"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the models of this package."""
    return [RpcShift, RpcDrift, RpcAffine, RpcJitter, RpcField, PushbroomRefine]


@hookimpl
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return the circular error, and the median error by the covered area."""
    return [Ce90, E50PerArea]


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the selection of m of n control points, and a paper's set-up of it."""
    return [RECIPE, KONUGURTHI]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the corrections of an RPC that features have."""
    return [*CORRECTIONS, LOCAL, JITTERED]


@hookimpl
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return the simulated data sets of this package: candidates for control, some of them wrong.
    """
    return [DatasetSpec(
        DATASET_NAME, "simulated IKONOS scene of Hamedan, 1 m: 240 points; of 160 for control and "
        "check 40 are inexact and 24 blunders (after Konugurthi et al. "
        "2016)", partial(kept_features, "termsel_rpc", DATASET_NAME),
        simulated=True), DatasetSpec(
        MATCHES, "simulated Cartosat-1 scene, 2.5 m: 100 points of image matching, 30 of them "
                 "wrong (after Konugurthi et al. 2016); 100 independent ones",
        partial(kept_features, "termsel_rpc", MATCHES),
        simulated=True)]
