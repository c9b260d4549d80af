"""The exterior orientation of a camera against one that is written out here."""

from __future__ import annotations

import numpy as np
import pytest

from termsel.data.record.figures import SensorFigure
from termsel.data.scaling import Scaling
from termsel.fitting.orientation import angles_of, camera_figures, exterior_orientation


def turned(axis: int, degrees: float) -> np.ndarray:
    """Return the rotation of axes about one of them."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[i, i, j, j], [i, j, i, j]] = c, s, -s, c
    return matrix


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (3.0, -2.0, 170.0), (35.0, 1.0, -90.0)])
@pytest.mark.parametrize(("mirrored", "crs", "units"), [
    (False, "EPSG:32633", ("m", "m", "m")), (True, "local", ("m", "m", "m")),
    (True, "EPSG:4979", ("deg", "deg", "m")), (False, "EPSG:2263+6360", ("us-ft",) * 3),
    (False, "EPSG:2263", ("us-ft", "us-ft", "m")), (True, "EPSG:2222", ("ft", "ft", "m"))])
def test_place_and_angles_of_a_camera(angles: tuple[float, float, float], mirrored: bool,
                                      crs: str, units: tuple[str, ...]) -> None:
    omega, phi, kappa = angles
    matrix = turned(2, kappa) @ turned(1, phi) @ turned(0, omega)
    np.testing.assert_allclose(angles_of(matrix), angles, atol=1e-9)
    sample = -matrix[0] if mirrored else matrix[0]
    rotation = np.stack([-matrix[1], sample, -matrix[2]])
    scaling = Scaling((4e5, 5e6, 300.0), (1000.0, 900.0, 50.0), (0.0, 0.0), 1500.0)
    # A plane frame of metres that bends a little, as that of the Earth does.
    def local(ground: np.ndarray) -> np.ndarray:
        metres = ground * [1000.0, 900.0, 50.0]
        metres[:, 2] -= (metres[:, :2] ** 2).sum(axis=1) / 1.3e7
        return metres

    centre = local(np.array([[0.1, -0.2, 24.0]]))[0]
    orientation = exterior_orientation(rotation, centre, local, scaling, crs)
    assert tuple(figure.unit for figure in orientation[:3]) == units
    figures = {figure.name: figure.value for figure in orientation}
    expected = {"projection centre x": 400_100.0, "projection centre y": 4_999_820.0,
                "projection centre z": 1500.0, "omega": omega, "phi": phi, "kappa": kappa}
    assert figures.keys() == expected.keys()
    for name, value in expected.items():
        assert figures[name] == pytest.approx(value, abs=1e-6), name


def test_a_camera_states_focal_length_and_principal_point_after_its_orientation() -> None:
    orientation = (SensorFigure("omega", 1.0, "deg"),)
    figures = camera_figures(orientation, 1500.0, np.array([20.0, 30.0]))
    assert [(figure.name, figure.value, figure.unit) for figure in figures] == [
        ("omega", 1.0, "deg"), ("focal length", 1500.0, "px"),
        ("principal point, line", 20.0, "px"), ("principal point, sample", 30.0, "px")]
