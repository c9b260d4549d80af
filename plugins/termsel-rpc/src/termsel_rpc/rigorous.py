"""Refinement of a rigorous pushbroom model by biases of position and attitude."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from termsel import Equations, FeatureSet, Option, TermselError, image_equations
from termsel.simulate import (
    SCENES,
    Angle,
    Pushbroom,
    geometry_from,
    geometry_text,
    read_geometry,
    scene_truth,
)
from termsel_rpc.refinement import FloatArray, Refinement
from termsel_rpc.simulated import NOMINAL, nominal_sensor

EMBEDDED = (*NOMINAL, *SCENES)

POSITION = ("ahead", "starboard", "down")
ATTITUDE = ("roll", "pitch", "yaw")

# Step of a bias by which derivatives are differences: some px in the image.
_DERIVATIVE_STEP = 1e-3


class PushbroomRefine(Refinement):
    """Rigorous pushbroom model with biases of position and attitude: 3 or 6 terms.

    Biases are constant over the scene: of roll, pitch and yaw, and of the position ahead, to
    starboard and down. Equations are linear about the nominal geometry, by central
    differences; a fit then minimises the squares of the distances, and image positions are always
    those of the rigorous model. From orbit a bias of position is almost like one of attitude, so
    that few points cannot separate them; by default there are only those of attitude.

    Like all coefficients, those of the terms are in scaled units: times the image scale, roll,
    pitch and position are the movement of the image in detectors, with the altitude as the
    distance of the ground; yaw is in radians.

    Notes
    -----
    Constant biases after P.V. Radhadevi, R. Ramachandran and A.S.R.K.V. Murali Mohan,
    "Restitution of IRS-1C PAN data using an orbit attitude model and minimum control", ISPRS J.
    53 (1998) 262-271. The geometry is that of `termsel.simulate.Pushbroom`.
    """

    name = "pushbroom-refine"
    declared_options = (
        Option("geometry", "", "Required: the nominal geometry, as a JSON file from "
                               "termsel.simulate.write_geometry or the name of an embedded data "
                               "set. A result contains the geometry itself."),
        Option("biases", "attitude", "Quantities whose biases are terms.",
               choices=("attitude", "position", "both")))

    def __init__(self, **options: Any) -> None:
        """Take the options, and read the geometry; that of a file replaces its name as the option.

        Raises TermselError for options that are not valid, or a geometry that cannot be read.
        """
        super().__init__(**options)
        # The name of an embedded data set, the JSON of a result, or a file.
        stated = self.options["geometry"]
        self._sensor = None
        self._file = stated
        if stated in EMBEDDED:
            self._sensor = (nominal_sensor(stated) if stated in NOMINAL
                            else scene_truth(stated).sensor)
        elif stated.startswith("{"):
            self._sensor = geometry_from(stated)
            self._file = "of the result"
        elif stated:
            self._sensor = read_geometry(stated)
            self._file = Path(stated).name
            # A result must be readable without the file.
            self.options["geometry"] = geometry_text(self._sensor)

    @property
    def sensor(self) -> Pushbroom:
        """The nominal geometry.

        Raises
        ------
        TermselError
            If the option `geometry` names none.
        """
        if self._sensor is None:
            raise TermselError(f"model {self.name!r} requires the geometry to refine",
                               hint="Give it with --set geometry=FILE, or the name of an embedded "
                                    f"data set: {', '.join(EMBEDDED)}.")
        return self._sensor

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the biases that the option `biases` chooses."""
        return {"attitude": ATTITUDE, "position": POSITION,
                "both": ATTITUDE + POSITION}[self.options["biases"]]

    @property
    def source(self) -> str:
        """The geometry and its file, for messages."""
        return f"the geometry {self._file}"

    def footprint(self) -> FloatArray:
        """Return the least, then the greatest longitude and latitude [deg] of the image, (2, 2).

        They are those of its corners at the height 0.
        """
        last = self.sensor.n_lines - 1, self.sensor.n_samples - 1
        corners = self.sensor.locate(np.array(list(product((0, 1), repeat=2))) * last, 0.0)
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def first_order(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scaled image positions (n, 2) without biases, and the derivatives (n, 2, k)."""
        nominal = np.zeros(len(self.terms))
        return self.project(nominal, ground), self._coefficient_derivatives(nominal, ground)

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations:
        """Return the equations about a solution (k,) (see `SensorModel.linearised`)."""
        blocks = []
        for ground in (features.points.ground, features.lines.ground.reshape(-1, 3)):
            # image(x) = image(x0) + J (x - x0): the constant part is image(x0) - J x0.
            columns = self._coefficient_derivatives(coefficients, ground)
            blocks += [columns, self.project(coefficients, ground) - columns @ coefficients]
        return image_equations(features, *blocks[::2], *blocks[1::2])

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions (..., n, 2) of ground points (n, 3), all of them scaled.

        `coefficients` (..., k) are the biases: one set or many.
        """
        geographic = self.geographic(ground)
        assert self.scaling is not None  # otherwise `geographic` has raised an error
        sets = coefficients.reshape(-1, len(self.terms))
        if not len(geographic):
            return np.zeros((*coefficients.shape[:-1], 0, 2))
        # The scanner projects all at once: each ground point is repeated for each set of biases.
        image = self._scanner_with_biases(np.repeat(sets, len(geographic), axis=0)).project(
            np.tile(geographic, (len(sets), 1)))
        return self.scaling.image(image).reshape(*coefficients.shape[:-1], len(geographic), 2)

    def _coefficient_derivatives(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the derivatives of image positions by the coefficients, shape (n, 2, k)."""
        # Central differences, all terms at once.
        steps = _DERIVATIVE_STEP * np.eye(len(coefficients))
        ahead, behind = (self.project(coefficients + sign * steps, ground) for sign in (1, -1))
        return np.asarray(np.moveaxis(ahead - behind, 0, -1) / (2 * _DERIVATIVE_STEP))

    def _scanner_with_biases(self, coefficients: FloatArray) -> Pushbroom:
        """Return a scanner that has biases of its own for each of n points.

        `coefficients` (n, k) are those of the terms, in scaled units.
        """
        assert self.scaling is not None
        sensor = self.sensor
        # One scaled unit is `image_scale` detectors, each of the angle `ifov` [rad].
        angle = self.scaling.image_scale * sensor.ifov
        bias = dict.fromkeys((*ATTITUDE, *POSITION), np.zeros(len(coefficients)))
        bias |= dict(zip(self.terms, coefficients.T, strict=True))
        position_bias = np.stack([bias[name] for name in POSITION], axis=1)
        return replace(
            sensor, roll=_Turned(nominal=sensor.roll, bias=angle * bias["roll"]),
            pitch=_Turned(nominal=sensor.pitch, bias=angle * bias["pitch"]),
            yaw=_Turned(nominal=sensor.yaw, bias=bias["yaw"]),
            offset=np.asarray(sensor.offset) + angle * sensor.altitude * position_bias)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Turned(Angle):
    """An attitude angle with a separate bias for each point."""

    nominal: Angle
    bias: FloatArray

    def __call__(self, time: FloatArray) -> FloatArray:
        return self.nominal(time) + self.bias
