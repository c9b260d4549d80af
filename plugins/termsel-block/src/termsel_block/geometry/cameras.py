"""What each image's model is in a block: a known part, and a few columns that correct it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import product
from types import MappingProxyType

import numpy as np

from termsel import Rpc
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame

_GROUND_STEP = 1.0
"""Metres on the ground over which derivatives are taken."""

DISTANCE = 700e3
"""Metres from an imaging satellite to its ground: most are 450 to 900 km away."""

_EARTH_RADIUS = 6371e3
"""Radius of the Earth [m]."""

_DISTANCE_SPREAD = 0.3
"""Relative standard deviation of that distance."""

_MIN_QUADRATIC = 0.0002
"""Terms of degree 2 of the straightest images, in half images: of ten real ones whose vendors' RPCs
were at hand they are 0.0001 to 0.0019 (root mean squares), 0.0007 in the middle."""

_WAVES = 16
"""Half waves of jitter along an image at most: ties seldom lie closer than 30 to an image."""

EXPONENTS = tuple(sorted((p for p in product(range(4), repeat=3) if sum(p) + p[2] <= 3),
                         key=lambda p: (sum(p), p)))
"""Exponents of x, y and z: cubic on the plane, heights by themselves and with x and y."""

_AXES = (1, 0, 0), (0, 1, 0), (0, 0, 1)

_AFFINE, _QUADRATIC, _CUBIC, _RELIEF = "affine", "quadratic", "cubic", "relief"


Fixed = tuple[FloatArray, FloatArray] | None
"""What no parameter changes at some places: known part (n, 2) [px] and columns (n, m), if any."""


class Camera(ABC):
    """What line and sample of places are in one image, by p parameters with a prior.

    Parameters belong to groups, such as "shift" or "degree 2", which the evidence keeps or drops
    together. Their prior is normal about zero.

    Attributes
    ----------
    groups : tuple of str
        Group of each parameter.
    prior_sigma : tuple of float
        Prior standard deviation of each parameter to begin with.
    min_sigma : tuple of float
        The least that evidence may make of it: what all images have in common ties cannot show.
    permanent : frozenset of str
        Groups that no evidence can drop.
    fixed_variance : frozenset of str
        Groups among these whose variance is not estimated.
    nested : bool
        Whether a group makes sense only with all before it.
    scales : tuple of str
        Of each parameter: those of one scale share a standard deviation while variances are
        unknown.
    stated_terms : mapping
        Parameters whose prior is what a model says of its terms: name and index.
    sigma_factors : ndarray, shape (p,)
        What the standard deviation of each parameter is times what the model states.
    """

    groups: tuple[str, ...]
    prior_sigma: tuple[float, ...]
    min_sigma: tuple[float, ...]
    permanent: frozenset[str] = frozenset()
    fixed_variance: frozenset[str] = frozenset()
    nested = False
    stated_terms: Mapping[str, int] = MappingProxyType({})
    sigma_factors: FloatArray

    @property
    def scales(self) -> tuple[str, ...]:
        """The name of each parameter's scale."""
        return self.groups

    @abstractmethod
    def with_parameters(self, keep: BoolArray) -> Camera:
        """Return the camera with those of its parameters that are true in the mask `keep` (p,)."""

    def fixed(self, local: FloatArray) -> Fixed:
        """Return the part of the model at positions (n, 3) that does not depend on parameters.

        `project` and `jacobian` take it, so that it is computed once. None if there is none.
        """
        return None

    @abstractmethod
    def project(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None) -> FloatArray:
        """Return line and sample (n, 2) [px] of places of the frame (n, 3), by parameters (p,)."""

    @abstractmethod
    def jacobian(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None,
                 ) -> FloatArray:
        """Return the derivatives (n, 2, p) of line and sample by the parameters."""

    def slopes(self, parameters: FloatArray, local: FloatArray, image: FloatArray) -> FloatArray:
        """Return the derivatives (n, 2, 3) [px/m] of line and sample by the position.

        They are at `local` (n, 3), of which `image` (n, 2) are the line and sample.
        """
        slopes = np.empty((len(local), 2, 3))
        for axis in range(3):
            shifted = local.copy()
            shifted[:, axis] += _GROUND_STEP
            slopes[:, :, axis] = (self.project(parameters, shifted) - image) / _GROUND_STEP
        return slopes

    def parameters_after_step(self, parameters: FloatArray, step: FloatArray, aim: FloatArray,
                              local: FloatArray) -> FloatArray:
        """Return parameters (p,) after a step (p,).

        To first order the step moves the images of `local` (n, 3) to `aim` (n, 2), which cameras
        that are not linear may use to correct it.
        """
        return np.asarray(parameters + step)

    def with_priors(self, factors: Mapping[str, float], parameters: FloatArray,
                    ) -> tuple[Camera, FloatArray]:
        """Return the camera with other priors of stated terms, and parameters in their units.

        `factors` are by name of the term (see `sigma_factors`). A camera without stated terms is
        returned as it is.
        """
        return self, parameters

    def grown(self) -> tuple[LinearCamera, BoolArray] | None:
        """Return the camera with further columns that residuals may support, and a mask of these.

        The mask (p,) marks the new parameters of the larger camera. None if there are no further
        columns.
        """
        return None

    @abstractmethod
    def area(self) -> tuple[FloatArray, FloatArray]:
        """Return middle (3,) and half widths (2,) of the ground in the image [m]."""


