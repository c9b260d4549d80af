"""What a block is adjusted from and for: measurements, unknowns, and the outcome."""

from __future__ import annotations

from dataclasses import dataclass, field

from termsel_block.estimation.equations import Solved
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.frame import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Measured:
    """The ties that are seen in one image.

    Parameters
    ----------
    tie : ndarray of int, shape (n,)
        Index of each among all ties of the block.
    position : ndarray, shape (n, 2)
        Its line and sample [px].
    """

    tie: IntArray
    position: FloatArray


@dataclass(eq=False)
class BlockUnknowns:
    """The unknowns of a block, and variances, while steps change them.

    Parameters
    ----------
    cameras : list of Camera
        One for each image.
    parameters : list of ndarray, shape (p,)
        Parameters of each image's camera, in standard deviations of their priors.
    ties : ndarray, shape (t, 3)
        Positions of the ties in the frame [m].
    variances : list of ndarray, shape (p,)
        Variances of the priors of the parameters of each image.
    sigma_ties : float
        Standard deviation of a tie's line or sample [px].
    sigma_control : float
        Factor of the stated standard deviations of control.
    freedom_control : float
        From how many measurements that factor is known.
    in_use, control_in_use : list of ndarray of bool
        Which ties (n,) and which control rows (k,) of each image are in the adjustment.
    """

    cameras: list[Camera]
    parameters: list[FloatArray]
    ties: FloatArray
    variances: list[FloatArray]
    sigma_ties: float = 1.0
    sigma_control: float = 1.0
    freedom_control: float = 4.0
    in_use: list[BoolArray] = field(default_factory=list)
    control_in_use: list[BoolArray] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A block as adjusted.

    Parameters
    ----------
    state : State
    solved : Solved
        The last normal equations, with what is needed for covariances.
    residuals : list of ndarray, shape (n, 2)
        Residuals of the ties of each image, measured minus computed [px].
    of_control : list of ndarray, shape (k,)
        Residuals of the rows of each image's control [px].
    evidence : list of dict
        For each image, the logarithm of the Bayes factor of each group of columns that was weighed.
    steps : int
    converged : bool
    offset, roughness : float
        How far heights are off the surface as a whole, and each by itself [m].
    freedom : float
        Redundancy: measurements less the unknowns that they determine.
    moved : ndarray, shape (images,)
        How far the last step moved each image, at most [px].
    by_priors : list of (ndarray, ndarray)
        Parameters of each image and their covariance with priors as stated and estimated.
    score : dict
        Logarithm of the density of each feature of control, by number of the image and name, as
        predicted by all others and by priors as stated; empty where no model states any.
    draws : list of ndarray, shape (d, p)
        Of the errors of each image's parameters, with variances unknown; empty where these are
        taken as estimated.
    """

    state: BlockUnknowns
    solved: Solved
    residuals: list[FloatArray]
    of_control: list[FloatArray]
    evidence: list[dict[str, float]]
    steps: int
    converged: bool
    offset: float
    roughness: float
    freedom: float
    moved: FloatArray
    by_priors: list[tuple[FloatArray, FloatArray]]
    score: dict[tuple[int, str], float] = field(default_factory=dict)
    draws: list[FloatArray] = field(default_factory=list)
