"""The imaging radar whose orbit and timing a Sentinel-1 annotation states: range and Doppler."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet, Option, TermselError
from termsel.toolkit.models import KnownImage
from termsel_cameras.scanners.annotation import Annotation, FloatArray, annotation_of
from termsel_cameras.scanners.orbit import to_geocentric
from termsel_cameras.scanners.physical import Physical, require_scaling

Vectors = tuple[tuple[float, ...], ...]

LIGHT = 299792458.0
"""Speed of light [m/s]."""

RADAR_TERMS = ("azimuth", "range", "azimuth-rate", "range-rate")

SHIFT, RATE_METRES = 30.0, 2.0
"""Standard deviations of a shift in azimuth and in range [m], and of what a shift changes by from
the middle of the image to its edge [m]. Orbits of products for near real time are metres off, the
troposphere delays echoes by 2 to 4 m, and a processor may leave out the delay by which pulses
arrive after they are sent. The shift is given more, so that a single point corrects it."""

NEWTON_STEPS, LAST_STEP = 20, 1e-10
"""Most Newton steps to the time of zero Doppler, and the step at which they end [s]."""

DEGREES = 1e-5
"""Step of longitude and latitude by which image positions are differentiated."""

MAX_BEYOND = 0.25
"""Part of the swath beyond which polynomials of ground range say nothing."""

BISTATIC = Option(
    "bistatic", False, "Whether lines take in that echoes from afar arrive later than those from "
    "the middle of the swath, as the lattice of the annotation does (up to 0.2 lines). By default "
    "they are those of range and Doppler alone, as of most programs.", type=bool)


class Radar(Physical):
    """Imaging radar with the orbit and timing of a Sentinel-1 annotation; shifts have priors.

    A place is seen on the line of the time t at which the satellite's velocity is square to the
    line of sight, (P - S(t)) . V(t) = 0 (zero Doppler), and on the sample of its distance
    |P - S(t)|: in slant range by the sampling rate, in ground range by the polynomials of the
    annotation, linear in time between two of them. Terms are in standard deviations of what is
    known beforehand: shifts in azimuth and range, and how they change along lines and samples. A
    term that is not selected is 0.

    Notes
    -----
    Lines and samples count from the centre of the first pixel, as the annotation's do. Positions
    are cubic Hermite polynomials between the state vectors, velocities cubic splines through
    theirs. The priors are termsel's own. Not modelled: the delay of the troposphere, which the
    shift in range takes.

    An echo arrives later from afar, while the satellite flies on. The processor corrects that for
    the middle of the swath. The rest is half the difference of two-way times, up to 0.2 lines of a
    GRD image and 0.14 of a stripmap between edge and middle. Range and Doppler by themselves, and
    most programs, leave it out, and so does this model unless `bistatic` is true. The lattice of an
    annotation has it: on the annotations tried, lines differ from the lattice by 0.08 to 0.11 px
    (RMS) without it, and by 0.0006 to 0.002 px with it.

    Examples
    --------
    >>> import termsel
    >>> model = termsel.get("models", "radar")
    >>> model().terms
    ('azimuth', 'range', 'azimuth-rate', 'range-rate')

    References
    ----------
    J. C. Curlander, "Location of Spaceborne SAR Imagery", IEEE Trans. Geosci. Remote Sens. GE-20
    (1982) 359-364. ESA, Guide to Sentinel-1 Geocoding, UZH-S1-GC-AD 1.10 (2019), sections 2 and 3.
    """

    name = "radar"
    declared_options = (
        Option("metadata", "", "Required: the annotation of a Sentinel-1 image (XML), the image "
                               "or the product. A result contains what was read."),
        Option("swath", "", "Swath of a product that has several, such as IW2."),
        Option("burst", 0, "Number of the burst, from 1, of an SLC image of the modes IW and EW; "
                           "its lines are those of the whole image.",
               type=int, minimum=0, maximum=1000),
        BISTATIC)
    terms_ = RADAR_TERMS

    def __init__(self, **options: Any) -> None:
        """Take the options, and read the annotation; its text becomes the option `metadata`.

        Raises TermselError for options that are not valid, an annotation that cannot be read, and
        one that lacks what `burst` or `bistatic` need.
        """
        super().__init__(**options)
        metadata = self.options["metadata"]
        self._annotation = annotation_of(metadata, self.options["swath"]) if metadata else None
        if self._annotation is not None:
            self._first_line = _line_time_origin(self._annotation, self.options["burst"])
            if self.options["bistatic"]:
                self._require_middle(self._annotation)
            self.options["metadata"] = self._annotation.text()  # readable without the file

    @property
    def annotation(self) -> Annotation:
        """The annotation of the image: orbit, timing and lattice.

        Raises
        ------
        TermselError
            If the option `metadata` names none.
        """
        if self._annotation is None:
            raise TermselError(f"model {self.name!r} requires the annotation of the image",
                               hint="Give the XML file of a Sentinel-1 product with "
                                    "--set metadata=FILE.")
        return self._annotation

    @property
    def source(self) -> str:
        """The file of the annotation."""
        return self.annotation.source

    def known_image(self) -> KnownImage | None:
        """Return the image's size, the area of the annotation's lattice and the lines of the burst.

        None without a lattice.
        """
        stated = self.annotation
        if not stated.area:
            return None
        lines = None
        if stated.bursts:
            # The lines of other bursts overlap in time: each is seen by a geometry of its own.
            first = int(self._first_line[1])
            lines = first, first + stated.lines_per_burst - 1
        return KnownImage(stated.size, np.array(stated.area), lines)

    def starts(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms from which a fit begins, (1, k): no shift."""
        return np.zeros((1, len(RADAR_TERMS)))

    def image_of(self, values: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions (p, n, 2) of scaled ground positions by terms (p, k)."""
        image = self.unshifted(self.geographic(ground))
        annotation = self.annotation
        spacing = np.array([annotation.line_spacing, annotation.sample_spacing])
        # Positions from the middle of the image, from -1 to 1, by which shifts change.
        middle = (np.array(annotation.size) - 1.0) / 2.0
        from_middle = (image - middle) / np.maximum(middle, 1.0)
        # [m], and then [px] by the spacing of lines and samples.
        shift = SHIFT * values[:, None, :2] + RATE_METRES * values[:, None, 2:] * from_middle
        shifted = image + shift / spacing
        return np.asarray(
            require_scaling(self.scaling).image(shifted.reshape(-1, 2)).reshape(shifted.shape))

    def unshifted(self, geographic: FloatArray) -> FloatArray:
        """Return line and sample (n, 2) [px] by the annotation alone.

        NaN for a point that the radar does not see, or whose ground range is beyond that of the
        annotation's polynomials.

        Parameters
        ----------
        geographic : ndarray, shape (n, 3)
            WGS84 longitude, latitude [deg] and ellipsoidal height [m].
        """
        stated = self.annotation
        time, distance, is_visible = zero_doppler(stated, to_geocentric(geographic))
        if self.options["bistatic"] and stated.middle_range_time is not None:
            # Lines are counted by the arrival of echoes from the middle of the swath. An echo with
            # the two-way time tau = 2 R / c is on the line of (tau - tau_middle) / 2 before its
            # zero Doppler, as the satellite flies on between transmission and echo.
            time = time - (2.0 * distance / LIGHT - stated.middle_range_time) / 2.0
        first_time, first_line = self._first_line
        line = first_line + (time - first_time) / stated.line_interval
        if stated.ground_ranges:
            sample = _ground_range(stated, time, distance) / stated.sample_spacing
        else:
            sample = (2.0 * distance / LIGHT - stated.first_range_time) * stated.sampling_rate
        image = np.stack([line, sample], axis=1)
        samples = stated.size[1]
        is_beyond = np.abs(sample - samples / 2.0) > (0.5 + MAX_BEYOND) * samples
        if stated.ground_ranges:
            # Slant range is valid at any distance, a polynomial of ground range near the swath.
            is_visible &= ~is_beyond
        image[~is_visible] = np.nan
        return image

    @staticmethod
    def _require_middle(annotation: Annotation) -> None:
        """Raise TermselError if the lattice does not say by which echoes lines are timed."""
        if annotation.middle_range_time is None:
            raise TermselError(
                f"{annotation.source}: its lattice does not state by which echoes lines are timed",
                hint="Leave out --set bistatic=....")

    def on_ground(self, image: FloatArray, known_ground: FloatArray) -> FloatArray:
        """Return the ground positions (n, 3) that are seen at image positions (n, 2).

        They are by the annotation alone, without shifts. Heights are interpolated in the image
        between those of `known_ground` (m, 3). Both are WGS84 longitude, latitude [deg] and
        ellipsoidal height [m]. NaN where none is found.
        """
        from scipy.interpolate import griddata  # other models need not import it

        known_image = self.unshifted(known_ground)
        is_visible = np.isfinite(known_image).all(axis=1)
        known_image = known_image[is_visible]
        known_ground = known_ground[is_visible]
        ground = griddata(known_image, known_ground, image, rescale=True)
        # Outside the hull of the known points the nearest one counts.
        nearest = griddata(known_image, known_ground, image, method="nearest", rescale=True)
        ground = np.where(np.isnan(ground), nearest, ground)
        # Newton's method moves longitude and latitude at the interpolated heights.
        for _ in range(NEWTON_STEPS):
            residuals = image - self.unshifted(ground)
            # Rows that are lost on the way are NaN; the other rows go on without them.
            if not (np.abs(residuals) > 1e-9).any():
                break
            slopes = np.stack([(self.unshifted(ground + step) - self.unshifted(ground - step))
                               / (2.0 * DEGREES) for step in DEGREES * np.eye(3)[:2]], axis=-1)
            ground[:, :2] += np.linalg.solve(slopes, residuals[..., None])[..., 0]
        is_found = np.abs(image - self.unshifted(ground)).max(axis=1) < 1e-6
        ground[~is_found] = np.nan
        return np.asarray(ground)


def _line_time_origin(annotation: Annotation, burst: int) -> tuple[float, float]:
    """Return the time [s] and the number of the line from which lines are counted.

    They are those of the first line of a burst, from 1; of an image without bursts, for which
    `burst` is 0, both are 0. Raises TermselError for a burst that the image does not have, and for
    none of an image that has several.
    """
    bursts = annotation.bursts
    # The lines of an image without bursts follow one another in time from the first to the last.
    if not bursts:
        if burst:
            raise TermselError(f"{annotation.source}: the image has no bursts",
                               hint="Leave out --set burst=...")
        return 0.0, 0.0
    if not 1 <= burst <= len(bursts):
        raise TermselError(
            f"{annotation.source}: the image is made of {len(bursts)} bursts that overlap in time, "
            "so that a point may be on two lines",
            hint=f"Choose one with --set burst=N, N from 1 to {len(bursts)}, or use an image of "
                 "merged bursts, such as the GRD product.")
    chosen_burst = bursts[burst - 1]
    return chosen_burst.time, float(chosen_burst.line)


def zero_doppler(annotation: Annotation, targets: FloatArray,
                 ) -> tuple[FloatArray, FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return the times of zero Doppler of targets, their distances then, and which are seen.

    The time is a zero of f(t) = (P - S(t)) . V(t), found by Newton's method with f'(t) = (P - S(t))
    . A(t) - V(t) . V(t).

    Parameters
    ----------
    annotation : Annotation
    targets : ndarray, shape (n, 3)
        Earth-fixed positions [m].

    Returns
    -------
    time, distance : ndarray, shape (n,)
        From the first line [s], and from the satellite [m].
    seen : ndarray of bool, shape (n,)
        False on the left of the track, and if there is no zero within the state vectors.
    """
    orbit, motion, acceleration = _splines_of_orbit(annotation.times, annotation.positions,
                                                    annotation.velocities)
    first = annotation.times[0]
    last = annotation.times[-1]
    time = np.full(len(targets), annotation.size[0] * annotation.line_interval / 2.0)
    # The search begins at the middle of the image, and stays where the orbit is known.
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            sight = targets - orbit(time)
            velocity = motion(time)
            doppler = (sight * velocity).sum(axis=1)
            slope = (sight * acceleration(time)).sum(axis=1) - (velocity**2).sum(axis=1)
            step = -doppler / slope
            time = np.clip(time + step, first, last)
            if not (np.abs(step) > LAST_STEP).any():
                break
        position = orbit(time)
        velocity = motion(time)
        sight = targets - position
        distance = np.linalg.norm(sight, axis=1)
        # Sentinel-1 looks to the right: V x S points there, S being up.
        rightward = (sight * np.cross(velocity, position)).sum(axis=1) > 0
        reached = np.abs((sight * velocity).sum(axis=1)) < 1e-3 * distance
    return time, distance, rightward & reached


@lru_cache(maxsize=8)  # an orbit is asked for with each set of places
def _splines_of_orbit(times: tuple[float, ...], positions: Vectors, velocities: Vectors,
                      ) -> tuple[Any, Any, Any]:
    """Return splines of position [m], velocity [m/s] and acceleration [m/s^2] by time [s].

    The velocity is not the derivative of the position: each is a spline of its own.
    """
    # Other models need not import it.
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

    # Stated velocities differ by 1 cm/s from how stated positions change, which moves a place by
    # 0.3 lines of a stripmap: the processor's lattice of points follows the velocities.
    motion = CubicSpline(times, velocities)
    return CubicHermiteSpline(times, positions, velocities), motion, motion.derivative()


def _ground_range(annotation: Annotation, time: FloatArray, distance: FloatArray) -> FloatArray:
    """Return the ground range (n,) [m] of slant ranges `distance` (n,) [m] at times (n,) [s].

    Products state a polynomial every few seconds. Between two of them the ground range is
    interpolated linearly in time; before the first and after the last it is theirs.
    """
    polynomials = annotation.ground_ranges
    origins = np.array([polynomial.origin for polynomial in polynomials])
    degree = max(len(polynomial.coefficients) for polynomial in polynomials)
    coefficients = np.zeros((degree, len(polynomials)))
    for number, polynomial in enumerate(polynomials):
        coefficients[:len(polynomial.coefficients), number] = polynomial.coefficients

    def by_polynomials(numbers: NDArray[np.intp]) -> FloatArray:
        """Return ground ranges (n,), each by the polynomial of that number (Horner's scheme)."""
        from_origin = distance - origins[numbers]
        value = np.zeros(len(distance))
        for coefficient in coefficients[::-1]:
            value = value * from_origin + coefficient[numbers]
        return value

    if len(polynomials) == 1:
        return by_polynomials(np.zeros(len(distance), dtype=np.intp))
    times = np.array([polynomial.time for polynomial in polynomials])
    after = np.clip(np.searchsorted(times, time), 1, len(times) - 1)
    # Clipped to 0 and 1, the weight takes the first polynomial before it and the last after it.
    weight = np.clip((time - times[after - 1]) / (times[after] - times[after - 1]), 0.0, 1.0)
    return np.asarray((1.0 - weight) * by_polynomials(after - 1)
                      + weight * by_polynomials(after))