class LinearCamera(Camera):
    """An image whose line and sample are a known part plus columns times parameters.

    Both axes have the same m columns: parameters are those of the line, then those of the sample.
    A perspective that the parameters state may be added.
    """

    @abstractmethod
    def first_order(self, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the known part (n, 2) [px] and the columns (n, m) at places of the frame."""

    def perspective(self, parameters: FloatArray, local: FloatArray) -> FloatArray | float:
        """Return what parameters (2m,) add besides their columns, (n, 2) [px]; here 0."""
        return 0.0

    def fixed(self, local: FloatArray) -> Fixed:
        """Return the known part (n, 2) [px] and the columns (n, m)."""
        return self.first_order(local)

    def project(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None) -> FloatArray:
        """Return line and sample (n, 2) [px]: known part + columns @ parameters + perspective."""
        image, columns = fixed or self.first_order(local)
        return np.asarray(image + columns @ split_by_axis(parameters)
                          + self.perspective(parameters, local))

    def jacobian(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None,
                 ) -> FloatArray:
        """Return the derivatives (n, 2, 2m) of line and sample by all parameters (2m,).

        `local` (n, 3) are positions in the frame of the block [m], and `fixed` is what
        `first_order` returned of them, if it is known. The first m parameters move lines, the
        others samples.
        """
        _, columns = fixed or self.first_order(local)
        n, m = columns.shape
        derivatives = np.zeros((n, 2, 2 * m))
        derivatives[:, 0, :m] = columns
        derivatives[:, 1, m:] = columns
        return derivatives

    def correction(self, parameters: FloatArray, local: FloatArray) -> FloatArray:
        """Return the product of columns and parameters (2m,) at places (n, 3): (n, 2) [px]."""
        return np.asarray(self.first_order(local)[1] @ split_by_axis(parameters))


def split_by_axis(parameters: FloatArray) -> FloatArray:
    """Return parameters (2m,) as a column for the line and one for the sample, (m, 2)."""
    return parameters.reshape(2, -1).T


class RpcCamera(LinearCamera):
    """A vendor's RPC with a polynomial of line and sample added, as Grodecki and Dial 2003.

    Columns are 1; l; s, with l and s the RPC's line and sample in half images. For jitter of the
    attitude a random function of the line follows, cosines of 1 to `_WAVES` half waves an image.

    Notes
    -----
    Standard deviations of the cosines fall with the number of half waves, as those of an attitude
    that wanders do. A cosine has no part in 1 and l, so that each group says what is new.

    References
    ----------
    Grodecki, Dial 2003: Block adjustment of high-resolution satellite images described by rational
    polynomials. PE&RS 69(1), 59-68.
    """

    COLUMNS = ("shift", "drift", "affine")
    SMOOTH = "smooth"
    nested = True

    def __init__(self, rpc: Rpc, frame: Frame, columns: Sequence[str] = COLUMNS) -> None:
        self.rpc = rpc
        self.frame = frame
        self.columns = tuple(columns)
        self.groups = self.columns * 2
        # A first guess [px] that data may change a thousandfold: vendors are wrong by tens of px.
        # The same error of yaw or roll changes an image along its lines by about a pixel.
        guesses = {"shift": 20.0, "drift": 2.0, "affine": 1.0, self.SMOOTH: 2.0}
        self.prior_sigma = tuple(guesses[name] for name in self.groups)
        self.min_sigma = (1e-4,) * len(self.groups)

    def with_parameters(self, keep: BoolArray) -> RpcCamera:
        """Return the camera with the columns that are true in the mask `keep` (2m,)."""
        # Groups are kept in line and sample alike, so that the first half of the mask is enough.
        return RpcCamera(self.rpc, self.frame, [name for name, is_kept in zip(
            self.columns, keep[:len(self.columns)], strict=True) if is_kept])

    def grown(self) -> tuple[RpcCamera, BoolArray] | None:
        """Return the camera with all groups of parameters, and which are new, a mask (2m,).

        None if it has the columns for jitter already, which are the last group.
        """
        if self.SMOOTH in self.columns:
            return None
        larger = RpcCamera(self.rpc, self.frame, groups_of(self.SMOOTH))
        # New columns follow those that the camera has, for the line as for the sample.
        is_new = np.arange(len(larger.columns)) >= len(self.columns)
        return larger, np.tile(is_new, 2)

    def area(self) -> tuple[FloatArray, FloatArray]:
        """Return the middle (3,) and the half widths (2,) of the RPC's area in the frame [m]."""
        rpc = self.rpc
        middle = np.array(rpc.ground_offset)
        corners = self.frame.from_geodetic(np.stack([middle - rpc.ground_scale,
                                                     middle + rpc.ground_scale]))
        return corners.mean(axis=0), np.abs(np.diff(corners[:, :2], axis=0)[0]) / 2

    def first_order(self, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return line and sample by the RPC (n, 2) [px], and the columns of its correction (n, m).

        `local` (n, 3) are positions in the frame of the block [m]. A column has the factors of one
        parameter, in line as in sample: 1 and the image position in half images, or waves of it.
        """
        image = self.rpc.project(self.frame.geodetic(local))
        half_images = (image - self.rpc.image_offset) / np.abs(self.rpc.image_scale)
        polynomial = {"shift": np.ones(len(image)), "drift": half_images[:, 0],
                      "affine": half_images[:, 1]}
        columns = [polynomial[name] for name in self.columns if name != self.SMOOTH]
        if self.SMOOTH in self.columns:
            columns += list(_cosine_functions(half_images[:, 0]))
        return image, np.array(columns).reshape(len(self.columns), len(image)).T


def groups_of(correction: str) -> tuple[str, ...]:
    """Return the group of each column of a correction, with all that it contains."""
    if correction == RpcCamera.SMOOTH:
        return (*RpcCamera.COLUMNS, *(RpcCamera.SMOOTH,) * _WAVES)
    names = ("none", *RpcCamera.COLUMNS)
    return RpcCamera.COLUMNS[:names.index(correction)]


def _cosine_functions(lines: FloatArray) -> FloatArray:
    """Return `_WAVES` cosines of lines (n,), as (`_WAVES`, n), without their parts in 1 and l.

    Lines are in half images from the middle; well beyond the image the values stay the same.
    """
    lines = np.clip(lines, -1.2, 1.2)
    number = np.arange(1, _WAVES + 1)[:, None]
    # The part in l: the integral of the cosine times l, over that of l^2.
    linear = 6 * ((-1.0) ** number - 1) / (np.pi * number) ** 2
    return np.asarray((np.cos(np.pi * number * (lines + 1) / 2) - linear * lines) / number)


class PolynomialCamera(LinearCamera):
    """An image without any geometry: a cubic polynomial of ground coordinates with priors.

    Coordinates are in half widths of the image's ground, heights too, so that the effect of a
    height is bounded as physics bounds it: a metre up moves a place in the image at most some one
    metre along the ground. Terms of degree 0 and 1 are free but for that bound. From them follows
    the perspective of a scanner some 700 km away: all images of a block have it in common, and ties
    alone cannot show it. Terms of degree 2 and 3 correct it; the block's evidence finds their
    variances.

    Notes
    -----
    A scanner divides samples by the distance d = D + r (p - m t), with r the direction of its rays,
    p the place, m t its own way since it saw the middle. To second order that adds
    -s (r p - (r m) l) / D, with l and s the terms of degree 1 of line and sample. The ray is where
    l and s do not change. Lines follow one another in time; the rays of two of them part as radii
    of the Earth do, which adds -l z / R. A wrong ray bends the image: where control leaves the ray
    open, the derivatives of the perspective by it show how far.
    """

    permanent = frozenset({_AFFINE, _QUADRATIC})
    fixed_variance = frozenset({_AFFINE})

    def __init__(self, centre: FloatArray, half_ground: float, half_image: float,
                 middle: FloatArray, powers: Sequence[tuple[int, ...]] = EXPONENTS) -> None:
        self.centre = centre
        self.half = half_ground
        self.middle = middle
        self.half_image = half_image
        self.powers = tuple(powers)
        self.groups = tuple(_group(p) for p in powers) * 2
        # The perspective over an image is its ground divided by the distance, and as uncertain.
        perspective = _DISTANCE_SPREAD * half_ground / DISTANCE
        prior_sigma = {_QUADRATIC: 0.003, _CUBIC: 0.0005, _RELIEF: max(perspective, 0.003)}
        min_sigma = {_QUADRATIC: _MIN_QUADRATIC, _RELIEF: perspective / 2}
        # Terms of degree 0 and 1 are free but for heights: a metre up moves the image by about a
        # metre on the ground at most.
        self.prior_sigma = tuple(
            half_image * prior_sigma.get(name, 0.5 if power[2] else 10.0)
            for name, power in zip(self.groups, self.powers * 2, strict=True))
        self.min_sigma = tuple(min_sigma[name] * half_image if name in min_sigma else 1e-4
                               for name in self.groups)

    def with_parameters(self, keep: BoolArray) -> PolynomialCamera:
        """Return the camera with the monomials that are true in the mask `keep` (2m,)."""
        # The mask has the same monomials for the line as for the sample.
        powers = [power for power, is_kept in zip(
            self.powers, keep[:len(self.powers)], strict=True) if is_kept]
        return PolynomialCamera(self.centre, self.half, self.half_image, self.middle, powers)

    def perspective(self, parameters: FloatArray, local: FloatArray) -> FloatArray | float:
        """Return the perspective (n, 2) [px] at positions (n, 3), by the ray of parameters."""
        scaled = (local - self.centre) / self.half
        forms = self._quadratic_forms(split_by_axis(parameters)[self._slopes])
        # p^T F p of each scaled position p, with the forms F of line and sample.
        return np.asarray(np.einsum("ni,aij,nj->na", scaled, forms, scaled))

    def jacobian(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None,
                 ) -> FloatArray:
        """Return the derivatives (n, 2, 2m) of line and sample by all parameters (2m,).

        `local` (n, 3) are positions in the frame of the block [m]. The perspective is included,
        which depends on the terms of degree 1.
        """
        derivatives = super().jacobian(parameters, local, fixed)
        m = len(self.powers)
        scaled = (local - self.centre) / self.half
        step = 1e-4 * self.half_image
        slopes = split_by_axis(parameters)[self._slopes]
        # The ray depends on the terms of degree 1 alone: central differences of the forms by these.
        for axis, (k, term) in product(range(2), enumerate(self._slopes)):
            ahead = slopes.copy()
            behind = slopes.copy()
            ahead[k, axis] += step
            behind[k, axis] -= step
            form_slope = (self._quadratic_forms(ahead)
                          - self._quadratic_forms(behind)) / (2 * step)
            derivatives[:, :, axis * m + term] += np.einsum(
                "ni,aij,nj->na", scaled, form_slope, scaled)
        return derivatives

    @property
    def _slopes(self) -> list[int]:
        """Numbers of the columns x, y and z among the monomials."""
        return [self.powers.index(axis) for axis in _AXES]

    def _quadratic_forms(self, slopes: FloatArray) -> FloatArray:
        """Return the quadratic forms (2, 3, 3) of the perspective in line and sample.

        `slopes` (3, 2) are the terms of x, y and z in line and sample. The forms are zeros if the
        ray is nearly level, as no image from above has it.
        """
        line, sample = slopes.T
        # Along the ray neither line nor sample changes: it is across the gradients of both.
        ray = np.cross(line, sample)
        if abs(ray[2]) <= 1e-3 * np.linalg.norm(ray):
            return np.zeros((2, 3, 3))
        # The ray has length 1, and leads downwards.
        ray *= -np.sign(ray[2]) / np.linalg.norm(ray)
        # m of the class: the way on the ground that changes the line by 1, and the sample by 0.
        way = np.array([sample[1], -sample[0]]) / (line[0] * sample[1] - line[1] * sample[0])
        # r p - (r m) l, as a linear form of p.
        distance_form = ray - (ray[:2] @ way) * line
        return np.stack([-self.half / _EARTH_RADIUS * np.outer(line, (0, 0, 1)),
                         -self.half / DISTANCE * np.outer(sample, distance_form)])

    @property
    def scales(self) -> tuple[str, ...]:
        """The name of each parameter's scale: an attitude bends along the lines alone."""
        return tuple(f"x{a} y{b} z{c}" for a, b, c in self.powers) * 2

    def area(self) -> tuple[FloatArray, FloatArray]:
        """Return middle and half widths of the ground that the coordinates fit."""
        return self.centre, np.full(2, self.half)

    def first_order(self, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the middle of the image for each position (n, 2) [px], and monomials (n, m)."""
        x, y, z = ((local - self.centre) / self.half).T
        columns = np.stack([x**a * y**b * z**c for a, b, c in self.powers], axis=1)
        return np.tile(self.middle, (len(local), 1)), columns


def _group(power: tuple[int, ...]) -> str:
    """Return the group of a monomial by its exponents of x, y and z.

    It is affine up to degree 1, relief beyond it if z is in it, and else quadratic or cubic.
    """
    degree = sum(power)
    if degree < 2:
        return _AFFINE
    if power[2]:
        return _RELIEF
    return _QUADRATIC if degree == 2 else _CUBIC
