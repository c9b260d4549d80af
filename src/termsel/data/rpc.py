"""Rational polynomial coefficients (RPC), as vendors deliver them and GDAL reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
from msgspec import structs
from numpy.typing import ArrayLike

from termsel.core.arguments import Explained, explains_arguments
from termsel.core.errors import TermselError
from termsel.data.arrays import FloatArray
from termsel.data.locate import Surface, locate
from termsel.data.monomials import RPC00B, evaluate_monomials
from termsel.data.record.cautions import BEYOND_RPC
from termsel.data.record.record import RpcNumbers

Coefficients = tuple[float, ...]

N_COEFFICIENTS = len(RPC00B)

_OUTSIDE = 2.0
"""Half ranges of the RPC's heights from their middle beyond which heights are surely outside."""
_NEAR_RANGE = 200.0
"""Height [m] above or below a narrow range to which an RPC is still about right."""
CHECK_HEIGHTS = "check their unit and sign; leave unknown ones blank, or give --dem FILE"
"""What to do about heights that are far outside those of an RPC."""


@dataclass(frozen=True)
class Rpc(Explained):
    """Line and sample as quotients of cubic polynomials of longitude, latitude and height.

    With X, Y, Z = (ground - ground_offset) / ground_scale,

        line = image_offset[0] + image_scale[0] P(X, Y, Z) / Q(X, Y, Z),

    and sample likewise.

    Parameters
    ----------
    image_offset, image_scale : tuple of 2 floats
        Of line and sample [px]; the centre of the upper-left pixel is (0, 0), as in RPB
        and _RPC.TXT files.
    ground_offset, ground_scale : tuple of 3 floats
        Of WGS84 longitude, latitude [deg] and ellipsoidal height [m].
    line_numerator, line_denominator, sample_numerator, sample_denominator : tuple of 20 floats
        In RPC00B order.
    error_bias, error_random : float, optional
        Root mean square of bias and of random error [m], if the vendor states them.
    source : str
        Name of its file, for messages.
    control_count : int
        Number of features that it was fitted to by termsel; 0 for one that a vendor made.
    control_digests : tuple of str
        What these features are recognised by (`termsel.data.fingerprints`).

    Raises
    ------
    TermselError
        If there are not so many values, one is not finite, a scale is 0, or all of a denominator
        is 0.

    Notes
    -----
    NGA STDI-0002-1, appendix E, "RPC00B". Evaluated as in GDAL: longitudes that differ by a
    full turn are the same.

    Examples
    --------
    >>> import termsel
    >>> one = (1.0,) + 19 * (0.0,)
    >>> line, sample = (0.0, 0.0, 1.0) + 17 * (0.0,), (0.0, 1.0) + 18 * (0.0,)
    >>> rpc = termsel.Rpc((500.0, 500.0), (500.0, 500.0), (11.0, 46.0, 300.0), (0.1, 0.1, 300.0),
    ...                   line, one, sample, one)
    >>> rpc.project([[11.1, 46.0, 300.0]])  # line and sample [px]
    array([[ 500., 1000.]])
    """

    _AXES: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "image_scale": ("line", "sample"),
        "ground_scale": ("longitude", "latitude", "height")}
    elsewhere: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("LINE_OFF", "SAMP_OFF", "line_off", "samp_off", "line_offset",
                         "sample_offset"), "It is in rpc.image_offset, of line and sample."),
        **dict.fromkeys(("LINE_SCALE", "SAMP_SCALE", "line_scale", "samp_scale"),
                        "It is in rpc.image_scale, of line and sample."),
        **dict.fromkeys(("LAT_OFF", "LONG_OFF", "HEIGHT_OFF", "lat_off", "long_off", "height_off"),
                        "It is in rpc.ground_offset, of longitude, latitude and height."),
        **dict.fromkeys(("LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE", "lat_scale", "long_scale",
                         "height_scale"),
                        "It is in rpc.ground_scale, of longitude, latitude and height."),
        **dict.fromkeys(("LINE_NUM_COEFF", "line_num_coeff"), "They are rpc.line_numerator."),
        **dict.fromkeys(("LINE_DEN_COEFF", "line_den_coeff"), "They are rpc.line_denominator."),
        **dict.fromkeys(("SAMP_NUM_COEFF", "samp_num_coeff"), "They are rpc.sample_numerator."),
        **dict.fromkeys(("SAMP_DEN_COEFF", "samp_den_coeff"), "They are rpc.sample_denominator."),
        "predict": "Image positions are rpc.project(ground).",
        "transform": "Image positions are rpc.project(ground).",
        "inverse": "Ground positions are rpc.locate(image, height).",
        "save": "termsel.write_rpc(rpc, PATH) writes it.",
        "write": "termsel.write_rpc(rpc, PATH) writes it."}

    image_offset: tuple[float, float]
    image_scale: tuple[float, float]
    ground_offset: tuple[float, float, float]
    ground_scale: tuple[float, float, float]
    line_numerator: Coefficients
    line_denominator: Coefficients
    sample_numerator: Coefficients
    sample_denominator: Coefficients
    error_bias: float | None = None
    error_random: float | None = None
    source: str = field(default="", compare=False)
    control_count: int = field(default=0, compare=False)
    control_digests: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Store numbers as Python's float and check them; raises TermselError as the class says."""
        for name, value in vars(self).items():
            # Files have the repr of the numbers, which is another one for those of numpy.
            if isinstance(value, tuple) and name != "control_digests":
                object.__setattr__(self, name, tuple(map(float, value)))
        for name in ("line_numerator", "line_denominator", "sample_numerator",
                     "sample_denominator"):
            values = getattr(self, name)
            _require_values(values, N_COEFFICIENTS, name, "coefficients")
            if name.endswith("denominator") and not any(values):
                raise TermselError(f"all coefficients of the RPC's {name.replace('_', ' ')} are 0",
                                   hint="A denominator usually begins with 1.")
        for name, count in (("image_offset", 2), ("image_scale", 2),
                            ("ground_offset", 3), ("ground_scale", 3)):
            _require_values(getattr(self, name), count, name, "values")
            if name.endswith("scale") and not all(getattr(self, name)):
                axis = self._AXES[name][getattr(self, name).index(0.0)]
                raise TermselError(f"the scale of {axis} of the RPC is 0",
                                   hint="The RPC is damaged: get it again.")
        for name in ("error_bias", "error_random"):
            if getattr(self, name) is not None:
                _require_finite((getattr(self, name),), name)

    def as_delivered(self) -> Self:
        """Return the RPC without the record of its control, as if a vendor had delivered it."""
        return replace(self, control_count=0, control_digests=())

    def numbers(self) -> RpcNumbers:
        """Return the RPC as the record of a run holds it."""
        return RpcNumbers(**asdict(self))

    @classmethod
    def from_numbers(cls, numbers: RpcNumbers) -> Self:
        """Return the RPC that `numbers` returned these for."""
        return cls(**structs.asdict(numbers))

    @explains_arguments()
    def heights_outside(self, heights: FloatArray) -> str:
        """Return a clause for a message if the median height is far outside the range of the RPC.

        Parameters
        ----------
        heights : array, shape (n,)
            Ellipsoidal heights [m].

        Returns
        -------
        str
            The clause; "" without heights, and if their median is not far outside.

        Examples
        --------
        >>> import numpy as np, termsel
        >>> one = (1.0,) + 19 * (0.0,)
        >>> rpc = termsel.Rpc((500.0, 500.0), (500.0, 500.0), (11.0, 46.0, 300.0),
        ...                   (0.1, 0.1, 300.0), one, one, one, one)
        >>> rpc.heights_outside(np.array([9000.0]))
        'the heights of the control, 9,000 m (median), are outside those of the RPC, 0 to 600 m'
        >>> rpc.heights_outside(np.array([500.0]))
        ''
        """
        if not len(heights):
            return ""
        # The range of an RPC is its offset plus and minus its scale.
        middle = self.ground_offset[2]
        half_range = abs(self.ground_scale[2])
        median = float(np.median(heights)) + 0.0  # 0.0 makes 0 of -0, which would be written "-0"
        if abs(median - middle) <= max(_OUTSIDE * half_range, half_range + _NEAR_RANGE):
            return ""
        return (f"the heights of the control, {median:,.0f} m (median){BEYOND_RPC}"
                f"{middle - half_range:,.0f} to {middle + half_range:,.0f} m")

    @explains_arguments()
    def project(self, ground: ArrayLike) -> FloatArray:
        """Return where ground points are seen.

        Parameters
        ----------
        ground : array_like, shape (n, 3)
            WGS84 longitude, latitude [deg] and ellipsoidal height [m].

        Returns
        -------
        ndarray, shape (n, 2)
            Line and sample [px]; infinite or NaN where a denominator is 0.
        """
        columns = self._monomials(ground)
        line = (columns @ self.line_numerator) / (columns @ self.line_denominator)
        sample = (columns @ self.sample_numerator) / (columns @ self.sample_denominator)
        image = np.stack([line, sample], axis=1)
        return np.asarray(image * self.image_scale + self.image_offset)

    @explains_arguments()
    def denominators(self, ground: FloatArray) -> FloatArray:
        """Return the denominators of line and sample at ground points, (n, 2)."""
        below = np.array([self.line_denominator, self.sample_denominator])
        return np.asarray(self._monomials(ground) @ below.T)

    def _monomials(self, ground: ArrayLike) -> FloatArray:
        """Return the monomials (n, 20) of X, Y, Z at ground points (n, 3)."""
        from_offset = np.asarray(ground, dtype=np.float64) - self.ground_offset
        # Longitudes on the other side of 180 degrees differ by about a turn; GDAL evaluates an RPC
        # with the same limits.
        is_turn_more = from_offset[:, 0] > 270
        is_turn_less = from_offset[:, 0] < -270
        from_offset[:, 0] -= 360.0 * (is_turn_more.astype(float) - is_turn_less)
        return evaluate_monomials(from_offset / self.ground_scale, RPC00B)

    @explains_arguments()
    def locate(self, image: ArrayLike, height: ArrayLike | Surface) -> FloatArray:
        """Return where the rays of image points reach heights or a surface.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [px].
        height : array_like, shape (n,), a number, or callable
            Ellipsoidal heights [m], or a function of longitudes and latitudes, shape (n, 2).

        Returns
        -------
        ndarray, shape (n, 3)
            WGS84 longitude, latitude [deg] and ellipsoidal height [m]; NaN where a ray does not
            reach its height or the surface.
        """
        return locate(self.project, image, height, centre=self.ground_offset,
                      scale=np.abs(self.ground_scale))


def _require_values(values: tuple[float, ...], count: int, name: str, noun: str) -> None:
    """Raise TermselError unless an RPC has `count` finite values of some name, called `noun`."""
    if len(values) != count:
        raise TermselError(f"the {name.replace('_', ' ')} of the RPC has {len(values)} {noun}, "
                           f"expected {count}")
    _require_finite(values, name)


def _require_finite(values: tuple[float, ...], name: str) -> None:
    """Raise TermselError if any of an RPC's values of some name is not finite."""
    if not np.isfinite(values).all():
        raise TermselError(f"the RPC's {name.replace('_', ' ')} is not finite: {values}")
